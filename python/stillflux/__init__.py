"""Sensorless induction motor control at very low and zero stator frequency.

SI units, complex amplitude-invariant space vectors, numpy arrays. A `Drive` controls anything that
delivers currents and takes duties; a `Plant` is a switching-level motor and inverter; `simulate` runs
a `Scenario` of both.
"""

from stillflux._core import Drive, Estimate, FluxEstimator, Plant, PlantState, Status, Trace
from stillflux.nameplate import Nameplate
from stillflux.parameters import Inverter, Motor
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.simulation import Interrupted, simulate
from stillflux.status import StatusCode

__all__ = [
    "Drive",
    "Estimate",
    "FluxEstimator",
    "Interrupted",
    "Inverter",
    "Motor",
    "Nameplate",
    "Plant",
    "PlantState",
    "Result",
    "Scenario",
    "Status",
    "StatusCode",
    "Trace",
    "simulate",
]
