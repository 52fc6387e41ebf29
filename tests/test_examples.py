"""The examples that have no test beside what they show: they run, and what they show is so."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillflux import metrics

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name: str) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="example")["main"]()


def test_own_motor() -> None:
    result = run("own_motor")
    assert result.status == "running"
    assert metrics.worst_angle(result) < 5.0


def test_observability() -> None:
    kept, default = (run("observability")[name].window(4.5) for name in ("omega_s_min=0", "default"))
    assert metrics.worst_angle(kept) > 5.0 * metrics.worst_angle(default)
    assert kept["estimate.angle_deviation"].max() > 2.0 * default["estimate.angle_deviation"].max()


def test_bridge_curve() -> None:
    _, measured, law = run("bridge_curve")
    assert np.abs(measured - law).max() < 0.03


def test_lost_and_held() -> None:
    runs = run("lost_and_held")
    assert metrics.worst_angle(runs["paper"]) > 45.0
    # 15° is where confidence is one half; a few seconds after the step it is found.
    assert metrics.worst_angle(runs["enhanced"]) < 15.0
    assert metrics.worst_angle(runs["enhanced"].window(10.0)) < 2.0
    assert runs["enhanced"].status == "running"


@pytest.mark.slow
def test_the_animation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / "lost_and_held.py"), run_name="__main__")
    assert (tmp_path / "lost_and_held.gif").stat().st_size > 20_000
