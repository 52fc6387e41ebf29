"""Load steps of 120 % at zero speed."""

from __future__ import annotations

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import START, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import step
from stillflux.evidence.target import Case, Target
from stillflux.metrics import settled_after
from stillflux.result import Result
from stillflux.scenario import Scenario

_ON, _OFF = START + 2.0, START + 6.0
_BAND = 0.002


def scenario(machine: str, scheme: str, arithmetic: str = "f32", *, torque: float = 1.2) -> Scenario:
    """Zero speed; the load comes and goes."""
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"load step of {torque:g} T_N at rest",
        load=[*step(_ON, torque), (_OFF, torque), (_OFF, 0.0)],
        record_every=10,
        duration=_OFF + 3.0,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    window = (_ON, _OFF + 3.0)
    return [
        Case(
            "transient-load",
            machine,
            scheme,
            f"{100 * torque:+.0f} %",
            scenario(machine, scheme, arithmetic, torque=torque),
            window,
            window,
        )
        for torque in (1.2, -1.2)
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case
    on = settled_after(result.window(0.0, _OFF - 0.01), _ON, _BAND)
    return [
        at_most("speed within ±0.002 after the load is on", on, 1.0, "s"),
        at_most("speed within ±0.002 after it is off", settled_after(result, _OFF, _BAND), 1.0, "s"),
        at_most("field angle error", m.angle_held, 5.0, "°"),
    ]


TARGETS = (
    Target(
        "transient-load",
        41,
        "Load steps of 120 % at zero speed",
        _cases,
        _claims,
        numbers=("angle_held",),
    ),
)
