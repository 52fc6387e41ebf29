"""What plots share: drawn like the paper's, normalised, one trace below the other as on a recorder.

Events are dashed lines with a name, references dotted, angles within ±180°. From where control was lost on
the plot is shaded and says so; what lies beyond a scale is told in numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillflux import metrics
from stillflux.evidence.judge import CONFIDENT, angle, lost
from stillflux.plots import thin as thin_to
from stillflux.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

__all__ = [
    "ESTIMATE",
    "LOST",
    "STYLE",
    "THIRD",
    "TRUE",
    "Events",
    "PerUnit",
    "Strip",
    "adaptation",
    "adapting",
    "figure_of",
    "from_time",
    "parts",
    "record",
    "recorder",
    "recording",
    "side_by_side",
    "spaced",
    "until_fault",
    "wide",
]

TRUE, ESTIMATE, THIRD, LOST = "#1b4f8f", "#c8501e", "#5f6b73", "#b3261e"
LOST_TEXT = "control lost"
Events: TypeAlias = Sequence[tuple[float, str]]
"""Time in s and name of what happens."""
STYLE: Any = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888",
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "grid.color": "#e4e4e4",
    "axes.grid": True,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.handlelength": 1.2,
    "svg.fonttype": "path",
}


def figure_of(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def parts(figure: Figure | SubFigure, rows: int, columns: int, **options: Any) -> Sequence[SubFigure]:
    """Figures within a figure."""
    within: Sequence[SubFigure] = figure.subfigures(rows, columns, **options)
    return within


@dataclass(frozen=True)
class Strip:
    """One panel: traces over time."""

    label: str
    traces: Sequence[tuple[str, NDArray[Any]]]
    limits: tuple[float, float] | None = None
    level: float | None = None
    """A level worth a line."""
    unit: str = "pu"
    """Empty: a ratio."""


def recorder(
    figure: Figure | SubFigure,
    t: NDArray[Any],
    strips: Sequence[Strip],
    unit: str = "s",
    title: str = "",
    events: Events = (),
    loss: float | None = None,
) -> None:
    """Panels with a common time axis; `events` and the time of a loss of control on the same axis."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        panels = figure.subplots(len(strips), 1, sharex=True, squeeze=False)[:, 0]
        for panel, strip in zip(panels, strips, strict=True):
            colours = (TRUE,) if len(strip.traces) == 1 else (ESTIMATE, TRUE, THIRD)
            for (name, values), colour in zip(strip.traces, colours, strict=False):
                line = ":" if name == "reference" else "-"
                # Wide and beneath, so that an estimate that coincides with it is seen.
                width, order = (1.8, 1.9) if name == "true" else (0.9, 2.0)
                shown = thin_to(t, values, 900)
                panel.plot(*shown, line, linewidth=width, zorder=order, color=colour, label=name)
            label = f"{strip.label}, {strip.unit}" if strip.unit else strip.label
            panel.set_ylabel(label, rotation=0, ha="right", va="center")
            if strip.limits is not None:
                panel.set_ylim(*strip.limits)
                _tell_beyond(panel, strip)
            else:
                _at_least(panel)
            if strip.level is not None:
                panel.axhline(strip.level, color=THIRD, linewidth=0.7, linestyle=":")
            if len(strip.traces) > 1:
                panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
            for time, _ in events:
                panel.axvline(time, color="#888", linewidth=0.7, linestyle="--")
            if loss is not None:
                panel.axvspan(loss, max(loss, float(t[-1])), color=LOST, alpha=0.12, linewidth=0)
        panels[0].set_xlim(t[0], t[-1])
        panels[-1].set_xlabel(f"t, {unit}")
        rows = _name(panels[0], t, [*events, *([(loss, LOST_TEXT)] if loss is not None else [])])
        if title:
            panels[0].set_title(title, fontsize=9, pad=6.0 + _ROW * rows)


_ROW, _LETTER = 8.0, 3.7
"""Height of a row of names and width of a letter, points."""


def _name(panel: Axes, t: NDArray[Any], events: Events) -> int:
    """Names above the uppermost panel, in two rows where one would run into the next; how many rows."""
    # Panels take about two thirds of the width of their figure.
    points = 0.66 * 72.0 * panel.figure.bbox.width / panel.figure.dpi / float(t[-1] - t[0])
    ends = [-np.inf, -np.inf]
    rows = 0
    for time, name in sorted(events):
        if not t[0] <= time <= t[-1]:
            continue
        is_loss = name == LOST_TEXT
        to_right = time - t[0] < 0.85 * (t[-1] - t[0])
        begin, length = points * (time - t[0]), _LETTER * len(name)
        row = 0 if is_loss or begin - (0.0 if to_right else length) > ends[0] else 1
        if not is_loss:
            ends[row] = begin + (length if to_right else 0.0)
            rows = max(rows, row + 1)
        panel.annotate(
            name,
            (time, 1.0),
            # A loss often follows at the heels of an event: its name stands within the panel.
            (2, -2) if is_loss else (0, 2 + _ROW * row),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=7,
            ha="left" if to_right else "right",
            va="top" if is_loss else "bottom",
            color=LOST if is_loss else "#444",
        )
    return rows


def _tell_beyond(panel: Axes, strip: Strip) -> None:
    """Says how far a trace leaves the scale."""
    low, high = panel.get_ylim()
    least = min(float(np.nanmin(values)) for _, values in strip.traces)
    most = max(float(np.nanmax(values)) for _, values in strip.traces)
    beyond = [f"{x:.2g}" for x, is_out in ((least, least < low), (most, most > high)) if is_out]
    if beyond:
        text = f"beyond the scale: {', '.join(beyond)}"
        panel.text(0.01, 0.95, text, transform=panel.transAxes, fontsize=6.5, va="top", color=LOST)


def _at_least(panel: Axes, span: float = 0.02) -> None:
    """Keeps a flat trace from being blown up to its noise."""
    low, high = panel.get_ylim()
    if high - low < span:
        middle = 0.5 * (high + low)
        panel.set_ylim(middle - span / 2, middle + span / 2)


class PerUnit:
    """Signals of a result, per unit."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.base = result.scenario.motor.base
        self.t = result.t

    def psi(self, name: str) -> NDArray[Any]:
        """A flux."""
        return np.asarray(self.result[name] / self.base["psi"])

    def u(self, name: str) -> NDArray[Any]:
        """A voltage."""
        return np.asarray(self.result[name] / self.base["u"])

    def i(self, name: str) -> NDArray[Any]:
        """A current."""
        return np.asarray(self.result[name] / self.base["i"])

    def omega_m(self, name: str = "omega_m") -> NDArray[Any]:
        """A mechanical speed."""
        return np.asarray(self.result[name] / self.base["omega_m"])

    def omega_s(self) -> NDArray[Any]:
        """True stator frequency, mean over 50 ms: the raw signal shows every switching period."""
        raw = self.result["omega_s"] / self.base["omega"]
        step = self.t[1] - self.t[0]
        samples = max(1, round(0.05 / step))
        padded = np.pad(np.clip(raw, -0.25, 0.25), samples, mode="edge")
        return metrics.smoothed(padded, samples)[samples:-samples]

    def frequency(self) -> Strip:
        """The same as a panel."""
        return Strip(r"$\omega_s$", [("", self.omega_s())])

    def torque(self, name: str = "torque") -> NDArray[Any]:
        """A torque, in units of rated torque."""
        return np.asarray(self.result[name] / self.result.scenario.motor.T_N)

    def r_s(self, limits: tuple[float, float] = (0.9, 1.35)) -> Strip:
        """Estimated and true resistance of winding and bridge over the nominal one."""
        scenario = self.result.scenario
        r_d = (scenario.plant_inverter or scenario.inverter).r_d
        nominal = scenario.motor.R_s + scenario.inverter.r_d
        estimate, true = self.result["estimate.R_s"] / nominal, (self.result["R_s"] + r_d) / nominal
        least, most = min(estimate.min(), true.min()), max(estimate.max(), true.max())
        limits = min(limits[0], least - 0.02), max(limits[1], most + 0.02)
        return Strip(r"$r_s/r_{sN}$", [("estimated", estimate), ("true", true)], limits, unit="")

    def angle(self, limit: float = 15.0) -> Strip:
        """Field angle error, within ±180°."""
        error = np.where(metrics.faulted(self.result), np.nan, angle(self.result))
        span = min(max(limit, 1.1 * float(np.nanmax(np.abs(error)))), 180.0)
        return Strip(r"$\hat\delta-\delta$", [("", error)], (-1.05 * span, 1.05 * span), unit="°")

    def confidence(self) -> Strip:
        """The drive's confidence in its field angle, and the level below which 15° must be expected."""
        return Strip("confidence", [("", self.result["estimate.confidence"])], (-0.05, 1.05), CONFIDENT, "")

    def i_q(self) -> Strip:
        """Torque-producing current."""
        return Strip("$i_q$", [("", self.i("estimate.i_dq").imag)])

    def i_alpha(self) -> Strip:
        """One component of the true current."""
        return Strip(r"$i_\alpha$", [("", self.i("i_s").real)])

    def speed(self) -> Strip:
        """Estimated and true speed, and the reference."""
        estimate, true = self.omega_m("estimate.omega_m"), self.omega_m()
        reference = self.omega_m("reference")
        # A machine that runs away would hide everything before.
        low, high = min(reference.min(), 0.0), max(reference.max(), 0.0)
        limits = (low - 0.25, high + 0.25) if np.abs(true - reference).max() > 0.3 else None
        return Strip(r"$\omega$", [("estimated", estimate), ("true", true), ("reference", reference)], limits)

    def delta(self) -> Strip:
        """Estimated field angle."""
        angle = np.degrees(np.angle(self.result["estimate.psi_s"]))
        return Strip(r"$\hat\delta$", [("", angle)], (-190.0, 190.0), unit="°")


def until_fault(result: Result) -> Result:
    """The part before a fault, and a little of what follows."""
    faults = np.flatnonzero(metrics.faulted(result))
    return result.window(0.0, float(result.t[faults[0]]) + 0.5) if len(faults) else result


def from_time(result: Result, begin: float, end: float = float("inf")) -> PerUnit:
    """A window with time from zero."""
    part = result.window(begin, end)
    return PerUnit(replace(part, t=part.t - begin))


def adaptation(result: Result, begin: float, events: Events) -> Figure:
    """Resistance, i_q, speed and angle from a time on."""
    return recording(result, adapting(), begin, size=(7.5, 5.2), events=events)


def adapting(most: float = 5.0) -> Callable[[PerUnit], list[Strip]]:
    """Strips of the resistance adaptation, the angle error within ± `most` degrees."""
    return lambda pu: [pu.r_s(), pu.i_q(), pu.speed(), pu.angle(most)]


def recording(
    result: Result,
    strips: Callable[[PerUnit], Sequence[Strip]],
    begin: float,
    end: float = float("inf"),
    size: tuple[float, float] = (7.5, 5.8),
    events: Events = (),
) -> Figure:
    """One recorder of a run from `begin` to `end` s, no further than a fault, with the confidence below."""
    figure = figure_of(*size)
    record(figure, result, strips, begin, end, events)
    return figure


def record(
    figure: Figure | SubFigure,
    result: Result,
    strips: Callable[[PerUnit], Sequence[Strip]],
    begin: float,
    end: float = float("inf"),
    events: Events = (),
    title: str = "",
) -> None:
    """The same as part of a figure."""
    loss, _ = lost(result)
    part = until_fault(result)
    begin = min(begin, float(part.t[-1]) - 1.0)
    pu = from_time(part, begin, end)
    last = begin + float(pu.t[-1])
    recorder(
        figure,
        pu.t,
        [*strips(pu), pu.confidence()],
        title=title,
        events=[(t - begin, name) for t, name in events if begin <= t <= last],
        loss=max(loss - begin, 0.0) if loss < last else None,
    )


def side_by_side(
    results: Sequence[Result],
    titles: Sequence[str],
    strips: Callable[[PerUnit], Sequence[Strip]],
    begin: float,
    end: float = float("inf"),
    events: Events = (),
    height: float = 5.4,
) -> Figure:
    """Several runs of one course, a recorder each, under their titles."""
    figure = figure_of(2.0 + 3.6 * len(results), height)
    for part, result, title in zip(parts(figure, 1, len(results)), results, titles, strict=True):
        record(part, result, strips, begin, end, events, title)
    return figure


def spaced(z: NDArray[Any], points: int = 1500) -> tuple[NDArray[Any], NDArray[Any]]:
    """Real and imaginary part of points at equal distances along a path."""
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(z)))))
    chosen = np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], points)).clip(max=len(z) - 1))
    return z[chosen].real, z[chosen].imag


def wide(x: NDArray[Any], span: float) -> tuple[float, float]:
    """Limits about the mean, at least ±`span`."""
    middle = float(x.mean())
    half = max(span, 1.1 * float(np.abs(x - middle).max()))
    return middle - half, middle + half
