"""Pictures: maps of the plane, scheme beside scheme, and the course of runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from stillflux.evidence.beyond import Row
from stillflux.evidence.conditions import SCHEMES, line_speed
from stillflux.evidence.draw import ESTIMATE, STYLE, THIRD, TRUE, figure_of
from stillflux.evidence.judge import EXCURSION
from stillflux.evidence.machines import motor_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["courses", "plane", "rest", "schemes_of", "worst_by_point"]

COLOURS = {"paper": TRUE, "enhanced": ESTIMATE}
_LOW, _HIGH = 0.1, 90.0
_MOST = 6


def schemes_of(rows: Sequence[Row]) -> list[str]:
    """Schemes that occur, the paper's first."""
    found = {row.scheme for row in rows}
    return [scheme for scheme in SCHEMES if scheme in found]


def worst_by_point(rows: Sequence[Row]) -> dict[tuple[float, float], Row]:
    """For each point the run with the largest angle error, a lost one before all."""
    found: dict[tuple[float, float], Row] = {}
    for row in sorted(rows, key=lambda row: (bool(row.measured.why), row.measured.angle_held)):
        if row.point is not None:
            found[row.point] = row
    return found


def plane(rows: Sequence[Row]) -> Figure:
    """Maps of the angle error over speed and torque at one machine, one for each scheme.

    The line is ω_s = 0, dashed where 15° are allowed; a cross is a lost point, a circle one that falls short.
    """
    import matplotlib as mpl
    from matplotlib.colors import LogNorm

    schemes = schemes_of(rows)
    figure = figure_of(1.2 + 4.3 * len(schemes), 4.2)
    motor = motor_of(rows[0].machine)
    speeds, torques = (sorted({row.point[k] for row in rows if row.point is not None}) for k in (0, 1))
    torque = np.linspace(torques[0] - 0.1, torques[-1] + 0.1, 60)
    line = np.array([line_speed(motor, float(x)) for x in torque])
    with mpl.rc_context(STYLE):
        panels = figure.subplots(1, len(schemes), sharey=True, squeeze=False)[0]
        image = None
        for panel, scheme in zip(panels, schemes, strict=True):
            mine = worst_by_point([row for row in rows if row.scheme == scheme])
            values = np.full((len(torques), len(speeds)), np.nan)
            for k, T in enumerate(torques):
                for j, omega in enumerate(speeds):
                    row = mine.get((omega, T))
                    if row is None:
                        continue
                    values[k, j] = min(max(row.measured.angle_settled, _LOW), _HIGH)
                    if row.measured.why:
                        panel.plot(omega, T, "x", color="#b3261e", markersize=5, markeredgewidth=1.3)
                    elif not row.ok:
                        panel.plot(omega, T, "o", color="white", markersize=4, fillstyle="none")
            image = panel.pcolormesh(
                speeds, torques, values, norm=LogNorm(_LOW, _HIGH), cmap="viridis", shading="nearest"
            )
            panel.plot(line, torque, color="white", linewidth=1.2)
            for side in (-0.01, 0.01):
                panel.plot(line + side, torque, color="white", linewidth=0.7, linestyle="--")
            panel.grid(False)
            panel.set(xlim=(-0.105, 0.105), ylim=(-1.3, 1.3), xlabel=r"$\omega$")
            held = sum(row.ok for row in mine.values())
            panel.set_title(f"{scheme}: {held} of {len(mine)} points", fontsize=9)
        panels[0].set_ylabel("$T/T_N$")
        assert image is not None
        bar = figure.colorbar(image, ax=list(panels), label="largest angle error, °")
        bar.ax.set_yticks([0.1, 0.3, 1, 3, 10, 30, 90], labels=["0.1", "0.3", "1", "3", "10", "30", "90"])
    return figure


def rest(rows: Sequence[Row]) -> Figure:
    """Largest angle error over the load applied at rest, at one machine."""
    import matplotlib as mpl

    figure = figure_of(6.0, 3.2)
    with mpl.rc_context(STYLE):
        panel = figure.subplots()
        for scheme in schemes_of(rows):
            by = worst_by_point([row for row in rows if row.scheme == scheme])
            mine = [by[point] for point in sorted(by)]
            x = [point[1] for point in sorted(by)]
            y = [min(max(row.measured.angle_held, 0.01), 180.0) for row in mine]
            panel.semilogy(x, y, "o-", color=COLOURS[scheme], markersize=4, linewidth=0.9, label=scheme)
            gone = [(a, b) for a, b, row in zip(x, y, mine, strict=True) if row.measured.why]
            if gone:
                panel.plot(*zip(*gone, strict=True), "x", color="#b3261e", markersize=9, label="lost")
        panel.axhline(EXCURSION, color=THIRD, linewidth=0.8, linestyle="--")
        panel.set(xlabel="$T/T_N$", ylabel="largest angle error, °", ylim=(0.01, 250))
        panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def courses(rows: Sequence[Row]) -> Figure:
    """Angle error, speed, torque and confidence of runs at one machine, scheme over scheme.

    One column for each label, the first six of them, under one seed.
    """
    import matplotlib as mpl

    rows = [row for row in rows if row.seed == rows[0].seed]
    labels = list(dict.fromkeys(row.label for row in rows))[:_MOST]
    figure = figure_of(1.5 + 2.6 * max(2, len(labels)), 6.0)
    with mpl.rc_context(STYLE):
        grid = figure.subplots(4, len(labels), sharex="col", squeeze=False)
        for j, label in enumerate(labels):
            mine = [row for row in rows if row.label == label and row.trace]
            if not mine:
                continue
            for row in mine:
                _course(list(grid[:, j]), row)
            grid[0, j].set_title(label, fontsize=8)
            for panel in grid[:-1, j]:
                panel.tick_params(labelbottom=False)
            grid[0, j].set_ylim(*_limits(mine))
            grid[1, j].set_ylim(*_speeds(mine))
            grid[2, j].set_ylim(-1.8, 1.8)
            grid[3, j].set_ylim(-0.05, 1.05)
            grid[3, j].axhline(0.5, color=THIRD, linewidth=0.7, linestyle="--")
            grid[3, j].set_xlabel("t, s")
        names = ("angle\nerror, °", r"$\omega$", "$T/T_N$", "confi-\ndence")
        for panel, name in zip(grid[:, 0], names, strict=True):
            panel.set_ylabel(name, rotation=0, ha="right", va="center")
        grid[0, -1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _course(panels: Sequence[Axes], row: Row) -> None:
    colour, width = COLOURS[row.scheme], 0.9
    panels[0].plot(*row.trace["angle"], color=colour, linewidth=width, label=row.scheme)
    if "reference" in row.trace:
        panels[1].plot(*row.trace["reference"], color=THIRD, linewidth=0.8, linestyle=":")
    panels[1].plot(*row.trace["speed"], color=colour, linewidth=width)
    panels[2].plot(*row.trace["load"], color=THIRD, linewidth=0.8, linestyle=":")
    panels[2].plot(*row.trace["torque"], color=colour, linewidth=width)
    panels[3].plot(*row.trace["confidence"], color=colour, linewidth=width)


def _limits(rows: Sequence[Row]) -> tuple[float, float]:
    """Symmetric limits of the angle, 5° to 90°."""
    most = min(max(5.0, *(1.1 * float(np.abs(row.trace["angle"][1]).max()) for row in rows)), 90.0)
    return -most, most


def _speeds(rows: Sequence[Row]) -> tuple[float, float]:
    """Limits of the speed: zero and the reference. A machine that runs away would hide everything else."""
    known = [row.trace["reference"][1] for row in rows if "reference" in row.trace]
    low = min((float(x.min()) for x in known), default=-0.1)
    high = max((float(x.max()) for x in known), default=0.1)
    low, high = min(low, 0.0), max(high, 0.0)
    margin = max(0.02, 0.2 * (high - low))
    return low - margin, high + margin
