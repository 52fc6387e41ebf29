"""Figures of results."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.metrics import angle_error, running

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from stillflux.replay import Replay
    from stillflux.result import Result
    from stillflux.sweep import Sweep

__all__ = [
    "flux_trajectory",
    "new_figure",
    "overview",
    "panels",
    "replayed",
    "sweep_map",
    "sweep_spread",
    "thin",
]

_MOST = 1200


def new_figure(**how: Any) -> Figure:
    """A figure that a notebook shows by itself; no window, no global state."""
    from matplotlib.figure import Figure

    class Shown(Figure):
        def _repr_png_(self) -> bytes:
            image = io.BytesIO()
            self.savefig(image, format="png", dpi=90)
            return image.getvalue()

    return Shown(**how)


def panels(runs: Mapping[str, Result], signals: Sequence[str]) -> Figure:
    """Signals over the time, a panel each, of one run or several. Space vectors by magnitude, angles in
    degrees."""
    figure = new_figure(figsize=(7.5, 1.0 + 1.9 * len(signals)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(signals), 1, sharex=True))
    for panel, name in zip(axes, signals, strict=True):
        for label, run in runs.items():
            values, unit = run[name], run.units[name]
            if np.iscomplexobj(values):
                values = np.abs(values)
            if unit == "rad":
                values, unit = np.degrees(values), "°"
            panel.plot(*thin(run.t, values), linewidth=0.9, label=label or None)
            text = f"|{name}|" if np.iscomplexobj(run[name]) else name
            panel.set_ylabel(f"{text}, {unit}" if unit else text)
        panel.grid(alpha=0.3)
    axes[-1].set_xlabel("time, s")
    if len(runs) > 1:
        _legend_above(axes[0], 2)
    return figure


def thin(t: NDArray[Any], x: NDArray[Any], most: int = _MOST) -> tuple[NDArray[Any], NDArray[Any]]:
    """At most about `most` samples of a real signal; of every bin the least and the greatest stay."""
    bins = most // 2
    size = -(-len(t) // bins)
    if size < 2:
        return t, x
    bins = len(t) // size
    folded = x[: bins * size].reshape(bins, size)
    extremes = np.stack([folded.argmin(1), folded.argmax(1)], axis=1) + size * np.arange(bins)[:, None]
    # What does not fill a bin stays whole.
    chosen = np.unique(np.append(extremes, np.arange(bins * size, len(t))))
    return t[chosen], x[chosen]


def overview(result: Result) -> Figure:
    """Speed, torque, currents, field-angle error, offset voltage and resistance over time, as far as they
    were recorded; where none of them was, every signal that was."""
    shown = [(label, lines) for label, lines in _overview(result) if lines]
    if not shown:
        return panels({"": result}, list(result))
    figure = new_figure(figsize=(7.5, 0.4 + 1.9 * len(shown)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
    for panel, (label, lines) in zip(axes, shown, strict=True):
        _lines(panel, result, label, lines)
        if label.startswith("$R_s"):
            low, high = panel.get_ylim()
            nominal = result.scenario.motor.R_s + result.scenario.inverter.r_d
            panel.set_ylim(min(low, 0.9 * nominal), max(high, 1.1 * nominal))
        _legend_above(panel, len(lines))
    axes[-1].set_xlabel("time, s")
    figure.suptitle(result.scenario.name or "closed loop", parse_math=False)
    return figure


def _overview(result: Result) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """Panels of the overview: label, and its lines by name."""

    def of(signals: Mapping[str, str]) -> dict[str, NDArray[Any]]:
        return {name: result[signal] for name, signal in signals.items() if signal in result}

    speeds = {"true": "omega_m", "estimated": "estimate.omega_m"}
    found = of(speeds)
    if found and result.scenario.torque_ref is None:
        found |= of({"reference": "reference"})
    yield "speed, rad/s", found
    torques = of({"true": "torque", "estimated": "estimate.torque"})
    if torques:
        torques |= of({"load": "load_torque"})
    yield "torque, N·m", torques
    for current in of({"": "estimate.i_dq"}).values():
        yield "current, A", {"$i_d$": current.real, "$i_q$": current.imag}
    if "angle_error" in result:
        error = angle_error(result) if "status" in result else np.degrees(result["angle_error"])
        yield "field angle error, °", {"estimated − true": error}
    for offset in of({"": "estimate.u_off"}).values():
        yield r"$\hat u_{off}$, mV", {r"$\alpha$": 1e3 * offset.real, r"$\beta$": 1e3 * offset.imag}
    resistances = {}
    if "R_s" in result:
        r_d = (result.scenario.plant_inverter or result.scenario.inverter).r_d
        resistances["true"] = result["R_s"] + r_d
    yield r"$R_s + r_d$, $\Omega$", resistances | of({"estimated": "estimate.R_s"})


def flux_trajectory(result: Result) -> Figure:
    """True and estimated stator flux in the complex plane, while the drive runs."""
    figure = new_figure(figsize=(4.5, 4.5), layout="constrained")
    panel = figure.subplots()
    begun = np.flatnonzero(running(result))
    for signal, label in (("psi_s", "true"), ("estimate.psi_s", "estimated")):
        # The first period of the run has no estimate yet. Points at equal distances along the path.
        psi = result[signal][begun[1:]]
        path = np.cumsum(np.abs(np.diff(psi)))
        if len(path):
            psi = psi[np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], 2 * _MOST)))]
        panel.plot(psi.real, psi.imag, label=label, **_WIDTHS.get(label, {}))
    panel.set(xlabel=r"$\psi_\alpha$, V·s", ylabel=r"$\psi_\beta$, V·s", aspect="equal", title="stator flux")
    panel.grid(alpha=0.3)
    # The flux keeps its magnitude: the middle is free.
    panel.legend(loc="center", fontsize="small")
    return figure


def replayed(found: Replay) -> Figure:
    """Estimates of a replayed log over time: speed, torque with a band of two standard deviations, flux,
    resistance, deviation of the angle with the confidence."""
    figure = new_figure(figsize=(7.5, 10), layout="constrained")
    speed, torque, flux, resistance, angle = axes = figure.subplots(5, 1, sharex=True)
    known = found.angle_deviation < np.pi

    def line(panel: Axes, values: NDArray[Any], label: str, **style: Any) -> None:
        panel.plot(*thin(found.t, np.where(known, values, np.nan)), linewidth=0.9, label=label, **style)

    line(speed, found.omega_m, "speed")
    speed.set_ylabel("speed, rad/s")
    band = np.where(known, 2.0 * found.torque_deviation, np.nan)
    t, low = thin(found.t, found.torque - band)
    at = np.searchsorted(found.t, t)
    torque.fill_between(t, low, (found.torque + band)[at], alpha=0.25, linewidth=0.0, label="± 2 σ")
    line(torque, found.torque, "torque")
    torque.set_ylabel("torque, N·m")
    line(flux, np.abs(found.psi_s), r"$|\hat\psi_s|$")
    flux.set_ylabel("flux, V·s")
    with_bridge = "" if found.voltage == "terminal" else " + r_d"
    line(resistance, found.R_s, rf"$\hat R_s{with_bridge}$")
    resistance.set_ylabel(r"resistance, $\Omega$")
    line(angle, np.degrees(found.angle_deviation), "σ of the field angle")
    angle.set_ylabel("σ, °")
    right = angle.twinx()
    line(right, found.confidence, "confidence", color="C1")
    right.set_ylim(-0.02, 1.05)
    right.set_ylabel("confidence", color="C1")
    axes[-1].set_xlabel("time, s")
    # A file may be called "a$b_$.csv".
    figure.suptitle(f"{found.source}, scheme {found.scheme}", parse_math=False)
    _legend_above(torque, 2)
    for panel in axes:
        panel.grid(alpha=0.3)
    return figure


def sweep_map(found: Sweep, x: str, y: str, metric: str) -> Figure:
    """A metric of a sweep over two parameters: the largest value of each cell; a cross where a row failed or
    faulted, or the value is not finite. Raises KeyError for a column that there is not, ValueError for one
    that is no number."""
    xs, ys, values = (found[name] for name in (x, y, metric))
    if metric not in found.metrics:
        raise ValueError(f"metric = {metric!r} is not one of {', '.join(found.metrics)}")
    for name, column in ((x, xs), (y, ys)):
        if column.ndim != 1 or column.dtype.kind not in "fiubU":
            raise ValueError(f"{name}: its values are neither numbers nor texts, a map has no axis for them")
    columns, rows = np.unique(xs), np.unique(ys)
    cells = np.full((len(rows), len(columns)), np.nan)
    lost = np.zeros(cells.shape, bool)
    for at_x, at_y, value, row in zip(xs, ys, values, found.rows, strict=True):
        k, j = np.searchsorted(rows, at_y), np.searchsorted(columns, at_x)
        cells[k, j] = np.fmax(cells[k, j], value if np.isfinite(value) else np.nan)
        lost[k, j] |= bool(row["error"]) or str(row["status"]).startswith("fault") or not np.isfinite(value)
    figure = new_figure(figsize=(6.4, 4.8), layout="constrained")
    panel = figure.subplots()
    mesh = panel.pcolormesh(np.arange(len(columns)), np.arange(len(rows)), cells, shading="nearest")
    figure.colorbar(mesh, ax=panel, label=_labelled(found, metric))
    at = np.argwhere(lost)
    if len(at):
        panel.plot(at[:, 1], at[:, 0], "x", color="C3", label="fault or failure")
        panel.legend(loc="upper right", fontsize="small")
    for axis, ticks, name in ((panel.xaxis, columns, x), (panel.yaxis, rows, y)):
        every = max(1, len(ticks) // 10)
        texts = [str(tick) if ticks.dtype.kind == "U" else f"{tick:.4g}" for tick in ticks[::every]]
        axis.set_ticks(np.arange(len(ticks))[::every], texts)
        axis.set_label_text(name)
    return figure


def _labelled(found: Sweep, metric: str) -> str:
    return f"{metric}, {found.units[metric]}" if metric in found.units else metric


def sweep_spread(found: Sweep, metrics: Sequence[str]) -> Figure:
    """Distribution of metrics over the rows of a sweep; rows that failed count as not reached."""
    figure = new_figure(figsize=(1.0 + 3.2 * len(metrics), 3.4), layout="constrained")
    for panel, name in zip(np.atleast_1d(figure.subplots(1, len(metrics))), metrics, strict=True):
        values = np.sort(found[name].astype(float))
        values = values[np.isfinite(values)]
        panel.step(values, np.arange(1, len(values) + 1) / max(1, len(found)), where="post")
        panel.set(xlabel=_labelled(found, name), ylabel="part of the rows", ylim=(0.0, 1.02))
        panel.locator_params(axis="x", nbins=4)
        panel.grid(alpha=0.3)
    return figure


_WIDTHS: Mapping[str, Mapping[str, Any]] = {
    # Wide and beneath, so that an estimate that coincides with it is seen.
    "true": {"linewidth": 2.0, "alpha": 0.55},
    "estimated": {"linewidth": 0.9},
    "reference": {"linewidth": 0.9, "linestyle": ":", "color": "#000000"},
}


def _lines(panel: Axes, result: Result, label: str, signals: dict[str, NDArray[Any]]) -> None:
    for name, values in signals.items():
        panel.plot(*thin(result.t, values), label=name, **_WIDTHS.get(name, {"linewidth": 0.9}))
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)


def _legend_above(panel: Axes, columns: int) -> None:
    """Between the panels: within one it would hide lines, beside it a narrow screen would cut it off."""
    place: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 0.98), "borderaxespad": 0.1}
    panel.legend(**place, ncols=columns, frameon=False, fontsize="small", handlelength=1.4)
