"""Fig. 17: zero speed under a load that falls in steps; 130 % in the caption, 120 % in the text.

"Stable zero stator frequency operation is finally reached at no load." What is left of ω_s there is that of
the angle error θ: without load the torque current is `-i_d θ` in the frame of the drive, which sees a slip of
-θ/τ_r and turns the field by it, 0.0005 pu (2.2 kW) or 0.0002 pu (11 kW) for each degree. So the field creeps
until a phase current passes zero; there the voltage of that leg is another one (Fig. 6) and θ changes by
about a degree, either way. It counts as zero frequency if the mean over 12 s is closer to zero than to the
lowest speed that the paper names, 0.003 (Fig. 20): less than half of it.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.paper import HOLD, identify_then, paper_drive, runs_to_the_end, speed_kept
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEGIN, _STAY = HOLD + 2.0, 4.0
_AT_REST_FOR = 12.0
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
        duration=profile[-1][0] + _AT_REST_FOR,
    )


def claims(result: Result) -> list[Claim]:
    """Speed held at every load, ends at zero stator frequency."""
    if result.status != "running":
        return [runs_to_the_end(result)]
    errors = []
    for k in range(len(_PARTS)):
        until = _BEGIN + (k + 1) * _STAY
        errors.append(np.abs(metrics.speed_error(result.window(until - 2.5, until - 1e-3))).max())
    end = result.window(result.t[-1] - _AT_REST_FOR)
    frequency = abs(float(end["omega_s"].mean())) / result.scenario.motor.base["omega"]
    return [
        runs_to_the_end(result),
        at_most(_LOADED, max(errors), 0.002, "pu"),
        at_most(_AT_REST, frequency, 0.0015, "pu"),
        speed_kept("at the end", end),
    ]


def draw(result: Result, load: float) -> Figure:
    """Stator frequency on top, speed, load, current."""
    return recording(
        result,
        lambda pu: [pu.frequency(), pu.speed(), pu.i_q(), pu.i_alpha(), pu.angle(5.0)],
        _BEGIN - 2.0,
        size=(7.5, 6.6),
        events=[(_BEGIN + k * _STAY, f"{100 * load * part:.0f} %") for k, part in enumerate(_PARTS)],
    )


def _experiment(name: str, load: float) -> Experiment:
    return Experiment(
        name,
        f"Zero speed, load from {100 * load:.0f} % to none in steps",
        "Speed held, ends at zero stator frequency",
        partial(scenario, load=load),
        claims,
        partial(draw, load=load),
        Control(
            "offset estimator off",
            settings(offset_estimator=False),
            (_LOADED, "the drive runs to the end"),
            event=HOLD,
        ),
    )


EXPERIMENTS = (_experiment("17-130", 1.3), _experiment("17-120", 1.2))
