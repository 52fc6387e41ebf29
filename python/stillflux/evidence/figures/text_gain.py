"""Section III-D: the noise compensator against unbalanced gains of the current channels.

One channel reads 2 % too much. That puts a component of negative sequence on the measured current and, by
way of r̂_s i_s, on û_i: a disturbance of twice the stator frequency in field coordinates, which no model of
the drive describes. The control is the compensator at a third of its floor, not off: without it the
integrator drifts, unbalanced or not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.machines import step
from stillflux.evidence.paper import RUN, paper_drive, to_the_end, turned_by_at_most
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOAD, _SLOWER, _SETTLED, _END = 10.0, 12.0, 18.0, 24.0
_RIPPLE = "ripple of |ψ̂_s|"
_ANGLE = "field angle error at ω = 0.05"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """Half load at ω = 0.1, then 0.05; phase a reads 2 % too much."""
    return paper_drive(
        machine,
        arithmetic,
        name="unbalanced gains",
        omega=[(0.0, 0.1), (_SLOWER, 0.1), (_SLOWER + 1.0, 0.05)],
        load=step(_LOAD, 0.5),
        duration=_END,
        plant={"current_gain": (1.02, 1.0, 1.0)},
    )


@to_the_end
def claims(result: Result) -> list[Claim]:
    """The trajectory stays a circle; the field angle and the speed stay right."""
    settled = result.window(_SETTLED)
    return [
        at_most(_RIPPLE, 100 * metrics.flux_ripple(settled), 2, "%").inner(),
        turned_by_at_most(3, "at ω = 0.05", settled),
        at_most("ripple of the speed", metrics.speed_ripple(settled), 0.002, "pu"),
    ]


def draw(result: Result) -> Figure:
    """Two seconds of the steady state."""
    return recording(
        result,
        lambda pu: [pu.speed(), pu.i_q(), pu.i_alpha(), pu.angle(5.0)],
        _SETTLED,
        _SETTLED + 2.0,
        (7.5, 4.8),
    )


EXPERIMENTS = (
    Experiment(
        "II-B-gains",
        "Gain of one current channel off by 2 %",
        "Residual disturbances compensated without a model",
        scenario,
        claims,
        draw,
        Control(
            "gain of the compensator at most 0.02",
            settings(noise_gain=(0.0, 0.02)),
            (_ANGLE, _RIPPLE),
            event=RUN,
        ),
    ),
)
