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
from stillflux.evidence.plane_points import PlanePoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure

__all__ = ["courses", "plane", "rest", "schemes_of", "worst_by_point"]

COLOURS = {"paper": TRUE, "enhanced": ESTIMATE}
_LOW, _HIGH = 0.1, 90.0
_LOST = "#b3261e"
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


def plane(points: Sequence[PlanePoint]) -> Figure:
    """Maps of the angle error over speed and torque: a row for each machine, a column for each scheme.

    The line is ω_s = 0, dashed where 15° are allowed; a cross is a lost point, a circle one that falls short.
    """
    import matplotlib as mpl
    from matplotlib.lines import Line2D

    machines = list(dict.fromkeys(point.machine for point in points))
    found = {point.scheme for point in points}
    schemes = [scheme for scheme in SCHEMES if scheme in found]
    figure = figure_of(1.2 + 4.3 * len(schemes), 0.5 + 3.9 * len(machines))
    with mpl.rc_context(STYLE):
        panels = figure.subplots(len(machines), len(schemes), sharex=True, sharey=True, squeeze=False)
        image = None
        for machine, line in zip(machines, panels, strict=True):
            for scheme, panel in zip(schemes, line, strict=True):
                mine = [x for x in points if (x.machine, x.scheme) == (machine, scheme)]
                image = _map(panel, machine, mine)
                held = sum(point.met for point in mine)
                panel.set_title(f"{machine}, {scheme}: {held} of {len(mine)} points met", fontsize=9)
            line[0].set_ylabel("$T/T_N$")
        for panel in panels[-1]:
            panel.set_xlabel(r"$\omega$")
        assert image is not None
        bar = figure.colorbar(image, ax=panels, label="largest angle error, °")
        bar.ax.set_yticks([0.1, 0.3, 1, 3, 10, 30, 90], labels=["0.1", "0.3", "1", "3", "10", "30", "90"])
        figure.legend(
            handles=[
                Line2D([], [], color=_LOST, marker="x", linestyle="", label="lost"),
                Line2D([], [], color="grey", marker="o", fillstyle="none", linestyle="", label="not met"),
                Line2D([], [], color="grey", label=r"$\omega_s = 0$ at rated flux"),
                Line2D([], [], color="grey", linestyle="--", label=r"$\pm 0.01$, where 15° are allowed"),
            ],
            loc="outside lower center",
            ncols=4,
            fontsize=8,
        )
    return figure


def _map(panel: Axes, machine: str, points: Sequence[PlanePoint]) -> QuadMesh:
    """The map of one machine and scheme."""
    from matplotlib.colors import LogNorm

    speeds, torques = (sorted({point.place[k] for point in points}) for k in (0, 1))
    values = np.full((len(torques), len(speeds)), np.nan)
    for point in points:
        omega, T = point.place
        values[torques.index(T), speeds.index(omega)] = min(max(point.angle, _LOW), _HIGH)
        if point.lost:
            panel.plot(omega, T, "x", color=_LOST, markersize=5, markeredgewidth=1.3)
        elif not point.met:
            panel.plot(omega, T, "o", color="white", markersize=4, fillstyle="none")
    image = panel.pcolormesh(
        speeds, torques, values, norm=LogNorm(_LOW, _HIGH), cmap="viridis", shading="nearest"
    )
    torque = np.linspace(torques[0] - 0.1, torques[-1] + 0.1, 60)
    line = np.array([line_speed(motor_of(machine), float(x)) for x in torque])
    panel.plot(line, torque, color="white", linewidth=1.2)
    for side in (-0.01, 0.01):
        panel.plot(line + side, torque, color="white", linewidth=0.7, linestyle="--")
    panel.grid(False)
    panel.set(xlim=(-0.105, 0.105), ylim=(-1.3, 1.3))
    return image


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
                panel.plot(*zip(*gone, strict=True), "x", color=_LOST, markersize=9, label="lost")
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
