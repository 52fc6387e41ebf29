"""What drawn installations showed: rates of loss and the consistency of the estimate, as text, JSON and
pages."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stillflux import html_page
from stillflux.evidence import draws, effects
from stillflux.evidence.consistency import REGIONS, Consistency, Sample, by_claim
from stillflux.evidence.courses import COURSES
from stillflux.evidence.report.page import cut_off, finite
from stillflux.evidence.tolerance import LOST_ANGLE, Outcome, interval, rates, rerun_of
from stillflux.html_page import svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["consistency_table", "describe", "table", "to_json", "write_consistency", "write_tolerance"]


def describe(x: Outcome) -> str:
    """One run with what was drawn, as text."""
    lost = f"lost {x.lost:.3g} s after the start-up: {x.why}" if x.why else "kept"
    head = (
        f"{x.machine}, {COURSES[x.course].title}, draw {x.draw}, {x.scheme}: {lost}, angle ≤ {x.angle:.3g}°"
    )
    return "\n".join([head, *(f"  {name:<18} {value:.4g}" for name, value in x.numbers.items())])


def _cell(lost: int, runs: int) -> str:
    if not runs:
        return "–"
    low, high = (100.0 * x for x in interval(lost, runs))
    return f"{lost} of {runs} ({low:.3g}…{high:.3g} %)"


def _judged(text: str, ok: bool) -> str:
    return f"<td class='{'ok' if ok else 'failed'}'>{html.escape(text)}</td>"


def _counted(found: Sequence[Outcome], course: str, machine: str | None) -> tuple[int, int]:
    mine = [x for x in found if x.course == course and machine in (None, x.machine)]
    return sum(bool(x.why) for x in mine), len(mine)


def table(found: Sequence[Outcome]) -> str:
    """Losses by course and drive with their 95 % intervals, the largest angle of those kept, and every
    loss, as text."""
    lines = []
    for rate in rates(found):
        claims = "; ".join(
            f"{c.quantity} {c.measured}" for c in rate.claims if not c.run and c.quantity != "draws"
        )
        bad = "" if all(c.ok for c in rate.claims) else "  NOT MET"
        lines.append(f"  {rate.machine:<7} {rate.course:<13} {claims}{bad}")
    for course in dict.fromkeys(x.course for x in found):
        lines.append(f"  {'all':<7} {course:<13} {_cell(*_counted(found, course, None))}")
    excursions, misses = sum(x.excursions for x in found), sum(x.misses for x in found)
    alarm = 100.0 * sum(x.needless for x in found) / max(sum(x.running for x in found), 1e-9)
    lines.append(
        f"  excursions beyond 15°: {excursions}, announced {excursions - misses}; "
        f"needless alarms {alarm:.2g} % of the time"
    )
    lines += [f"  {x.why} after {x.lost:.3g} s: {rerun_of(x)}" for x in found if x.why]
    return "\n".join(lines)


def to_json(found: Sequence[Outcome]) -> str:
    """Every run."""
    return json.dumps([finite(asdict(x)) for x in found], indent=1, ensure_ascii=False)


def _page(path: Path, title: str, command: str, body: str, stopped: str) -> None:
    html_page.write(
        path,
        title,
        f"<p>Made by <code>{html.escape(command)}</code>. All verdicts are on the plant's truth.</p>"
        f"{cut_off(stopped)}\n{body}",
    )


def write_tolerance(path: Path, command: str, found: Sequence[Outcome], stopped: str = "") -> None:
    """The page of the rates of loss, with every loss and the command that runs it again."""
    machines = list(dict.fromkeys(x.machine for x in found))
    judged = {(r.course, r.machine): all(c.ok for c in r.claims) for r in rates(found)}
    body = ""
    for name in dict.fromkeys(x.course for x in found):
        target = COURSES[name].target
        cells = "".join(
            _judged(_cell(*_counted(found, name, m)), judged.get((name, m), True)) for m in machines
        )
        body += (
            f"<tr><td>{html.escape(COURSES[name].title)}</td>"
            f"<td>{'–' if target is None else f'{target:g} %'}</td>"
            f"{cells}<td>{_cell(*_counted(found, name, None))}</td></tr>"
        )
    head = "".join(f"<th>{html.escape(m)}</th>" for m in machines)
    losses = "".join(
        f"<tr><td>{x.machine}</td><td>{x.course}</td><td>{x.draw}</td><td>{x.lost:.3g}</td><td>{html.escape(x.why)}</td>"
        f"<td>{x.numbers['knee']:.3g}</td><td>{x.numbers['capacitance told']:.3g}</td>"
        f"<td><code>{html.escape(rerun_of(x))}</code></td></tr>"
        for x in found
        if x.why
    )
    picture = f"<figure>{svg(_angles(found))}</figure>" if found else ""
    drawn = draws.__doc__ or ""
    if any(x.beyond_model for x in found):
        drawn += effects.__doc__ or ""
    _page(
        path,
        "Tolerances: every parameter off at once",
        command,
        "<p>Lost: a fault, a field angle error above 30° while running, or a true speed off by more than "
        "0.05 pu at the end. In brackets the 95 % interval of the rate.</p>"
        f"<table><tr><th>course</th><th>target</th>{head}<th>all</th></tr>{body}</table>{picture}"
        "<h2>Losses</h2><table><tr><th>drive</th><th>course</th><th>draw</th><th>after, s</th><th>by</th>"
        f"<th>I_k / peak current</th><th>capacitance told / real</th><th>run again</th></tr>{losses}</table>"
        f"<h2>What was drawn</h2><pre>{html.escape(drawn)}</pre>",
        stopped,
    )


def _angles(found: Sequence[Outcome]) -> Figure:
    """Largest angle error of every run over the knee of its bridge."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for machine in dict.fromkeys(x.machine for x in found):
        mine = [x for x in found if x.machine == machine]
        knee, angle = (
            np.array(v) for v in zip(*((100 * x.numbers["knee"], x.angle) for x in mine), strict=True)
        )
        lost = np.array([bool(x.why) for x in mine])
        (line,) = axes.plot(knee[~lost], angle[~lost], ".", markersize=3, label=machine)
        axes.plot(knee[lost], np.minimum(angle[lost], 90.0), "x", markersize=5, color=line.get_color())
    axes.axhline(LOST_ANGLE, color="0.5", linewidth=0.8)
    axes.set(
        xscale="log", yscale="log", xlabel="I_k in % of rated peak current", ylabel="largest angle error, °"
    )
    axes.set_title("dots: kept, crosses: lost", fontsize=9)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure


def consistency_table(found: Sequence[Consistency]) -> str:
    """One claim a line, one drive a column, as text."""
    machines = [x.machine for x in found]
    lines = [f"  {'':<58}" + "".join(f"{m:>10}" for m in machines)]
    for claims in by_claim(found).values():
        first = next(iter(claims.values()))
        cells = [claims[m].measured + ("" if claims[m].ok else "!") if m in claims else "–" for m in machines]
        lines.append(f"  {first.text:<58}" + "".join(f"{cell:>10}" for cell in cells))
    return "\n".join([*lines, "  !: not met"])


def write_consistency(
    path: Path, command: str, found: Sequence[Consistency], samples: Sequence[Sample], stopped: str = ""
) -> None:
    """The page of the consistency of the estimate."""
    head = "".join(f"<th>{html.escape(x.machine)}</th>" for x in found)
    body = ""
    for claims in by_claim(found).values():
        first = next(iter(claims.values()))
        cells = "".join(
            _judged(claims[x.machine].measured, claims[x.machine].ok) if x.machine in claims else "<td>–</td>"
            for x in found
        )
        body += f"<tr><td>{html.escape(first.text)}</td>{cells}</tr>"
    picture = f"<figure>{svg(_scatter(samples))}</figure>" if samples else ""
    lost = [x for x in samples if x.lost]
    listed = "".join(f"<li>{html.escape(x.machine)}, draw {x.draw}: {html.escape(x.lost)}</li>" for x in lost)
    _page(
        path,
        "Consistency: does the drive know its angle error?",
        command,
        f"<table><tr><th></th>{head}</tr>{body}</table>{picture}<h2>Runs lost</h2><ul>{listed}</ul>",
        stopped,
    )


def _scatter(samples: Sequence[Sample]) -> Figure:
    """Angle error over what was expected of it, region by region; on the line an error of one deviation."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    for k, axes in enumerate(figure.subplots(1, len(REGIONS), sharex=True, sharey=True)):
        for machine in dict.fromkeys(x.machine for x in samples):
            mine = [x for x in samples if x.machine == machine]
            parts = [
                (np.degrees(x.sigma[x.region == k]), np.degrees(np.abs(x.error[x.region == k]))) for x in mine
            ]
            sigma, error = (np.concatenate(part) for part in zip(*parts, strict=True))
            # Every tenth: one a second.
            axes.plot(sigma[::10], np.maximum(error[::10], 1e-3), ".", markersize=2, label=machine)
        axes.plot([0.1, 30.0], [0.1, 30.0], color="0.5", linewidth=0.8)
        axes.set(xscale="log", yscale="log", title=REGIONS[k], xlabel="deviation, °")
        axes.title.set_fontsize(8)
        if k == 0:
            axes.set_ylabel("angle error, °")
    return figure
