"""One table of what `cargo bench` and `make firmware-bench` left in the target directory, for the README.

Per control period: time on this machine, instructions on this machine, instructions on a Cortex-M4F.
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
    "flux estimator": "flux_estimator",
    "speed": "speed_estimator",
    "resistance": "resistance_adaptation",
    "confidence": "confidence",
    "speed control": "speed_control",
    "flux control": "flux_control",
    "current control": "current_control",
    "inverter model": "inverter_model",
    "modulator": "modulator",
    "drive step": "drive_step",
    "filter": "filter",
    "balance": "balance",
    "drive step enhanced": "drive_step_enhanced",
}
#: Names of the counted drive steps.
STEPS = {"drive step": "recorded", "drive step enhanced": "enhanced"}
MISSING = "–"


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


def main() -> None:
    """Prints the table."""
    report = ROOT / "target" / "firmware-bench.json"
    target = json.loads(report.read_text()) if report.exists() else {}
    print("| | ns f32 | f64 | Q | instructions f32 | f64 | Q | Cortex-M4F f32 | Q |")
    print("|---|---|---|---|---|---|---|---|---|")
    for block, key in BLOCKS.items():
        cells = [measure(block, a) for measure in (nanoseconds, instructions) for a in ("f32", "f64", "q")]
        for a in ("f32", "q"):
            b = target.get(key)
            cells.append(f"{b[a]:.0f} / {b[f'{a}_worst']}" if b else MISSING)
        print(f"| {block} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
