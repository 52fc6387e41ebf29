"""The machines on which everything is shown, and profiles in their units."""

from __future__ import annotations

import os
import shlex
from typing import Any

from stillflux.machine_file import Machine, load_machine
from stillflux.parameters import PRESETS, Inverter, Motor
from stillflux.scenario import Profile

__all__ = [
    "ADC_NOISE",
    "ALL_MACHINES",
    "LEAKY",
    "MACHINES",
    "OwnMachine",
    "inverter_of",
    "motor_of",
    "option",
    "plant_of",
    "ramp",
    "scaled",
    "step",
]

MACHINES = PRESETS
"""The machines of the presets; the paper's figures are run on these."""
LEAKY = "11kW-leaky"
"""The 11-kW machine with the leakage inductance σl_s = 0.15; l_s, r_s and τ_r stay."""
ALL_MACHINES = (*MACHINES, LEAKY)

ADC_NOISE = 0.004
"""Noise of the 12-bit current sensors, rms per unit of rated rms current."""


class OwnMachine(str):
    """Name of a user's machine that carries its parameters: to processes that run jobs, too, which know none
    but the machines of this file."""

    machine: Machine
    source: str
    """Its motor file."""

    def __new__(cls, machine: Machine, source: str = "") -> OwnMachine:
        """The name of a machine."""
        name = super().__new__(cls, machine.name)
        name.machine, name.source = machine, source
        return name

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> OwnMachine:
        """The machine of a motor file, see `stillflux.machine_file`."""
        return cls(load_machine(path), str(path))

    @property
    def is_guess(self) -> bool:
        """Whether the motor that is simulated is the one that follows from a plate."""
        return self.machine.of_plate and self.machine.plant_motor is None

    def __getnewargs__(self) -> tuple[Machine, str]:  # type: ignore[override]
        return (self.machine, self.source)

    def __repr__(self) -> str:
        """With all parameters: what was done for a machine counts for no other of the same name."""
        return repr(self.machine)


def option(machine: str) -> str:
    """How a command line names a machine."""
    if isinstance(machine, OwnMachine):
        return f"--motor {shlex.quote(machine.source or str(machine))}"
    return f"--machine {machine}"


def motor_of(machine: str) -> Motor:
    """Motor of one of `ALL_MACHINES`, or of a user's machine."""
    if isinstance(machine, OwnMachine):
        return machine.machine.motor
    if machine != LEAKY:
        return Motor.preset(machine)
    motor = Motor.preset("11kW")
    L_sigma = 0.15 * motor.base["l"]
    L_M = motor.L_s - L_sigma
    return motor.replace(L_sigma=L_sigma, L_M=L_M, R_R=L_M / motor.tau_r)


def inverter_of(machine: str) -> Inverter:
    """Inverter of one of `ALL_MACHINES`, or of a user's machine."""
    if isinstance(machine, OwnMachine):
        return machine.machine.inverter
    return Inverter.preset("11kW" if machine == LEAKY else machine)


def plant_of(machine: str, scheme: str) -> dict[str, Any]:
    """Fields of a scenario in which a user's machine differs from what its drive is told: motor and inverter
    that are simulated, and settings by how well the drive's values are known; none for other machines."""
    if not isinstance(machine, OwnMachine):
        return {}
    own = machine.machine
    fields: dict[str, Any] = {"plant_motor": own.plant_motor, "plant_inverter": own.plant_inverter}
    if scheme == "enhanced":
        fields["settings"] = own.settings
    return fields


def scaled(profile: Profile, base: float) -> Profile:
    """A profile times `base`."""
    if isinstance(profile, int | float):
        return profile * base
    return [(t, value * base) for t, value in profile]


def step(t: float, after: float) -> list[tuple[float, float]]:
    """Zero, from `t` on `after`."""
    return [(0.0, 0.0), (t, 0.0), (t, after)]


def ramp(begin: float, end: float, after: float, before: float = 0.0) -> list[tuple[float, float]]:
    """`before` until `begin`, on a straight line to `after` at `end`, s."""
    return [(0.0, before), (begin, before), (end, after)]
