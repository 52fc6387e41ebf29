"""Fig. 19: 120 % torque step at zero speed.

The negative control is r̂_s, which the step leans on: before it, without load at zero stator frequency, a
wrong one does no harm and cannot be seen; under load Δr_s i_s stands against an induced voltage that begins
at zero. The noise compensator is none: switched off as a whole it loses the drive during the 12 s at 1 Hz
before, and with its floor off (`noise_gain=(0, …)`), so that it is off at zero stator frequency alone, the
step is held as well. Nor is the offset estimator: without it the speed leaves its band before the step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stillflux.evidence.claims import Claim
from stillflux.evidence.draw import Strip, recording
from stillflux.evidence.figure import Experiment, warmer_winding
from stillflux.evidence.machines import step
from stillflux.evidence.paper import (
    HOLD,
    identify_then,
    paper_drive,
    recovery,
    runs_to_the_end,
    turned_by_at_most,
)
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOAD = HOLD + 3.0
"""The load is applied, s."""


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """120 % torque step at zero speed."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 19",
        omega=identify_then(0.0),
        load=step(LOAD, 1.2),
        duration=LOAD + 4.0,
    )


def claims(result: Result) -> list[Claim]:
    """The 120 % step."""
    if result.status != "running":
        return [runs_to_the_end(result)]
    return [
        runs_to_the_end(result),
        recovery("120 %", result, LOAD, 1),
        turned_by_at_most(5, "from 1 s after the step", result.window(LOAD + 1.0)),
    ]


def draw(result: Result) -> Figure:
    """The step, expanded."""
    return recording(
        result,
        lambda pu: [
            pu.speed(),
            Strip("$T/T_N$", [("load", pu.torque("load_torque")), ("motor", pu.torque())], unit=""),
            pu.i_q(),
            pu.i_alpha(),
            pu.angle(5.0),
        ],
        LOAD - 0.5,
        LOAD + 2.0,
        events=[(LOAD, "120 % load")],
    )


EXPERIMENTS = (
    Experiment(
        "19",
        "120 % step at zero speed",
        "Zero speed again after a short transient",
        scenario,
        claims,
        draw,
        warmer_winding(
            LOAD, ("speed back within ±0.002 pu after the 120 % step", "the drive runs to the end")
        ),
    ),
)
