"""Drives drawn at random: motors of 0.18 to 250 kW and the bridges that feed them, one for each number.

Ten drives are few: what holds for them may hold by their choice. These have resistances, reactances and
inertias that follow the size as in catalogues, each with a spread of its own,

| quantity | of a motor of P kW | 1σ, log-normal, or range |
|---|---|---|
| rated power P | log-uniform from 0.18 to 250 | |
| pole pairs; rated frequency | 1, 2 (half of them), 3, 4; 50 (two fifths), 60, 87, 100 Hz | |
| rated voltage | 230, 400, 460 V up to 10 kW, 400, 460, 480 V above | |
| R_s; R_r/R_s | 0.062 P^-0.36 pu | 0.2; 0.55 … 0.95, and 0.1 |
| stator leakage; rotor leakage over it | 0.085 pu, ±0.02 | 0.15; 0.8 … 1.3 |
| L_m | 1.75 P^0.12 pu, a fifth less from three pole pairs on | 0.12 |
| time to rated speed with rated torque | 0.075 P^0.33 s | 0.4 |
| switching frequency | 8, 10, 16 kHz below 10 kW; 4, 5, 8 kHz below 80; 3, 4 kHz above | |
| dead time | 1 … 2.5 µs below 30 kW, 2 … 4 µs above | |
| threshold; differential resistance | 0.7 … 1.4 V; 0.006 pu | 0.3 |
| dc link over rated voltage | 1.35, up to 8 % more | |

with per-unit values of rated voltage and current. A switching frequency that leaves fewer than 40 periods in
a turn at rated frequency is raised to that: with fewer than 30 a drive does not go there.
"""

from __future__ import annotations

import math

import numpy as np

from stillflux.evidence.drives import DRIVES, TypicalDrive
from stillflux.parameters import Inverter, Motor

__all__ = ["DRAWN", "POPULATION", "drive", "drive_of"]

DRAWN = "drawn"
"""Name of the drive that is another one in every draw."""
POPULATION = 400
"""Drives of a campaign, one run of each on every course: about five minutes on two cores."""
_SEED = 77
_PERIODS = 40.0


def drive(number: int) -> TypicalDrive:
    """The drive of a number, from 0 on."""
    r = np.random.default_rng([_SEED, number])

    def about(sigma: float) -> float:
        return math.exp(sigma * float(r.standard_normal()))

    P = math.exp(r.uniform(math.log(0.18), math.log(250.0)))
    n_p = int(r.choice([1, 2, 2, 2, 3, 4]))
    f = float(r.choice([50.0, 50.0, 60.0, 87.0, 100.0]))
    U = float(r.choice([230.0, 400.0, 400.0, 460.0] if P < 10.0 else [400.0, 400.0, 460.0, 480.0]))
    R_s = 0.062 * P**-0.36 * about(0.2)
    R_r = R_s * r.uniform(0.55, 0.95) * about(0.1)
    X_ls = (0.085 + r.uniform(-0.02, 0.02)) * about(0.15)
    X_lr = X_ls * r.uniform(0.8, 1.3)
    X_m = 1.75 * P**0.12 * about(0.12) * (1.0 if n_p <= 2 else 0.8)
    I_N = P * 1e3 / (math.sqrt(3.0) * U * min(0.62 * P**0.07, 0.84))
    z, omega = U / (math.sqrt(3.0) * I_N), 2.0 * math.pi * f
    omega_N = omega / n_p * (1.0 - min(1.05 * R_r, 0.09))
    T = P * 1e3 / omega_N
    motor = Motor.t_model(
        R_s=R_s * z,
        R_r=R_r * z,
        L_ls=X_ls * z / omega,
        L_lr=X_lr * z / omega,
        L_m=X_m * z / omega,
        n_p=n_p,
        J=0.075 * P**0.33 * about(0.4) * T / omega_N,
        U_N=U,
        I_N=I_N,
        f_N=f,
        T_N=T,
    )
    f_s = r.choice([8e3, 10e3, 16e3] if P < 10.0 else [4e3, 5e3, 8e3] if P < 80.0 else [3e3, 4e3])
    inverter = Inverter(
        u_dc=1.35 * U * r.uniform(1.0, 1.08),
        f_s=max(float(f_s), _PERIODS * f),
        u_th=r.uniform(0.7, 1.4),
        r_d=0.006 * z * about(0.3),
        dead_time=(r.uniform(1.0, 2.5) if P < 30.0 else r.uniform(2.0, 4.0)) * 1e-6,
    )
    return TypicalDrive(motor, inverter)


def drive_of(machine: str, draw: int) -> TypicalDrive:
    """The drive of a name; `DRAWN`: that of the draw."""
    return drive(draw) if machine == DRAWN else DRIVES[machine]
