"""Fig. 9: start with offset; six periods of 2 s after the start, then two to measure the true offset by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.draw import Strip, figure_of, from_time, parts, recorder
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.paper import RUN, offset_found, paper_drive, runs_to_the_end
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTLED = RUN + 0.5 + 6 * 2.0
"""Six periods have passed, s."""
_CENTRE = "centre of ψ̂_1"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """De-energised start with offset to ω = 0.01."""
    return paper_drive(machine, arithmetic, name="Fig. 9", omega=0.01, duration=SETTLED + 4.5)


def claims(result: Result) -> list[Claim]:
    """Start with offset."""
    start = metrics.start_time(result)
    effective = "estimate effective after"
    begun = [at_least(effective, start, RUN - 0.2, "s"), at_most(effective, start, RUN + 0.2, "s")]
    if result.status != "running":
        return [*begun, runs_to_the_end(result)]
    settled = result.window(SETTLED)
    psi_1 = settled["estimate.psi_1"]
    centre = max(abs(x.max() + x.min()) / 2 for x in (psi_1.real, psi_1.imag))
    return [
        *begun,
        runs_to_the_end(result),
        offset_found(settled, 5),
        at_most(_CENTRE, 100 * centre / result.scenario.motor.base["psi"], 5, "% of ψ*"),
    ]


def draw(result: Result) -> Figure:
    """Start: flux, field angle, offset voltage; the last periods enlarged."""
    figure = figure_of(9.5, 6.2)
    left, right = parts(figure, 1, 2, width_ratios=(3, 2))
    for part, begin, end in ((left, 0.0, float("inf")), (right, RUN - 0.2, RUN + 2.3)):
        pu = from_time(result, begin, end)
        psi, psi_1 = pu.psi("estimate.psi_s"), pu.psi("estimate.psi_1")
        u_off = 1e3 * pu.u("estimate.u_off")
        strips = [
            pu.speed(),
            Strip(r"$\psi_\alpha$", [("estimated", psi.real), ("true", pu.psi("psi_s").real)], (-1.3, 1.3)),
            Strip(r"$\hat\psi_{1\alpha}$", [("", psi_1.real)], (-1.3, 1.3)),
            Strip(r"$10^3\,\hat u_{off}$", [(r"$\alpha$", u_off.real), (r"$\beta$", u_off.imag)]),
            pu.delta(),
            pu.angle(20.0),
        ]
        recorder(part, pu.t + begin, strips)
        if part is left:
            for panel in part.axes:
                panel.axvspan(RUN - 0.2, RUN + 2.3, color="#eee", zorder=0)
                legend = panel.get_legend()
                if legend is not None:
                    legend.remove()
    return figure


EXPERIMENTS = (
    Experiment(
        "9",
        "Start with offset",
        "Estimate effective at 1.5 s, û_off found, ψ̂_1 centres",
        scenario,
        claims,
        draw,
        Control("offset estimator off", settings(offset_estimator=False), (_CENTRE,), event=RUN),
    ),
)
