"""Fig. 15: low speed with offset. Approached from 5 Hz, as Fig. 10, which is the same without offset
estimator.

True torque ripples a little where the measured i_q does not, since the true current has the opposite offset
until û_off is found.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import (
    ESTIMATE,
    STYLE,
    TRUE,
    Strip,
    figure_of,
    from_time,
    parts,
    recorder,
    spaced,
    until_fault,
    wide,
)
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.paper import (
    OFFSET_25_MV,
    OFFSET_250_MV,
    RUN,
    offset_found,
    paper_drive,
    to_the_end,
)
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTLED = RUN + 20.0
"""From then on the state is steady, s."""
_FROM_5_HZ = [(0.0, 0.1), (RUN + 8.0, 0.1), (RUN + 10.0, 0.023)]
"""Started at 0.023 with the large offset, the first estimate comes too late."""
RIPPLE = "ripple of |ψ̂_s|"


def scenario(
    machine: str, arithmetic: str = "f32", offset: float = OFFSET_25_MV, name: str = "Fig. 15"
) -> Scenario:
    """Steady state at ω = 0.023 with offset."""
    return paper_drive(
        machine,
        arithmetic,
        name=name,
        omega=_FROM_5_HZ,
        offset=offset * (1 + 1j),
        duration=SETTLED + 5.0,
    )


@to_the_end
def claims(result: Result) -> list[Claim]:
    """The trajectory is a circle, the field angle is right, the offset is found."""
    settled = result.window(SETTLED)
    return [
        at_most(RIPPLE, 100 * metrics.flux_ripple(settled), 1, "%"),
        at_most("mean field angle error", abs(float(metrics.angle_error(settled).mean())), 2, "°"),
        offset_found(settled, 2),
    ]


def draw(result: Result, *others: Result) -> Figure:
    """(a) circle, (b) flux components and angle error, (c) current and speed."""
    import matplotlib as mpl

    del others
    result = until_fault(result)
    figure = figure_of(9.5, 7.0)
    left, right = parts(figure, 1, 2, width_ratios=(2, 3))
    begin = min(SETTLED, max(0.0, float(result.t[-1]) - 3.0))
    pu = from_time(result, begin, begin + 3.0)
    psi, true = pu.psi("estimate.psi_s"), pu.psi("psi_s")
    with mpl.rc_context(STYLE):
        panel = left.subplots()
        panel.plot(*spaced(psi), color=ESTIMATE, linewidth=0.9, label="estimated")
        panel.plot(*spaced(true), color=TRUE, linewidth=0.9, label="true")
        panel.set(aspect="equal", xlabel=r"$\psi_\alpha$, pu", ylabel=r"$\psi_\beta$, pu", title="(a)")
        panel.legend(loc="center")
    estimated_speed = pu.omega_m("estimate.omega_m")
    strips = [
        Strip(r"$\psi_\alpha$", [("estimated", psi.real), ("true", true.real)]),
        Strip(r"$\psi_\beta$", [("estimated", psi.imag), ("true", true.imag)]),
        pu.angle(5.0),
        pu.i_alpha(),
        Strip("$i_q$", pu.i_q().traces, wide(pu.i("estimate.i_dq").imag, 0.1)),
        Strip("$T/T_N$", [("", pu.torque())], wide(pu.torque(), 0.1), unit=""),
        Strip(
            r"$\omega$",
            pu.speed().traces,
            wide(estimated_speed, 0.005),
        ),
        pu.confidence(),
    ]
    recorder(right, pu.t, strips, title="(b) above, (c) below")
    return figure


_CONTROL = Control(
    "offset estimator off",
    settings(offset_estimator=False),
    (RIPPLE, "û_off, deviation from the true offset", "the drive runs to the end"),
    event=RUN,
)

EXPERIMENTS = (
    Experiment(
        "15",
        "Low speed with offset",
        "Circle round, no angle error",
        scenario,
        claims,
        draw,
        _CONTROL,
    ),
    Experiment(
        "15-250mV",
        "Low speed with tenfold offset",
        "Circle round, no angle error",
        partial(scenario, offset=OFFSET_250_MV),
        claims,
        draw,
        _CONTROL,
    ),
)
