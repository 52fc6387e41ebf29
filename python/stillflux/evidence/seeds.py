"""Seeds of the plant's noise.

One realisation of the noise proves little where the closed loop is chaotic, and there it is wherever a phase
current stands near zero. So every closed-loop claim is judged under each of `SEEDS` and the worst counts. A
figure of the paper is judged under `REALISATIONS`: each of these seeds with each of four directions of the
sensors' offset, which the paper does not give and on which the sign of a transient may depend. On a map,
where there are hundreds of points, each point has a seed of its own (`seed_of`) and the scheme is judged by
the whole map.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

from stillflux.scenario import Scenario

__all__ = ["BESIDE", "DIRECTIONS", "REALISATIONS", "SEEDS", "realised", "seed_of", "seeded"]

SEEDS = (0, 1, 2, 3, 4)
"""Those of every claim about a single experiment."""
DIRECTIONS = 4
"""Directions of the offset, 90° apart."""
REALISATIONS = tuple(range(DIRECTIONS * len(SEEDS)))
"""Realisation k: noise seed k mod 5, offset turned by 90° times k div 5. The first are `SEEDS`."""
BESIDE = (0, 6, 12, 18, 4)
"""Those under which another scheme is put beside the published one: each seed once, every direction."""


def seed_of(*what: object) -> int:
    """A seed that follows from what it is for, the same on every machine and in every process."""
    return zlib.crc32(repr(what).encode("utf-8"))


def seeded(runs: Sequence[Any], seed: int) -> tuple[Any, ...]:
    """Scenarios under a seed, one that follows another under its own; what is no scenario has no noise."""
    return tuple(
        run.replace(plant={**run.plant, "seed": seed + k * len(SEEDS)}) if isinstance(run, Scenario) else run
        for k, run in enumerate(runs)
    )


def realised(runs: Sequence[Any], realisation: int) -> tuple[Any, ...]:
    """Scenarios under a realisation; what is no scenario has neither noise nor offset."""
    turned, seed = divmod(realisation, len(SEEDS))
    return tuple(_turned(run, turned) if isinstance(run, Scenario) else run for run in seeded(runs, seed))


def _turned(run: Scenario, quarters: int) -> Scenario:
    """With the offset of the current sensors turned by so many quarters, from power-up or a later time on."""
    offset = run.plant.get("current_offset", 0j)
    if not isinstance(offset, complex):
        return run
    by = (1, 1j, -1, -1j)[quarters]
    changes = [
        (
            t,
            {**change, "current_offset": change["current_offset"] * by}
            if "current_offset" in change
            else change,
        )
        for t, change in run.changes
    ]
    return run.replace(plant={**run.plant, "current_offset": offset * by}, changes=changes)
