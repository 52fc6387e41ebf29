"""Rated load exactly at zero stator frequency, the flux kept."""

from __future__ import annotations

from stillflux.evidence.conditions import REACHED, line_speed
from stillflux.evidence.machines import motor_of
from stillflux.evidence.points import plane, stay, stay_claims
from stillflux.evidence.target import Case, Target
from stillflux.scenario import Scenario


def scenario(
    machine: str, scheme: str, arithmetic: str = "f32", *, torque: float = 1.0, time: float = 120.0
) -> Scenario:
    """Load `torque` (units of rated torque) exactly at ω_s = 0 from `REACHED` on, for `time` s.

    The flux stays rated: the drive is not allowed to leave the line.
    """
    omega = line_speed(motor_of(machine), torque)
    run = plane(machine, scheme, arithmetic, omega=omega, torque=torque, hold=time)
    # The published scheme has no flux shift.
    return run.with_settings(omega_s_min=0.0) if scheme == "enhanced" else run


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    runs = [(scenario(machine, scheme, arithmetic, torque=torque), torque) for torque in (1.0, -1.0)]
    return [
        stay("persistence-rated", run, (machine, scheme), torque, (REACHED, run.duration))
        for run, torque in runs
    ]


TARGETS = (
    Target(
        "persistence-rated",
        21,
        "Rated load exactly at zero stator frequency, up to two minutes",
        _cases,
        stay_claims,
        "confidence",
        "courses",
        ("angle_held", "angle_passed", "omega_s", "torque_ripple"),
    ),
)
