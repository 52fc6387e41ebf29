"""Voltages and currents of a log as space vectors on a uniform grid; gaps, NaN, wrong units and single wrong
values by place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.logs.read import QUANTITIES, Log
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "TURN",
    "Rows",
    "Signals",
    "check_computable",
    "check_units",
    "check_values",
    "effective",
    "grid_of",
    "resampled",
    "signals_of",
    "space",
    "times",
    "without_nan",
]

_RATES = (1e3, 1e7)
_C_OUT_MAX = 10e-9  # F
_CURRENT_MAX = 50.0
"""Largest current, of the rated peak: sensors reach 2.5 to 20 times it, direct starts and short circuits stay
below. Single currents up to there cost some rad/s, at a low confidence."""
_VOLTAGE_MAX = 10.0
"""Largest voltage of a phase or between two, of the rated peak of a phase: it stays below twice the link."""
_LINK_MAX = 5.0
"""Largest dc link, of the rated one."""
_COMPUTED = 1e9
"""Largest value in SI with which is computed: nothing is measured beyond."""
TURN = np.exp(2j * np.pi / 3)
"""Axis of phase b."""


@dataclass(frozen=True)
class _Series:
    """Voltages and currents over the time, in SI."""

    t: NDArray[np.float64]
    u: NDArray[np.complex128]
    """Mean over the interval that ends at the row, V."""
    i: NDArray[np.complex128]
    i_sum: NDArray[np.float64]
    u_dc: NDArray[np.float64]
    psi_ref: NDArray[np.float64]
    currents: tuple[str, ...]
    """Quantities that the currents are made of."""


@dataclass(frozen=True)
class Signals(_Series):
    """Voltages and currents of a log on its own rows."""

    voltages: tuple[str, ...]


def effective(inverter: Inverter, voltage: str) -> Inverter:
    """The inverter between a voltage of this kind and the flux."""
    if voltage == "bridge":
        return inverter
    inverter = inverter.replace(u_th=0.0, dead_time=0.0, c_out=0.0)
    return inverter.replace(r_d=0.0) if voltage == "terminal" else inverter


def check_computable(log: Log) -> None:
    """Raises ValueError for a value so large that nothing finite would come of it."""
    most = {name: _COMPUTED for name in log.data if QUANTITIES[name] not in ("time", "")}
    _check_largest(log, most, "nothing is measured beyond")


def without_nan(log: Log, rate: float | None, max_gap: float, notes: list[str]) -> Log:
    """Bridges stretches of NaN of up to `max_gap`; raises ValueError for a longer one."""
    data = dict(log.data)
    n = len(log)
    t = data.get("t")
    step = 1.0 / rate if t is None and rate else _median_step(t) if t is not None else 0.0
    for name, values in log.data.items():
        bad = ~np.isfinite(values)
        if not bad.any():
            continue
        first = int(np.flatnonzero(bad)[0])
        edges = np.flatnonzero(np.diff(np.concatenate(([False], bad, [False])).astype(int)))
        longest = int((edges[1::2] - edges[::2]).max())
        at_end = bool(bad[0] or bad[-1])
        if name == "t" or at_end or longest * step > max_gap:
            raise ValueError(
                f"{log.place(name, first)}: {values[first]} is not a finite number, one of {int(bad.sum())}; "
                f"stretches of up to max_gap = {max_gap:g} s are bridged, the longest has {longest} rows"
            )
        good = np.flatnonzero(~bad)
        # An angle that is wrapped goes on through the wrap.
        known = np.unwrap(values[good]) if name == "angle" else values[good]
        filled = np.interp(np.arange(n), good, known.real)
        if np.iscomplexobj(values):
            filled = filled + 1j * np.interp(np.arange(n), good, values[good].imag)
        data[name] = filled
        notes.append(f"{log.place(name, first)}: {int(bad.sum())} values that are no numbers are bridged")
    return replace(log, data=data)


def _median_step(t: NDArray[np.float64]) -> float:
    steps = np.diff(t[np.isfinite(t)])
    return float(np.median(steps)) if len(steps) else 0.0


def times(
    log: Log, rate: float | None, max_gap: float, notes: list[str]
) -> tuple[NDArray[np.float64], list[tuple[int, int]]]:
    """Time of each row, and the pieces between gaps."""
    n = len(log)
    if n < 100:
        raise ValueError(f"{log.source} has {n} rows, 100 are needed at least")
    t = log.data.get("t")
    if rate is not None and not _RATES[0] <= rate <= _RATES[1]:
        raise ValueError(f"rate = {rate:g} Hz is outside {_RATES[0]:g} … {_RATES[1]:g} Hz")
    if t is None:
        if rate is None:
            raise ValueError(
                f"{log.source} has no column 't': name it, columns={{'t': …}}, or give the sampling rate, "
                f"rate = … in Hz"
            )
        return np.arange(n) / rate, [(0, n)]
    steps = np.diff(t)
    step = float(np.median(steps))
    back = np.flatnonzero(steps <= 0.0)
    if len(back):
        k = int(back[0]) + 1
        if steps.min() < 0.0 or t[-1] == t[0]:
            raise ValueError(f"{log.place('t', k)}: time goes from {t[k - 1]:.9g} to {t[k]:.9g} s")
        # Never backwards: written with too few digits. The rate says what they were.
        if rate is None:
            raise ValueError(
                f"{log.place('t', k)}: time stands still at {t[k]:.9g} s, written with too few digits? Give "
                f"the sampling rate, rate = … in Hz"
            )
        if abs((t[-1] - t[0]) * rate / (n - 1) - 1.0) > 0.01:
            raise ValueError(
                f"rate = {rate:g} Hz, but the {n} rows of {log.place('t')} span {t[-1] - t[0]:g} s"
            )
        notes.append(f"{log.place('t')} has too few digits, rows are taken {1.0 / rate:g} s apart")
        return t[0] + np.arange(n) / rate, [(0, n)]
    if rate is not None and abs(step * rate - 1.0) > 0.01:
        raise ValueError(f"rate = {rate:g} Hz, but the rows of {log.place('t')} are {step:g} s apart")
    if step > 1.001 / _RATES[0] or step < 0.999 / _RATES[1]:
        unit = next((u for u, f in (("ms", 1e-3), ("us", 1e-6)) if 5e-6 <= step * f <= 1e-3), None)
        hint = f"; in {unit}? columns={{'t': ({log.names['t']!r}, {unit!r})}}" if unit else ""
        raise ValueError(
            f"{log.place('t')}: rows are {step:g} s apart, admissible are {1 / _RATES[1]:g} … "
            f"{1 / _RATES[0]:g} s{hint}"
        )
    gaps = np.flatnonzero(steps > 1.5 * step)
    pieces: list[tuple[int, int]] = []
    begin = 0
    for k in map(int, gaps):
        missing = round(steps[k] / step) - 1
        where = f"{log.place('t', k + 1)}: {missing} rows are missing after t = {t[k]:.6g} s"
        if steps[k] - step <= max_gap:
            notes.append(f"{where}, bridged")
            continue
        notes.append(f"{where}, the estimators begin anew")
        pieces.append((begin, k + 1))
        begin = k + 1
    pieces.append((begin, n))
    short = next((p for p in pieces if p[1] - p[0] < 100), None)
    if short:
        raise ValueError(
            f"{log.place('t', short[0])}: only {short[1] - short[0]} rows between two gaps, 100 are needed; "
            f"a larger max_gap bridges them"
        )
    return np.asarray(t), pieces


def signals_of(
    log: Log,
    t: NDArray[np.float64],
    pieces: list[tuple[int, int]],
    motor: Motor,
    inverter: Inverter,
    delay: float | None,
    sampled: bool,
) -> Signals:
    """Voltages and currents of the log's columns; a voltage is moved by `delay` rows, not across a gap."""
    i, i_sum, currents = _vector(log, "i")
    u_dc = log.data.get("u_dc", np.full(len(log), inverter.u_dc))
    if "d_a" in log.data or "d_b" in log.data:
        missing = [name for name in ("d_a", "d_b", "d_c") if name not in log.data]
        if missing:
            raise ValueError(f"{log.source}: duty {', '.join(missing)} is missing")
        voltages: tuple[str, ...] = ("d_a", "d_b", "d_c")
        for name in voltages:
            bad = np.flatnonzero((log.data[name] < -0.001) | (log.data[name] > 1.001))
            if len(bad):
                value = log.data[name][bad[0]]
                hint = ", in percent? give its unit '%'" if value <= 100.0 else ""
                raise ValueError(f"{log.place(name, int(bad[0]))}: duty {value:g} is outside 0 … 1{hint}")
        duties = space(*(log.data[name] for name in voltages))
        u = _delayed(duties, 2.0 if delay is None else delay, pieces) * u_dc
    else:
        u, _, voltages = _vector(log, "u")
        u = _delayed(u, 0.0 if delay is None else delay, pieces)
    if sampled:
        u = 0.5 * (u + _delayed(u, 1.0, pieces))
    psi_ref = log.data.get("psi_ref", np.full(len(log), motor.base["psi"]))
    return Signals(t, u, i, i_sum, u_dc, psi_ref, currents, voltages)


def _delayed(
    u: NDArray[np.complex128], delay: float, pieces: list[tuple[int, int]]
) -> NDArray[np.complex128]:
    """The rows of `delay` rows earlier, at the begin of a piece its first."""
    if not 0.0 <= delay <= 100.0:
        raise ValueError(f"delay = {delay} is outside 0 … 100 rows")
    rows = np.arange(len(u), dtype=float)
    moved = np.empty_like(u)
    for begin, end in pieces:
        at = np.maximum(rows[begin:end] - delay, begin)
        low = np.floor(at).astype(int)
        part = at - low
        moved[begin:end] = (1.0 - part) * u[low] + part * u[np.minimum(low + 1, end - 1)]
    return moved


def space(a: Any, b: Any, c: Any) -> NDArray[np.complex128]:
    """Space vector of three phases."""
    return np.asarray((a + TURN * b + np.conj(TURN) * c) * (2.0 / 3.0))


def _vector(log: Log, letter: str) -> tuple[NDArray[np.complex128], NDArray[np.float64], tuple[str, ...]]:
    """Space vector of currents or voltages, sum of three phases, and the quantities it is made of."""
    data, n = log.data, len(log)
    none = np.zeros(n)
    phases = [f"{letter}_{p}" for p in "abc"]
    given = [name for name in phases if name in data]
    if f"{letter}_s" in data:
        return data[f"{letter}_s"], none, (f"{letter}_s",)
    pair = (f"{letter}_alpha", f"{letter}_beta")
    if all(name in data for name in pair):
        return data[pair[0]] + 1j * data[pair[1]], none, pair
    if len(given) == 3:
        values = [data[name] for name in phases]
        return space(*values), values[0] + values[1] + values[2], tuple(phases)
    if len(given) == 2:
        last = next(name for name in phases if name not in data)
        values = [data[name] if name != last else -data[given[0]] - data[given[1]] for name in phases]
        return space(*values), none, tuple(given)
    lines = ("u_ab", "u_bc")
    if letter == "u" and ("u_ca" in data) + sum(name in data for name in lines) >= 2:
        u_ab = data["u_ab"] if "u_ab" in data else -data["u_bc"] - data["u_ca"]
        u_bc = data["u_bc"] if "u_bc" in data else -data["u_ab"] - data["u_ca"]
        used = tuple(name for name in (*lines, "u_ca") if name in data)
        return (2.0 * u_ab + u_bc) / 3.0 + 1j * u_bc / math.sqrt(3.0), none, used
    dq = (f"{letter}_d", f"{letter}_q")
    if all(name in data for name in dq):
        if "angle" not in data:
            raise ValueError(f"{log.source}: {dq[0]} and {dq[1]} need the column 'angle' of the d-axis")
        angle = data["angle"]
        turned = np.abs(np.diff(angle))
        if len(turned) and 6.5 < turned.max() < 400.0 and np.abs(angle).max() > 100.0:
            raise ValueError(
                f"{log.place('angle')}: wraps at {turned.max():.0f}, in degrees? give its unit 'deg'"
            )
        return (data[dq[0]] + 1j * data[dq[1]]) * np.exp(1j * angle), none, (*dq, "angle")
    what = {"i": "current", "u": "voltage"}[letter]
    options = (
        f"two or three of {', '.join(phases)}; {', '.join(pair)}; {', '.join(dq)} with angle; {letter}_s"
    )
    if letter == "u":
        options += "; two of u_ab, u_bc, u_ca; duties d_a, d_b, d_c"
    raise ValueError(f"{log.source} has no {what}: needed are {options}; it has {', '.join(data)}")


def check_units(log: Log, signals: Signals, motor: Motor, inverter: Inverter) -> None:
    """Magnitudes that no machine of this rating has: a unit is wrong by a factor of 1000."""
    base = motor.base
    i = float(np.quantile(np.abs(signals.i), 0.99)) / base["i"]
    if i > _CURRENT_MAX or i < 0.01:
        _wrong_unit(log, signals.currents, i, base["i"], "A", 0.02, 20.0)
    u_dc = float(np.median(signals.u_dc)) / inverter.u_dc
    if "u_dc" in log.data and not 0.2 < u_dc < _LINK_MAX:
        _wrong_unit(log, ("u_dc",), u_dc, inverter.u_dc, "V", 0.2, _LINK_MAX)
    u = float(np.quantile(np.abs(signals.u), 0.99)) / base["u"]
    if signals.voltages[0] != "d_a" and (u > _VOLTAGE_MAX or u < 0.002):
        _wrong_unit(log, signals.voltages, u, base["u"], "V", 0.002, _VOLTAGE_MAX)


def _wrong_unit(
    log: Log, quantities: tuple[str, ...], ratio: float, base: float, unit: str, low: float, high: float
) -> None:
    what = f"{log.place(quantities)}: values of {ratio * base:.3g} {unit}, {ratio:.3g} of rated"
    given = log.scales.get(quantities[0], 1.0)
    for prefix, factor in (("", 1.0), ("m", 1e-3), ("k", 1e3)):
        if low <= ratio * factor / given <= high:
            raise ValueError(
                f"{what}, wrong by a factor of 1000? Give the unit, columns={{{quantities[0]!r}: "
                f"({log.names.get(quantities[0], quantities[0])!r}, '{prefix}{unit}'), …}}, or check=False"
            )
    raise ValueError(f"{what}: not a log of this machine? check=False accepts it")


def check_values(log: Log, signals: Signals, motor: Motor, inverter: Inverter) -> None:
    """Single values that no drive of this machine measures, in a log whose units are right: raises ValueError
    for the first one."""
    kinds = (
        ("current", _CURRENT_MAX, motor.base["i"], "the rated peak current"),
        ("voltage", _VOLTAGE_MAX, motor.base["u"], "the rated peak voltage of a phase"),
    )
    for kind, times, rated, of in kinds:
        names = [name for name in (*signals.currents, *signals.voltages) if QUANTITIES[name] == kind]
        _check_largest(log, dict.fromkeys(names, times * rated), f"{times:g} times {of}")
    if "u_dc" in log.data:
        _check_largest(log, {"u_dc": _LINK_MAX * inverter.u_dc}, f"{_LINK_MAX:g} times the rated dc link")


def _check_largest(log: Log, most: Mapping[str, float], why: str) -> None:
    """Raises ValueError for the first value beyond the largest of its quantity; passes over what is no
    number."""
    for name, limit in most.items():
        values = log.data[name]
        with np.errstate(over="ignore", invalid="ignore"):
            bad = np.flatnonzero(np.isfinite(values) & (np.abs(values) > limit))
        if len(bad):
            value, scale = values[bad[0]], log.scales.get(name, 1.0)
            unit = {"current": "A", "voltage": "V", "flux": "V·s", "angle": "rad"}[QUANTITIES[name]]
            given = "" if scale == 1.0 else f"{value / scale:.6g}, in SI "
            raise ValueError(
                f"{log.place(name, int(bad[0]))}: {given}{value:.6g} {unit} is outside the admissible range "
                f"{-limit:.4g} to {limit:.4g} {unit}, {why}"
            )


@dataclass(frozen=True)
class Rows(_Series):
    """A piece of a log on the grid of the estimators."""

    shown: NDArray[np.int64]
    """Rows at which estimates are returned."""

    @property
    def step(self) -> float:
        """Time between two rows, s."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))


def grid_of(step: float, inverter: Inverter, notes: list[str]) -> tuple[float, Inverter]:
    """Grid points per row (1, 2, … or 1/2, 1/3, …), near one for each control period, and an inverter whose
    control period is theirs: dead time and node capacitance in proportion, so that loss and knee stay. A
    capacitance that is then beyond the range of an inverter is a note."""
    ratio = step * 2.0 * inverter.f_s / inverter.half_periods
    many = float(round(ratio)) if ratio >= 1.5 else 1.0 / max(1, round(1.0 / ratio))
    f_s = many / step
    if abs(f_s / inverter.f_s - 1.0) < 1e-6 and inverter.half_periods == 2:
        return many, inverter
    scale = inverter.f_s / f_s
    if inverter.c_out * scale > _C_OUT_MAX:
        notes.append(
            f"c_out = {inverter.c_out:g} F in a grid of {f_s:g} Hz would be {inverter.c_out * scale:.3g} F: "
            f"{_C_OUT_MAX:g} F is taken, the bridge's knee is narrower than it was told"
        )
    return many, inverter.replace(
        f_s=f_s,
        half_periods=2,
        f_clk=0.0,
        dead_time=inverter.dead_time * scale,
        c_out=min(inverter.c_out * scale, _C_OUT_MAX),
    )


def resampled(s: Signals, piece: slice, many: float, step: float) -> Rows:
    """A piece of the log on a grid with `many` points a row: volt-seconds between rows are kept."""
    t, u, i = s.t[piece], s.u[piece], s.i[piece]
    i_sum, u_dc, psi_ref = s.i_sum[piece], s.u_dc[piece], s.psi_ref[piece]
    n = len(t)
    uniform = bool(np.abs(np.diff(t) / step - 1.0).max() < 0.02)
    if many == 1.0 and uniform:
        return Rows(t, u, i, i_sum, u_dc, psi_ref, s.currents, np.arange(n))
    fine = step / many
    grid = t[0] + fine * np.arange(int((t[-1] - t[0]) / fine * (1.0 + 1e-12)) + 1)
    volt_seconds = np.concatenate(([0j], np.cumsum(u[1:] * np.diff(t))))
    if many > 1.0:
        flux, current = _cubic(grid, t, volt_seconds), _cubic(grid, t, i)
    else:
        flux = _linear(grid, t, volt_seconds)
        # Mean over a grid step around each point: what is faster than the grid does not alias.
        charge = np.concatenate(([0j], np.cumsum(0.5 * (i[1:] + i[:-1]) * np.diff(t))))
        low, high = np.maximum(grid - fine / 2, t[0]), np.minimum(grid + fine / 2, t[-1])
        current = (_linear(high, t, charge) - _linear(low, t, charge)) / (high - low)
    voltage = np.concatenate((u[:1], np.diff(flux) / fine))
    i_sum, u_dc, psi_ref = (np.interp(grid, t, x) for x in (i_sum, u_dc, psi_ref))
    shown = np.arange(len(grid))
    if many > 1.0:
        shown = np.minimum(np.round((t - t[0]) / fine).astype(np.int64), len(grid) - 1)
    return Rows(grid, voltage, current, i_sum, u_dc, psi_ref, s.currents, shown)


def _linear(x: Any, t: Any, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.asarray(np.interp(x, t, y.real) + 1j * np.interp(x, t, y.imag))


def _cubic(x: Any, t: Any, y: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Cubic Hermite interpolation with central differences as slopes."""
    slope = np.gradient(y, t)
    k = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(t) - 2)
    h = t[k + 1] - t[k]
    s = (x - t[k]) / h
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * y[k]
        + s * (1 - s) ** 2 * h * slope[k]
        + s**2 * (3 - 2 * s) * y[k + 1]
        + s**2 * (s - 1) * h * slope[k + 1]
    )
