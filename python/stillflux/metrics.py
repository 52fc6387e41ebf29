"""Numbers that judge a run, from the plant's truth. Angles in degrees, the rest in SI or per unit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stillflux.status import StatusCode

if TYPE_CHECKING:
    from stillflux.result import Result

__all__ = [
    "angle_error",
    "fault_time",
    "faulted",
    "flux_ripple",
    "last_resistance_error",
    "last_speed_error",
    "least_confidence",
    "offset_voltage",
    "resistance_error",
    "rms_angle",
    "running",
    "settled_after",
    "smoothed",
    "speed_error",
    "speed_ripple",
    "speed_swing",
    "start_time",
    "stays_within",
    "turns",
    "worst_angle",
    "worst_speed_error",
]


def running(result: Result) -> NDArray[np.bool_]:
    """Where the drive runs."""
    return np.asarray(result["status"] == StatusCode.RUNNING)


def faulted(result: Result) -> NDArray[np.bool_]:
    """Where it stands with a fault."""
    return np.asarray(result["status"] == StatusCode.FAULTED)


def angle_error(result: Result) -> NDArray[np.float64]:
    """Field angle error arg ψ̂_s - arg ψ_s in degrees, continuous: a slipped turn counts 360.

    Zero while the drive does not run: there is no estimate to judge.
    """
    error = np.where(running(result), result["angle_error"], 0.0)
    return np.degrees(np.unwrap(error))


def turns(result: Result) -> NDArray[np.float64]:
    """Revolutions of the true stator flux since the first sample."""
    angle = np.unwrap(np.angle(result["psi_s"]))
    revolutions: NDArray[np.float64] = (angle - angle[0]) / (2 * np.pi)
    return revolutions


def flux_ripple(result: Result, signal: str = "estimate.psi_s") -> float:
    """Half the peak-to-peak value of |ψ| over its mean."""
    magnitude = np.abs(result[signal])
    return float(np.ptp(magnitude) / (2 * magnitude.mean()))


def offset_voltage(result: Result) -> complex:
    """Offset voltage the drive has to find, in V: dc part of û_i - dψ_s/dt over whole revolutions.

    Difference of the means of the first and last revolution of the recorded `drift`. Raises ValueError
    below one revolution.
    """
    revolution = np.abs(turns(result))
    whole = int(revolution.max(initial=0.0))
    if whole < 1:
        raise ValueError(f"revolutions = {revolution.max(initial=0.0):.2f}: one is needed at least")
    if whole == 1:
        ends = np.array([0, np.argmax(revolution >= 1.0)])
        first, last = ends[:1], ends[1:]
    else:
        first = np.flatnonzero(revolution < 1.0)
        last = np.flatnonzero((revolution >= whole - 1) & (revolution < whole))
    drift, t = result["drift"], result.t
    return complex((drift[last].mean() - drift[first].mean()) / (t[last].mean() - t[first].mean()))


def speed_error(result: Result) -> NDArray[np.float64]:
    """True speed minus reference, per unit of rated frequency; NaN where the reference is a torque."""
    if result.scenario.torque_ref is not None:
        return np.full(len(result.t), np.nan)
    error: NDArray[np.float64] = (result["omega_m"] - result["reference"]) / _base(result)["omega_m"]
    return error


def speed_ripple(result: Result) -> float:
    """Half the peak-to-peak value of the true speed, per unit."""
    return float(np.ptp(result["omega_m"]) / (2 * _base(result)["omega_m"]))


def settled_after(result: Result, event: float, band: float) -> float:
    """Seconds from `event` until the speed error stays within ±band per unit; inf if it does not, NaN where
    the reference is a torque."""
    after = result.window(event)
    return stays_within(after.t, speed_error(after), event, band)


def stays_within(t: NDArray[np.float64], error: NDArray[np.float64], event: float, band: float) -> float:
    """Seconds from `event` until an error stays within ±band; inf if it does not, NaN if there is none."""
    if np.isnan(error).all():
        return math.nan
    outside = np.flatnonzero(np.abs(error) > band)
    if not len(outside):
        return 0.0
    return float("inf") if outside[-1] == len(t) - 1 else float(t[outside[-1] + 1] - event)


def smoothed(x: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
    """Moving mean over a window of `samples`."""
    mean: NDArray[np.float64] = np.convolve(x, np.ones(samples) / samples, mode="same")
    return mean


def start_time(result: Result) -> float:
    """Time at which the drive began to run, s; inf if it did not."""
    begun = np.flatnonzero(running(result))
    return float(result.t[begun[0]]) if len(begun) else float("inf")


def worst_angle(result: Result) -> float:
    """Largest field angle error, degrees; inf if the drive never ran."""
    return float(np.abs(angle_error(result)).max()) if running(result).any() else math.inf


def rms_angle(result: Result) -> float:
    """Root mean square of the field angle error while the drive runs, degrees; inf if it never did."""
    judged = angle_error(result)[running(result)]
    return float(np.sqrt(np.mean(judged**2))) if len(judged) else math.inf


def least_confidence(result: Result) -> float:
    """Smallest confidence while the drive runs; 0 if it never did."""
    confidence = result["estimate.confidence"][running(result)]
    return float(confidence.min()) if len(confidence) else 0.0


def last_speed_error(result: Result) -> float:
    """True speed minus reference at the end, per unit; NaN where the reference is a torque."""
    return float(speed_error(result)[-1])


def speed_swing(result: Result) -> float:
    """Half the peak-to-peak value of `speed_error` in the last 0.5 s, per unit; NaN where the reference is a
    torque."""
    return float(np.ptp(speed_error(result.window(float(result.t[-1]) - 0.5))) / 2)


def worst_speed_error(result: Result) -> float:
    """Largest magnitude of true speed minus reference while the drive runs, per unit; inf if it never did,
    NaN where the reference is a torque."""
    error = np.abs(speed_error(result)[running(result)])
    return float(error.max()) if len(error) else math.inf


def resistance_error(result: Result) -> NDArray[np.float64]:
    """Estimated over true resistance (with the inverter's r_d) minus one."""
    r_d = (result.scenario.plant_inverter or result.scenario.inverter).r_d
    error: NDArray[np.float64] = result["estimate.R_s"] / (result["R_s"] + r_d) - 1.0
    return error


def last_resistance_error(result: Result) -> float:
    """`resistance_error` at the end."""
    return float(resistance_error(result)[-1])


def fault_time(result: Result) -> float:
    """Time of the fault, s; inf without one."""
    time = result.status.time
    return math.inf if time is None else float(time)


def _base(result: Result) -> dict[str, Any]:
    return result.scenario.motor.base
