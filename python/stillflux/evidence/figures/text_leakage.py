"""Section III-E: "the machine parameters l_s and σl_s as functions of the load are determined by
self-commissioning"; here σl_s.

Bridges over closed slots saturate with the rotor current. The circle (12) with a σl_s that is δ too large is
one for another flux: by (14), linearised about rated flux,

    (2 - (l_s + σl_s) i_d) Δψ = (l_s i_s² - i_d) δ        per unit, ψ = 1

and the adaptation brings ψ̂ there by an error of r̂_s, Δr_s i_d ≈ ω_s Δψ. Without load l_s i_s² = i_d and δ
has no effect; it grows with i_q². The plant's leakage loses 40 % at rated rotor current. The drive is told
σl_s at the load that is held, as a commissioning finds it; the control is σl_s without load, as a constant.
At the 11-kW machine r_s is 0.02 per unit and δ doubles the error of r̂_s; at 2.2 kW, where it is 0.08, it adds
0.4 %.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import adaptation
from stillflux.evidence.figure import Control, Experiment, told_what_is_simulated
from stillflux.evidence.machines import motor_of, step
from stillflux.evidence.paper import (
    HOLD,
    identify_then,
    paper_drive,
    resistance_off,
    to_the_end,
    turned_by_at_most,
)
from stillflux.parameters import Motor
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOAD = 1.0
"""Of rated torque."""
LOST = 0.4
"""Share of the leakage that is lost at rated rotor current."""
_SETTLED = HOLD + 14.0
_ERROR = "r̂_s, deviation"


def rotor_current(motor: Motor, load: float) -> float:
    """Peak rotor current at a torque in units of rated torque, rated flux, A."""
    psi_R = motor.base["psi"] * motor.L_M / (motor.L_M + motor.L_sigma)
    return load * motor.T_N / (1.5 * motor.n_p * psi_R)


def at_load(motor: Motor, load: float) -> Motor:
    """The motor with the σl_s that its leakage has at a load."""
    rated = (1.0 - LOST) * motor.L_sigma * rotor_current(motor, 1.0)
    k = LOST / (1.0 - LOST) / rated**2
    current = rotor_current(motor, load)
    # L i = psi, L = L_0/(1 + k psi²): the one real root of k psi³ + psi = L_0 i.
    psi = np.roots([k, 0.0, 1.0, -motor.L_sigma * current])
    real = float(psi[np.argmin(np.abs(psi.imag))].real)
    return motor.replace(L_sigma=real / current)


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """ω = 0.03 at rated load, σl_s(i) told."""
    real = motor_of(machine)
    built = paper_drive(
        machine,
        arithmetic,
        name="σl_s(i) at rated load",
        omega=identify_then(0.03),
        load=step(HOLD, LOAD),
        duration=_SETTLED + 6.0,
        plant={"leakage_saturation": (LOST, rotor_current(real, 1.0))},
    )
    return built.replace(motor=at_load(real, LOAD), plant_motor=real)


@to_the_end
def claims(result: Result) -> list[Claim]:
    """r̂_s and the angle once the adaptation has settled."""
    return [
        at_most(_ERROR, resistance_off(result, _SETTLED), 2, "%").inner(),
        turned_by_at_most(3, "once it has settled", result.window(_SETTLED)),
    ]


def draw(result: Result) -> Figure:
    """Resistance, i_q, speed and angle from the load on."""
    return adaptation(result, HOLD - 0.5, [(HOLD, "rated load")])


EXPERIMENTS = (
    Experiment(
        "III-E-sigma",
        "σl_s as a function of the load",
        "The circle of (12) with σl_s(i)",
        scenario,
        claims,
        draw,
        Control(
            "σl_s without load as a constant",
            told_what_is_simulated,
            (_ERROR,),
            event=HOLD,
        ),
        machines=("11kW",),
    ),
)
