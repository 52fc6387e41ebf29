"""What drives did when they were asked to: as text and as a page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stillflux import html_page
from stillflux.evidence.operate import Performed
from stillflux.evidence.registry import operations
from stillflux.evidence.report.page import cut_off
from stillflux.html_page import svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["table", "write"]


def table(found: Sequence[Performed]) -> str:
    """Verdicts as plain text, failing claims below."""
    lines = []
    for x in found:
        lines.append(f"  {x.name:<22} {x.machine:<7} {x.scheme:<9} {'ok' if x.ok else 'FAILED'}")
        lines += [f"{'':10}{c.text}: {c.measured}" for c in (*x.claims, *x.without) if not c.ok]
    return "\n".join(lines)


def write(path: Path, command: str, found: Sequence[Performed], stopped: str = "") -> None:
    """One self-contained page: every operation with its claims, and a picture of its first drive."""
    escape = html.escape
    sections = []
    for name in dict.fromkeys(x.name for x in found):
        operation, runs = operations()[name], [x for x in found if x.name == name]
        rows = "".join(
            f"<tr><td>{escape(x.machine)}</td><td>{escape(x.scheme)}</td><td>{escape(c.text)}</td>"
            f"<td>{escape(c.measured)}</td><td class='{verdict}'>{verdict}</td></tr>"
            for x in runs
            for c in (*x.claims, *x.without)
            for verdict in ("ok" if c.ok else "failed",)
        )
        sections.append(
            f"<h2 id='{name}'>{escape(operation.asked)}</h2>"
            f"<p>Negative control: without {escape(operation.control.off)}.</p>"
            f"<figure>{svg(_picture(runs[0]))}</figure><table><tr><th>drive</th><th>scheme</th><th>claim</th><th>measured</th><th>verdict</th></tr>"
            f"{rows}</table>"
        )
    html_page.write(
        path,
        "Operations: what was asked, what happened",
        f"<p>Made by <code>{escape(command)}</code>.</p>{cut_off(stopped)}{''.join(sections)}",
    )


def _picture(x: Performed) -> Figure:
    from matplotlib.figure import Figure

    shown = [name for name in x.traces if not name.startswith("without ")]
    figure = Figure(figsize=(9, 1.8 * len(shown)), layout="constrained")
    for panel, name in zip(
        figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0], shown, strict=True
    ):
        panel.plot(*x.traces[name], linewidth=0.9, label="with")
        panel.plot(*x.traces[f"without {name}"], linewidth=0.9, label="without")
        panel.set_ylabel(name)
        panel.grid(alpha=0.3)
    panel.set_xlabel("time, s")
    panel.legend(fontsize="small")
    figure.suptitle(f"{x.machine}, {x.scheme}")
    return figure
