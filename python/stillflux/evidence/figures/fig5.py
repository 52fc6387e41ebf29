"""Fig. 5: the trajectory of ψ̂_1 while a large offset is all but uncompensated."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most
from stillflux.evidence.draw import STYLE, THIRD, TRUE, figure_of, from_time, spaced
from stillflux.evidence.figure import Control, Experiment, Runs
from stillflux.evidence.paper import OFFSET_250_MV, RUN, paper_drive, to_the_end
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TOUCHED = "far boundary touched on both axes, extreme"
_CLEAR = "clearance from the opposite boundary"


def scenario(machine: str, arithmetic: str = "f32") -> Scenario:
    """Offset of the signs of the paper's example at ω = 0.1; the estimator all but ignores what it sees."""
    offset = OFFSET_250_MV * (1 - 1j)
    built = paper_drive(machine, arithmetic, name="Fig. 5", omega=0.1, offset=offset, duration=6.0)
    return built.with_settings(offset_gain=0.01)


@to_the_end
def claims(result: Result) -> list[Claim]:
    """One limit touched per axis, the other side clear, means with the signs of the offset, (−, +)."""
    settled = result.window(4.0)
    psi = settled["estimate.psi_1"] / result.scenario.motor.base["psi"]
    sides = [np.sort([-x.min(), x.max()]) for x in (psi.real, psi.imag)]
    mean = [0.5 * float(x.max() + x.min()) for x in (psi.real, psi.imag)]
    return [
        at_least(_TOUCHED, min(x[1] for x in sides), 0.999, "ψ*"),
        at_least(_CLEAR, 1 - max(x[0] for x in sides), 0.02, "ψ*"),
        at_most("(max + min)/2 of ψ̂_1α, of the sign of the offset", mean[0], 0.0, "ψ*"),
        at_least("(max + min)/2 of ψ̂_1β, of the sign of the offset", mean[1], 0.0, "ψ*"),
    ]


def draw(result: Result) -> Figure:
    """Trajectory of ψ̂_1 within its limits."""
    import matplotlib as mpl

    figure = figure_of(4.6, 4.6)
    with mpl.rc_context(STYLE):
        panel = figure.subplots()
        psi = from_time(result, min(4.0, float(result.t[-1]) - 0.5)).psi("estimate.psi_1")
        circle = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
        panel.plot(
            circle.real, circle.imag, color=THIRD, linewidth=0.8, linestyle=":", label=r"$|\psi|=\psi_s^*$"
        )
        panel.plot(
            [-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1], color=THIRD, linewidth=0.8, label=r"limits $\pm\psi_s^*$"
        )
        panel.plot(*spaced(psi), color=TRUE, linewidth=0.9, label=r"$\hat\psi_1$")
        panel.axhline(0, color="#aaa", linewidth=0.6)
        panel.axvline(0, color="#aaa", linewidth=0.6)
        panel.set(
            aspect="equal", xlabel=r"$\hat\psi_{1\alpha}/\psi_s^*$", ylabel=r"$\hat\psi_{1\beta}/\psi_s^*$"
        )
        panel.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
        panel.legend(loc="center")
    return figure


def _without_offset(runs: Runs) -> Runs:
    return tuple(run.replace(plant={**run.plant, "current_offset": 0.0}) for run in runs)


EXPERIMENTS = (
    Experiment(
        "5",
        "Trajectory of ψ̂_1 with uncompensated offset",
        "One limit touched per axis, clearance opposite, means of the offset's sign",
        scenario,
        claims,
        draw,
        directed=False,
        beside="ψ̂_1 is a block of the published scheme",
        control=Control("no offset", _without_offset, (_CLEAR,), event=RUN),
    ),
)
