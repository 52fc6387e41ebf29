"""Steps of the speed reference far into field weakening, and full reversals there."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds, reported
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.limits import shortest_time
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.metrics import faulted
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.status import StatusCode

_TOP = 2.0
"""Speed, per unit."""
_BAND = 0.02
"""Relative to the step's end: it is reached here."""
_SIGNALS = ("omega_m", "reference", "torque", "psi_s", "i_s", "u_s", "angle_error", "status")


def _scenario(machine: str, scheme: str, arithmetic: str, *, sign: float) -> Scenario:
    """From rest to `sign` 2 pu, and from there to the opposite."""
    drive = DRIVES[machine]
    top, begin = sign * _TOP * drive.motor.base["omega_m"], magnetised(machine)
    least = shortest_time(drive.motor, drive.inverter, _TOP)
    turn = begin + 1.6 * least + 0.5
    return asked(
        f"rest, {sign * _TOP:g} pu, {-sign * _TOP:g} pu",
        machine,
        scheme,
        arithmetic,
        omega_ref=[(0.0, 0.0), (begin, 0.0), (begin, top), (turn, top), (turn, -top)],
        duration=turn + 3.2 * least + 1.0,
        signals=_SIGNALS,
    )


def _times(result: Result) -> list[tuple[float, float]]:
    """Of every step: the time until its end is reached within 2 %, s, and the shortest one."""
    scenario = result.scenario
    assert isinstance(scenario.omega_ref, Sequence)
    points = scenario.omega_ref
    events = [k for k in range(1, len(points)) if points[k][0] == points[k - 1][0]]
    found = []
    for n, k in enumerate(events):
        begin, target = points[k]
        end = points[k + 1][0] if k + 1 < len(points) else scenario.duration
        part = result.window(begin, end)
        there = np.flatnonzero(np.abs(part["omega_m"] - target) <= _BAND * abs(target))
        reached = float(part.t[there[0]] - begin) if len(there) else float("inf")
        # A reversal brakes and accelerates: twice the time at most, for there is more voltage when braking.
        least = shortest_time(scenario.motor, scenario.inverter, _TOP) * (1.0 if n == 0 else 2.0)
        found.append((reached, least))
    return found


def _check(result: Result) -> list[Claim]:
    (step, least), (turn, twice) = _times(result)
    angle = np.degrees(np.abs(result["angle_error"][result["status"] == StatusCode.RUNNING]))
    return [
        holds("no fault", not faulted(result).any()),
        at_most("rest to 2 pu, against the shortest time", step / least, 1.3),
        at_most("reversal, against twice the shortest time", turn / twice, 1.3),
        reported("field angle error", float(angle.max()), "°"),
    ]


def _stays(result: Result) -> list[Claim]:
    """Without field weakening the speed stays where the voltage is used up."""
    begin = _start_of(result)
    speed = np.abs(result.window(begin)["omega_m"]) / result.scenario.motor.base["omega_m"]
    return [
        at_most("largest speed, pu", float(speed.max()), 1.6),
        at_least("largest speed, pu", float(speed.max()), 0.8),
    ]


def _start_of(result: Result) -> float:
    assert isinstance(result.scenario.omega_ref, Sequence)
    return result.scenario.omega_ref[1][0]


_GAIN = 1.02
"""Least flux at the end over that of a drive that stays within the circle, 0.97 of 0.98 u_dc/√3."""


def _overmodulated(machine: str, scheme: str, arithmetic: str) -> Scenario:
    """From rest to 2 pu with overmodulation."""
    scenario = _scenario(machine, scheme, arithmetic, sign=1.0)
    assert isinstance(scenario.omega_ref, Sequence)
    points = scenario.omega_ref[:3]
    return scenario.replace(
        name=scenario.name.replace("rest", "overmodulation, rest"),
        omega_ref=points,
        duration=points[-1][0] + 2.0 * shortest_time(scenario.motor, scenario.inverter, _TOP) + 1.0,
        settings={"overmodulation": True},
    )


def _flux(result: Result) -> float:
    """At the end, over that of the circle without load: 0.97 of the voltage over the speed."""
    base, scenario = result.scenario.motor.base, result.scenario
    circle = 0.97 * 0.98 / np.sqrt(3.0) * scenario.inverter.u_dc / base["u"] / _TOP
    end = result.window(scenario.duration - 0.3)
    return float(np.abs(end["psi_s"]).mean() / base["psi"] / circle)


def _check_overmodulated(result: Result) -> list[Claim]:
    (step, least), *_ = _times(result)
    angle = np.degrees(np.abs(result["angle_error"][result["status"] == StatusCode.RUNNING]))
    return [
        holds("no fault", not faulted(result).any()),
        at_least("flux at 2 pu, against that of the circle", _flux(result), _GAIN),
        at_most("rest to 2 pu, against the shortest time within the circle", step / least, 1.3),
        at_most("field angle error", float(angle.max()), 15.0, "°"),
    ]


def _within_circle(result: Result) -> list[Claim]:
    return [at_most("flux at 2 pu, against that of the circle", _flux(result), 1.01)]


OPERATIONS = (
    *(
        Operation(
            f"speed-step{'' if sign > 0 else '-negative'}",
            10 + (sign < 0),
            f"A step of the reference to {'' if sign > 0 else '−'}2 pu without load, then to the opposite",
            partial(_scenario, sign=sign),
            _check,
            Control("field weakening", lambda s: s.with_settings(field_weakening=False), _stays),
            schemes=("enhanced", "paper"),
        )
        for sign in (1.0, -1.0)
    ),
    Operation(
        "overmodulation",
        15,
        "A step of the reference to 2 pu without load, with overmodulation",
        _overmodulated,
        _check_overmodulated,
        Control("overmodulation", lambda s: s.with_settings(overmodulation=False), _within_circle),
        # Refused at 160 kW, whose 4 kHz leave 40 control periods to a turn of the field at 2 pu.
        machines=tuple(machine for machine in DRIVES if machine != "160kW"),
    ),
)
