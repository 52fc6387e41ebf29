"""Fig. 6: phase currents at their zero crossings, dead time uncompensated.

Samples at the carrier peak; reversals within a switching period show as the voltage that leg a loses lying
between its two full values.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.claims import Claim, at_least
from stillflux.evidence.draw import STYLE, TRUE, Strip, figure_of, parts, recorder
from stillflux.evidence.figure import Control, Experiment, inverter
from stillflux.evidence.machines import inverter_of, motor_of
from stillflux.evidence.openloop import VoltageFed, Waveforms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DWELLS = "time within ±2 % of the amplitude, as multiple of a sine's"
_REVERSES = "switching periods per crossing in which i_a reverses"


def run(machine: str, arithmetic: str = "f32") -> VoltageFed:
    """Motoring at ω_s = 0.1 on a circle of u*, with dead time and hence zero-current clamping."""
    del arithmetic  # No drive takes part.
    bridge = inverter_of(machine).replace(c_out=0.0)
    return VoltageFed(motor=motor_of(machine), inverter=bridge, omega_s=0.1, omega_r=0.02, periods=3)


def claims(run: Waveforms) -> list[Claim]:
    """Plateau at the zero crossing of i_a, and reversals of the current inside switching periods."""
    amplitude = abs(run.harmonic(run.i_s, 1))
    i_a = run.i_s.real
    near = np.abs(i_a) < 0.02 * amplitude
    edges = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(int), [0]))))
    longest = float((edges[1::2] - edges[::2]).max(initial=0)) / run.run.inverter.f_s
    sine = 2 * 0.02 / (run.run.omega_s * run.run.motor.base["omega"])
    # Where phase a crosses, the other legs lose opposite voltages: what is left is that of leg a.
    leg = run.distortion.real / (2 / 3 * run.threshold)
    reversing = np.count_nonzero(near & (np.abs(leg) < 0.8)) / (2 * run.run.periods)
    return [at_least(_DWELLS, longest / sine, 3), at_least(_REVERSES, float(reversing), 10)]


def draw(run: Waveforms) -> Figure:
    """Three phase currents over a period, and i_a about its zero crossing."""
    import matplotlib as mpl

    figure = figure_of(8.5, 4.6)
    axes = np.exp(-2j * np.pi / 3 * np.arange(3))
    i_abc = (run.i_s[:, None] * axes).real / run.run.motor.base["i"]
    period = len(run.t) // run.run.periods
    top, bottom = parts(figure, 2, 1)
    t = 1e3 * run.t[:period]
    labels = [r"$i_a$", r"$i_b$", r"$i_c$"]
    traces = [(name, i_abc[:period, k]) for k, name in enumerate(labels)]
    recorder(top, t, [Strip("$i_{abc}$", traces)], "ms")
    crossing = int(np.flatnonzero(np.diff(np.sign(i_abc[period // 8 :, 0])))[0]) + period // 8
    half = period // 10
    near = slice(max(0, crossing - half), crossing + half)
    with mpl.rc_context(STYLE):
        left, right = bottom.subplots(1, 2)
        left.plot(1e3 * run.t[near], i_abc[near, 0], ".", markersize=2, color=TRUE)
        left.set(xlabel="t, ms", ylabel="$i_a$ at the carrier peak, pu")
        leg = run.distortion.real[near] / (2 / 3 * run.threshold)
        right.plot(1e3 * run.t[near], leg, linewidth=0.9, color=TRUE)
        right.set(xlabel="t, ms", ylabel="voltage lost in leg a\nover its full value", ylim=(-1.3, 1.3))
    return figure


EXPERIMENTS = (
    Experiment(
        "6",
        "Zero-crossing effect",
        "Currents dwell at zero, ripple reverses them repeatedly",
        run,
        claims,
        draw,
        Control("no dead time, so no leg is ever open", inverter(dead_time=0.0), (_DWELLS, _REVERSES)),
    ),
)
