"""`sweep`: many scenarios, numbers of each, on any executor.

```python
axes = {"plant_motor.R_s": sf.factors(0.9, 1.0, 1.1), "plant_inverter.dead_time": [1.6e-6, 2e-6, 2.4e-6]}
points = sf.grid(base, axes)
found = sf.sweep(points, ["angle_max", "confidence_min"], resume="sweep.jsonl", progress=True)
found.map("plant_motor.R_s", "plant_inverter.dead_time", "angle_max").savefig("map.png")
```

A row belongs to its scenario, its metrics and the build, whatever ran it: the same rows, in the order of the
scenarios, come from the processes of this machine, from a Dask `Client`, from joblib or from Ray.
"""

from __future__ import annotations

import csv
import hashlib
import html
import io
import json
import math
import os
import pickle
import queue
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from stillflux import json_lines
from stillflux import metrics as of_results
from stillflux.build import fingerprint
from stillflux.messages import near
from stillflux.options import DriveSettings, PlantOptions
from stillflux.outputs import write_text
from stillflux.parallel import Pool, ended_early
from stillflux.parameters import instance
from stillflux.parameters import number as real
from stillflux.result import Result
from stillflux.scenario import Scenario, plain
from stillflux.simulation import DivergenceError, check_progress, progress_bar, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

__all__ = [
    "METRICS",
    "Factors",
    "Point",
    "Spread",
    "Sweep",
    "SweepInterrupted",
    "draws",
    "factors",
    "grid",
    "normal",
    "sweep",
    "uniform",
]

Metric: TypeAlias = Callable[[Result], float]
Metrics: TypeAlias = "Mapping[str, Metric] | Sequence[str | Metric]"

METRICS: Mapping[str, Metric] = {
    "angle_max": of_results.worst_angle,
    "angle_rms": of_results.rms_angle,
    "confidence_min": of_results.least_confidence,
    "speed_error_end": of_results.last_speed_error,
    "speed_error_max": of_results.worst_speed_error,
    "speed_swing": of_results.speed_swing,
    "R_s_error_end": of_results.last_resistance_error,
    "fault_time": of_results.fault_time,
}
"""Metrics by name, from the plant's truth: angles in degrees, speeds per unit of rated frequency, resistance
relative, times in s."""

_UNITS: Mapping[str, str] = {
    "angle_max": "°",
    "angle_rms": "°",
    "speed_error_end": "pu",
    "speed_error_max": "pu",
    "speed_swing": "pu",
    "fault_time": "s",
}
_SHOWN = 20  # rows of a table in a notebook
_IN_FLIGHT = 1000  # tasks handed to an executor at a time
_LARGEST_GRID = 1_000_000  # points, an allowance: of a plain scenario 1.3 GB


@dataclass(frozen=True)
class Point:
    """A scenario of a sweep with the parameters that single it out; without a scenario, why there is none."""

    parameters: Mapping[str, Any]
    scenario: Scenario | None
    error: str = ""


@dataclass(frozen=True)
class Factors:
    """Values of a grid relative to the base scenario's."""

    values: tuple[float, ...]


@dataclass(frozen=True)
class Spread:
    """Relative tolerance of a drawn value."""

    kind: str
    """"normal" or "uniform"."""
    width: float
    """Standard deviation, or largest deviation."""


def factors(*values: float) -> Factors:
    """Axis of a grid: the base scenario's value times each."""
    return Factors(tuple(real(f"factors[{k}]", x) for k, x in enumerate(values)))


def normal(deviation: float) -> Spread:
    """Tolerance of `draws`: normal with this relative standard deviation, from 0 to 1."""
    return Spread("normal", _part_of_one("deviation", deviation))


def uniform(most: float) -> Spread:
    """Tolerance of `draws`: uniform within ± this relative deviation, from 0 to 1."""
    return Spread("uniform", _part_of_one("most", most))


def _part_of_one(name: str, value: float) -> float:
    part = real(name, value)
    if not 0.0 <= part <= 1.0:
        raise ValueError(
            f"{name} = {part:g} is outside the admissible range 0 to 1: it is relative, no percent"
        )
    return part


def grid(base: Scenario, axes: Mapping[str, Sequence[Any] | Factors]) -> list[Point]:
    """Every combination of values of fields of a scenario; the last axis changes first.

    A field is that of a scenario ("load_torque", "arithmetic") or of a part ("plant_motor.R_s",
    "settings.psi_ref", "plant.current_offset"). A number in place of a profile holds from t = 0 on: a load
    turns the machine before the drive has started. A combination that no scenario admits is a point with the
    error. Raises ValueError for a field that there is not, an axis without values and more than a million
    points, TypeError for an axis that is no list.
    """
    instance("base", base, Scenario)
    if not isinstance(axes, Mapping):
        raise TypeError(f"axes = {axes!r} is not a mapping of fields to values")
    values = [_values(base, name, axis) for name, axis in axes.items()]
    number = math.prod(map(len, values))
    if number > _LARGEST_GRID:
        raise ValueError(
            f"axes = {tuple(axes)} have {number} combinations: at most {_LARGEST_GRID} are a grid"
        )
    return [_point(base, dict(zip(axes, chosen, strict=True))) for chosen in product(*values)]


def _values(base: Scenario, name: str, axis: Sequence[Any] | Factors) -> list[Any]:
    _known(base, name)
    if isinstance(axis, Factors):
        values = [_number(base, name) * x for x in axis.values]
    elif isinstance(axis, str | bytes | Mapping) or not isinstance(axis, Iterable):
        raise TypeError(f"{name} = {axis!r} is neither a list of values nor factors(…)")
    else:
        values = [x.item() if isinstance(x, np.generic) else x for x in axis]
    if not values:
        raise ValueError(f"{name} = {axis!r} has no value: the grid would have no point")
    return values


_OPTIONS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "settings": ("the drive has no setting", DriveSettings.__annotations__),
    "plant": ("the plant has no option", PlantOptions.__annotations__),
}


def _known(base: Scenario, name: str) -> None:
    """Raises ValueError for what is no field of a scenario, a motor or an inverter, no setting of a drive and
    no option of a plant."""
    part, dot, field_name = name.partition(".") if isinstance(name, str) else (name, "", "")
    if dot and part in _OPTIONS:
        text, known = _OPTIONS[part]
        if field_name not in known:
            raise ValueError(f"{name}: {text} {field_name!r}{near(field_name, known)}")
    elif not dot or part != "memory":
        base.value(name)


def _number(base: Scenario, name: str) -> Any:
    value = base.value(name)
    if isinstance(value, bool) or not isinstance(value, int | float | complex):
        raise TypeError(f"{name} = {value!r} is not a number: give a list of values instead of factors")
    return value


def draws(base: Scenario, number: int, tolerances: Mapping[str, Spread], seed: int = 0) -> list[Point]:
    """`number` scenarios with fields drawn at random around the base scenario's, each draw on its own stream
    of random numbers: the first ten of a hundred draws are those of ten. The noise of the sensors has the
    draw's seed. Raises ValueError for a field that there is not, TypeError for a tolerance that is none."""
    instance("base", base, Scenario)
    number, seed = _whole("number", number, 1), _whole("seed", seed, 0)
    if not isinstance(tolerances, Mapping):
        raise TypeError(f"tolerances = {tolerances!r} is not a mapping of fields to tolerances")
    middle = {}
    for name, spread in tolerances.items():
        if not isinstance(spread, Spread):
            raise TypeError(f"{name}: {spread!r} is neither normal(…) nor uniform(…)")
        middle[name] = _number(base, name)
    points = []
    for k in range(number):
        random = np.random.default_rng([seed, k])
        parameters: dict[str, Any] = {}
        for name, spread in tolerances.items():
            of_kind = {"normal": random.standard_normal, "uniform": lambda r=random: r.uniform(-1.0, 1.0)}
            parameters[name] = middle[name] * (1.0 + spread.width * float(of_kind[spread.kind]()))
        parameters["plant.seed"] = int(random.integers(1 << 31))
        points.append(_point(base, parameters))
    return points


def _whole(name: str, value: Any, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} = {value!r} is not a whole number from {least} on")
    return int(value)


def _point(base: Scenario, parameters: dict[str, Any]) -> Point:
    try:
        return Point(parameters, base.with_values(parameters))
    except (ValueError, TypeError) as error:
        return Point(parameters, None, f"{type(error).__name__}: {error}")


@dataclass(frozen=True, eq=False)
class Sweep:
    """Rows of a sweep, in the order of its scenarios. `found["angle_max"]` is an array, of objects where a
    parameter is a profile or a tuple."""

    rows: Sequence[Mapping[str, Any]]
    """By column: the parameters, `status` of the drive at the end, the metrics, `error` (empty if there was
    none; metrics are NaN otherwise)."""
    parameters: tuple[str, ...] = field(default=())
    metrics: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self.rows)

    def __getitem__(self, column: str) -> NDArray[Any]:
        if column not in self.columns:
            raise KeyError(f"{column!r} is no column; there are {', '.join(self.columns)}")
        values = [row.get(column) for row in self.rows]
        for kind in (str, int | float | complex):
            if all(isinstance(x, kind) for x in values):
                return np.array(values)
        # Profiles, tuples and what is of several kinds stay what they are, an object a row.
        objects = np.empty(len(values), object)
        for k, value in enumerate(values):
            objects[k] = value
        return objects

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return (*self.parameters, "status", *self.metrics, "error")

    @property
    def units(self) -> dict[str, str]:
        """Units of the metrics that have a known one."""
        return {name: _UNITS[name] for name in self.metrics if name in _UNITS}

    @property
    def failed(self) -> list[Mapping[str, Any]]:
        """Rows with an error: no scenario, no result, or no metric."""
        return [row for row in self.rows if row["error"]]

    def to_pandas(self) -> Any:
        """A pandas frame, one row a scenario."""
        from stillflux.frames import needed

        return needed("pandas", "pandas").DataFrame(list(self.rows), columns=list(self.columns))

    def to_csv(self) -> str:
        """As CSV text: the same bytes whatever executor ran the sweep."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([_cell(row.get(name)) for name in self.columns] for row in self.rows)
        return text.getvalue()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes `to_csv()`, whole or not at all."""
        write_text(Path(path), self.to_csv())

    def map(self, x: str, y: str, metric: str) -> Figure:
        """A metric over two parameters; a cell with several rows shows the largest value, one that failed or
        faulted is crossed out."""
        from stillflux.plots import sweep_map

        return sweep_map(self, x, y, metric)

    def spread(self, *metrics: str) -> Figure:
        """Distribution of metrics over all rows: the part of the rows up to each value. Raises ValueError for
        what is no metric."""
        from stillflux.plots import sweep_spread

        for name in metrics:
            if name not in self.metrics:
                raise ValueError(f"metrics: {name!r} is not one of {', '.join(self.metrics) or 'none'}")
        if not self.metrics:
            raise ValueError("metrics: this sweep has none")
        return sweep_spread(self, metrics or self.metrics)

    def summary(self) -> str:
        """A few lines: rows, faults, errors, range of each metric."""
        faults = sum(str(row["status"]).startswith("fault") for row in self.rows)
        lines = [f"{len(self)} rows, {faults} ended with a fault, {len(self.failed)} failed"]
        for name in self.metrics:
            values = self[name].astype(float)
            values = values[np.isfinite(values)]
            if len(values):
                median = np.median(values)
                lines.append(f"{name}: {values.min():.4g} … {values.max():.4g}, median {median:.4g}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<Sweep of {len(self)} rows: {', '.join(self.columns)}>"

    def _repr_html_(self) -> str:
        def line(cells: Iterable[Any], tag: str) -> str:
            return "<tr>" + "".join(f"<{tag}>{html.escape(_shown(x))}</{tag}>" for x in cells) + "</tr>"

        rows = "".join(line((row.get(name) for name in self.columns), "td") for row in self.rows[:_SHOWN])
        more = f"<p>… {len(self) - _SHOWN} more</p>" if len(self) > _SHOWN else ""
        return f"<table>{line(self.columns, 'th')}{rows}</table>{more}"


class SweepInterrupted(KeyboardInterrupt):
    """Ended by Ctrl-C; `result` has the rows that were done."""

    def __init__(self, result: Sweep, total: int) -> None:
        super().__init__(f"interrupted after {len(result)} of {total} scenarios")
        self.result, self._total = result, total

    def __reduce__(self) -> tuple[type[SweepInterrupted], tuple[Sweep, int]]:
        return SweepInterrupted, (self.result, self._total)


def sweep(
    scenarios: Iterable[Scenario | Point] | Mapping[str, Scenario],
    metrics: Metrics = ("angle_max", "confidence_min", "speed_error_end"),
    executor: Any = None,
    resume: str | os.PathLike[str] | None = None,
    *,
    progress: Callable[[int, int, Mapping[str, Any]], object] | bool | None = None,
) -> Sweep:
    """Runs scenarios and keeps numbers of each.

    Parameters
    ----------
    scenarios
        Scenarios, a mapping of names to scenarios, or points of `grid` or `draws`.
    metrics
        Names of `METRICS`, functions of a `Result`, or a mapping of names to functions. A function has to be
        importable by the workers (Dask and joblib also send others).
    executor
        What has `submit(function, *arguments)` and gives futures with `add_done_callback` and `result`: a
        `concurrent.futures` pool, a Dask `Client`, `stillflux.executors.joblib()` or `.Ray()`. "serial":
        here, one after the other. None: processes, one for each processor.
    resume
        A file that gets each row as soon as it is done. Rows that it already has, of the same scenario,
        metrics and build, are not run again: a sweep that was killed goes on where it was. A function is told
        by its code, its defaults and what it holds, not by other functions of yours that it calls.
    progress
        True: a bar on stderr. A function gets the number done, the number of all, and the latest row.

    A scenario or a metric that raises an error is a row with the error, and so is a task that a cluster's
    worker took along when it ended. Raises `SweepInterrupted` on Ctrl-C, ValueError for an unknown metric or
    none at all, one that cannot be sent to another process, and with `resume` one that cannot be told from
    others, FileNotFoundError where there is no folder for `resume`. In a script call it below
    `if __name__ == "__main__":`, as everything that starts processes.
    """
    chosen = named_metrics(metrics)
    check_progress(progress)
    points = _points(scenarios)
    names = tuple(dict.fromkeys(name for point in points for name in point.parameters))
    clash = set(names) & {"status", "error", *chosen}
    if clash:
        raise ValueError(f"scenarios: a parameter has the name of a column, {', '.join(sorted(clash))}")
    journal = _Journal(resume) if resume is not None else None
    build = _build(chosen) if journal is not None else b""
    keys = [_key(point, build) for point in points]
    outcomes: dict[int, Mapping[str, Any]] = {}
    todo = []
    for k, (point, key) in enumerate(zip(points, keys, strict=True)):
        if point.scenario is None:
            outcomes[k] = {"status": "", "error": point.error}
        elif journal is not None and key in journal.rows:
            outcomes[k] = journal.rows[key]
        else:
            todo.append(k)
    bar = progress_bar("sweep") if progress is True else None

    def rows() -> list[dict[str, Any]]:
        return [_row(points[k], outcomes[k], chosen) for k in sorted(outcomes)]

    def done(k: int, outcome: Mapping[str, Any], ran: bool) -> None:
        outcomes[k] = outcome
        # A task that its worker took along is tried again when the sweep goes on.
        if journal is not None and ran:
            journal.add(keys[k], outcome)
        if bar is not None:
            bar(len(outcomes) / len(points))
        elif callable(progress):
            progress(len(outcomes), len(points), _row(points[k], outcome, chosen))

    try:
        _execute([(k, points[k].scenario) for k in todo], chosen, executor, done)
    except KeyboardInterrupt:
        raise SweepInterrupted(Sweep(rows(), names, tuple(chosen)), len(points)) from None
    return Sweep(rows(), names, tuple(chosen))


def named_metrics(metrics: Metrics) -> dict[str, Metric]:
    """Functions by name. Raises ValueError for a name that is none of `METRICS`, or not one of its own, and
    where there is none."""
    chosen: dict[str, Metric] = {}
    if isinstance(metrics, str):
        raise TypeError(f"metrics = {metrics!r}: give a list of names, [{metrics!r}]")
    if not isinstance(metrics, Iterable):
        raise TypeError(f"metrics = {metrics!r} is not a list of names and functions")
    named = metrics.items() if isinstance(metrics, Mapping) else ((None, metric) for metric in metrics)
    for name, metric in named:
        if name is not None and not isinstance(name, str):
            raise TypeError(f"metrics: {name!r} is not a name")
        if not callable(metric):
            if not isinstance(metric, str) or metric not in METRICS:
                raise ValueError(f"metrics: {metric!r} is not one of {', '.join(METRICS)}, nor a function")
            name, metric = name or metric, METRICS[metric]
        elif name is None:
            name = getattr(metric, "__name__", None)
            if name is None:
                raise ValueError(f"metrics: {metric!r} has no name: give a mapping of names to functions")
        if name in chosen or name in ("status", "error"):
            why = "is there twice" if name in chosen else "is a column of every sweep"
            raise ValueError(f"metrics: {name!r} {why}: give a mapping of other names to functions")
        chosen[name] = metric
    if not chosen:
        raise ValueError(f"metrics = {metrics!r} has no metric: the sweep would keep nothing of a run")
    return chosen


def _points(scenarios: Iterable[Any] | Mapping[str, Scenario]) -> list[Point]:
    if isinstance(scenarios, Scenario):
        scenarios = [scenarios]
    if isinstance(scenarios, Mapping):
        for name, scenario in scenarios.items():
            if not isinstance(scenario, Scenario):
                raise TypeError(f"scenarios[{name!r}] = {scenario!r} is not a Scenario")
        return [Point({"name": name}, scenario) for name, scenario in scenarios.items()]
    if not isinstance(scenarios, Iterable):
        raise TypeError(f"scenarios = {scenarios!r} are no scenarios, nor points of a grid")
    points = []
    for k, item in enumerate(scenarios):
        if not isinstance(item, Point | Scenario):
            raise TypeError(f"scenarios[{k}] = {item!r} is neither a Scenario nor a point of a grid")
        points.append(item if isinstance(item, Point) else Point({"scenario": item.name or k}, item))
    return points


def _key(point: Point, build: bytes) -> str:
    """Of a scenario, and of what `_build` makes of metrics and build."""
    digest = hashlib.sha256(build)
    if point.scenario is not None:
        digest.update(json.dumps(point.scenario.to_dict(), sort_keys=True).encode())
    return digest.hexdigest()


def _build(metrics: Mapping[str, Metric]) -> bytes:
    """Of the metrics and the build, the same in every process. Raises ValueError for a metric of which that
    cannot be said."""
    told = [fingerprint()]
    for name, metric in metrics.items():
        try:
            told.append(repr((name, _told(metric, ()))))
        except Exception:
            raise ValueError(
                f"metrics: {name!r} cannot be told from others when the sweep goes on: define it in a "
                "module, or leave out resume"
            ) from None
    return "\n".join(told).encode()


def _told(x: Any, within: tuple[int, ...]) -> Any:
    """What decides what a function gives, in plain values without addresses or an order by chance."""
    if id(x) in within:
        return "itself"
    inner = (*within, id(x))

    def each(values: Iterable[Any]) -> list[Any]:
        return [_told(value, inner) for value in values]

    if x is None or x is ... or isinstance(x, bool | int | float | complex | str | bytes):
        return x
    if isinstance(x, tuple | list):
        return [type(x).__name__, each(x)]
    if isinstance(x, set | frozenset):
        return ["set", sorted(map(repr, each(x)))]
    if isinstance(x, Mapping):
        return ["mapping", sorted(repr(pair) for pair in each(x.items()))]
    if isinstance(x, CodeType):
        return ["code", x.co_code, x.co_names, each(x.co_consts)]
    if isinstance(x, FunctionType):
        held = [cell.cell_contents for cell in x.__closure__ or ()]
        return [x.__module__, x.__qualname__, *each((x.__code__, x.__defaults__, x.__kwdefaults__, held))]
    if isinstance(x, MethodType):
        return ["method", *each((x.__func__, x.__self__))]
    if isinstance(x, partial):
        return ["partial", *each((x.func, x.args, x.keywords))]
    if isinstance(x, ModuleType):
        return ["module", x.__name__]
    return [type(x).__qualname__, pickle.dumps(x)]


def run_task(scenario: Scenario, metrics: Mapping[str, Metric]) -> dict[str, Any]:
    """One scenario, in a worker: status, metrics and error."""
    try:
        result = simulate(scenario)
    except Exception as error:
        status = str(error.result.status) if isinstance(error, DivergenceError) else ""
        return {"status": status, "error": f"{type(error).__name__}: {error}"}
    row: dict[str, Any] = {"status": str(result.status), "error": ""}
    for name, metric in metrics.items():
        try:
            row[name] = float(metric(result))
        except Exception as error:
            row["error"] = f"{name}: {type(error).__name__}: {error}"
    return row


def _row(point: Point, outcome: Mapping[str, Any], metrics: Mapping[str, Metric]) -> dict[str, Any]:
    measured = {name: outcome.get(name, math.nan) for name in metrics}
    return {**point.parameters, "status": outcome["status"], **measured, "error": outcome["error"]}


def _execute(
    tasks: Sequence[tuple[int, Any]],
    metrics: Mapping[str, Metric],
    executor: Any,
    done: Callable[[int, Mapping[str, Any], bool], None],
) -> None:
    """Runs tasks and hands on each outcome as it comes, in this thread."""
    if not tasks:
        return
    if executor == "serial":
        for k, scenario in tasks:
            done(k, run_task(scenario, metrics), True)
        return
    own = None
    if executor is None:
        _check_sendable(metrics)
        own = executor = Pool(len(tasks))
    elif not hasattr(executor, "submit"):
        raise TypeError(f"executor = {executor!r} has no submit()")
    finished: queue.Queue[int] = queue.Queue()
    futures: dict[int, Any] = {}
    waiting = iter(tasks)

    def submit() -> None:
        task = next(waiting, None)
        if task is not None:
            k, scenario = task
            futures[k] = executor.submit(run_task, scenario, metrics)
            futures[k].add_done_callback(lambda _, k=k: finished.put(k))

    ended = 0
    try:
        for _ in range(min(_IN_FLIGHT, len(tasks))):
            submit()
        while futures:
            k = finished.get()
            try:
                outcome, ran = futures.pop(k).result(), True
            except BrokenProcessPool:
                raise
            except Exception as error:
                outcome, ran = {"status": "", "error": f"worker: {type(error).__name__}: {error}"}, False
            done(k, outcome, ran)
            ended += 1
            submit()
    except BrokenProcessPool:
        raise ended_early(
            "sweep", ended > 0, "with resume=FILE the sweep goes on where it was", 'give executor="serial"'
        ) from None
    except BaseException:
        for future in futures.values():
            future.cancel()
        raise
    finally:
        if own is not None:
            own.shutdown(cancel_futures=True)


def _check_sendable(metrics: Mapping[str, Metric]) -> None:
    for name, metric in metrics.items():
        try:
            pickle.dumps(metric)
        except Exception:
            raise ValueError(
                f"metrics: {name!r} cannot be sent to another process: define it in a module, or give "
                f'executor="serial" or stillflux.executors.joblib()'
            ) from None


class _Journal:
    """Rows by key, one line of JSON each; a last line that was cut off counts for nothing."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        text, values = json_lines.read(self._path)
        self.rows: dict[str, Mapping[str, Any]] = {value[0]: value[1] for value in values if _is_row(value)}
        cut_off = text.startswith(b'["') and b"\n" not in text
        if text and not self.rows and not cut_off:
            raise ValueError(f"resume = {path} holds no rows of a sweep")
        json_lines.begin(self._path)

    def add(self, key: str, row: Mapping[str, Any]) -> None:
        """On the disk before the next one is waited for."""
        self.rows[key] = row
        json_lines.append(self._path, [key, row])


def _is_row(value: Any) -> bool:
    """Whether a line of a file of rows is one."""
    if not (isinstance(value, list) and len(value) == 2 and isinstance(value[0], str)):
        return False
    return isinstance(value[1], dict) and "status" in value[1] and "error" in value[1]


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _cell(value: Any) -> Any:
    value = plain(value)
    return json.dumps(value) if isinstance(value, list | dict | tuple) else value
