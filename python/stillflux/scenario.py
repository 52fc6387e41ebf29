"""`Scenario`: a closed-loop experiment as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from stillflux import _core
from stillflux.machine_file import part
from stillflux.options import DriveSettings, PlantOptions
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack

__all__ = ["Profile", "Scenario"]

Profile: TypeAlias = float | Sequence[tuple[float, float]]
"""A constant, or points (t in s, value) joined by straight lines; two points at one time make a step."""

_RECORD_LIMIT = 4e9
_OFFSETS = ("current_offset", "current_offset_drift", "u_off")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A drive on a plant, references, load, and what changes meanwhile.

    Raises ValueError naming field, value and admissible range, TypeError for unknown names.
    """

    motor: Motor
    """Motor as the drive knows it."""
    inverter: Inverter
    """Inverter as the drive knows it."""
    duration: float
    """Duration, s."""
    arithmetic: str = "f32"
    """Arithmetic of the drive: "f32", "f64" or "q"."""
    scheme: str = "enhanced"
    """Control scheme: "enhanced" (one filter) or "paper" (the published scheme)."""
    settings: DriveSettings = field(default_factory=DriveSettings)
    """Settings of the drive."""
    plant: PlantOptions = field(default_factory=PlantOptions)
    """Options of the plant."""
    plant_motor: Motor | None = None
    """The real motor; None: as the drive knows it."""
    plant_inverter: Inverter | None = None
    """The real inverter; None: as the drive knows it."""
    omega_ref: Profile = 0.0
    """Speed reference, mechanical rad/s."""
    torque_ref: Profile | None = None
    """Torque reference, N·m, instead of a speed reference."""
    load_torque: Profile = 0.0
    """Load torque, N·m; opposes positive rotation."""
    changes: Sequence[tuple[float, dict[str, Any]]] = ()
    """(t, {name: value}) in ascending order: R_s (Ω), current_offset (A), u_dc (V), speed (rad/s or None)."""
    record_every: int = 10
    """Record every so many control periods."""
    signals: Sequence[str] | None = None
    """Names of the signals to record; None: all."""
    memory: dict[str, Any] | None = None
    """What an earlier run left in `Result.memory`."""
    name: str = ""
    """Title of plots."""

    def __post_init__(self) -> None:
        if self.torque_ref is not None and self.omega_ref != 0.0:
            raise ValueError(
                f"omega_ref = {self.omega_ref} and torque_ref = {self.torque_ref}: give only one"
            )
        rows = self.duration * self.inverter.f_s / max(self.record_every, 1)
        names = _core.signals() if self.signals is None else self.signals
        size = 16.0 * rows * (1 + len(names))
        if size > _RECORD_LIMIT:
            raise ValueError(
                f"duration = {self.duration} s would record {size:.1e} bytes, admissible are up to "
                f"{_RECORD_LIMIT:.0e}: raise record_every or choose signals"
            )
        _core.Run(self)

    def replace(self, **changes: Any) -> Self:
        """A copy with changed fields."""
        return replace(self, **changes)

    def with_settings(self, **settings: Unpack[DriveSettings]) -> Self:
        """A copy with changed settings of the drive."""
        return replace(self, settings={**self.settings, **settings})

    def value(self, name: str) -> Any:
        """A field, or one of a part of the scenario: "load_torque", "plant_motor.R_s", "settings.psi_ref".

        The real motor and inverter are those that the drive knows, where they are not given.
        """
        part, dot, field_name = name.partition(".")
        if not hasattr(self, part):
            raise ValueError(f"{name}: {part} is not a field of a scenario")
        whole = getattr(self, part)
        if not dot:
            return whole
        if whole is None and part.startswith("plant_"):
            whole = getattr(self, part.removeprefix("plant_"))
        if isinstance(whole, dict):
            if field_name not in whole:
                raise ValueError(f"{name} is not given in the scenario")
            return whole[field_name]
        if not isinstance(whole, Motor | Inverter) or not hasattr(whole, field_name):
            raise ValueError(f"{name}: {field_name} is not a field of {part}")
        return getattr(whole, field_name)

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """A copy with changed fields, named as in `value`. Raises ValueError as the scenario does."""
        changes: dict[str, Any] = {}
        parts: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            part, dot, field_name = name.partition(".")
            if part not in {f.name for f in fields(self)}:
                raise ValueError(f"{name}: {part} is not a field of a scenario")
            if dot:
                parts.setdefault(part, {})[field_name] = value
            else:
                changes[part] = value
        for part, of_part in parts.items():
            whole = changes.get(part, getattr(self, part))
            if whole is None and part.startswith("plant_"):
                whole = changes.get(part.removeprefix("plant_"), getattr(self, part.removeprefix("plant_")))
            if isinstance(whole, dict):
                changes[part] = {**whole, **of_part}
            elif isinstance(whole, Motor | Inverter):
                changes[part] = whole.replace(**of_part)
            else:
                raise ValueError(f"{part} has no field {', '.join(of_part)}")
        return self.replace(**changes)

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON: complex numbers become [re, im]."""
        return {key: plain(value) for key, value in asdict(self).items() if value is not None}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Self:
        """From plain data, as `to_dict` gives it or a TOML file holds it.

        Motors and inverters are a preset's name, a motor file (see `stillflux.machine_file`), or a table of
        fields, in which `preset` may name a preset to change. Without an inverter, that of the motor's
        preset or file is taken.
        """
        known = {f.name for f in fields(cls)}
        for key in data:
            if key not in known:
                raise ValueError(f"{key} is not a field of a scenario; those are {', '.join(sorted(known))}")
        if "inverter" not in data and isinstance(data.get("motor"), str):
            data = {**data, "inverter": data["motor"]}
        kinds = {"motor": Motor, "plant_motor": Motor, "inverter": Inverter, "plant_inverter": Inverter}
        rest = {key: rich(value) for key, value in data.items() if key not in kinds}
        parts = {key: part(kind, data[key]) for key, kind in kinds.items() if key in data}
        return cls(**rest, **parts)


def plain(value: Any) -> Any:
    """Plain data for JSON: complex numbers become [re, im]."""
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def rich(value: Any, key: str = "") -> Any:
    """Undoes `plain`: pairs under the names of space vectors become complex, points become tuples."""
    if isinstance(value, dict):
        return {key: rich(item, key) for key, item in value.items()}
    if isinstance(value, list):
        if key in _OFFSETS and len(value) == 2:
            return complex(*value)
        return tuple(rich(item) for item in value)
    return value
