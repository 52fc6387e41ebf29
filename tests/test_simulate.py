"""Scenario, simulate, Result."""

from __future__ import annotations

import _thread
import json
import os
import pickle
import re
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux import metrics
from stillflux._core import RecordEstimator
from stillflux.machine_file import typical_inverter

MEMORY: dict[str, Any] = {
    "u_off": 0.1 + 0.2j,
    "R_s": 3.9,
    "i_off": (0.0, 0.1, 0.0),
    "loss_error": 0.1,
    "L_sigma": 0.02,
    "L_M": 0.2,
}


def test_what_is_no_name_is_named(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario.replace(duration=0.01, changes=[]))
    for call, text in (
        (lambda: scenario.with_values(3), "values = 3 is not a table of names and values"),  # type: ignore[arg-type]
        (lambda: scenario.with_values({1: 3}), "values: 1 is not a name"),  # type: ignore[dict-item]
        (lambda: result.plot(["omega_m"]), r"signal = \['omega_m'\] is not a name; give several"),  # type: ignore[arg-type]
        (lambda: result.select(["omega_m"]), r"signal = \['omega_m'\] is no"),  # type: ignore[arg-type]
    ):
        with pytest.raises(TypeError, match=text):
            call()


def test_a_memory_may_be_plain_data(scenario: sf.Scenario) -> None:
    made = scenario.replace(memory={**MEMORY, "u_off": [0.1, 0.2]})
    assert made == scenario.replace(memory=MEMORY)
    assert made.replace(memory=made.to_dict()["memory"]) == made


def test_without_an_inverter_a_scenario_takes_that_of_the_motors_preset() -> None:
    motor, inverter = sf.Motor.preset("11kW"), sf.Inverter.preset("11kW")
    for given in ("11kW", {"preset": "11kW", "R_s": 0.4}):
        assert sf.Scenario.from_dict({"motor": given, "duration": 0.1}).inverter == inverter
        made = sf.Scenario.from_dict({"motor": given, "inverter": {"f_s": 8000.0}, "duration": 0.1})
        assert made.inverter == inverter.replace(f_s=8000.0)
    fields = {"motor": asdict(motor), "duration": 0.1}
    assert sf.Scenario.from_dict({**fields, "inverter": {}}).inverter == typical_inverter(motor)
    made = sf.Scenario.from_dict({"motor": "11kW", "duration": 0.1, "plant_inverter": {"dead_time": 2.1e-6}})
    assert made.plant_inverter == inverter.replace(dead_time=2.1e-6)
    assert sf.Scenario.from_dict(made.to_dict()) == made
    for wrong, text in (
        ({"preset": "2.2kW", "R_s": -1.0}, "motor: R_s = -1 ohm is outside the admissible range"),
        ({"preset": "2.2kW", "Rs": 1.0}, "motor: Rs is not known; 'R_s'"),
        (asdict(motor), "inverter is missing: .* inverter = {} is one that suits the motor"),
    ):
        with pytest.raises(ValueError, match=text):
            sf.Scenario.from_dict({"motor": wrong, "duration": 0.1})


def test_records_truth_and_estimate_apart(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario)
    assert result.status == "running"
    assert len(result.t) == pytest.approx(2000, abs=1)
    assert result["psi_s"].dtype == complex
    assert result["estimate.omega_m"].shape == result.t.shape
    assert result.units["omega_m"] == "rad/s"
    assert result["omega_m"][-1] == pytest.approx(5.0, abs=1.5)
    assert metrics.start_time(result) == pytest.approx(1.5, abs=0.2)
    assert result["R_s"][-1] == pytest.approx(4.0, rel=0.05)
    with pytest.raises(KeyError, match="was not recorded"):
        result["speed"]


def test_the_status_signal_has_named_values(scenario: sf.Scenario) -> None:
    changes = [(1.9, {"u_dc": 50.0})]
    result = sf.simulate(scenario.replace(changes=changes, record_every=1))
    seen = [sf.StatusCode(int(code)) for code in result["status"]]
    order = [code for k, code in enumerate(seen) if k == 0 or seen[k - 1] != code]
    code = sf.StatusCode
    assert order == [code.READING_OFFSET, code.MAGNETISING, code.RUNNING, code.FAULTED]
    assert result.status.fault == "under-voltage"
    assert result.status.fault_code == 2


def test_same_scenario_same_result(scenario: sf.Scenario) -> None:
    noisy = scenario.replace(plant={"adc_noise": 0.02, "seed": 5})
    first, second = sf.simulate(noisy), sf.simulate(noisy)
    assert np.array_equal(first["i_s"], second["i_s"])


def test_scenario_and_result_come_back_from_pickle(scenario: sf.Scenario) -> None:
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    result = sf.simulate(scenario.replace(signals=["omega_m"], duration=0.1, changes=[]))
    back = pickle.loads(pickle.dumps(result))
    assert np.array_equal(back["omega_m"], result["omega_m"])
    assert back.status == result.status


def test_a_result_comes_back_from_its_file(scenario: sf.Scenario, tmp_path: Path) -> None:
    result = sf.simulate(scenario.replace(memory=MEMORY))
    path = tmp_path / "run.npz"
    result.save(path)
    back = sf.Result.load(path)
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
    assert back.scenario.plant["current_offset"] == 0.03 + 0.02j
    assert back.scenario.motor == scenario.motor
    assert back.memory == result.memory
    assert back.status == result.status
    assert back.signals == result.signals
    assert np.array_equal(back["psi_s"], result["psi_s"])
    assert np.array_equal(sf.simulate(back.scenario)["psi_s"], result["psi_s"])


def test_failed_save_leaves_nothing(
    scenario: sf.Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = sf.simulate(scenario.replace(duration=0.01, changes=[]))
    path = tmp_path / "run.npz"
    path.write_bytes(b"before")

    def full(*_: object, **__: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OSError, match="disk full"):
        result.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["run.npz"]
    assert path.read_bytes() == b"before"


def test_a_window_is_a_part_of_a_result_and_a_plot_has_all_panels(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario)
    part = result.window(1.0, 1.5)
    assert part.t[0] == pytest.approx(1.0)
    assert part.t[-1] == pytest.approx(1.5)
    assert len(result.plot().axes) == 6
    with pytest.raises(ValueError, match="window = "):
        result.window(5.0)


def test_mismatch_is_one_line(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario.replace(plant_motor=scenario.motor.replace(R_s=4.4), changes=(), plant={}))
    assert result["R_s"][0] == 4.4
    assert result.scenario.motor.R_s == 3.7


def test_torque_reference_and_imposed_speed(scenario: sf.Scenario) -> None:
    run = scenario.replace(
        omega_ref=0.0, torque_ref=[(0.0, 0.0), (1.6, 0.0), (1.6, 5.0)], plant={"speed": 0.0}, changes=()
    )
    result = sf.simulate(run)
    assert result["omega_m"][-1] == 0.0
    assert result["torque"][-1] == pytest.approx(5.0, abs=0.5)


@pytest.mark.filterwarnings("ignore::stillflux.ScenarioWarning")
def test_the_summary_names_a_speed_reference_that_is_cut(scenario: sf.Scenario) -> None:
    # 1500 r/min taken for rad/s.
    result = sf.simulate(scenario.replace(omega_ref=1500.0, duration=1.8, changes=[]))
    assert "speed reference: 1500 … 1500 rad/s, cut to -345.6 … 345.6 rad/s (omega_max" in result.summary()
    assert "cut to" not in sf.simulate(scenario.replace(duration=1.8, changes=[])).summary()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"omega_ref": 1500.0}, r"omega_ref: 1500 … 1500 rad/s, cut to -345\.6 … 345\.6 rad/s"),
        ({"omega_ref": [(0, 0), (1, -400), (1, 0)]}, r"omega_ref: -400 … 0 rad/s, cut to -345\.6"),
        ({"omega_ref": [(0, 0), (4, 800)]}, r"omega_ref: 0 … 400 rad/s, cut to -345\.6"),
        (
            {"omega_ref": 0.0, "torque_ref": 10.0, "settings": {"torque_limits": (-20.0, 5.0)}},
            r"torque_ref: 10 … 10 N·m, cut to -20 … 5 N·m \(torque_max, torque_limits\)",
        ),
    ],
)
def test_a_reference_that_the_drive_cuts_is_warned_of_where_the_scenario_is_made(
    scenario: sf.Scenario, change: dict[str, Any], text: str
) -> None:
    with pytest.warns(sf.ScenarioWarning, match=text) as caught:
        scenario.replace(**change)
    assert [one.filename for one in caught] == [__file__]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenario.replace(omega_ref=[(0, 0), (2, 345.5), (2.1, 345.5), (8, 345.5)])
        scenario.replace(omega_ref=[(0, 0), (6, 900)])


def test_channels_that_end_below_the_over_current_level_are_refused(scenario: sf.Scenario) -> None:
    trip = sf.Drive(scenario.motor, scenario.inverter).settings["i_trip"]
    text = rf"adc_range = 16 A is outside the admissible range {trip:.5g}\d* to 1000000 A: .* i_trip"
    with pytest.raises(ValueError, match=text):
        scenario.replace(plant={"adc_range": 16.0})
    scenario.replace(plant={"adc_range": 1.001 * trip})
    higher: Any = {"i_trip": 20.0, "i_range": 20.0}
    with pytest.raises(ValueError, match=r"adc_range = 17 A is outside the admissible range 20 to"):
        scenario.replace(plant={"adc_range": 17.0}, settings=higher)
    # What is not given is that of the real motor, which may be smaller than the drive believes.
    scenario.replace(plant={"adc_range": None}, settings=higher)


@pytest.mark.filterwarnings("ignore::stillflux.ScenarioWarning")
def test_the_summary_names_a_torque_reference_that_is_cut(scenario: sf.Scenario) -> None:
    asked = scenario.replace(omega_ref=0.0, torque_ref=60.0, duration=1.8, plant={"speed": 0.0}, changes=[])
    most = sf.Drive(asked.motor, asked.inverter).settings["torque_max"]
    said = sf.simulate(asked).summary()
    cut = f"torque reference: 60 … 60 N·m, cut to {-most:.4g} … {most:.4g} N·m (torque_max, torque_limits)"
    assert cut in said
    limited = asked.replace(torque_ref=10.0).with_settings(torque_limits=(-20.0, 5.0))
    assert "10 … 10 N·m, cut to -20 … 5 N·m" in sf.simulate(limited).summary()
    assert "cut to" not in sf.simulate(asked.replace(torque_ref=10.0)).summary()


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"duration": -1.0}, ValueError, "duration = -1"),
        ({"duration": 9e4}, ValueError, "raise record_every"),
        ({"arithmetic": "f8"}, ValueError, "arithmetic = "),
        ({"signals": ["speed"]}, ValueError, "'speed'|\"speed\""),
        ({"settings": {"gain": 1.0}}, TypeError, "'gain'"),
        ({"settings": {"speed_bandwith": 5.0}}, TypeError, "'speed_bandwith'; 'speed_bandwidth'\\?"),
        (
            {"settings": {"jerk": 1.0}},
            ValueError,
            "jerk = 1 .*not admissible: it needs an accel",
        ),
        ({"plant": {"iron_los": (1.0, 1.0)}}, TypeError, "'iron_los'; 'iron_loss'\\?"),
        (
            {"plant": {"iron_loss": 1.0}},
            TypeError,
            r"iron_loss = 1.0 is not \(R_fe in Ω, ",
        ),
        ({"plant": {"adc_skew": 1e-6}}, TypeError, "adc_skew = 1e-06 is not three numbers"),
        ({"plant": {"gain": 1.0}}, TypeError, "'gain'"),
        ({"plant": {"adc_bits": 99}}, ValueError, "bits = 99"),
        ({"changes": [(1.0, {"R_r": 1.0})]}, TypeError, "'R_r'"),
        ({"changes": [(1.0, {"R_s": -1.0})]}, ValueError, "R_s = -1"),
        ({"changes": [(1.0, {"R_R": 0.0})]}, ValueError, "R_R = 0 ohm"),
        ({"changes": [(1.0, {"R_s": 1.0}), (0.5, {"R_s": 2.0})]}, ValueError, "changes time = 0.5"),
        ({"load_torque": [(1.0, 0.0), (0.5, 0.0)]}, ValueError, "load_torque: .*time = 0.5"),
        ({"omega_ref": float("nan")}, ValueError, "omega_ref = nan"),
        ({"torque_ref": 1.0}, ValueError, "give only one"),
        ({"memory": {"R_s": 1.0}}, ValueError, "u_off"),
        ({"plant_inverter": sf.Inverter(f_s=5e3)}, ValueError, "f_s = 5000"),
    ],
)
def test_what_no_scenario_can_be_is_named(
    scenario: sf.Scenario, changes: dict[str, object], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        scenario.replace(**changes)


def test_reports_progress(scenario: sf.Scenario, capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[float] = []
    sf.simulate(scenario, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    sf.simulate(scenario, progress=True)
    assert "start" in capsys.readouterr().err


# Both on the clock of this process's computing time: a piece of the run that is too long shows on it, other
# processes on the same cores do not.
@pytest.fixture
def _interruptible() -> Iterator[None]:
    """Ctrl-C as in the foreground: a shell starts its background jobs with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_interruptible")
def test_interrupt_within_200_ms_keeps_what_was_recorded(scenario: sf.Scenario) -> None:
    long = scenario.replace(duration=5000.0, record_every=100, signals=["omega_m"])
    pressed = 0.0

    def press() -> None:
        nonlocal pressed
        pressed = time.process_time()
        _thread.interrupt_main()

    timer = threading.Timer(0.3, press)
    timer.start()
    with pytest.raises(sf.Interrupted) as stop:
        sf.simulate(long)
    assert time.process_time() - pressed < 0.2
    assert isinstance(stop.value, KeyboardInterrupt)
    assert 0.0 < stop.value.result.t[-1] < 5000.0


@pytest.mark.usefixtures("_interruptible")
@pytest.mark.parametrize("estimator", ["FluxEstimator", "RecordEstimator"])
def test_an_estimator_over_a_long_record_is_interrupted_within_200_ms(estimator: str) -> None:
    motor, inverter = sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW")
    i_s = np.ones(5_000_000, complex)
    one, pressed = np.ones(len(i_s)), 0.0
    run: Callable[[], object]
    if estimator == "FluxEstimator":
        run = partial(sf.FluxEstimator(motor, inverter).run, i_s, i_s)
    else:
        record = RecordEstimator(motor, inverter, "enhanced")
        run = partial(record.run, i_s, i_s, 0.0 * one, 540.0 * one, one, 1.0 + 0.0j, 0.1, 0.0)

    def press() -> None:
        nonlocal pressed
        pressed = time.process_time()
        _thread.interrupt_main()

    timer = threading.Timer(0.2, press)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        run()
    assert time.process_time() - pressed < 0.2


def test_releases_the_gil(scenario: sf.Scenario) -> None:
    """While one thread simulates, this one gets to run many times between its pieces."""
    worker = threading.Thread(target=sf.simulate, args=(scenario.replace(duration=20.0),))
    worker.start()
    longest, last = 0.0, time.process_time()
    while worker.is_alive():
        time.sleep(0.001)
        longest, last = max(longest, time.process_time() - last), time.process_time()
    assert longest < 0.04


def test_a_function_of_too_many_points_is_refused_by_name(scenario: sf.Scenario) -> None:
    with pytest.raises(ValueError, match="load_torque is a function, read every 1 ms: 5000000 points"):
        scenario.replace(duration=5000.0, load_torque=lambda t: 0.0)


def test_profiles_are_numbers_arrays_and_functions(scenario: sf.Scenario) -> None:
    points = [(0.0, 0.0), (1.0, 2.0)]
    kinds: list[Any] = [points, np.array(points), [np.array(p) for p in points], [list(p) for p in points]]
    for given in kinds:
        assert scenario.replace(omega_ref=given).omega_ref == ((0.0, 0.0), (1.0, 2.0))
    ramp = scenario.replace(omega_ref=lambda t: 2.0 * t, duration=0.5, changes=[])
    assert isinstance(ramp.omega_ref, tuple)
    assert len(ramp.omega_ref) == 501
    assert ramp.omega_ref[-1] == (0.5, 1.0)
    assert pickle.loads(pickle.dumps(ramp)) == ramp
    assert scenario.replace(load_torque=np.float32(1.5)).load_torque == 1.5


def test_plain_data_gives_an_equal_scenario(scenario: sf.Scenario, tmp_path: Path) -> None:
    full = scenario.replace(
        settings={"low_confidence": "limit"},
        plant={
            "current_offset": [0.01, 0.02, 0.0],
            "current_offset_drift": 1e-3j,
            "current_gain": np.array([1.01, 1.0, 0.99]),
            "turn_on_delay": [(1e-7, 1e-7)] * 3,
            "iron_loss": (2000.0, 1e-4),
            "speed": None,
        },
        plant_motor=scenario.motor.replace(R_s=4.0),
        omega_ref=np.array([[0.0, 0.0], [1.0, 1.0]]),
        changes=[(0.1, {"current_offset": np.complex128(0.01 + 0.02j)}), (0.2, {"speed": None})],
        signals=["omega_m", "i_s"],
        memory={
            "u_off": 0.1j,
            "R_s": 3.9,
            "i_off": [0.0, 0.1, 0.0],
            "loss_error": 0.1,
            "L_sigma": 0.02,
            "L_M": 0.2,
        },
        duration=0.3,
    )
    assert sf.Scenario.from_dict(json.loads(json.dumps(full.to_dict()))) == full
    path = tmp_path / "run.npz"
    sf.simulate(full).save(path)
    assert sf.Result.load(path).scenario == full


def test_plain_data_that_are_no_space_vector_are_named() -> None:
    data = {"motor": "2.2kW", "duration": 0.1}
    for wrong, text in (
        ({"plant": {"current_offset": ["a", 1]}}, r"current_offset\[0\] = 'a' is not a number"),
        ({"plant": {"current_offset_drift": [0.1, True]}}, r"current_offset_drift\[1\] = True is not"),
        ({"changes": [[0.01, {"current_offset": [[1], 1]}]]}, r"current_offset\[0\] = \[1\] is not"),
        ({"memory": {"u_off": [None, 1]}}, r"u_off\[0\] = None is not a number"),
    ):
        with pytest.raises(TypeError, match=text):
            sf.Scenario.from_dict({**data, **wrong})


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"duration": "ten"}, "duration = 'ten' is not a number"),
        ({"plant": {"adc_bits": -3}}, "adc_bits = -3"),
        ({"plant": {"seed": 1.5}}, "seed = 1.5"),
        ({"omega_ref": 1e5}, r"omega_ref = 100000 rad/s is outside .* -3141\.59 to 3141\.59 rad/s"),
        ({"load_torque": 1e9}, r"load_torque = 1e\+09 N·m is outside the admissible range -146 to 146 N·m"),
        ({"load_torque": float("nan")}, "load_torque = nan"),
        ({"omega_ref": [(0.0, 0.0), (1.0, 1e6)]}, r"omega_ref = 1e\+06"),
        ({"omega_ref": [(0.0, 0.0), (1.0,)]}, r"omega_ref\[1\] = \(1.0,\) is not a point"),
        ({"omega_ref": np.zeros((3, 3))}, r"omega_ref has the shape \(3, 3\)"),
        ({"omega_ref": "fast"}, "omega_ref = 'fast' is not a number"),
        ({"inverter": sf.Inverter(u_dc=100.0)}, r"inverter.u_dc = 100 V .* from 169.7 V on .* U_N = 400 V"),
        ({"plant_inverter": sf.Inverter(u_dc=100.0)}, "plant_inverter.u_dc = 100 V"),
        ({"changes": [("x", {"R_s": 4.0})]}, r"changes\[0\]"),
        ({"record_every": 2.5}, "record_every = 2.5"),
        ({"signals": "omega_m"}, "give a list of names"),
        ({"motor": "2.2kW"}, r"motor = '2.2kW' is not a stillflux.Motor: give Motor.preset\('2.2kW'\)"),
        ({"plant_inverter": 3}, "plant_inverter = 3 is not a stillflux.Inverter"),
        ({"name": 5}, "name = 5 is not a text"),
        ({"omega_ref": []}, r"omega_ref = \[\] has no points"),
        ({"omega_ref": [(float("inf"), 1.0)]}, r"omega_ref\[0\]: t = inf s"),
        ({"plant": {"speed": 1e5}}, r"speed = 100000 rad/s is outside .* -3141\.59 to 3141\.59 rad/s"),
        ({"changes": [(0.1, {"speed": 1e5})]}, "speed = 100000"),
        ({"plant": {"seed": 1 << 64}}, "seed = "),
        ({"plant": {"adc_bits": -1}}, "adc_bits = -1 bit is outside the admissible range 0 to 32"),
        ({"plant": {"adc_bits": 33}}, "adc_bits = 33 bit is outside the admissible range 0 to 32 bit"),
        ({"plant": {"current_offset": [0.1, 0.2]}}, "current_offset has 2 values, .* or one complex number"),
        ({"plant": {"encoder_lines": -1}}, "plant encoder_lines = -1 is outside the admissible range 1 to"),
        ({"duration": 0.0}, "duration = 0 s is outside .* 0.0001 to 100000 s: one control period at least"),
        ({"changes": 3}, "changes = 3 is not a list"),
        ({"settings": {1: 1}}, "settings: 1 is not a name"),
        ({"plant": {1: 1}}, "plant: 1 is not a name"),
        ({"memory": {"x": 1}}, "memory has no value 'x'; there are u_off, R_s, "),
        ({"memory": {**MEMORY, "R_S": 99.0}}, "memory has no value 'R_S'; there are u_off, R_s, "),
        ({"memory": {key: MEMORY[key] for key in ("R_s", "i_off")}}, "memory has no 'u_off'"),
        ({"memory": {**MEMORY, "u_off": ["x", 1.0]}}, "memory u_off = 'x' is not a number"),
        (
            {"memory": {**MEMORY, "R_s": 9.0}},
            r"memory R_s = 9 Ω is outside the admissible range 1\.56\d* to 7\.8 Ω: .* another machine's",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(
    scenario: sf.Scenario, changes: dict[str, Any], text: str
) -> None:
    with pytest.raises((ValueError, TypeError), match=text):
        scenario.replace(**changes)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"motor": "2.2kW"}, "duration is missing"),
        ({"duration": 1.0}, "motor is missing"),
        ({"motor": 3, "inverter": "2.2kW", "duration": 1.0}, "motor = 3 is neither a preset"),
        ({"motor": {"R_s": 1.0}, "inverter": "2.2kW", "duration": 1.0}, "motor: has no complete equivalent"),
        ({"motor": "3kW", "duration": 1.0}, "motor = '3kW' is neither a preset"),
        ([1], "a scenario is a table"),
    ],
)
def test_what_is_no_scenario_is_named(data: Any, text: str) -> None:
    with pytest.raises((ValueError, TypeError), match=text):
        sf.Scenario.from_dict(data)


def test_parameters_take_numbers_of_numpy_and_nothing_else(scenario: sf.Scenario) -> None:
    motor = scenario.motor.replace(R_s=np.float32(3.5), n_p=np.int64(2))
    assert type(motor.R_s) is float
    assert type(motor.n_p) is int
    json.dumps(scenario.replace(motor=motor).to_dict())
    with pytest.raises(TypeError, match="R_s = 'x' is not a number"):
        scenario.motor.replace(R_s="x")
    with pytest.raises(ValueError, match="saturation has 2 values"):
        scenario.motor.replace(saturation=(1.0, 2.0))


def test_a_load_that_no_shaft_stands_is_refused_by_the_plant(scenario: sf.Scenario) -> None:
    plant = sf.Plant(scenario.motor, scenario.inverter)
    with pytest.raises(ValueError, match="load_torque = 1000000000 N m is outside the admissible range -146"):
        plant.step([0.5, 0.5, 0.5], load_torque=1e9)


def test_a_state_that_is_not_finite_is_an_error(
    scenario: sf.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stillflux.scenario._TORQUE_LIMIT", 1e12)
    runaway = scenario.replace(load_torque=1e9, duration=0.5, signals=["omega_m"], changes=[])
    with pytest.raises(ArithmeticError, match="omega_m is not finite from t = ") as stop:
        sf.simulate(runaway)
    assert isinstance(stop.value, sf.DivergenceError)
    kept = pickle.loads(pickle.dumps(stop.value)).result
    assert 0 < len(kept.t) < 500
    assert np.isfinite(kept["omega_m"]).all()


def test_what_runs_away_after_a_fault_is_told_of_the_fault(
    scenario: sf.Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stillflux.scenario._TORQUE_LIMIT", 1e12)
    faults = scenario.replace(
        load_torque=[(0.0, 0.0), (0.8, 0.0), (0.8, 1e9)], duration=1.2, changes=[(0.7, {"u_dc": 10.0})]
    )
    with pytest.raises(
        sf.DivergenceError, match=r"the drive had ended with fault: under-voltage .*runs away"
    ):
        sf.simulate(faults)
    row = sf.sweep([faults], ["angle_max"], "serial").rows[0]
    assert row["status"].startswith("fault: under-voltage")
    assert row["error"].startswith("DivergenceError: ")


def test_a_summary_says_how_far_the_speed_swings(scenario: sf.Scenario) -> None:
    """A shaft of a quarter of the inertia that the drive was told of swings, and the drive runs; by default
    it reduces its gains."""
    loaded = scenario.replace(
        duration=2.5, omega_ref=[(0.0, 0.0), (1.0, 0.0), (1.2, 15.0)], load_torque=3.0, plant={}, changes=[]
    )
    steady = loaded.replace(plant_motor=scenario.motor.replace(J=0.25 * scenario.motor.J))
    light = steady.with_settings(reduce_gain=False)
    for asked, least, most in ((loaded, 0.0, 0.001), (steady, 0.0, 0.001), (light, 0.1, 1.0)):
        result = sf.simulate(asked)
        assert result.status == "running"
        assert least <= sf.metrics.speed_swing(result) <= most
        said = float(
            re.findall(r"speed error at the end: .*, ±(.*) pu in the last 0.5 s", result.summary())[0]
        )
        assert said == pytest.approx(sf.metrics.speed_swing(result), rel=0.1)
        reduced = "speed control: reduced to 0." in result.summary()
        assert reduced == (asked is steady)


def test_a_result_is_a_mapping_with_a_summary(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario)
    assert "omega_m" in result
    assert "speed" not in result
    assert set(result) == set(result.keys()) == set(result._ipython_key_completions_())
    assert len(repr(result)) < 100
    assert result._repr_html_().startswith("<table><caption>start</caption>")
    text = result.summary()
    for expected in (
        "status: running",
        "field angle error: ",
        "stator frequency at the end: ",
        "R_s at the end: ",
    ):
        assert expected in text
    few = result.select("omega_m", "i_s")
    assert few.signals == ("omega_m", "i_s")
    assert "angle" not in few.summary()
    with pytest.raises(KeyError, match="was not recorded"):
        result.select("speed")


def test_frames_have_units_and_files_take_them(scenario: sf.Scenario, tmp_path: Path) -> None:
    import pandas
    import xarray

    result = sf.simulate(scenario.replace(duration=0.3, changes=[]))
    frame = result.to_pandas()
    assert frame.attrs["units"]["psi_s.re"] == "V s"
    assert frame.index.name == "t"
    frame.to_parquet(tmp_path / "x.parquet")
    back = pandas.read_parquet(tmp_path / "x.parquet")
    assert np.array_equal(back["psi_s.im"], result["psi_s"].imag)
    data = result.to_xarray()
    assert data["omega_m"].attrs["units"] == "rad/s"
    data.to_netcdf(tmp_path / "x.nc", engine="scipy")
    again = xarray.load_dataset(tmp_path / "x.nc", engine="scipy")
    assert np.array_equal(again["psi_s.re"], result["psi_s"].real)
    assert again["t"].attrs["units"] == "s"
    assert sf.Scenario.from_dict(json.loads(again.attrs["scenario"])) == result.scenario


def test_plots_show_in_a_notebook_and_compare_runs(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario)
    other = sf.simulate(scenario.replace(omega_ref=2.0, name="slower"))
    figures: list[Any] = [result.plot(), result.plot("omega_m", "psi_s"), result.compare(other)]
    for figure in figures:
        assert figure._repr_png_().startswith(b"\x89PNG")
    legend = result.compare(other, signals=["omega_m"]).axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["start", "slower"]


def test_chosen_signals_are_enough_for_plots(scenario: sf.Scenario) -> None:
    result = sf.simulate(scenario)
    few = result.select("omega_m", "angle_error")
    assert [panel.get_ylabel() for panel in few.plot().axes] == ["speed, rad/s", "field angle error, °"]
    assert len(result.select("u_s").plot().axes) == 1
    assert [panel.get_ylabel() for panel in few.compare(result).axes] == ["omega_m, rad/s", "angle_error, °"]
    assert dict(few.items()).keys() == {"omega_m", "angle_error"}
    with pytest.raises(ValueError, match="none in common"):
        few.compare(result.select("u_s"))
    with pytest.raises(TypeError, match=r"others\[0\] = 3 is not a Result"):
        few.compare(3)  # type: ignore[arg-type]


def test_what_is_no_saved_result_is_named(tmp_path: Path, scenario: sf.Scenario) -> None:
    (tmp_path / "junk.npz").write_text("junk")
    with pytest.raises(ValueError, match=r"junk.npz is not a saved result"):
        sf.Result.load(tmp_path / "junk.npz")
    whole = tmp_path / "run.npz"
    result = sf.simulate(scenario.replace(duration=0.01, changes=[]))
    result.save(whole)
    with pytest.raises(ValueError, match=r"run\.csv: \.csv is not \.npz"):
        result.save(tmp_path / "run.csv")
    assert not (tmp_path / "run.csv").exists()
    torn = bytearray(whole.read_bytes())
    torn[121] ^= 0xFF
    (tmp_path / "torn.npz").write_bytes(torn)
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "other.npz", meta="{}", t=[1.0])
    np.savez(tmp_path / "number.npz", meta="5", t=[1.0])
    for name in ("torn.npz", "array.npy", "other.npz", "number.npz"):
        with pytest.raises(ValueError, match=f"{name} is not a saved result"):
            sf.Result.load(tmp_path / name)
    with np.load(whole) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays.pop("meta")))
    for change, text in (
        ({"status": ["asleep"]}, "state = 'asleep' is not one of"),
        ({"scenario": {**meta["scenario"], "later": 1}}, "later is not a field of a scenario"),
    ):
        np.savez(tmp_path / "newer.npz", meta=json.dumps({**meta, **change}), **arrays)
        with pytest.raises(ValueError, match=rf"newer.npz: {text}"):
            sf.Result.load(tmp_path / "newer.npz")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        sf.simulate(scenario.replace(duration=0.01, changes=[])).save(tmp_path / "none" / "run.npz")


def test_a_saved_file_has_the_permissions_of_the_user(scenario: sf.Scenario, tmp_path: Path) -> None:
    result = sf.simulate(scenario.replace(duration=0.01, changes=[]))
    path = tmp_path / "run.npz"
    before = os.umask(0o027)
    try:
        result.save(path)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640


RAMP = [(0.0, 0.0), (1.0, 0.0), (9.0, 5.0)]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            {"changes": [(1.0, {"R_s": 4.0}), (5.0, {"R_s": 5.0})]},
            r"changes\[1\] comes after the end, at t = 5 s",
        ),
        (
            {"load_torque": [(0, 0), (6, 0), (6, 5)]},
            r"load_torque\[2\] comes after the end, from t = 6 s on",
        ),
        ({"omega_ref": [*RAMP, (12.0, 7.0)]}, r"omega_ref\[3\] comes after the end, from t = 9 s on"),
    ],
)
def test_what_only_comes_after_the_end_is_warned_of_and_in_the_summary(
    scenario: sf.Scenario, change: dict[str, Any], text: str, tmp_path: Path
) -> None:
    with pytest.warns(sf.ScenarioWarning, match=f"{text}: duration = 2 s") as caught:
        late = scenario.replace(**{"changes": [], **change})
    assert caught[0].filename == __file__, "where the scenario is made"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = sf.simulate(late)
        result.save(tmp_path / "run.npz")
        assert sf.Result.load(tmp_path / "run.npz").scenario == late
    assert re.search(f"not reached: {text}", result.summary())


@pytest.mark.parametrize(
    "change",
    [
        {"omega_ref": RAMP},
        {"load_torque": [(0, 0), (1, 3), (5, 3), (9, 3)]},
        {"changes": [(2.0, {"R_s": 4.0})], "load_torque": [(0, 0), (2, 0), (2, 5)]},
        {"omega_ref": lambda t: t},
    ],
)
def test_a_ramp_that_ends_after_the_run_and_a_value_that_stays_are_no_mistake(
    scenario: sf.Scenario, change: dict[str, Any]
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scenario.replace(**change).unreached() == []


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"omega_ref": None}, "omega_ref = None is not a number"),
        (
            {"load_torque": {0: 1}},
            r"load_torque = {0: 1} is not a number, nor points \(t, value\), nor a func",
        ),
        ({"signals": 5}, "signals = 5 is not a list of names"),
        ({"signals": ["omega_m", 5]}, r"signals\[1\] = 5 is not a name"),
        ({"cycle_stamps": "no"}, "cycle_stamps = 'no' is neither True nor False"),
        (
            {"changes": [(0.1, {"R_s": 4.0}), (0.2, {"u_dc": "a"})]},
            r"changes\[1\]: u_dc = 'a' is not a number",
        ),
        (
            {"changes": [(0.1, {"load_torque": 4.0})]},
            "no setting 'load_torque'; there are R_s, R_R, current_offset",
        ),
        ({"changes": [(0.1, {"open_phase": -1})]}, "open_phase = -1 is not a whole number from 0 to 2"),
        (
            {"changes": [(0.1, {"channel": (0, "of", 1.5)})]},
            "channel of = 1.5 is not a whole number from 0 to 2",
        ),
        ({"changes": [(0.1, {"channel": (7, "held")})]}, "channel = 7 is not a whole number from 0 to 2"),
        ({"changes": [(0.1, {"channel": (0, "gain")})]}, r"channel = \(0, 'gain'\): admissible are 'held'"),
    ],
)
def test_what_no_scenario_has_is_named(scenario: sf.Scenario, changes: dict[str, Any], text: str) -> None:
    with pytest.raises((ValueError, TypeError), match=text):
        scenario.replace(**changes)


@pytest.mark.parametrize(("channel", "other"), [(0, 1), (1, 2.0), (2, 0)])
def test_a_channel_can_read_another_phase(scenario: sf.Scenario, channel: int, other: float) -> None:
    since = 1.7
    result = sf.simulate(
        scenario.replace(
            plant={},
            changes=[(since, {"channel": (channel, "of", other)})],
            duration=since + 0.01,
            signals=["i_s", "measured.i_s"],
            record_every=1,
        )
    )
    axes = np.exp(2j * np.pi / 3 * np.arange(3))
    phases = (result["i_s"][:, None] * axes.conj()).real
    swapped = phases.copy()
    swapped[:, channel] = phases[:, int(other)]
    # From the next sample on, and the current flows until the sum of the three is a fault.
    after = result.t > since + 0.5 / scenario.inverter.f_c
    assert (after & (np.abs(swapped - phases).max(axis=1) > 1.0)).sum() >= 3
    for read, rows in ((phases, ~after), (swapped, after)):
        measured = 2.0 / 3.0 * (read * axes).sum(axis=1)
        assert np.abs(result["measured.i_s"] - measured)[rows].max() < 0.02


def test_a_field_of_a_scenario_is_no_method_of_it(scenario: sf.Scenario) -> None:
    for name, text in (
        ("replace", "replace is not a field of a scenario"),
        ("motor.tau_r", "tau_r is not a field of motor"),
        ("motor.__class__", "__class__ is not a field of motor"),
    ):
        with pytest.raises(ValueError, match=text):
            scenario.value(name)
    with pytest.raises(ValueError, match=r"motor.R_x: R_x is not a field of motor"):
        scenario.with_values({"motor.R_x": 1.0})


def test_profiles_are_frames_as_well(scenario: sf.Scenario) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"t": [0.0, 1.0], "load": [0.0, 2.0]})
    assert scenario.replace(load_torque=frame).load_torque == ((0.0, 0.0), (1.0, 2.0))
    with pytest.raises(ValueError, match=r"load_torque has the shape \(2,\), points have \(n, 2\)"):
        scenario.replace(load_torque=frame["load"])


def test_what_cannot_be_shown_or_run_is_named(scenario: sf.Scenario) -> None:
    short = sf.simulate(scenario.replace(duration=0.02, changes=[]))
    wrong: list[tuple[Any, str]] = [
        (lambda: sf.simulate(scenario.to_dict()), "scenario = .* is not a stillflux.Scenario"),  # type: ignore[arg-type]
        (lambda: sf.simulate(scenario, progress=5), "progress = 5 is neither a function nor True"),  # type: ignore[arg-type]
        (lambda: short.window("a"), "begin = 'a' is not a number"),  # type: ignore[arg-type]
        (lambda: short.compare(short, signals="omega_m"), r"signals = 'omega_m': give a list"),
        (lambda: short.select().plot(), "signals: none was recorded"),
    ]
    for call, text in wrong:
        with pytest.raises((ValueError, TypeError), match=text):
            call()
