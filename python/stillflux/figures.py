"""Plots drawn like the paper's: the same signals, normalised, one trace below the other as on a recorder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stillflux import claims, metrics
from stillflux import scenarios as s
from stillflux.openloop import Waveforms
from stillflux.plots import thin as thin_to
from stillflux.result import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

__all__: list[str] = []

TRUE, ESTIMATE, THIRD = "#1b4f8f", "#c8501e", "#5f6b73"
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
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _parts(figure: Figure, rows: int, columns: int, **options: Any) -> Sequence[SubFigure]:
    parts: Sequence[SubFigure] = figure.subfigures(rows, columns, **options)
    return parts


@dataclass(frozen=True)
class Strip:
    """One panel: traces over time."""

    label: str
    traces: Sequence[tuple[str, NDArray[Any]]]
    limits: tuple[float, float] | None = None


def recorder(
    figure: Figure | SubFigure, t: NDArray[Any], strips: Sequence[Strip], unit: str = "s", title: str = ""
) -> None:
    """Panels with a common time axis."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        panels = figure.subplots(len(strips), 1, sharex=True, squeeze=False)[:, 0]
        for panel, strip in zip(panels, strips, strict=True):
            colours = (TRUE,) if len(strip.traces) == 1 else (ESTIMATE, TRUE, THIRD)
            for (name, values), colour in zip(strip.traces, colours, strict=False):
                panel.plot(*thin_to(t, values, 900), linewidth=0.9, color=colour, label=name)
            panel.set_ylabel(strip.label, rotation=0, ha="right", va="center")
            if strip.limits is not None:
                panel.set_ylim(*strip.limits)
            else:
                _at_least(panel)
            if len(strip.traces) > 1:
                panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        panels[0].set_xlim(t[0], t[-1])
        panels[-1].set_xlabel(f"t, {unit}")
        if title:
            panels[0].set_title(title, fontsize=9)


def _at_least(panel: Axes, span: float = 0.02) -> None:
    """Keeps a flat trace from being blown up to its noise."""
    low, high = panel.get_ylim()
    if high - low < span:
        middle = 0.5 * (high + low)
        panel.set_ylim(middle - span / 2, middle + span / 2)


class _PerUnit:
    """Signals of a result, per unit."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self.base = result.scenario.motor.base
        self.t = result.t

    def psi(self, name: str) -> NDArray[Any]:
        return np.asarray(self.result[name] / self.base["psi"])

    def u(self, name: str) -> NDArray[Any]:
        return np.asarray(self.result[name] / self.base["u"])

    def i(self, name: str) -> NDArray[Any]:
        return np.asarray(self.result[name] / self.base["i"])

    def omega_m(self, name: str = "omega_m") -> NDArray[Any]:
        return np.asarray(self.result[name] / self.base["omega_m"])

    def omega_s(self) -> NDArray[Any]:
        """True stator frequency, mean over 50 ms: the raw signal shows every switching period."""
        raw = self.result["omega_s"] / self.base["omega"]
        step = self.t[1] - self.t[0]
        samples = max(1, round(0.05 / step))
        padded = np.pad(np.clip(raw, -0.25, 0.25), samples, mode="edge")
        return claims.smoothed(padded, samples)[samples:-samples]

    def torque(self, name: str = "torque") -> NDArray[Any]:
        return np.asarray(self.result[name] / self.result.scenario.motor.T_N)

    def r_s(self) -> Strip:
        """Estimated and true resistance of winding and bridge over the nominal one."""
        scenario = self.result.scenario
        r_d = (scenario.plant_inverter or scenario.inverter).r_d
        nominal = scenario.motor.R_s + scenario.inverter.r_d
        estimate, true = self.result["estimate.R_s"] / nominal, (self.result["R_s"] + r_d) / nominal
        return Strip(r"$r_s/r_{sN}$", [("estimated", estimate), ("true", true)], (0.9, 1.35))

    def angle(self, limit: float = 15.0) -> Strip:
        error = metrics.angle_error(self.result)
        span = min(max(limit, 1.1 * float(np.abs(error).max())), 180.0)
        return Strip(
            "$\\hat\\delta-\\delta$, °", [("", error.clip(-span, span))], (-1.05 * span, 1.05 * span)
        )

    def i_q(self) -> Strip:
        return Strip("$i_q$", [("", self.i("estimate.i_dq").imag)])

    def i_alpha(self) -> Strip:
        return Strip(r"$i_\alpha$", [("", self.i("i_s").real)])

    def speed(self) -> Strip:
        estimate, true = self.omega_m("estimate.omega_m"), self.omega_m()
        # A machine that runs away would hide everything before.
        limits = (-0.25, 0.25) if np.abs(true).max() > 1.0 else None
        return Strip(r"$\omega$", [("estimated", estimate), ("true", true)], limits)

    def delta(self) -> Strip:
        angle = np.degrees(np.angle(self.result["estimate.psi_s"]))
        return Strip(r"$\hat\delta$, °", [("", angle)], (-190.0, 190.0))


def _until_fault(result: Result) -> Result:
    """The part before a fault, and a little of what follows."""
    faults = np.flatnonzero(result["status"] == 4)
    return result.window(0.0, float(result.t[faults[0]]) + 0.5) if len(faults) else result


def _from(result: Result, begin: float, end: float = float("inf")) -> _PerUnit:
    """A window with time from zero."""
    from dataclasses import replace

    part = result.window(begin, end)
    return _PerUnit(replace(part, t=part.t - begin))


def fig2(*runs: Waveforms) -> Figure:
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
            panel.set(aspect="equal", xlabel=r"$u_\alpha$", ylabel=r"$u_\beta$")
            panel.set_title(rf"({part}) $\omega_s$ = {run.run.omega_s:g}", fontsize=9)
            panel.legend(loc="upper right", markerscale=8)
    return figure


def fig5(result: Result) -> Figure:
    """Trajectory of ψ̂_1 within its limits."""
    import matplotlib as mpl

    figure = figure_of(4.6, 4.6)
    with mpl.rc_context(STYLE):
        panel = figure.subplots()
        begin = min(4.0, float(result.t[-1]) - 0.5)
        pu = _from(result, begin)
        psi = pu.psi("estimate.psi_1")
        circle = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
        panel.plot(
            circle.real, circle.imag, color=THIRD, linewidth=0.8, linestyle=":", label=r"$|\psi|=\psi_s^*$"
        )
        panel.plot(
            [-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1], color=THIRD, linewidth=0.8, label=r"limits $\pm\psi_s^*$"
        )
        panel.plot(*_spaced(psi), color=TRUE, linewidth=0.9, label=r"$\hat\psi_1$")
        panel.axhline(0, color="#aaa", linewidth=0.6)
        panel.axvline(0, color="#aaa", linewidth=0.6)
        panel.set(
            aspect="equal", xlabel=r"$\hat\psi_{1\alpha}/\psi_s^*$", ylabel=r"$\hat\psi_{1\beta}/\psi_s^*$"
        )
        panel.set(xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
        panel.legend(loc="center")
    return figure


def _spaced(z: NDArray[Any], points: int = 1500) -> tuple[NDArray[Any], NDArray[Any]]:
    """Real and imaginary part of points at equal distances along a path."""
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(z)))))
    chosen = np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], points)).clip(max=len(z) - 1))
    return z[chosen].real, z[chosen].imag


def fig6(run: Waveforms) -> Figure:
    """Three phase currents over a period, and i_a about its zero crossing."""
    import matplotlib as mpl

    figure = figure_of(8.5, 4.6)
    axes = np.exp(-2j * np.pi / 3 * np.arange(3))
    i_abc = (run.i_s[:, None] * axes).real / run.run.motor.base["i"]
    period = len(run.t) // run.run.periods
    top, bottom = _parts(figure, 2, 1)
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
        left.set(xlabel="t, ms", ylabel="$i_a$ at the carrier peak")
        leg = run.distortion.real[near] / (2 / 3 * run.threshold)
        right.plot(1e3 * run.t[near], leg, linewidth=0.9, color=TRUE)
        right.set(xlabel="t, ms", ylabel="voltage lost in leg a\nover its full value", ylim=(-1.3, 1.3))
    return figure


def fig8(result: Result) -> Figure:
    """Components of u_hf, and the lines of its radial component."""
    import matplotlib as mpl

    figure = figure_of(8.5, 5.0)
    steady = result.window(min(s.FIG8_STEADY, float(result.t[-1]) - 0.5))
    upper, lower = _parts(figure, 2, 1, height_ratios=(3, 2))
    pu = _from(steady, float(steady.t[0]), float(steady.t[0]) + 0.4)
    u = 1e3 * pu.u("estimate.u_hf")
    recorder(
        upper,
        pu.t,
        [Strip(r"$10^3\,u_{hf\alpha}$", [("", u.real)]), Strip(r"$10^3\,u_{hf\beta}$", [("", u.imag)])],
    )
    with mpl.rc_context(STYLE):
        panel = lower.subplots()
        lines = 1e3 * claims.u_hf_lines(steady)
        panel.bar(
            np.arange(1, 41), lines, width=0.6, color=[ESTIMATE if k == 6 else TRUE for k in range(1, 41)]
        )
        panel.set(xlabel="multiple of stator frequency, in field coordinates", ylabel="line of $u_{hf}$, mV")
        panel.set_xticks(range(0, 42, 6))
    return figure


def fig9(result: Result) -> Figure:
    """Start: flux, field angle, offset voltage; the last periods enlarged."""
    figure = figure_of(9.5, 6.2)
    left, right = _parts(figure, 1, 2, width_ratios=(3, 2))
    for part, begin, end in ((left, 0.0, float("inf")), (right, s.RUN - 0.2, s.RUN + 2.3)):
        pu = _from(result, begin, end)
        psi, psi_1 = pu.psi("estimate.psi_s"), pu.psi("estimate.psi_1")
        u_off = 1e3 * pu.u("estimate.u_off")
        strips = [
            pu.speed(),
            Strip(r"$\psi_\alpha$", [("estimated", psi.real), ("true", pu.psi("psi_s").real)], (-1.3, 1.3)),
            Strip(r"$\hat\psi_{1\alpha}$", [("", psi_1.real)], (-1.3, 1.3)),
            Strip(r"$10^3\,\hat u_{off}$", [(r"$\alpha$", u_off.real), (r"$\beta$", u_off.imag)]),
            pu.delta(),
            pu.angle(20.0),
        ]
        recorder(part, pu.t + begin, strips)
        if part is left:
            for panel in part.axes:
                panel.axvspan(s.RUN - 0.2, s.RUN + 2.3, color="#eee", zorder=0)
                legend = panel.get_legend()
                if legend is not None:
                    legend.remove()
    return figure


def fig15(result: Result, *others: Result) -> Figure:
    """(a) circle, (b) flux components and angle error, (c) current and speed."""
    import matplotlib as mpl

    del others
    result = _until_fault(result)
    figure = figure_of(9.5, 6.2)
    left, right = _parts(figure, 1, 2, width_ratios=(2, 3))
    begin = min(s.FIG15_SETTLED, max(0.0, float(result.t[-1]) - 3.0))
    pu = _from(result, begin, begin + 3.0)
    psi, true = pu.psi("estimate.psi_s"), pu.psi("psi_s")
    with mpl.rc_context(STYLE):
        panel = left.subplots()
        panel.plot(*_spaced(psi), color=ESTIMATE, linewidth=0.9, label="estimated")
        panel.plot(*_spaced(true), color=TRUE, linewidth=0.9, label="true")
        panel.set(aspect="equal", xlabel=r"$\psi_\alpha$", ylabel=r"$\psi_\beta$", title="(a)")
        panel.legend(loc="center")
    strips = [
        Strip(r"$\psi_\alpha$", [("estimated", psi.real), ("true", true.real)]),
        Strip(r"$\psi_\beta$", [("estimated", psi.imag), ("true", true.imag)]),
        pu.angle(5.0),
        pu.i_alpha(),
        Strip("$i_q$", pu.i_q().traces, _wide(pu.i("estimate.i_dq").imag, 0.1)),
        Strip("$T/T_N$", [("", pu.torque())], _wide(pu.torque(), 0.1)),
        Strip(
            r"$\omega$",
            [("estimated", pu.omega_m("estimate.omega_m")), ("true", pu.omega_m())],
            _wide(pu.omega_m("estimate.omega_m"), 0.005),
        ),
    ]
    recorder(right, pu.t, strips, title="(b) above, (c) below")
    return figure


def _wide(x: NDArray[Any], span: float) -> tuple[float, float]:
    """Limits about the mean, at least ±`span`."""
    middle = float(x.mean())
    half = max(span, 1.1 * float(np.abs(x - middle).max()))
    return middle - half, middle + half


fig10 = fig15


def fig11(*results: Result) -> Figure:
    """Loci i_d(i_q): lines of the closed form, points of the plant."""
    import matplotlib as mpl

    figure = figure_of(6.4, 4.6)
    colours = ("#7b3294", "#b07cc0", TRUE, "#5aae61", "#1b7837")
    with mpl.rc_context(STYLE):
        panel = figure.subplots()
        for result, ratio, colour in zip(results, s.FIG11_RATIOS, colours, strict=True):
            if result.status != "running":
                continue
            i_q, i_d, expected, _ = claims.locus(result, ratio)
            panel.plot(i_q, expected, color=colour, linewidth=1.0, label=rf"$\hat r_s/r_s$ = {ratio:g}")
            panel.plot(i_q, i_d, "o", color=colour, markersize=3.5)
        panel.set(xlabel="$i_q$", ylabel="$i_d$", title="points: plant; lines: closed form")
        panel.title.set_fontsize(9)
        panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def fig13(result: Result) -> Figure:
    """Resistance, i_q, speed and field angle error about the step of r_s."""
    event = s.FIG13A_CHANGE if "13a" in result.scenario.name else s.FIG13B_CHANGE
    result = _until_fault(result)
    begin = event - 1.0
    pu = _from(result, begin, event + (8.0 if "13a" in result.scenario.name else 2.0))
    figure = figure_of(7.5, 5.4)
    recorder(figure, pu.t, [pu.r_s(), pu.i_q(), pu.i_alpha(), pu.speed(), pu.angle(5.0)])
    return figure


def fig14(result: Result) -> Figure:
    """Speed, current, resistance over the excursion."""
    result = _until_fault(result)
    pu = _from(result, min(6.0, float(result.t[-1]) - 1.0))
    figure = figure_of(7.5, 5.4)
    recorder(figure, pu.t, [pu.speed(), pu.i_q(), pu.i_alpha(), pu.r_s(), pu.angle(5.0)])
    return figure


def fig16(earlier: Result, result: Result) -> Figure:
    """Speed, flux, field angle and current from the first moment on."""
    del earlier
    pu = _from(result, 0.0)
    psi = pu.psi("estimate.psi_s")
    figure = figure_of(7.5, 5.8)
    strips = [
        pu.speed(),
        Strip(r"$\psi_\alpha$", [("estimated", psi.real), ("true", pu.psi("psi_s").real)], (-1.3, 1.3)),
        pu.delta(),
        pu.i_alpha(),
        pu.angle(5.0),
    ]
    recorder(figure, pu.t, strips)
    return figure


def fig17(result: Result) -> Figure:
    """Stator frequency on top, speed, load, current."""
    result = _until_fault(result)
    pu = _from(result, s.FIG17_BEGIN - 2.0)
    figure = figure_of(7.5, 6.0)
    strips = [
        Strip(r"$\omega_s$", [("", pu.omega_s())]),
        pu.speed(),
        Strip("$i_q$", pu.i_q().traces),
        pu.i_alpha(),
        pu.angle(5.0),
    ]
    recorder(figure, pu.t, strips)
    return figure


def fig18(result: Result) -> Figure:
    """The whole minute: speed, current, field angle."""
    result = _until_fault(result)
    pu = _from(result, s.IDENTIFIED - 2.0)
    figure = figure_of(9.0, 6.0)
    strips = [
        pu.speed(),
        Strip(r"$\omega_s$", [("", pu.omega_s())]),
        pu.i_q(),
        pu.i_alpha(),
        pu.delta(),
        pu.angle(15.0),
    ]
    recorder(figure, pu.t, strips)
    return figure


def fig19(result: Result) -> Figure:
    """The step, expanded."""
    result = _until_fault(result)
    pu = _from(result, s.LOAD_STEP - 0.5, s.LOAD_STEP + 2.0)
    figure = figure_of(7.5, 5.8)
    strips = [
        pu.speed(),
        Strip("$T/T_N$", [("load", pu.torque("load_torque")), ("motor", pu.torque())]),
        pu.i_q(),
        pu.i_alpha(),
        pu.angle(5.0),
    ]
    recorder(figure, pu.t, strips)
    return figure


def fig20(result: Result) -> Figure:
    """Regeneration after the step."""
    result = _until_fault(result)
    pu = _from(result, s.LOAD_STEP - 1.0)
    figure = figure_of(7.5, 5.8)
    strips = [pu.speed(), Strip(r"$\omega_s$", [("", pu.omega_s())]), pu.i_q(), pu.i_alpha(), pu.angle(5.0)]
    recorder(figure, pu.t, strips)
    return figure
