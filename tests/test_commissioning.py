"""From the nameplate to a running drive."""

from __future__ import annotations

import pickle

import pytest

import stillflux as sf

PLATE = sf.Nameplate(P_N=4000.0, U_N=400.0, I_N=8.2, f_N=50.0, n_N=1435.0, cos_phi=0.82)


def test_a_nameplate_is_a_motor_with_deviations() -> None:
    motor = PLATE.motor()
    assert motor.n_p == 2
    assert abs(motor.T_N - 26.62) < 0.01
    for value, low, high in ((motor.R_s, 0.7, 2.5), (motor.R_R, 0.7, 2.5), (motor.L_M, 0.1, 0.25)):
        assert low < value < high
    assert set(PLATE.deviation) == {"R_s", "R_R", "L_sigma", "L_M", "J"}
    assert all(0.01 < x < 0.6 for x in PLATE.deviation.values())
    assert pickle.loads(pickle.dumps(PLATE)) == PLATE
    known = PLATE.replace(T_max=80.0, J=0.02)
    assert known.deviation["L_sigma"] < PLATE.deviation["L_sigma"]
    assert known.motor().J == 0.02


@pytest.mark.parametrize(
    ("change", "field"),
    [({"n_N": 1500.0}, "n_N"), ({"P_N": 6000.0}, "P_N"), ({"cos_phi": 1.2}, "cos_phi"), ({"J": -1.0}, "J")],
)
def test_an_impossible_nameplate_names_the_value_and_its_range(change: dict[str, float], field: str) -> None:
    with pytest.raises(ValueError, match=rf"{field} = .* range .* to "):
        PLATE.replace(**change)
