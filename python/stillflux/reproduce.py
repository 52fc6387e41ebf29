"""Runs the paper's figures with their negative controls, in parallel, and writes verdicts and report."""

from __future__ import annotations

import csv
import html
import io
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from stillflux.beyond.scenarios import SCHEMES
from stillflux.beyond.targets import KNOWN, STEPPED, TARGETS
from stillflux.claims import Claim
from stillflux.experiments import EXPERIMENTS, FIGURES, Experiment
from stillflux.openloop import VoltageFed, Waveforms
from stillflux.parallel import run_jobs
from stillflux.report import STYLE, conditions, svg
from stillflux.scenarios import ALL_MACHINES, MACHINES

__all__ = ["METRICS_OF", "Judged", "Outcome", "choose", "metrics_table", "run", "run_all"]

Verdict = str
"""`reproduced`; `limit`: falls short as explained; `FAILED`."""


@dataclass(frozen=True)
class Outcome:
    """One figure at one machine."""

    figure: str
    machine: str
    verdict: Verdict
    claims: tuple[Claim, ...]
    control: tuple[Claim, ...]
    """The claims that fail in the negative control."""
    conditions: str = ""
    picture: str = ""
    """The plot as SVG."""

    @property
    def experiment(self) -> Experiment:
        """What was run."""
        return EXPERIMENTS[self.figure]

    @property
    def reason(self) -> str:
        """Why it falls short; empty if it does not."""
        return self.experiment.limits[self.machine].reason if self.verdict == "limit" else ""

    @property
    def summary(self) -> str:
        """The claims that say most: those that fail, else the first that have a number."""
        shown = [claim for claim in self.claims if not claim.ok]
        shown = (
            shown or [claim for claim in self.claims if claim.value is not None][:3] or list(self.claims[:1])
        )
        return "; ".join(f"{claim.text}: {claim.measured}" for claim in shown)


def choose(names: Iterable[str]) -> tuple[str, ...]:
    """Figures by number: "13" stands for 13a and 13b. Raises ValueError for one that does not exist."""
    chosen: list[str] = []
    for name in names:
        found = [f for f in FIGURES if f == name or (f.startswith(name) and not f[len(name)].isdigit())]
        if not found:
            raise ValueError(f"there is no figure {name}; there are {', '.join(FIGURES)}")
        chosen += found
    return tuple(dict.fromkeys(chosen)) or FIGURES


def judge(figure: str, machine: str, claims: Sequence[Claim], control: Sequence[Claim]) -> Verdict:
    """The verdict on claims and those of the negative control."""
    if EXPERIMENTS[figure].unexpected(machine, claims) or all(claim.ok for claim in control):
        return "FAILED"
    return "reproduced" if all(claim.ok for claim in claims) else "limit"


def run(figure: str, machine: str, arithmetic: str = "f32", folder: Path | None = None) -> Outcome:
    """Runs one figure with its negative control; with a folder, also draws it there as PNG."""
    experiment = EXPERIMENTS[figure]
    results = experiment.simulate(machine, arithmetic)
    claims = experiment.check(*results)
    control = experiment.run(machine, arithmetic, control=True)
    picture = described = ""
    if folder is not None:
        drawing = experiment.draw(*results)
        drawing.savefig(folder / f"figure-{figure}-{machine}.png", dpi=100)
        drawing.set_layout_engine("none")
        picture = svg(drawing)
        described = _described(results[-1] if figure == "16" else results[0])
    return Outcome(
        figure=figure,
        machine=machine,
        verdict=judge(figure, machine, claims, control),
        claims=tuple(claims),
        control=_failing(claims, control),
        conditions=described,
        picture=picture,
    )


def _failing(claims: Sequence[Claim], control: Sequence[Claim]) -> tuple[Claim, ...]:
    """Claims that fail in the negative control, before all others those that hold otherwise."""
    held = {claim.text for claim in claims if claim.ok}
    return tuple(sorted((c for c in control if not c.ok), key=lambda c: c.text not in held))


def _described(result: Any) -> str:
    if isinstance(result, Waveforms):
        run: VoltageFed = result.run
        return (
            f"Conditions: open loop, u* on a circle, shaft speed imposed, rated flux; switching plant, "
            f"{run.inverter.f_s / 1e3:g} kHz, dc link {run.inverter.u_dc:g} V, dead time "
            f"{1e6 * run.inverter.dead_time:g} µs, threshold {run.inverter.u_th:g} V, "
            f"r_d {run.inverter.r_d:g} Ω."
        )
    return conditions(result)


def run_all(
    figures: Sequence[str],
    machines: Sequence[str],
    arithmetic: str = "f32",
    folder: Path | None = None,
    show: Callable[[int, int, Outcome], None] | None = None,
) -> list[Outcome]:
    """Runs figures at machines in as many processes as there are processors; `show` reports progress."""
    jobs = [(figure, machine) for figure in figures for machine in machines]
    long = ("18", "11", "17-130", "17-120", "10", "10-250mV", "2")
    return run_jobs(run, jobs, arithmetic, folder, first=lambda job: job[0] in long, show=show)


def progress(done: int, total: int, outcome: Outcome) -> None:
    """One line on stderr for each figure."""
    line = f"[{done:2d}/{total}] Fig. {outcome.figure}, {outcome.machine}: {outcome.verdict}"
    print(line, file=sys.stderr, flush=True)


def table(outcomes: Sequence[Outcome]) -> str:
    """Verdicts as plain text, one figure a line, failing claims below."""
    lines = []
    for o in outcomes:
        lines.append(f"  {'Fig. ' + o.figure:<14} {o.machine:<6}  {o.verdict:<10}  {o.experiment.claim}")
        lines += [f"{'':27}{c.text}: {c.measured}" for c in o.claims if not c.ok]
        if not o.control:
            lines.append(f"{'':27}the negative control ({o.experiment.control_text}) does not fail")
    return "\n".join(lines)


def to_json(outcomes: Sequence[Outcome]) -> str:
    """The verdicts for machines."""
    rows = [
        {
            "figure": o.figure,
            "machine": o.machine,
            "claim": o.experiment.claim,
            "verdict": o.verdict,
            "reason": o.reason or None,
            "claims": [asdict(c) for c in o.claims],
            "control": {"what": o.experiment.control_text, "fails": [asdict(c) for c in o.control]},
        }
        for o in outcomes
    ]
    return json.dumps(finite(rows), indent=1, ensure_ascii=False)


def finite(value: Any) -> Any:
    """Infinite numbers become null: JSON has none."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value


# The committed table of metrics.

_COLUMNS = ("figure", "machine", "quantity", "value", "unit", "ok")

METRICS_OF = (
    *((figure, machine) for figure in FIGURES for machine in MACHINES),
    *(
        (f"{target}, {scheme}", machine)
        for target in (*TARGETS, KNOWN, STEPPED)
        for machine in ALL_MACHINES
        for scheme in SCHEMES
    ),
)
"""Figure, or target and scheme, and machine: what the table may hold, in its order."""


class Judged(Protocol):
    """Whatever has lines in the table: a figure or a target at a machine."""

    @property
    def figure(self) -> str:
        """Figure, or target and scheme."""

    @property
    def machine(self) -> str:
        """Name of the machine."""

    @property
    def claims(self) -> tuple[Claim, ...]:
        """What was claimed and measured."""


def metrics_table(outcomes: Sequence[Judged], before: Sequence[dict[str, str]] = ()) -> str:
    """CSV of what every claim measured, to two digits.

    The closed loop is chaotic where phase currents cross zero, so digits move with the compiler. A value
    that meets its limit and agrees with that of `before` (see `agree`) is left as it stands there: only real
    changes show in a diff.
    """
    known = {(row["figure"], row["machine"], row["quantity"]): row for row in before}
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    fresh: dict[tuple[str, str], list[dict[str, str]]] = {}
    for o in outcomes:
        rows = fresh.setdefault((o.figure, o.machine), [])
        for claim in o.claims:
            row = metrics_row(o, claim)
            old = known.get((row["figure"], row["machine"], row["quantity"]))
            rows.append(old if old is not None and claim.ok and agree(old, row, claim) else row)
    # What was not run stays.
    for row in before:
        if (row["figure"], row["machine"]) not in {(o.figure, o.machine) for o in outcomes}:
            fresh.setdefault((row["figure"], row["machine"]), []).append(row)
    for key in METRICS_OF:
        writer.writerows(fresh.get(key, []))
    return text.getvalue()


def metrics_row(outcome: Judged, claim: Claim) -> dict[str, str]:
    """One line of the table."""
    return {
        "figure": outcome.figure,
        "machine": outcome.machine,
        "quantity": claim.text,
        "value": claim.measured.split(" at ")[0]
        if claim.value is None
        else f"{float(f'{claim.value:.2g}'):g}",
        "unit": claim.unit.strip(),
        "ok": "yes" if claim.ok else "no",
    }


def agree(old: dict[str, str], new: dict[str, str], claim: Claim) -> bool:
    """Whether two lines say the same: within 30 % or 5 % of the limit; what fails has only to fail."""
    if old["ok"] != new["ok"] or not claim.ok:
        return old["ok"] == new["ok"]
    if claim.value is None:
        return old["value"] == new["value"]
    margin = max(0.3 * abs(float(old["value"])), 0.05 * abs(claim.limit or 0.0))
    return abs(float(old["value"]) - claim.value) <= margin


def read_metrics(path: Path) -> list[dict[str, str]]:
    """The committed table; empty if there is none."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# The report.


def write_report(
    path: Path, command: str, outcomes: Sequence[Outcome], sensitivity: str = "", beyond: str = ""
) -> None:
    """One self-contained HTML page: index table, further sections, then every figure."""
    escape = html.escape
    machines = list(dict.fromkeys(o.machine for o in outcomes))
    figures = list(dict.fromkeys(o.figure for o in outcomes))
    index = "".join(
        f"<tr><td><a href='#{_anchor(o)}'>{escape(o.figure)}</a></td><td>{escape(o.machine)}</td>"
        f"<td>{escape(o.experiment.claim)}</td><td>{escape(o.summary)}</td>"
        f"<td class='{_css(o)}'>{o.verdict}</td><td>{escape(_control(o))}</td></tr>"
        for o in outcomes
    )
    sections = []
    for figure in figures:
        experiment = EXPERIMENTS[figure]
        sections.append(f"<h2>Fig. {escape(figure)}: {escape(experiment.title)}</h2>")
        sections += [_section(o) for o in outcomes if o.figure == figure]
    title = "The figures of the paper, on plant truth"
    intro = (
        f"Made by <code>{escape(command)}</code>, at {escape(' and '.join(machines))}. The paper: J. Holtz, "
        "J. Quan, <i>Drift- and parameter-compensated flux estimator for persistent zero-stator-frequency "
        "operation of sensorless-controlled induction motors</i>. Every verdict is on what the motor does, "
        "not on what the drive believes. <i>limit</i>: the published scheme falls short of the paper's "
        "figure here, measured and explained; every claim that the explanation does not cover holds. Each "
        "negative control has to fail."
    )
    if beyond:
        intro += " <a href='#beyond'>Beyond the paper.</a>"
    if sensitivity:
        intro += " <a href='#sensitivity'>How far parameters may be off.</a>"
    path.write_text(
        f"<!doctype html>\n<html lang='en'><head><meta charset='utf-8'><title>{title}</title>"
        f"<style>{STYLE}</style></head>\n<body><h1>{title}</h1>\n"
        f"<p>{intro}</p>\n<table><tr><th>fig.</th><th>machine</th><th>claim</th><th>measured</th><th>verdict</th>"
        f"<th>negative control</th></tr>{index}</table>\n{beyond}\n"
        f"{sensitivity}\n{''.join(sections)}\n</body></html>\n",
        encoding="utf-8",
    )


def _anchor(o: Outcome) -> str:
    return f"fig-{o.figure}-{o.machine.replace('.', '-')}"


def _css(o: Outcome) -> str:
    return {"reproduced": "ok", "limit": "limit"}.get(o.verdict, "failed")


def _control(o: Outcome) -> str:
    worst = "; ".join(f"{c.text}: {c.measured}" for c in o.control[:1])
    return f"{o.experiment.control_text}: {worst or 'all claims hold, which they must not'}"


def _section(o: Outcome) -> str:
    escape = html.escape
    rows = "".join(
        f"<tr><td>{escape(c.text)}</td><td>{escape(c.measured)}</td>"
        f"<td class='{'ok' if c.ok else _css(o)}'>{'ok' if c.ok else 'not met'}</td></tr>"
        for c in o.claims
    )
    reason = f"<p class='limit'>Why: {escape(o.reason)}</p>" if o.reason else ""
    return (
        f"<section id='{_anchor(o)}'><h3>{escape(o.machine)}: <span class='{_css(o)}'>{o.verdict}</span></h3>"
        f"<figure>{o.picture}</figure>"
        f"<table><tr><th>claim</th><th>measured</th><th></th></tr>{rows}</table>{reason}"
        f"<p>Negative control, {escape(_control(o))}</p><p>{escape(o.conditions)}</p>"
        f"<p><code>stillflux reproduce {escape(o.figure)} --machine {escape(o.machine)}</code></p></section>"
    )
