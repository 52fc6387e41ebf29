"""Section III-E: "the machine parameters l_s and σl_s as functions of the load are determined by
self-commissioning."

Fig. 13b at 70 % of rated flux, where the iron is no longer saturated: l_s of the 2.2-kW machine is a third
larger than at rated flux, and (12) is the wrong circle with the rated one. The drive is told l_s(ψ*) as a
commissioning finds it; the control is l_s as a constant. The 11-kW machine has no saturation: constant and
function are the same there, and only the 2.2-kW machine is shown. σl_s(i) is in `text_leakage`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import adaptation
from stillflux.evidence.figure import Control, Experiment, told_what_is_simulated
from stillflux.evidence.figures import fig13b
from stillflux.evidence.paper import HOLD, identified, resistance_off, to_the_end, turned_by_at_most
from stillflux.parameters import Motor
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FLUX = 0.7
"""Flux reference, per unit of rated flux."""
_BEFORE = "r̂_s before the change, deviation"
_TIME = "time until r̂_s is within 5 %"


def at_flux(motor: Motor, psi: float) -> Motor:
    """The motor with the l_s(ψ) of its saturation curve at a flux in per unit."""
    if motor.saturation is None:
        return motor
    L_u, a, S = motor.saturation
    return motor.replace(L_M=L_u / (1.0 + (a * psi * motor.base["psi"]) ** S) - motor.L_sigma)


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """Fig. 13b at reduced flux, l_s(ψ*) told."""
    built = fig13b.scenario(machine, arithmetic).with_settings(psi_ref=FLUX)
    real = built.motor
    return built.replace(name="l_s(ψ) at 70 % flux", motor=at_flux(real, FLUX), plant_motor=real)


@to_the_end
def claims(result: Result) -> list[Claim]:
    """r̂_s right before the change and soon after it."""
    before = resistance_off(result, fig13b.CHANGE - 1.0, fig13b.CHANGE - 1e-3)
    return [
        at_most(_BEFORE, before, 3, "%").inner(),
        at_most(_TIME, identified(result, fig13b.CHANGE, 0.05), 1.5, "s").inner(),
        turned_by_at_most(15, "from the change on", result.window(fig13b.CHANGE)),
    ]


def draw(result: Result) -> Figure:
    """Resistance, i_q, speed and angle from the load on."""
    return adaptation(result, HOLD - 0.5, [(HOLD, "30 % load"), (fig13b.CHANGE, "$r_s$ + 25 %")])


EXPERIMENTS = (
    Experiment(
        "III-E-l_s",
        "l_s as a function of the flux",
        "The circle of (12) with l_s(ψ)",
        scenario,
        claims,
        draw,
        Control(
            "l_s of rated flux as a constant",
            told_what_is_simulated,
            (_BEFORE, _TIME, "the drive runs to the end"),
            event=HOLD,
        ),
        machines=("2.2kW",),
    ),
)
