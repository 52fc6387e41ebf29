"""Fig. 14: the winding heats up at high speed, where its resistance cannot be seen.

Loaded to one half; the paper does not give the load. The adaptation starts as soon as ω_s is low enough on
the way down. At more than 60 % load it is slowed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.machines import motor_of, step
from stillflux.evidence.paper import (
    RUN,
    identified,
    paper_drive,
    resistance_error,
    runs_to_the_end,
    turned_by_at_most,
)
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UP, _TOP, _WARMING, _DOWN, _BACK = 9.0, 10.5, 11.0, 18.0, 20.0
_FOUND = "time until r̂_s is within 3 % after the return to ω = 0.02"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """Half load; cold at ω = 0.02, up to 0.5, there 25 % warmer within 6 s, down again within 2 s."""
    R_s = motor_of(machine).R_s
    warming = [(_WARMING + 0.1 * k, {"R_s": R_s * (1.0 + 0.25 * k / 60)}) for k in range(61)]
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 14",
        omega=[(0.0, 0.02), (_UP, 0.02), (_TOP, 0.5), (_DOWN, 0.5), (_BACK, 0.02)],
        load=step(7.0, 0.5),
        duration=_BACK + 4.0,
        changes=warming,
    )


def claims(result: Result) -> list[Claim]:
    """r̂_s lost at high speed, found at once after the return, control never lost."""
    if result.status != "running":
        return [runs_to_the_end(result)]
    top, cold = result.window(_DOWN - 0.5, _DOWN), result.window(_UP - 0.5, _UP)
    behind = 100 * float(np.abs(resistance_error(top)).mean())
    before = 100 * float(np.abs(resistance_error(cold)).max())
    return [
        runs_to_the_end(result),
        turned_by_at_most(15, "throughout", result.window(RUN + 0.2)),
        at_most("r̂_s before the acceleration, deviation", before, 3, "%").inner(),
        at_least("r̂_s at high speed, deviation", behind, 10, "%").inner(),
        at_most(_FOUND, identified(result, _BACK, 0.03), 0.5, "s").inner(),
    ]


def draw(result: Result) -> Figure:
    """Speed, current, resistance over the excursion."""
    return recording(
        result,
        lambda pu: [pu.speed(), pu.i_q(), pu.i_alpha(), pu.r_s(), pu.angle(5.0)],
        6.0,
        size=(7.5, 5.4),
    )


EXPERIMENTS = (
    Experiment(
        "14",
        "Fast identification after a transient from high speed",
        "r̂_s right at once on return to very low speed",
        scenario,
        claims,
        draw,
        Control(
            "resistance adaptation off",
            settings(resistance_adaptation=False),
            (_FOUND, "the drive runs to the end"),
            event=_WARMING,
        ),
    ),
)
