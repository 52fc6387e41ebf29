"""Sensorless induction motor control at very low and zero stator frequency.

SI units, complex amplitude-invariant space vectors, numpy arrays. A `Drive` controls anything that
delivers currents and takes duties; a `Plant` is a switching-level motor and inverter; `simulate` runs
a `Scenario` of both.
"""

from importlib.metadata import version

from stillflux._core import (
    Drive,
    Estimate,
    FluxEstimator,
    Plant,
    PlantState,
    Status,
    StatusWarning,
    Trace,
)
from stillflux.commissioning import Commissioned, Commissioning, CommissioningInterrupted, commission
from stillflux.machine_file import Machine, load_machine
from stillflux.messages import MachineWarning
from stillflux.nameplate import Nameplate
from stillflux.parameters import Inverter, Motor
from stillflux.replay import Replay, replay
from stillflux.result import Result
from stillflux.scenario import Scenario, ScenarioWarning
from stillflux.simulation import DivergenceError, Interrupted, simulate
from stillflux.status import EncoderCode, StatusCode
from stillflux.sweep import Sweep, SweepInterrupted, draws, factors, grid, normal, sweep, uniform

__version__ = version("stillflux")

__all__ = [
    "Commissioned",
    "Commissioning",
    "CommissioningInterrupted",
    "DivergenceError",
    "Drive",
    "EncoderCode",
    "Estimate",
    "FluxEstimator",
    "Interrupted",
    "Inverter",
    "Machine",
    "MachineWarning",
    "Motor",
    "Nameplate",
    "Plant",
    "PlantState",
    "Replay",
    "Result",
    "Scenario",
    "ScenarioWarning",
    "Status",
    "StatusCode",
    "StatusWarning",
    "Sweep",
    "SweepInterrupted",
    "Trace",
    "__version__",
    "commission",
    "draws",
    "factors",
    "grid",
    "load_machine",
    "normal",
    "replay",
    "simulate",
    "sweep",
    "uniform",
]
