"""The plane, loaded at rest before the motor has ever turned, 1 % offset from power-up."""

from __future__ import annotations

from stillflux.evidence.points import map_of

TARGETS = (
    map_of(
        "plane-rest",
        2,
        "Plane, loaded at rest before the motor has ever turned, 1 % offset from power-up",
        "rest",
        speeds=(0.0,),
        own_seeds=False,
    ),
)
