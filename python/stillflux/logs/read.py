"""Recorded logs as columns in SI: CSV, Parquet, NPZ, MAT, mappings of arrays; what is wrong with them by
place."""

from __future__ import annotations

import codecs
import csv
import io
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from stillflux.parameters import number as real

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["QUANTITIES", "Columns", "Log", "read_log"]

Columns: TypeAlias = Mapping[str, "str | tuple[str, str | float] | Mapping[str, Any]"]
"""Quantity → name of its column, or (name, unit or factor), or {"name": …, "unit": …, "scale": …}."""

_UNITS: dict[str, tuple[str, float]] = {
    "": ("", 1.0),
    "1": ("", 1.0),
    "-": ("", 1.0),
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

_DELIMITERS = ";\t,"
_PREAMBLE = 200  # lines in which the first row of numbers is looked for

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
    scales: Mapping[str, float]
    """Quantity → factor by which its column was brought to SI."""

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
            table = {str(name): _unmasked(log[name]) for name in log}
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
        if quantity == "t" and values.dtype.kind in "mM" and len(values):
            # Times of day and durations, as pandas has them: from the first row on.
            values = (values - values[0]) / np.timedelta64(1, "s")
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
    if not data:
        known = ", ".join(map(repr, table)) or "none"
        raise ValueError(
            f"{source} has no column of a known name: assign them, columns={{'i_a': …}}; its "
            f"columns: {known}; known: {', '.join(QUANTITIES)}"
        )
    if not len(next(iter(data.values()))):
        raise ValueError(f"{source} has a header and no rows")
    scales = {quantity: scale for quantity, (_, scale) in found.items()}
    return Log(source, data, names, lines, scales)


def _unmasked(values: Any) -> NDArray[Any]:
    """A column as array; what is masked or missing in it is NaN."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    array = np.asarray(values)
    # Columns of pandas with missing numbers.
    if array.dtype.kind == "O" and hasattr(values, "to_numpy") and hasattr(values, "isna"):
        try:
            return np.asarray(values.to_numpy(dtype=float, na_value=np.nan))
        except (TypeError, ValueError):
            return array
    return array


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
    if not isinstance(columns, Mapping):
        raise TypeError(f"columns = {columns!r} is not a mapping of quantities to columns")
    for quantity, given in columns.items():
        if quantity not in QUANTITIES:
            raise ValueError(f"columns: {quantity!r} is not one of {', '.join(QUANTITIES)}")
        name, unit, scale = _column(quantity, given)
        # Named without the unit that stands beside it or in a row below the header.
        same = [column for column in table if _header(column)[0] == name]
        if name not in table and len(same) == 1:
            name = same[0]
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
        return str(given["name"]), given.get("unit"), _scale(quantity, given.get("scale", 1.0))
    try:
        name, last = given
    except (TypeError, ValueError):
        raise ValueError(
            f"columns: {quantity!r} = {given!r} is neither a name nor (name, unit or factor)"
        ) from None
    return (str(name), last, 1.0) if isinstance(last, str) else (str(name), None, _scale(quantity, last))


def _scale(quantity: str, value: Any) -> float:
    """A factor to SI."""
    scale = real(f"columns: scale of {quantity!r}", value)
    if not np.isfinite(scale) or scale == 0.0:
        raise ValueError(f"columns: scale of {quantity!r} = {scale:g} is no factor to SI: finite, and not 0")
    return scale


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
        return _opened(path, "an NPZ file of numbers", lambda: _read_npz(path)), None
    if kind == ".parquet":
        pandas = _optional("pandas", path, "parquet")
        try:
            frame = _opened(path, "a Parquet file", lambda: pandas.read_parquet(path))
        except ImportError:
            raise ValueError(f"{path}: Parquet needs pyarrow: pip install 'stillflux[parquet]'") from None
        table = {str(name): frame[name].to_numpy() for name in frame.columns}
        return {**table, **_index(frame, table)}, None
    if kind == ".mat":
        return _opened(path, "a MAT file", lambda: _read_mat(path)), None
    raise ValueError(f"{path}: {kind or 'no suffix'} is not one of .csv, .txt, .tsv, .parquet, .npz, .mat")


def _read_npz(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def _read_mat(path: Path) -> dict[str, Any]:
    """The variables of a MAT file, those of structures as "structure.field"; version 7.3 is HDF5."""
    with path.open("rb") as file:
        newest = b"MATLAB 7.3 MAT-file" in file.read(128)
    if newest:
        with _optional("h5py", path, "mat").File(path, "r") as file:
            return dict(_datasets(file))
    content = _optional("scipy.io", path, "mat").loadmat(path, squeeze_me=True)
    found: dict[str, Any] = {}
    for name, values in content.items():
        fields = values.dtype.names if isinstance(values, np.ndarray) and values.ndim == 0 else None
        if fields:
            found.update({f"{name}.{field}": values[field].item() for field in fields})
        elif not name.startswith("__"):
            found[name] = values
    return found


def _datasets(group: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Arrays of numbers of an HDF5 group and of those below it; complex numbers are pairs there."""
    for name, item in group.items():
        if name.startswith("#"):
            continue
        if not hasattr(item, "dtype"):
            yield from _datasets(item, f"{prefix}{name}.")
        elif item.dtype.names == ("real", "imag"):
            yield prefix + name, item[()]["real"] + 1j * item[()]["imag"]
        else:
            yield prefix + name, item[()]


def _opened(path: Path, kind: str, read: Callable[[], Any]) -> Any:
    """What `read` makes of a file. Raises ValueError with the file's name where it is not of its kind;
    errors of `_optional` pass, and ImportError and what the system says of the file."""
    try:
        return read()
    except (ImportError, _MissingError):
        raise
    except Exception as error:
        # Each reader has errors of its own: zipfile, pickle, pyarrow, scipy, h5py.
        if isinstance(error, OSError) and error.filename is not None:
            raise
        reason = str(error).partition("\n")[0]
        raise ValueError(f"{path} is not {kind} ({type(error).__name__}: {reason})") from None


class _MissingError(ValueError):
    """A package that is not installed."""


def _optional(module: str, path: Path, extra: str) -> Any:
    try:
        return import_module(module)
    except ImportError:
        name = module.partition(".")[0]
        raise _MissingError(f"{path}: this format needs {name}: pip install 'stillflux[{extra}]'") from None


def _read_text(path: Path) -> tuple[dict[str, Any], NDArray[np.int64]]:
    """Delimiter by the first row of numbers, decimal comma by all rows. The header is the line before the
    first row of numbers, between which a row of units may stand, both also where they begin with #; other
    lines before it and comments are passed over. An empty cell is NaN."""
    content = io.StringIO(_decoded(path.read_bytes()), newline="")
    lines = [(number, line.rstrip("\r\n")) for number, line in enumerate(content, 1) if line.strip()]
    if not lines:
        raise ValueError(f"{path} is empty")
    at, delimiter = _header_line(lines)
    first, header_line = lines[at]
    header = [name.strip() for name in _cells(header_line.lstrip("# \t"), delimiter)]
    if all(_number(cell) is not None for cell in header):
        raise ValueError(f"{path}, line {first}: no header, a line with the names of the columns")
    if len(set(header)) < len(header):
        raise ValueError(f"{path}, line {first}: a column's name stands twice in {', '.join(header)}")
    begin = at + 1
    if begin < len(lines):
        units = _units_of(_cells(lines[begin][1].lstrip("# \t"), delimiter))
        if len(units) == len(header):
            header = _with_units(f"{path}, line {lines[begin][0]}", header, units)
            begin += 1
    body = [(number, line) for number, line in lines[begin:] if not line.lstrip().startswith("#")]
    # The rows before the bridge switches may be whole numbers, without any decimal comma. Beside points a
    # comma that comes later is none.
    early = body if not any("." in line for _, line in body) else body[:5]
    comma = delimiter != "," and any("," in line for _, line in early)
    rows = np.empty((len(body), len(header)))
    for k, (number, line) in enumerate(body):
        cells = _values(line, delimiter, comma)
        if len(cells) != len(header):
            hint = ""
            if delimiter == "," and len(cells) > len(header):
                hint = "; numbers with a decimal comma need another delimiter, such as ;, or quotation marks"
            raise ValueError(
                f"{path}, line {number}: {len(cells)} values, the header has {len(header)}{hint}"
            )
        try:
            rows[k] = [float(cell) if cell.strip() else np.nan for cell in cells]
        except ValueError:
            bad = next(j for j, cell in enumerate(cells) if cell.strip() and _number(cell) is None)
            raise ValueError(
                f"{path}, line {number}, column {header[bad]!r}: {cells[bad]!r} is not a number"
            ) from None
    table = {name: rows[:, j] for j, name in enumerate(header)}
    return table, np.array([number for number, _ in body], dtype=np.int64)


def _header_line(lines: Sequence[tuple[int, str]]) -> tuple[int, str | None]:
    """Place of the header among the lines, and the delimiter; None: white space."""
    plain = next((k for k, (_, line) in enumerate(lines) if not line.lstrip().startswith("#")), 0)
    for k, (_, line) in enumerate(lines[:_PREAMBLE]):
        # Of decimal commas there may be more than of delimiters: the one that leaves numbers.
        signs = (sign for sign in _DELIMITERS if sign in line)
        delimiter = next(
            (sign for sign in signs if all(map(_is_value, _cells(line, sign)))), _delimiter(line)
        )
        cells = _cells(line, delimiter)
        if len(cells) < 2 or not all(_is_value(cell) for cell in cells):
            continue
        # The nearest line above with as many cells that has the name of a quantity; where none has one, and
        # `columns` assigns other names, the nearest that is no row of units.
        above = {
            j: names
            for j in range(k - 1, -1, -1)
            if len(names := _cells(lines[j][1].lstrip("# \t"), delimiter)) == len(cells)
            and all(_number(name) is None for name in names)
        }
        known = (j for j, names in above.items() if any(_header(name)[0] in QUANTITIES for name in names))
        other = (j for j, names in above.items() if not _units_of(names))
        at = next(known, next(other, next(iter(above), plain)))
        return at, delimiter if at < k else _delimiter(lines[at][1])
    return plain, _delimiter(lines[plain][1])


def _delimiter(line: str) -> str | None:
    found = max(_DELIMITERS, key=line.count)
    return found if found in line else None


def _cells(line: str, delimiter: str | None) -> list[str]:
    """Cells of a line, without quotation marks."""
    return next(csv.reader([line], delimiter=delimiter), []) if delimiter else line.split()


def _values(line: str, delimiter: str | None, comma: bool) -> list[str]:
    """Cells of a row of numbers, with a decimal point where they have a comma."""
    if delimiter == "," and '"' in line:
        # Within quotation marks a comma is that of a number.
        return [cell.replace(",", ".") for cell in _cells(line, delimiter)]
    # A quoted number is a number; no number has a quotation mark within.
    return (line.replace(",", ".") if comma else line).replace('"', "").split(delimiter)


def _is_value(cell: str) -> bool:
    """Whether a cell is a number, with a point or a comma, or empty."""
    return not cell.strip() or _number(cell.replace(",", ".")) is not None


def _units_of(cells: Sequence[str]) -> list[str]:
    """The units of a row of units; empty if it is none. Half of them are known at least: a log also has
    columns that are no quantities of a replay, as a temperature."""
    units = [re.sub(r"^[\[(]|[\])]$", "", cell.strip()) for cell in cells]
    named = [unit for unit in units if unit and _number(unit) is None]
    return units if named and 2 * sum(unit in _UNITS for unit in named) >= len(named) else []


def _with_units(where: str, header: Sequence[str], units: Sequence[str]) -> list[str]:
    """The names of a header with the units of the row below it. Raises ValueError where they differ from
    those that the header has."""
    names = []
    for name, unit in zip(header, units, strict=True):
        own = _header(name)[1]
        if own and unit and unit != own:
            raise ValueError(f"{where}: the unit of column {name!r} is {unit!r} here")
        names.append(f"{name} [{unit}]" if unit and not own else name)
    return names


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
