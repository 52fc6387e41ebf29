"""Sweep files: a sweep as TOML, for `stillflux sweep FILE.toml`.

```toml
metrics = ["angle_max", "confidence_min"]

[scenario]                            # fields of stillflux.Scenario
motor = "2.2kW"                       # a preset, a motor file (relative to this one), or a table
duration = 3.0
omega_ref = [[0.0, 0.0], [1.8, 0.0], [2.3, 15.0]]

[grid]                                # every combination of these values …
"plant_inverter.dead_time" = [1.6e-6, 2.0e-6, 2.4e-6]
"plant_motor.R_s" = { factors = [0.9, 1.0, 1.1] }

[draws]                               # … or scenarios drawn at random
number = 20
seed = 1
"plant_motor.R_s" = { normal = 0.07 }
"plant_motor.L_M" = { uniform = 0.1 }

[plot]                                # optional, for --plot; without it the distribution of the metrics
x = "plant_motor.R_s"
y = "plant_inverter.dead_time"
metric = "angle_max"
```
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stillflux.scenario import Scenario, rich
from stillflux.sweep import Factors, Point, draws, factors, grid, named_metrics, normal, uniform

__all__ = ["SweepFile", "parse"]


@dataclass(frozen=True)
class SweepFile:
    """What a sweep file asks for."""

    points: Sequence[Point]
    metrics: Sequence[str]
    plot: Mapping[str, str] | None


def parse(data: Mapping[str, Any]) -> SweepFile:
    """A sweep of the tables of a file. Raises ValueError naming what is wrong."""
    for key in data:
        if key not in ("scenario", "grid", "draws", "metrics", "plot"):
            raise ValueError(
                f"{key} is not known in a sweep file; there are scenario, grid, draws, metrics, plot"
            )
    if "scenario" not in data or ("grid" in data) == ("draws" in data):
        raise ValueError("a sweep file has [scenario] and one of [grid] and [draws]")
    for key in ("grid", "draws", "plot"):
        if key in data and not isinstance(data[key], Mapping):
            raise ValueError(f"{key} = {data[key]!r} is not a table: write [{key}] and its fields below it")
    base = Scenario.from_dict(data["scenario"])
    plot = data.get("plot")
    if plot is not None and set(plot) != {"x", "y", "metric"}:
        raise ValueError(f"[plot] has x, y and metric, not {', '.join(plot) or 'nothing'}")
    metrics = data.get("metrics", ("angle_max", "confidence_min", "speed_error_end"))
    if isinstance(metrics, str) or not isinstance(metrics, Sequence) or not metrics:
        raise ValueError(f"metrics = {metrics!r} is not a list of names")
    named_metrics(metrics)
    if plot is not None:
        axes = [name for name in data.get("grid", data.get("draws", {})) if name not in ("number", "seed")]
        for key, known in (("x", axes), ("y", axes), ("metric", metrics)):
            if plot[key] not in known:
                raise ValueError(f"[plot] {key} = {plot[key]!r} is not one of {', '.join(map(str, known))}")
    if "grid" in data:
        return SweepFile(
            grid(base, {name: _axis(name, x) for name, x in data["grid"].items()}), metrics, plot
        )
    table = dict(data["draws"])
    number, seed = table.pop("number", None), table.pop("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise ValueError(f"[draws] seed = {seed!r} is not a whole number from 0 on")
    if not isinstance(number, int) or not 1 <= number <= 1_000_000:
        raise ValueError(f"[draws] number = {number} is outside 1 … 1000000")
    tolerances = {name: _tolerance(name, x) for name, x in table.items()}
    return SweepFile(draws(base, number, tolerances, seed), metrics, plot)


def _axis(name: str, x: Any) -> Sequence[Any] | Factors:
    if isinstance(x, dict) and set(x) == {"factors"} and isinstance(x["factors"], list) and x["factors"]:
        return factors(*x["factors"])
    if not isinstance(x, list) or not x:
        raise ValueError(f"[grid] {name} = {x!r} is neither a list of values nor {{ factors = […] }}")
    return [rich(value, name.rpartition(".")[2]) for value in x]


def _tolerance(name: str, x: Any) -> Any:
    kinds = {"normal": normal, "uniform": uniform}
    if not isinstance(x, dict) or len(x) != 1 or not set(x) <= set(kinds):
        raise ValueError(f"[draws] {name} = {x!r} is neither {{ normal = … }} nor {{ uniform = … }}")
    ((kind, width),) = x.items()
    if isinstance(width, bool) or not isinstance(width, int | float) or not 0.0 <= width <= 1.0:
        raise ValueError(f"[draws] {name}: {kind} = {width} is outside 0 … 1")
    return kinds[kind](width)
