"""The committed points of the torque-speed plane: what the map of each machine and scheme is drawn from.

One line for each point of the target `plane-ramps`: the largest angle error while it is held, whether it
meets the target, and why it was lost if it was. Beside the table of claims, which has the worst of a whole
map only.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from stillflux.evidence import csv_file
from stillflux.evidence.beyond import Row
from stillflux.evidence.conditions import SCHEMES
from stillflux.evidence.machines import ALL_MACHINES
from stillflux.outputs import write_text

__all__ = ["FILE", "TARGET", "PlanePoint", "digest", "points_of", "read", "update"]

TARGET = "plane-ramps"
FILE = "plane.csv"
"""Name of the file, in the folder of the table of claims."""


@dataclass(frozen=True)
class PlanePoint:
    """A point of the plane at one machine under one scheme."""

    machine: str
    scheme: str
    omega: float
    """Speed, per unit."""
    torque: float
    """Of rated torque."""
    angle: float
    """Largest angle error while the point is judged, °; inf if the drive does not run."""
    met: bool
    """Whether it meets the target."""
    lost: str
    """Why it was lost; empty if it was not."""

    @property
    def place(self) -> tuple[float, float]:
        """Speed and torque."""
        return self.omega, self.torque


def points_of(rows: Iterable[Row]) -> list[PlanePoint]:
    """For each point of rows of one target the run with the largest angle error, a lost one before all."""
    found: dict[tuple[str, str, float, float], PlanePoint] = {}
    for row in sorted(rows, key=lambda row: (bool(row.measured.why), row.measured.angle_settled)):
        if row.point is not None:
            key = row.machine, row.scheme, *row.point
            found[key] = PlanePoint(*key, row.measured.angle_settled, row.ok, row.measured.why)
    return list(found.values())


def read(path: Path) -> list[PlanePoint]:
    """From a file; none if there is no file. Raises ValueError naming file and line for one that is none of
    this kind."""
    return csv_file.read(path, _COLUMNS, "point of the plane", _point)


def _point(line: Sequence[str]) -> PlanePoint:
    """Of a line of a file. Raises ValueError for what is none."""
    machine, scheme, omega, torque, angle, met, lost = line
    if machine not in ALL_MACHINES or scheme not in SCHEMES:
        raise ValueError(f"{machine}, {scheme}")
    return PlanePoint(machine, scheme, float(omega), float(torque), float(angle), met == "yes", lost)


def update(path: Path, rows: Sequence[Row]) -> None:
    """Replaces the maps of the machines and schemes that rows are of; rows of other targets count for
    nothing, as do machines that are none of the project's."""
    fresh = points_of(row for row in rows if row.target == TARGET and row.machine in ALL_MACHINES)
    if not fresh:
        return
    measured = {(point.machine, point.scheme) for point in fresh}
    kept = [point for point in read(path) if (point.machine, point.scheme) not in measured]
    order = sorted([*kept, *fresh], key=_order)
    write_text(path, csv_file.text(_COLUMNS, map(_texts, order)))


def _texts(point: PlanePoint) -> list[str]:
    """As a line of a file."""
    machine, scheme, omega, torque, angle, met, lost = astuple(point)
    shown = f"{float(f'{angle:.3g}'):g}" if math.isfinite(angle) else "inf"
    return [machine, scheme, f"{omega:g}", f"{torque:g}", shown, "yes" if met else "no", lost]


def digest(path: Path) -> str:
    """Of the file: a picture that was drawn from it carries it."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


_COLUMNS = tuple(column.name for column in fields(PlanePoint))


def _order(point: PlanePoint) -> tuple[int, int, float, float]:
    return ALL_MACHINES.index(point.machine), SCHEMES.index(point.scheme), point.omega, point.torque
