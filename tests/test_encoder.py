"""An encoder beside a drive: its speed in Python, its options, and what is refused."""

from __future__ import annotations

import warnings

import pytest

import stillflux as sf

MOTOR, INVERTER = sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW")


def test_a_stopped_drive_tells_the_speed_of_a_shaft_that_turns() -> None:
    drive = sf.Drive(MOTOR, INVERTER, encoder_lines=1024)
    plant = sf.Plant(MOTOR, INVERTER, encoder_lines=1024, speed=-40.0)
    i_abc, u_dc = plant.sample()
    assert drive.encoder == (0.0, 0.0, "silent")
    for _ in range(1500):
        duty = drive.step(i_abc, u_dc, encoder=plant.encoder)
        i_abc, u_dc = plant.step(duty, gates_on=drive.gates_on)
    assert drive.encoder is not None
    omega_m, difference, state = drive.encoder
    assert omega_m == pytest.approx(-40.0, abs=0.1)
    assert (difference, state) == (0.0, "agrees")
    for _ in range(300):
        drive.step(i_abc, u_dc)
    assert drive.encoder[2] == "silent"


def test_without_an_encoder_there_is_nothing_to_say_and_a_position_is_refused() -> None:
    drive = sf.Drive(MOTOR, INVERTER)
    drive.step([0.0, 0.0, 0.0], 540.0, encoder=None)
    with pytest.raises(ValueError, match=r"encoder = 3: this drive has none; .* the setting encoder_lines"):
        drive.step([0.0, 0.0, 0.0], 540.0, encoder=3)
    assert drive.encoder is None
    assert sf.Plant(MOTOR, INVERTER).encoder is None


def test_the_settings_are_those_that_were_given() -> None:
    drive = sf.Drive(MOTOR, INVERTER, encoder_lines=1024, encoder_mode="control", encoder_fault=True)
    settings = drive.settings
    assert (settings["encoder_lines"], settings["encoder_mode"]) == (1024, "control")
    # Three quarters of the rated slip and 0.01 pu.
    slip = MOTOR.R_R * MOTOR.T_N / (1.5 * MOTOR.n_p * MOTOR.base["psi"] ** 2)
    expected = (0.75 * slip + 0.01 * MOTOR.base["omega"]) / MOTOR.n_p
    assert settings["encoder_deviation"] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"encoder_lines": 10}, "encoder_lines = 10"),
        ({"encoder_mode": "control"}, "encoder_lines = 0"),
        ({"encoder_lines": 1024, "encoder_mode": "both"}, "encoder_mode = 'both'"),
        ({"encoder_lines": 1024, "encoder_states": 100}, "encoder_states = 100"),
        ({"encoder_lines": 1024, "encoder_deviation": -1.0}, "encoder_deviation = -1"),
    ],
)
def test_an_encoder_that_does_not_fit_is_refused_by_name(
    settings: sf.options.DriveSettings, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        sf.Drive(MOTOR, INVERTER, **settings)


@pytest.mark.parametrize(
    ("plant", "warned", "summary"),
    [
        ({}, "plant.encoder_lines = None: there is no encoder to read", "encoder: silent for 100 %"),
        (
            {"encoder_lines": 1000},
            "plant.encoder_lines = 1000: the drive reads 2 of",
            "encoder: apart",
        ),
        ({"encoder_lines": 500}, None, None),
    ],
)
def test_an_encoder_that_the_plant_does_not_have_is_warned_of(
    plant: sf.options.PlantOptions, warned: str | None, summary: str | None
) -> None:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        scenario = sf.Scenario(
            motor=MOTOR,
            inverter=INVERTER,
            duration=2.0,
            settings={"encoder_lines": 500, "encoder_mode": "control"},
            plant=plant,
            omega_ref=[(0.0, 0.0), (1.6, 0.0), (1.8, 60.0)],
            signals=["status", "encoder.state"],
        )
    assert [one.category for one in seen] == ([sf.ScenarioWarning] if warned else [])
    assert warned is None or warned in str(seen[0].message)
    said = sf.simulate(scenario).summary()
    assert summary in said if summary else "encoder" not in said


def test_a_scenario_has_its_signals_and_names_its_faults() -> None:
    scenario = sf.Scenario(
        motor=MOTOR,
        inverter=INVERTER,
        duration=2.6,
        settings={"encoder_lines": 500, "encoder_mode": "control"},
        plant={"encoder_lines": 500},
        omega_ref=[(0.0, 0.0), (1.6, 0.0), (2.0, 60.0)],
        changes=[(2.2, {"encoder": "broken"})],
        signals=["omega_m", "encoder.omega_m", "encoder.difference", "encoder.state"],
    )
    result = sf.simulate(scenario)
    before, after = result.window(2.1, 2.19), result.window(2.5)
    assert abs(before["encoder.omega_m"] - before["omega_m"]).max() < 0.5
    assert (before["encoder.state"] == sf.EncoderCode.AGREES).all()
    assert abs(after["encoder.omega_m"]).max() < 0.1
    assert (after["encoder.state"] == sf.EncoderCode.APART).all()
    assert abs(after["omega_m"] - 60.0).max() < 0.5
    with pytest.raises(ValueError, match="encoder = \"loose\" is not one of 'broken'"):
        scenario.replace(changes=[(2.2, {"encoder": "loose"})])
