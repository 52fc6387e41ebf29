"""How far the real machine may be off from what the drive believes before a figure's verdict falls.

A ladder of errors is climbed in both directions under the first seed until a claim falls; the step reached is
then tried under every other seed, and where a claim falls the ladder is climbed down. So the step that is
given holds under all of them.
"""

from __future__ import annotations

import html
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from stillflux.evidence.claims import Claim, reported
from stillflux.evidence.errors import ERRORS
from stillflux.evidence.figure import Experiment
from stillflux.evidence.journal import Runner
from stillflux.evidence.registry import experiments
from stillflux.evidence.seeds import SEEDS
from stillflux.parallel import run_jobs
from stillflux.simulation import DivergenceError, simulate

__all__ = [
    "FIGURES",
    "LESS",
    "MORE",
    "Margin",
    "jobs",
    "margin",
    "progress",
    "run_all",
    "to_html",
    "to_markdown",
]

LESS, MORE = ", real value smaller", ", real value larger"
"""Sides of an error, after its name."""

FIGURES = ("13b", "15", "18", "19", "20")
"""The figures whose margins are measured."""


@dataclass(frozen=True)
class Margin:
    """The largest steps at which every claim still held, and the first at which one fell."""

    figure: str
    machine: str
    error: str
    down: float | None
    """None if the error has no sign."""
    up: float
    fell: str = ""
    """The claims that fell first."""

    @property
    def claims(self) -> tuple[Claim, ...]:
        """Its sides as numbers, in the unit of the error."""
        error = ERRORS[self.error]
        sides = ((LESS, self.down), (MORE, self.up))
        return tuple(
            reported(f"{self.error}{side}", error.scale * x, error.unit) for side, x in sides if x is not None
        )

    def __str__(self) -> str:
        error = ERRORS[self.error]

        def shown(x: float, sign: str, beyond: str, within: str) -> str:
            if x == 0.0:
                return f"{within}{sign}{error.scale * error.steps[0]:.3g}"
            open_end = beyond if abs(x) == error.steps[-1] else ""
            return f"{open_end}{sign}{error.scale * abs(x):.3g}"

        if self.down is None:
            return f"{shown(self.up, '', '≥ ', '< ')} {error.unit}"
        return f"{shown(self.down, '−', '≤ ', '> ')} … {shown(self.up, '+', '≥ ', '< ')} {error.unit}"


def margin(
    figure: str, machine: str, error: str, arithmetic: str = "f32", seeds: Sequence[int] = SEEDS
) -> Margin:
    """Climbs the ladder of steps in both directions until the verdict falls."""
    experiment, kind = experiments()[figure], ERRORS[error]
    fell: list[str] = []

    def climb(sign: float) -> float:
        held, lost = climbed(
            len(kind.steps),
            seeds,
            lambda k, seed: _lost(experiment, machine, error, sign * kind.steps[k], arithmetic, seed),
        )
        if lost:
            fell.append(f"{'+' if sign > 0 else '−'}: {lost}")
        return sign * kind.steps[held - 1] if held else 0.0

    up = climb(1.0)
    down = climb(-1.0) if kind.signed else None
    return Margin(figure, machine, error, down, up, "; ".join(fell))


def climbed(steps: int, seeds: Sequence[int], lost: Callable[[int, int], str]) -> tuple[int, str]:
    """Number of steps of a ladder that hold under every seed, and what is lost at the first that does not.

    `lost` takes the index of a step and a seed and returns what is lost there, empty if nothing is.
    """
    held, why = 0, ""
    while held < steps and not (why := lost(held, seeds[0])):
        held += 1
    for seed in seeds[1:]:
        while held and (found := lost(held - 1, seed)):
            held, why = held - 1, f"{found}, seed {seed}"
    return held, why


def _lost(experiment: Experiment, machine: str, error: str, x: float, arithmetic: str, seed: int) -> str:
    """The first claim that a mismatch breaks; empty if all hold."""
    (run,) = experiment.runs(machine, arithmetic, seed)
    try:
        claims = experiment.check(simulate(ERRORS[error].apply(run, x)))
    except (ValueError, DivergenceError) as reason:  # Not admissible, never turned, or run away.
        return str(reason)
    fallen = experiment.unexpected(machine, claims)
    return f"{fallen[0].text}: {fallen[0].measured}" if fallen else ""


def jobs(figures: Sequence[str], machines: Sequence[str]) -> list[tuple[str, str, str]]:
    """Figure, machine and error of every margin of those of `figures` that have any."""
    return [(f, m, e) for f in FIGURES if f in figures for m in machines for e in ERRORS]


def run_all(
    figures: Sequence[str],
    machines: Sequence[str],
    arithmetic: str = "f32",
    show: Callable[[int, int, Margin], None] | None = None,
    runner: Runner = run_jobs,
) -> list[Margin]:
    """Measures every margin of those of `figures` that have any, on all processors."""
    return runner(margin, jobs(figures, machines), arithmetic, first=is_long, show=show)


def is_long(job: tuple[Any, ...]) -> bool:
    """Whether a margin takes long: that of the minute at zero stator frequency."""
    return bool(job[0] == "18")


def progress(done: int, total: int, found: Margin) -> None:
    """One line on stderr for each margin."""
    line = f"[{done:2d}/{total}] Fig. {found.figure}, {found.machine}, {found.error}: {found}"
    print(line, file=sys.stderr, flush=True)


def _rows(margins: Sequence[Margin]) -> tuple[list[str], list[list[str]]]:
    columns = list(dict.fromkeys((x.figure, x.machine) for x in margins))
    by = {(x.figure, x.machine, x.error): str(x) for x in margins}
    head = ["real value off by", *(f"{figure}, {machine}" for figure, machine in columns)]
    return head, [[error, *(by.get((*column, error), "–") for column in columns)] for error in ERRORS]


def to_markdown(margins: Sequence[Margin]) -> str:
    """The table, one figure and machine a column."""
    head, rows = _rows(margins)
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))


def to_html(margins: Sequence[Margin]) -> str:
    """The table and what fell first, as a section of the report."""
    head, rows = _rows(margins)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(x)}</td>" for x in row) + "</tr>" for row in rows)
    fell = "".join(
        f"<tr><td>{html.escape(f'{x.figure}, {x.machine}')}</td><td>{html.escape(x.error)}</td>"
        f"<td>{html.escape(x.fell or 'nothing')}</td></tr>"
        for x in margins
    )
    return (
        "<h2 id='sensitivity'>Sensitivity</h2><p>How far the real value may be off from what the drive was "
        "told before the first claim of the figure falls; everything else as in the figure. The drive adapts "
        "r̂_s where it can. Largest step of a ladder that held, on both sides.</p>"
        f"<table><tr>{''.join(f'<th>{html.escape(x)}</th>' for x in head)}</tr>{body}</table>"
        "<details><summary>What falls first, beyond</summary><table><tr><th>figure</th><th>error</th>"
        f"<th>claim that falls</th></tr>{fell}</table></details>"
    )
