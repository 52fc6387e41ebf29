"""Motor and inverter: conversions, copies, errors."""

from __future__ import annotations

import pickle
import re
import warnings
from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence.drives import DRIVES

RATING: Any = {"n_p": 2, "J": 0.1, "U_N": 400.0, "I_N": 20.0, "f_N": 50.0, "T_N": 70.0}


def test_a_motor_has_what_follows_from_its_parameters() -> None:
    motor = sf.Motor.inverse_gamma(
        R_s=3.7, R_R=2.1, L_sigma=0.021, L_M=0.224, n_p=2, J=0.015, U_N=400.0, I_N=5.0, f_N=50.0, T_N=14.6
    )
    assert motor == sf.Motor.preset("2.2kW").replace(saturation=None)
    assert motor.replace(R_s=4.4).R_s == 4.4
    assert motor.tau_r == pytest.approx(0.224 / 2.1)
    assert motor.L_s == pytest.approx(0.245)
    assert motor.sigma == pytest.approx(0.021 / 0.245)
    assert motor.base["psi"] == pytest.approx(400.0 * (2 / 3) ** 0.5 / (100 * 3.141592653589793))


def test_circuits_convert_exactly() -> None:
    motor = sf.Motor.inverse_gamma(R_s=0.2, R_R=0.2, L_sigma=2e-3, L_M=0.06, **RATING)
    gamma: Any = motor.to_gamma()
    t_model: Any = motor.to_t_model()
    for back in (sf.Motor.gamma(**gamma, **RATING), sf.Motor.t_model(**t_model, **RATING)):
        for name in ("R_s", "R_R", "L_sigma", "L_M"):
            assert getattr(back, name) == pytest.approx(getattr(motor, name), rel=1e-11)


@pytest.mark.parametrize(
    "value", [sf.Motor.preset("2.2kW"), sf.Motor.preset("11kW"), sf.Inverter(c_out=1e-9)]
)
def test_motor_and_inverter_come_back_from_pickle_and_repr(value: sf.Motor | sf.Inverter) -> None:
    assert pickle.loads(pickle.dumps(value)) == value
    assert eval(repr(value), vars(sf)) == value


@pytest.mark.parametrize(
    ("field", "value"),
    [("R_s", -1.0), ("L_M", float("nan")), ("n_p", 0), ("J", float("inf")), ("n_p", -3), ("U_N", 1e9)],
)
def test_bad_motor_names_field_value_and_range(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"{field} = .* range .* to ") as error:
        sf.Motor.preset("2.2kW").replace(**{field: value})
    assert str(value).lower() in str(error.value).lower() or f"{value:.0f}" in str(error.value)


def test_what_is_no_value_of_a_motor_is_named() -> None:
    with pytest.raises(ValueError, match=r"n_p = 1.5"):
        sf.Motor.preset("2.2kW").replace(n_p=1.5)
    with pytest.raises(ValueError, match=r"'2\.2kW' and '11kW'"):
        sf.Motor.preset("3kW")
    with pytest.raises(TypeError, match="R_x"):
        sf.Motor.preset("2.2kW").replace(R_x=1.0)
    for wrong in (np.complex64(3 + 4j), np.True_, bytearray(b"3")):
        with pytest.raises(TypeError, match=r"R_s = .* is not a number"):
            sf.Motor.preset("2.2kW").replace(R_s=wrong)
    with pytest.raises(ValueError, match=r"R_s is a whole number beyond the range of a float"):
        sf.Motor.preset("2.2kW").replace(R_s=10**400)


def test_what_is_no_value_of_a_setting_is_named() -> None:
    pair = r"machine_overload = 300.0 is not \(continuous current in A rms, time constant in s\), nor None"
    with pytest.raises(TypeError, match=pair):
        sf.Drive(sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW"), machine_overload=300.0)  # type: ignore[arg-type]
    for name in ("psi_ref", "current_sensors", "acceleration"):
        with pytest.raises(TypeError, match=f"{name} = True is not a number"):
            sf.Drive(sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW"), **{name: True})  # type: ignore[arg-type]


def test_what_no_inverter_can_be_is_named() -> None:
    with pytest.raises(ValueError, match=r"dead_time = 1"):
        sf.Inverter(dead_time=1.0)
    with pytest.raises(ValueError, match=r"c_out = 0\.000001 F .* range 0 to 1e-8 F"):
        sf.Inverter(c_out=1e-6)
    for half_periods, admitted in (
        (0, "outside .* range 1 to 16"),
        (3, "not admissible: 1, or an even number"),
        (18, "outside .* range 1 to 16"),
    ):
        with pytest.raises(ValueError, match=rf"half_periods = {half_periods} is {admitted}"):
            sf.Inverter(half_periods=half_periods)
    assert sf.Inverter(half_periods=1).f_c == 20e3


def test_too_few_control_periods_in_a_turn_are_refused_by_what_they_follow_from() -> None:
    motor = sf.Motor.preset("2.2kW")
    for half_periods, least in ((16, "8000"), (12, "6000")):
        few = sf.Inverter(f_s=5.9e3, half_periods=half_periods)
        with pytest.raises(
            ValueError, match=rf"f_s = 5900 Hz .* {least} to .* half_periods and f_N, 20 to 6283"
        ):
            sf.Drive(motor, few)
    sf.Drive(motor, sf.Inverter(f_s=6.1e3, half_periods=12))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"T_N": 14600.0}, r"T_N = 1.46e\+04 N·m does not fit .* 9 to 23\.2 N·m"),
        ({"J": 150.0}, r"with J = 150 kg·m² rated torque takes 1.61e\+03 s to rated speed"),
        ({"T_N": 0.0146}, "T_N = 0.0146 N·m does not fit U_N, I_N, f_N and n_p"),
        ({"R_s": 1000.0}, r"R_s = 1000 Ω takes more than the rated voltage .* up to 46\.2 Ω"),
        ({"f_N": 314.16}, "T_N = 14.6 N·m does not fit"),
        ({"n_p": 4}, "T_N = 14.6 N·m does not fit .* and n_p pairs of poles"),
        ({"n_p": 1}, "T_N = 14.6 N·m does not fit"),
    ],
)
def test_a_rating_whose_values_do_not_fit_each_other_is_warned_of(
    change: dict[str, float], text: str
) -> None:
    with pytest.warns(sf.MachineWarning, match=text) as seen:
        sf.Motor.preset("2.2kW").replace(**change)
    assert seen[0].filename == __file__


def test_the_motors_of_the_package_fit_their_rating() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for motor in (*(drive.motor for drive in DRIVES.values()), *map(sf.Motor.preset, ("2.2kW", "11kW"))):
            assert motor.replace() == motor
            assert sf.Nameplate.of(motor).n_p == motor.n_p


def test_a_value_of_another_circuit_is_named_as_it_was_given() -> None:
    gamma: Any = {"R_s": 0.2, "R_r": 0.2, "L_l": 2e-3, "L_s": 0.06, **RATING}
    t_model: Any = {"R_s": 0.2, "R_r": 0.2, "L_ls": 1e-3, "L_lr": 1e-3, "L_m": 0.06, **RATING}
    for build, values, change, text in (
        (sf.Motor.gamma, gamma, {"L_s": 0.0}, r"L_s = 0 H is outside .* range 0\.000001 to 1000 H"),
        (sf.Motor.gamma, gamma, {"R_r": "x"}, "R_r = 'x' is not a number"),
        (sf.Motor.t_model, t_model, {"L_ls": -1e-3}, r"L_ls = -0\.001 H is outside .* range 0 to"),
        (sf.Motor.t_model, t_model, {"L_m": float("nan")}, "L_m = NaN H is outside"),
    ):
        with pytest.raises((ValueError, TypeError), match=text):
            build(**{**values, **change})
    one_side: Any = {**t_model, "L_ls": 0.0, "L_lr": 2e-3}
    assert sf.Motor.t_model(**one_side).L_sigma == pytest.approx(2e-3, rel=0.1)


def test_a_word_or_a_curve_that_is_none_is_named() -> None:
    with pytest.raises(TypeError, match="preset = 5 is not a text"):
        sf.Motor.preset(5)  # type: ignore[arg-type]
    for none in (5, np.array(5.0), b"abc", {"L_u": 1.0}):
        shown = re.escape(repr(none))
        with pytest.raises(TypeError, match=rf"saturation = {shown} is not \(L_u, a, S\), nor None"):
            sf.Motor.preset("2.2kW").replace(saturation=none)
