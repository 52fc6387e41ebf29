"""Recorded logs as columns in SI: CSV, Parquet, NPZ, MAT, mappings of arrays; what is wrong with them by
place."""

from __future__ import annotations

import codecs
import csv
import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["QUANTITIES", "Columns", "Log", "read_log"]

Columns: TypeAlias = Mapping[str, "str | tuple[str, str | float] | Mapping[str, Any]"]
"""Quantity → name of its column, or (name, unit or factor), or {"name": …, "unit": …, "scale": …}."""

_UNITS: dict[str, tuple[str, float]] = {
    "": ("", 1.0),
    "1": ("", 1.0),
    "%": ("", 1e-2),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "µs": ("time", 1e-6),
    "μs": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "A": ("current", 1.0),
    "mA": ("current", 1e-3),
    "kA": ("current", 1e3),
    "V": ("voltage", 1.0),
    "mV": ("voltage", 1e-3),
    "kV": ("voltage", 1e3),
    "rad": ("angle", 1.0),
    "deg": ("angle", np.pi / 180.0),
    "°": ("angle", np.pi / 180.0),
    "Vs": ("flux", 1.0),
    "V s": ("flux", 1.0),
    "V·s": ("flux", 1.0),
    "Wb": ("flux", 1.0),
}

QUANTITIES: dict[str, str] = {
    "t": "time",
    **dict.fromkeys(("i_a", "i_b", "i_c", "i_alpha", "i_beta", "i_s", "i_d", "i_q"), "current"),
    **dict.fromkeys(("u_a", "u_b", "u_c", "u_ab", "u_bc", "u_ca"), "voltage"),
    **dict.fromkeys(("u_alpha", "u_beta", "u_s", "u_d", "u_q", "u_dc"), "voltage"),
    **dict.fromkeys(("d_a", "d_b", "d_c"), ""),
    "angle": "angle",
    "psi_ref": "flux",
}
"""What a log can hold, and its kind. `i_s` and `u_s` are complex; `angle` is that of the d-axis of the dq
columns; `d_a` … are duties, 0 to 1."""


@dataclass(frozen=True)
class Log:
    """Columns of a log in SI, with the place that each value came from."""

    source: str
    """File, or kind of object."""
    data: Mapping[str, NDArray[Any]]
    """Quantity → values in SI, all of one length."""
    names: Mapping[str, str]
    """Quantity → name of its column."""
    lines: NDArray[np.int64] | None
    """Line of each row in a text file, else None."""

    def __len__(self) -> int:
        return len(next(iter(self.data.values())))

    def place(self, quantity: str | Sequence[str], row: int | None = None) -> str:
        """Where a value stands: file, line or row, columns."""
        quantities = [quantity] if isinstance(quantity, str) else quantity
        columns = ", ".join(repr(self.names.get(q, q)) for q in quantities)
        where = self.source
        if row is not None:
            where += f", row {row}" if self.lines is None else f", line {self.lines[row]}"
        return f"{where}, column{'s' if len(quantities) > 1 else ''} {columns}"


def read_log(log: Any, columns: Columns | None = None) -> Log:
    """The columns of a log. `log`: a file (.csv, .txt, .tsv, .parquet, .npz, .mat) or a mapping of arrays (a
    pandas frame is one).

    A column belongs to the quantity of its name ("i_a", "u_dc"; a unit may follow: "i_a [mA]", "t (ms)"), or
    to the one that `columns` assigns. Raises ValueError with file, line and column.
    """
    if isinstance(log, str | os.PathLike):
        path = Path(log)
        source, (table, lines) = str(path), _read(path)
    else:
        source, lines = type(log).__name__, None
        try:
            table = {str(name): np.asarray(log[name]) for name in log}
        except (TypeError, KeyError, IndexError):
            raise TypeError(f"log = {source} is neither a file nor a mapping of names to arrays") from None
        table.update(_index(log, table))
    vectors = _vectors(table)
    found = _assigned(source, vectors, columns or {})
    data: dict[str, NDArray[Any]] = {}
    names: dict[str, str] = {}
    for quantity, (name, scale) in found.items():
        values = np.asarray(vectors[name])
        if values.ndim != 1:
            values = values.squeeze()
        if values.ndim != 1 or values.dtype.kind not in "fiucb":
            raise ValueError(
                f"{source}, column {name!r} is not one series of numbers ({values.dtype}, {values.shape})"
            )
        kind = np.complex128 if quantity in ("i_s", "u_s") else np.float64
        if values.dtype.kind == "c" and kind is np.float64:
            raise ValueError(f"{source}, column {name!r} is complex; only i_s and u_s are space vectors")
        data[quantity], names[quantity] = np.ascontiguousarray(values, kind) * scale, name
    lengths = {names[q]: len(values) for q, values in data.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{source}: columns of different lengths, {lengths}")
    if not data or not len(next(iter(data.values()))):
        known = ", ".join(map(repr, table)) or "none"
        raise ValueError(
            f"{source} has no rows or no column of a known name; its columns: {known}; known: "
            f"{', '.join(QUANTITIES)}"
        )
    return Log(source, data, names, lines)


def _index(frame: Any, table: Mapping[str, Any]) -> dict[str, Any]:
    """The index of a pandas frame as a column, where it has a name that is none of the columns."""
    index = getattr(frame, "index", None)
    name = getattr(index, "name", None)
    return {} if name is None or str(name) in table else {str(name): np.asarray(index)}


def _vectors(table: Mapping[str, Any]) -> dict[str, Any]:
    """With the pairs "i_s.re" and "i_s.im", as `Result.to_pandas` writes them, as complex "i_s"."""
    pairs = {name.removesuffix(".re") for name in table if name.endswith(".re")}
    joined = {
        name: np.asarray(table[f"{name}.re"]) + 1j * np.asarray(table[f"{name}.im"])
        for name in pairs
        if f"{name}.im" in table and name not in table
    }
    return {**table, **joined}


def _assigned(source: str, table: Mapping[str, Any], columns: Columns) -> dict[str, tuple[str, float]]:
    """Quantity → (column, factor to SI)."""
    found: dict[str, tuple[str, float]] = {}
    for quantity, given in columns.items():
        if quantity not in QUANTITIES:
            raise ValueError(f"columns: {quantity!r} is not one of {', '.join(QUANTITIES)}")
        name, unit, scale = _column(quantity, given)
        if name not in table:
            raise ValueError(f"{source}: column {name!r} is missing; there are {', '.join(map(repr, table))}")
        unit = _header(name)[1] if unit is None else unit
        found[quantity] = name, scale * _factor(quantity, unit, f"{source}, column {name!r}")
    taken = {name for name, _ in found.values()}
    for name in table:
        bare, unit = _header(name)
        if bare in QUANTITIES and bare not in found and name not in taken:
            found[bare] = name, _factor(bare, unit, f"{source}, column {name!r}")
    return found


def _column(quantity: str, given: Any) -> tuple[str, str | None, float]:
    """Name, unit and further factor of an entry of `columns`."""
    if isinstance(given, str):
        return given, None, 1.0
    if isinstance(given, Mapping):
        unknown = set(given) - {"name", "unit", "scale"}
        if unknown or "name" not in given:
            raise ValueError(f"columns: {quantity!r} = {dict(given)} needs name and may have unit and scale")
        return str(given["name"]), given.get("unit"), float(given.get("scale", 1.0))
    try:
        name, last = given
    except (TypeError, ValueError):
        raise ValueError(
            f"columns: {quantity!r} = {given!r} is neither a name nor (name, unit or factor)"
        ) from None
    return (str(name), last, 1.0) if isinstance(last, str) else (str(name), None, float(last))


def _header(name: str) -> tuple[str, str]:
    """Name and unit of a header such as "i_a [mA]", "t (ms)" or "u_dc/V"."""
    match = re.fullmatch(r"\s*(.+?)\s*(?:\[(.*)\]|\((.*)\)|/\s*([^/\s]+))\s*", name)
    if not match:
        return name.strip(), ""
    return match[1], next(unit for unit in match.groups()[1:] if unit is not None).strip()


def _factor(quantity: str, unit: str, where: str) -> float:
    kind = QUANTITIES[quantity]
    if unit == "":
        return 1.0
    if unit not in _UNITS or _UNITS[unit][0] != kind:
        known = [name for name, (of, _) in _UNITS.items() if of == kind and name]
        raise ValueError(f"{where}: unit {unit!r} is none of {quantity}, which can have {', '.join(known)}")
    return _UNITS[unit][1]


def _read(path: Path) -> tuple[dict[str, Any], NDArray[np.int64] | None]:
    """Columns of a file, and the lines of the rows of a text file."""
    kind = path.suffix.lower()
    if kind in (".csv", ".txt", ".tsv"):
        return _read_text(path)
    if kind == ".npz":
        with _opened(path, "an NPZ file", lambda: np.load(path)) as file:
            return {name: file[name] for name in file.files if file[name].dtype.kind in "fiucb"}, None
    if kind == ".parquet":
        pandas = _optional("pandas", path, "parquet")
        try:
            frame = _opened(path, "a Parquet file", lambda: pandas.read_parquet(path))
        except ImportError:
            raise ValueError(f"{path}: Parquet needs pyarrow: pip install 'stillflux[parquet]'") from None
        table = {str(name): frame[name].to_numpy() for name in frame.columns}
        return {**table, **_index(frame, table)}, None
    if kind == ".mat":
        matlab = _optional("scipy.io", path, "mat")
        try:
            content = _opened(path, "a MAT file", lambda: matlab.loadmat(path, squeeze_me=True))
        except NotImplementedError:
            raise ValueError(f"{path} is a MAT file of version 7.3: save it with '-v7'") from None
        return {name: values for name, values in content.items() if not name.startswith("__")}, None
    raise ValueError(f"{path}: {kind or 'no suffix'} is not one of .csv, .txt, .tsv, .parquet, .npz, .mat")


def _opened(path: Path, kind: str, read: Callable[[], Any]) -> Any:
    """What `read` makes of a file. Raises ValueError with the file's name where it is not of its kind;
    OSError, ImportError and NotImplementedError pass."""
    try:
        return read()
    except (OSError, ImportError, NotImplementedError):
        raise
    except Exception as error:
        # Each reader has errors of its own: zipfile, pickle, pyarrow, scipy.
        reason = str(error).partition("\n")[0]
        raise ValueError(f"{path} is not {kind} ({type(error).__name__}: {reason})") from None


def _optional(module: str, path: Path, extra: str) -> Any:
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise ValueError(f"{path}: this format needs {name}: pip install 'stillflux[{extra}]'") from None


def _read_text(path: Path) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Delimiter and decimal comma by the header and the first row; lines that begin with # are comments; a
    row of units may follow the header. An empty cell is NaN."""
    content = io.StringIO(_decoded(path.read_bytes()), newline="")
    lines = [(number, line) for number, line in enumerate(content, 1) if line.strip()]
    lines = [(number, line) for number, line in lines if not line.lstrip().startswith("#")]
    if not lines:
        raise ValueError(f"{path} is empty")
    header_line = lines[0][1]
    delimiter = max(";\t,", key=header_line.count)
    header = [name.strip() for name in next(csv.reader([header_line], delimiter=delimiter))]
    if all(_number(cell) is not None for cell in header):
        raise ValueError(f"{path}, line {lines[0][0]}: no header, a line with the names of the columns")
    if len(set(header)) < len(header):
        raise ValueError(f"{path}, line {lines[0][0]}: a column's name stands twice in {', '.join(header)}")
    body = lines[1:]
    if body:
        cells = [cell.strip() for cell in body[0][1].replace('"', "").rstrip("\r\n").split(delimiter)]
        if (
            len(cells) == len(header)
            and all(re.sub(r"^[\[(]|[\])]$", "", c) in _UNITS for c in cells)
            and any(cells)
        ):
            units = [re.sub(r"^[\[(]|[\])]$", "", cell) for cell in cells]
            header = [f"{name} [{unit}]" if unit else name for name, unit in zip(header, units, strict=True)]
            body = body[1:]
    comma = delimiter != "," and any("," in line for _, line in body[:5])
    rows = np.empty((len(body), len(header)))
    for k, (number, line) in enumerate(body):
        # A quoted number is a number; no number has a quotation mark within.
        text = (line.replace(",", ".") if comma else line).replace('"', "")
        cells = text.rstrip("\r\n").split(delimiter)
        if len(cells) != len(header):
            raise ValueError(f"{path}, line {number}: {len(cells)} values, the header has {len(header)}")
        try:
            rows[k] = [float(cell) if cell.strip() else np.nan for cell in cells]
        except ValueError:
            bad = next(j for j, cell in enumerate(cells) if cell.strip() and _number(cell) is None)
            raise ValueError(
                f"{path}, line {number}, column {header[bad]!r}: {cells[bad]!r} is not a number"
            ) from None
    table = {name: rows[:, j] for j, name in enumerate(header)}
    return table, np.array([number for number, _ in body], dtype=np.int64)


def _decoded(content: bytes) -> str:
    """Text in UTF-8, in UTF-16 with a byte order mark, or else in Windows' Latin-1, in which instruments
    write µ and °."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
