"""Fig. 13b: the stator resistance rises to 125 % in a step at ω = 0.01 under 30 % load.

What the paper shows is a response time of 280 ms and "the temporary increase of i_q". With r̂_s < r_s the
estimate ψ̂_s = ψ_s + Δr ∫ i_s dτ leans towards the current and leads while motoring; the same current, seen
from a leading frame, has less i_q, by i_d sin(δ̂ - δ). So i_q first falls (for as long as r̂_s lags) and
then, as speed control makes up for the torque lost, rises above what it was: the increase is judged over the
whole oscillation, 3 s, against what i_q does in as long a time before.

"12-quotient" is the same with the quotient of the caption of Fig. 12 (N: numerator, D: denominator). In
the steady state ε = -2 ψ* Δr_s i_q/ω_s, so that with N = ε ω̂_s and D = i_q the path carries -2 ψ* Δr_s: the
error itself, with its sign. That accounts for the sign schedule that the law with sign(ω̂_s i_q) needs, and
makes the response the same at every speed and load. The sign law is the same quotient with its size left
out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_least, at_most, reported
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.machines import motor_of, step
from stillflux.evidence.paper import (
    HOLD,
    identified,
    identify_then,
    paper_drive,
    to_the_end,
    turned_by_at_most,
)
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANGE = HOLD + 8.0
"""The resistance changes, s."""
_TIME = "time until r̂_s is within 5 %"
_RISE = "rise of i_q within 3 s over its largest excursion in 3 s before"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """ω = 0.01 at 30 % load."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 13b",
        omega=identify_then(0.01),
        load=step(HOLD, 0.3),
        duration=CHANGE + 8.0,
        changes=[(CHANGE, {"R_s": 1.25 * motor_of(machine).R_s})],
    )


@to_the_end
def claims(result: Result) -> list[Claim]:
    """r̂_s within 5 % after 280 ms ± 30 %, i_q rises meanwhile."""
    time = 1e3 * identified(result, CHANGE, 0.05)
    i_q = metrics.smoothed(result["estimate.i_dq"].imag, 50)
    before = i_q[(result.t > CHANGE - 3.0) & (result.t < CHANGE)]
    mean = before.mean()
    during = i_q[(result.t > CHANGE) & (result.t < CHANGE + 3.0)]
    rise, fall = 100 * float(during.max() / mean - 1), 100 * float(1 - during.min() / mean)
    usual = 100 * float(np.abs(before / mean - 1).max())
    left = 100 * abs(float(i_q[result.t > result.t[-1] - 1.0].mean() / mean - 1))
    return [
        at_least(_TIME, time, 0.7 * 280, "ms").inner(),
        at_most(_TIME, time, 1.3 * 280, "ms").inner(),
        at_least(_RISE, rise / usual, 1.5, note=f"{rise:.2g} % against {usual:.2g} %"),
        reported("fall of i_q before", fall, "%"),
        at_most("change of i_q left at the end", left, 5, "%"),
        turned_by_at_most(15, "from the change on", result.window(CHANGE)),
    ]


def draw(result: Result) -> Figure:
    """Resistance, i_q, speed and field angle error about the step of r_s."""
    return recording(
        result,
        lambda pu: [pu.r_s(), pu.i_q(), pu.i_alpha(), pu.speed(), pu.angle(5.0)],
        CHANGE - 1.0,
        CHANGE + 4.0,
        (7.5, 6.0),
        events=[(CHANGE, "$r_s$ + 25 %")],
    )


EXPERIMENTS = (
    Experiment(
        "13b",
        "Resistance step at 30 % load",
        "r̂_s right after 280 ms, i_q rises meanwhile",
        scenario,
        claims,
        draw,
        Control(
            "resistance adaptation off",
            settings(resistance_adaptation=False),
            (_TIME, "the drive runs to the end"),
            event=CHANGE,
        ),
    ),
)
