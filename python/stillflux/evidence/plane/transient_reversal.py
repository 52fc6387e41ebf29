"""Full reversal through zero under half of rated load."""

from __future__ import annotations

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import START, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import ramp
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Scenario

_AT, _WITHIN = START + 6.0, 4.0
_END = _AT + _WITHIN + 3.0


def scenario(
    machine: str, scheme: str, arithmetic: str = "f32", *, begin: float = -1.0, torque: float = 0.5
) -> Scenario:
    """From `begin` through zero to `-begin` within 4 s under a constant load."""
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"{begin:g} to {-begin:g}, T = {torque:g} T_N",
        omega=[*ramp(START, START + 3.0, begin), (_AT, begin), (_AT + _WITHIN, -begin)],
        load=ramp(START + 4.0, START + 5.0, torque),
        record_every=10,
        duration=_END,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [
        Case(
            "transient-reversal",
            machine,
            scheme,
            f"{begin:g} to {-begin:g}, T = {torque:g} T_N",
            scenario(machine, scheme, arithmetic, begin=begin, torque=torque),
            (START + 5.0, _END),
            (_END - 1.0, _END),
            traced=True,
        )
        for begin in (-1.0, 1.0)
        for torque in (0.5, -0.5)
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [
        at_most("field angle error", m.angle_held, 5.0, "°"),
        at_most("speed error at the end", m.speed_settled, 0.003, "pu"),
    ]


TARGETS = (
    Target(
        "transient-reversal",
        42,
        "Full reversal through zero under half of rated load",
        _cases,
        _claims,
        view="courses",
        numbers=("angle_held", "torque_command"),
    ),
)
