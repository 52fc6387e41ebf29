"""Shafts so light that the largest torque accelerates them faster than a fixed speed estimator follows."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence.machines import ADC_NOISE
from stillflux.evidence.tolerance import start_up
from stillflux.options import DriveSettings

# That of the loop without what follows from the shaft, Hz.
FIXED = 25.0


def spindle(f_N: float, times: float) -> tuple[sf.Motor, sf.Inverter]:
    """A motor of 2 kW that 1.5 times its rated torque accelerates by so many times `ω_n²` of 25 Hz."""
    omega, U, I_N = 2.0 * math.pi * f_N, 380.0, 4.6
    z = U / math.sqrt(3.0) / I_N
    T_N = 2000.0 / (omega * 0.97)
    motor = sf.Motor.t_model(
        R_s=0.026 * z,
        R_r=0.02 * z,
        L_ls=0.1 * z / omega,
        L_lr=0.1 * z / omega,
        L_m=2.1 * z / omega,
        n_p=1,
        J=1.5 * T_N / (times * (2.0 * math.pi * FIXED) ** 2),
        U_N=U,
        I_N=I_N,
        f_N=f_N,
        T_N=T_N,
    )
    return motor, sf.Inverter(u_dc=540.0, f_s=20e3, u_th=1.0, dead_time=1e-6, c_out=0.3e-9)


def reversed_at(
    motor: sf.Motor, inverter: sf.Inverter, seed: int, settings: DriveSettings | None = None
) -> tuple[sf.Result, float]:
    """Steps to 0.8 pu and -0.8 pu without a ramp; and the largest error of the estimated speed, pu."""
    begin, fast = start_up(motor, inverter), 0.8 * motor.base["omega_m"]
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            duration=begin + 2.0,
            omega_ref=((0.0, 0.0), (begin, 0.0), (begin, fast), (begin + 1.0, fast), (begin + 1.0, -fast)),
            plant={"seed": seed, "adc_noise": ADC_NOISE * motor.I_N},
            settings=settings or {},
            signals=("omega_m", "estimate.omega_m", "angle_error", "status"),
        )
    )
    apart = result["estimate.omega_m"] - result["omega_m"]
    return result, float(np.abs(apart).max()) / motor.base["omega_m"]


@pytest.mark.parametrize(("f_N", "times"), [(300.0, 1.0), (300.0, 1.6), (400.0, 1.6), (400.0, 4.0)])
def test_the_speed_of_a_light_shaft_is_followed_at_the_largest_torque(f_N: float, times: float) -> None:
    motor, inverter = spindle(f_N, times)
    for seed in (1, 2, 3):
        result, apart = reversed_at(motor, inverter, seed)
        assert result.status.fault is None
        assert apart < 0.2
        running = result["status"] == sf.StatusCode.RUNNING
        assert np.abs(np.degrees(result["angle_error"][running])).max() < 10.0
        assert result["omega_m"][-1] / motor.base["omega_m"] == pytest.approx(-0.8, abs=0.01)
        # The loop of a heavier shaft slips turns.
        assert reversed_at(motor, inverter, seed, {"pll_bandwidth": FIXED})[1] > 0.4
