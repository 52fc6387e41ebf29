"""What pages share, and a self-contained page of runs and claims."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillflux import html_page, plots
from stillflux.evidence.claims import Claim
from stillflux.evidence.report import diagram
from stillflux.html_page import svg
from stillflux.result import Result

__all__ = ["Section", "conditions", "cut_off", "finite", "table", "write"]


@dataclass(frozen=True)
class Section:
    """One run and what is claimed about it."""

    title: str
    slug: str
    """Name of its picture files."""
    result: Result
    claims: Sequence[Claim]
    note: str = ""
    expected: Sequence[str] = ()
    """Of a negative control the quantities of which one has to fail; empty: it is none."""

    @property
    def as_it_must(self) -> bool:
        """Whether every claim holds; of a negative control, whether one of those expected does not."""
        if self.expected:
            return any(not claim.ok for claim in self.claims if claim.quantity in self.expected)
        return all(claim.ok for claim in self.claims)

    def verdict(self, claim: Claim) -> tuple[str, str]:
        """What to say of a claim, and its class: what fails in a negative control is neither good nor bad."""
        if claim.direction == "reported":
            return "", ""
        if self.expected:
            return ("holds", "control") if claim.ok else ("fails", "control")
        return ("ok", "ok") if claim.ok else ("FAILED", "failed")

    @property
    def conclusion(self) -> str:
        """Of a negative control: whether it failed as it must; else nothing."""
        if not self.expected:
            return ""
        return "fails, as it must" if self.as_it_must else "does NOT fail as it must"

    @property
    def outcome(self) -> tuple[str, str]:
        """The verdict on the whole run, and its class."""
        if all(claim.direction == "reported" for claim in self.claims):
            return "measured, not judged", ""
        text = self.conclusion or ("every claim holds" if self.as_it_must else "a claim fails")
        return text, "ok" if self.as_it_must else "failed"


def table(section: Section) -> str:
    """Claims as plain text, one a line."""
    claims = section.claims
    width = max(len(claim.text) for claim in claims)
    measured = max(len(claim.measured) for claim in claims)
    lines = [f"  {c.text:<{width}}  {c.measured:>{measured}}  {section.verdict(c)[0]}" for c in claims]
    return "\n".join([*lines, *([f"  {section.conclusion}"] if section.conclusion else [])])


def write(path: Path, title: str, command: str, sections: Sequence[Section], stopped: str = "") -> None:
    """Writes the page, and beside it each figure as PNG; `stopped` says why runs are missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = "".join(
        f"<tr><td>{html.escape(x.title)}</td><td class='{x.outcome[1]}'>{html.escape(x.outcome[0])}</td></tr>"
        for x in sections
    )
    body = "\n".join(_section(section, path.parent) for section in sections)
    html_page.write(
        path,
        title,
        f"<p>Made by <code>{html.escape(command)}</code>. Every figure in the tables is the plant's truth, "
        f"not the drive's opinion.</p>{cut_off(stopped)}"
        f"<table><tr><th>run</th><th>verdict</th></tr>{rows}</table>"
        f"<figure>{diagram.drive()}</figure>\n{body}",
    )


def _section(section: Section, folder: Path) -> str:
    rows = ""
    for c in section.claims:
        text, css = section.verdict(c)
        what, value = html.escape(c.text), html.escape(c.measured)
        rows += f"<tr><td>{what}</td><td>{value}</td><td class='{css}'>{text}</td></tr>"
    if section.conclusion:
        css = "control" if section.as_it_must else "failed"
        rows += f"<tr><td colspan='3' class='{css}'>{section.conclusion}</td></tr>"
    figures = ""
    for name, draw in (("signals", plots.overview), ("flux", plots.flux_trajectory)):
        figure = draw(section.result)
        figure.savefig(folder / f"{section.slug}-{name}.png", dpi=110)
        figures += f"<figure>{svg(figure)}</figure>"
    anchor = re.sub(r"[^\w-]", "-", section.slug)
    return (
        f"<h2 id='{anchor}'>{html.escape(section.title)}</h2><p>{html.escape(section.note)}</p>"
        f"<table><tr><th>claim</th><th>measured</th><th>verdict</th></tr>{rows}</table>"
        f"<p>{html.escape(conditions(section.result))}</p>{figures}"
    )


def cut_off(stopped: str) -> str:
    """That a page is not whole, and why."""
    return f"<p class='failed'>Not whole: {html.escape(stopped)}</p>" if stopped else ""


def conditions(result: Result) -> str:
    """What a run was made under, in a sentence."""
    s = result.scenario
    plant, inverter = s.plant, s.plant_inverter or s.inverter
    return (
        f"Conditions: {plant.get('mode', 'switching')} plant, {inverter.f_s / 1e3:g} kHz, dc link "
        f"{inverter.u_dc:g} V, dead time {1e6 * inverter.dead_time:g} µs, threshold {inverter.u_th:g} V, "
        f"A/D conversion {plant.get('adc_bits', 12)} bit with offset "
        f"{_offset(plant.get('current_offset', 0.0))}, no friction unless named; scheme {s.scheme} in "
        f"{s.arithmetic}, settings changed from their defaults: "
        f"{_changed(s.settings)}."
    )


def _offset(offset: Any) -> str:
    """An offset of the current sensors in words."""
    if isinstance(offset, complex):
        return f"{offset.real:.3g} A in α and {offset.imag:.3g} A in β"
    return f"{offset:.3g} A" if isinstance(offset, int | float) else ", ".join(f"{x:.3g} A" for x in offset)


def _changed(settings: Mapping[str, Any]) -> str:
    """Settings in words."""

    def text(value: Any) -> str:
        if isinstance(value, bool):
            return "on" if value else "off"
        if isinstance(value, tuple | list):
            return " to ".join(map(text, value))
        return f"{value:g}" if isinstance(value, int | float) else str(value)

    return ", ".join(f"{name.replace('_', ' ')} {text(value)}" for name, value in settings.items()) or "none"


def finite(value: Any) -> Any:
    """Infinite numbers become null: JSON has none."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
