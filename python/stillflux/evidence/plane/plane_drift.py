"""The plane, reached by ramps, 1 % offset appears once the drive runs."""

from __future__ import annotations

from stillflux.evidence.points import map_of

TARGETS = (
    map_of(
        "plane-drift",
        1,
        "Plane, reached by ramps, 1 % offset appears once the drive runs",
        "drift",
        own_seeds=True,
    ),
)
