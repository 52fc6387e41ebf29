"""How far the real machine may be off from what the drive believes before a figure's verdict falls."""

from __future__ import annotations

import html
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from stillflux.experiments import EXPERIMENTS
from stillflux.parallel import run_jobs
from stillflux.parameters import Motor
from stillflux.scenario import Scenario
from stillflux.simulation import simulate

__all__ = ["ERRORS", "FIGURES", "Margin", "margin", "run_all", "to_html", "to_markdown"]

FIGURES = ("13b", "15", "18", "19", "20")
"""The figures whose margins are measured."""

_RELATIVE = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)


def _motor(change: Callable[[Motor, float], Motor]) -> Callable[[Scenario, float], Scenario]:
    """The real motor changed; what happens to R_s during the run changes in proportion."""

    def apply(scenario: Scenario, x: float) -> Scenario:
        real = change(scenario.motor, x)
        ratio = real.R_s / scenario.motor.R_s
        changes = [
            (t, {k: v * ratio if k == "R_s" else v for k, v in c.items()}) for t, c in scenario.changes
        ]
        return scenario.replace(plant_motor=real, changes=changes)

    return apply


def _l_s(motor: Motor, x: float) -> Motor:
    """Stator inductance, at the same leakage and rotor time constant."""
    L_M = (1 + x) * motor.L_s - motor.L_sigma
    curve = motor.saturation and ((1 + x) * motor.saturation[0], *motor.saturation[1:])
    return motor.replace(L_M=L_M, R_R=L_M / motor.tau_r, saturation=curve)


def _sigma_l_s(motor: Motor, x: float) -> Motor:
    """Leakage inductance, at the same stator inductance and rotor time constant."""
    L_sigma = (1 + x) * motor.L_sigma
    L_M = motor.L_s - L_sigma
    return motor.replace(L_sigma=L_sigma, L_M=L_M, R_R=L_M / motor.tau_r)


def _inverter(name: str) -> Callable[[Scenario, float], Scenario]:
    def apply(scenario: Scenario, x: float) -> Scenario:
        inverter = scenario.inverter
        return scenario.replace(plant_inverter=inverter.replace(**{name: (1 + x) * getattr(inverter, name)}))

    return apply


def _offset(scenario: Scenario, x: float) -> Scenario:
    return scenario.replace(plant={**scenario.plant, "current_offset": x * _complex(scenario)})


def _complex(scenario: Scenario) -> complex:
    offset = scenario.plant["current_offset"]
    assert isinstance(offset, complex)
    return offset


def _gain(scenario: Scenario, x: float) -> Scenario:
    return scenario.replace(plant={**scenario.plant, "current_gain": (1 + x, 1.0, 1.0)})


@dataclass(frozen=True)
class Error:
    """One kind of mismatch."""

    apply: Callable[[Scenario, float], Scenario]
    steps: Sequence[float] = _RELATIVE
    """Sizes tried, ascending, in both directions if `signed`."""
    signed: bool = True
    scale: float = 100.0
    unit: str = " %"


ERRORS: Mapping[str, Error] = {
    "r_s": Error(_motor(lambda motor, x: motor.replace(R_s=(1 + x) * motor.R_s))),
    "σl_s": Error(_motor(_sigma_l_s)),
    "l_s": Error(_motor(_l_s)),
    "τ_r": Error(_motor(lambda motor, x: motor.replace(R_R=motor.R_R / (1 + x)))),
    "u_th": Error(_inverter("u_th"), (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)),
    "dead time": Error(_inverter("dead_time"), (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3)),
    "current offset": Error(_offset, (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0), False, 25.0, " mV"),
    "gain of one current channel": Error(_gain, (0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1)),
}
"""What may be off. The real value is meant, the drive keeps its own."""


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

    def __str__(self) -> str:
        error = ERRORS[self.error]

        def shown(x: float, sign: str, beyond: str, within: str) -> str:
            if x == 0.0:
                return f"{within}{sign}{error.scale * error.steps[0]:.3g}"
            open_end = beyond if abs(x) == error.steps[-1] else ""
            return f"{open_end}{sign}{error.scale * abs(x):.3g}"

        if self.down is None:
            return f"{shown(self.up, '', '≥ ', '< ')}{error.unit}"
        return f"{shown(self.down, '−', '≤ ', '> ')} … {shown(self.up, '+', '≥ ', '< ')}{error.unit}"


def margin(figure: str, machine: str, error: str, arithmetic: str = "f32") -> Margin:
    """Climbs the ladder of steps in both directions until the verdict falls."""
    kind = ERRORS[error]
    fell: list[str] = []

    def climb(sign: float) -> float:
        held = 0.0
        for step in kind.steps:
            lost = _lost(figure, machine, error, sign * step, arithmetic)
            if lost:
                fell.append(f"{'+' if sign > 0 else '−'}: {lost}")
                break
            held = sign * step
        return held

    up = climb(1.0)
    down = climb(-1.0) if kind.signed else None
    return Margin(figure, machine, error, down, up, "; ".join(fell))


def _lost(figure: str, machine: str, error: str, x: float, arithmetic: str) -> str:
    """The first claim that a mismatch breaks; empty if all hold."""
    experiment = EXPERIMENTS[figure]
    try:
        scenario = ERRORS[error].apply(experiment.build(machine, arithmetic), x)
        claims = experiment.check(simulate(scenario))
    except ValueError as reason:  # Beyond what is admissible, or never turned.
        return str(reason)
    fallen = experiment.unexpected(machine, claims)
    return f"{fallen[0].text}: {fallen[0].measured}" if fallen else ""


def run_all(
    figures: Sequence[str],
    machines: Sequence[str],
    arithmetic: str = "f32",
    show: Callable[[int, int, Margin], None] | None = None,
) -> list[Margin]:
    """Measures every margin of those of `figures` that have any, on all processors."""
    jobs = [(f, m, e) for f in FIGURES if f in figures for m in machines for e in ERRORS]
    return run_jobs(margin, jobs, arithmetic, first=lambda job: job[0] == "18", show=show)


def progress(done: int, total: int, found: Margin) -> None:
    """One line on stderr for each margin."""
    line = f"[{done:2d}/{total}] Fig. {found.figure}, {found.machine}, {found.error}: {found}"
    print(line, file=sys.stderr, flush=True)


def _rows(margins: Sequence[Margin]) -> tuple[list[str], list[list[str]]]:
    columns = list(dict.fromkeys((x.figure, x.machine) for x in margins))
    by = {(x.figure, x.machine, x.error): str(x) for x in margins}
    head = ["real value off by", *(f"{figure}, {machine}" for figure, machine in columns)]
    return head, [[error, *(by[(*column, error)] for column in columns)] for error in ERRORS]


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
