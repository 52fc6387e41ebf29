"""Sweeps: grids and draws, resume, failures as rows, the same bytes from any executor."""

from __future__ import annotations

import functools
import os
import pickle
import runpy
import select
import signal
import subprocess
import sys
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux import executors
from stillflux.cli import main
from stillflux.metrics import settled_after
from stillflux.sweep import METRICS, Point

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
MOTOR = sf.Motor.preset("2.2kW")
BASE = sf.Scenario(
    motor=MOTOR,
    inverter=sf.Inverter.preset("2.2kW"),
    duration=1.7,
    omega_ref=5.0,
    signals=["angle_error", "status", "omega_m", "reference", "estimate.confidence", "R_s", "estimate.R_s"],
)


def points() -> list[Point]:
    return sf.grid(BASE, {"plant_motor.R_s": sf.factors(0.9, 1.1), "load_torque": [0.0, 3.0]})


def cosine_fails(result: sf.Result) -> float:
    raise ZeroDivisionError(f"at {result.t[-1]}")


def test_a_grid_is_every_combination() -> None:
    grid = points()
    assert [p.parameters for p in grid] == [
        {"plant_motor.R_s": MOTOR.R_s * x, "load_torque": load} for x in (0.9, 1.1) for load in (0.0, 3.0)
    ]
    assert grid[1].scenario is not None
    assert grid[1].scenario.plant_motor == MOTOR.replace(R_s=0.9 * MOTOR.R_s)
    assert grid[1].scenario.motor == MOTOR


def test_draws_do_not_depend_on_their_number() -> None:
    tolerances = {"plant_motor.R_s": sf.normal(0.1), "plant_inverter.dead_time": sf.uniform(0.2)}
    few, many = sf.draws(BASE, 3, tolerances, seed=4), sf.draws(BASE, 9, tolerances, seed=4)
    assert [p.parameters for p in few] == [p.parameters for p in many[:3]]
    assert sf.draws(BASE, 1, tolerances, seed=5)[0].parameters != few[0].parameters
    off = np.array([p.parameters["plant_inverter.dead_time"] / 2e-6 - 1.0 for p in many])
    assert 0.0 < np.abs(off).max() <= 0.2


def test_the_same_bytes_from_any_executor() -> None:
    from dask.distributed import Client, LocalCluster

    metrics = list(METRICS)
    found = {"serial": sf.sweep(points(), metrics, "serial"), "processes": sf.sweep(points(), metrics)}
    with ThreadPoolExecutor(2) as pool:
        found["threads"] = sf.sweep(points(), metrics, pool)
    found["joblib"] = sf.sweep(points(), metrics, executors.joblib(2))
    with (
        LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        found["dask"] = sf.sweep(points(), metrics, client)
        found["dask pool"] = sf.sweep(points(), metrics, client.get_executor())
    assert {x.to_csv() for x in found.values()} == {found["serial"].to_csv()}
    assert len(found["serial"]) == 4
    # The load turns the shaft before there is torque, and the start catches it, 6 to 7° off at first.
    assert found["serial"]["angle_max"].max() < 8.0
    with pytest.raises(TypeError, match=r"has no submit"):
        sf.sweep(points(), metrics, 3)


def test_ray_by_its_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    """The calls that the adapter makes, on a stand-in: Ray itself is not among the development packages."""

    class Remote:
        def __init__(self, function: Any) -> None:
            self.function = function

        def options(self, **options: Any) -> Remote:
            assert options == {"num_cpus": 1}
            return self

        def remote(self, *arguments: Any) -> Any:
            return lambda: self.function(*arguments)

    ray = SimpleNamespace(
        is_initialized=lambda: False, init=lambda: None, remote=Remote, get=lambda reference: reference()
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    found = sf.sweep(points()[:2], ["angle_max"], executors.Ray(num_cpus=1))
    assert found.to_csv() == sf.sweep(points()[:2], ["angle_max"], "serial").to_csv()


@pytest.mark.slow
def test_the_same_bytes_from_ray(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="pip install 'stillflux[ray]'")
    grid, journal = sf.grid(BASE, {"plant_motor.R_s": [3.7, -1.0, 4.0]}), tmp_path / "sweep.jsonl"
    metrics: Any = {**METRICS, "last": lambda result: result.t[-1]}
    found = sf.sweep(grid, metrics, executors.Ray(num_cpus=1), journal)
    assert found.to_csv() == sf.sweep(grid, metrics, "serial").to_csv()
    assert len(journal.read_text().splitlines()) == 2
    with pytest.raises(sf.SweepInterrupted, match="after 1 of 4"):
        sf.sweep(points(), ["angle_max"], executors.Ray(num_cpus=1), progress=interrupt)


def interrupt(done: int, total: int, row: Any) -> None:
    raise KeyboardInterrupt


class Dying:
    """A cluster whose worker ends with its second task."""

    def __init__(self) -> None:
        self.tasks = 0

    def submit(self, function: Any, *arguments: Any) -> Future[Any]:
        self.tasks += 1
        future: Future[Any] = Future()
        if self.tasks == 2:
            future.set_exception(MemoryError("worker 3 has gone"))
        else:
            future.set_result(function(*arguments))
        return future


def test_a_task_that_its_worker_took_along_is_a_row_and_tried_again(tmp_path: Path) -> None:
    journal = tmp_path / "sweep.jsonl"
    found = sf.sweep(points(), ["angle_max"], Dying(), journal)
    assert [row["error"] for row in found] == ["", "worker: MemoryError: worker 3 has gone", "", ""]
    assert len(journal.read_text().splitlines()) == 3
    run: list[Any] = []
    found = sf.sweep(points(), ["angle_max"], "serial", journal, progress=lambda *x: run.append(x))
    assert len(run) == 1
    assert not found.failed


def test_failures_are_rows() -> None:
    grid = sf.grid(BASE, {"plant_motor.R_s": [3.7, -1.0]})
    found = sf.sweep(grid, ["angle_max", cosine_fails], "serial")
    assert [row["error"][:28] for row in found] == [
        "cosine_fails: ZeroDivisionEr",
        "ValueError: R_s = -1 ohm is ",
    ]
    assert np.isfinite(found["angle_max"][0])
    assert np.isnan(found["angle_max"][1])
    assert len(found.failed) == 2
    assert "2 failed" in found.summary()


def test_a_fault_of_the_drive_is_a_status() -> None:
    found = sf.sweep([BASE.replace(changes=[(1.6, {"u_dc": 10.0})])], ["fault_time"], "serial")
    assert "under-voltage" in found["status"][0]
    assert 1.6 <= found["fault_time"][0] < 1.61
    assert not found.failed


KILLED = """
import os, signal, sys
sys.path.insert(0, {tests!r})
from test_sweep import points
import stillflux as sf
def show(done, total, row):
    if done == 2:
        os.kill(os.getpid(), signal.SIGKILL)
sf.sweep(points(), ["angle_max"], "serial", {journal!r}, progress=show)
"""


def test_a_killed_sweep_goes_on_and_loses_at_most_one_task(tmp_path: Path) -> None:
    journal = tmp_path / "sweep.jsonl"
    program = KILLED.format(tests=str(Path(__file__).parent), journal=str(journal))
    ended = subprocess.run([sys.executable, "-c", program], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert len(journal.read_text().splitlines()) == 2
    journal.write_text(journal.read_text() + '["abc", {"status": "runn')
    run: list[Any] = []
    found = sf.sweep(points(), ["angle_max"], "serial", journal, progress=lambda *x: run.append(x))
    assert len(run) == 2, "two were done"
    assert found.to_csv() == sf.sweep(points(), ["angle_max"], "serial").to_csv()
    again = sf.sweep(points(), ["angle_max"], "serial", journal, progress=lambda *x: run.append(x))
    assert len(run) == 2
    assert again.to_csv() == found.to_csv()
    # Another metric, another scenario: not those rows.
    other = sf.sweep(points()[:1], ["angle_rms"], "serial", journal)
    assert np.isfinite(other["angle_rms"][0])
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        sf.sweep(points(), ["angle_max"], "serial", tmp_path / "folder", progress=lambda *x: run.append(x))
    assert len(run) == 2, "named before the first run"
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        sf.sweep(
            points(), ["angle_max"], "serial", tmp_path / "none" / "x", progress=lambda *x: run.append(x)
        )
    assert not (tmp_path / "none").exists()
    journal.write_text("t,i_a\n")
    with pytest.raises(ValueError, match="holds no rows of a sweep"):
        sf.sweep(points(), ["angle_max"], "serial", journal)


def test_the_key_of_a_metric_is_that_of_its_behaviour_in_every_process() -> None:
    program = """
from functools import partial
from stillflux.sweep import _build
def power(result, base=2.0, *, names=frozenset({"omega_m", "torque", "i_s"})):
    return max((lambda x: abs(x) ** base)(x) for x in result[min(names)])
def held(limit):
    return lambda result: [x for x in result["omega_m"] if x in {"a", "b", "c"}][0] > limit
print(_build({"a": power, "b": partial(power, base=3.0), "c": held(4.0)}).hex())
"""

    def key(text: str, seed: str) -> str:
        command = [sys.executable, "-c", text]
        done = subprocess.run(
            command, capture_output=True, check=True, text=True, env={**os.environ, "PYTHONHASHSEED": seed}
        )
        return done.stdout

    first = key(program, "1")
    assert first == key(program, "2")
    for old, new in [
        ("base=2.0", "base=2.5"),
        ("** base)", "* base)"),
        ("base=3.0", "base=3.5"),
        ("held(4.0)", "held(5.0)"),
        ('"torque"', '"psi_s"'),
        ('"b", "c"', '"b", "d"'),
    ]:
        assert key(program.replace(old, new), "1") != first, new


def test_a_metric_that_cannot_be_told_from_others_is_refused_where_it_would_be_reused(tmp_path: Path) -> None:
    lock = threading.Lock()
    metrics = {"locked": lambda result: float(lock.locked())}
    assert sf.sweep(points()[:1], metrics, "serial")["locked"] == [0.0]
    with pytest.raises(ValueError, match="'locked' cannot be told from others"):
        sf.sweep(points()[:1], metrics, "serial", tmp_path / "sweep.jsonl")
    with pytest.raises(ValueError, match="has no name: give a mapping"):
        sf.sweep(points()[:1], [functools.partial(METRICS["angle_max"])], "serial")


def test_a_sweep_that_was_killed_in_its_first_row_goes_on(tmp_path: Path) -> None:
    journal = tmp_path / "sweep.jsonl"
    for cut in ('["abc", {"status": "runn', '["'):
        journal.write_text(cut)
        assert len(sf.sweep(points()[:1], ["angle_max"], "serial", journal)) == 1
    assert len(sf.sweep(points()[:1], ["angle_max"], "serial", journal, progress=interrupt)) == 1, "stored"


def test_a_torque_reference_has_no_speed_error() -> None:
    torque = replace(BASE, omega_ref=0.0, torque_ref=1.0, duration=0.1)
    found = sf.sweep([torque], ["speed_error_end", "speed_error_max"], "serial")
    assert np.isnan(found["speed_error_end"][0])
    assert not found.failed
    assert np.isnan(settled_after(sf.simulate(torque), 0.05, 0.01))


def test_an_interruption_goes_to_another_process_with_its_rows() -> None:
    stop = sf.SweepInterrupted(sf.sweep([BASE.replace(duration=0.01)], ["angle_max"], "serial"), 3)
    again = pickle.loads(pickle.dumps(stop))
    assert (str(again), len(again.result)) == ("interrupted after 1 of 3 scenarios", 1)


def test_ctrl_c_keeps_what_was_done() -> None:
    with pytest.raises(sf.SweepInterrupted, match="after 1 of 4") as caught:
        sf.sweep(points(), ["angle_max"], "serial", progress=interrupt)
    assert len(caught.value.result) == 1


def test_a_sweep_is_drawn_as_map_and_spread_and_given_as_frame(tmp_path: Path) -> None:
    found = sf.sweep(points(), ["angle_max"], "serial")
    assert found.units == {"angle_max": "°"}
    for figure in (found.map("plant_motor.R_s", "load_torque", "angle_max"), found.spread()):
        figure.savefig(tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 5_000
    assert list(found.to_pandas().columns) == list(found.columns)
    with pytest.raises(KeyError, match="is no column"):
        found["nothing"]


def test_the_command_writes_rows_plot_and_journal_and_names_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "sweep.toml"
    text = (EXAMPLES / "sweep_map.toml").read_text().replace("[1.6e-6, 2.0e-6, 2.4e-6]", "[2.0e-6]")
    file.write_text(text)
    out, plot, journal = tmp_path / "x.csv", tmp_path / "x.png", tmp_path / "x.jsonl"
    assert main(["sweep", str(file), "--out", str(out), "--plot", str(plot), "--resume", str(journal)]) == 0
    assert "3 rows, 0 ended with a fault, 0 failed" in capsys.readouterr().out
    assert len(out.read_text().splitlines()) == 4
    assert len(journal.read_text().splitlines()) == 3
    assert plot.exists()
    file.write_text(text.replace("1.15]", "-1.0]"))
    assert main(["sweep", str(file), "--out", str(out)]) == 1
    assert "failed: ValueError: R_s = -" in capsys.readouterr().out
    assert len(out.read_text().splitlines()) == 4
    for wrong, expected in (
        ("metrics = ['angle']\n" + text.split("\n", 3)[3], "'angle' is not one of"),
        (text.replace("[grid]", "[gird]"), "gird is not known"),
        (text.replace('x = "plant_motor.R_s"', 'x = "load_torqe"'), "[plot] x = 'load_torqe' is not one of"),
        ('grid = 5\n[scenario]\nmotor = "2.2kW"\nduration = 0.1\n', "grid = 5 is not a table"),
        (text.replace("[0.85, 1.0, 1.15]", '"12"'), "neither a list"),
        (text.replace("{ factors = [0.85, 1.0, 1.15] }", "3"), "neither a list"),
        (text.replace("R_s", "R_x"), f"{file}: plant_motor.R_x: R_x is not a field"),
        (text.replace('"plant_motor.R_s"', '"settings.psi_reff"'), "the drive has no setting 'psi_reff'"),
    ):
        file.write_text(wrong)
        assert main(["sweep", str(file)]) == 2
        assert expected in capsys.readouterr().err


def test_a_sweep_that_is_interrupted_prints_the_rows_that_no_file_keeps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out, journal = tmp_path / "sweep.toml", tmp_path / "x.csv", tmp_path / "x.jsonl"
    text = '[scenario]\nmotor = "2.2kW"\nduration = 0.01\n[grid]\nload_torque = [0.0, 1.0]\n'
    file.write_text(f'metrics = ["fault_time"]\n{text}')
    monkeypatch.setattr(
        "stillflux.cli.sweep",
        lambda points, metrics, **how: sf.sweep(
            points, metrics, "serial", resume=how["resume"], progress=interrupt
        ),
    )
    rows = "load_torque,status,fault_time,error\n0.0,"
    for kept in ([], ["--out", str(out)], ["--resume", str(journal)]):
        assert main(["sweep", str(file), *kept]) == 130
        said = capsys.readouterr()
        assert said.err == "stillflux: interrupted after 1 of 2 scenarios\n"
        assert said.out.startswith("1 rows, 0 ended with a fault")
        assert (rows in said.out) == (not kept)
    assert out.read_text().startswith(rows)


def test_the_example_on_a_dask_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example = runpy.run_path(str(EXAMPLES / "sweep_dask.py"), run_name="example")
    found = example["main"]()
    assert len(found) == 8
    assert not found.failed
    assert len((tmp_path / "sweep_dask.jsonl").read_text().splitlines()) == 8
    assert found["angle_max"].max() < 15.0


def test_what_is_no_sweep_is_refused_by_name() -> None:
    base = sf.Scenario(motor=MOTOR, inverter=sf.Inverter.preset("2.2kW"), duration=0.1)
    wrong: list[tuple[Any, str]] = [
        (lambda: sf.grid(base, {"plant_motor.Rs": [1.0]}), "Rs is not a field of plant_motor"),
        (
            lambda: sf.grid(base, {"settings.psi_reff": [1, 2]}),
            "settings.psi_reff: the drive has no setting 'psi_reff'; 'psi_ref'",
        ),
        (lambda: sf.grid(base, {"plant.adc_nois": [0.0]}), "plant has no option 'adc_nois'; 'adc_noise'"),
        (lambda: sf.grid(base, {"settings.nonsense": [0.0]}), "drive has no setting 'nonsense'$"),
        (lambda: sf.grid(base, {"load_torque": 3.0}), "load_torque = 3.0 is neither a list"),  # type: ignore[dict-item]
        (lambda: sf.grid(base, {"load_torque": []}), r"load_torque = \[\] has no value"),
        (lambda: sf.grid(base.replace(omega_ref=[(0, 1)]), {"omega_ref": sf.factors(2)}), "is not a number"),
        (lambda: sf.draws(base, 2, {"plant_motor.R_s": 0.1}), "R_s: 0.1 is neither normal"),  # type: ignore[dict-item]
        (lambda: sf.draws(base, 0, {}), "number = 0"),
        (lambda: sf.sweep([base, base], {"x": lambda _: 1.0}), "'x' cannot be sent to another process"),
        (lambda: sf.grid(base, {"plant_motor.R_s": sf.factors()}), "has no value"),
        (
            lambda: sf.grid(
                base, dict.fromkeys(("load_torque", "duration", "plant_motor.R_s"), range(1, 102))
            ),
            "have 1030301 combinations: at most 1000000 are a grid",
        ),
        (lambda: sf.sweep([base], []), r"metrics = \[\] has no metric"),
        (lambda: sf.sweep([base], [lambda _: 1.0, lambda _: 2.0]), "'<lambda>' is there twice"),
        (lambda: sf.sweep([base], {"status": lambda _: 1.0}), "'status' is a column of every sweep"),
        (lambda: sf.sweep([base], {"a": "no_metric"}), "'no_metric' is not one of"),  # type: ignore[dict-item]
        (lambda: sf.sweep({"b": None}, ["angle_max"]), r"scenarios\['b'\] = None is not a Scenario"),  # type: ignore[arg-type]
    ]
    for make, text in wrong:
        with pytest.raises((ValueError, TypeError), match=text):
            make()


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import stillflux as sf\n"
        "motor, inverter = sf.Motor.preset('2.2kW'), sf.Inverter.preset('2.2kW')\n"
        "base = sf.Scenario(motor=motor, inverter=inverter, duration=0.01)\n"
        "sf.sweep([base, base.replace(duration=0.02)], ['angle_max'])\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert 'begin the sweep below `if __name__ == "__main__":`' in done.stderr


def test_every_setting_of_either_scheme_is_an_axis() -> None:
    motor, inverter = MOTOR, sf.Inverter.preset("2.2kW")
    for scheme in ("enhanced", "paper"):
        settings = sf.Drive(motor, inverter, scheme=scheme).settings
        base = sf.Scenario(motor=motor, inverter=inverter, duration=0.1, scheme=scheme)
        for name, value in settings.items():
            (point,) = sf.grid(base, {f"settings.{name}": [value]})
            assert point.scenario is not None, point.error


INTERRUPTED = """
import signal, sys
sys.path.insert(0, {tests!r})
from test_sweep import BASE
import stillflux as sf
def show(done, total, row):
    print("done", flush=True)
if __name__ == "__main__":
    # As in a terminal, where the tests run in the background of a shell as well.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        sf.sweep([BASE.replace(duration=x) for x in (0.1, 3000.0, 3001.0, 3002.0, 3003.0)], progress=show)
    except sf.SweepInterrupted as stop:
        print(stop, flush=True)
"""


def test_ctrl_c_pressed_again_and_again_is_quiet(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED.format(tests=str(Path(__file__).parent)))
    run = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert run.stdout is not None
    assert run.stdout.readline() == "done\n"
    # As a terminal does it: to the whole group, to the processes that begin, run and end.
    while run.poll() is None and not select.select([run.stdout], [], [], 0.01)[0]:
        os.killpg(run.pid, signal.SIGINT)
    said, errors = run.communicate(timeout=60)
    assert said == "interrupted after 1 of 5 scenarios\n"
    assert errors == ""


def test_a_map_has_texts_on_its_axes_and_shows_in_a_notebook() -> None:
    rows = [{"a": a, "b": b, "status": "running", "m": 1.0, "error": ""} for a in ("x", "y") for b in (1, 2)]
    found = sf.Sweep(rows, ("a", "b"), ("m",))
    figure: Any = found.map("b", "a", "m")
    assert [text.get_text() for text in figure.axes[0].get_yticklabels()] == ["x", "y"]
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert found._repr_html_().count("<tr>") == 5
    with pytest.raises(ValueError, match="metric = 'status' is not one of m"):
        found.map("b", "a", "status")


def test_a_profile_is_a_column_of_its_values() -> None:
    short = BASE.replace(duration=0.02)
    loads = [[(0, 0), (0.01, 1)], [(0, 0), (0.01, 2)]]
    found = sf.sweep(sf.grid(short, {"load_torque": loads}), ["angle_max"], "serial")
    assert found["load_torque"].shape == (2,)
    assert list(found["load_torque"]) == loads
    for values in (
        [0.0, [(0, 0), (0.01, 1)]],
        [1.0, "two"],
        [np.array([[0, 0], [1, 1]])] * 2,
        [(1, 2), (3, 4)],
    ):
        column = sf.Sweep([{"x": x, "status": "", "error": ""} for x in values], ("x",))["x"]
        assert column.shape == (2,)
        assert column.dtype == object
        assert all(a is b for a, b in zip(column, values, strict=True))
    numbers = sf.Sweep([{"x": x, "status": "", "error": ""} for x in (1, 2.5)], ("x",))
    assert numbers["x"].dtype == float
    assert numbers["status"].dtype.kind == "U"


def test_numbers_of_numpy_are_rows_of_plain_numbers() -> None:
    bits: Any = np.array([10, 12])
    grid = sf.grid(BASE, {"plant.adc_bits": bits})
    assert [type(point.parameters["plant.adc_bits"]) for point in grid] == [int, int]
    assert len(sf.draws(BASE, np.int64(2), {}, seed=np.int64(3))) == 2  # type: ignore[arg-type]


def test_what_no_sweep_takes_is_named() -> None:
    wrong: list[tuple[Any, str]] = [
        (
            lambda: sf.sweep([BASE], "angle_max"),
            r"metrics = 'angle_max': give a list of names, \['angle_max'\]",
        ),
        (lambda: sf.sweep([BASE], None), "metrics = None is not a list"),  # type: ignore[arg-type]
        (lambda: sf.sweep(None), "scenarios = None are no scenarios"),  # type: ignore[arg-type]
        (lambda: sf.sweep([BASE], {1: len}), "metrics: 1 is not a name"),  # type: ignore[dict-item]
        (lambda: sf.sweep([BASE], [["angle_max"]]), r"metrics: \['angle_max'\] is not one of"),  # type: ignore[list-item]
        (lambda: sf.sweep([BASE], progress=5), "progress = 5 is neither a function nor True"),  # type: ignore[arg-type]
        (lambda: sf.grid(5, {}), "base = 5 is not a stillflux.Scenario"),  # type: ignore[arg-type]
        (lambda: sf.grid(BASE, 5), "axes = 5 is not a mapping"),  # type: ignore[arg-type]
        (lambda: sf.draws(BASE, 2, 5), "tolerances = 5 is not a mapping"),  # type: ignore[arg-type]
        (lambda: sf.draws(BASE, 2, {}, seed=-1), "seed = -1 is not a whole number from 0 on"),
        (lambda: sf.factors("a"), r"factors\[0\] = 'a' is not a number"),  # type: ignore[arg-type]
        (lambda: sf.normal(7.0), "deviation = 7 is outside the admissible range 0 to 1: it is relative"),
        (lambda: sf.uniform(float("nan")), "most = nan is outside the admissible range 0 to 1"),
        (
            lambda: sf.Sweep([], (), ("angle_max",)).spread("status"),
            "metrics: 'status' is not one of angle_max",
        ),
        (lambda: sf.Sweep([]).spread(), "metrics: this sweep has none"),
    ]
    for make, text in wrong:
        with pytest.raises((ValueError, TypeError), match=text):
            make()
