"""Targets of the plane in fixed point (Q7.24), whatever arithmetic the others are run in.

The filter's covariance is resolved to 2⁻²⁴ there, in units of the states' typical deviations: where it needs
smaller correlations, near ω_s = 0 over minutes, `f32` can hold what `Q` cannot.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from stillflux.evidence.plane import crossing, mismatch, persistence_no_load, persistence_shifted, plane_seeds
from stillflux.evidence.target import Case, Target


def _cases(name: str, of: Target, machine: str, scheme: str, arithmetic: str) -> list[Case]:
    del arithmetic
    return [replace(case, target=name) for case in of.build(machine, scheme, "q")]


def _fixed(name: str, order: int, title: str, target: Target) -> Target:
    # The verdict on the confidence is over the runs of the other targets.
    return replace(
        target,
        name=name,
        order=order,
        title=f"{title}, in fixed point",
        build=partial(_cases, name, target),
        verdict="",
    )


TARGETS = (
    _fixed("fixed-point-plane", 70, "Plane, a coarse map", plane_seeds.TARGETS[0]),
    _fixed("fixed-point-crossing", 71, "Reversals under rated torque", crossing.TARGETS[0]),
    _fixed("fixed-point-no-load", 72, "Ten minutes at ω_s = 0 without load", persistence_no_load.TARGETS[0]),
    _fixed("fixed-point-shifted", 73, "Ten minutes, the flux lowered", persistence_shifted.TARGETS[0]),
    _fixed("fixed-point-mismatch", 74, "One parameter wrong", mismatch.TARGETS[0]),
)
