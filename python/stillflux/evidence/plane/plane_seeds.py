"""A coarse map of the plane, every point under every seed: how far the full maps depend on the noise."""

from __future__ import annotations

from stillflux.evidence.points import map_of

TARGETS = (
    map_of(
        "plane-seeds",
        4,
        "Plane, a coarse map under five realisations of the noise",
        "ramps",
        speeds=(-0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1),
        torques=(-1.0, 0.0, 1.0),
        own_seeds=False,
    ),
)
