"""Section III-E: "a higher load than 30 % rated may cause a transient instability at this very low speed."

Fig. 13b repeated at rising load. The same step of the resistance that is taken at 30 % makes the torque
current swing further the larger the load; the paper calls the condition unrealistic, since a winding does
not warm up in a step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_least, at_most, holds, reported
from stillflux.evidence.draw import adapting, side_by_side
from stillflux.evidence.figure import Control, Experiment, fields
from stillflux.evidence.figures import fig13b
from stillflux.evidence.judge import lost
from stillflux.evidence.machines import scaled, step
from stillflux.evidence.paper import HOLD, RUN
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOADS = (0.3, 0.6, 1.0)
"""Units of rated torque."""
_GROWS = "swing of i_q at rated load over that at 30 % load"


def scenarios(machine: str, arithmetic: str = "f32") -> tuple[Scenario, ...]:
    """Fig. 13b at 30, 60 and 100 % load."""
    built = fig13b.scenario(machine, arithmetic)
    return tuple(
        built.replace(
            name=f"r_s + 25 % at {100 * load:.0f} % load",
            load_torque=scaled(step(HOLD, load), built.motor.T_N),
        )
        for load in LOADS
    )


def swing(result: Result) -> float:
    """Largest change of i_q within 3 s of the step, per unit; of a run that is lost the rated current."""
    base = result.scenario.motor.base["i"]
    if lost(result, since=RUN)[1]:
        return 1.0
    i_q = metrics.smoothed(result["estimate.i_dq"].imag, 50) / base
    before = i_q[(result.t > fig13b.CHANGE - 1.0) & (result.t < fig13b.CHANGE)].mean()
    during = i_q[(result.t > fig13b.CHANGE) & (result.t < fig13b.CHANGE + 3.0)]
    return float(np.abs(during - before).max())


def claims(*results: Result) -> list[Claim]:
    """Taken at 30 % load; a swing that grows faster than the load."""
    swings = [swing(result) for result in results]
    found = [
        holds("held at 30 % load", not lost(results[0], since=RUN)[1]),
        at_most("swing of i_q at 30 % load", swings[0], 0.1, "pu"),
        at_least(_GROWS, swings[-1] / swings[0], 2.0 * LOADS[-1] / LOADS[0]),
    ]
    for result, size, load in zip(results[1:], swings[1:], LOADS[1:], strict=True):
        why = lost(result, since=RUN)[1]
        found.append(
            reported(f"swing of i_q at {100 * load:.0f} % load", size, "pu", f"lost: {why}" if why else "")
        )
    return found


def draw(*results: Result) -> Figure:
    """The three loads side by side."""
    return side_by_side(
        results,
        [f"{100 * load:.0f} % load" for load in LOADS],
        adapting(15.0),
        fig13b.CHANGE - 1.0,
        fig13b.CHANGE + 4.0,
        [(fig13b.CHANGE, "$r_s$ + 25 %")],
    )


EXPERIMENTS = (
    Experiment(
        "III-E-load",
        "Resistance step at rising load",
        "A load above 30 % may cause a transient instability",
        scenarios,
        claims,
        draw,
        Control("no step of the resistance", fields(changes=()), (_GROWS,), event=RUN),
    ),
)
