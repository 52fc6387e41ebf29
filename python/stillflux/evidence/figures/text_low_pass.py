"""Section II-C: a low-pass filter in place of the integrator, slower and slower.

"The lower limit of stable operation is at about five times the cutoff and, thus, intolerably high." The
reference falls from ten times the cutoff frequency to once; the estimator is `estimate/lowpass.rs`. Its lead
arctan(ω_c/ω_s) is 11° at five times the cutoff and 15° at 3.7 times: there the limit is drawn. Where control
is lost depends on the machine.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, reported
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.judge import EXCURSION, angle, lost
from stillflux.evidence.paper import RUN, paper_drive
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CUTOFF = 1.0
"""Cutoff frequency, Hz."""
_BEGIN, _END = 4.0, 24.0
_FROM, _TO = 10.0, 1.0
_LEAD = "mean lead of the field angle at ten times the cutoff over arctan(1/10)"
_HELD = "frequency at which the angle error passes 15°, multiple of the cutoff"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """No load; the reference falls from ten times the cutoff to once within 20 s."""
    return paper_drive(
        machine,
        arithmetic,
        name="low-pass filter in place of the integrator",
        omega=[(0.0, _pu(_FROM)), (_BEGIN, _pu(_FROM)), (_END, _pu(_TO))],
        duration=_END + 2.0,
    ).with_settings(low_pass=CUTOFF)


def _pu(multiple: float) -> float:
    """A multiple of the cutoff per unit of rated frequency, 50 Hz for both machines."""
    return multiple * CUTOFF / 50.0


def frequency_at(result: Result, error: float, begin: float) -> float:
    """Reference at which the angle error first passes so many degrees, or control is lost, after `begin`;
    per unit.

    0: neither happens.
    """
    when, _ = lost(result, since=RUN)
    passed = np.flatnonzero((np.abs(angle(result)) > error) & (result.t > begin))
    first = min(when, float(result.t[passed[0]]) if len(passed) else math.inf)
    if math.isinf(first):
        return 0.0
    reference = float(np.interp(first, result.t, result["reference"]))
    return abs(reference) / result.scenario.motor.base["omega_m"]


def claims(result: Result) -> list[Claim]:
    """The angle leads as the filter's does; it is beyond use below about five times the cutoff."""
    steady = result.window(_BEGIN - 1.0, _BEGIN)
    lead = float(np.mean(angle(steady))) / math.degrees(math.atan(1.0 / _FROM))
    multiple = frequency_at(result, EXCURSION, _BEGIN) * 50.0 / CUTOFF
    at_loss = frequency_at(result, 180.0, _BEGIN) * 50.0 / CUTOFF
    return [
        at_least(_LEAD, lead, 0.8),
        at_most(_LEAD, lead, 1.2),
        at_least(_HELD, multiple, 2.5),
        at_most(_HELD, multiple, 7.5),
        reported("frequency at which control is lost, multiple of the cutoff; 0: never", at_loss),
    ]


def draw(result: Result) -> Figure:
    """The way down, with the frequencies named."""
    slope = (_END - _BEGIN) / (_FROM - _TO)
    return recording(
        result,
        lambda pu: [pu.speed(), pu.i_q(), pu.i_alpha(), pu.angle(15.0)],
        2.0,
        size=(7.5, 5.4),
        events=[(_BEGIN + (_FROM - x) * slope, f"{x:g} × cutoff") for x in (10.0, 5.0, 2.0)],
    )


EXPERIMENTS = (
    Experiment(
        "II-C-low-pass",
        "Low-pass filter in place of the integrator",
        "Limit of stable operation at about five times the cutoff",
        scenario,
        claims,
        draw,
        Control("the estimator of Fig. 7 in its place", settings(low_pass=0.0), (_HELD,), event=_BEGIN),
        beside="the estimator itself is replaced",
    ),
)
