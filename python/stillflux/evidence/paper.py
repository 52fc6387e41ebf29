"""What the figures share: the paper's drive, its way to zero stator frequency, and claims they have in
common.

Speeds in per unit of rated frequency: 1 pu is `2π f_N/n_p` mechanical rad/s. Torques in units of rated
torque.

Nothing is tuned to a figure: the drive's settings are its defaults, but for what the paper itself changes
(the offset estimator off in Fig. 10, say) and two that the paper's drive does not have, off throughout: it
does not read its offsets at rest (`calibrate_offset`), and its speed controller sees the reference as it is,
without a filter (`set_point_weight` of 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_most, holds
from stillflux.evidence.conditions import drive
from stillflux.evidence.judge import angle
from stillflux.result import Result
from stillflux.scenario import Profile, Scenario

__all__ = [
    "HOLD",
    "IDENTIFIED",
    "OFFSET_25_MV",
    "OFFSET_250_MV",
    "OFFSET_FOUND",
    "RUN",
    "identified",
    "identify_then",
    "offset_found",
    "paper_drive",
    "recovery",
    "runs_to_the_end",
    "speed_kept",
    "turned_by_at_most",
]

OFFSET_25_MV = 0.00625
"""25 mV at ±10 V = 2.5 I_N, per unit of rated peak current; added to i_α and i_β (Fig. 9)."""
OFFSET_250_MV = 10 * OFFSET_25_MV
"""The offset of Figs. 10 and 15 in the paper, whose scale it does not give; ten times that of Fig. 9."""

OFFSET_FOUND = "û_off, deviation from the true offset"
"""Of the published scheme alone: the other one takes an offset off the currents, not off the voltage."""

RUN = 1.5
"""Offset reading and magnetisation: the drive runs after this time, s."""
IDENTIFIED = RUN + 12.0
"""Until then at 1 Hz, where the offset voltage shows, s."""
HOLD = IDENTIFIED + 1.0
"""From then at the speed of the experiment, s."""


def paper_drive(
    machine: str,
    arithmetic: str = "f32",
    *,
    name: str,
    duration: float,
    omega: Profile = 0.0,
    load: Profile = 0.0,
    offset: complex = OFFSET_25_MV * (1 + 1j),
    **fields: Any,
) -> Scenario:
    """The drive of the paper on a switching-level plant with current offset, 12 bit and noise.

    The bridge is the one that the paper describes: dead time, thresholds and legs that are clamped at current
    zero, without capacitance of their nodes.

    `omega` in per unit, `load` in units of rated torque, `offset` of the current space vector in per unit.
    """
    scenario = drive(
        machine,
        "paper",
        arithmetic,
        name=name,
        duration=duration,
        omega=omega,
        load=load,
        offset=offset,
        **{"signals": None, "record_every": 10, **fields},
    ).with_settings(calibrate_offset=False, set_point_weight=1.0)
    told, real = scenario.inverter, scenario.plant_inverter
    # The bridge that a motor file simulates is clamped as well: a drive that knows of no capacitance does not
    # hold a bridge that has one.
    real = real and real.replace(c_out=0.0)
    return scenario.replace(inverter=told.replace(c_out=0.0), plant_inverter=real)


def identify_then(omega: float) -> list[tuple[float, float]]:
    """Speed reference: long enough at 1 Hz to find the offset, then within a second to `omega`."""
    return [(0.0, 0.02), (IDENTIFIED, 0.02), (HOLD, omega)]


# Claims.


def runs_to_the_end(result: Result) -> Claim:
    """The drive is running when the run ends."""
    return holds("the drive runs to the end", result.status == "running", str(result.status))


def to_the_end(claims: Callable[..., list[Claim]]) -> Callable[..., list[Claim]]:
    """Claims about a run that begin with its running to the end, and are no others if it does not."""

    @wraps(claims)
    def judged(result: Result, *others: Result) -> list[Claim]:
        ended = runs_to_the_end(result)
        return [ended, *claims(result, *others)] if ended.ok else [ended]

    return judged


def turned_by_at_most(limit: float, when: str, result: Result) -> Claim:
    """Largest field angle error, degrees."""
    return at_most(f"field angle error {when}", float(np.abs(angle(result)).max()), limit, "°")


def speed_kept(when: str, result: Result) -> Claim:
    """Largest error of the true speed against its reference."""
    return at_most(f"speed error {when}", float(np.abs(metrics.speed_error(result)).max()), 0.002, "pu")


def recovery(step: str, result: Result, event: float, limit: float) -> Claim:
    """Time from `event` until the true speed stays at its reference."""
    time = metrics.settled_after(result, event, 0.002)
    return at_most(f"speed back within ±0.002 pu after the {step} step", time, limit, "s")


def offset_found(result: Result, limit: float) -> Claim:
    """The offset voltage estimate against the true one."""
    true = metrics.offset_voltage(result)
    deviation = 100 * abs(result["estimate.u_off"].mean() - true) / abs(true)
    return at_most(OFFSET_FOUND, deviation, limit, "%").inner()


def resistance_off(result: Result, begin: float, end: float = math.inf) -> float:
    """Largest deviation of r̂_s within a window, %."""
    return 100.0 * float(np.abs(metrics.resistance_error(result.window(begin, end))).max())


def identified(result: Result, event: float, within: float) -> float:
    """Seconds from `event` until the resistance error stays within ±`within`."""
    after = result.window(event)
    return metrics.stays_within(after.t, metrics.resistance_error(after), event, within)
