"""Cycles of the control interrupt by a timing model of the Cortex-M4, from the instructions QEMU executes.

The model is the table of instruction times of the processor's reference manual (ARM DDI 0439, 3.3 and 7.2)
with these assumptions:

* memory without wait states, code and data on buses of their own: flash accelerators and wait states of a
  part come on top,
* a load takes two cycles, one directly behind another single load or store of an integer register; a store
  takes one (write buffer); those of the FPU take two; several words take one more than their number,
* a taken branch refills the pipeline in two cycles (the manual says one to three),
* the result of a floating-point operation that the next instruction consumes costs one cycle,
* an IT instruction takes a cycle (the processor may fold it), MLA and MLS take two,
* the exception's entry and return, and what other interrupts take, are not in it.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from . import toolchain
from .image import Image

ISR = "control_isr"
#: Cycles to refill the pipeline behind a taken branch.
REFILL = 2
_LINE = re.compile(r"^\s+([0-9a-f]+):\t(\S+)(?:\t(.*))?$")
#: Start of a block of instructions in QEMU's log, and an instruction of a block that it translates.
_TRACE = re.compile(r"^Trace [^/]*/([0-9a-f]+)/")
_FPU = re.compile(r"^v(add|sub|mul|nmul|mla|mls|nmla|nmls|div|abs|neg|cvt|sqrt|fma|fms)")


@dataclass(frozen=True)
class Cycles:
    """Of one interrupt: mean and worst over the periods, of the model and of instructions."""

    periods: int
    mean: float
    worst: int
    instructions_mean: float
    instructions_worst: int


def measure(elf: Path, frames: Path, periods: int, skip: int) -> Cycles:
    """Replays the first frames of a recording; the first `skip` periods (start-up) are not counted."""
    part = frames.with_suffix(".part")
    part.write_bytes(frames.read_bytes()[: 16 * periods])
    times: list[int] = []
    counts: list[int] = []
    length: dict[int, list[int]] = {}
    code = _instructions(elf)
    image = Image(elf)
    inside = {a for f in image.reachable(ISR) for a in range(f.address, f.address + f.size, 2)}
    entry = image.find(ISR).address
    time = count = 0
    active = False
    last: int | None = None
    for address in _blocks(elf, part, length):
        if last is not None:
            time += _block(code, last, length[last], address)
            count += len(length[last])
            last = None
        if address == entry:
            active, time, count = True, 0, 0
        elif active and address not in inside:
            active = False
            times.append(time)
            counts.append(count)
        if active:
            last = address
    times, counts = times[skip:], counts[skip:]
    n = len(times)
    return Cycles(n, sum(times) / n, max(times), sum(counts) / n, max(counts))


def _instructions(elf: Path) -> dict[int, tuple[str, str]]:
    """Address → operation and operands."""
    command = ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(elf)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = (_LINE.match(line) for line in text.splitlines())
    return {int(m[1], 16): (m[2], m[3] or "") for m in found if m}


def _blocks(elf: Path, frames: Path, length: dict[int, list[int]]) -> Iterator[int]:
    """Addresses of the blocks in the order in which they run; `length` gets the instructions of each."""
    config = f"enable=on,target=native,arg=fw,arg={frames.name},arg=cycles.back"
    command = ["qemu-system-arm", "-cpu", "cortex-m4", "-machine", "mps2-an386", "-nographic"]
    command += ["-monitor", "none", "-serial", "none", "-semihosting-config", config, "-kernel", str(elf)]
    command += ["-d", "in_asm,exec,nochain", "-D", "/dev/stderr"]
    with subprocess.Popen(
        command, cwd=toolchain.OUT, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, errors="replace",
    ) as process:  # fmt: skip
        assert process.stderr
        block: int | None = None
        for line in process.stderr:
            if trace := _TRACE.match(line):
                yield int(trace[1], 16)
            elif line.startswith("0x"):
                address = int(line[: line.index(":")], 16)
                block = address if block is None else block
                if address == block:
                    length[block] = []
                length[block].append(address)
            else:
                block = None


def _block(code: dict[int, tuple[str, str]], start: int, addresses: list[int], behind: int) -> int:
    """Cycles of a block that goes on at `behind`."""
    time, before = 0, ("", "")
    for address in addresses:
        op, operands = code.get(address, ("", ""))
        base = re.sub(r"\.[nw]$", "", op)
        time += _time(base, operands, before[0])
        result = before[1].split(",")[0].strip()
        if _FPU.match(before[0]) and result in re.findall(r"\bs\d+\b", _sources(base, operands)):
            time += 1
        before = (base, operands)
    size = addresses[-1] - start
    following = {start + size + 2, start + size + 4}
    return time + (REFILL if behind not in following else 0)


def _sources(op: str, operands: str) -> str:
    """Operands that an instruction reads."""
    first, _, rest = operands.partition(",")
    reads_first = op.startswith(("vcmp", "vstr", "vmla", "vmls", "vnmla", "vnmls"))
    return operands if reads_first else rest or first


def _time(op: str, operands: str, before: str) -> int:
    words = 1 if "{" not in operands else _words(operands)
    if op.startswith(("vdiv", "vsqrt")):
        return 14
    if op.startswith(("vmla", "vmls", "vnmla", "vnmls", "vfm", "vfnm")):
        return 3
    if op.startswith(("vldr", "vstr")):
        return 2
    if op.startswith(("push", "pop", "ldm", "stm", "vpush", "vpop", "vldm", "vstm")):
        return 1 + words
    if op.startswith(("ldrd", "strd")):
        return 3
    if op.startswith("ldr"):
        return 1 if re.match(r"(ldr|str)(?!d)", before) else 2
    if op in ("mla", "mls", "tbb", "tbh"):
        return 2
    if op in ("udiv", "sdiv"):
        return 12
    return 1


def _words(operands: str) -> int:
    inner = operands[operands.index("{") + 1 : operands.index("}")]
    count = 0
    for item in inner.split(","):
        ends = [int(n) for n in re.findall(r"\d+", item)]
        number = ends[1] - ends[0] + 1 if "-" in item and len(ends) == 2 else 1
        count += 2 * number if "d" in item else number
    return count
