"""What the targets showed, as text, as JSON, and as a section of the report."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillflux import html_page
from stillflux.evidence.beyond import Row, Summary, summaries
from stillflux.evidence.machines import option
from stillflux.evidence.plane_points import points_of
from stillflux.evidence.points import POINTS
from stillflux.evidence.registry import targets
from stillflux.evidence.report import diagram, maps
from stillflux.evidence.report.page import cut_off
from stillflux.evidence.target import Target
from stillflux.html_page import svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["map_text", "section", "table", "to_rows", "write"]

_HEADS = {
    "angle_held": "largest angle error, °",
    "angle_settled": "settled, °",
    "angle_passed": "15° passed at, s",
    "speed_settled": "speed error, pu",
    "torque_command": "true − commanded torque, % of T_N",
    "torque_estimate": "true − estimated torque, % of T_N",
    "torque_ripple": "true torque ± % of T_N",
    "omega_s": "true ω_s",
    "r_s": "r̂_s off by, %",
}
_PERCENT = ("torque_command", "torque_estimate", "torque_ripple", "r_s")


def table(found: Sequence[Summary]) -> str:
    """Summaries as plain text, claims below each."""
    lines = []
    for x in found:
        lines.append(f"  {x.name:<20} {x.machine:<11} {x.scheme:<9} {x.held:4d} of {x.runs} runs")
        lines += [f"{'':24}{c.text}: {c.measured}{'' if c.ok else '  NOT MET'}" for c in x.claims]
    return "\n".join(lines)


def map_text(rows: Sequence[Row]) -> str:
    """A map of one machine and scheme in letters: `·` met, `o` not met, `X` lost."""
    by = maps.worst_by_point(rows)

    def letter(row: Row | None) -> str:
        if row is None:
            return " "
        return "X" if row.measured.why else "·" if row.ok else "o"

    speeds = sorted({row.point[0] for row in rows if row.point is not None})
    torques = sorted({row.point[1] for row in rows if row.point is not None}, reverse=True)
    head = f"{'':6}speed {speeds[0]:g} … {speeds[-1]:g}"
    lines = [f"{T:+5.1f} {''.join(letter(by.get((omega, T))) for omega in speeds)}" for T in torques]
    return "\n".join([head, *lines])


def to_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Plain data for JSON, without the courses."""
    return [
        {
            **{
                name: getattr(row, name) for name in ("target", "machine", "scheme", "label", "seed", "point")
            },
            "ok": row.ok,
            "measured": asdict(row.measured),
            "claims": [{**asdict(claim), "ok": claim.ok} for claim in row.claims],
        }
        for row in rows
    ]


def write(path: Path, command: str, rows: Sequence[Row], stopped: str = "") -> None:
    """The section as a page of its own, pictures beside it as PNG; `stopped` says why runs are missing."""
    html_page.write(
        path,
        "The torque-speed plane of both schemes",
        f"<p>Made by <code>{html.escape(command)}</code>.</p>{cut_off(stopped)}"
        f"<figure>{diagram.drive()}</figure>\n"
        f"{section(rows, path.parent)}",
    )


def section(rows: Sequence[Row], folder: Path | None = None) -> str:
    """The section of the report; with a folder, also draws every picture there as PNG."""
    found = summaries(rows)
    body = "".join(
        f"<tr><td>{html.escape(x.name)}</td><td>{html.escape(x.machine)}</td><td>{x.scheme}</td>"
        f"<td class='{'ok' if x.held == x.runs else 'failed'}'>{x.held} of {x.runs}</td>"
        f"<td>{_claims(x)}</td></tr>"
        for x in found
    )
    parts = [
        "<h2 id='beyond'>Beyond the paper</h2><p>The published scheme (<code>paper</code>) beside the "
        "one that goes beyond it (<code>enhanced</code>), each with its default settings for the machine. "
        "Switching-level plant with dead time, clamping, 12-bit converters, 0.4 % noise, 1 % offset of the "
        "current sensors, no friction. All verdicts are on the plant's truth. <i>Lost</i>: a fault, a field "
        "angle error above 90°, or a true speed off by more than 0.05 at the end.</p>"
        "<table><tr><th>target</th><th>machine</th><th>scheme</th><th>runs that meet it</th>"
        f"<th>worst (runs that meet it)</th></tr>{body}</table>"
    ]
    for target in dict.fromkeys(row.target for row in rows):
        what = targets()[target]
        parts.append(f"<h2 id='beyond-{target}'>{html.escape(what.title)}</h2>")
        of_target = [row for row in rows if row.target == target]
        for machine in dict.fromkeys(row.machine for row in of_target):
            mine = [row for row in of_target if row.machine == machine]
            parts.append(f"<h3>{html.escape(machine)}</h3>")
            picture = _picture(what, mine)
            if picture is not None:
                if folder is not None:
                    picture.savefig(folder / f"beyond-{target}-{machine}.png", dpi=100)
                picture.set_layout_engine("none")
                parts.append(f"<figure>{svg(picture)}</figure>")
            if what.view == "errors":
                parts.append(_mismatches(mine))
            elif what.numbers:
                parts.append(_numbers(what, mine))
            parts.append(
                f"<p><code>stillflux beyond {html.escape(target)} {html.escape(option(machine))}</code></p>"
            )
    parts.append(_doubts(rows))
    return "\n".join(parts)


def _doubts(rows: Sequence[Row]) -> str:
    """Every run in which the confidence missed an excursion or gave a false alarm."""
    body = "".join(
        f"<tr><td>{html.escape(row.target)}</td><td>{html.escape(row.machine)}</td><td>{row.scheme}</td>"
        f"<td>{html.escape(row.label)}</td><td>{row.seed}</td>"
        f"<td>{c.misses} of {c.excursions}</td><td>{c.blind:.3g}</td>"
        f"<td>{c.false_alarms}</td><td>{c.false_time:.3g}</td></tr>"
        for row in rows
        for c in (row.measured.confidence,)
        if targets()[row.target].verdict and (c.misses or c.false_alarms)
    )
    if not body:
        return ""
    return (
        "<h2 id='beyond-confidence'>Confidence</h2><p>A miss: the angle error came to exceed 15° at a "
        "confidence of 0.5 or more. A false alarm: a confidence below 0.5 for more than 0.5 s while the "
        "error stayed below 5°.</p><details><summary>Every run with either</summary><table><tr>"
        "<th>target</th><th>machine</th><th>scheme</th><th>run</th><th>seed</th><th>misses of excursions</th>"
        f"<th>time unwarned, s</th><th>false alarms</th><th>for, s</th></tr>{body}</table></details>"
    )


def _claims(x: Summary) -> str:
    return "<br>".join(
        f"<span class='{'ok' if c.ok else 'failed'}'>{html.escape(c.text)}: {html.escape(c.measured)}</span>"
        for c in x.claims
    )


def _picture(target: Target, rows: Sequence[Row]) -> Figure | None:
    if target.view == "loads":
        return maps.rest(rows)
    if target.view == "map":
        return maps.plane(points_of(rows))
    drawn = [row for row in rows if row.trace]
    return maps.courses(drawn) if drawn else None


def _mismatches(rows: Sequence[Row]) -> str:
    """Angle errors, one mismatch a line, one operating point a column, scheme after scheme."""
    schemes = maps.schemes_of(rows)
    by: dict[tuple[str, str, tuple[float, float] | None], Row] = {}
    for row in sorted(rows, key=lambda row: (bool(row.measured.why), row.measured.angle_settled)):
        by[row.scheme, row.error, row.point] = row

    def cell(scheme: str, error: str, point: tuple[float, float]) -> str:
        row = by.get((scheme, error, point))
        if row is None:
            return "–"
        measured = "lost" if row.measured.why else f"{row.measured.angle_settled:.2g}°"
        return f"<span class='{'ok' if row.ok else 'failed'}'>{measured}</span>"

    head = "".join(f"<th>ω = {omega:g}, T = {T:g} T_N</th>" for omega, T in POINTS)
    body = "".join(
        f"<tr><td>{html.escape(error)}</td>"
        + "".join(f"<td>{' / '.join(cell(x, error, p) for x in schemes)}</td>" for p in POINTS)
        + "</tr>"
        for error in dict.fromkeys(row.error for row in rows)
    )
    return (
        f"<p>Largest angle error over the last 5 s, worst seed: {html.escape(' / '.join(schemes))}.</p>"
        f"<table><tr><th>the real</th>{head}</tr>{body}</table>"
    )


def _numbers(target: Target, rows: Sequence[Row]) -> str:
    names = target.numbers

    def cell(row: Row, name: str) -> str:
        value: float = getattr(row.measured, name)
        return f"{100 * value:.2g}" if name in _PERCENT else f"{value:.3g}"

    head = "".join(f"<th>{html.escape(_HEADS[name])}</th>" for name in names)
    body = "".join(
        f"<tr><td>{html.escape(row.label)}</td><td>{row.scheme}</td><td>{row.seed}</td>"
        + "".join(f"<td>{html.escape(cell(row, name))}</td>" for name in names)
        + f"<td class='{'ok' if row.ok else 'failed'}'>"
        + html.escape("; ".join(f"{c.text}: {c.measured}" for c in row.claims if not c.ok) or "met")
        + "</td></tr>"
        for row in rows
    )
    return f"<table><tr><th>run</th><th>scheme</th><th>seed</th>{head}<th></th></tr>{body}</table>"
