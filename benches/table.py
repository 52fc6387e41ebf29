"""Writes what `cargo bench` and `make firmware-bench` left in the target directory into the README.

Per control period: time on this machine, instructions on this machine, instructions on a Cortex-M4F; and the
speed of the simulation.
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
#: Name in `benches/src/lib.rs`, and in the report of the firmware.
BLOCKS = {
    "drive step": "drive_step",
    "drive step enhanced": "drive_step_enhanced",
    "flux estimator": "flux_estimator",
    "filter": "filter",
    "balance": "balance",
    "speed": "speed_estimator",
    "resistance": "resistance_adaptation",
    "confidence": "confidence",
    "speed control": "speed_control",
    "flux control": "flux_control",
    "current control": "current_control",
    "inverter model": "inverter_model",
    "modulator": "modulator",
}
#: Names of the counted drive steps.
STEPS = {"drive step": "recorded", "drive step enhanced": "enhanced"}
MISSING = "–"
#: Names in the README, where they differ: those marked run in every sixteenth period.
LABELS = {
    "drive step": "drive step, published scheme",
    "drive step enhanced": "drive step, enhanced scheme",
    **{name: f"{name}*" for name in ("resistance", "confidence", "speed control", "flux control")},
}
#: Of the benchmark `simulation`, and its simulated seconds.
PLANTS = {
    "switching": "every switching edge, 1 nF at the legs' nodes",
    "hard edges": "every switching edge, without capacitance",
    "averaged": "average of each period",
}
SECONDS = 5
README = ROOT / "README.md"


def nanoseconds(block: str, arithmetic: str) -> str:
    """Mean time of criterion's last run."""
    folder = f"{block}_{arithmetic}" if block in STEPS else f"block/{block}/{arithmetic}"
    file = TARGET / "criterion" / folder / "new" / "estimates.json"
    if not file.exists():
        return MISSING
    return f"{json.loads(file.read_text())['mean']['point_estimate']:.0f}"


def instructions(block: str, arithmetic: str) -> str:
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
    return f"{max(found) / CALLS:.0f}" if found else MISSING


def of_target(text: str) -> dict[str, list[str]]:
    """The columns of the Cortex-M4F as they stand in a README, by block: without a report they are kept."""
    (table,) = re.findall(r"<!-- bench: control -->\n(.*?)<!-- end -->", text, re.DOTALL)
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    return {row[0]: row[-2:] for row in rows}


def control() -> str:
    """Time and instructions of the control step and its blocks."""
    report = ROOT / "target" / "firmware-bench.json"
    target = json.loads(report.read_text()) if report.exists() else {}
    known = {} if target else of_target(README.read_text(encoding="utf-8"))
    lines = [
        "| | ns f32 | f64 | Q7.24 | instructions f32 | f64 | Q7.24 | Cortex-M4F f32 | Q7.24 |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for block, key in BLOCKS.items():
        cells = [measure(block, a) for measure in (nanoseconds, instructions) for a in ("f32", "f64", "q")]
        label = LABELS.get(block, block)
        if b := target.get(key):
            cells += [f"{b[a]:.0f} / {b[f'{a}_worst']}" for a in ("f32", "q")]
        else:
            cells += known.get(label, [MISSING, MISSING])
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def simulation() -> str:
    """Simulated seconds per second of the drive with its plant, on one core."""
    lines = ["| plant | f32 | f64 | Q7.24 |", "|---|---|---|---|"]
    for name, label in PLANTS.items():
        cells = []
        for arithmetic in ("F32", "F64", "Q"):
            file = TARGET / "criterion" / "simulation" / name / arithmetic / "new" / "estimates.json"
            if file.exists():
                took = json.loads(file.read_text())["mean"]["point_estimate"]
                cells.append(f"{1e9 * SECONDS / took:.0f}")
            else:
                cells.append(MISSING)
        lines.append(f"| {label} | {' | '.join(cells)} |")
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
