"""Section II-D: "the load dependent variations of the winding temperature may lead to up to ±50 % error of
the modeled stator resistance. Hence, the stator resistance must be continuously adapted to its correct value
during operation."

The winding warms up by 45 % or cools down by as much within 20 s at ω = 0.02 under 30 % load; r̂_s follows
through most of its range of ±50 %.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import side_by_side
from stillflux.evidence.figure import Control, Experiment, settings
from stillflux.evidence.machines import motor_of, step
from stillflux.evidence.paper import (
    HOLD,
    identify_then,
    paper_drive,
    runs_to_the_end,
    speed_kept,
    turned_by_at_most,
)
from stillflux.metrics import resistance_error
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WARMING, _WARM = HOLD + 4.0, HOLD + 24.0
_ERRORS = (0.45, -0.45)
_FOUND = "r̂_s, largest deviation"


def scenarios(machine: str, arithmetic: str = "f32") -> tuple[Scenario, ...]:
    """The winding warmer and colder by 45 % within 20 s."""
    R_s = motor_of(machine).R_s
    return tuple(
        paper_drive(
            machine,
            arithmetic,
            name=f"winding {100 * error:+.0f} %",
            omega=identify_then(0.02),
            load=step(HOLD, 0.3),
            duration=_WARM + 2.0,
            changes=[
                (_WARMING + (_WARM - _WARMING) * k / 200, {"R_s": R_s * (1.0 + error * k / 200)})
                for k in range(201)
            ],
        )
        for error in _ERRORS
    )


def claims(*results: Result) -> list[Claim]:
    """Followed all the way, control never lost."""
    found: list[Claim] = []
    for result, error in zip(results, _ERRORS, strict=True):
        which = f"winding {100 * error:+.0f} %"
        found.append(_named(runs_to_the_end(result), which))
        if result.status != "running":
            continue
        meanwhile = result.window(_WARMING)
        off = 100 * float(np.abs(resistance_error(meanwhile)).max())
        found += [
            at_most(f"{which}: {_FOUND}", off, 5, "%").inner(),
            _named(turned_by_at_most(15, "meanwhile", meanwhile), which),
            _named(speed_kept("meanwhile", meanwhile), which),
        ]
    return found


def _named(claim: Claim, which: str) -> Claim:
    return replace(claim, quantity=f"{which}: {claim.quantity}")


def draw(*results: Result) -> Figure:
    """Both runs side by side."""
    return side_by_side(
        results,
        [f"winding {100 * error:+.0f} %" for error in _ERRORS],
        lambda pu: [pu.speed(), pu.r_s((0.4, 1.6)), pu.i_q(), pu.angle(15.0)],
        HOLD - 1.0,
        events=[(HOLD, "30 % load"), (_WARMING, "temperature changes"), (_WARM, "kept")],
    )


EXPERIMENTS = (
    Experiment(
        "II-D-range",
        "Winding 45 % warmer or colder, within 20 s",
        "Continuously adapted over ±50 %",
        scenarios,
        claims,
        draw,
        Control(
            "resistance adaptation off",
            settings(resistance_adaptation=False),
            tuple(
                f"winding {100 * error:+.0f} %: {what}"
                for error in _ERRORS
                for what in (_FOUND, "the drive runs to the end")
            ),
            event=_WARMING,
        ),
    ),
)
