"""What the static limits of a machine and its inverter allow: largest torque and shortest time to a speed.

Steady states in coordinates of the stator flux (per unit, `docs/gains.md`), with the flux and the torque
current free:

    i_d by (12),   ω_s = ω + r_R ψ_s i_q/|ψ_R|²,   |u|² = (r_s i_d)² + (r_s i_q + ω_s ψ_s)²
    |i| ≤ i_max,   |u| ≤ 0.98 u_dc/√3,   ψ_s ≤ rated,   |T| ≤ T_max,   i_q up to pull-out

The time is the integral of `J dω/T_max(ω)`: the speed follows no torque but these, and the flux is where each
wants it at once.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from stillflux.parameters import Inverter, Motor

__all__ = ["largest_torque", "shortest_time"]

_UTILISATION = 0.98 / np.sqrt(3.0)


@cache
def _settings(motor: Motor, inverter: Inverter) -> dict[str, float]:
    return {"i_max": 1.8 * np.sqrt(2.0) * motor.I_N, "torque_max": 1.5 * motor.T_N}


def largest_torque(motor: Motor, inverter: Inverter, omega: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest steady motoring torque in N·m at speeds in per unit, with default settings."""
    base, settings = motor.base, _settings(motor, inverter)
    r_s, r_R = (motor.R_s + inverter.r_d) / base["z"], motor.R_R / base["z"]
    l_s, sl_s = motor.L_s / base["l"], motor.L_sigma / base["l"]
    i_max, u_max = settings["i_max"] / base["i"], _UTILISATION * inverter.u_dc / base["u"]
    psi, part = np.meshgrid(np.linspace(0.0125, 1.0, 80), np.linspace(0.0, 1.0, 201), indexing="ij")
    i_q = part * psi * (1.0 - sl_s / l_s) / (2.0 * sl_s)
    b, product = (l_s + sl_s) * psi, l_s * sl_s
    root = np.sqrt(np.maximum(b * b - 4.0 * product * (psi * psi + product * i_q * i_q), 0.0))
    i_d = (b - root) / (2.0 * product)
    psi_R = np.hypot(psi - sl_s * i_d, sl_s * i_q)
    slip = r_R * psi * i_q / psi_R**2
    within = i_d**2 + i_q**2 <= i_max**2
    torque = psi * i_q
    found = [
        torque[within & ((r_s * i_d) ** 2 + (r_s * i_q + (w + slip) * psi) ** 2 <= u_max**2)].max(initial=0.0)
        for w in np.atleast_1d(omega)
    ]
    limited: NDArray[np.float64] = np.minimum(np.array(found) * base["torque"], settings["torque_max"])
    return limited


@cache
def shortest_time(motor: Motor, inverter: Inverter, omega: float) -> float:
    """Shortest time in s from rest to a speed in per unit, without load, with the motor's inertia."""
    steps = 40
    speeds = (np.arange(steps) + 0.5) * omega / steps
    rise = motor.base["omega_m"] * omega / steps
    return float(np.sum(motor.J * rise / largest_torque(motor, inverter, speeds)))
