"""The offset of one current sensor (phase a, b or c) steps by 1.5 % of rated peak current in a running drive.

A step of one sensor shows in the sum of the three currents, unlike the offset of `plane_drift`, whose sum is
zero. Speeds and loads of both signs stand for steps of both.
"""

from __future__ import annotations

from dataclasses import replace

from stillflux.evidence.conditions import OFFSET_AT
from stillflux.evidence.points import TORQUES, Kind, map_of
from stillflux.evidence.target import Case, Target

_STEP = 0.015
_SPEEDS = (-0.1, -0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06, 0.1)
_TORQUES = (-1.2, -0.8, -0.4, 0.0, 0.4, 0.8, 1.2)


def _stepped(case: Case, phase: int) -> Case:
    offset = [0.0, 0.0, 0.0]
    offset[phase] = _STEP * case.scenario.motor.base["i"]
    changes = [(OFFSET_AT, {"current_offset": tuple(offset)})]
    label = f"{case.label}, phase {'abc'[phase]}"
    return replace(case, label=label, scenario=case.scenario.replace(changes=changes))


def _target(
    name: str, order: int, title: str, kind: Kind, speeds: tuple[float, ...], torques: tuple[float, ...]
) -> Target:
    held = map_of(name, order, f"{title}, one sensor steps by 1.5 %", kind, speeds, torques, own_seeds=True)

    def cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
        return [
            _stepped(case, phase) for case in held.build(machine, scheme, arithmetic) for phase in range(3)
        ]

    return replace(held, build=cases, view="numbers")


TARGETS = (
    _target("sensor-step", 7, "Coarse plane", "drift", _SPEEDS, _TORQUES),
    _target("sensor-step-rest", 8, "Load at rest before the first turn", "rest-drift", (0.0,), TORQUES),
)
