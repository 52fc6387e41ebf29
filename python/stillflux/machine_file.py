"""Motor files: a machine as TOML, by its parameters, by its nameplate, or as commissioning found it.

```toml
name = "pump 3"                # optional, the file's name otherwise
status = "fault: aborted at 3 s"    # optional, as commissioning writes them: "done" or a fault,
cause = "aborted"              # its cause, none if it is done,
warnings = ["…"]               # what should be looked at; these and a fault are warnings when it is read

[motor]                        # inverse-Γ: R_s, R_R, L_sigma, L_M in Ω and H;
R_s = 3.7                      # or Γ: R_s, R_r, L_l, L_s; or T: R_s, R_r, L_ls, L_lr, L_m
R_R = 2.1
L_sigma = 0.021
L_M = 0.224
n_p = 2
J = 0.015
U_N = 400.0
I_N = 5.0
f_N = 50.0
T_N = 14.6
saturation = [0.25, 0.7, 6.0]  # optional

[inverter]                     # fields of stillflux.Inverter; optional, the rest suits the motor
u_dc = 540.0

[deviation]                    # optional: relative standard deviations, of which the drive makes its priors
R_s = 0.05

[plant.motor]                  # optional: the motor and the inverter that are simulated where they differ
R_s = 3.65                     # from what the drive is told, as `stillflux commission` writes them; what a
                               # table does not say is that of the tables above

[plant.inverter]
dead_time = 2.1e-6
```

`preset = "2.2kW"` in a table names a preset whose fields the others change. What `[inverter]` does not say is
that of the inverter of the motor's preset, or for a motor without one what suits it (`typical_inverter`). A
file with a `[nameplate]` table (`P_N`, `U_N`, `I_N`, `f_N`, `n_N`, `cos_phi`; W, V, A, Hz, r/min) instead of
`[motor]` gets the parameters that follow from the rated point.

Files in which a motor file may stand in place of a preset (scenarios, sweeps, commissionings) name it
relative to their own folder.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import sys
import warnings as python_warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from stillflux import _core
from stillflux.messages import MachineWarning, meant, outside
from stillflux.nameplate import Nameplate
from stillflux.options import DriveSettings
from stillflux.parameters import PRESETS, Inverter, Motor

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = [
    "NOTES",
    "Machine",
    "beside",
    "check_tables",
    "checked",
    "checked_name",
    "deviation_of",
    "in_file",
    "inverter_beside",
    "inverter_of",
    "load_machine",
    "machine_to_toml",
    "motor_file",
    "part",
    "plate_of",
    "priors",
    "read_toml",
    "simulated_guess",
    "typical_inverter",
]

_TABLES = ("motor", "inverter", "deviation", "nameplate", "plant")
NOTES = ("status", "cause", "warnings")
"""What commissioning writes about itself."""
_DEVIATIONS = ("R_s", "R_R", "L_sigma", "L_M", "J", "loss", "c_out", "leg_delay")
_MEASURED = {"R_s", "R_R", "L_sigma", "L_M", "J", "loss", "c_out"}
_CIRCUITS = (
    (Motor.inverse_gamma, ("R_s", "R_R", "L_sigma", "L_M")),
    (Motor.gamma, ("R_s", "R_r", "L_l", "L_s")),
    (Motor.t_model, ("R_s", "R_r", "L_ls", "L_lr", "L_m")),
)


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A motor with its inverter, as a motor file or a preset describes them."""

    name: str
    """For titles and file names."""
    motor: Motor
    inverter: Inverter
    deviation: Mapping[str, float] = field(default_factory=dict)
    """Relative standard deviation of single values, where the file or the nameplate knows one."""
    settings: DriveSettings = field(default_factory=DriveSettings)
    """What a drive begins with by the deviations in the file (`priors`)."""
    plant_motor: Motor | None = None
    """The motor that is simulated; None: `motor`."""
    plant_inverter: Inverter | None = None
    """The inverter that is simulated; None: `inverter`."""
    of_plate: bool = False
    """The motor's parameters follow from a nameplate."""
    status: str | None = None
    """How the commissioning ended that has written the file, "done" or a fault; None: it was none."""
    cause: str | None = None
    """Cause of that fault, None without one."""
    warnings: tuple[str, ...] = ()
    """What commissioning has warned of."""


def priors(deviation: Mapping[str, float], told: Collection[str] = ()) -> DriveSettings:
    """Priors of a drive (`prior_R_s` and so on) for relative standard deviations: where those of R_s, R_R,
    L_sigma, L_M, J, loss and c_out are known, as a commissioning leaves them, of all but J, and else of those
    that are `told`. Those of a nameplate are no measurement."""
    if set(deviation) >= _MEASURED:
        return _core.priors(deviation)
    some = {name: deviation[name] for name in _MEASURED & set(told)}
    every = _core.priors({**dict.fromkeys(_MEASURED, 0.1), **some})
    return cast("DriveSettings", {k: x for k, x in every.items() if k.removeprefix("prior_") in some})


def with_machine(scenario: Mapping[str, Any], machine: Machine) -> dict[str, Any]:
    """The plain data of a scenario with the motor and inverter of a machine instead of those in it; with
    those that its file simulates, and with the settings that follow from how well it knows its values,
    unless the scenario has its own."""
    found = {**scenario, "motor": asdict(machine.motor), "inverter": asdict(machine.inverter)}
    for name, real in (("plant_motor", machine.plant_motor), ("plant_inverter", machine.plant_inverter)):
        if real is not None:
            found.setdefault(name, asdict(real))
    if machine.settings and found.get("scheme", "enhanced") == "enhanced":
        found["settings"] = {**machine.settings, **found.get("settings", {})}
    return found


def load_machine(source: str | os.PathLike[str]) -> Machine:
    """The machine of a preset's name ("2.2kW", "11kW") or of a motor file.

    What the commissioning that has written the file warned of, and a fault by which it ended, is a
    `MachineWarning`. Raises ValueError naming file, table, field, value and admissible range; OSError if the
    file cannot be read, TypeError for what is no path.
    """
    if not isinstance(source, str | os.PathLike):
        raise TypeError(f"motor = {source!r} is neither a preset ({', '.join(PRESETS)}) nor a path")
    if isinstance(source, str) and source in PRESETS:
        return Machine(name=source, motor=Motor.preset(source), inverter=Inverter.preset(source))
    path = motor_file(source)
    data = read_toml(path)
    check_tables(path, data, "motor")
    if ("motor" in data) == ("nameplate" in data):
        raise ValueError(f"{path}: give one of the tables [motor] and [nameplate]")
    deviation = deviation_of(path, data)
    told = tuple(deviation)
    if "motor" in data:
        motor = checked(path, "motor", _motor, data["motor"])
    else:
        motor, assumed = checked(path, "nameplate", _of_nameplate, data["nameplate"])
        deviation = {**assumed, **deviation}
    inverter = checked(
        path, "inverter", lambda t: inverter_of(t, motor, data.get("motor")), data.get("inverter")
    )
    name = checked_name(path, data.get("name", path.stem))
    real = beside(path, data.get("plant", {}), ("inverter",), "plant")
    plant_motor = None
    if "motor" in real:
        plant_motor = checked(path, "plant.motor", lambda t: _motor(t, motor), real.pop("motor"))
    plant_inverter = None
    if "inverter" in real:
        plant_inverter = checked(
            path,
            "plant.inverter",
            lambda t: part(Inverter, t, inverter),
            real.pop("inverter"),
        )
    if real:
        raise ValueError(f"{path}: [plant] {next(iter(real))}: there are motor and inverter")
    notes = _notes(path, data)
    for text in notes["warnings"]:
        python_warnings.warn(f"{path}: {text}", MachineWarning, stacklevel=outside())
    if notes["cause"] is not None:
        python_warnings.warn(
            f"{path}: the commissioning ended with {notes['status'] or notes['cause']!r}: values of "
            f"procedures that were not completed are the nameplate's",
            MachineWarning,
            stacklevel=outside(),
        )
    return Machine(
        **notes,
        name=name,
        motor=motor,
        inverter=inverter,
        deviation=deviation,
        settings=priors(deviation, told if notes["status"] is None else ()),
        plant_motor=plant_motor,
        plant_inverter=plant_inverter,
        of_plate="nameplate" in data,
    )


def check_tables(path: Path, data: Mapping[str, Any], kind: str, named: Sequence[str] = ()) -> None:
    """Raises ValueError for what a kind of file does not have, and for what has to be a table and is none;
    those of `named` may be a text, the name of a preset or of a file."""
    known = (*_TABLES, "name", *NOTES)
    for key, value in data.items():
        if key not in known:
            raise ValueError(f"{path}: {key} is not known in a {kind} file{meant(key, known)}")
        if key in _TABLES and not isinstance(value, (dict, str) if key in named else dict):
            raise ValueError(f"{path}: {key} is not a table: write [{key}] and its fields below it")


def deviation_of(path: Path, data: Mapping[str, Any]) -> dict[str, float]:
    """The table of deviations of a file. Raises ValueError naming file, table and field."""
    deviation = dict(data.get("deviation", {}))
    for key, value in deviation.items():
        if key not in _DEVIATIONS:
            raise ValueError(f"{path}: [deviation] {key} is not known{meant(key, _DEVIATIONS)}")
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 10.0:
            raise ValueError(f"{path}: [deviation] {key} = {value!r} is outside 0 … 10")
    return deviation


def motor_file(source: str | os.PathLike[str]) -> Path:
    """The file of what is no preset's name. Raises ValueError for what is no file's either."""
    path = Path(source)
    # "5.5kW" is no file name with the ending ".5kW".
    # Nothing at all is the path of the folder.
    if path.is_dir() or (path.suffix != ".toml" and not path.exists()):
        raise ValueError(
            f"motor = {str(source)!r} is neither a preset ({', '.join(PRESETS)}) nor a motor file"
        )
    return path


def simulated_guess(path: str | os.PathLike[str]) -> str:
    """What is said where the plant is no motor of its own but the one that the drive is told."""
    return f"{path} has no [plant.motor]: the motor that follows from the plate is simulated"


def beside(path: str | os.PathLike[str], table: Any, fields: Sequence[str], title: str = "") -> Any:
    """A table of a file, in which a motor file that a field names is the one beside the file, wherever the
    command was given. Raises ValueError naming file, table and field where there is none."""
    if not isinstance(table, Mapping):
        return table
    found = dict(table)
    for name in fields:
        value = found.get(name)
        if not isinstance(value, str) or value in PRESETS:
            continue
        named = Path(path).parent / value
        if named.is_dir() or not named.exists():
            where = f"{path}: {title and f'[{title}] '}{name} = {value!r}"
            known = ", ".join(PRESETS)
            raise ValueError(f"{where} is neither a preset ({known}) nor a motor file: there is no {named}")
        found[name] = str(named)
    return found


@contextmanager
def in_file(path: str | os.PathLike[str]) -> Iterator[None]:
    """Puts the name of a file in front of an error of what is in it."""
    try:
        yield
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from None


def _notes(path: Path, data: Mapping[str, Any]) -> dict[str, Any]:
    """What commissioning has written about itself."""
    notes: dict[str, Any] = {name: data.get(name) for name in ("status", "cause")}
    for name, value in notes.items():
        if value is not None and not isinstance(value, str):
            raise ValueError(f"{path}: {name} = {value!r} is not a text")
    texts = data.get("warnings", [])
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise ValueError(f"{path}: warnings = {texts!r} is not a list of texts")
    return {**notes, "warnings": tuple(texts)}


def checked_name(path: Path, name: Any) -> str:
    """The name of a machine; ValueError naming the file if reports cannot be named by it."""
    if not isinstance(name, str) or not re.fullmatch(r"[^\x00-\x1f/\\:*?\"<>|]{1,80}", name):
        raise ValueError(
            f"{path}: name = {name!r} is no file name of up to 80 characters, which reports need"
        )
    return name


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The tables of a TOML file. Raises ValueError with file and line for bad syntax and for bytes
    that are not UTF-8."""
    try:
        # Editors of one system begin a file with a mark of the byte order.
        return tomllib.loads(Path(path).read_bytes().decode("utf-8-sig"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: {error}") from None
    except UnicodeDecodeError as error:
        line, byte = error.object.count(b"\n", 0, error.start) + 1, error.object[error.start]
        raise ValueError(
            f"{path}, line {line}: no text in UTF-8, as TOML has to be (byte 0x{byte:02x})"
        ) from None
    except RecursionError:
        raise ValueError(f"{path}: nested too deeply") from None


def machine_to_toml(
    motor: Motor,
    inverter: Inverter | None = None,
    *,
    name: str = "",
    deviation: Mapping[str, float] | None = None,
    warnings: Sequence[str] = (),
    status: str | None = None,
    cause: str | None = None,
    plant_motor: Motor | None = None,
    plant_inverter: Inverter | None = None,
) -> str:
    """The text of a motor file, which `load_machine` reads back to equal objects."""
    lines = [f"name = {_toml(name)}"] if name else []
    lines += [
        f"{key} = {_toml(text)}" for key, text in (("status", status), ("cause", cause)) if text is not None
    ]
    if warnings:
        lines.append(f"warnings = {_toml(list(warnings))}")
    tables: list[tuple[str, Mapping[str, Any]]] = [("motor", asdict(motor))]
    if inverter is not None:
        tables.append(("inverter", asdict(inverter)))
    if deviation:
        tables.append(("deviation", deviation))
    if plant_motor is not None:
        tables.append(("plant.motor", asdict(plant_motor)))
    if plant_inverter is not None:
        tables.append(("plant.inverter", asdict(plant_inverter)))
    for title, fields in tables:
        lines += ["", f"[{title}]"] if lines else [f"[{title}]"]
        lines += [f"{key} = {_toml(value)}" for key, value in fields.items() if value is not None]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    # A JSON string is a TOML string; shortest digits that read back to the same number.
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else repr(value)


def part(cls: type[Motor] | type[Inverter], value: Any, otherwise: Any = None) -> Any:
    """A `Motor` or `Inverter` of plain data: a preset's name, a motor file, or a table of fields, which
    change the preset that the table names, or else the given one."""
    if isinstance(value, str):
        machine = load_machine(value)
        return machine.motor if cls is Motor else machine.inverter
    if cls is Motor:
        return _motor(value, otherwise)
    fields = _inverter_fields(value)
    return Inverter(**fields) if otherwise is None or "preset" in value else otherwise.replace(**fields)


def inverter_beside(motor: Motor, given: Any) -> Inverter:
    """The inverter of a motor that is given as a preset's name, a motor file or a table of fields: that of
    the preset, also of one that the table names, or of the file, or one that suits the motor."""
    if isinstance(given, str):
        return load_machine(given).inverter
    preset = given.get("preset") if isinstance(given, Mapping) else None
    return typical_inverter(motor) if preset is None else Inverter.preset(preset)


def checked(path: Path, table: str, build: Any, fields: Any) -> Any:
    """What `build` makes of a table; errors name file and table."""
    try:
        return build(fields)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: [{table}] {error}") from None


def _motor(table: Mapping[str, Any], otherwise: Motor | None = None) -> Motor:
    fields = _with_preset(Motor, table)
    others = [one for one in dataclasses.fields(Motor) if one.name not in _CIRCUITS[0][1]]
    needed = [one.name for one in others if one.default is dataclasses.MISSING]
    if otherwise is not None and "preset" not in table:
        inherited = asdict(otherwise)
        if any(all(name in fields for name in names) for _, names in _CIRCUITS):
            # With a circuit of its own it has the rating of the other motor, and not its curve.
            inherited = {name: inherited[name] for name in needed}
        fields = {**inherited, **fields}
    for build, names in _CIRCUITS:
        if all(name in fields for name in names):
            _only(fields, (*names, *(one.name for one in others)))
            if missing := [name for name in needed if name not in fields]:
                raise ValueError(f"has no {', '.join(missing)}: a motor has {', '.join(needed)}")
            motor: Motor = build(**fields)
            return motor
    known = "; ".join(", ".join(names) for _, names in _CIRCUITS)
    raise ValueError(f"has no complete equivalent circuit, which is one of: {known}")


def inverter_of(table: Mapping[str, Any] | None, motor: Motor, given: Any = None) -> Inverter:
    """The inverter of a table, whose fields change those of the preset that it names, or else those of the
    inverter beside the motor as it is given. Raises ValueError, TypeError."""
    otherwise = inverter_beside(motor, given)
    inverter: Inverter = otherwise if table is None else part(Inverter, table, otherwise)
    return inverter


def typical_inverter(motor: Motor) -> Inverter:
    """An inverter for a motor without a description of its own: the rectified rated voltage, the threshold of
    its class of switches, a differential resistance of a twentieth of R_s, otherwise the defaults."""
    u_dc = 1.35 * motor.U_N
    return Inverter(u_dc=u_dc, u_th=1.0 if u_dc > 150.0 else 0.0, r_d=0.05 * motor.R_s)


def _with_preset(cls: type[Any], table: Mapping[str, Any]) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise TypeError(f"{table!r} is not a table of fields")
    fields = dict(table)
    preset = fields.pop("preset", None)
    return fields if preset is None else {**asdict(cls.preset(preset)), **fields}


def _inverter_fields(table: Mapping[str, Any]) -> dict[str, Any]:
    fields = _with_preset(Inverter, table)
    _only(fields, [one.name for one in dataclasses.fields(Inverter)])
    return fields


def _only(table: Mapping[str, Any], known: Sequence[str]) -> None:
    """Raises ValueError for a field that there is not."""
    for name in table:
        if name not in known:
            raise ValueError(f"{name} is not known{meant(name, known)}")


def plate_of(table: Mapping[str, Any]) -> Nameplate:
    """The nameplate of a table. Raises ValueError naming what is missing or not known, TypeError."""
    if not isinstance(table, Mapping):
        raise TypeError(f"{table!r} is not a table of fields")
    known = [one.name for one in dataclasses.fields(Nameplate)]
    _only(table, known)
    needed = [x.name for x in dataclasses.fields(Nameplate) if x.default is dataclasses.MISSING]
    if missing := [name for name in needed if name not in table]:
        raise ValueError(f"has no {', '.join(missing)}: a plate has {', '.join(needed)}")
    return Nameplate(**table)


def _of_nameplate(table: Mapping[str, Any]) -> tuple[Motor, Mapping[str, float]]:
    plate = plate_of(table)
    return plate.motor(), dict(plate.deviation)
