"""The plane, reached by ramps, 1 % offset from power-up."""

from __future__ import annotations

from stillflux.evidence.points import map_of

TARGETS = (
    map_of("plane-ramps", 0, "Plane, reached by ramps, 1 % offset from power-up", "ramps", own_seeds=True),
)
