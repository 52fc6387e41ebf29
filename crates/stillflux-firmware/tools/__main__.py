"""`python3 -m tools run|bench|cycles` in the firmware crate: `make firmware`, `firmware-bench`, cycles."""

from __future__ import annotations

import sys

from . import cost, cycles, documents, pil, toolchain


def run(chain: toolchain.Toolchain) -> int:
    """Builds both images, starts them, and compares a closed loop with the host."""
    failed = 0
    for arithmetic in cost.ARITHMETICS:
        elf = toolchain.build(chain, "drive", *([] if arithmetic == "f32" else ["q"]))
        print(toolchain.emulate(elf).strip())
        result = pil.run(elf, arithmetic)
        if result.first:
            failed += 1
            print(f"  {result.periods} periods: {result.different} words differ, first {result.first}")
        else:
            print(f"  {result.periods} periods of a closed loop: every bit as on the host")
    return failed


def bench(chain: toolchain.Toolchain) -> int:
    """Measures, reports, and brings the tables in the documents up to date."""
    report = cost.measure(chain)
    report["smallest"] = cost.measure_smallest()
    report["cycles"] = cost.measure_cycles(chain)
    report["features"] = cost.measure_features(chain)
    cost.write(report)
    print(cost.table(report))
    documents.update(report)
    return 0


def time(chain: toolchain.Toolchain) -> int:
    """Cycles of the control interrupt by the timing model of the Cortex-M4."""
    print(cycles.__doc__)
    for scheme, arithmetics in cost.measure_cycles(chain).items():
        for arithmetic, of in arithmetics.items():
            print(f"{scheme:10}{arithmetic:5}{of['mean']:8} cycles a period, worst {of['worst']:5}")
    return 0


def main() -> int:
    """Runs one of the commands."""
    commands = {"run": run, "bench": bench, "cycles": time}
    if len(sys.argv) != 2 or sys.argv[1] not in commands:
        print("usage: python3 -m tools run|bench|cycles", file=sys.stderr)
        return 2
    try:
        chain = toolchain.find()
        print(f"building with {chain.name}", file=sys.stderr)
        return commands[sys.argv[1]](chain)
    except (toolchain.MissingError, RuntimeError) as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
