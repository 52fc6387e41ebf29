"""Seeds of the plant's noise.

One realisation of the noise proves little where the closed loop is chaotic, and there it is wherever a phase
current stands near zero. So every closed-loop claim is judged under each of `SEEDS` and the worst counts. On
a map, where there are hundreds of points, each point has a seed of its own (`seed_of`) and the scheme is
judged by the whole map.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

from stillflux.scenario import Scenario

__all__ = ["SEEDS", "seed_of", "seeded"]

SEEDS = (0, 1, 2, 3, 4)
"""Those of every claim about a single experiment."""


def seed_of(*what: object) -> int:
    """A seed that follows from what it is for, the same on every machine and in every process."""
    return zlib.crc32(repr(what).encode("utf-8"))


def seeded(runs: Sequence[Any], seed: int) -> tuple[Any, ...]:
    """Scenarios under a seed, one that follows another under its own; what is no scenario has no noise."""
    return tuple(
        run.replace(plant={**run.plant, "seed": seed + k * len(SEEDS)}) if isinstance(run, Scenario) else run
        for k, run in enumerate(runs)
    )
