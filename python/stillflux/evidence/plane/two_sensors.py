"""The plane with two current sensors, whose gains and offsets are drawn for every point.

Gains 1 + 0.5 % g and offsets 0.7 % g of rated peak current for each of the two channels, `g` normal and cut
at ±2.5, as an installation is drawn (`evidence.draws`); what the channel of phase c holds is not read.
"""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from statistics import NormalDist

from stillflux.evidence.points import map_of
from stillflux.evidence.seeds import seed_of
from stillflux.evidence.target import Case

_GAIN, _OFFSET, _CUT = 0.005, 0.007, 2.5
_MAP = map_of(
    "two-sensors", 5, "Plane with two current sensors of drawn gains and offsets", "ramps", own_seeds=True
)


def _drawn(case: Case) -> Case:
    random = Random(seed_of(case.target, case.machine, case.label))
    peak = math.sqrt(2) * case.scenario.motor.I_N

    def g() -> float:
        return min(max(NormalDist().inv_cdf(max(random.random(), 1e-12)), -_CUT), _CUT)

    gain = (1.0 + _GAIN * g(), 1.0 + _GAIN * g(), 1.0)
    offset = (_OFFSET * peak * g(), _OFFSET * peak * g(), 0.0)
    plant = {**case.scenario.plant, "current_gain": gain, "current_offset": offset}
    scenario = case.scenario.replace(plant=plant).with_settings(current_sensors=2)
    return replace(case, scenario=scenario)


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [_drawn(case) for case in _MAP.build(machine, scheme, arithmetic)]


TARGETS = (replace(_MAP, build=_cases),)
