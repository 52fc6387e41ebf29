"""The drive in C: header and library build, and compute what the drive computes in Rust, bit by bit.

On the host, and on a Cortex-M4F under QEMU, where the interrupt in C costs hardly more than in Rust.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
CRATE = ROOT / "crates" / "stillflux-c"
EXAMPLES = CRATE / "examples"
sys.path.insert(0, str(ROOT / "crates" / "stillflux-firmware"))
toolchain: Any = importlib.import_module("tools.toolchain")
pil: Any = importlib.import_module("tools.pil")
image: Any = importlib.import_module("tools.image")
cost: Any = importlib.import_module("tools.cost")

pytestmark = pytest.mark.builds

WARNINGS = [
    *("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wstrict-prototypes"),
    *("-Wmissing-prototypes", "-Werror"),
]
#: Features of the library by arithmetic, as the images in Rust have them.
FEATURES: dict[str, list[str]] = {
    "f32": ["--no-default-features", "--features", "enhanced,additions"],
    "q": ["--no-default-features", "--features", "enhanced,additions,q"],
}
#: The functions of the header.
FUNCTIONS = {
    *(
        "stillflux_open",
        "stillflux_period",
        "stillflux_period_at",
        "stillflux_counts_from_raw",
        "stillflux_status",
        "stillflux_fault",
    ),
    *("stillflux_fault_text", "stillflux_reset", "stillflux_timer_full", "stillflux_telemetry_read"),
    *("stillflux_store", "stillflux_defaults", "stillflux_memory_of", "stillflux_page"),
    *("stillflux_pulses_read", "stillflux_encoder_set", "stillflux_encoder_read", "stillflux_chopper"),
}


@pytest.fixture(scope="module", params=["gcc", "clang"])
def compiler(request: pytest.FixtureRequest) -> str:
    if not shutil.which(request.param):
        pytest.skip(f"{request.param} not found")
    return str(request.param)


@pytest.fixture(scope="module", params=["f32", pytest.param("q", marks=pytest.mark.slow)])
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """Arithmetic, and the folder of its library and header for the host."""
    to = tmp_path_factory.mktemp(request.param)
    features = " ".join(FEATURES[request.param])
    subprocess.run(["make", "-s", "c", f"C_TO={to}", f"C_FEATURES={features}"], cwd=ROOT, check=True)
    return request.param, to


def test_header_and_library_have_the_same_features() -> None:
    """The header knows the size of the state, which depends on them."""
    manifests = [CRATE / "Cargo.toml", CRATE / "header" / "Cargo.toml"]
    library, header = (tomllib.loads(m.read_text(encoding="utf-8"))["features"] for m in manifests)
    renamed = {name: [on.replace("drive/", "stillflux/") for on in ons] for name, ons in library.items()}
    assert renamed == header


def test_the_state_is_aligned_where_a_compiler_aligns_long_words_to_four_bytes(
    compiler: str, library: tuple[str, Path]
) -> None:
    """i386: there the library expects more than the union of the header would give it by itself."""
    _, folder = library
    source = folder / "aligned.c"
    source.write_text(
        '#include "stillflux.h"\n'
        "struct with { char c; stillflux_drive drive; };\n"
        "typedef char placed[offsetof(struct with, drive) == 8 ? 1 : -1];\n"
        "typedef char padded[sizeof(stillflux_drive) % 8 == 0 ? 1 : -1];\n"
    )
    for word in ("-m32", "-m64"):
        command = [compiler, word, *WARNINGS, "-Wpedantic", "-ffreestanding", "-fsyntax-only", f"-I{folder}"]
        done = subprocess.run([*command, str(source)], capture_output=True, text=True, check=False)
        if f"unrecognized command-line option '{word}'" in done.stderr:
            continue  # Not an x86.
        assert done.returncode == 0, done.stderr


def compile_host(compiler: str, library: Path, to: Path, *sources: str) -> None:
    command = [compiler, *WARNINGS, "-Wpedantic", "-O2", f"-I{library}"]
    command += [*(str(EXAMPLES / s) for s in sources), str(library / "libstillflux.a"), "-o", str(to)]
    subprocess.run(command, check=True)


def test_the_loop_in_c_is_that_in_rust_bit_by_bit(compiler: str, library: tuple[str, Path]) -> None:
    arithmetic, folder = library
    program = folder / f"drive-{compiler}"
    compile_host(compiler, folder, program, "drive.c", "board_host.c")
    frames = pil.record(arithmetic)[0]
    recorded = [write_page(compiler, folder), frames, frames.with_suffix(".telemetry")]
    done = subprocess.run([str(program), *map(str, recorded)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "periods 142000\nwords different 0\n" in done.stdout
    # The comparison notices one bit.
    torn = folder / "torn.telemetry"
    content = bytearray(recorded[2].read_bytes())
    content[len(content) // 2] ^= 1
    torn.write_bytes(content)
    command = [str(program), *map(str, recorded[:2]), str(torn)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "words different 1\n" in done.stdout


def write_page(compiler: str, folder: Path) -> Path:
    """Runs the example that writes a parameter page; it checks beside that what is bad is refused."""
    program, page = folder / f"page-{compiler}", folder / "drive.page"
    compile_host(compiler, folder, program, "page.c")
    done = subprocess.run([str(program), str(page)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return page


def test_a_page_from_c_is_that_in_the_image_from_rust(compiler: str, library: tuple[str, Path]) -> None:
    arithmetic, folder = library
    page = write_page(compiler, folder).read_bytes()
    assert len(page) == 1536
    try:
        chain = toolchain.find()
    except toolchain.MissingError as missing:
        pytest.skip(str(missing))
    elf = toolchain.build(chain, "drive", *([] if arithmetic == "f32" else ["q"]))
    assert page in elf.read_bytes()


def test_the_header_declares_every_function_with_a_comment(library: tuple[str, Path]) -> None:
    lines = (library[1] / "stillflux.h").read_text().splitlines()
    found = set()
    for k, line in enumerate(lines):
        for name in FUNCTIONS:
            if f" {name}(" in line and not line.startswith(("//", " *")):
                found.add(name)
                # The comment may stand above the line with the type.
                assert any(above.startswith("//") for above in lines[max(0, k - 2) : k]), name
    assert found == FUNCTIONS


def test_the_target_computes_every_bit_in_c_at_the_cost_of_rust(
    library: tuple[str, Path],
) -> None:
    arithmetic, folder = library
    try:
        chain = toolchain.find()
    except toolchain.MissingError as missing:
        pytest.skip(str(missing))
    for tool in ("gcc", "arm-none-eabi-gcc"):
        if not shutil.which(tool):
            pytest.skip(f"{tool} not found")
    elf = _image(chain, folder, arithmetic)
    page = toolchain.OUT / f"c-{arithmetic}.page"
    shutil.copy(write_page("gcc", folder), page)
    frames = pil.record(arithmetic)[0]
    names = [page.name, frames.name, frames.with_suffix(".telemetry").name]
    lines = toolchain.count(elf, *names).splitlines()
    assert lines[:2] == ["periods 142000", "words different 0"]
    in_c = int(lines[2].split()[-1]) / 100
    # The interrupt's content in Rust over the same recording.
    (in_rust,) = (
        row["mean"]
        for row in cost.count(chain, arithmetic, "enhanced", [])
        if row.get("block") == "interrupt_enhanced"
    )
    print(f"{arithmetic}: {in_c} instructions a period in C, {in_rust} in Rust")
    # Its pointers, the check of an open drive and the set point, without an empty call.
    assert in_c <= 1.02 * in_rust
    # What a call from C can reach cannot panic, allocate, or leave the FPU, as in Rust.
    assert image.Image(elf).violations("stillflux_period") == {}


def _image(chain: Any, folder: Path, arithmetic: str) -> Path:
    """The example on the target, without a C library; the header is that of the host."""
    chain.cargo("build", "--release", "--locked", *FEATURES[arithmetic], target=toolchain.TARGET, cwd=CRATE)
    library = toolchain.OUT / toolchain.TARGET / "release" / "libstillflux.a"
    elf: Path = toolchain.OUT / f"c-{arithmetic}.elf"
    machine = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
    command = ["arm-none-eabi-gcc", *WARNINGS, *machine, "-O2", "-ffreestanding", "-nostdlib", f"-I{folder}"]
    command += [str(EXAMPLES / name) for name in ("drive.c", "board_mps2.c")]
    command += [
        str(library),
        "-lgcc",
        f"-T{EXAMPLES / 'mps2.ld'}",
        "-Wl,--gc-sections,-z,noexecstack",
        "-o",
        str(elf),
    ]
    subprocess.run(command, check=True)
    return elf
