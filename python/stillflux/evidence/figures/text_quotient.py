"""Fig. 12, caption: the quotient N/D in the adaptation path, in place of the sign alone.

`fig13b` says what it stands for. The step of Fig. 13b at 30 % load, at ω = 0.01, 0.02 and 0.03. With the
quotient the path carries the error of r̂_s itself, at the same gain at every speed; what is left of the
dependence is the transient of ε, which takes a part of a period of ω_s.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stillflux.evidence.claims import Claim, at_least, at_most, reported
from stillflux.evidence.draw import adapting, side_by_side
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.figures import fig13b
from stillflux.evidence.machines import scaled
from stillflux.evidence.paper import identified, identify_then, runs_to_the_end, turned_by_at_most
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SPEEDS = (0.01, 0.02, 0.03)
_TIME = "time until r̂_s is within 5 %, the longest"


def scenarios(machine: str, arithmetic: str = "f32") -> tuple[Scenario, ...]:
    """Fig. 13b at three speeds, with the quotient."""
    built = fig13b.scenario(machine, arithmetic)
    return tuple(
        built.replace(
            name=f"quotient of Fig. 12, ω = {omega:g}",
            omega_ref=scaled(identify_then(omega), built.motor.base["omega_m"]),
        ).with_settings(resistance_quotient=True)
        for omega in _SPEEDS
    )


def claims(*results: Result) -> list[Claim]:
    """Found at every speed."""
    for result in results:
        if result.status != "running":
            return [runs_to_the_end(result)]
    times = [1e3 * identified(result, fig13b.CHANGE, 0.05) for result in results]
    worst = max(turned_by_at_most(15, "from the change on", r.window(fig13b.CHANGE)).value for r in results)
    return [
        runs_to_the_end(results[0]),
        at_most(_TIME, max(times), 1000, "ms").inner(),
        at_least("the shortest", min(times), 50, "ms").inner(),
        *(reported(f"at ω = {omega:g}", time, "ms") for omega, time in zip(_SPEEDS, times, strict=True)),
        at_most("field angle error from the change on", worst, 15, "°"),
    ]


def draw(*results: Result) -> Figure:
    """The three speeds side by side."""
    return side_by_side(
        results,
        [f"ω = {omega:g}" for omega in _SPEEDS],
        adapting(),
        fig13b.CHANGE - 0.5,
        fig13b.CHANGE + 2.0,
        [(fig13b.CHANGE, "$r_s$ + 25 %")],
    )


EXPERIMENTS = (
    Experiment(
        "12-quotient",
        "The quotient of Fig. 12 in the adaptation path",
        "The error of r̂_s itself in the path, with its sign",
        scenarios,
        claims,
        draw,
        Control(
            "resistance adaptation off",
            settings(resistance_adaptation=False),
            (_TIME, "the drive runs to the end"),
            event=fig13b.CHANGE,
        ),
    ),
)
