"""The tables of `make bench`: what was not measured on the target stays as it stands in the README."""

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


def test_columns_of_the_target_stay_without_a_report(table: ModuleType) -> None:
    before = table.of_target(table.README.read_text(encoding="utf-8"))
    assert set(before) == {table.LABELS.get(block, block) for block in table.BLOCKS}
    table.main()
    after = table.README.read_text(encoding="utf-8")
    assert table.of_target(after) == before
    assert f"| modulator | {' | '.join([table.MISSING] * 6)} | {' | '.join(before['modulator'])} |" in after


def test_a_report_of_the_target_is_taken(table: ModuleType, tmp_path: Path) -> None:
    counts = {"f32": 1.2, "f32_worst": 3, "q": 4.4, "q_worst": 5}
    (tmp_path / "target").mkdir()
    report = dict.fromkeys(table.BLOCKS.values(), counts)
    (tmp_path / "target" / "firmware-bench.json").write_text(json.dumps(report))
    table.main()
    found = table.of_target(table.README.read_text(encoding="utf-8"))
    assert set(map(tuple, found.values())) == {("1 / 3", "4 / 5")}
