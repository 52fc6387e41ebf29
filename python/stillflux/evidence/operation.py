"""What a file in `operations` holds: something a drive is asked to do in the field, what must happen, and its
negative control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from stillflux.evidence.claims import Claim
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.machines import ADC_NOISE
from stillflux.evidence.tolerance import start_up
from stillflux.options import PlantOptions
from stillflux.result import Result
from stillflux.scenario import Scenario

__all__ = ["Control", "Operation", "asked", "magnetised"]


@dataclass(frozen=True)
class Control:
    """The negative control: the same with the mechanism switched off."""

    off: str
    """What is switched off, in words."""
    build: Callable[[Scenario], Scenario]
    check: Callable[[Result], Sequence[Claim]]
    """What the run must show: that it fails, for its reason and not before its event."""


@dataclass(frozen=True)
class Operation:
    """One thing that is asked of a drive."""

    name: str
    order: int
    """Its place on the page; tens for topics."""
    asked: str
    """What is asked, in a sentence."""
    build: Callable[[str, str, str], Scenario]
    """Its scenario for a drive of `drives.DRIVES`, a scheme and an arithmetic."""
    check: Callable[[Result], Sequence[Claim]]
    """What must happen, on the plant's truth."""
    control: Control
    machines: Sequence[str] = tuple(DRIVES)
    schemes: Sequence[str] = ("enhanced",)
    shown: Sequence[str] = ("omega_m", "reference", "torque", "psi_s")
    """Signals of its picture; of a complex one the magnitude."""


def magnetised(machine: str) -> float:
    """When a drive of `drives.DRIVES` runs: offset reading and magnetisation are over for 0.2 s, s."""
    drive = DRIVES[machine]
    return start_up(drive.motor, drive.inverter) + 0.2


def asked(
    what: str, machine: str, scheme: str, arithmetic: str, plant: PlantOptions | None = None, **fields: Any
) -> Scenario:
    """A scenario for a drive of `drives.DRIVES`, with the noise of its current channels; `what` is asked of
    it."""
    drive = DRIVES[machine]
    options: PlantOptions = {"adc_noise": ADC_NOISE * drive.motor.I_N, **(plant or {})}
    return Scenario(
        name=f"{what}; {machine}, {scheme}, {arithmetic}",
        motor=drive.motor,
        inverter=drive.inverter,
        scheme=scheme,
        arithmetic=arithmetic,
        plant=options,
        **fields,
    )
