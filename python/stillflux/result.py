"""`Result`: what a simulation recorded."""

from __future__ import annotations

import html
import json
import math
import os
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux import _core, metrics
from stillflux._core import Status
from stillflux.outputs import whole
from stillflux.parameters import number
from stillflux.scenario import Scenario, ScenarioWarning, plain, rich
from stillflux.status import EncoderCode

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from typing_extensions import Self

__all__ = ["Result"]

_TORN = (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error)
"""What reading a file raises that is no saved result, or a damaged one."""
_META = "meta"
_COMPARED = ("omega_m", "torque", "angle_error", "estimate.confidence")
_MOST_PANELS = 6


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """Signals over time: the plant's truth under the plain name, the drive's view under `estimate.`.

    `result["omega_m"]` is an array of the length of `t`; space vectors are complex.
    """

    scenario: Scenario
    """What was simulated."""
    t: NDArray[np.float64]
    """Time, s."""
    data: Mapping[str, NDArray[Any]]
    """The signals."""
    status: Status
    """Status of the drive at the end."""
    memory: dict[str, Any]
    """What the drive would store at the end."""

    def __contains__(self, name: object) -> bool:
        return name in self.data

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)

    def __len__(self) -> int:
        """Number of recorded signals."""
        return len(self.data)

    def keys(self) -> tuple[str, ...]:
        """Names of what was recorded."""
        return tuple(self.data)

    def items(self) -> Iterable[tuple[str, NDArray[Any]]]:
        """Names and arrays of what was recorded."""
        return self.data.items()

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.data)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if not isinstance(name, str):
            raise TypeError(
                f"signal = {name!r} is not a name; give several one by one: plot('omega_m', 'torque')"
            )
        try:
            return self.data[name]
        except KeyError:
            raise KeyError(f"{name!r} was not recorded; there are {', '.join(self.data)}") from None

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of what was recorded."""
        return tuple(self.data)

    def select(self, *names: str) -> Self:
        """With the named signals only. Raises KeyError for one that was not recorded."""
        return replace(self, data={name: self[name] for name in names})

    @property
    def units(self) -> dict[str, str]:
        """Unit of each signal."""
        units = _core.signals()
        return {name: units[name] for name in self.data}

    def window(self, begin: float, end: float = float("inf")) -> Self:
        """The part with begin <= t <= end, s. Raises ValueError if there is none."""
        begin, end = number("begin", begin), number("end", end)
        chosen = (self.t >= begin) & (self.t <= end)
        if not chosen.any():
            raise ValueError(
                f"window = {begin}…{end} s holds no sample of 0…{self.t[-1] if len(self.t) else 0} s"
            )
        data = {name: values[chosen] for name, values in self.data.items()}
        return replace(self, t=self.t[chosen], data=data)

    def plot(self, *signals: str) -> Figure:
        """The named signals, a panel each; without names an overview: speed, torque, currents, angle error,
        offset voltage, resistance, as far as they were recorded. Raises KeyError for one that was not."""
        from stillflux.plots import overview, panels

        if not self.data:
            raise ValueError("signals: none was recorded, there is nothing to plot")
        return panels({"": self}, signals) if signals else overview(self)

    def compare(self, *others: Self, signals: Sequence[str] | None = None) -> Figure:
        """Signals of this run and of others over the time, each run with the name of its scenario. None:
        speed, torque, angle error and confidence, or, where these were not recorded, what all runs have."""
        from stillflux.plots import panels

        runs: dict[str, Result] = {}
        for k, run in enumerate((self, *others)):
            if not isinstance(run, Result):
                raise TypeError(f"others[{k - 1}] = {run!r} is not a Result")
            name = run.scenario.name or f"run {k + 1}"
            runs[name if name not in runs else f"{name} ({k + 1})"] = run
        if isinstance(signals, str):
            raise TypeError(f"signals = {signals!r}: give a list of names, [{signals!r}]")
        if signals is None:
            common = [name for name in self.data if all(name in run for run in runs.values())]
            signals = [name for name in _COMPARED if name in common] or common[:_MOST_PANELS]
        if not signals:
            raise ValueError("signals: the runs have none in common")
        return panels(runs, signals)

    def to_pandas(self) -> Any:
        """A pandas frame over the time; space vectors as two columns, `psi_s.re` and `psi_s.im`; units in
        `frame.attrs["units"]`. Parquet takes it."""
        from stillflux.frames import to_pandas

        return to_pandas(self.t, self.data, self.units)

    def to_xarray(self) -> Any:
        """An xarray data set over the time; space vectors as two variables, units as attributes; scenario and
        status as attributes of the set. NetCDF takes it."""
        from stillflux.frames import to_xarray

        attributes = {"scenario": json.dumps(self.scenario.to_dict()), "status": str(self.status)}
        return to_xarray(self.t, self.data, self.units, attributes)

    def summary(self) -> str:
        """A few lines: status, length, worst angle, speed error, stator frequency, confidence and
        resistance, as far as recorded."""
        return "\n".join(f"{name}: {value}" for name, value in self._facts())

    def _facts(self) -> list[tuple[str, str]]:
        facts = [("status", str(self.status))]
        end = self.t[-1] if len(self.t) else 0.0
        facts.append(("simulated", f"{end:.4g} s, {len(self.t)} rows of {len(self.data)} signals"))
        facts.extend(("not reached", text) for text in self.scenario.unreached())
        if not len(self.t) or "status" not in self or not metrics.running(self).any():
            return facts
        if "angle_error" in self:
            worst = f"{metrics.worst_angle(self):.3g}° at most, {metrics.rms_angle(self):.3g}° rms"
            facts.append(("field angle error", worst))
        if "omega_m" in self and "reference" in self and self.scenario.torque_ref is None:
            swing = metrics.speed_swing(self)
            facts.append(
                (
                    "speed error at the end",
                    f"{metrics.last_speed_error(self):.2g} pu, ±{swing:.2g} pu in the last 0.5 s",
                )
            )
        if "omega_s" in self:
            facts.append(("stator frequency at the end", f"{self['omega_s'][-1] / math.tau:.3g} Hz"))
        if "reference" in self:
            facts.extend(self._cut())
        facts.extend(self._encoder())
        if "estimate.confidence" in self:
            facts.append(("confidence", f"{metrics.least_confidence(self):.2f} at least"))
        if "estimate.speed_gain" in self and (gain := float(self["estimate.speed_gain"][-1])) < 1.0:
            text = f"reduced to {gain:.2g} after a swing: J is about that part of the one told"
            facts.append(("speed control", text))
        if "estimate.R_s" in self and "R_s" in self:
            facts.append(("R_s at the end", f"{100 * metrics.last_resistance_error(self):+.2g} %"))
        return facts

    def _encoder(self) -> list[tuple[str, str]]:
        """For how much of the running time the encoder of the drive was silent or not believed."""
        if not self.scenario.settings.get("encoder_lines") or "encoder.state" not in self:
            return []
        state = self["encoder.state"][metrics.running(self)]
        shares = {code: float(np.mean(state == code)) for code in EncoderCode if code != EncoderCode.AGREES}
        texts = [
            f"{code.name.lower().replace('_', ' ')} for {100 * share:.3g} % of the running time"
            for code, share in shares.items()
            if share
        ]
        return [("encoder", ", ".join(texts))] if texts else []

    def _cut(self) -> list[tuple[str, str]]:
        """The limits to which the drive has cut its reference, of speed or torque, if it was beyond them."""
        asked = self["reference"]
        text = self.scenario.cut(asked.min(), asked.max())
        what = "speed" if self.scenario.torque_ref is None else "torque"
        return [(f"{what} reference", text)] if text else []

    def __repr__(self) -> str:
        name = f" {self.scenario.name!r}" if self.scenario.name else ""
        return f"<Result{name}: {self.status}, {len(self.t)} rows of {len(self.data)} signals>"

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
            for name, value in self._facts()
        )
        return f"<table><caption>{html.escape(self.scenario.name or 'closed loop')}</caption>{cells}</table>"

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a file with the suffix .npz, whole or not at all. Raises ValueError for another suffix,
        FileNotFoundError if there is no such folder."""
        if Path(path).suffix.lower() != ".npz":
            raise ValueError(f"{path}: {Path(path).suffix or 'no suffix'} is not .npz")
        meta = {
            "scenario": self.scenario.to_dict(),
            "status": self.status.__getnewargs__(),
            "memory": plain(self.memory),
        }
        arrays: dict[str, Any] = {"t": self.t, **self.data, _META: json.dumps(meta)}
        # As an open file numpy adds no suffix.
        with whole(Path(path)) as part, part.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Reads what `save` wrote. Raises ValueError for another file."""
        try:
            with np.load(path) as file:
                data = {name: file[name] for name in file.files}
            meta = json.loads(str(data.pop(_META)))
            t, scenario, status, memory = data.pop("t"), meta["scenario"], meta["status"], meta["memory"]
        except _TORN:
            raise ValueError(f"{path} is not a saved result") from None
        try:
            with warnings.catch_warnings():
                # What was cut short was said when it was made.
                warnings.simplefilter("ignore", ScenarioWarning)
                simulated = Scenario.from_dict(scenario)
            return cls(scenario=simulated, t=t, data=data, status=Status(*status), memory=rich(memory))
        except (ValueError, TypeError) as error:
            # Saved by a version with other fields, or changed by hand.
            raise ValueError(f"{path}: {error}") from None
