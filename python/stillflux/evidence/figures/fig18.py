"""Fig. 18: a minute at zero stator frequency, then a rated torque step; and the headline, with the load off
again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.draw import PerUnit, Strip, figure_of, parts, record, wide
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.machines import scaled, step
from stillflux.evidence.paper import (
    HOLD,
    IDENTIFIED,
    identify_then,
    offset_found,
    paper_drive,
    recovery,
    speed_kept,
    to_the_end,
    turned_by_at_most,
)
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOAD = HOLD + 61.5
"""The load is applied, s."""
END = LOAD + 6.0
"""The run ends; in the headline the load is removed, s."""


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """Start, offset found at 1 Hz, a minute at zero stator frequency, then a rated torque step."""
    return paper_drive(
        machine,
        arithmetic,
        name="Fig. 18",
        omega=identify_then(0.0),
        load=step(LOAD, 1.0),
        duration=END,
    )


def headline(machine: str, arithmetic: str = "f32") -> Scenario:
    """`scenario`, then the load is removed."""
    built = scenario(machine, arithmetic)
    load = [*step(LOAD, 1.0), (END, 1.0), (END, 0.0)]
    return built.replace(
        name=built.name.replace("Fig. 18", "zero stator frequency"),
        load_torque=scaled(load, built.motor.T_N),
        duration=END + 4.0,
    )


def at_rest(machine: str, arithmetic: str = "f32") -> Scenario:
    """`scenario` with the adaptation of Fig. 13a; the real resistance 1 % larger than the drive is told."""
    built = scenario(machine, arithmetic).with_settings(resistance_at_rest=True)
    real = built.motor.replace(R_s=1.01 * built.motor.R_s)
    return built.replace(name=built.name.replace("Fig. 18", "Fig. 18, adaptation at rest"), plant_motor=real)


@to_the_end
def claims(result: Result) -> list[Claim]:
    """A minute at zero stator frequency, then the rated step."""
    hold = result.window(HOLD + 1.0, LOAD - 1e-3)
    loaded = result.window(LOAD + 2.0, END)
    frequency = abs(metrics.turns(hold)[-1]) / np.ptp(hold.t) / result.scenario.motor.f_N
    return [
        offset_found(result.window(IDENTIFIED - 4.0, IDENTIFIED), 5),
        at_least("time at zero stator frequency", float(np.ptp(hold.t)), 60, "s"),
        at_most("mean stator frequency meanwhile", frequency, 5e-4, "pu"),
        turned_by_at_most(15, "meanwhile", hold),
        speed_kept("meanwhile", hold),
        recovery("rated", result.window(0.0, END), LOAD, 2),
        turned_by_at_most(15, "under rated load", loaded),
        speed_kept("under rated load", loaded),
    ]


def headline_claims(result: Result) -> list[Claim]:
    """Fig. 18, then no load again."""
    found = claims(result)
    if result.status == "running":
        unloaded = result.window(END + 2.0)
        found += [turned_by_at_most(15, "after the load", unloaded), speed_kept("after the load", unloaded)]
    return found


def draw(result: Result) -> Figure:
    """The minute, on scales of its own, and the torque step enlarged."""
    figure = figure_of(11.0, 6.6)
    left, right = parts(figure, 1, 2, width_ratios=(3, 2))
    minute = result.window(HOLD, min(LOAD - 1e-3, float(result.t[-1])))
    within = PerUnit(minute)

    def strips(pu: PerUnit, of_minute: bool) -> list[Strip]:
        speed, frequency, i_q, angle = pu.speed(), pu.frequency(), pu.i_q(), pu.angle(5.0)
        if not of_minute:
            return [speed, frequency, i_q, pu.i_alpha(), angle]
        # Scales of the minute: what the step does is enlarged on the right.
        scale = wide(within.omega_m(), 0.004)
        return [
            Strip(speed.label, speed.traces, scale),
            Strip(frequency.label, frequency.traces, wide(within.omega_s(), 0.004)),
            Strip(i_q.label, i_q.traces, wide(within.i("estimate.i_dq").imag, 0.1)),
            pu.i_alpha(),
            pu.delta(),
            angle,
        ]

    events = [(HOLD, "$\\omega_s$ = 0"), (LOAD, "rated load"), (END, "no load")]
    record(
        left, result, lambda pu: strips(pu, True), HOLD - 1.0, LOAD + 3.0, events=events, title="the minute"
    )
    record(
        right,
        result,
        lambda pu: strips(pu, False),
        LOAD - 0.3,
        LOAD + 1.2,
        events=events,
        title="the step enlarged",
    )
    return figure


_CONTROL = Control(
    "offset estimator off",
    settings(offset_estimator=False),
    ("field angle error meanwhile", "speed error meanwhile", "the drive runs to the end"),
    event=HOLD,
)

EXPERIMENTS = (
    Experiment(
        "18",
        "Rated step after a minute at zero stator frequency",
        "Field angle without drift, then full control",
        scenario,
        claims,
        draw,
        _CONTROL,
    ),
    Experiment(
        "18-at-rest",
        "The same with the adaptation of Fig. 13a, the winding 1 % warmer than known",
        "The minute and the step with the resistance adapted at rest",
        at_rest,
        claims,
        draw,
        _CONTROL,
    ),
    Experiment(
        "headline",
        "Zero stator frequency",
        "A minute at zero stator frequency, a rated torque step, no load again",
        headline,
        headline_claims,
        draw,
        _CONTROL,
        of_paper=False,
    ),
)
