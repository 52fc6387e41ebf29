"""Finds what builds and runs the image here, or says what to install."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

CRATE = Path(__file__).resolve().parents[1]
ROOT = CRATE.parents[1]
TARGET = "thumbv7em-none-eabihf"
#: A Cortex-M0+: no FPU, no long multiplication. The emulated Cortex-M4 runs its instructions one for one.
SMALLEST = "thumbv6m-none-eabi"
#: Features of the core that an image has unless it is to be without them, by these names or by `PLAIN`.
ADDITIONS = ("ripple", "weakening", "ramp", "derating", "bridging")
PLAIN = "plain"
#: Those of them that act on a recorded loop.
ACTING = ("ripple", "weakening")
OUT = Path(os.environ.get("FIRMWARE_TARGET_DIR", ROOT / "target" / "firmware"))

HELP = f"""\
  rustup:         rustup target add {TARGET}
  Debian/Ubuntu:  apt-get install rustc-web cargo-web rust-web-src   (compiler with library source)
and for both:     apt-get install qemu-system-arm gcc-arm-none-eabi"""


class MissingError(RuntimeError):
    """Something has to be installed first; the message says what."""


@dataclass(frozen=True)
class Toolchain:
    """A cargo that builds for another target."""

    name: str
    env: dict[str, str] = field(default_factory=dict)
    #: Crates of the standard library that have to be built, too; empty: none.
    build_std: str = ""

    def cargo(self, *args: str, target: str, cwd: Path, out: Path = OUT) -> None:
        """Runs cargo, which builds in `out`; its output only where it fails."""
        command = ["cargo", *args, "--target", target]
        if self.build_std:
            command.append(f"-Zbuild-std={self.build_std}")
        env = {**os.environ, "CARGO_TARGET_DIR": str(out), **self.env}
        # No standard input: a compiler that is asked about a target reads it.
        none = subprocess.DEVNULL
        done = subprocess.run(
            command, cwd=cwd, env=env, stdin=none, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")


def find(target: str = TARGET) -> Toolchain:
    """The installed target if there is one, else a distribution's compiler with the library source."""
    absent = [
        tool
        for tool in ("qemu-system-arm", "arm-none-eabi-ld", "arm-none-eabi-objdump")
        if not shutil.which(tool)
    ]
    if absent:
        raise MissingError(f"{', '.join(absent)} not found. Install\n{HELP}")
    chain = compiler(target, "core,compiler_builtins")
    if chain is None:
        raise MissingError(f"no Rust compiler for {target}. Install one of\n{HELP}")
    return chain


def compiler(target: str, library: str) -> Toolchain | None:
    """A compiler for the target, one that builds these crates of the standard library itself if need be."""
    if shutil.which("rustup"):
        installed = subprocess.run(
            ["rustup", "target", "list", "--installed"], capture_output=True, text=True, check=False
        ).stdout.split()
        if target in installed:
            return Toolchain("rustup target")
    if Path("/usr/bin/rustc").exists() and Path("/usr/bin/cargo").exists():
        sysroot = subprocess.run(
            ["/usr/bin/rustc", "--print", "sysroot"], capture_output=True, text=True, check=True
        ).stdout.strip()
        if (Path(sysroot) / "lib/rustlib/src/rust/library/core").is_dir():
            env = {"RUSTC_BOOTSTRAP": "1", "PATH": f"/usr/bin:{os.environ['PATH']}"}
            # A rustc that some outer tool has set would be another compiler.
            return Toolchain("distribution compiler", {**env, "RUSTC": "/usr/bin/rustc"}, library)
    return None


def build(chain: Toolchain, name: str, *features: str, target: str = TARGET) -> Path:
    """Builds a bin of the firmware crate; the ELF file under a name of its own.

    The enhanced scheme is in it unless `paper` stands alone, and all `ADDITIONS` unless some of them are
    named, or `PLAIN`. Several processes may build at once: cargo puts a bin of any features in the same
    place, so that it has to be copied before the next build begins.
    """
    args = ["build", "--release", "--locked", "--bin", name]
    chosen = [feature for feature in features if feature != PLAIN]
    if ("paper" in features and "enhanced" not in features) or additions(features) != ADDITIONS:
        args.append("--no-default-features")
        chosen += [] if "paper" in features else ["enhanced"]
        chosen += ["additions"] if additions(features) == ADDITIONS and "additions" not in chosen else []
    if chosen:
        args += ["--features", ",".join(chosen)]
    kind = [] if target == TARGET else [target.partition("-")[0]]
    elf = OUT / ("-".join([name, *features, *kind]) + ".elf")
    part = elf.with_suffix(f".{os.getpid()}")
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / "build.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        chain.cargo(*args, target=target, cwd=CRATE)
        shutil.copy(OUT / target / "release" / name, part)
        part.replace(elf)
    return elf


def additions(features: Sequence[str]) -> tuple[str, ...]:
    """Those that an image of these features has."""
    if PLAIN not in features and not set(features) & set(ADDITIONS):
        return ADDITIONS
    return tuple(name for name in ADDITIONS if name in features or "additions" in features)


def emulate(elf: Path, *args: str, timeout: float = 900) -> str:
    """Runs an image under QEMU, arguments (names of files in `OUT`) on its command line; what it prints."""
    return _emulate(elf, args, [], timeout)


def count(elf: Path, *args: str, timeout: float = 900) -> str:
    """[`emulate`] with a clock that counts instructions.

    What is counted depends on the image and on the files that it reads alone: it is kept under their hash.
    """
    digest = hashlib.sha256(elf.read_bytes())
    for arg in args:
        file = OUT / arg
        digest.update(b"\0" + arg.encode() + b"\0")
        digest.update(hashlib.sha256(file.read_bytes()).digest() if file.is_file() else b"")
    kept = OUT / "counts" / digest.hexdigest()
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(f".{os.getpid()}")
        part.write_text(_emulate(elf, args, ["-icount", "shift=0"], timeout))
        part.replace(kept)
    return kept.read_text()


def _emulate(elf: Path, args: tuple[str, ...], options: list[str], timeout: float) -> str:
    config = ",".join(["enable=on", "target=native", "arg=fw", *(f"arg={a}" for a in args)])
    command = ["qemu-system-arm", "-cpu", "cortex-m4", "-machine", "mps2-an386", "-nographic"]
    command += ["-monitor", "none", "-serial", "none", "-semihosting-config", config, "-kernel", str(elf)]
    command += options
    done = subprocess.run(
        command,
        cwd=OUT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{elf.name} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def host_example(name: str, *args: str | Path, features: Sequence[str] = ()) -> str:
    """Builds and runs an example of the workspace on the host; what it prints. `cargo test` builds them. With
    those of the `ADDITIONS` of an image of these features that act on a recording."""
    command = ["cargo", "build", "--locked", "--example", name]
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    OUT.mkdir(parents=True, exist_ok=True)
    acting = [feature for feature in ACTING if feature in additions(features)]
    if len(acting) < len(ACTING):
        # In a place of its own: it must not be taken for that of the workspace.
        target = OUT / "-".join(["host", *acting])
        command += ["-p", "stillflux-sim", "--no-default-features", "--features", ",".join(acting)]
    env = {**os.environ, "CARGO_TARGET_DIR": str(target)}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=env)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stderr}")
    binary = target / "debug" / "examples" / name
    return subprocess.run(
        [str(binary), *map(str, args)], cwd=OUT, stdout=subprocess.PIPE, text=True, check=True
    ).stdout
