"""The ten drives on which tolerances are shown: from 0.37 to 160 kW, one at 48 V, one slow fan.

T parameters with equal leakages as data sheets and manufacturers' equivalent circuits give them for such
sizes; the presets are those of the paper. The traction machine has a pull-out torque of about twice its
rated torque (`3/2 n_p ψ_s² L_M/(2 L_σ L_s)`), the others of 2.8 to 5.3 times, the 11-kW preset of 11 times.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from stillflux.parameters import PRESETS, Inverter, Motor, Rating

__all__ = ["DRIVES", "TypicalDrive", "pull_out"]


@dataclass(frozen=True)
class TypicalDrive:
    """A motor and the inverter that feeds it, as the drive is told of them but for the node capacitance."""

    motor: Motor
    inverter: Inverter


def _rating(n_p: int, J: float, U_N: float, I_N: float, f_N: float, T_N: float) -> Rating:
    return {"n_p": n_p, "J": J, "U_N": U_N, "I_N": I_N, "f_N": f_N, "T_N": T_N}


def _drive(
    circuit: tuple[float, float, float, float],
    rating: Rating,
    bridge: tuple[float, float, float, float, float],
) -> TypicalDrive:
    """From (R_s, R_r, one leakage, L_m), a rating, and (u_dc, f_s, u_th, r_d, dead time)."""
    R_s, R_r, L_l, L_m = circuit
    u_dc, f_s, u_th, r_d, dead_time = bridge
    return TypicalDrive(
        Motor.t_model(R_s=R_s, R_r=R_r, L_ls=L_l, L_lr=L_l, L_m=L_m, **rating),
        Inverter(u_dc=u_dc, f_s=f_s, u_th=u_th, r_d=r_d, dead_time=dead_time),
    )


DRIVES: Mapping[str, TypicalDrive] = {
    **{name: TypicalDrive(Motor.preset(name), Inverter.preset(name)) for name in PRESETS},
    "0.37kW": _drive(
        (24.0, 17.0, 55e-3, 1.0), _rating(2, 0.0009, 400.0, 1.1, 50.0, 2.6), (540.0, 10e3, 1.0, 0.5, 2e-6)
    ),
    "0.75kW": _drive(
        (11.5, 8.0, 34e-3, 0.63), _rating(2, 0.0021, 400.0, 1.9, 50.0, 5.1), (540.0, 10e3, 1.0, 0.4, 2e-6)
    ),
    "4kW": _drive(
        (1.4, 1.1, 7.5e-3, 0.16), _rating(2, 0.0135, 400.0, 8.2, 50.0, 26.6), (540.0, 10e3, 1.0, 0.1, 2e-6)
    ),
    "15kW": _drive(
        (0.26, 0.17, 2.2e-3, 57e-3),
        _rating(2, 0.11, 400.0, 28.5, 50.0, 98.0),
        (540.0, 8e3, 1.1, 0.03, 2.5e-6),
    ),
    "45kW": _drive(
        (0.06, 0.036, 0.8e-3, 24e-3),
        _rating(2, 0.5, 400.0, 81.0, 50.0, 291.0),
        (540.0, 5e3, 1.2, 0.012, 3e-6),
    ),
    "160kW": _drive(
        (0.0105, 0.0067, 0.27e-3, 8.4e-3),
        _rating(2, 2.9, 400.0, 275.0, 50.0, 1030.0),
        (540.0, 4e3, 1.3, 0.004, 3e-6),
    ),
    "48V": _drive(
        (0.013, 0.01, 44e-6, 1.5e-3),
        _rating(2, 0.02, 34.0, 120.0, 100.0, 16.0),
        (56.0, 16e3, 0.05, 0.002, 0.8e-6),
    ),
    "fan": _drive(
        (0.9, 0.75, 6e-3, 60e-3), _rating(4, 1.0, 400.0, 13.5, 50.0, 73.0), (540.0, 10e3, 1.0, 0.06, 2e-6)
    ),
}
"""By name."""


def pull_out(motor: Motor) -> float:
    """Pull-out torque at rated stator flux, in units of rated torque."""
    flux = motor.base["psi"]
    return 1.5 * motor.n_p * flux**2 * motor.L_M / (2.0 * motor.L_sigma * motor.L_s) / motor.T_N
