"""Faults with what was measured, cycle stamps, and the judge of the guarantee."""

from __future__ import annotations

import cmath
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence import guarantee
from stillflux.evidence.courses import COURSES
from stillflux.evidence.documents import rendered
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.judge import angle
from stillflux.evidence.machines import ADC_NOISE
from stillflux.evidence.seeds import seed_of
from stillflux.evidence.table import Group, Table, guarantee_at, of_guarantee
from stillflux.evidence.tolerance import scenario, start_up

METRICS = Path(__file__).parent / "metrics.csv"


@pytest.fixture
def drive() -> sf.Drive:
    return sf.Drive(sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW"))


def test_a_fault_says_what_was_measured_and_against_which_limit(drive: sf.Drive) -> None:
    for _ in range(2):
        drive.step([0.0, 0.0, 0.0], 1000.0, omega_ref=0.0)
    status = drive.status
    assert (status.fault, status.fault_code, status.unit) == ("over-voltage", 3, "V")
    assert status.value == pytest.approx(1000.0, rel=1e-6)
    assert status.limit == pytest.approx(drive.settings["u_dc_max"], rel=1e-6)
    assert pickle.loads(pickle.dumps(status)) == status


def test_without_a_fault_there_is_nothing_to_say(drive: sf.Drive) -> None:
    status = drive.status
    assert (status.value, status.limit, status.unit, status.fault_code) == (None, None, None, None)


def test_a_doubled_call_changes_nothing(drive: sf.Drive) -> None:
    motor = sf.Motor.preset("2.2kW")
    plant = sf.Plant(motor, sf.Inverter.preset("2.2kW"))
    i_abc, u_dc = plant.sample()
    for k in range(1500):
        duty = drive.step(i_abc, u_dc, omega_ref=0.0, cycle=(65_000 + k) % 65_536)
        i_abc, u_dc = plant.step(duty, gates_on=drive.gates_on)
    assert drive.status == "starting"
    before = drive.estimate.psi_s
    again = drive.step(i_abc, u_dc, omega_ref=0.0, cycle=(65_000 + 1499) % 65_536)
    assert np.array_equal(again, duty)
    assert drive.estimate.psi_s == before


def test_missed_calls_stop_a_drive_that_switches(drive: sf.Drive) -> None:
    plant = sf.Plant(sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW"))
    i_abc, u_dc = plant.sample()
    for k in range(2000):
        if k % 10:
            duty = drive.step(i_abc, u_dc, omega_ref=0.0, cycle=k)
        i_abc, u_dc = plant.step(duty if k else [0.5] * 3, gates_on=drive.gates_on)
    assert drive.status.fault == "timing"


@pytest.mark.parametrize("omega", [0.1, -0.1])
def test_a_step_of_the_speed_at_few_kilohertz_is_no_open_phase(omega: float) -> None:
    # The torque reverses as fast as the field turns, the current behind it: a healthy phase stays at zero
    # for 27 ms.
    motor, inverter = sf.Motor.preset("11kW"), sf.Inverter.preset("11kW").replace(f_s=4e3)
    speed = omega * motor.base["omega_m"]
    result = sf.simulate(
        sf.Scenario(motor=motor, inverter=inverter, duration=3.5, omega_ref=[(0, 0), (2, 0), (2, speed)])
    )
    assert result.status == "running"
    assert result["omega_m"][-1] == pytest.approx(speed, rel=0.01)


@pytest.mark.parametrize(
    ("machine", "f_s", "frequency", "swing"),
    [
        ("4kW", 4e3, 10.0, 0.5),
        ("0.75kW", 4e3, 15.0, 0.5),
        ("11kW", 4e3, 10.0, 0.3),
        ("11kW", 4e3, 15.0, 0.5),
        ("0.37kW", 5e3, 10.0, 0.5),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_a_load_that_swings_at_few_kilohertz_is_no_open_phase(
    machine: str, f_s: float, frequency: float, swing: float, seed: int
) -> None:
    # Where the induced voltage was fed forward with the estimated speed, which lags, current control lagged
    # while a phase was at its zero: 12 of these 15 ended by "open phase".
    motor, inverter = DRIVES[machine].motor, DRIVES[machine].inverter.replace(f_s=f_s)
    begin = start_up(motor, inverter) + 0.5
    t = np.arange(0.0, 4.0, 1.0 / (24.0 * frequency))
    load = motor.T_N * (0.1 + swing * np.sin(2.0 * np.pi * frequency * t))
    speed = 0.02 * motor.base["omega_m"]
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            duration=begin + 4.5,
            omega_ref=[(0.0, 0.0), (begin, 0.0), (begin + 0.5, speed)],
            load_torque=[(0.0, 0.0), *zip((begin + 0.5 + t).tolist(), load.tolist(), strict=True)],
            plant={"adc_noise": 0.004 * motor.I_N, "seed": seed},
            record_every=20,
        )
    )
    assert result.status == "running"
    assert np.degrees(np.abs(result["angle_error"][result.t > begin])).max() < 15.0


@pytest.mark.parametrize("scheme", ["enhanced", "paper"])
@pytest.mark.parametrize("machine", ["2.2kW", "11kW"])
def test_an_offset_that_was_found_and_is_then_read_counts_once(scheme: Any, machine: str) -> None:
    # Of 3 % of rated peak: taken off twice, the field was lost or 68° off.
    motor, inverter = sf.Motor.preset(machine), sf.Inverter.preset(machine)
    offset = 0.03 * math.sqrt(2.0) * motor.I_N * cmath.rect(1.0, 2.0)
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            scheme=scheme,
            duration=15.0,
            # Nothing is fresh after a stop of 0.3 s.
            settings={"fresh_time": 0.1},
            omega_ref=[(0.0, 0.0), (1.8, 0.0), (2.0, 20.0), (7.0, 20.0), (7.2, 0.0)],
            load_torque=[(0.0, 0.0), (11.0, 0.0), (11.1, 0.5 * motor.T_N)],
            changes=[(2.0, {"current_offset": offset}), (7.0, {"stop": True}), (7.3, {"stop": False})],
        )
    )
    assert result.status == "running"
    before = result.t < 7.0
    assert abs(np.asarray(result["estimate.u_off"])[before][-1]) > 0.5 * abs(offset) * motor.R_s
    assert np.degrees(np.abs(result["angle_error"][result.t > 10.8])).max() < 10.0


@pytest.mark.parametrize("omega", [1.3, -1.3, 1.5, -1.5])
def test_a_start_does_not_excite_a_machine_that_turns_in_either_direction(omega: float) -> None:
    # While its direct currents rest the voltage was turned ahead as if the field turned in the positive one.
    motor, inverter = sf.Motor.preset("11kW"), sf.Inverter.preset("11kW")
    speed = omega * motor.base["omega_m"]
    for part in (0.9, 1.1):
        real = motor.replace(R_R=part * motor.R_R, R_s=(2.0 - part) * motor.R_s)
        result = sf.simulate(
            sf.Scenario(
                motor=motor,
                inverter=inverter,
                plant_motor=real,
                duration=2.0,
                omega_ref=speed,
                plant={"speed": speed},
            )
        )
        assert result.status == "running", part
        assert result["omega_m"][-1] == pytest.approx(speed, rel=0.02)


def test_held_is_the_longest_uninterrupted_time() -> None:
    t = np.arange(10) * 0.1
    condition = np.array([0, 1, 1, 0, 1, 1, 1, 1, 0, 0], dtype=bool)
    assert guarantee.held(t, condition) == pytest.approx(0.4)
    assert guarantee.held(t, ~np.ones(10, dtype=bool)) == 0.0
    assert guarantee.held(t, np.ones(10, dtype=bool)) == pytest.approx(0.9)


def test_a_draw_of_the_guarantee_is_run_again_alone_if_it_faults() -> None:
    outcome = guarantee.run("2.2kW", "start", 0, 1.0)
    assert not outcome.violated
    assert not outcome.fault
    assert not outcome.needless
    assert f"{guarantee.GO_ON}: 0" in guarantee.table([outcome])


def outcome(
    machine: str, draw: int, speed: float = 0.0, fault: str = "", off: float = 0.0
) -> guarantee.Outcome:
    """One run at 2.5 times the tolerances, whose speed is wrong for so long with and without supervision."""
    needless = bool(fault) and off == 0.0
    return guarantee.Outcome(machine, "hold", draw, 2.5, speed, 0.0, fault, needless, max(speed, off), 0.0)


def test_the_guarantee_of_a_drive_counts_its_runs_and_names_those_to_look_at() -> None:
    runs = [
        outcome("fan", 0),
        outcome("2.2kW", 1, speed=0.3),
        outcome("fan", 2, fault="field lost", off=0.5),
        outcome("fan", 3, fault="stall"),
        outcome("2.2kW", 0, speed=0.2),
    ]
    first, second = guarantee.found(runs)
    assert (first.machine, second.machine) == ("2.2kW", "fan")
    claims = {claim.quantity: claim for claim in (*first.claims, *second.claims)}
    by = [{claim.quantity: claim for claim in x.claims} for x in (first, second)]
    assert [x[guarantee.GO_ON].value for x in by] == [1, 0]
    assert [x[guarantee.GO_ON].ok for x in by] == [False, True]
    assert [x[guarantee.WITHOUT].value for x in by] == [1, 1]
    assert [x[guarantee.NEEDLESSLY].value for x in by] == [0, 1]
    assert claims["draw 1 of hold goes on lost"].value == 0.3
    assert claims["draw 3 of hold ended needlessly by stall"].seed == 3

    table = Table().updated([line for x in (first, second) for line in of_guarantee(x, "enhanced")])
    markers = (f"<!-- table: {name} -->\n<!-- end -->" for name in ("guarantee", "guarantee-runs"))
    text = rendered("".join(markers), table)
    assert "| 2.5 times: runs that go on lost | **1** |" in text
    assert "| 2.2kW | hold | 2.5 | 1 | goes on lost, 0.3 s | " in text
    assert f"`{guarantee.rerun('fan', 'hold', 3, 2.5)}`" in text


def test_at_the_tolerances_themselves_no_drive_goes_on_lost() -> None:
    """As the committed table has it, over at least six draws of each course."""
    table = Table.read(METRICS)
    for scale in guarantee.SCALES:
        for machine in DRIVES:
            group: Group = ("guarantee", guarantee_at(scale), machine, "enhanced")
            assert table.get(group, guarantee.RUNS).number >= 6 * len(COURSES)
            if scale == 1.0:
                assert table.get(group, guarantee.GO_ON).number == 0


@pytest.mark.parametrize("seed", [1, 2])
def test_the_saliency_of_the_rotors_slots_is_no_lost_field(seed: int) -> None:
    """4 % of the leakage, all parameters right: its ripple in the innovation alternates. Judged by squares
    without their sign each of these runs ended with "field lost", at 0.9° of angle error."""
    motor, inverter = DRIVES["48V"].motor, DRIVES["48V"].inverter
    omega, T = 0.08 * motor.base["omega_m"], motor.T_N
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            duration=12.0,
            omega_ref=((0.0, 0.0), (2.0, 0.0), (2.5, omega)),
            load_torque=((0.0, 0.0), (3.0, 0.0), (3.5, T), (7.0, T), (7.5, -T)),
            plant={"seed": seed, "adc_noise": ADC_NOISE * motor.I_N, "slot_ripple": (28, 0.0, 0.04)},
        )
    )
    assert result.status.fault is None
    assert np.abs(angle(result))[result.t > 3.0].max() < 2.0


def test_a_heavy_shaft_that_brakes_at_the_torque_limit_keeps_its_field() -> None:
    """30 times the fan's inertia takes seconds through the speed of the slip, where a field that is lost
    would stand. What half of the torque shows decides; on suspicion alone the field was turned by 141°."""
    motor, inverter = DRIVES["fan"].motor, DRIVES["fan"].inverter
    speed = 0.3 * motor.base["omega_m"]
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            plant_motor=motor.replace(J=30.0 * motor.J),
            duration=32.0,
            omega_ref=((0.0, 0.0), (2.0, 0.0), (2.01, speed), (14.0, speed), (14.01, -speed)),
            signals=("angle_error", "omega_m", "status"),
        )
    )
    after = result.t > 2.0
    assert np.abs(angle(result))[after].max() < 2.0
    assert result["omega_m"][-1] < -0.9 * speed


@pytest.mark.parametrize("noise", range(3))
def test_a_load_that_meets_the_torque_limit_at_the_speed_of_the_slip_is_held(noise: int) -> None:
    """A 48-V drive far beyond its tolerances: pull-out leaves it rated torque, at which the shaft stands
    below its reference. On suspicion alone its field was turned by 118° and the shaft ran away."""
    seed = seed_of("48V", "beside-rated", 7)
    made, _ = scenario("48V", COURSES["beside-rated"], seed, scale=2.5)
    plant = {**made.plant, "seed": seed + noise}
    result = sf.simulate(made.replace(plant=plant, signals=("angle_error", "status")))
    assert np.abs(angle(result)).max() < 15.0


@pytest.mark.parametrize(("machine", "inertia"), [("160kW", 4.0), ("48V", 11.0)])
def test_a_stop_that_the_dc_link_holds_up_is_no_stall(machine: str, inertia: float) -> None:
    """With `u_dc_brake` and no chopper losses alone brake a heavy shaft, by less than 0.01 pu a second."""
    motor, inverter = DRIVES[machine].motor, DRIVES[machine].inverter
    base, u_dc = motor.base["omega_m"], inverter.u_dc
    power = motor.T_N * base
    begin = start_up(motor, inverter)
    at_speed = begin + 0.6 + 0.45 * inertia * motor.J * base / motor.T_N
    speed = 0.29 * base
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            plant={
                "J_load": (inertia - 1.0) * motor.J,
                "dc_link": (250e-9 * power * (540.0 / u_dc) ** 2, 0.02 * u_dc**2 / power, None),
            },
            duration=at_speed + 4.0,
            omega_ref=((0.0, 0.0), (begin, 0.0), (begin, speed), (at_speed, speed), (at_speed, 0.0)),
            settings={"u_dc_brake": 1.3 * u_dc},
            signals=("omega_m", "u_dc"),
        )
    )
    assert result.status.fault is None
    after = result.window(at_speed + 0.5)
    # The link is what holds the torque: without this the test would say nothing.
    assert np.mean(after["u_dc"]) > 1.2 * u_dc
    assert 0.0 < after["omega_m"][-1] < speed


def test_noise_while_the_current_of_a_start_rises_is_not_taken_for_a_rotation() -> None:
    """At 160 kW the legs of the bridge leave more across the current of the search than a rotation builds up
    in 10 ms; three of these 24 starts took it for one, and followed it."""
    drive = DRIVES["160kW"]
    base, I_N = drive.motor.base["i"], drive.motor.I_N
    for seed in range(24):
        result = sf.simulate(
            sf.Scenario(
                motor=drive.motor,
                inverter=drive.inverter.replace(c_out=0.6e-9),
                duration=1.0,
                plant={"adc_noise": 0.004 * I_N, "current_offset": 0.01 * I_N * (1 + 1j), "seed": seed},
                signals=["estimate.i_dq", "status"],
            )
        )
        assert result.status == "starting", (seed, result.status)
        # After the comparison of the legs the current keeps its direction.
        across = result.window(0.36)["estimate.i_dq"].imag / base
        assert np.abs(across).max() < 0.2, seed
