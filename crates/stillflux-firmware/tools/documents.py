"""Writes what was measured on the target into README and `docs/firmware.md`, between markers: it is typed
nowhere.

<!-- target: NAME -->
(one of `TABLES`)
<!-- end -->
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from . import cost, toolchain

DOCUMENTS = tuple(toolchain.ROOT / name for name in ("README.md", "docs/firmware.md"))
_TABLE = re.compile(r"(<!-- target: (?P<name>[^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
#: Names in the README; those marked run in every eighth or sixteenth period.
_BLOCKS = {
    "drive_step": "drive step, published scheme",
    "drive_step_enhanced": "drive step, enhanced scheme",
    "flux_estimator": "flux estimator",
    "filter": "filter",
    "balance": "balance",
    "speed_estimator": "speed",
    "resistance_adaptation": "resistance*",
    "confidence": "confidence*",
    "speed_control": "speed control*",
    "flux_control": "flux control*",
    "current_control": "current control",
    "inverter_model": "inverter model",
    "modulator": "modulator",
}
_LABELS = {
    "flash_step": "flash: control step with everything it reaches",
    "flash_library": "flash: with the start from a page that is ready",
    "flash_library_si": "flash: with the start from SI values",
    "ram_drive": "RAM of `Drive`",
    "ram_config": "of it configuration",
    "stack_step": "stack of one step",
}


def update(report: Mapping[str, Any]) -> None:
    """Brings the documents up to date."""
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        document.write_text(rendered(text, report), encoding="utf-8")


def rendered(text: str, report: Mapping[str, Any]) -> str:
    """The document with everything between its markers made anew."""
    return _TABLE.sub(lambda match: f"{match[1]}{TABLES[match['name']](report)}\n{match[3]}", text)


def blocks(report: Mapping[str, Any]) -> str:
    """Mean and worst case of the step and of its blocks."""
    rows = [["", "f32", "Q7.24"], ["---"] * 3]
    for name, label in _BLOCKS.items():
        rows.append([label, *_counts(report[name])])
    return _lines(rows)


def instructions(report: Mapping[str, Any]) -> str:
    """Mean and worst case of the step and of what the enhanced scheme adds; cycles by the timing model."""
    rows = [["", "f32", "Q", "Q on a Cortex-M0+"], ["---"] * 4]
    for name, block, scheme in (
        ("drive step, published scheme", "drive_step", "paper"),
        ("drive step, enhanced scheme", "drive_step_enhanced", "enhanced"),
        ("its filter: prediction every period, and the period's part of the block", "filter", None),
        ("its balance of the current sensors", "balance", None),
        ("inverter model", "inverter_model", None),
    ):
        cells = _counts(report[block])
        smallest = (report.get("smallest") or {}).get(scheme)
        rows.append([name, *cells, f"{smallest['mean']:.0f} / {smallest['worst']}" if smallest else ""])
    for scheme, name in (("paper", "published"), ("enhanced", "enhanced")):
        if of := (report.get("cycles") or {}).get(scheme):
            cells = [f"{of[a]['mean']} / {of[a]['worst']}" for a in cost.ARITHMETICS]
            rows.append([f"cycles of the whole interrupt by the timing model, {name} scheme", *cells, ""])
    return _lines(rows)


def sizes(report: Mapping[str, Any]) -> str:
    """Bytes of an image with one scheme, as far as measured; what exceeds the budget is bold."""
    rows = [["", "published f32", "Q", "enhanced f32", "Q", "budget"], ["---"] * 6]
    for key, label in _LABELS.items():
        if cost.size_key(key, "paper") not in report:
            continue
        budget = cost.SIZES[key][1]
        measured = [report[cost.size_key(key, s)][a] for s in cost.SCHEMES for a in cost.ARITHMETICS]
        cells = [f"**{n:,}**" if budget and n > int(budget) else f"{n:,}" for n in measured]
        rows.append([label, *cells, f"{int(budget):,}" if budget else ""])
    return _lines(rows)


def features(report: Mapping[str, Any], scheme: str = "enhanced") -> str:
    """What the features of a product take beside a scheme; what exceeds a budget is bold."""
    budgets = {key: int(cost.SIZES[key][1]) for key in ("flash_library", "ram_drive", "stack_step")}
    name = {"paper": "published"}.get(scheme, scheme)
    rows = [[f"features of the {name} scheme", "step, mean / worst", "flash", "RAM of `Drive`", "stack"]]
    rows[0] += [f"{title}, Q" for title in ("step", "flash", "RAM", "stack")]
    rows.append(["---"] * len(rows[0]))
    for row in (report.get("features") or {}).get(scheme, ()):
        cells = [", ".join(f"`{name}`" for name in row["features"]) or "none"]
        for arithmetic in cost.ARITHMETICS:
            of = row[arithmetic]
            cells.append(f"{of['mean']:.0f} / {of['worst']}")
            for key in ("flash_library", "ram_drive", "stack_step"):
                n = of[key]
                cells.append(f"**{n:,}**" if n > budgets.get(key, n) else f"{n:,}")
        rows.append(cells)
    return _lines(rows)


def additions(report: Mapping[str, Any]) -> str:
    """The same of the published scheme: what it takes that an image has more than the paper's drive."""
    return features(report, "paper")


def _counts(of: Mapping[str, Any]) -> list[str]:
    return [f"{of[a]:.0f} / {of[f'{a}_worst']}" for a in cost.ARITHMETICS]


def _lines(rows: list[list[str]]) -> str:
    return "\n".join(f"|{'|'.join(row)}|" if row[0] == "---" else f"| {' | '.join(row)} |" for row in rows)


#: Tables by the names of their markers.
TABLES = {
    "blocks": blocks,
    "instructions": instructions,
    "sizes": sizes,
    "additions": additions,
    "features": features,
}
