"""Section II-C: an integrator with limited components as flux estimator, slower and slower.

"While such limiting eliminates the dc offset from the flux signal, it introduces phase angle distortions in
turn. The limit of stable operation is around a stator frequency of 2-3 Hz." The offset is the 250 mV of
Figs. 10 and 15, which the estimator of Fig. 7 takes at 1.14 Hz; the estimator is `estimate/limiter.rs`. The
limit is drawn at 30°, where a seventh of the torque is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.draw import recording
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.figures.text_low_pass import frequency_at
from stillflux.evidence.judge import angle
from stillflux.evidence.paper import OFFSET_250_MV, paper_drive
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEGIN, _END = 8.0, 28.0
_FROM, _TO = 0.2, 0.01
_HELD = "frequency at which the angle error passes 30° or control is lost"
_DISTORTED = "field angle error at 10 Hz"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """No load; the reference falls from 10 Hz to 0.5 Hz within 20 s."""
    return paper_drive(
        machine,
        arithmetic,
        name="limited integrator in place of Fig. 7",
        omega=[(0.0, _FROM), (_BEGIN, _FROM), (_END, _TO)],
        offset=OFFSET_250_MV * (1 + 1j),
        duration=_END + 2.0,
    ).with_settings(limiter=True)


def claims(result: Result) -> list[Claim]:
    """The angle is distorted; control is lost at 2 to 3 Hz, within a factor of two."""
    error = float(np.abs(angle(result.window(_BEGIN - 1.0, _BEGIN))).max())
    loss = 50.0 * frequency_at(result, 30.0, _BEGIN)
    return [
        at_least(_DISTORTED, error, 2, "°"),
        at_least(_HELD, loss, 1.25, "Hz"),
        at_most(_HELD, loss, 5, "Hz"),
    ]


def draw(result: Result) -> Figure:
    """The way down, with the frequencies named."""
    slope = (_END - _BEGIN) / (_FROM - _TO)
    return recording(
        result,
        lambda pu: [pu.speed(), pu.i_q(), pu.i_alpha(), pu.angle(15.0)],
        4.0,
        size=(7.5, 5.4),
        events=[(_BEGIN + (_FROM - x / 50.0) * slope, f"{x:g} Hz") for x in (5.0, 3.0, 2.0)],
    )


EXPERIMENTS = (
    Experiment(
        "II-C-limiter",
        "Limited integrator in place of the estimator",
        "Limit of stable operation around 2 to 3 Hz",
        scenario,
        claims,
        draw,
        Control("the estimator of Fig. 7 in its place", settings(limiter=False), (_HELD,), event=_BEGIN),
        beside="the estimator itself is replaced",
    ),
)
