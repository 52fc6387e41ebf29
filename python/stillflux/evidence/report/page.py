"""What pages share, and a self-contained page of runs and claims."""

from __future__ import annotations

import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillflux import plots
from stillflux.evidence.claims import Claim
from stillflux.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["HEAD", "STYLE", "Section", "conditions", "finite", "svg", "table", "write"]

HEAD = "<meta charset='utf-8'><meta name='viewport' content='width=device-width, initial-scale=1'>"
"""What every page says of its text and of small screens."""
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222 }
body { max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
table { border-collapse: collapse; margin: 1rem 0; display: block; overflow-x: auto }
td, th { padding: .25rem .8rem; border-bottom: 1px solid #ddd }
th { text-align: left } .ok { color: #176f2c } .failed { color: #b3261e; font-weight: 600 }
.limit { color: #8a5a00 } .control { color: #35516b } td { vertical-align: top } figure { margin: 1rem 0 }
svg { max-width: 100%; height: auto } code { background: #f3f3f3; padding: .1rem .3rem }
"""


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


def table(section: Section) -> str:
    """Claims as plain text, one a line."""
    claims = section.claims
    width = max(len(claim.text) for claim in claims)
    measured = max(len(claim.measured) for claim in claims)
    lines = [f"  {c.text:<{width}}  {c.measured:>{measured}}  {section.verdict(c)[0]}" for c in claims]
    return "\n".join([*lines, *([f"  {section.conclusion}"] if section.conclusion else [])])


def write(path: Path, title: str, command: str, sections: Sequence[Section]) -> None:
    """Writes the page, and beside it each figure as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    body = "\n".join(_section(section, path.parent) for section in sections)
    path.write_text(
        f"<!doctype html>\n<html lang='en'><head>{HEAD}<title>{html.escape(title)}</title>"
        f"<style>{STYLE}</style></head>\n<body><h1>{html.escape(title)}</h1>\n"
        f"<p>Made by <code>{html.escape(command)}</code>. Every figure in the tables is the plant's truth, "
        f"not the drive's opinion.</p>\n{body}\n</body></html>\n",
        encoding="utf-8",
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
    return (
        f"<h2>{html.escape(section.title)}</h2><p>{html.escape(section.note)}</p>"
        f"<table><tr><th>claim</th><th>measured</th><th></th></tr>{rows}</table>"
        f"<p>{html.escape(conditions(section.result))}</p>{figures}"
    )


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


def svg(figure: Figure) -> str:
    """A figure for inclusion in a page, without anything that varies from run to run."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def finite(value: Any) -> Any:
    """Infinite numbers become null: JSON has none."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
