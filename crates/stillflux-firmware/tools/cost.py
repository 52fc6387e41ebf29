"""What the core costs on a Cortex-M4F, beside what it must compute and how exact it is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from . import cycles, pil, toolchain
from .image import Image

BLOCKS = (
    "flux_estimator",
    "speed_estimator",
    "resistance_adaptation",
    "confidence",
    "speed_control",
    "flux_control",
    "current_control",
    "inverter_model",
    "modulator",
    "drive_step",
    "interrupt",
)
#: Those of the enhanced scheme, and the periods of its filter's block.
ENHANCED = (
    "balance",
    "balance_fit",
    "filter",
    *(f"filter_{k}" for k in ("close", *range(1, 10))),
    "drive_step_enhanced",
    "interrupt_enhanced",
    "trace",
)
ARITHMETICS = ("f32", "q")
#: Schemes and the features of their images.
SCHEMES: dict[str, list[str]] = {"paper": ["paper", toolchain.PLAIN], "enhanced": [toolchain.PLAIN]}
#: Name of the step in the report.
STEPS = {"paper": "drive_step", "enhanced": "drive_step_enhanced"}
#: What a product may add to a scheme, by the features of its image: to the published one what both have
#: beyond the paper's drive, each and together, to the enhanced one that and more.
FEATURES: dict[str, tuple[tuple[str, ...], ...]] = {
    "paper": ((), *((name,) for name in toolchain.ADDITIONS), ("additions",)),
    "enhanced": (
        (),
        ("additions",),
        ("additions", "supervision"),
        ("additions", "supervision", "dclink"),
        ("additions", "legs"),
        ("additions", "restart"),
        ("additions", "modes"),
        ("additions", "shunt"),
        ("additions", "encoder"),
        ("additions", "dither"),
        ("additions", "supervision", "dclink", "legs", "restart"),
        ("additions", "supervision", "dclink", "legs", "restart", "dither"),
    ),
}
ISR = "control_isr"
#: What the design asks for, mean instructions: f32, q.
TARGETS = {"flux_estimator": (150, 250), "drive_step": (600, 1000)}
#: The enhanced step's worst case, relative to the published one's.
WORST_RATIO = 1.6
#: Bytes of an image with one scheme: label, and what the design asks for. Those of the enhanced scheme have
#: the same names with `_enhanced` behind them.
SIZES = {
    "flash_step": ("flash, control step", ""),
    "flash_library": ("  with start from page", "16384"),
    "flash_library_si": ("  with start from SI values", ""),
    "flash_image": ("flash, whole image", ""),
    "ram_drive": ("RAM, Drive", "1024"),
    "ram_config": ("  of it configuration", ""),
    "stack_step": ("stack, one step", "512"),
}
REPORT = toolchain.ROOT / "target" / "firmware-bench.json"


def measure(chain: toolchain.Toolchain, si: bool = True) -> dict[str, Any]:
    """All figures, as they go into the report; `si`: with the images that convert SI values themselves."""
    lines = []
    for scheme, features in SCHEMES.items():
        lines += [row for a in ARITHMETICS for row in count(chain, a, scheme, features)]
    operations = json.loads(toolchain.host_example("operations"))
    report: dict[str, Any] = {name: {} for name in (*BLOCKS, *ENHANCED)}
    for row in lines:
        if row.get("block") in report:
            block = report[row["block"]]
            block[row["arithmetic"]] = row["mean"]
            block[f"{row['arithmetic']}_worst"] = row["worst"]
    for name in (*BLOCKS, *ENHANCED):
        report[name]["operations"] = operations.get(name)
    for scheme, features in SCHEMES.items():
        for arithmetic in ARITHMETICS:
            of = [*features, *([] if arithmetic == "f32" else ["q"])]
            found = sizes(toolchain.build(chain, "drive", *of))
            if si:
                found["flash_library_si"] = _library(Image(toolchain.build(chain, "drive", *of, "si-page")))
            for key, size in found.items():
                report.setdefault(size_key(key, scheme), {})[arithmetic] = size
    report["accuracy"] = json.loads(toolchain.host_example("accuracy"))
    return report


def count(
    chain: toolchain.Toolchain,
    arithmetic: str,
    scheme: str,
    features: Sequence[str],
    target: str = toolchain.TARGET,
) -> list[dict[str, Any]]:
    """Rows of the image that counts, for one arithmetic, over a recorded closed loop of the scheme."""
    image = toolchain.build(chain, "cost", *features, target=target)
    frames = [pil.record(a, scheme, features)[0].name if a == arithmetic else "-" for a in ARITHMETICS]
    return [json.loads(line) for line in toolchain.count(image, *frames).splitlines()]


def measure_smallest() -> dict[str, Any] | None:
    """Instructions of the step on a Cortex-M0+ by scheme, mean and worst; `None` without a compiler."""
    chain = toolchain.compiler(toolchain.SMALLEST, "core,compiler_builtins")
    if chain is None:
        return None
    report = {}
    for scheme, features in SCHEMES.items():
        lines = count(chain, "q", scheme, features, target=toolchain.SMALLEST)
        rows = {row.get("block"): row for row in lines}
        step = rows[STEPS[scheme]]
        report[scheme] = {"mean": step["mean"], "worst": step["worst"]}
    return report


def measure_cycles(chain: toolchain.Toolchain) -> dict[str, Any]:
    """Cycles of the interrupt by the timing model, over 2000 periods under control."""
    report: dict[str, Any] = {}
    for scheme, features in SCHEMES.items():
        report[scheme] = {}
        for arithmetic in ARITHMETICS:
            elf = toolchain.build(chain, "drive", *features, *([] if arithmetic == "f32" else ["q"]))
            of = cycles.measure(elf, pil.record(arithmetic, scheme, features)[0], 19_000, 17_000)
            report[scheme][arithmetic] = {"mean": round(of.mean), "worst": of.worst}
    return report


def measure_features(chain: toolchain.Toolchain) -> dict[str, list[dict[str, Any]]]:
    """Step, sizes and stack of each scheme with what a product adds, in the order of `FEATURES`."""
    report: dict[str, list[dict[str, Any]]] = {scheme: [] for scheme in FEATURES}
    for scheme, chosen in ((s, c) for s, choices in FEATURES.items() for c in choices):
        of = [*(["paper"] if scheme == "paper" else []), *(chosen or [toolchain.PLAIN])]
        row: dict[str, Any] = {"features": chosen}
        rows = [row for a in ARITHMETICS for row in count(chain, a, scheme, of)]
        steps = [row for row in rows if row.get("block") == STEPS[scheme]]
        for step in steps:
            elf = toolchain.build(chain, "drive", *of, *([] if step["arithmetic"] == "f32" else ["q"]))
            row[step["arithmetic"]] = {"mean": step["mean"], "worst": step["worst"], **sizes(elf)}
        report[scheme].append(row)
    return report


def size_key(key: str, scheme: str) -> str:
    """Name of a size in the report."""
    return key if scheme == "paper" else f"{key}_{scheme}"


def sizes(elf: Path) -> dict[str, Any]:
    """Bytes of an image: code, RAM and stack."""
    image = Image(elf)
    idle = json.loads(toolchain.emulate(elf))
    return {
        "flash_step": sum(f.size for f in image.reachable(ISR)),
        "flash_library": _library(image),
        "flash_image": sum(f.size for f in image.functions.values()),
        "ram_drive": idle["drive_bytes"],
        "ram_config": idle["config_bytes"],
        "stack_step": image.stack(ISR),
    }


def _library(image: Image) -> int:
    """Code of the interrupt and of the start from the parameter page, in bytes."""
    return sum({f.address: f.size for root in (ISR, "drive::load") for f in image.reachable(root)}.values())


def table(report: dict[str, Any]) -> str:
    """The report for people."""
    out = [
        "Cortex-M4F, instructions a call over a recorded closed loop (worst ±4; not cycles: VDIV takes 14)",
        f"{'':25}{'arithmetic':>10}"
        f"{'f32 mean':>10}{'worst':>7}{'q mean':>10}{'worst':>7}{'target f32/q':>15}",
    ]
    for name in (*BLOCKS, *ENHANCED):
        b = report[name]
        target = "/".join(map(str, TARGETS[name])) if name in TARGETS else ""
        out.append(
            f"{name:25}{b['operations'] or '':>10}{b['f32']:>10.1f}{b['f32_worst']:>7}"
            f"{b['q']:>10.1f}{b['q_worst']:>7}{target:>15}"
        )
    for scheme in SCHEMES:
        out += ["", f"{f'bytes, {scheme} scheme':25}{'':>10}{'f32':>10}{'':>7}{'q':>10}{'':>7}{'target':>15}"]
        for name, (label, target) in SIZES.items():
            size = report[size_key(name, scheme)]
            out.append(f"{label:25}{'':>10}{size['f32']:>10}{'':>7}{size['q']:>10}{'':>7}{target:>15}")
    out += ["", f"{'60 s at zero frequency':25}{'f64':>10}{'f32':>10}{'':>7}{'q':>10}"]
    for key, label, form in (
        ("angle_rms_deg", "field angle, rms °", ".3f"),
        ("angle_worst_deg", "field angle, worst °", ".3f"),
        ("speed_rms_pu", "speed, rms p.u.", ".1e"),
    ):
        f64, f32, q = (format(report["accuracy"][a][key], form) for a in ("f64", "f32", "q"))
        out.append(f"{label:25}{f64:>10}{f32:>10}{'':>7}{q:>10}")
    return "\n".join(out)


def write(report: dict[str, Any]) -> None:
    """To `target/firmware-bench.json`."""
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(json.dumps(report, indent=2) + "\n")
