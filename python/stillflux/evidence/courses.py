"""Courses that an installation has to survive: references and loads over the time since the end of the
start-up, and a stop in one of them.

Speeds in per unit of rated frequency, torques in units of rated torque, times in s. `slip` is that of the
machine as the drive knows it, at rated flux; the real one's is off by as much as its R_R.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from stillflux.evidence.conditions import slip
from stillflux.parameters import Motor

__all__ = ["COURSES", "Course", "Demand", "Points", "in_every_draw"]

Points: TypeAlias = list[tuple[float, float]]


@dataclass(frozen=True)
class Demand:
    """What a course asks of a drive; the run ends with the last point."""

    omega: Points
    """Points of the speed reference."""
    load: Points
    """Points of the load."""
    stopped: tuple[float, float] | None = None
    """When the drive is stopped, and when it starts again, s."""

    def after(self, begin: float) -> Demand:
        """The same in the time of a scenario in which it begins at `begin`, s."""

        def later(points: Points) -> Points:
            return [(0.0, points[0][1]), *((begin + t, value) for t, value in points)]

        stopped = self.stopped and (begin + self.stopped[0], begin + self.stopped[1])
        return Demand(later(self.omega), later(self.load), stopped)

    @property
    def end(self) -> float:
        """Time of the last point, s."""
        return max(self.omega[-1][0], self.load[-1][0])

    @property
    def changes(self) -> list[tuple[float, dict[str, Any]]]:
        """Stop and start as changes of a scenario."""
        if self.stopped is None:
            return []
        stop, start = self.stopped
        return [(stop, {"stop": True}), (start, {"stop": False})]


@dataclass(frozen=True)
class Course:
    """One course."""

    title: str
    build: Callable[[Motor, int], Demand]
    """What it asks of a motor in the draw with a seed."""
    target: float | None
    """Largest admissible rate of loss, %; None: no target is set."""


def _start(motor: Motor) -> tuple[Points, Points]:
    """Rated load arrives at once, 0.1 s after the start-up, then a ramp to a tenth of rated speed."""
    del motor
    return [(0, 0), (0.5, 0), (1.5, 0.1), (4, 0.1)], [(0, 0), (0.1, 0), (0.1, 1)]


def _low_speed(motor: Motor) -> tuple[Points, Points]:
    """Motoring at 0.02, then regeneration at ω_s = 0.02, 4 s each."""
    generating = slip(motor, 1.0) + 0.02
    omega = [(0, 0), (0.3, 0), (0.8, 0.02), (5, 0.02), (5.5, generating), (9.5, generating)]
    return omega, [(0, 0), (0.8, 0), (1.3, 1), (5, 1), (5.5, -1)]


def _hold(motor: Motor) -> tuple[Points, Points]:
    """Rated load at zero speed for 8 s."""
    del motor
    return [(0, 0), (8.8, 0)], [(0, 0), (0.3, 0), (0.8, 1)]


def _crossing(motor: Motor) -> tuple[Points, Points]:
    """ω_s from 0.03 to −0.03 within 10 s under rated load."""
    line = -slip(motor, 1.0)
    omega = [(0, 0), (0.3, 0), (0.8, line + 0.03), (2, line + 0.03), (12, line - 0.03), (13, line - 0.03)]
    return omega, [(0, 0), (0.8, 0), (1.3, 1)]


def _load_steps(motor: Motor) -> tuple[Points, Points]:
    """Steps of ± rated load at zero speed."""
    del motor
    steps = [(0.5, 1.0), (1.5, 0.0), (2.5, -1.0), (3.5, 0.0), (4.5, 1.0), (5.5, -1.0)]
    load: Points = [(0, 0)]
    for t, torque in steps:
        load += [(t, load[-1][1]), (t, torque)]
    return [(0, 0), (6.5, 0)], load


def _beside(torque: float) -> Callable[[Motor], tuple[Points, Points]]:
    """15 s at a speed at which ω_s is 0.003 at rated flux."""

    def build(motor: Motor) -> tuple[Points, Points]:
        beside = 0.003 - slip(motor, torque)
        omega = [(0, 0), (0.3, 0), (0.8, 0.05), (1.5, 0.05), (2.5, beside), (17.5, beside)]
        return omega, [(0, 0), (0.8, 0), (1.3, torque)]

    return build


def _reversal(motor: Motor) -> tuple[Points, Points]:
    """To rated speed and from there to the opposite one, without load, on a ramp that asks the largest
    inertia for four fifths of rated torque."""
    ramp = max(1.0, 3.0 * motor.J * motor.base["omega_m"] / (0.8 * motor.T_N))
    return [(0, 0), (0.3, 0), (0.3 + ramp, 1), (0.8 + ramp, 1), (0.8 + 3 * ramp, -1), (1.3 + 3 * ramp, -1)], [
        (0, 0)
    ]


def _weakening(motor: Motor) -> tuple[Points, Points]:
    """Steps to 1.9 times rated speed, to its opposite and to rest, without load and without a ramp, for four
    times as long as the largest inertia takes to rated speed with rated torque. A drive whose switching
    frequency does not carry this field ends at the speed that it does."""
    step = max(0.5, 4.0 * 3.0 * motor.J * motor.base["omega_m"] / motor.T_N)
    omega: Points = [(0, 0)]
    for t, speed in [(0.3, 1.9), (0.3 + step, -1.9), (0.3 + 2.2 * step, 0.0)]:
        omega += [(t, omega[-1][1]), (t, speed)]
    return [*omega, (0.3 + 3.2 * step, 0)], [(0, 0)]


def _light_load(motor: Motor) -> tuple[Points, Points]:
    """A fifth of rated torque that grows from 3 to 6 s at zero speed and stays until 14 s. Without load the
    field stands or all but stands, with a direct current, and nothing shows its angle when the load comes."""
    del motor
    return [(0, 0), (14, 0)], [(0, 0), (3, 0), (6, 0.2)]


def _restart(motor: Motor, seed: int) -> Demand:
    """A stop and a restart with the flux that is left: at a speed from 0.02 to 1.2 in either direction, after
    1 ms to 1 s, without load or with up to 0.6 in either direction. A load that would change the speed by
    more than 15 % in the pause, with the inertia that is told, ends with the stop and comes back 0.3 s after
    the restart."""
    rng = np.random.default_rng([seed, 2])
    speed = math.exp(rng.uniform(math.log(0.02), math.log(1.2))) * rng.choice((-1, 1))
    load = rng.uniform(0.0, 0.6) * rng.choice((0, 1, 1)) * rng.choice((-1, 1), p=(0.3, 0.7)) * np.sign(speed)
    pause = math.exp(rng.uniform(math.log(1e-3), 0.0))
    spin_up = motor.J * motor.base["omega_m"] / motor.T_N
    ramp = max(0.4, 4.0 * abs(speed) * spin_up)
    loaded = 0.3 + ramp
    stop = loaded + 2.0 * motor.tau_r + 0.6
    start = stop + pause
    points: Points = [(0, 0), (loaded, 0), (loaded + 0.1, load)]
    if abs(load) * pause > 0.15 * abs(speed) * spin_up:
        points += [(stop, load), (stop, 0), (start + 0.3, 0), (start + 0.4, load)]
    omega: Points = [(0, 0), (0.3, 0), (0.3 + ramp, speed), (start + 1.8, speed)]
    return Demand(omega, points, (stop, start))


def _duty(motor: Motor, seed: int) -> Demand:
    """Speeds and loads at random for some 20 s: standstill, a speed from 0.003 to 0.1 or from 0.1 to 1, in
    either direction, on a ramp that asks the largest inertia for at most 0.4 of rated torque and may be ten
    times as long; meanwhile the load goes within 10 ms to 1 s to none or to any between ± rated torque."""
    rng = np.random.default_rng([seed, 3])

    def spread(low: float, high: float) -> float:
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    def next_speed() -> float:
        speeds = (0.0, spread(0.003, 0.1), rng.uniform(0.1, 1.0))
        return float(rng.choice(speeds, p=(0.25, 0.4, 0.35)) * rng.choice((-1, 1)))

    spin_up = motor.J * motor.base["omega_m"] / motor.T_N
    omega: Points = [(0, 0), (0.3, 0)]
    load: Points = [(0, 0)]
    while omega[-1][0] < 20.0:
        t, old = omega[-1]
        speed = next_speed()
        ramp = max(0.05, 3.0 * abs(speed - old) * spin_up / 0.4 * spread(1.0, 10.0))
        dwell = spread(0.3, 4.0)
        torque = float(rng.uniform(-1.0, 1.0) * rng.choice((0, 1), p=(0.25, 0.75)))
        begin = t + rng.uniform(0.0, 0.8) * (ramp + dwell)
        load += [(begin, load[-1][1]), (begin + min(spread(0.01, 1.0), t + ramp + dwell - begin), torque)]
        omega += [(t + ramp, speed), (t + ramp + dwell, speed)]
    end = omega[-1][0] + 1.5
    return Demand([*omega, (end, omega[-1][1])], [*load, (end, load[-1][1])])


def in_every_draw(build: Callable[[Motor], tuple[Points, Points]]) -> Callable[[Motor, int], Demand]:
    """The same reference and load in every draw."""
    return lambda motor, seed: Demand(*build(motor))


COURSES: Mapping[str, Course] = {
    "start": Course("start into rated load", in_every_draw(_start), 0.0),
    "low-speed": Course("low speed, motoring and regeneration, T_N", in_every_draw(_low_speed), 0.0),
    "hold": Course("zero speed held under T_N", in_every_draw(_hold), 0.0),
    "crossing": Course("slow crossing of ω_s = 0 under T_N", in_every_draw(_crossing), 0.0),
    "load-steps": Course("steps of ±T_N at zero speed", in_every_draw(_load_steps), 0.0),
    "beside-rated": Course("15 s beside ω_s = 0 at T_N", in_every_draw(_beside(1.0)), 1.0),
    "beside-half": Course("15 s beside ω_s = 0 at T_N/2", in_every_draw(_beside(0.5)), None),
    "reversal": Course("to rated speed and its opposite", in_every_draw(_reversal), None),
    "weakening": Course("steps to ±1.9 times rated speed", in_every_draw(_weakening), None),
    "light-load": Course("light load that comes within 3 s at rest, T_N/5", in_every_draw(_light_load), None),
    "restart": Course("restart with the flux that is left", _restart, None),
    "duty": Course("speeds and loads at random", _duty, None),
}
"""By name."""
