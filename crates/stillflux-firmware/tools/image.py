"""What the disassembly of an image proves about a function and everything it can reach."""

from __future__ import annotations

import bisect
import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

_HEAD = re.compile(r"^([0-9a-f]+) <(.*)>:$")
_LINE = re.compile(r"^\s+([0-9a-f]+):\t(\S+)(?:\t(.*))?$")
#: Condition of an instruction in an IT block.
_IF = "(eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"
_BRANCH = re.compile(rf"^(blx?{_IF}|b{_IF}|cbn?z)(\.[nw])?$")
_CALL = re.compile(rf"^blx?{_IF}(\.[nw])?$")
_TO_REGISTER = re.compile(rf"^bl?x{_IF}$")
_ADDRESS = re.compile(r"(?:^|, )([0-9a-f]+) <")

#: What a name tells of a function that must not be reached.
FORBIDDEN = {
    "panic": re.compile(r"core::panicking|panic_|slice_index|unwrap_failed|expect_failed|rust_begin_unwind"),
    "allocation": re.compile(r"__rust_(alloc|dealloc|realloc)|__rg_|\balloc::|\bmalloc\b"),
    "double": re.compile(r"__aeabi_(d\w+|c?dcmp\w*|f2d|u?i2d|u?l2d)\b|__\w*df\w*\b"),
    "soft float": re.compile(
        r"__aeabi_(f(?!2d)\w+|cfcmp\w*|u?i2f|u?l2f|h2f)\b|__(add|sub|mul|div|fix|float)\w*(sf|si|di)\w*\b"
        r"|compiler_builtins::float"
    ),
    "64-bit division": re.compile(r"__aeabi_u?ldivmod|__u?divmod(di|si)|__u?(div|mod)di3|div_rem"),
}


@dataclass
class Function:
    """A function of the image."""

    name: str
    address: int
    size: int = 0
    stack: int = 0
    calls: set[int] = field(default_factory=set)
    #: Instructions whose effect on control flow or stack the disassembly does not show.
    opaque: list[str] = field(default_factory=list)


class Image:
    """The functions of an ELF file."""

    def __init__(self, elf: Path) -> None:
        text = subprocess.run(
            ["arm-none-eabi-objdump", "-d", "-C", "--no-show-raw-insn", str(elf)],
            capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        self.functions: dict[int, Function] = {}
        jumps: list[tuple[Function, int, bool]] = []
        current: Function | None = None
        for line in text.splitlines():
            if head := _HEAD.match(line):
                current = Function(head[2], int(head[1], 16))
                self.functions[current.address] = current
            elif current and (match := _LINE.match(line)):
                address, op, operands = int(match[1], 16), match[2], match[3] or ""
                current.size = address + 4 - current.address
                _note(current, op, operands, jumps)
        self._starts = sorted(self.functions)
        for function, to, call in jumps:
            if (start := self._start(to)) is not None and (call or start != function.address):
                function.calls.add(start)

    def _start(self, address: int) -> int | None:
        k = bisect.bisect_right(self._starts, address)
        return self._starts[k - 1] if k else None

    def find(self, name: str) -> Function:
        """The function of this name."""
        for function in self.functions.values():
            if function.name == name:
                return function
        raise KeyError(name)

    def reachable(self, root: str) -> list[Function]:
        """`root` and everything it can call, directly or through others."""
        seen, todo = set[int](), [self.find(root).address]
        while todo:
            address = todo.pop()
            if address not in seen:
                seen.add(address)
                todo.extend(self.functions[address].calls)
        return [self.functions[a] for a in sorted(seen)]

    def stack(self, root: str) -> int | None:
        """Bytes of stack on the deepest path from `root`; `None`: unbounded."""
        depth: dict[int, int] = {}
        path: set[int] = set()

        def visit(address: int) -> int | None:
            if address in path:
                return None
            if address not in depth:
                path.add(address)
                function = self.functions[address]
                below = [visit(c) for c in function.calls]
                path.discard(address)
                if None in below:
                    return None
                depth[address] = function.stack + max((d for d in below if d is not None), default=0)
            return depth[address]

        return visit(self.find(root).address)

    def violations(self, root: str) -> dict[str, list[str]]:
        """What `root` can reach that it must not."""
        found: dict[str, list[str]] = {}
        for function in self.reachable(root):
            for kind, pattern in FORBIDDEN.items():
                if pattern.search(function.name):
                    found.setdefault(kind, []).append(function.name)
            if function.opaque:
                found.setdefault("indirect", []).append(f"{function.name}: {function.opaque[0]}")
        if self.stack(root) is None:
            found["unbounded stack"] = [root]
        return found


def _note(function: Function, op: str, operands: str, jumps: list[tuple[Function, int, bool]]) -> None:
    """Books a line's calls and its use of the stack."""
    if _TO_REGISTER.match(op) and not re.match(r"[0-9a-f]+ <", operands):
        if operands != "lr":
            function.opaque.append(f"{op} {operands}")
    elif _BRANCH.match(op) and (to := _ADDRESS.search(operands)):
        jumps.append((function, int(to[1], 16), bool(_CALL.match(op))))
    elif op in ("tbb", "tbh"):
        pass  # A jump table stays within its function.
    elif op.startswith("push") or (op.startswith("stmdb") and operands.startswith("sp!")):
        function.stack += 4 * _registers(operands)
    elif op.startswith("vpush"):
        function.stack += (8 if "{d" in operands else 4) * _registers(operands)
    elif re.match(r"sub(w|\.w|s)?$", op) and operands.startswith("sp,"):
        immediate = re.search(r"#(\d+)", operands)
        if immediate:
            function.stack += int(immediate[1])
        else:
            function.opaque.append(f"{op} {operands}")
    elif match := re.search(r"\[sp, #-(\d+)\]!", operands):
        function.stack += int(match[1])


def _registers(operands: str) -> int:
    """Number of registers in a list such as `{r4, r5, d8-d15}`."""
    inner = operands[operands.index("{") + 1 : operands.index("}")]
    count = 0
    for item in inner.split(","):
        ends = [int(n) for n in re.findall(r"\d+", item)]
        count += ends[1] - ends[0] + 1 if "-" in item and len(ends) == 2 else 1
    return count
