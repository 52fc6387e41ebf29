"""Fig. 17: zero speed under a load that falls in steps; 130 % in the caption, 120 % in the text."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, Limit, settings
from stillflux.evidence.paper import HOLD, identify_then, paper_drive, runs_to_the_end, speed_kept
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEGIN, _STAY = HOLD + 2.0, 4.0
_PARTS = (1.0, 0.75, 0.5, 0.25, 0.0)
_LOADED = "speed error under every load, from 1.5 s after the step"
_AT_REST = "stator frequency at the end"


def scenario(machine: str, arithmetic: str = "f32", load: float = 1.3) -> Scenario:
    """`load` times rated torque at zero speed, taken away in four steps."""
    profile = [(0.0, 0.0), (_BEGIN, 0.0)]
    for k, part in enumerate(_PARTS):
        begin = _BEGIN + k * _STAY
        profile += [(begin, load * part), (begin + _STAY, load * part)]
    return paper_drive(
        machine,
        arithmetic,
        name=f"Fig. 17, {100 * load:.0f} %",
        omega=identify_then(0.0),
        load=profile,
        duration=profile[-1][0] + 4.0,
    )


def claims(result: Result) -> list[Claim]:
    """Speed held at every load, ends at zero stator frequency."""
    if result.status != "running":
        return [runs_to_the_end(result)]
    errors = []
    for k in range(len(_PARTS)):
        until = _BEGIN + (k + 1) * _STAY
        errors.append(np.abs(metrics.speed_error(result.window(until - 2.5, until - 1e-3))).max())
    end = result.window(result.t[-1] - 4.0)
    frequency = abs(float(end["omega_s"].mean())) / result.scenario.motor.base["omega"]
    return [
        runs_to_the_end(result),
        at_most(_LOADED, max(errors), 0.002, "pu"),
        at_most(_AT_REST, frequency, 5e-4, "pu"),
        speed_kept("at the end", end),
    ]


def draw(result: Result) -> Figure:
    """Stator frequency on top, speed, load, current."""
    return recording(
        result,
        lambda pu: [pu.frequency(), pu.speed(), pu.i_q(), pu.i_alpha(), pu.angle(5.0)],
        _BEGIN - 2.0,
        size=(7.5, 6.6),
        events=[(_BEGIN + k * _STAY, f"{100 * part:.0f} %") for k, part in enumerate(_PARTS)],
    )


def _experiment(name: str, load: float, limits: dict[str, Limit] | None = None) -> Experiment:
    return Experiment(
        name,
        f"Zero speed, load from {100 * load:.0f} % to none in steps",
        "Speed held, ends at zero stator frequency",
        partial(scenario, load=load),
        claims,
        draw,
        Control(
            "offset estimator off",
            settings(offset_estimator=False),
            (_LOADED, "the drive runs to the end"),
            event=HOLD,
        ),
        limits=limits or {},
    )


_WANDERING = Limit(
    (_AT_REST,),
    "In one of five realisations of the noise the mean over the last four seconds is 0.0006 pu, in the "
    "others at most 0.0003 pu. Without load and friction a remaining offset voltage d makes the standing "
    "field swing like a pendulum of the period 2π √(τ_r/d), some ten seconds: four of them do not average "
    "to zero.",
)

EXPERIMENTS = (_experiment("17-130", 1.3, {"2.2kW": _WANDERING}), _experiment("17-120", 1.2))
