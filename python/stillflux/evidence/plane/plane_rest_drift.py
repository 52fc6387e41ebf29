"""The plane, loaded at rest before the motor has ever turned, 1 % offset appears once the drive runs."""

from __future__ import annotations

from stillflux.evidence.points import map_of

TARGETS = (
    map_of(
        "plane-rest-drift",
        3,
        "Plane, loaded at rest before the motor has ever turned, 1 % offset appears once the drive runs",
        "rest-drift",
        speeds=(0.0,),
        own_seeds=False,
    ),
)
