"""Replay: a log whose voltage, current or dc link has another scale is noted with what was measured, and one
of a motor within its tolerances is not."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux.logs.identified import identified_doubts
from stillflux.logs.scale import Scale, scale_of
from stillflux.logs.signals import Rows, effective
from stillflux.logs.steady import steady_blocks

TURN = np.exp(2j * np.pi / 3)
FACTORS = {"√2": math.sqrt(2.0), "√3": math.sqrt(3.0), "2": 2.0}
PLATES = {
    "0.37kW": {"P_N": 370.0, "U_N": 400.0, "I_N": 1.1, "f_N": 50.0, "n_N": 1370.0, "cos_phi": 0.71},
    "45kW": {"P_N": 45e3, "U_N": 400.0, "I_N": 81.0, "f_N": 50.0, "n_N": 1478.0, "cos_phi": 0.86},
    "48V": {"P_N": 2000.0, "U_N": 28.0, "I_N": 60.0, "f_N": 100.0, "n_N": 2880.0, "cos_phi": 0.8},
}
MOTORS = {
    **{name: sf.Motor.preset(name) for name in ("2.2kW", "11kW")},
    **{name: sf.Nameplate(**plate).motor() for name, plate in PLATES.items()},
}
TERMINAL = effective(sf.Inverter.preset("2.2kW"), "terminal")
NO_LOAD, LOADED = [(0.3, 0.0)], [(0.15, 0.0), (0.15, 0.8), (0.8, 0.8)]


def rows(
    motor: sf.Motor, points: list[tuple[float, float]], voltage: float = 1.0, current: float = 1.0
) -> Rows:
    """Terminals of a motor at rated flux, 0.5 s at each of the points (frequency and torque, of rated)."""
    base, step = motor.base, 1e-4
    u: list[Any] = []
    i: list[Any] = []
    t = np.arange(5000) * step
    for frequency, load in points:
        i_d = base["psi"] / motor.L_s
        i_q = load * motor.T_N / (1.5 * motor.n_p * motor.L_M * i_d)
        omega, phasor = frequency * base["omega"], i_d + 1j * i_q
        psi_s = motor.L_sigma * phasor + motor.L_M * i_d
        turned = np.exp(1j * omega * t)
        i.append(phasor * turned)
        # The voltage is the mean of the interval that ends at the sample.
        u.append((motor.R_s * phasor + 1j * omega * psi_s) * turned * np.exp(-0.5j * omega * step))
    volts: Any = voltage * np.concatenate(u)
    amperes: Any = current * np.concatenate(i)
    at: Any = np.arange(len(volts)) * step
    flat = np.zeros(len(volts))
    return Rows(at, volts, amperes, flat, flat, flat, ("i_s",), np.arange(len(volts)))


def judged(motor: sf.Motor, of: Rows) -> Scale:
    scale = scale_of(of, motor, TERMINAL, of_link=False)
    assert scale is not None
    return scale


@pytest.mark.parametrize("points", [NO_LOAD, LOADED])
@pytest.mark.parametrize("name", MOTORS)
def test_each_factor_is_named_with_what_was_measured(name: str, points: list[tuple[float, float]]) -> None:
    motor = MOTORS[name]
    for (root, k), upside_down, what in itertools.product(
        FACTORS.items(), (False, True), ("voltage", "current")
    ):
        k = 1.0 / k if upside_down else k
        scale = judged(motor, rows(motor, points, **{what: k}))
        assert scale.explained
        assert scale.text is not None
        size = "small" if upside_down else "large"
        assert f"{what} {root} times too {size} (" in scale.text
        impedance = k if what == "voltage" else 1.0 / k
        measured = float(scale.text.split("L_M) ")[1].split(" times")[0])
        assert measured == pytest.approx(impedance, rel=0.06)


@pytest.mark.parametrize("name", MOTORS)
def test_a_motor_at_the_limits_of_its_tolerances_is_not_noted(name: str) -> None:
    """Negative control: R_s by 30 %, L_M by 15 %, L_σ by 20 %, in every direction."""
    motor = MOTORS[name]
    for a, b, c in itertools.product((1 / 1.3, 1.0, 1.3), (1 / 1.15, 1.0, 1.15), (1 / 1.2, 1.2)):
        real = motor.replace(R_s=a * motor.R_s, L_M=b * motor.L_M, L_sigma=c * motor.L_sigma, saturation=None)
        for points in (NO_LOAD, LOADED):
            scale = judged(motor.replace(saturation=None), rows(real, points))
            assert scale == Scale(None, True), (a, b, c, points)


def test_a_flux_that_no_drive_has_is_one_of_both_scales() -> None:
    motor = MOTORS["11kW"]
    text = judged(motor, rows(motor, LOADED, voltage=math.sqrt(3.0), current=math.sqrt(3.0))).text
    assert text is not None
    assert "voltage and current √3 times too large" in text
    # Half of both is a drive with half of the flux.
    assert judged(motor, rows(motor, LOADED, voltage=0.5, current=0.5)).text is None


def test_another_motor_is_none_with_a_factor() -> None:
    motor = MOTORS["11kW"]
    scale = judged(motor, rows(motor.replace(R_s=10.0 * motor.R_s, L_M=0.4 * motor.L_M), LOADED))
    assert not scale.explained
    assert scale.text is not None
    assert "no factor of √2, √3 or 2 explains" in scale.text


def test_a_larger_motor_under_load_is_not_a_small_one_beyond_its_pull_out() -> None:
    text = judged(MOTORS["2.2kW"], rows(MOTORS["11kW"], [(0.15, 0.8)])).text
    assert text is not None
    assert "another motor?" in text


def test_nothing_steady_is_no_verdict() -> None:
    motor = MOTORS["2.2kW"]
    of = rows(motor, NO_LOAD)
    swept = replace(of, i=of.i * np.linspace(0.2, 3.0, len(of.t)) ** 2)
    assert steady_blocks(swept, motor) is None
    assert scale_of(swept, motor, TERMINAL, of_link=False) is None


@pytest.fixture(scope="module")
def log() -> dict[str, Any]:
    """Duties as firmware would record them: start, 0.15 pu, rated load; a winding 30 % warmer."""
    motor, inverter = MOTORS["2.2kW"], sf.Inverter.preset("2.2kW")
    plant = sf.Plant(motor.replace(R_s=1.3 * motor.R_s), inverter, current_offset=0.05, adc_noise=0.02)
    drive, table = sf.Drive(motor, inverter), []
    i_abc, u_dc = plant.sample()
    for k in range(35_000):
        duty = drive.step(i_abc, u_dc, omega_ref=0.0 if k < 17_000 else 24.0)
        voltage = plant.state.u_s
        table.append([k / 10e3, *i_abc, *duty, u_dc, *((voltage * TURN**-p).real for p in range(3))])
        i_abc, u_dc = plant.step(duty, gates_on=drive.gates_on, load_torque=0.0 if k < 20_000 else 12.0)
    names = ["t", "i_a", "i_b", "i_c", "d_a", "d_b", "d_c", "u_dc", "u_a", "u_b", "u_c"]
    return dict(zip(names, np.array(table).T, strict=True))


def replayed(log: dict[str, Any], kind: str, begin: int, scaled: str = "-", factor: float = 1.0) -> sf.Replay:
    names = [name for name in log if name[0] in ("t", "i", kind) or (kind == "d" and name == "u_dc")]
    part = {name: log[name][begin:] * (factor if name.startswith(scaled) else 1.0) for name in names}
    if kind == "u":
        part.pop("u_dc", None)
    return sf.replay(part, MOTORS["2.2kW"], sf.Inverter.preset("2.2kW"))


@pytest.mark.parametrize("begin", [0, 28_000])
@pytest.mark.parametrize(
    ("kind", "scaled", "named"),
    [("u", "u_", "voltage"), ("d", "u_dc", "duties times link"), ("d", "i_", "current")],
)
def test_a_recorded_log_of_another_scale_is_noted(
    log: dict[str, Any], kind: str, scaled: str, named: str, begin: int
) -> None:
    assert not [note for note in replayed(log, kind, begin).notes if "hardly fit" in note]
    for factor in (math.sqrt(3.0), 0.5):
        notes = " ".join(replayed(log, kind, begin, scaled, factor).notes)
        assert "hardly fit this motor: impedances" in notes
        assert (
            f"{named} {'√3' if factor > 1.0 else '2'} times too {'large' if factor > 1.0 else 'small'}"
            in notes
        )


def test_what_the_estimators_identify_at_the_end_of_its_range_is_named() -> None:
    def doubts(resistance: float, nis: float) -> list[str]:
        found = {"R_s": np.full(100, resistance), "nis": np.full(100, nis)}
        return list(identified_doubts(found, np.ones(100, bool), 1.0))

    assert doubts(1.5, 0.04) == []
    assert "resistance ends at 2 times" in doubts(2.0, 0.0)[0]
    assert "resistance ends at 0.4 times" in doubts(0.4, 0.0)[0]
    assert "innovation squared is 0.12" in doubts(1.0, 0.12)[0]
    assert list(identified_doubts({}, np.zeros(3, bool), 1.0)) == []
