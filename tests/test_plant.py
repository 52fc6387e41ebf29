"""Plant: against scipy on the same equations, and its interface."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stillflux as sf


@pytest.mark.parametrize("saturated", [False, True])
def test_agrees_with_solve_ivp(motor: sf.Motor, inverter: sf.Inverter, saturated: bool) -> None:
    """State error at most 1e-6 relative after a second of start-up at rated voltage under load."""
    g = motor.to_gamma()
    assert motor.saturation is not None
    L_u, a, S = motor.saturation

    def field(psi_s: complex, psi_r: complex) -> tuple[complex, float]:
        inverse = (1 + (a * abs(psi_s)) ** S) / L_u if saturated else 1 / g["L_s"]
        i_r = (psi_s - psi_r) / g["L_l"]
        return psi_s * inverse + i_r, 1.5 * motor.n_p * (psi_r.conjugate() * psi_s).imag / g["L_l"]

    def voltage(t: float) -> complex:
        return 200.0 * cmath.exp(2j * math.pi * 30.0 * t)

    def slope(x: np.ndarray, u: complex, load: float) -> list[float]:
        psi_s, psi_r, omega = complex(x[0], x[1]), complex(x[2], x[3]), x[4]
        i_s, torque = field(psi_s, psi_r)
        d_s = u - motor.R_s * i_s
        d_r = g["R_r"] / g["L_l"] * (psi_s - psi_r) + 1j * motor.n_p * omega * psi_r
        return [d_s.real, d_s.imag, d_r.real, d_r.imag, (torque - load) / motor.J]

    plant = sf.Plant(motor, inverter, saturation=saturated)
    dt, n = 1e-3, 1000
    x = np.zeros(5)
    for k in range(n):
        u, load = voltage(k * dt), 5.0 if k > 500 else 0.0
        plant.step_voltage(u, dt, load)
        x = solve_ivp(
            lambda _, x, u=u, load=load: slope(x, u, load),
            (0, dt),
            x,
            method="DOP853",
            rtol=1e-11,
            atol=1e-12,
        ).y[:, -1]
    state = plant.state
    assert state.t == pytest.approx(1.0)
    assert abs(state.psi_s - complex(x[0], x[1])) <= 1e-6 * abs(state.psi_s)
    i_s, torque = field(complex(x[0], x[1]), complex(x[2], x[3]))
    assert abs(state.i_s - i_s) <= 1e-6 * abs(i_s)
    assert state.omega_m == pytest.approx(x[4], rel=1e-6)
    assert state.torque == pytest.approx(torque, rel=1e-5)
    assert state.omega_m > 50.0


def test_duties_act_one_period_later(motor: sf.Motor) -> None:
    plant = sf.Plant(motor, sf.Inverter(u_th=0.0, dead_time=0.0, f_clk=0.0), adc_bits=0)
    first, u_dc = plant.step([0.6, 0.5, 0.4])
    assert np.abs(first).max() < 1e-9
    second, _ = plant.step([0.5, 0.5, 0.5])
    assert second[0] > 0.05
    assert u_dc == pytest.approx(540.0, abs=810.0 / 4096)


def test_averaged_follows_switching(motor: sf.Motor, inverter: sf.Inverter) -> None:
    torques = []
    for mode in ("switching", "averaged"):
        plant = sf.Plant(motor, inverter, mode=mode, speed=0.0)
        for k in range(5000):
            u = 0.06 * cmath.exp(2j * math.pi * 2.0 * k / inverter.f_s)
            duty = [0.5 + (u * cmath.exp(-2j * math.pi * p / 3)).real for p in range(3)]
            plant.step(duty)
        torques.append(plant.state.torque)
    assert torques[0] == pytest.approx(torques[1], rel=0.03)


def test_sensors(motor: sf.Motor, inverter: sf.Inverter) -> None:
    plant = sf.Plant(
        motor, inverter, current_offset=0.5j, adc_noise=0.01, adc_range=20.0, adc_bits=14, seed=3
    )
    twin = sf.Plant(motor, inverter, current_offset=0.5j, adc_noise=0.01, adc_range=20.0, adc_bits=14, seed=3)
    reading, _ = plant.sample()
    assert reading == pytest.approx([0.0, 0.5 * math.sqrt(0.75), -0.5 * math.sqrt(0.75)], abs=0.05)
    assert list(reading) == list(twin.sample()[0])
    plant.current_offset = (0.1, 0.2, 0.3)
    assert plant.sample()[0] == pytest.approx([0.1, 0.2, 0.3], abs=0.05)


def test_setters(motor: sf.Motor, inverter: sf.Inverter) -> None:
    plant = sf.Plant(motor, inverter)
    plant.R_s = 4.4
    plant.u_dc = 500.0
    plant.speed = 3.0
    plant.step([0.5] * 3)
    assert (plant.state.R_s, plant.state.u_dc, plant.state.omega_m) == (4.4, 500.0, 3.0)
    plant.set_state(1.0, 0.9j, 5.0)
    assert (plant.state.psi_s, plant.state.omega_m) == (1.0, 5.0)
    assert plant.state.psi_r == pytest.approx(0.9j)
    with pytest.raises(ValueError, match=r"R_s = -1 ohm .* range"):
        plant.R_s = -1.0
    with pytest.raises(ValueError, match="u_dc = NaN"):
        plant.u_dc = float("nan")


def test_errors(motor: sf.Motor, inverter: sf.Inverter) -> None:
    with pytest.raises(TypeError, match="'fricton'"):
        sf.Plant(motor, inverter, fricton=1.0)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match=r"viscous = -1 .* range 0 to"):
        sf.Plant(motor, inverter, viscous=-1.0)
    with pytest.raises(ValueError, match=r"mode = .*'averaged'"):
        sf.Plant(motor, inverter, mode="mean")
    with pytest.raises(ValueError, match="load_torque = NaN"):
        sf.Plant(motor, inverter).step([0.5] * 3, load_torque=float("nan"))
