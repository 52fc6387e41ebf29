"""What a run shows of itself: angle, speed, torque, whether and when it was lost, and its confidence.

All on the plant's truth. Angles in degrees, speeds in per unit, torques in units of rated torque, times in s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stillflux.metrics import faulted, running, smoothed, speed_error
from stillflux.result import Result

__all__ = [
    "CONFIDENT",
    "EXCURSION",
    "Confidence",
    "Measured",
    "angle",
    "confidence",
    "lost",
    "measure",
    "stops",
]

Window: TypeAlias = tuple[float, float]
"""Begin and end, s."""

CONFIDENT = 0.5
"""Documented level of the confidence: below it an angle error of `EXCURSION` has to be expected."""
EXCURSION = 15.0
"""Angle error from which on the confidence must have dropped, °."""
CALM, FALSE_ALARM = 5.0, 0.5
"""Confidence below its level for longer than the second (s) is a false alarm while the error stays below the
first (°)."""
LOST_ANGLE = 90.0
"""Field angle error at which control is lost, °."""
LOST_SPEED, LOST_FOR = 0.05, 0.2
"""Lost: true speed off its reference by more than the first (per unit) for the last (s) of the run."""
MEAN_OVER = 0.02
"""Torques are compared as means over this time, s."""


@dataclass(frozen=True)
class Confidence:
    """How true the drive's confidence in its angle was over a run."""

    least: float
    """Smallest value while running."""
    excursions: int
    """Times at which the angle error came to exceed `EXCURSION`, up to and including the loss of control."""
    misses: int
    """Those at which the confidence had not dropped below its level."""
    blind: float
    """Time with an angle error above `EXCURSION` and a confidence above its level, s."""
    false_alarms: int
    """Stretches of more than 0.5 s with the confidence below its level and the error below 5° throughout."""
    false_time: float
    """Their duration in all, s."""
    running: float
    """Time the drive ran, s."""


@dataclass(frozen=True)
class Measured:
    """One run; angles in degrees, speeds in per unit, torques in units of rated torque, times in s."""

    lost: float
    """Time of loss since power-up; inf: never."""
    why: str
    """What was lost first: a fault by name, "angle" or "speed"; empty: nothing."""
    angle_held: float
    """Largest angle error while the point was held; inf after a fault."""
    angle_settled: float
    """Largest angle error of the settled part; inf after a fault."""
    angle_passed: float
    """Time at which the angle error first exceeded `EXCURSION` while the point was held; inf: never."""
    speed_settled: float
    """Largest error of the true speed against its reference in the settled part; 0 in torque control."""
    speed_mean: float
    """Mean error of the true speed in the settled part; 0 in torque control."""
    torque_estimate: float
    """Largest deviation of the true torque from the drive's estimate in the settled part, 20 ms means."""
    torque_command: float
    """Largest deviation of the true torque from the commanded one in the settled part, 20 ms means."""
    torque_ripple: float
    """Half the peak-to-peak value of the true torque in the settled part, 20 ms means."""
    omega_s: float
    """Mean true stator frequency of the settled part."""
    r_s: float
    """Relative error of the drive's resistance at the end."""
    confidence: Confidence


def angle(result: Result) -> NDArray[np.float64]:
    """Field angle error arg ψ̂_s - arg ψ_s within ±180°; zero while the drive does not run."""
    error: NDArray[np.float64] = np.degrees(np.where(running(result), result["angle_error"], 0.0))
    return error


def confidence(result: Result, loss: float = float("inf")) -> Confidence:
    """Judges the confidence against the true angle error, through a loss of control at `loss` s.

    Of the excursions after a loss the first counts, if the field was still there when control was lost: it is
    the loss itself, of which the confidence has to tell. Those that follow while the field turns unseen do
    not; `blind` and `false_alarms` are of the whole run.
    """
    begun = np.flatnonzero(running(result))[1:]
    if not len(begun):
        return Confidence(0.0, 0, 0, 0.0, 0, 0.0, 0.0)
    error, trust, t = np.abs(angle(result))[begun], result["estimate.confidence"][begun], result.t[begun]
    dt = float(result.t[1] - result.t[0])
    beyond = error > EXCURSION
    ups = _excursions(error)
    before = int(np.count_nonzero(t[ups] <= loss))
    last = error[t <= loss]
    gone = len(last) > 0 and bool(last[-1] > EXCURSION)
    ups = ups[: before if gone else before + 1]
    low = (trust < CONFIDENT) & (error < CALM)
    edges = np.diff(np.concatenate(([0], low.astype(int), [0])))
    lengths = dt * (np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0))
    alarms = lengths[lengths > FALSE_ALARM]
    return Confidence(
        least=float(trust.min()),
        excursions=len(ups),
        misses=int(np.count_nonzero(trust[ups] >= CONFIDENT)),
        blind=dt * float(np.count_nonzero(beyond & (trust >= CONFIDENT))),
        false_alarms=len(alarms),
        false_time=float(alarms.sum()),
        running=dt * len(begun),
    )


def _excursions(error: NDArray[np.float64]) -> NDArray[np.int64]:
    """Where an error comes to exceed the level, having been below two thirds of it."""
    found: list[int] = []
    armed = True
    # Only where it enters or leaves the band does anything change.
    band = np.where(error > EXCURSION, 1, np.where(error < EXCURSION / 1.5, -1, 0))
    for k in np.flatnonzero(np.diff(band, prepend=0)):
        if band[k] > 0 and armed:
            found.append(int(k))
            armed = False
        elif band[k] < 0:
            armed = True
    return np.array(found, dtype=np.int64)


def stops(result: Result) -> list[tuple[float, str]]:
    """When a fault ended the run or, of a drive that never ran, the run itself, s, and by what."""
    faults = np.flatnonzero(faulted(result))
    if len(faults):
        return [(float(result.t[faults[0]]), result.status.fault or "fault")]
    return [] if running(result).any() else [(float(result.t[-1]), "never ran")]


def lost(result: Result, since: float = 0.0) -> tuple[float, str]:
    """When control was lost, s, and by what; (inf, "") if it was not.

    A fault; an angle error above 90° at any time from `since` on; the true speed off its reference by more
    than 0.05 for the last 0.2 s.
    """
    found = stops(result)
    turned = np.flatnonzero((np.abs(angle(result)) > LOST_ANGLE) & (result.t >= since))
    if len(turned):
        found.append((float(result.t[turned[0]]), "angle"))
    if result.scenario.torque_ref is None:
        off = np.abs(speed_error(result)) > LOST_SPEED
        within = np.flatnonzero(~off)
        begin = float(result.t[min(within[-1] + 1, len(off) - 1)]) if len(within) else 0.0
        if off[-1] and result.t[-1] - begin >= LOST_FOR:
            found.append((begin, "speed"))
    return min(found, default=(float("inf"), ""))


def measure(result: Result, held: Window, settled: Window, since: float = 0.0) -> Measured:
    """Measures a run: `held` and `settled` are the windows judged, s; see `lost` for `since`."""
    when, why = lost(result, since)
    whole, part = result.window(*held), result.window(*settled)
    error = np.abs(angle(whole))
    fault = bool(faulted(whole).any())
    passed = np.flatnonzero(error > EXCURSION)
    speed = speed_error(part) if result.scenario.torque_ref is None else np.zeros(1)
    field = np.unwrap(np.angle(part["psi_s"]))
    inverter = result.scenario.plant_inverter or result.scenario.inverter
    return Measured(
        lost=when,
        why=why,
        angle_held=float("inf") if fault else float(error.max()),
        angle_settled=float("inf") if fault else float(np.abs(angle(part)).max()),
        angle_passed=float(whole.t[passed[0]]) if len(passed) else float("inf"),
        speed_settled=float(np.abs(speed).max()),
        speed_mean=float(speed.mean()),
        torque_estimate=_deviation(part, part["estimate.torque"]),
        torque_command=_deviation(part, commanded(part)),
        torque_ripple=float(np.ptp(_means(part, part["torque"]))) / (2 * result.scenario.motor.T_N),
        omega_s=float(
            (field[-1] - field[0]) / (part.t[-1] - part.t[0]) / result.scenario.motor.base["omega"]
        ),
        r_s=float(result["estimate.R_s"][-1] / (result["R_s"][-1] + inverter.r_d) - 1.0),
        confidence=confidence(result, when),
    )


def commanded(result: Result) -> NDArray[np.float64]:
    """The torque the drive asks for, N·m: its flux times its reference of the torque current."""
    flux, i_q = np.abs(result["estimate.psi_s"]), result["estimate.i_dq_ref"].imag
    torque: NDArray[np.float64] = 1.5 * result.scenario.motor.n_p * flux * i_q
    return torque


def _deviation(result: Result, torque: NDArray[Any]) -> float:
    return float(np.abs(_means(result, result["torque"] - torque)).max() / result.scenario.motor.T_N)


def _means(result: Result, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Moving means over `MEAN_OVER`, where the whole window lies within the record."""
    samples = max(1, round(MEAN_OVER / (result.t[1] - result.t[0])))
    samples = min(samples, len(x))
    return smoothed(x, samples)[samples // 2 : len(x) - samples // 2]
