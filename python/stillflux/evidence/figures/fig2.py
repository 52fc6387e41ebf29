"""Fig. 2: threshold voltages of the bridge, nothing compensated, u* on a circle, shaft driven or braked.

The criterion is of the threshold voltage alone, so the bridge has no dead time here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_most, equal
from stillflux.evidence.draw import STYLE, THIRD, TRUE, figure_of
from stillflux.evidence.figure import Control, Experiment, inverter
from stillflux.evidence.machines import inverter_of, motor_of
from stillflux.evidence.openloop import VoltageFed, Waveforms

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_U_TH = 1.0
"""Threshold voltage of both inverters, V."""


def runs(machine: str, arithmetic: str = "f32") -> tuple[VoltageFed, ...]:
    """Motoring at ω_s = 0.017 and 0.01; driven at 0.017; driven at 0.15, where power does flow back."""
    del arithmetic  # No drive takes part.
    bare = inverter_of(machine).replace(dead_time=0.0, c_out=0.0)
    points = [(0.017, 0.02), (0.01, 0.02), (0.017, -0.02), (0.15, -0.02)]
    return tuple(
        VoltageFed(motor=motor_of(machine), inverter=bare, omega_s=omega_s, omega_r=omega_r)
        for omega_s, omega_r in points
    )


def claims(*runs: Waveforms) -> list[Claim]:
    """Jumps, fundamental and harmonics of the average voltage; motoring twice, driven twice."""
    found = []
    for run in runs[:2]:
        at = f"ω_s = {run.run.omega_s:g}"
        jumps, per_period = _jumps(run)
        deviation = 100 * float(np.abs(jumps / (4 / 3 * _U_TH) - 1).max())
        found.append(at_most(f"{at}: jumps, worst deviation from (4/3) u_th", deviation, 5, "%"))
        found.append(equal(f"{at}: jumps a period", round(per_period), 6))
    for run in runs:
        kind = "motoring" if run.run.omega_r > 0 else "driven"
        u_ref, u_av = run.harmonic(run.u_ref, 1), run.harmonic(run.u_ref - run.distortion, 1)
        cos_phi = (u_ref * run.harmonic(run.i_mean, 1).conjugate()).real
        cos_phi /= abs(u_ref) * abs(run.harmonic(run.i_mean, 1))
        lost, expected = abs(u_ref) - abs(u_av), 4 / np.pi * _U_TH * cos_phi
        text = f"ω_s = {run.run.omega_s:g}, {kind}: loss of fundamental, deviation from (4/π) u_th cos φ"
        phi = f"φ = {np.degrees(np.arccos(cos_phi)):.0f}°"
        found.append(at_most(text, 100 * abs(lost / expected - 1), 5, "%", phi))
    for run in runs[:2]:
        for order in (-5, 7):
            size = abs(run.harmonic(run.distortion, order)) * abs(order) / (4 / np.pi * _U_TH)
            text = f"ω_s = {run.run.omega_s:g}: harmonic {abs(order)}, deviation from (4/π) u_th/{abs(order)}"
            found.append(at_most(text, 100 * abs(size - 1), 10, "%"))
    return found


def _jumps(run: Waveforms) -> tuple[NDArray[np.float64], float]:
    """Distances between the distortion's neighbouring positions, and how often it moves in one period."""
    d = run.distortion
    sector = np.round(np.angle(d) / (np.pi / 3)).astype(int) % 6
    positions = np.array([d[sector == k].mean() if (sector == k).any() else 0.0 for k in range(6)])
    # A sector counts once it has lasted: ripple makes it flicker at the border.
    lasted = [sector[k] for k in range(20, len(sector)) if (sector[k - 20 : k] == sector[k]).all()]
    moves = np.count_nonzero(np.diff(lasted))
    return np.abs(np.roll(positions, -1) - positions), moves / run.run.periods


def draw(*runs: Waveforms) -> Figure:
    """Circle of u* and discontinuous trajectory of u_av, at both frequencies."""
    import matplotlib as mpl

    figure = figure_of(8.5, 4.2)
    with mpl.rc_context(STYLE):
        panels: Sequence[Axes] = figure.subplots(1, 2)
        for panel, run, part in zip(panels, runs[:2], "ab", strict=True):
            base = run.run.motor.base["u"]
            period = len(run.t) // run.run.periods
            reference, average = run.u_ref[: period + 1] / base, run.u_av[:period] / base
            panel.plot(reference.real, reference.imag, color=THIRD, linewidth=0.9, label=r"$u^*$")
            panel.plot(
                average.real,
                average.imag,
                ".",
                color=TRUE,
                markersize=0.8,
                rasterized=True,
                label=r"$u_{av}$",
            )
            panel.set(aspect="equal", xlabel=r"$u_\alpha$, pu", ylabel=r"$u_\beta$, pu")
            panel.set_title(rf"({part}) $\omega_s$ = {run.run.omega_s:g}", fontsize=9)
            panel.legend(loc="upper right", markerscale=8)
    return figure


EXPERIMENTS = (
    Experiment(
        "2",
        "Effect of inverter nonlinearity",
        "u_av jumps six times a period; less fundamental at motoring, more at regeneration",
        runs,
        claims,
        draw,
        Control(
            "no threshold voltage",
            inverter(u_th=0.0),
            ("ω_s = 0.017: jumps, worst deviation from (4/3) u_th",),
        ),
    ),
)
