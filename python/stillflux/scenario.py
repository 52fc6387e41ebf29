"""`Scenario`: a closed-loop experiment as data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from stillflux import _core
from stillflux.machine_file import inverter_beside, load_machine, part, with_machine
from stillflux.messages import outside
from stillflux.options import DriveSettings, PlantOptions
from stillflux.parameters import Inverter, Motor, instance, number, truth

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self, Unpack

__all__ = ["Profile", "ProfileLike", "Scenario", "ScenarioWarning"]

Profile: TypeAlias = float | Sequence[tuple[float, float]]
"""A constant, or points (t in s, value) joined by straight lines; two points at one time make a step."""
ProfileLike: TypeAlias = "Profile | NDArray[Any] | Callable[[float], float]"
"""A profile, points as an array of shape (n, 2), or a function of the time, taken every millisecond. A
scenario holds numbers or points."""

_RECORD_LIMIT = 4e9
_EVERY = 1e-3  # s between the points of a profile that is given as a function
_MOST_POINTS = 2_000_000
_TORQUE_LIMIT = 10.0  # largest load and reference, of rated torque
_SPEED_LIMIT = 20.0  # largest speed reference, of rated frequency
_LEAST_LINK = 0.3  # least rated dc link over that of the motor's rated voltage, √2 U_N
_OFFSETS = ("current_offset", "current_offset_drift", "u_off")


class ScenarioWarning(UserWarning):
    """Something of a scenario that has no effect, or not the one that is meant, though nothing forbids it."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A drive on a plant, references, load, and what changes meanwhile.

    Raises ValueError naming field, value and admissible range, TypeError for unknown names. What only comes
    after the end of the run, a change or points of a profile, is a `ScenarioWarning`: a scenario may be cut
    short; and so is an encoder of the drive that the plant does not have, or has with other lines, and a
    reference beyond the limits to which the drive cuts it.
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
    omega_ref: ProfileLike = 0.0
    """Speed reference, mechanical rad/s."""
    torque_ref: ProfileLike | None = None
    """Torque reference, N·m, instead of a speed reference."""
    load_torque: ProfileLike = 0.0
    """Load torque, N·m; opposes positive rotation."""
    changes: Sequence[tuple[float, dict[str, Any]]] = ()
    """(t, {name: value}) in ascending order.

    Of the plant: R_s (Ω), R_R (Ω), current_offset (A), u_dc (V), speed (rad/s or None), open_phase (0 to 2),
    channel: (0 to 2, how) with how "held", or (0 to 2, how, value) with "stuck" and "once" (one sample) in A,
    "gain", or "of" another channel; encoder: "broken" (no edges), "channel" (one of the two is lost),
    "swapped", "silent" (not read), or None, whole again. Of the drive: stop (True, or False to go on), reset
    (True: leave a fault)."""
    record_every: int = 10
    """Record every so many control periods."""
    signals: Sequence[str] | None = None
    """Names of the signals to record; None: all."""
    memory: dict[str, Any] | None = None
    """What an earlier run of this motor left in `Result.memory`; `R_s` from 0.4 to 2 times that of motor and
    inverter, with r_d, `L_sigma` from 0.5 to 2 and `L_M` from 0.625 to 1.67 times the motor's. `knee` and
    `leg_delay` may be missing: they are those of the parameters then."""
    cycle_stamps: bool = False
    """Every call of the drive carries the stamp of its PWM period."""
    name: str = ""
    """Title of plots."""

    def __post_init__(self) -> None:
        self._normalise()
        self._check()
        if self.torque_ref is not None and self.omega_ref != 0.0:
            raise ValueError(
                f"omega_ref = {self.omega_ref} and torque_ref = {self.torque_ref}: give only one"
            )
        rows = self.duration * self.inverter.f_c / max(self.record_every, 1)
        names = _core.signals() if self.signals is None else self.signals
        size = 16.0 * rows * (1 + len(names))
        if math.isfinite(size) and size > _RECORD_LIMIT:
            raise ValueError(
                f"duration = {self.duration} s would record {size:.1e} bytes, admissible are up to "
                f"{_RECORD_LIMIT:.0e}: raise record_every or choose signals"
            )
        _core.Run(self)
        said = [self._encoder(), self._cut()]
        if texts := self.unreached():
            said.append(f"{'; '.join(texts)}: duration = {self.duration:g} s")
        for text in filter(None, said):
            warnings.warn(text, ScenarioWarning, stacklevel=outside())

    def _encoder(self) -> str | None:
        """Where the drive is told of an encoder that the plant does not have."""
        told, real = self.settings.get("encoder_lines") or 0, self.plant.get("encoder_lines") or 0
        if not told or told == real:
            return None
        text = f"settings.encoder_lines = {told}, plant.encoder_lines = {real or None}: "
        if not real:
            return f"{text}there is no encoder to read, the drive is sensorless"
        return f"{text}the drive reads {real / told:.3g} of the speed"

    def _cut(self) -> str | None:
        """Where the reference goes beyond what the drive follows, before the end of the run."""
        name = "omega_ref" if self.torque_ref is None else "torque_ref"
        profile = getattr(self, name)
        asked = [profile]
        if isinstance(profile, tuple):
            t, values = zip(*profile, strict=True)
            asked = [value for t, value in profile if t <= self.duration]
            asked.append(float(np.interp(self.duration, t, values)))
        text = self.cut(min(asked), max(asked))
        return text and f"{name}: {text}"

    def cut(self, least: float, most: float) -> str | None:
        """The limits, in words, to which the drive cuts references of speed or torque from `least` to `most`;
        None where it follows them."""
        options: dict[str, Any] = {"scheme": self.scheme, "arithmetic": self.arithmetic, **self.settings}
        settings: Any = _core.Drive(self.motor, self.inverter, **options).settings
        unit, largest, limits = "rad/s", "omega_max", "speed_limits"
        if self.torque_ref is not None:
            unit, largest, limits = "N·m", "torque_max", "torque_limits"
        low, high = settings[limits] or (-settings[largest], settings[largest])
        # A ulp of single precision is no excess.
        if least >= 1.000001 * low and most <= 1.000001 * high:
            return None
        return f"{least:.4g} … {most:.4g} {unit}, cut to {low:.4g} … {high:.4g} {unit} ({largest}, {limits})"

    def unreached(self) -> list[str]:
        """What would only come after the end of the run, in words: changes, and points of a profile with
        another value than the last one that is reached. The end of a ramp may lie there."""
        texts = []
        for name in ("omega_ref", "torque_ref", "load_torque"):
            points = getattr(self, name)
            if not isinstance(points, tuple):
                continue
            # A line that begins before the end counts as reached.
            for k, ((t, before), (_, after)) in enumerate(pairwise(points)):
                if t > self.duration and before != after:
                    texts.append(f"{name}[{k + 1}] comes after the end, from t = {t:g} s on")
                    break
        late = [(k, t) for k, (t, _) in enumerate(self.changes) if t > self.duration]
        if late:
            k, t = late[0]
            texts.append(f"changes[{k}] comes after the end, at t = {t:g} s")
        return texts

    def _normalise(self) -> None:
        """Plain immutable values in place of arrays, lists and functions: equal scenarios compare equal,
        pickle and save."""

        def set_field(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        for name, kind in (
            ("motor", Motor),
            ("plant_motor", Motor),
            ("inverter", Inverter),
            ("plant_inverter", Inverter),
        ):
            value = getattr(self, name)
            if value is not None or not name.startswith("plant_"):
                instance(name, value, kind)
        for name, text in (("name", self.name), ("scheme", self.scheme), ("arithmetic", self.arithmetic)):
            if not isinstance(text, str):
                raise TypeError(f"{name} = {text!r} is not a text")
        set_field("duration", number("duration", self.duration))
        every = number("record_every", self.record_every)
        if not 1.0 <= every < 2.0**32 or every != int(every):
            raise ValueError(
                f"record_every = {self.record_every} is not a whole number of periods from 1 to 2^32 - 1"
            )
        set_field("record_every", int(every))
        for name in ("omega_ref", "torque_ref", "load_torque"):
            if getattr(self, name) is None and name != "torque_ref":
                raise TypeError(f"{name} = None is not a number: 0.0 is none")
            set_field(name, _profile(name, getattr(self, name), self.duration))
        if isinstance(self.signals, str):
            raise TypeError(f"signals = {self.signals!r}: give a list of names, [{self.signals!r}]")
        if self.signals is not None:
            if not isinstance(self.signals, Iterable):
                raise TypeError(f"signals = {self.signals!r} is not a list of names")
            set_field("signals", tuple(self.signals))
            for k, name in enumerate(self.signals):
                if not isinstance(name, str):
                    raise TypeError(f"signals[{k}] = {name!r} is not a name")
        set_field("cycle_stamps", truth("cycle_stamps", self.cycle_stamps))
        for name, what in (
            ("settings", "a table of names and values"),
            ("plant", "a table of names and values"),
            ("memory", "what Result.memory holds"),
        ):
            table = getattr(self, name)
            if table is None and name == "memory":
                continue
            if not isinstance(table, Mapping):
                raise TypeError(f"{name} = {table!r} is not {what}")
            for key in table:
                if not isinstance(key, str):
                    raise TypeError(f"{name}: {key!r} is not a name")
            values = {key: _immutable(value) for key, value in table.items()}
            pair = values.get("u_off")
            # As plain data have it.
            if name == "memory" and isinstance(pair, tuple) and [type(x) for x in pair] == [float, float]:
                values["u_off"] = complex(*pair)
            set_field(name, values)
        if not isinstance(self.changes, Iterable):
            raise TypeError(f"changes = {self.changes!r} is not a list of (t, {{name: value}})")
        set_field("changes", tuple(_change(k, change) for k, change in enumerate(self.changes)))

    def _check(self) -> None:
        """What the compiled part cannot see or would not name."""
        times = [t for t, _ in self.changes]
        for before, t in pairwise(times):
            if t < before:
                raise ValueError(f"changes time = {t:g} s stands after {before:g} s: sort them by time")
        motor = self.plant_motor or self.motor
        for name, most, unit in (
            ("load_torque", _TORQUE_LIMIT * motor.T_N, "N·m"),
            ("torque_ref", _TORQUE_LIMIT * self.motor.T_N, "N·m"),
            ("omega_ref", _SPEED_LIMIT * self.motor.base["omega_m"], "rad/s"),
        ):
            profile = getattr(self, name)
            values = [value for _, value in profile] if isinstance(profile, tuple) else [profile or 0.0]
            for value in values:
                if not abs(value) <= most:
                    raise ValueError(
                        f"{name} = {value:g} {unit} is outside the admissible range {-most:.6g} to "
                        f"{most:.6g} {unit}"
                    )
        most = _SPEED_LIMIT * motor.base["omega_m"]
        for given in (self.plant, *(change for _, change in self.changes if "speed" in change)):
            speed = given.get("speed")
            if isinstance(speed, int | float) and not abs(speed) <= most:
                raise ValueError(
                    f"speed = {speed:g} rad/s is outside the admissible range {-most:.6g} to {most:.6g} rad/s"
                )
        for title, link, of in (
            ("inverter", self.inverter, self.motor),
            ("plant_inverter", self.plant_inverter or self.inverter, motor),
        ):
            least = _LEAST_LINK * math.sqrt(2.0) * of.U_N
            if link.u_dc < least:
                raise ValueError(
                    f"{title}.u_dc = {link.u_dc:g} V is outside the admissible range from {least:.4g} V on "
                    f"for a machine of U_N = {of.U_N:g} V"
                )

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
        if not isinstance(name, str):
            raise TypeError(f"name = {name!r} is not a text")
        part, dot, field_name = name.partition(".")
        if part not in {f.name for f in fields(self)}:
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
        if not isinstance(whole, Motor | Inverter) or field_name not in {f.name for f in fields(whole)}:
            raise ValueError(f"{name}: {field_name} is not a field of {part}")
        return getattr(whole, field_name)

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """A copy with changed fields, named as in `value`. Raises ValueError as the scenario does."""
        if not isinstance(values, Mapping):
            raise TypeError(f"values = {values!r} is not a table of names and values")
        changes: dict[str, Any] = {}
        parts: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if not isinstance(name, str):
                raise TypeError(f"values: {name!r} is not a name")
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
                for field_name in of_part:
                    if field_name not in {f.name for f in fields(whole)}:
                        raise ValueError(f"{part}.{field_name}: {field_name} is not a field of {part}")
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

        Motors and inverters are a preset's name, a motor file (see `stillflux.machine_file`; relative to the
        current folder here, to their own in the files of the commands), or a table of fields, in which
        `preset` may name a preset to change. Without an inverter, that of the motor's preset or file is
        taken, and of a file also what it simulates and the settings that follow from how well it knows its
        values, unless they are given. A table of an inverter that names no preset changes that inverter, or
        for a motor without preset and file the one that suits it (`machine_file.typical_inverter`); those of
        `plant_motor` and `plant_inverter` change what the drive knows, and a `plant_motor` with an equivalent
        circuit of its own has the drive's rating where it has none.
        """
        known = {f.name for f in fields(cls)}
        if not isinstance(data, Mapping):
            raise TypeError(f"a scenario is a table of its fields, not {data!r}")
        for key in data:
            if key not in known:
                raise ValueError(f"{key} is not a field of a scenario; those are {', '.join(sorted(known))}")
        if "inverter" not in data and isinstance(data.get("motor"), str):
            with _naming_field("motor"):
                data = with_machine(data, load_machine(data["motor"]))
        least = "a scenario has motor, inverter and duration at least"
        for key in ("motor", "duration"):
            if key not in data:
                raise ValueError(f"{key} is missing: {least}")
        motor = _part(Motor, "motor", data["motor"])
        if "inverter" not in data and "preset" not in data["motor"]:
            raise ValueError(f"inverter is missing: {least}; inverter = {{}} is one that suits the motor")
        given, beside = data.get("inverter", {}), None
        if isinstance(given, Mapping) and "preset" not in given:
            with _naming_field("motor"):
                beside = inverter_beside(motor, data["motor"])
        inverter = _part(Inverter, "inverter", given, beside)
        parts = {"motor": motor, "inverter": inverter}
        if "plant_motor" in data:
            parts["plant_motor"] = _part(Motor, "plant_motor", data["plant_motor"], motor)
        if "plant_inverter" in data:
            parts["plant_inverter"] = _part(Inverter, "plant_inverter", data["plant_inverter"], inverter)
        rest = {
            key: rich(value, key)
            for key, value in data.items()
            if key.removeprefix("plant_") not in ("motor", "inverter")
        }
        return cls(**rest, **parts)


def _part(
    kind: type[Motor] | type[Inverter], name: str, value: Any, otherwise: Motor | Inverter | None = None
) -> Any:
    """A motor or an inverter of plain data; errors name the field."""
    if not isinstance(value, str | Mapping):
        raise TypeError(f"{name} = {value!r} is neither a preset, nor a motor file, nor a table of fields")
    with _naming_field(name):
        return part(kind, value, otherwise)


@contextmanager
def _naming_field(name: str) -> Iterator[None]:
    """Puts the name of a field in front of an error that does not begin with it."""
    try:
        yield
    except (ValueError, TypeError) as error:
        text = str(error)
        raise type(error)(text if text.startswith(f"{name} ") else f"{name}: {text}") from None


def _profile(name: str, value: Any, duration: float) -> Any:
    """A number, or pairs (t, value)."""
    if value is None:
        return None
    if callable(value):
        count = math.ceil(max(duration, 0.0) / _EVERY) if math.isfinite(duration) else 0
        if count > _MOST_POINTS:
            raise ValueError(
                f"{name} is a function, read every {1e3 * _EVERY:g} ms: {count} points for duration = "
                f"{duration:g} s, at most {_MOST_POINTS} (points (t, value) have no such limit)"
            )
        times = [duration * k / count for k in range(count + 1)] if count else [0.0]
        return tuple((t, number(name, value(t))) for t in times)
    # A frame of pandas is an array, too.
    if hasattr(value, "__array__") and np.ndim(value):
        value = np.asarray(value)
        if value.ndim != 2 or value.shape[1] != 2:
            raise ValueError(f"{name} has the shape {value.shape}, points have (n, 2): time in s and value")
        value = value.tolist()
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for k, point in enumerate(value):
            if not isinstance(point, Sequence | np.ndarray) or isinstance(point, str) or len(point) != 2:
                raise ValueError(f"{name}[{k}] = {point!r} is not a point (t, value)")
        if not len(value):
            raise ValueError(f"{name} = {value!r} has no points")
        points = tuple(
            (number(f"{name}[{k}]", t), number(f"{name}[{k}]", x)) for k, (t, x) in enumerate(value)
        )
        for k, (t, _) in enumerate(points):
            if not 0.0 <= t < math.inf:
                raise ValueError(f"{name}[{k}]: t = {t:g} s is outside the admissible range from 0 s on")
        return points
    try:
        return number(name, value)
    except TypeError:
        raise TypeError(
            f"{name} = {value!r} is not a number, nor points (t, value), nor a function of the time"
        ) from None


def _change(k: int, change: Any) -> tuple[float, dict[str, Any]]:
    try:
        t, what = change
        # Thousands of changes, of plain numbers, are the ripple of a link.
        values = {key: value if type(value) is float else _immutable(value) for key, value in what.items()}
        return t if type(t) is float else number(f"changes[{k}]", t), values
    except (AttributeError, ValueError, TypeError):
        raise TypeError(f"changes[{k}] = {change!r} is not (t, {{name: value}})") from None


def _immutable(value: Any) -> Any:
    """Numbers and tuples instead of numpy's scalars, arrays and lists."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(map(_immutable, value)) if isinstance(value, list | tuple) else value


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
            # A text, a truth value or a list in a file is no part of a space vector.
            return complex(*(number(f"{key}[{k}]", part) for k, part in enumerate(value)))
        return tuple(rich(item) for item in value)
    return value
