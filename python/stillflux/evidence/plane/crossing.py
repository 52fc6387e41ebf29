"""Crossing zero stator frequency under load."""

from __future__ import annotations

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import AT_SPEED, LOAD_AT, REACHED, START, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import ramp
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Scenario

_AT, _REST = REACHED + 2.0, 3.0
"""The reversal begins at the first, s, and is followed by the second, s."""
_SLOW = 60.0


def scenario(
    machine: str, scheme: str, arithmetic: str = "f32", *, begin: float, torque: float, time: float
) -> Scenario:
    """From `begin` (per unit) to `-begin` within `time` s under a constant load (units of rated torque)."""
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"{begin:g} to {-begin:g} in {time:g} s, T = {torque:g} T_N",
        omega=[*ramp(START, AT_SPEED, begin), (_AT, begin), (_AT + time, -begin)],
        load=ramp(LOAD_AT, REACHED, torque),
        duration=_AT + time + _REST,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    window = {time: (REACHED, _AT + time + _REST) for time in (20.0, _SLOW)}
    return [
        Case(
            "crossing",
            machine,
            scheme,
            f"{begin:g} to {-begin:g} in {time:g} s, T = {torque:g} T_N",
            scenario(machine, scheme, arithmetic, begin=begin, torque=torque, time=time),
            window[time],
            window[time],
            traced=time == _SLOW,
        )
        for time in window
        for begin in (0.1, -0.1)
        for torque in (1.0, -1.0)
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [
        at_most("true torque against commanded", 100 * m.torque_command, 10.0, "% of T_N"),
        at_most("true torque against estimated", 100 * m.torque_estimate, 10.0, "% of T_N"),
    ]


TARGETS = (
    Target(
        "crossing",
        10,
        "Reversals through zero stator frequency under rated torque",
        _cases,
        _claims,
        "confidence",
        "courses",
        ("angle_held", "torque_command", "torque_estimate", "torque_ripple"),
    ),
)
