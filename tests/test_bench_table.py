"""The tables of `make bench`: what was not measured stays as it stands in the README."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / "benches" / "table.py"


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("bench_table", SCRIPT)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    readme = tmp_path / "README.md"
    readme.write_text(module.README.read_text(encoding="utf-8"), encoding="utf-8")
    for name, value in (("ROOT", tmp_path), ("TARGET", tmp_path / "target"), ("README", readme)):
        monkeypatch.setattr(module, name, value)
    return module


def test_what_was_not_measured_stays(table: ModuleType) -> None:
    before = table.README.read_text(encoding="utf-8")
    assert set(table.standing("control")) == set(table.BLOCKS.values())
    table.main()
    assert table.README.read_text(encoding="utf-8") == before


def test_what_was_measured_is_taken(table: ModuleType, tmp_path: Path) -> None:
    before = table.standing("control")
    for benchmark, took in (("block/filter/f32", 12.3), ("simulation/averaged/Q", 2e7)):
        file = tmp_path / "target" / "criterion" / benchmark / "new" / "estimates.json"
        file.parent.mkdir(parents=True)
        file.write_text(json.dumps({"mean": {"point_estimate": took}}))
    table.main()
    after = table.standing("control")
    assert after == before | {"filter": ["12", *before["filter"][1:]]}
    assert table.standing("simulation")[table.PLANTS["averaged"]][-1] == "250"
