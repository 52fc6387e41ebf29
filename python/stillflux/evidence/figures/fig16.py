"""Fig. 16: start at a quarter hertz with the offset voltage that an earlier run has stored."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stillflux.evidence.claims import Claim
from stillflux.evidence.draw import Strip, recording
from stillflux.evidence.figure import Control, Experiment
from stillflux.evidence.paper import RUN, paper_drive, runs_to_the_end, speed_kept, turned_by_at_most
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def scenarios(machine: str, arithmetic: str = "f32") -> tuple[Scenario, Scenario]:
    """The earlier run at 1 Hz, then the start to ω = 0.005; the second takes over the first one's memory."""
    earlier = paper_drive(machine, arithmetic, name="before Fig. 16", omega=0.02, duration=RUN + 12.0)
    return earlier, paper_drive(machine, arithmetic, name="Fig. 16", omega=0.005, duration=RUN + 16.0)


def claims(earlier: Result, result: Result) -> list[Claim]:
    """Regulated within two periods of 4 s."""
    del earlier
    if result.status != "running":
        return [runs_to_the_end(result)]
    return [
        runs_to_the_end(result),
        speed_kept("after two periods", result.window(RUN + 8.0)),
        turned_by_at_most(3, "from the start on", result.window(RUN + 0.2)),
    ]


def draw(earlier: Result, result: Result) -> Figure:
    """Speed, flux, field angle and current from the first moment on."""
    del earlier
    return recording(
        result,
        lambda pu: [
            pu.speed(),
            Strip(
                r"$\psi_\alpha$",
                [("estimated", pu.psi("estimate.psi_s").real), ("true", pu.psi("psi_s").real)],
                (-1.3, 1.3),
            ),
            pu.delta(),
            pu.i_alpha(),
            pu.angle(5.0),
        ],
        0.0,
        events=[(RUN, "control begins"), (RUN + 8.0, "two periods")],
    )


EXPERIMENTS = (
    Experiment(
        "16",
        "De-energised start to 0.25 Hz",
        "Regulated at once with the stored offset",
        scenarios,
        claims,
        draw,
        Control("nothing stored", lambda runs: runs, ("field angle error from the start on",), event=RUN),
        chained=True,
    ),
)
