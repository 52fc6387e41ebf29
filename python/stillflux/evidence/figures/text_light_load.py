"""Section III-E: the method of [9] at light load beside the MRAS, and the hand-over between them.

"However, [...] it does require a minimum torque current of about 15 % i_qR [...]. The method described in
[9] is, therefore, preferred at light load, but its use must be inhibited at very low speed as it becomes
inaccurate." `estimate/light_load.rs` has the equations: the induced voltage stands at right angles to a flux
that is found without the resistance. The winding gets 12 % warmer at 6 % load, where the MRAS is frozen;
then the load rises to one half and the MRAS goes on with the same integrator, and back. (By 25 % in a step
the error of angle alone would raise i_q above the 15 %.)

How well this can be seen follows from the circle that any steady-state method has to use, since two measured
voltages are to tell r_s and the slip. The torque T is the root of (l_s i² - D)(D - σl_s i²): a relative
error e of l_s i² makes an error of r̂_s of ω_s e l_s (D - σl_s i²)/(2 T). Here that is 0.86 e (2.2 kW) and
0.80 e (11 kW), for e = 1 % a tenth and a third of r_s. So voltage and current are filtered before their
products, which frees them of the harmonics of the bridge, the method begins 5 τ_r after a change of load, and
r̂_s moves with a time constant of 10 τ_r.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.draw import adaptation
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.machines import motor_of
from stillflux.evidence.paper import (
    HOLD,
    IDENTIFIED,
    identify_then,
    paper_drive,
    resistance_off,
    to_the_end,
    turned_by_at_most,
)
from stillflux.metrics import resistance_error
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CHANGE, _LOADED, _LIGHT = HOLD + 4.0, HOLD + 9.0, HOLD + 12.0
_FOUND = "r̂_s at light load, deviation 5 s after the change"
_TAKEN_OVER = "r̂_s at half load, deviation from 1 s after the hand-over"
_CHANGED = "change of the deviation of r̂_s by the step"
_BACK = "r̂_s at light load again, deviation"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """ω = 0.075; 6 % load, the winding 12 % warmer, half load, 6 % again."""
    return paper_drive(
        machine,
        arithmetic,
        name="method of [9] at light load",
        omega=identify_then(0.075),
        load=[
            (0.0, 0.0),
            (IDENTIFIED, 0.0),
            (IDENTIFIED, 0.06),
            (_LOADED, 0.06),
            (_LOADED, 0.5),
            (_LIGHT, 0.5),
            (_LIGHT, 0.06),
        ],
        duration=_LIGHT + 3.0,
        changes=[(_CHANGE, {"R_s": 1.12 * motor_of(machine).R_s})],
    ).with_settings(resistance_at_light_load=True)


@to_the_end
def claims(result: Result) -> list[Claim]:
    """Found at light load, taken over under load, kept afterwards."""
    at_change = result.window(_CHANGE - 0.02, _CHANGE + 0.02)
    return [
        at_least(_CHANGED, float(np.ptp(100 * resistance_error(at_change))), 8, "%").inner(),
        at_most(_FOUND, resistance_off(result, _LOADED - 0.1, _LOADED - 1e-3), 5, "%").inner(),
        at_most(_TAKEN_OVER, resistance_off(result, _LOADED + 1.0, _LIGHT), 5, "%").inner(),
        at_most(_BACK, resistance_off(result, _LIGHT + 1.0, _LIGHT + 3.0), 5, "%").inner(),
        turned_by_at_most(15, "from the change on", result.window(_CHANGE)),
    ]


def draw(result: Result) -> Figure:
    """Resistance and current over the hand-over."""
    return adaptation(result, HOLD, [(_CHANGE, "$r_s$ + 12 %"), (_LOADED, "half load"), (_LIGHT, "6 %")])


EXPERIMENTS = (
    Experiment(
        "III-E-light",
        "Resistance at light load by the method of [9], hand-over to the MRAS",
        "r̂_s found where the MRAS cannot, handed over",
        scenario,
        claims,
        draw,
        Control(
            "no adaptation at light load",
            settings(resistance_at_light_load=False),
            (_FOUND,),
            event=_CHANGE,
        ),
    ),
)
