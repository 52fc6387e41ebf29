"""`replay`: the estimators of both schemes over a recorded log.

A log holds currents and voltages at 1 kHz or more. The estimators run at about the inverter's `f_s`: a
slower log is interpolated (cubic, volt-seconds kept), a faster one averaged. The kind of voltage decides
what lies between it and the flux:

| `voltage` | measured or computed | taken off |
|---|---|---|
| "terminal" | at the terminals | `R_s i_s` |
| "bridge" | duties times dc link, or a reference with compensation | bridge model, `(R_s + r_d) i_s` |
| "compensated" | a reference without it, `estimate.u_s` of a `Result` | `(R_s + r_d) i_s` |

A log that begins with the bridge blocked (20 ms without a change of the current) gives the offsets of the
current sensors; its flux begins at zero. Otherwise the flux at the first row is the one for which the
magnitude of the voltage model's rotor flux and that of the current model agree over the first turn of the
field.
"""

from __future__ import annotations

import csv
import dataclasses
import html
import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from stillflux._core import RecordEstimator
from stillflux.logs.identified import identified_doubts
from stillflux.logs.read import Columns, read_log
from stillflux.logs.scale import scale_of
from stillflux.logs.signals import (
    Rows,
    check_computable,
    check_units,
    check_values,
    effective,
    grid_of,
    resampled,
    signals_of,
    times,
    without_nan,
)
from stillflux.logs.start import Start, starts
from stillflux.logs.wiring import check_wiring
from stillflux.outputs import whole
from stillflux.parameters import Inverter, Motor, instance, number, truth
from stillflux.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from typing_extensions import Unpack

    from stillflux.options import DriveSettings, Scheme

__all__ = ["Replay", "Voltage", "replay"]

Voltage: TypeAlias = Literal["terminal", "bridge", "compensated"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Replay:
    """What the estimators made of a log: arrays over `t`, SI, space vectors complex in stator coordinates.

    `found["omega_m"]` is `found.omega_m`; `keys()` has the names of all signals.
    """

    t: NDArray[np.float64]
    """Time, s: of the log's rows, or of every `f_s` of the inverter where the log is faster."""
    psi_s: NDArray[np.complex128]
    """Stator flux linkage, V·s."""
    psi_r: NDArray[np.complex128]
    """Rotor flux linkage of the inverse-Γ circuit, V·s."""
    i_s: NDArray[np.complex128]
    """Current less the estimated offset, A."""
    u_s: NDArray[np.complex128]
    """Voltage less the loss of the inverter model, V."""
    u_off: NDArray[np.complex128]
    """Offset voltage, V."""
    omega_s: NDArray[np.float64]
    """Stator frequency, electrical rad/s."""
    omega_m: NDArray[np.float64]
    """Speed, mechanical rad/s."""
    torque: NDArray[np.float64]
    """Torque, N·m."""
    R_s: NDArray[np.float64]
    """Stator resistance, Ω; with the inverter's r_d unless the voltage is that of the terminals."""
    confidence: NDArray[np.float64]
    """Confidence in the field angle, 0 to 1; 0 before the flux is known."""
    angle_deviation: NDArray[np.float64]
    """Expected standard deviation of the field angle, rad; π before the flux is known, then that of the flux
    with which the estimators begin, until they have one of their own."""
    nis: NDArray[np.float64]
    """Normalised innovation squared, low-passed; zero in the scheme "paper"."""
    motor: Motor
    inverter: Inverter
    scheme: str
    voltage: str
    source: str
    """Where the log came from."""
    notes: tuple[str, ...] = field(default=())
    """What was found in the log and dealt with."""

    def __contains__(self, name: object) -> bool:
        return name in _UNITS

    def __iter__(self) -> Iterator[str]:
        return iter(_UNITS)

    def __len__(self) -> int:
        """Number of signals."""
        return len(_UNITS)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in _UNITS:
            raise KeyError(f"{name!r} is no signal of a replay; there are {', '.join(_UNITS)}")
        values: NDArray[Any] = getattr(self, name)
        return values

    def keys(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(_UNITS)

    def items(self) -> Iterable[tuple[str, NDArray[Any]]]:
        """Names and arrays of the signals."""
        return ((name, self[name]) for name in _UNITS)

    def _ipython_key_completions_(self) -> list[str]:
        return list(_UNITS)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each signal."""
        return dict(_UNITS)

    @property
    def angle(self) -> NDArray[np.float64]:
        """Field angle, rad."""
        return np.asarray(np.angle(self.psi_s))

    @property
    def torque_deviation(self) -> NDArray[np.float64]:
        """Standard deviation of the torque that follows from that of the angle, N·m: `3/2 n_p |ψ_s·i_s|
        σ`."""
        inner = np.abs((np.conj(self.psi_s) * self.i_s).real)
        return np.asarray(1.5 * self.motor.n_p * inner * np.minimum(self.angle_deviation, 1.0))

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """All signals as real columns with units in their names, as `save` writes them."""
        found: dict[str, NDArray[np.float64]] = {"t [s]": self.t}
        for name, unit in _UNITS.items():
            values = getattr(self, name)
            if np.iscomplexobj(values):
                found[f"{name}_alpha [{unit}]"], found[f"{name}_beta [{unit}]"] = values.real, values.imag
            else:
                found[f"{name} [{unit}]" if unit else name] = values
        return found

    def to_pandas(self) -> Any:
        """A pandas frame over the time; complex columns, units in `frame.attrs["units"]`."""
        from stillflux.frames import to_pandas

        return to_pandas(self.t, {name: getattr(self, name) for name in _UNITS}, _UNITS)

    def to_xarray(self) -> Any:
        """An xarray data set over the time; units as attributes, real and imaginary parts apart."""
        from stillflux.frames import to_xarray

        return to_xarray(
            self.t, {name: getattr(self, name) for name in _UNITS}, _UNITS, {"source": self.source}
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the signals, whole or not at all: CSV, NPZ or Parquet by the suffix. Raises ValueError
        for another one."""
        path, columns = Path(path), self.columns()
        suffix = path.suffix.lower()
        if suffix == ".csv":
            with whole(path) as part, part.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(columns)
                writer.writerows(np.column_stack(list(columns.values())).tolist())
        elif suffix == ".npz":
            with whole(path) as part, part.open("wb") as file:
                np.savez_compressed(file, t=self.t, **{name: getattr(self, name) for name in _UNITS})
        elif suffix == ".parquet":
            from stillflux.frames import write_parquet

            with whole(path) as part:
                write_parquet(part, columns)
        else:
            raise ValueError(f"{path}: {path.suffix or 'no suffix'} is not one of .csv, .npz, .parquet")

    def summary(self) -> str:
        """A few lines: length, speeds, resistance, confidence, notes."""
        known = self.angle_deviation < math.pi
        resistance = "R_s" if self.voltage == "terminal" else "R_s + r_d"
        lines = [f"{self.source}: {len(self.t)} rows, {self.t[-1] - self.t[0]:.3f} s, scheme {self.scheme}"]
        if known.any():
            speed, low = self.omega_m[known], self.confidence[known]
            deviation = np.degrees(np.median(self.angle_deviation[known]))
            lines += [
                f"speed {speed.min():.3g} … {speed.max():.3g} rad/s, "
                f"{resistance} {self.R_s[-1]:.4g} Ω at the end",
                f"confidence at least {low.min():.2f}, below one half for {100 * (low < 0.5).mean():.1f} % "
                f"of the time, angle ± {deviation:.2g}° (1 σ, median)",
            ]
        return "\n".join([*lines, *(f"note: {note}" for note in self.notes)])

    def plot(self) -> Figure:
        """Speed, torque with its band of two standard deviations, flux, resistance, deviation of the
        angle."""
        from stillflux.plots import replayed

        return replayed(self)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.summary())}</pre>"

    def __repr__(self) -> str:
        return f"<Replay {self.source}, {len(self.t)} rows, scheme {self.scheme!r}>"


_UNITS = {
    "psi_s": "V s",
    "psi_r": "V s",
    "i_s": "A",
    "u_s": "V",
    "u_off": "V",
    "omega_s": "rad/s",
    "omega_m": "rad/s",
    "torque": "N m",
    "R_s": "ohm",
    "confidence": "",
    "angle_deviation": "rad",
    "nis": "",
}


def replay(
    log: Any,
    motor: Motor,
    inverter: Inverter,
    scheme: Scheme = "enhanced",
    columns: Columns | None = None,
    *,
    voltage: Voltage | None = None,
    rate: float | None = None,
    delay: float | None = None,
    sampled: bool = False,
    max_gap: float = 0.0,
    check: bool = True,
    **settings: Unpack[DriveSettings],
) -> Replay:
    """Estimates flux, speed, torque and resistance from recorded voltages and currents.

    Parameters
    ----------
    log
        A file (.csv, .parquet, .npz, .mat), a mapping of names to arrays (a pandas frame is one), or a
        `Result` of a simulation with `record_every=1`. Below the header of a text file may stand a row of
        units.
    motor, inverter
        As a drive on this machine would know them.
    scheme
        "enhanced" (one filter) or "paper" (the published scheme).
    columns
        Where quantities have other names in the log: {"i_a": "Ia"}, with a unit or factor {"i_a": ("Ia",
        "mA")} or {"i_a": ("Ia", 0.001)}, or as {"name": …, "unit": …, "scale": …}. Quantities: `t`; two or
        three of `i_a`, `i_b`, `i_c`, or `i_alpha`, `i_beta`, or `i_d`, `i_q` with `angle`, or complex `i_s`;
        the same for `u_`, line voltages `u_ab`, `u_bc`, or duties `d_a`, `d_b`, `d_c`; `u_dc`; `psi_ref`.
    voltage
        What the log's voltage is: "terminal", measured or computed at the terminals; "bridge", duties times
        dc link, or a reference to which the loss of the bridge is added; "compensated", a reference without
        that. None: "bridge" for duties, "terminal" for voltages.
    rate
        Sampling rate in Hz, 1 kHz or more, for a log without `t`. Beside a `t` it has to agree within 1 %,
        and replaces times that were written with too few digits.
    delay
        Rows from the one that holds a voltage or duty to the one at whose sample its interval ends. None: 0
        for voltages (mean up to the sample), 2 for duties (computed at the sample, applied in the next
        period).
    sampled
        The voltage is a sample of a smooth voltage, not the mean over the interval.
    max_gap
        Longest gap (missing rows or NaN) in s that is bridged by a straight line. After a longer gap of the
        rows the estimators begin anew; a longer stretch of NaN is an error.
    check
        Whether to look for wrong units, scales and swapped phases, for single values that no drive measures
        (a current beyond 50 times the rated peak, a voltage beyond 10 times, a dc link beyond 5 times the
        rated one: errors), and at what was identified: a voltage, current or dc link that is wrong by √2, √3
        or 2 is a note with what was measured and what may be the cause.
    **settings
        Of the drive, see `stillflux.options.DriveSettings`; those about estimators act. A single shunt
        (`current_sensors=1`) is refused: a log holds phase currents.

    Raises ValueError naming file, line and column of what is wrong, ImportError's text included where a
    format needs a package that is not installed.
    """
    instance("motor", motor, Motor)
    instance("inverter", inverter, Inverter)
    if settings.get("current_sensors") == 1:
        raise ValueError(
            "current_sensors = 1 is outside the admissible range 2 to 3: a log holds phase currents, not the "
            "readings of a shunt; give the currents that follow from them"
        )
    sampled, check = truth("sampled", sampled), truth("check", check)
    run_name = ""
    if isinstance(log, Result):
        run_name = f"Result {log.scenario.name!r}" if log.scenario.name else "Result"
        if log.scenario.record_every != 1:
            raise ValueError(
                f"record_every = {log.scenario.record_every} of the scenario is not 1: {run_name} has no "
                f"voltages between its rows"
            )
        for name in ("measured.i_s", "estimate.u_s"):
            if columns is None and name not in log:
                raise ValueError(f"{run_name}: {name} was not recorded; there are {', '.join(log)}")
        columns = {"i_s": "measured.i_s", "u_s": "estimate.u_s", **(columns or {})}
        log, voltage = {"t": log.t, **{key: log[key] for key in log.signals}}, voltage or "compensated"
        log = {name: log[name] for name in ("t", "measured.i_s", "estimate.u_s", "u_dc") if name in log}
    table = read_log(log, columns)
    if run_name:
        table = dataclasses.replace(table, source=run_name)
    kind = voltage or ("bridge" if "d_a" in table.data else "terminal")
    if kind not in ("terminal", "bridge", "compensated"):
        raise ValueError(f"voltage = {voltage!r} is not one of 'terminal', 'bridge', 'compensated'")
    rate, delay = (None if x is None else number(name, x) for name, x in (("rate", rate), ("delay", delay)))
    max_gap = number("max_gap", max_gap)
    if not 0.0 <= max_gap < math.inf:
        raise ValueError(f"max_gap = {max_gap:g} s is outside the admissible range from 0 s on")
    notes: list[str] = []
    check_computable(table)
    given, table = table, without_nan(table, rate, max_gap, notes)
    t, pieces = times(table, rate, max_gap, notes)
    signals = signals_of(table, t, pieces, motor, inverter, delay, sampled)
    if check:
        check_units(table, signals, motor, inverter)
        check_values(given, signals, motor, inverter)
    model = effective(inverter, kind)
    step = float(np.median(np.diff(t)))
    many, model = grid_of(step, model, notes)
    calibrated = bool(settings.get("calibrate_offset", True))
    found: list[dict[str, NDArray[Any]]] = []
    estimator: RecordEstimator | None = None
    for begin, end in pieces:
        rows = resampled(signals, slice(begin, end), many, step)
        if check and not found:
            scale = scale_of(rows, motor, model, signals.voltages[0] == "d_a")
            if scale is not None and scale.text:
                notes.append(scale.text)
            check_wiring(table, rows, motor, model, scale, notes)
        parts, offset = starts(rows, motor, model, scheme, notes if not found else [])
        if estimator is None:
            own: DriveSettings = {**settings, "calibrate_offset": calibrated and offset is not None}
            estimator = RecordEstimator(motor, model, scheme, **own)
        found.append(_run(estimator, rows, parts, offset or 0j, motor.R_s + model.r_d))
    whole = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
    if check:
        notes += identified_doubts(whole, whole["angle_deviation"] < math.pi, motor.R_s + model.r_d)
    return Replay(
        t=whole.pop("t"),
        **whole,
        motor=motor,
        inverter=inverter,
        scheme=scheme,
        voltage=kind,
        source=table.source,
        notes=tuple(notes),
    )


def _integrated(rows: Rows, part: slice, offset: complex, R_s: float) -> dict[str, NDArray[Any]]:
    """Before the flux is known: the integral from zero, no confidence."""
    i, u = rows.i[part] - offset, rows.u[part]
    psi = np.concatenate(([0j], np.cumsum(u[1:] - R_s * 0.5 * (i[1:] + i[:-1])) * rows.step))
    none, zero = np.zeros(len(i)), np.zeros(len(i), complex)
    return {
        "psi_s": psi,
        "psi_r": psi,
        "i_s": i,
        "u_s": u,
        "u_off": zero,
        "omega_m": none,
        "omega_s": none,
        "torque": none,
        "R_s": np.full(len(i), R_s),
        "confidence": none,
        "angle_deviation": np.full(len(i), math.pi),
        "nis": none,
    }


def _run(
    estimator: RecordEstimator, rows: Rows, starts: list[Start], offset: complex, R_s: float
) -> dict[str, NDArray[Any]]:
    """Estimates at the rows to be shown."""
    found: list[dict[str, NDArray[Any]]] = []
    ends = [start.row for start in starts[1:]] + [len(rows.t)]
    begin_sum = rows.i_sum[: starts[1].row] if len(starts) > 1 and offset else rows.i_sum[:0]
    sum_offset = float(begin_sum.mean()) if len(begin_sum) else 0.0
    for start, end in zip(starts, ends, strict=True):
        part = slice(start.row, end)
        if not start.known:
            found.append(_integrated(rows, part, offset, R_s))
            continue
        estimates: dict[str, Any] = estimator.run(
            rows.u[part],
            rows.i[part] - offset,
            rows.i_sum[part] - sum_offset,
            rows.u_dc[part],
            rows.psi_ref[part],
            psi_s0=start.psi_s,
            deviation=start.deviation,
            omega_m=start.omega_m,
            settled=start.settled,
            R_s=start.R_s,
        )
        found.append(estimates)
    whole = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
    return {"t": rows.t[rows.shown], **{name: values[rows.shown] for name, values in whole.items()}}
