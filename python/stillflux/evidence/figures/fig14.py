"""Fig. 14: the resistance known at very low speed around a transient to high speed. (a) Acceleration of the
cold machine, (b) deceleration of the heated one.

In (a) the winding is 15 % colder than what the drive is told. It is found on the way to very low speed, from
where the drive accelerates to a speed at which it cannot be seen. In (b) the winding heats up by 25 % at
high speed and the drive comes back. Loaded to one half; the paper does not give the load. The adaptation
starts as soon as ω_s is low enough on the way down. At more than 60 % load it is slowed.
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
    to_the_end,
    turned_by_at_most,
)
from stillflux.metrics import resistance_error
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOAD, _UP, _TOP, _WARMING, _DOWN, _BACK = 7.0, 9.0, 10.5, 11.0, 18.0, 20.0
_COLD_LOAD, _COLD_DOWN, _COLD_LOW, _COLD_UP, _COLD_TOP = 4.0, 6.0, 8.0, 11.0, 12.5
_FOUND = "time until r̂_s is within 3 % after the return to ω = 0.02"
_COLD = "time until r̂_s is within 3 % once at ω = 0.02"
_AT_TOP = "r̂_s when the acceleration is over, deviation"


def cold(machine: str, arithmetic: str = "f32") -> Scenario:
    """(a): the winding 15 % colder than known; half load, down to ω = 0.02, then up to 0.5."""
    motor = motor_of(machine)
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 14a",
        omega=[(0.0, 0.1), (_COLD_DOWN, 0.1), (_COLD_LOW, 0.02), (_COLD_UP, 0.02), (_COLD_TOP, 0.5)],
        load=step(_COLD_LOAD, 0.5),
        duration=_COLD_TOP + 2.0,
        plant_motor=motor.replace(R_s=0.85 * motor.R_s),
    )


def heated(machine: str, arithmetic: str = "f32") -> Scenario:
    """(b): half load; cold at ω = 0.02, up to 0.5, there 25 % warmer within 6 s, down again within 2 s."""
    R_s = motor_of(machine).R_s
    warming = [(_WARMING + 0.1 * k, {"R_s": R_s * (1.0 + 0.25 * k / 60)}) for k in range(61)]
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 14b",
        omega=[(0.0, 0.02), (_UP, 0.02), (_TOP, 0.5), (_DOWN, 0.5), (_BACK, 0.02)],
        load=step(_LOAD, 0.5),
        duration=_BACK + 4.0,
        changes=warming,
    )


@to_the_end
def cold_claims(result: Result) -> list[Claim]:
    """Found at very low speed before the acceleration, kept through it."""
    before = 100 * float(np.abs(resistance_error(result.window(_COLD_LOAD - 0.5, _COLD_LOAD))).min())
    top = 100 * float(np.abs(resistance_error(result.window(_COLD_TOP))).max())
    found = identified(result.window(0.0, _COLD_UP), _COLD_LOW, 0.03)
    return [
        at_least("r̂_s at the start, deviation", before, 10, "%").inner(),
        at_most(_COLD, found, 0.5, "s").inner(),
        at_most(_AT_TOP, top, 5, "%").inner(),
        turned_by_at_most(15, "from the load on", result.window(_COLD_LOAD)),
    ]


@to_the_end
def heated_claims(result: Result) -> list[Claim]:
    """r̂_s lost at high speed, found at once after the return, control never lost."""
    top, start = result.window(_DOWN - 0.5, _DOWN), result.window(_UP - 0.5, _UP)
    behind = 100 * float(np.abs(resistance_error(top)).mean())
    before = 100 * float(np.abs(resistance_error(start)).max())
    return [
        turned_by_at_most(15, "throughout", result.window(RUN + 0.2)),
        at_most("r̂_s before the acceleration, deviation", before, 3, "%").inner(),
        at_least("r̂_s at high speed, deviation", behind, 10, "%").inner(),
        at_most(_FOUND, identified(result, _BACK, 0.03), 0.5, "s").inner(),
    ]


def draw_cold(result: Result) -> Figure:
    """Speed, current, resistance over the acceleration."""
    return recording(
        result,
        lambda pu: [pu.speed(), pu.i_q(), pu.i_alpha(), pu.r_s((0.75, 1.1)), pu.angle(5.0)],
        _COLD_LOAD - 1.0,
        size=(7.5, 6.0),
        events=[(_COLD_LOAD, "half load"), (_COLD_LOW, "very low speed"), (_COLD_UP, "acceleration")],
    )


def draw_heated(result: Result) -> Figure:
    """Speed, current, resistance over the excursion."""
    return recording(
        result,
        lambda pu: [pu.speed(), pu.i_q(), pu.i_alpha(), pu.r_s(), pu.angle(5.0)],
        6.0,
        size=(7.5, 6.0),
        events=[(_WARMING, "heats up"), (_DOWN, "deceleration"), (_BACK, "back")],
    )


def _control(event: float, *expected: str) -> Control:
    return Control(
        "resistance adaptation off",
        settings(resistance_adaptation=False),
        (*expected, "the drive runs to the end"),
        event=event,
    )


EXPERIMENTS = (
    Experiment(
        "14a",
        "Acceleration of the cold machine",
        "r̂_s found at very low speed, kept through the acceleration",
        cold,
        cold_claims,
        draw_cold,
        _control(_COLD_LOAD, _COLD, _AT_TOP),
    ),
    Experiment(
        "14b",
        "Deceleration of the heated machine",
        "r̂_s right at once on return to very low speed",
        heated,
        heated_claims,
        draw_heated,
        _control(_WARMING, _FOUND),
    ),
)
