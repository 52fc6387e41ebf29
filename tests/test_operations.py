"""Operations: what must happen happens, and the negative controls fail for their reason."""

from __future__ import annotations

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.limits import largest_torque, shortest_time
from stillflux.evidence.operate import perform
from stillflux.evidence.registry import choose_operations, operations
from stillflux.options import DriveSettings


@pytest.mark.parametrize(
    ("name", "machine"),
    [
        ("speed-step", "2.2kW"),
        ("speed-step", "0.37kW"),
        ("speed-step-negative", "45kW"),
        ("small-step-light", "45kW"),
        ("small-step-heavy", "0.37kW"),
        ("inductance", "48V"),
        ("light-shaft", "2.2kW"),
        ("light-shaft", "45kW"),
        ("ramp", "2.2kW"),
        ("limits-by-direction", "4kW"),
        ("overload", "2.2kW"),
        ("braking", "2.2kW"),
        ("chopper", "4kW"),
        ("supply-dip", "11kW"),
        ("overmodulation", "2.2kW"),
        ("hoist", "2.2kW"),
        ("open-phase", "11kW"),
        ("open-phase-start", "2.2kW"),
        ("channel-held", "4kW"),
        ("channel-inverted", "2.2kW"),
        ("channel-swapped", "11kW"),
        ("bad-sample", "2.2kW"),
        ("missed-calls", "2.2kW"),
        ("stall", "4kW"),
        ("encoder-break", "2.2kW"),
        ("encoder-channel", "0.37kW"),
        ("encoder-swapped", "11kW"),
        ("restart-1ms", "2.2kW"),
        ("restart-300ms", "11kW"),
        ("start-turned", "45kW"),
        ("start-turned-large", "160kW"),
        ("supply-back", "2.2kW"),
        ("temperature-regenerating", "45kW"),
        pytest.param("temperature-torque", "11kW", marks=pytest.mark.slow),
        pytest.param("temperature-torque-regenerating", "2.2kW", marks=pytest.mark.slow),
    ],
)
def test_operation_succeeds_and_its_control_fails_for_its_reason(name: str, machine: str) -> None:
    found = perform(name, machine, "enhanced", "f32")
    assert found.claims
    assert found.without
    assert found.ok, [f"{c.text}: {c.measured}" for c in (*found.claims, *found.without) if not c.ok]


@pytest.mark.parametrize("arithmetic", ["q", "f64"])
def test_a_step_into_field_weakening_succeeds_in_every_arithmetic(arithmetic: str) -> None:
    found = perform("speed-step", "2.2kW", "enhanced", arithmetic)
    assert found.ok, [f"{c.text}: {c.measured}" for c in found.claims]


def test_operations_are_chosen_by_name_or_its_beginning() -> None:
    assert choose_operations(()) == tuple(operations())
    assert choose_operations(["speed-step-negative"]) == ("speed-step-negative",)
    with pytest.raises(ValueError, match="there is no operation no-such"):
        choose_operations(["no-such"])


@pytest.mark.parametrize("machine", DRIVES)
def test_the_shortest_time_is_that_of_the_torque_limits(machine: str) -> None:
    motor, inverter = DRIVES[machine].motor, DRIVES[machine].inverter
    torque = largest_torque(motor, inverter, np.array([0.2, 1.5, 2.0]))
    assert torque[0] == pytest.approx(1.5 * motor.T_N)
    assert torque[0] > torque[1] > torque[2] > 0.0
    # At low speed the torque limit alone counts.
    assert shortest_time(motor, inverter, 0.2) == pytest.approx(
        0.2 * motor.J * motor.base["omega_m"] / (1.5 * motor.T_N)
    )


MOTOR, INVERTER = sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW")


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"acceleration": -1.0}, "acceleration"),
        ({"jerk": 100.0}, "jerk"),
        ({"torque_limits": (1.0, 2.0)}, "torque_limits"),
        ({"speed_limits": (-1e4, 1.0)}, "speed_limits"),
        ({"machine_overload": (0.1, 600.0)}, "machine_overload"),
        ({"bridge_overload": (5.0, 1e6)}, "bridge_overload"),
        ({"u_dc_brake": 500.0}, "u_dc_brake"),
        ({"winding_temperature": 200.0}, "winding_temperature"),
        ({"rotor_rise": 1.2}, "rotor_rise"),
        ({"winding_heat": (80.0, 600.0)}, "winding_heat"),
        ({"winding_temperature": 20.0, "winding_heat": (80.0, 0.1)}, "winding_heat"),
        ({"u_dc_buffer": 530.0}, "u_dc_buffer"),
        ({"u_dc_chopper": (650.0, 640.0)}, "u_dc_chopper"),
    ],
)
def test_a_setting_outside_its_range_is_refused_by_name(settings: DriveSettings, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        sf.Drive(MOTOR, INVERTER, **settings)


def test_overmodulation_is_refused_where_a_turn_of_the_field_has_too_few_control_periods() -> None:
    drive = DRIVES["160kW"]
    with pytest.raises(ValueError, match=r"overmodulation.*45 control periods"):
        sf.Drive(drive.motor, drive.inverter, overmodulation=True)
    assert sf.Drive(drive.motor, drive.inverter, overmodulation=True, omega_max=250.0)


@pytest.mark.parametrize(("name", "scheme"), [("2.2kW", "enhanced"), ("2.2kW", "paper"), ("4kW", "enhanced")])
def test_braking_from_field_weakening_ends_at_the_link_voltage_that_is_set(name: str, scheme: str) -> None:
    motor, inverter = DRIVES[name].motor, DRIVES[name].inverter
    base, u = motor.base["omega_m"], inverter.u_dc
    there = 2.0 + 10.0 * motor.J * 1.6 * base / motor.T_N
    braked = sf.Scenario(
        motor=motor,
        inverter=inverter,
        scheme=scheme,
        settings={"u_dc_brake": 1.2 * u},
        plant={"J_load": 4.0 * motor.J, "dc_link": (0.45e-6 * motor.T_N * base, 0.5, None)},
        omega_ref=[
            (0.0, 0.0),
            (2.0, 0.0),
            (there, 1.6 * base),
            (there + 0.5, 1.6 * base),
            (there + 0.5, base),
        ],
        duration=there + 1.5,
        signals=("omega_m", "torque", "u_dc", "status"),
    )
    result = sf.simulate(braked)
    assert result.status.state == "running", result.status
    assert float(result["u_dc"].max()) < 1.22 * u
    # Without the setting the same step ends by its energy.
    free = sf.simulate(braked.replace(settings={}))
    assert free.status.fault == "over-voltage", free.status
    assert free.status.time is not None
    assert free.status.time > there + 0.5


def test_a_link_on_a_capacitor_keeps_its_energy() -> None:
    """Loaded from its capacitor alone, the link gives what the plant takes."""
    scenario = sf.Scenario(
        motor=MOTOR,
        inverter=INVERTER,
        plant={"dc_link": (2e-3, 1.0, None)},
        omega_ref=[(0.0, 0.0), (1.7, 0.0), (1.9, 50.0)],
        load_torque=[(0.0, 0.0), (2.0, 0.0), (2.0, 10.0)],
        changes=[(2.5, {"u_dc": 0.0})],
        duration=2.6,
        record_every=1,
        signals=("u_dc", "omega_m", "torque", "i_s", "R_s"),
    )
    result = sf.simulate(scenario)
    part = result.window(2.52, 2.6)
    given = 1e-3 * (part["u_dc"][0] ** 2 - part["u_dc"][-1] ** 2)
    # Into the shaft and the resistances of winding and bridge; rotor loss by the slip, some 3 % of 50 Hz.
    t = part.t
    shaft = np.trapezoid(part["torque"] * part["omega_m"], t)
    copper = np.trapezoid(1.5 * (part["R_s"] + INVERTER.r_d) * np.abs(part["i_s"]) ** 2, t)
    rotor = np.trapezoid(part["torque"] * 0.03 * 157.0, t)
    threshold = 3 * INVERTER.u_th * 2 / np.pi * np.trapezoid(np.abs(part["i_s"]), t)
    assert given == pytest.approx(shaft + copper + rotor + threshold, rel=0.05)


@pytest.mark.parametrize(
    "change",
    [
        {"open_phase": 3},
        {"channel": (3, "held")},
        {"channel": (0, "held", 1.0)},
        {"channel": (0, "stuck")},
        {"channel": (0, "of", 3.0)},
        {"channel": "held"},
    ],
)
def test_a_change_that_is_none_is_refused_by_name(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        sf.Scenario(motor=MOTOR, inverter=INVERTER, duration=1.0, changes=[(0.5, change)])
