"""What the figures showed, as text, as JSON, and as a page."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stillflux import html_page
from stillflux.evidence.machines import option
from stillflux.evidence.registry import experiments
from stillflux.evidence.report import diagram
from stillflux.evidence.report.page import cut_off, finite
from stillflux.evidence.reproduce import Outcome

__all__ = ["table", "to_json", "write"]


def table(outcomes: Sequence[Outcome]) -> str:
    """Verdicts as plain text, one figure a line, failing claims below."""
    lines = []
    for o in outcomes:
        lines.append(f"  {'Fig. ' + o.figure:<14} {o.machine:<6}  {o.verdict:<10}  {o.experiment.claim}")
        lines += [f"{'':27}{c.text}: {c.measured}{_seed(c.seed)}" for c in o.claims if not c.ok]
        if o.verdict == "FAILED" and not all(run.ok for run in o.control):
            lines.append(f"{'':27}the negative control does not fail as it must: {o.control_text}")
    return "\n".join(lines)


def _seed(seed: int | None) -> str:
    return "" if seed is None else f", realisation {seed}"


def to_json(outcomes: Sequence[Outcome]) -> str:
    """The verdicts for machines."""
    rows = [
        {
            "figure": o.figure,
            "machine": o.machine,
            "claim": o.experiment.claim,
            "verdict": o.verdict,
            "reason": o.reason or None,
            "claims": [{**asdict(c), "ok": c.ok} for c in o.claims],
            "control": _control(o),
            "enhanced": [{**asdict(c), "ok": c.ok} for c in o.enhanced],
        }
        for o in outcomes
    ]
    return json.dumps(finite(rows), indent=1, ensure_ascii=False)


def _control(o: Outcome) -> dict[str, Any]:
    control = o.experiment.control
    if control is None:
        return {"what": None, "why": o.experiment.no_control}
    return {
        "what": control.text,
        "event": control.event,
        "lost": [run.lost for run in o.control],
        "ok": all(run.ok for run in o.control),
        "fails": [asdict(claim) for run in o.control for claim in run.expected if not claim.ok],
    }


def write(
    path: Path,
    command: str,
    outcomes: Sequence[Outcome],
    sensitivity: str = "",
    beyond: str = "",
    stopped: str = "",
) -> None:
    """One self-contained HTML page: index table, further sections, then every figure; `stopped` says why
    figures are missing."""
    escape = html.escape
    machines = list(dict.fromkeys(o.machine for o in outcomes))
    figures = list(dict.fromkeys(o.figure for o in outcomes))
    index = "".join(
        f"<tr><td><a href='#{_anchor(o)}'>{escape(o.figure)}</a></td><td>{escape(o.machine)}</td>"
        f"<td>{escape(o.experiment.claim)}</td><td>{escape(o.summary)}</td>"
        f"<td class='{_css(o)}'>{o.verdict}</td><td>{escape(o.control_text)}</td></tr>"
        for o in outcomes
    )
    sections = []
    for figure in figures:
        sections.append(f"<h2>Fig. {escape(figure)}: {escape(experiments()[figure].title)}</h2>")
        sections += [_section(o) for o in outcomes if o.figure == figure]
    title = "The figures of the paper, on plant truth"
    intro = (
        f"Made by <code>{escape(command)}</code>, at {escape(' and '.join(machines))}. The paper: J. Holtz, "
        "J. Quan, <i>Drift- and parameter-compensated flux estimator for persistent zero-stator-frequency "
        "operation of sensorless-controlled induction motors</i>. Every verdict is on what the motor does, "
        "not on what the drive believes; every number is the worst over several realisations of noise and "
        "direction of the offset. Each negative control has to fail, after the moment from which the "
        "mechanism is needed."
    )
    if any(o.verdict == "limit" for o in outcomes):
        intro += (
            " <i>limit</i>: the published scheme falls short of the paper's figure here, measured and "
            "explained; every claim that the explanation does not cover holds."
        )
    if beyond:
        intro += " <a href='#beyond'>Beyond the paper.</a>"
    if sensitivity:
        intro += " <a href='#sensitivity'>How far parameters may be off.</a>"
    html_page.write(
        path,
        title,
        f"<p>{intro}</p>{cut_off(stopped)}\n<figure>{diagram.drive()}</figure>\n<h2>Overview</h2><table><tr><th>fig.</th><th>machine</th><th>claim</th><th>measured</th><th>verdict</th>"
        f"<th>negative control</th></tr>{index}</table>\n{beyond}\n"
        f"{sensitivity}\n{''.join(sections)}",
    )


def _anchor(o: Outcome) -> str:
    return re.sub(r"[^\w-]", "-", f"fig-{o.figure}-{o.machine}")


def _css(o: Outcome) -> str:
    return {"reproduced": "ok", "limit": "limit"}.get(o.verdict, "failed")


def _section(o: Outcome) -> str:
    escape = html.escape
    beside = {c.key: c.measured if c.ok else f"{c.measured} (not met)" for c in o.enhanced}
    rows = "".join(
        f"<tr><td>{escape(c.text)}</td><td>{escape(c.measured)}</td>"
        f"<td>{'' if c.seed is None else c.seed}</td>"
        f"<td class='{'ok' if c.ok else _css(o)}'>{'ok' if c.ok else 'not met'}</td>"
        f"<td>{escape(beside.get(c.key, ''))}</td></tr>"
        for c in o.claims
    )
    head = f"enhanced{': ' + escape(o.experiment.beside) if o.experiment.beside else ''}"
    reason = f"<p class='limit'>Why: {escape(o.reason)}</p>" if o.reason else ""
    return (
        f"<section id='{_anchor(o)}'><h3>{escape(o.machine)}: <span class='{_css(o)}'>{o.verdict}</span></h3>"
        f"<figure>{o.picture}</figure>"
        f"<table><tr><th>claim</th><th>measured</th><th>realisation</th><th></th><th>{head}</th></tr>{rows}</table>{reason}"
        f"<p>Negative control, {escape(o.control_text)}</p><p>{escape(o.conditions)}</p>"
        f"<p><code>stillflux reproduce {escape(o.figure)} {escape(option(o.machine))}</code></p></section>"
    )
