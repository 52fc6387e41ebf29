"""The package's metadata agree with each other; a missing optional package is named."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux import frames
from stillflux.cli import main
from stillflux.logs import read

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]


def test_one_version_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["version"]
    assert sf.__version__ == cargo
    assert f"version: {cargo}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {cargo}\n" in (ROOT / "CHANGELOG.md").read_text()
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"stillflux {cargo}\n"


def test_the_lock_has_every_package_that_the_project_names() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    # Ray is large, and has no build for every Python.
    wanted = [*project["dependencies"], *(r for name, rs in extras.items() if name != "ray" for r in rs)]
    names = {re.split(r"[<>=;\[ ]", requirement)[0].replace("-", "_") for requirement in wanted} - {
        "stillflux"
    }
    locked = {
        line.split("==")[0].replace("-", "_")
        for line in (ROOT / "requirements.lock").read_text().splitlines()
        if "==" in line
    }
    assert names <= locked


def test_a_missing_optional_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Any:
        raise ImportError(name)

    path = tmp_path / "log.mat"
    path.write_bytes(b"x")
    monkeypatch.setattr(read, "import_module", missing)
    with pytest.raises(ValueError, match=r"log.mat: this format needs scipy: pip install 'stillflux\[mat\]'"):
        sf.replay(path, sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW"))
    monkeypatch.setattr(frames, "import_module", missing)
    with pytest.raises(ImportError, match=r"this needs xarray: pip install 'stillflux\[xarray\]'"):
        frames.to_xarray(np.zeros(1), {}, {}, {})


@pytest.mark.skipif(os.name != "posix", reason="a script of a POSIX shell")
@pytest.mark.parametrize(("venv", "there"), [(True, True), (True, False), (False, True), (False, False)])
def test_ci_brings_the_lists_of_packages_up_to_date_once_at_most(
    tmp_path: Path, venv: bool, there: bool
) -> None:
    log, folder = tmp_path / "log", tmp_path / "bin"
    folder.mkdir()

    def command(name: str, text: str = "exit 0") -> None:
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)

    for name in ("dirname", "id"):
        (folder / name).symlink_to(str(shutil.which(name)))
    for name in (
        "rustfmt",
        "clippy-driver",
        *(("qemu-system-arm", "arm-none-eabi-ld", "clang") if there else ()),
    ):
        command(name)
    command("python3", f"exit {0 if venv else 1}")
    for name in ("apt-get", "make"):
        command(name, f'echo "{name} $*" >> {log}')
    command("sudo", '"$@"')
    bash = str(shutil.which("bash"))
    subprocess.run([bash, str(ROOT / ".ci" / "run")], env={"PATH": str(folder)}, check=True)
    lines = log.read_text().splitlines()
    installed = [line.rpartition(" ")[2] for line in lines if " install " in line]
    expected = [] if venv else ["python3-venv"]
    if not Path("/usr/bin/cargo").exists():
        expected.append("rust-web-src")
    if not there:
        expected += ["qemu-system-arm", "gcc-arm-none-eabi", "clang"]
    assert installed == expected
    assert sum(line.startswith("apt-get update") for line in lines) == bool(expected)
    assert lines[-3:] == ["make test -j2", "make lint", "make test-builds"]
