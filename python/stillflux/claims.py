"""What the runs of `stillflux.scenarios` must show, judged on the plant's truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stillflux import metrics
from stillflux import scenarios as s
from stillflux.openloop import Waveforms
from stillflux.result import Result

__all__ = ["Claim"]


@dataclass(frozen=True)
class Claim:
    """One claim, what the plant's truth says, and whether that is enough."""

    text: str
    measured: str
    ok: bool
    of_motor: bool = True
    """Whether it is about how the motor runs; False: about an inner quantity of the drive."""
    value: float | None = None
    """What was measured as a number, if it is one."""
    limit: float | None = None
    """What it is compared with."""
    unit: str = ""


def at_most(text: str, value: float, limit: float, unit: str = "") -> Claim:
    """Claims `value <= limit`."""
    return _compared(f"{text} ≤ {limit:.3g}{unit}", value, limit, unit, bool(value <= limit))


def at_least(text: str, value: float, limit: float, unit: str = "") -> Claim:
    """Claims `value >= limit`."""
    return _compared(f"{text} ≥ {limit:.3g}{unit}", value, limit, unit, bool(value >= limit))


def _compared(text: str, value: float, limit: float, unit: str, ok: bool) -> Claim:
    return Claim(text, f"{value:.3g}{unit}", ok, value=float(value), limit=float(limit), unit=unit)


def _alive(result: Result) -> Claim:
    return Claim("the drive runs to the end", str(result.status), result.status == "running")


def _angle(text: str, result: Result, limit: float) -> Claim:
    return at_most(f"field angle error {text}", float(np.abs(metrics.angle_error(result)).max()), limit, "°")


def _speed(text: str, result: Result) -> Claim:
    return at_most(f"speed error {text}", float(np.abs(metrics.speed_error(result)).max()), 0.002, " pu")


def _recovery(text: str, result: Result, event: float, limit: float) -> Claim:
    time = metrics.settled_after(result, event, 0.002)
    return at_most(f"speed back within ±0.002 pu after the {text} step", time, limit, " s")


def _offset_found(result: Result, limit: float) -> Claim:
    true = metrics.offset_voltage(result)
    deviation = 100 * abs(result["estimate.u_off"].mean() - true) / abs(true)
    claim = at_most("û_off, deviation from the true offset", deviation, limit, " %")
    return replace(claim, of_motor=False)


# Figs. 2 and 6: the bridge.

_U_TH = 1.0
"""Threshold voltage of both inverters, V."""


def fig2(*runs: Waveforms) -> list[Claim]:
    """Jumps, fundamental and harmonics of the average voltage; motoring twice, driven twice."""
    claims = []
    for run in runs[:2]:
        at = f"ω_s = {run.run.omega_s:g}"
        jumps, per_period = _jumps(run)
        worst = 100 * float(np.abs(jumps / (4 / 3 * _U_TH) - 1).max())
        claims.append(at_most(f"{at}: jumps, worst deviation from (4/3) u_th", worst, 5, " %"))
        claims.append(Claim(f"{at}: six jumps a period", f"{per_period:.3g}", round(per_period) == 6))
    for run in runs:
        kind = "motoring" if run.run.omega_r > 0 else "driven"
        u_ref, u_av = run.harmonic(run.u_ref, 1), run.harmonic(run.u_ref - run.distortion, 1)
        cos_phi = (u_ref * run.harmonic(run.i_mean, 1).conjugate()).real
        cos_phi /= abs(u_ref) * abs(run.harmonic(run.i_mean, 1))
        lost, expected = abs(u_ref) - abs(u_av), 4 / np.pi * _U_TH * cos_phi
        claims.append(
            at_most(
                f"ω_s = {run.run.omega_s:g}, {kind}, φ = {np.degrees(np.arccos(cos_phi)):.0f}°: "
                "loss of fundamental, deviation from (4/π) u_th cos φ",
                100 * abs(lost / expected - 1),
                5,
                " %",
            )
        )
    for run in runs[:2]:
        for order in (-5, 7):
            found = abs(run.harmonic(run.distortion, order)) * abs(order) / (4 / np.pi * _U_TH)
            text = f"ω_s = {run.run.omega_s:g}: harmonic {abs(order)}, deviation from (4/π) u_th/{abs(order)}"
            claims.append(at_most(text, 100 * abs(found - 1), 10, " %"))
    return claims


def _jumps(run: Waveforms) -> tuple[NDArray[np.float64], float]:
    """Distances between the distortion's neighbouring positions, and how often it moves in one period."""
    d = run.distortion
    sector = np.round(np.angle(d) / (np.pi / 3)).astype(int) % 6
    positions = np.array([d[sector == k].mean() if (sector == k).any() else 0.0 for k in range(6)])
    # A sector counts once it has lasted: ripple makes it flicker at the border.
    lasted = [sector[k] for k in range(20, len(sector)) if (sector[k - 20 : k] == sector[k]).all()]
    moves = np.count_nonzero(np.diff(lasted))
    return np.abs(np.roll(positions, -1) - positions), moves / run.run.periods


def fig6(run: Waveforms) -> list[Claim]:
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
    return [
        at_least("time within ±2 % of the amplitude, as multiple of a sine's", longest / sine, 3),
        at_least("switching periods per crossing in which i_a reverses", float(reversing), 10),
    ]


# Figs. 5 and 8: inner signals of the estimator.


def fig5(result: Result) -> list[Claim]:
    """One limit touched per axis, the other side clear, means with the signs of the offset."""
    if result.status != "running":
        return [_alive(result)]
    settled = result.window(4.0)
    psi = settled["estimate.psi_1"] / result.scenario.motor.base["psi"]
    true = metrics.offset_voltage(settled)
    sides = [np.sort([-x.min(), x.max()]) for x in (psi.real, psi.imag)]
    mean = 0.5 * complex(psi.real.max() + psi.real.min(), psi.imag.max() + psi.imag.min())
    signs = np.sign([mean.real, mean.imag]) == np.sign([true.real, true.imag])
    return [
        _alive(result),
        at_least("far boundary touched on both axes, extreme", float(min(x[1] for x in sides)), 0.999, " ψ*"),
        at_least("clearance from the opposite boundary", float(1 - max(x[0] for x in sides)), 0.02, " ψ*"),
        Claim(
            "(max + min)/2 of ψ̂_1 with the signs of the offset, (−, +)",
            f"({mean.real:+.2f}, {mean.imag:+.2f}) ψ*",
            bool(signs.all()) and mean.real < 0 < mean.imag,
            value=abs(mean),
            unit=" ψ*",
        ),
    ]


def fig8(result: Result) -> list[Claim]:
    """Small, and dominated by the sixth harmonic in field coordinates."""
    if result.status != "running":
        return [_alive(result)]
    steady = result.window(s.FIG8_STEADY)
    u_hf = steady["estimate.u_hf"]
    rms = 100 * float(np.sqrt((np.abs(u_hf) ** 2).mean())) / result.scenario.motor.base["u"]
    lines = u_hf_lines(steady)
    others = np.delete(lines, 5)
    largest = int(others.argmax())
    sixth = float(lines[5] / others[largest]) if others[largest] > 0 else 0.0
    name = largest + 1 if largest < 5 else largest + 2
    return [
        _alive(result),
        at_most("u_hf, rms", rms, 2, " % of rated voltage"),
        replace(
            at_least("sixth harmonic over the next largest", sixth, 1),
            measured=f"{sixth:.2g} (order {name})",
        ),
    ]


def u_hf_lines(result: Result) -> NDArray[np.float64]:
    """Amplitudes of the radial component of u_hf at the multiples 1, 2, … 40 of stator frequency, V."""
    angle = np.unwrap(np.angle(result["psi_s"]))
    angle = np.abs(angle - angle[0])
    whole = int(angle[-1] / (2 * np.pi))
    radial = (result["estimate.u_hf"] * np.exp(-1j * np.angle(result["estimate.psi_s"]))).real
    grid = np.linspace(0.0, 2 * np.pi * whole, 4096 * whole, endpoint=False)
    spectrum = 2 * np.abs(np.fft.rfft(np.interp(grid, angle, radial))) / len(grid)
    lines: NDArray[np.float64] = spectrum[whole * np.arange(1, 41)]
    return lines


# Figs. 9, 10, 15, 16: offset.


def fig9(result: Result) -> list[Claim]:
    """Start with offset."""
    start = metrics.start_time(result)
    effective = Claim(
        "estimate effective at 1.5 ± 0.2 s",
        f"{start:.3g} s",
        abs(start - s.RUN) <= 0.2,
        value=start,
        unit=" s",
    )
    if result.status != "running":
        return [effective, _alive(result)]
    settled = result.window(s.FIG9_SETTLED)
    psi_1 = settled["estimate.psi_1"]
    centre = max(abs(x.max() + x.min()) / 2 for x in (psi_1.real, psi_1.imag))
    return [
        effective,
        _alive(result),
        _offset_found(settled, 5),
        at_most("centre of ψ̂_1", float(100 * centre / result.scenario.motor.base["psi"]), 5, " % of ψ*"),
    ]


def fig15(result: Result) -> list[Claim]:
    """Round circle, right angle, offset found."""
    if result.status != "running":
        return [_alive(result)]
    settled = result.window(s.FIG15_SETTLED)
    return [
        _alive(result),
        at_most("ripple of |ψ̂_s|", 100 * metrics.flux_ripple(settled), 1, " %"),
        at_most("mean field angle error", abs(float(metrics.angle_error(settled).mean())), 2, "°"),
        _offset_found(settled, 2),
    ]


def fig10(result: Result, fig15_result: Result) -> list[Claim]:
    """The circle stays round, the angle does not stay right."""
    if result.status != "running":
        return [_alive(result)]
    settled = result.window(s.FIG15_SETTLED)
    angle = float(np.abs(metrics.angle_error(settled)).max())
    rate = abs(settled["omega_s"].mean()) * np.abs(settled["psi_s"]).mean()
    bound = float(np.degrees(abs(metrics.offset_voltage(settled)) / rate))
    quiet = metrics.speed_ripple(fig15_result.window(s.FIG15_SETTLED))
    return [
        _alive(result),
        at_most("ripple of |ψ̂_s|", 100 * metrics.flux_ripple(settled), 3, " %"),
        at_least("field angle error over u_0/(ω_s ψ)", angle / bound, 1),
        at_least("speed ripple over Fig. 15's", metrics.speed_ripple(settled) / quiet, 5),
    ]


def fig16(earlier: Result, result: Result) -> list[Claim]:
    """Regulated within two periods of 4 s."""
    del earlier
    if result.status != "running":
        return [_alive(result)]
    regulated = result.window(s.RUN + 8.0)
    return [
        _alive(result),
        _speed("after two periods", regulated),
        _angle("from the start on", result.window(s.RUN + 0.2), 5),
    ]


# Figs. 11, 13, 14: stator resistance.


def locus(result: Result, ratio: float) -> NDArray[np.float64]:
    """Rows i_q, i_d, i_d of the closed form and ψ̂_s, per unit, one column for each load."""
    scenario = result.scenario
    base, motor, r_d = scenario.motor.base, scenario.motor, scenario.inverter.r_d
    l_s, sigma_l_s = motor.L_s / base["l"], motor.L_sigma / base["l"]
    r_hat = (motor.R_s + r_d) / base["z"]
    points = []
    for k in range(len(s.FIG11_LOADS)):
        end = s.FIG11_BEGIN + (k + 1) * s.FIG11_STAY
        steady = result.window(end - 1.0, end - 1e-3)
        turned = steady["i_s"] * np.exp(-1j * np.angle(steady["estimate.psi_s"]))
        i_d, i_q = turned.mean().real / base["i"], turned.mean().imag / base["i"]
        psi = np.abs(steady["estimate.psi_s"]).mean() / base["psi"]
        kappa = r_hat * (1.0 - 1.0 / ratio) / (steady["omega_s"].mean() / base["omega"])
        # ψ² - (l_s + σl_s) i_d ψ + l_s σl_s i² = ε = -(2 ψ κ i_q + κ² i²), solved for i_d.
        a, b = l_s * sigma_l_s + kappa**2, (l_s + sigma_l_s) * psi
        root = b * b - 4 * a * (psi**2 + 2 * psi * kappa * i_q + a * i_q**2)
        points.append((i_q, i_d, (b - np.sqrt(root)) / (2 * a) if root >= 0 else np.nan, psi))
    return np.array(points).T


def fig11(*results: Result) -> list[Claim]:
    """i_d(i_q) on the closed form for every r̂_s/r_s."""
    claims = []
    for result, ratio in zip(results, s.FIG11_RATIOS, strict=True):
        if result.status != "running":
            claims.append(_alive(result))
            continue
        _, i_d, expected, _ = locus(result, ratio)
        deviation = 100 * np.abs(i_d / expected - 1)
        worst = float(np.nan_to_num(deviation, nan=np.inf).max())
        claims.append(
            at_most(f"r̂_s/r_s = {ratio:g}: i_d, worst deviation from the closed form", worst, 1, " %")
        )
    return claims


def resistance_error(result: Result) -> NDArray[np.float64]:
    """`r̂_s` over the true resistance of winding and bridge, less one."""
    r_d = (result.scenario.plant_inverter or result.scenario.inverter).r_d
    error: NDArray[np.float64] = result["estimate.R_s"] / (result["R_s"] + r_d) - 1
    return error


def _identified(result: Result, event: float, within: float) -> float:
    """Seconds from `event` until the resistance error stays within ±`within`."""
    after = result.window(event)
    outside = np.flatnonzero(np.abs(resistance_error(after)) > within)
    if not len(outside):
        return 0.0
    return float("inf") if outside[-1] == len(after.t) - 1 else float(after.t[outside[-1] + 1] - event)


def fig13a(result: Result) -> list[Claim]:
    """r̂_s follows at no load and zero stator frequency, the torque step is held."""
    before = result.window(s.FIG13A_LOAD - 0.1, s.FIG13A_LOAD - 1e-3)
    error = 100 * float(np.abs(resistance_error(before)).max())
    claims = [replace(at_most("r̂_s before the load step, deviation", error, 5, " %"), of_motor=False)]
    if result.status != "running":
        return [*claims, _alive(result)]
    held = result.window(s.FIG13A_LOAD + 2.0)
    return [*claims, _alive(result), _speed("under rated load", held), _angle("under rated load", held, 15)]


def fig13b(result: Result) -> list[Claim]:
    """r̂_s within 5 % after 280 ms ± 30 %, i_q rises meanwhile."""
    if result.status != "running":
        return [_alive(result)]
    time = 1e3 * _identified(result, s.FIG13B_CHANGE, 0.05)
    span = Claim(
        "r̂_s within 5 % after 280 ms ± 30 %",
        f"{time:.0f} ms",
        196 <= time <= 364,
        False,
        value=time,
        unit=" ms",
    )
    i_q = smoothed(result["estimate.i_dq"].imag, 50)
    before = (result.t > s.FIG13B_CHANGE - 1.0) & (result.t < s.FIG13B_CHANGE)
    during = (result.t > s.FIG13B_CHANGE) & (result.t < s.FIG13B_CHANGE + 0.4)
    rise = 100 * float(i_q[during].max() / i_q[before].mean() - 1)
    fall = 100 * float(1 - i_q[during].min() / i_q[before].mean())
    left = 100 * abs(float(i_q[result.t > result.t[-1] - 1.0].mean() / i_q[before].mean() - 1))
    return [
        _alive(result),
        span,
        at_least("temporary change of i_q", max(rise, fall), 2, " %"),
        at_least("of it a rise", rise, 3, " %"),
        at_most("change of i_q left at the end", left, 5, " %"),
        _angle("from the change on", result.window(s.FIG13B_CHANGE), 15),
    ]


def smoothed(x: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """Moving mean over a window of `samples`."""
    mean: NDArray[np.float64] = np.convolve(x, np.ones(samples) / samples, mode="same")
    return mean


def fig14(result: Result) -> list[Claim]:
    """r̂_s lost at high speed, found at once after the return, control never lost."""
    if result.status != "running":
        return [_alive(result)]
    top = result.window(s.FIG14_DOWN - 0.5, s.FIG14_DOWN)
    behind = 100 * float(np.abs(resistance_error(top)).mean())
    back = _identified(result, s.FIG14_BACK, 0.03)
    cold = result.window(s.FIG14_UP - 0.5, s.FIG14_UP)
    return [
        _alive(result),
        _angle("throughout", result.window(s.RUN + 0.2), 15),
        replace(
            at_most(
                "r̂_s before the acceleration, deviation",
                100 * float(np.abs(resistance_error(cold)).max()),
                3,
                " %",
            ),
            of_motor=False,
        ),
        replace(at_least("r̂_s at high speed, deviation", behind, 10, " %"), of_motor=False),
        replace(at_most("r̂_s within 3 % after the return to ω = 0.02", back, 0.5, " s"), of_motor=False),
    ]


# Figs. 17 to 20: zero speed, zero stator frequency.


def fig17(result: Result) -> list[Claim]:
    """Speed held at every load, ends at zero stator frequency."""
    if result.status != "running":
        return [_alive(result)]
    errors = []
    for k in range(len(s.FIG17_STEPS)):
        until = s.FIG17_BEGIN + (k + 1) * s.FIG17_STAY
        errors.append(np.abs(metrics.speed_error(result.window(until - 2.5, until - 1e-3))).max())
    end = result.window(result.t[-1] - 4.0)
    base = result.scenario.motor.base
    return [
        _alive(result),
        at_most("speed error under every load, from 1.5 s after the step", float(max(errors)), 0.002, " pu"),
        at_most(
            "stator frequency at the end", abs(float(end["omega_s"].mean())) / base["omega"], 5e-4, " pu"
        ),
        _speed("at the end", end),
    ]


def fig18(result: Result) -> list[Claim]:
    """A minute at zero stator frequency, then the rated step."""
    if result.status != "running":
        return [_alive(result)]
    hold = result.window(s.HOLD + 1.0, s.FIG18_LOAD - 1e-3)
    loaded = result.window(s.FIG18_LOAD + 2.0, s.FIG18_END)
    frequency = abs(metrics.turns(hold)[-1]) / np.ptp(hold.t) / result.scenario.motor.f_N
    return [
        _alive(result),
        _offset_found(result.window(s.IDENTIFIED - 4.0, s.IDENTIFIED), 5),
        at_least("time at zero stator frequency", float(np.ptp(hold.t)), 60, " s"),
        at_most("mean stator frequency meanwhile", float(frequency), 5e-4, " pu"),
        _angle("meanwhile", hold, 15),
        _speed("meanwhile", hold),
        _recovery("rated", result.window(0.0, s.FIG18_END), s.FIG18_LOAD, 2),
        _angle("under rated load", loaded, 15),
        _speed("under rated load", loaded),
    ]


def headline(result: Result) -> list[Claim]:
    """Fig. 18, then no load again."""
    claims = fig18(result)
    if result.status == "running":
        unloaded = result.window(s.FIG18_END + 2.0)
        claims += [_angle("after the load", unloaded, 15), _speed("after the load", unloaded)]
    return claims


def fig19(result: Result) -> list[Claim]:
    """The 120 % step."""
    if result.status != "running":
        return [_alive(result)]
    return [
        _alive(result),
        _recovery("120 %", result, s.LOAD_STEP, 1),
        _angle("from 1 s after the step", result.window(s.LOAD_STEP + 1.0), 5),
    ]


def fig20(result: Result) -> list[Claim]:
    """Sustained regeneration."""
    if result.status != "running":
        return [_alive(result)]
    regenerating = result.window(s.LOAD_STEP + 1.5)
    power = regenerating["torque"] * regenerating["omega_m"]
    sustained = float(np.ptp(regenerating.t)) * float((power < 0).mean())
    return [
        _alive(result),
        at_least("time of regeneration", sustained, 10, " s"),
        _speed("meanwhile", regenerating),
        _angle("meanwhile", regenerating, 15),
    ]
