"""Writes what `cargo bench` left in the target directory into the README.

Time and instructions a control period on this machine, and the speed of the simulation. What was not measured
stays as it stands there.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
#: Calls of a counted benchmark, as `benches/instructions.rs` has them.
CALLS = 1000
#: Names in `benches/src/lib.rs`, and in the README: those marked run in every eighth or sixteenth period.
BLOCKS = {
    "drive step": "drive step, published scheme",
    "drive step enhanced": "drive step, enhanced scheme",
    "flux estimator": "flux estimator",
    "filter": "filter",
    "balance": "balance",
    "speed": "speed",
    "resistance": "resistance*",
    "confidence": "confidence*",
    "speed control": "speed control*",
    "flux control": "flux control*",
    "current control": "current control",
    "inverter model": "inverter model",
    "modulator": "modulator",
}
#: Names of the counted drive steps.
STEPS = {"drive step": "recorded", "drive step enhanced": "enhanced"}
MISSING = "–"
#: Of the benchmark `simulation`, and its simulated seconds.
PLANTS = {
    "switching": "every switching edge, 1 nF at the legs' nodes",
    "hard edges": "every switching edge, without capacitance",
    "averaged": "average of each period",
}
SECONDS = 5
README = ROOT / "README.md"


def estimate(benchmark: str) -> float | None:
    """Mean time of criterion's last run, ns."""
    file = TARGET / "criterion" / benchmark / "new" / "estimates.json"
    return json.loads(file.read_text())["mean"]["point_estimate"] if file.exists() else None


def nanoseconds(block: str, arithmetic: str) -> str | None:
    """Of criterion's last run."""
    took = estimate(f"{block}_{arithmetic}" if block in STEPS else f"block/{block}/{arithmetic}")
    return f"{took:.0f}" if took else None


def instructions(block: str, arithmetic: str) -> str | None:
    """Of gungraun's last run."""
    group = TARGET / "gungraun" / "stillflux-benches" / "instructions" / "counting" / f"all_{arithmetic}"
    name = (
        f"drive_step_{arithmetic}.{STEPS[block]}"
        if block in STEPS
        else f"block_{arithmetic}.{block.replace(' ', '_')}"
    )
    found = [
        int(match[1])
        for file in (group / name).glob("callgrind.*.out")
        if (match := re.search(r"^totals: (\d+)", file.read_text(errors="replace"), re.MULTILINE))
    ]
    return f"{max(found) / CALLS:.0f}" if found else None


def standing(name: str) -> dict[str, list[str]]:
    """The cells of a table as they stand in the README, by the first of their row."""
    text = README.read_text(encoding="utf-8")
    (table,) = re.findall(rf"<!-- bench: {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    return {label: cells for label, *cells in rows}


def row(label: str, cells: list[str | None], known: dict[str, list[str]]) -> str:
    """A line of a table; a cell without a measurement keeps what is known."""
    old = known.get(label, [MISSING] * len(cells))
    return f"| {label} | {' | '.join(new or old[k] for k, new in enumerate(cells))} |"


def control() -> str:
    """Time and instructions of the control step and its blocks."""
    known = standing("control")
    lines = ["| | ns f32 | f64 | Q7.24 | instructions f32 | f64 | Q7.24 |", "|---|---|---|---|---|---|---|"]
    for block, label in BLOCKS.items():
        cells = [measure(block, a) for measure in (nanoseconds, instructions) for a in ("f32", "f64", "q")]
        lines.append(row(label, cells, known))
    return "\n".join(lines)


def simulation() -> str:
    """Simulated seconds per second of the drive with its plant, on one core."""
    known = standing("simulation")
    lines = ["| plant | f32 | f64 | Q7.24 |", "|---|---|---|---|"]
    for name, label in PLANTS.items():
        took = [estimate(f"simulation/{name}/{arithmetic}") for arithmetic in ("F32", "F64", "Q")]
        lines.append(row(label, [f"{1e9 * SECONDS / t:.0f}" if t else None for t in took], known))
    return "\n".join(lines)


def main() -> None:
    """Prints the tables, and writes them into the README."""
    text = README.read_text(encoding="utf-8")
    for name, table in (("control", control()), ("simulation", simulation())):
        print(table, end="\n\n")
        mark = re.compile(rf"(<!-- bench: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = mark.sub(lambda match, table=table: f"{match[1]}{table}\n{match[2]}", text)
    README.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
