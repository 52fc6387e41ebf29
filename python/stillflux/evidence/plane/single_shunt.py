"""The plane with a single shunt in the dc link, whose gain and offset are drawn for every point.

Gain 1 + 0.5 % g and offset 0.7 % g of rated peak current, `g` normal and cut at ±2.5, as the channels of an
installation are drawn (`evidence.draws`); an amplifier of 0.3 µs, which the drive knows, and the window that
a drive takes by itself, the dead time and 2.5 µs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random
from statistics import NormalDist

from stillflux.evidence.points import map_of
from stillflux.evidence.seeds import seed_of
from stillflux.evidence.target import Case

_GAIN, _OFFSET, _CUT, _SETTLING = 0.005, 0.007, 2.5, 0.3e-6
_MAP = map_of(
    "single-shunt", 6, "Plane with a single shunt of drawn gain and offset", "ramps", own_seeds=True
)


def _drawn(case: Case) -> Case:
    random = Random(seed_of(case.target, case.machine, case.label))

    def g() -> float:
        return min(max(NormalDist().inv_cdf(max(random.random(), 1e-12)), -_CUT), _CUT)

    gain, offset = 1.0 + _GAIN * g(), _OFFSET * math.sqrt(2) * case.scenario.motor.I_N * g()
    plant = {
        **case.scenario.plant,
        "shunt": _SETTLING,
        "current_gain": (gain, 1.0, 1.0),
        "current_offset": (offset, 0.0, 0.0),
    }
    settings = {**case.scenario.settings, "current_sensors": 1, "shunt_settling": _SETTLING}
    return replace(case, scenario=case.scenario.replace(plant=plant, settings=settings))


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    return [_drawn(case) for case in _MAP.build(machine, scheme, arithmetic)]


TARGETS = (replace(_MAP, build=_cases),)
