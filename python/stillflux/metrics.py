"""Numbers that judge a run, from the plant's truth. Angles in degrees, the rest in SI or per unit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillflux.result import Result
from stillflux.status import StatusCode

__all__ = [
    "angle_error",
    "flux_ripple",
    "offset_voltage",
    "settled_after",
    "speed_error",
    "speed_ripple",
    "start_time",
    "turns",
]


def angle_error(result: Result) -> NDArray[np.float64]:
    """Field angle error arg ψ̂_s - arg ψ_s in degrees, continuous: a slipped turn counts 360.

    Zero while the drive does not run: there is no estimate to judge.
    """
    error = np.where(result["status"] == StatusCode.RUNNING, result["angle_error"], 0.0)
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
    """True speed minus reference, per unit of rated frequency."""
    error: NDArray[np.float64] = (result["omega_m"] - result["reference"]) / _base(result)["omega_m"]
    return error


def speed_ripple(result: Result) -> float:
    """Half the peak-to-peak value of the true speed, per unit."""
    return float(np.ptp(result["omega_m"]) / (2 * _base(result)["omega_m"]))


def settled_after(result: Result, event: float, band: float) -> float:
    """Seconds from `event` until the speed error stays within ±band per unit; inf if it does not."""
    after = result.window(event)
    outside = np.flatnonzero(np.abs(speed_error(after)) > band)
    if not len(outside):
        return 0.0
    if outside[-1] == len(after.t) - 1:
        return float("inf")
    return float(after.t[outside[-1] + 1] - event)


def start_time(result: Result) -> float:
    """Time at which the drive began to run, s; inf if it did not."""
    running = np.flatnonzero(result["status"] == StatusCode.RUNNING)
    return float(result.t[running[0]]) if len(running) else float("inf")


def _base(result: Result) -> dict[str, Any]:
    return result.scenario.motor.base
