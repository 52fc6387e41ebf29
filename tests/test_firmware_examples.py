"""Firmware for a real part (`examples/firmware`): compiles, fits its memory, cannot fail in its interrupt."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples" / "firmware"
sys.path.insert(0, str(ROOT / "crates" / "stillflux-firmware"))
toolchain: Any = importlib.import_module("tools.toolchain")
image: Any = importlib.import_module("tools.image")

pytestmark = pytest.mark.builds

#: The control interrupt of an STM32G4's first two converters.
ISR = "ADC1_2"
#: Flash for code and constants, and RAM, of an STM32G431 (`memory.x`), bytes.
FLASH, RAM = 124 * 1024, 32 * 1024


@pytest.fixture(scope="module")
def chain() -> Any:
    try:
        return toolchain.find()
    except toolchain.MissingError as missing:
        pytest.skip(str(missing))


def build(chain: Any, package: str) -> Path:
    """The image of a framework."""
    chain.cargo("build", "--release", "--locked", "-p", package, target=toolchain.TARGET, cwd=EXAMPLES)
    elf: Path = toolchain.OUT / toolchain.TARGET / "release" / package
    return elf


@pytest.mark.parametrize(
    "package",
    [
        "bare",
        pytest.param("rtic-drive", marks=pytest.mark.slow),
        pytest.param("embassy-drive", marks=pytest.mark.slow),
    ],
)
def test_an_image_fits_its_part_and_its_interrupt_cannot_fail(chain: Any, package: str) -> None:
    elf = build(chain, package)
    listing = image.Image(elf)
    assert listing.violations(ISR) == {}
    # The whole step is in it: were nothing able to set a speed, the compiler would leave most of it out.
    names = " ".join(f.name for f in listing.reachable(ISR))
    assert "estimate::kalman::" in names
    assert "supervision::" in names
    sections = _sections(elf)
    assert sections[".text"][0] + sections[".rodata"][0] + sections[".data"][0] < FLASH
    assert sections[".data"][0] + sections[".bss"][0] + listing.stack(ISR) < RAM
    # The first slot of the parameters, where the program looks for it.
    size, at = sections[".parameters"]
    assert (size, at) == (8 + 1536, 0x0801F000)
    page = subprocess.run(
        ["arm-none-eabi-objcopy", "-O", "binary", "-j", ".parameters", str(elf), "/dev/stdout"],
        capture_output=True,
        check=True,
    ).stdout
    assert page.startswith(b"sfr3")


def _sections(elf: Path) -> dict[str, tuple[int, int]]:
    """Size and address of each section."""
    done = subprocess.run(["arm-none-eabi-size", "-A", str(elf)], capture_output=True, text=True, check=True)
    rows = (line.split() for line in done.stdout.splitlines())
    return {row[0]: (int(row[1]), int(row[2])) for row in rows if len(row) == 3 and row[0].startswith(".")}


@pytest.mark.slow
def test_registers_of_the_board_are_those_of_the_reference_manual() -> None:
    """On the host: bits of the registers, dead times."""
    command = ["cargo", "test", "--quiet", "--locked", "-p", "board"]
    env = {**os.environ, "CARGO_TARGET_DIR": str(toolchain.OUT / "host")}
    done = subprocess.run(command, cwd=EXAMPLES, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout
