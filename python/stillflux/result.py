"""`Result`: what a simulation recorded."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux import _core
from stillflux._core import Status
from stillflux.scenario import Scenario, plain, rich

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from typing_extensions import Self

__all__ = ["Result"]

_META = "meta"


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

    def __getitem__(self, name: str) -> NDArray[Any]:
        try:
            return self.data[name]
        except KeyError:
            raise KeyError(f"{name!r} was not recorded; there are {', '.join(self.data)}") from None

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of what was recorded."""
        return tuple(self.data)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each signal."""
        units = _core.signals()
        return {name: units[name] for name in self.data}

    def window(self, begin: float, end: float = float("inf")) -> Self:
        """The part with begin <= t <= end, s. Raises ValueError if there is none."""
        chosen = (self.t >= begin) & (self.t <= end)
        if not chosen.any():
            raise ValueError(
                f"window = {begin}…{end} s holds no sample of 0…{self.t[-1] if len(self.t) else 0} s"
            )
        data = {name: values[chosen] for name, values in self.data.items()}
        return replace(self, t=self.t[chosen], data=data)

    def plot(self) -> Figure:
        """Overview: speed, torque, currents, angle error, offset voltage, resistance."""
        from stillflux.plots import overview

        return overview(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes an npz file, whole or not at all."""
        meta = {
            "scenario": self.scenario.to_dict(),
            "status": self.status.__getnewargs__(),
            "memory": plain(self.memory),
        }
        path = Path(path)
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
            try:
                arrays: dict[str, Any] = {"t": self.t, **self.data, _META: json.dumps(meta)}
                np.savez_compressed(file, **arrays)
                file.close()
                os.replace(file.name, path)
            except BaseException:
                os.unlink(file.name)
                raise

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Reads what `save` wrote. Raises ValueError for another file."""
        with np.load(path) as file:
            if _META not in file:
                raise ValueError(f"{path} is not a saved result")
            data = {name: file[name] for name in file.files}
        meta = json.loads(str(data.pop(_META)))
        return cls(
            scenario=Scenario.from_dict(meta["scenario"]),
            t=data.pop("t"),
            data=data,
            status=Status(*meta["status"]),
            memory=rich(meta["memory"]),
        )
