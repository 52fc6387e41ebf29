"""Section III-B: identification of u_th with direct current at rest.

The paper refers to [9] for its method and calls an adaptation to operating conditions "too much refinement
for some applications". With direct current along the a-axis the machine is a resistance, so that the
reference voltage over the current is a straight line: `u* = (r_s + r_d) i + (4/3)(u_th + T_d f_s u_dc)`, by
(5) and (7). Its slope is what the adaptation of Fig. 12 identifies as r̂_s, its intercept less the known
part of the dead time is the threshold. No drive takes part: the reference is applied open loop at several
levels and the current read once it has settled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import STYLE, THIRD, TRUE, figure_of
from stillflux.evidence.figure import Control, Experiment, Runs
from stillflux.evidence.machines import inverter_of, motor_of
from stillflux.evidence.openloop import DirectCurrent, Line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TH = "û_th, deviation"
_R = "slope, deviation from r_s + r_d"


def run(machine: str, arithmetic: str = "f32") -> DirectCurrent:
    """Four levels of direct current up to rated peak."""
    del arithmetic  # No drive takes part.
    return DirectCurrent(
        motor=motor_of(machine),
        inverter=inverter_of(machine).replace(c_out=0.0),
        parts=(0.4, 0.6, 0.8, 1.0),
        dead_time=inverter_of(machine).dead_time,
    )


def _unknown_dead_time(runs: Runs) -> Runs:
    return tuple(one.replace(dead_time=0.0) for one in runs)


def claims(line: Line) -> list[Claim]:
    """Threshold and resistance against those of the plant."""
    inverter, motor = line.run.inverter, line.run.motor
    return [
        at_most(_TH, 100 * abs(line.threshold / inverter.u_th - 1), 20, "%"),
        at_most(_R, 100 * abs(line.slope / (motor.R_s + inverter.r_d) - 1), 5, "%"),
    ]


def draw(line: Line) -> Figure:
    """Measured points and the line through them."""
    import matplotlib as mpl

    figure = figure_of(5.5, 3.8)
    with mpl.rc_context(STYLE):
        panel = figure.subplots()
        i = np.linspace(0.0, 1.05 * line.i.max(), 2)
        panel.plot(i, line.intercept + line.slope * i, color=THIRD, linewidth=0.8, label="line through them")
        panel.plot(line.i, line.u, "o", color=TRUE, markersize=4, label="measured")
        panel.set(xlabel="$i_a$, A", ylabel="$u^*$, V", xlim=(0.0, None), ylim=(0.0, None))
        panel.legend(loc="upper left")
    return figure


EXPERIMENTS = (
    Experiment(
        "III-B-u_th",
        "Identification of u_th with direct current",
        "Threshold voltage and resistance from a straight line",
        run,
        claims,
        draw,
        Control("dead time not taken off", _unknown_dead_time, (_TH,)),
    ),
)
