"""The examples that have no test beside what they show: they run, and what they show is so. Notebooks run
without Jupyter, as the site runs them."""

from __future__ import annotations

import json
import math
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stillflux import metrics

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
DOCS = EXAMPLES.with_name("docs")


def run(name: str) -> Any:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="example")["main"]()


def notebook(name: str) -> tuple[list[Any], dict[str, Any]]:
    cells, names = runpy.run_path(str(DOCS / "_notebook.py"))["executed"](EXAMPLES / f"{name}.ipynb")
    return cells, names


def test_a_cell_shows_what_a_notebook_shows(tmp_path: Path) -> None:
    path = tmp_path / "book.ipynb"
    sources = ["# title", "x = 2\nprint(x)\nx + 1", "x;", "1 / 0"]
    cells = [{"cell_type": "code" if k else "markdown", "source": [text]} for k, text in enumerate(sources)]
    path.write_text(json.dumps({"cells": cells[:3]}))
    executed = runpy.run_path(str(DOCS / "_notebook.py"))["executed"]
    found, names = executed(path)
    assert [(cell.code, cell.text) for cell in found] == [(False, ""), (True, "2\n3"), (True, "2")]
    assert names["x"] == 2
    path.write_text(json.dumps({"cells": cells}))
    with pytest.raises(ZeroDivisionError):
        executed(path)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_are_committed_small_and_without_outputs(path: Path) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    assert path.stat().st_size < 50_000
    for cell in content["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_the_notebook_of_an_own_motor_keeps_the_field() -> None:
    cells, names = notebook("own_motor")
    assert sum(bool(cell.picture) for cell in cells) == 2
    for run in (names["known"], names["plated"]):
        assert run.status == "running"
        assert metrics.worst_angle(run) < 5.0


def test_the_notebook_of_an_own_log_finds_the_speed_and_the_mistakes() -> None:
    cells, names = notebook("own_log")
    assert names["found"].voltage == "bridge"
    assert names["found"].omega_m[-1] == pytest.approx(20.0, rel=0.03)
    assert np.abs(names["angle"]).max() < 1.0
    assert "wrong by a factor of 1000" in cells[-1].text
    assert "i_a and i_b swapped" in cells[-1].text


def test_the_notebook_of_many_runs_has_none_that_fails() -> None:
    _, names = notebook("many_runs")
    assert len(names["found"]) == 9
    assert not names["found"].failed
    assert (names["found"]["status"] == "running").all()
    assert names["drawn"]["angle_max"].max() < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "name", "at_zero"),
    [
        ("motulator", "motulator_plant", 0.5),
        # Without capacitance of the nodes, noise decides on the dead-time voltage of a current near zero.
        ("gym_electric_motor", "gym_electric_motor_plant", 5.0),
    ],
)
def test_the_drive_holds_on_plants_that_others_wrote(package: str, name: str, at_zero: float) -> None:
    pytest.importorskip(package)
    worst = notebook(name)[1]["worst"]
    assert worst("enhanced", 2.4, 3.4) < 0.5
    assert worst("enhanced", 3.6, math.inf) < at_zero


def test_the_flux_shift_of_the_example_keeps_the_angle() -> None:
    kept, default = (run("observability")[name].window(4.5) for name in ("omega_s_min=0", "default"))
    assert metrics.worst_angle(kept) > 3.0 * metrics.worst_angle(default)
    assert kept["estimate.angle_deviation"].max() > 2.0 * default["estimate.angle_deviation"].max()


def test_the_bridge_curve_of_the_example_is_its_law() -> None:
    _, measured, law = run("bridge_curve")
    assert np.abs(measured - law).max() < 0.03


def test_where_the_published_scheme_of_the_example_is_lost_the_enhanced_one_holds() -> None:
    runs = run("lost_and_held")
    assert runs["paper"].status.fault is not None
    assert metrics.worst_angle(runs["paper"]) > 20.0
    # 15° is where confidence is one half; a few seconds after the step it is found.
    assert metrics.worst_angle(runs["enhanced"]) < 15.0
    assert metrics.worst_angle(runs["enhanced"].window(10.0)) < 2.0
    assert runs["enhanced"].status == "running"


@pytest.mark.slow
def test_the_animation_of_the_example_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / "lost_and_held.py"), run_name="__main__")
    assert (tmp_path / "lost_and_held.gif").stat().st_size > 20_000
