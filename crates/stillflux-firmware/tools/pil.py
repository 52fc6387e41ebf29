"""Processor in the loop: a closed loop recorded on the host, replayed on the target, compared bit by bit."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from . import toolchain

FRAME, ANSWER = 16, 68
#: Words of an answer, as `src/exchange.rs` has them.
WORDS = [
    *("compare_a", "compare_b", "compare_c", "state", "psi_alpha", "psi_beta", "omega_m", "omega_s"),
    *("torque", "u_off_alpha", "u_off_beta", "r_s", "i_d_ref", "i_q_ref", "epsilon", "innovation"),
    "confidence",
]


@dataclass(frozen=True)
class Comparison:
    """Host against target."""

    periods: int
    #: First difference: period and word; `None`: every bit of every word is the same.
    first: tuple[int, str] | None
    different: int


def record(arithmetic: str, scheme: str = "enhanced", features: Sequence[str] = ()) -> tuple[Path, Path]:
    """Frames to the target and the host's answers, for an image of these features; beside them the telemetry.
    Files are replaced as a whole: another process may be reading those of its own recording."""
    toolchain.OUT.mkdir(parents=True, exist_ok=True)
    acting = [feature for feature in toolchain.ACTING if feature in toolchain.additions(features)]
    loop = scheme if len(acting) == len(toolchain.ACTING) else "-".join([scheme, toolchain.PLAIN, *acting])
    names = [f"{loop}-{arithmetic}.{kind}" for kind in ("frames", "answers", "telemetry")]
    parts = [f"{name}.{os.getpid()}" for name in names]
    toolchain.host_example("record_pil", arithmetic, scheme, *parts, features=features)
    for part, name in zip(parts, names, strict=True):
        (toolchain.OUT / part).replace(toolchain.OUT / name)
    return toolchain.OUT / names[0], toolchain.OUT / names[1]


def run(elf: Path, arithmetic: str, scheme: str = "enhanced", features: Sequence[str] = ()) -> Comparison:
    """Records, replays on `elf`, an image of these features, compares."""
    frames, answers = record(arithmetic, scheme, features)
    back = frames.with_suffix(".back")
    # Names, not paths: the emulator's argument list knows no commas.
    toolchain.emulate(elf, frames.name, back.name)
    return compare(answers.read_bytes(), back.read_bytes())


#: Features of an image of the commissioning whose page is that of the recording on the host: both have the
#: same schemes.
COMMISSION = [
    *("commission", "paper", "enhanced", "variants", "supervision"),
    *("dclink", "modes", "shunt", "encoder", "legs", "restart", "dither"),
]


def commission(elf: Path, arithmetic: str) -> tuple[Comparison, Path, bool]:
    """Records a commissioning, replays it on `elf`; the comparison, the page that the target made, and
    whether it is the host's."""
    toolchain.OUT.mkdir(parents=True, exist_ok=True)
    frames, answers, page = (f"commission-{arithmetic}.{kind}" for kind in ("frames", "answers", "page"))
    toolchain.host_example("record_commission", arithmetic, frames, answers, page)
    toolchain.emulate(elf, frames, f"{answers}.back", f"{page}.back")
    host, target, mine, back = (
        toolchain.OUT / name for name in (answers, f"{answers}.back", page, f"{page}.back")
    )
    words = ["compare_a", "compare_b", "compare_c", "state"]
    found = compare(host.read_bytes(), target.read_bytes(), words)
    return found, back, mine.read_bytes() == back.read_bytes()


def compare(host: bytes, target: bytes, words: Sequence[str] = WORDS) -> Comparison:
    """Word by word."""
    size = 4 * len(words)
    periods = len(host) // size
    if len(target) != len(host):
        return Comparison(periods, (len(target) // size, "missing"), abs(len(host) - len(target)) // 4)
    if host == target:
        return Comparison(periods, None, 0)
    different = [k for k in range(0, len(host), 4) if host[k : k + 4] != target[k : k + 4]]
    first = different[0]
    return Comparison(periods, (first // size, words[first % size // 4]), len(different))
