"""Signals as pandas frames and xarray data sets, with units."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["needed", "to_pandas", "to_xarray", "write_parquet"]


def needed(module: str, extra: str) -> Any:
    """An optional package. Raises ImportError that says how to install it."""
    try:
        return import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise ImportError(f"this needs {package}: pip install 'stillflux[{extra}]'") from None


def to_pandas(t: NDArray[Any], signals: Mapping[str, NDArray[Any]], units: Mapping[str, str]) -> Any:
    """A frame over the time "t" in s. Space vectors are two real columns, `psi_s.re` and `psi_s.im`, so that
    every file format takes them; `frame.attrs["units"]` has the units."""
    pandas = needed("pandas", "pandas")
    columns, labels = _real(signals, units)
    frame = pandas.DataFrame(columns, index=pandas.Index(t, name="t"))
    frame.attrs["units"] = {"t": "s", **labels}
    return frame


def to_xarray(
    t: NDArray[Any],
    signals: Mapping[str, NDArray[Any]],
    units: Mapping[str, str],
    attributes: Mapping[str, str],
) -> Any:
    """A data set over the coordinate "t"; each variable has its unit as attribute `units`. Space vectors are
    two real variables, `psi_s.re` and `psi_s.im`: NetCDF has no complex numbers."""
    xarray = needed("xarray", "xarray")
    columns, labels = _real(signals, units)
    variables = {name: ("t", values, {"units": labels[name]}) for name, values in columns.items()}
    return xarray.Dataset(variables, coords={"t": ("t", t, {"units": "s"})}, attrs=dict(attributes))


def write_parquet(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Writes columns as Parquet."""
    pandas = needed("pandas", "parquet")
    needed("pyarrow", "parquet")
    pandas.DataFrame(dict(columns)).to_parquet(path)


def _real(
    signals: Mapping[str, NDArray[Any]], units: Mapping[str, str]
) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    columns: dict[str, NDArray[Any]] = {}
    labels: dict[str, str] = {}
    for name, values in signals.items():
        parts = (
            {f"{name}.re": values.real, f"{name}.im": values.imag}
            if np.iscomplexobj(values)
            else {name: values}
        )
        columns.update(parts)
        labels.update(dict.fromkeys(parts, units.get(name, "")))
    return columns, labels
