"""What an earlier run has identified, where the winding has another temperature since."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence.draws import drawn
from stillflux.evidence.drives import TypicalDrive
from stillflux.evidence.machines import ADC_NOISE
from stillflux.evidence.population import drive
from stillflux.evidence.tolerance import start_up
from stillflux.options import DriveSettings

COLD, HOT = 0.85, 1.3


def installation(number: int, warm: float) -> tuple[sf.Motor, TypicalDrive, Any]:
    """The motor with `R_s` and `R_R` at so many times their parameters, what the drive is told, the plant."""
    of = drive(69_000 + number)
    found = drawn(TypicalDrive(of.motor, of.inverter), 690_000 + number)
    real = found.motor.replace(R_s=warm * of.motor.R_s, R_R=warm * of.motor.R_R)
    plant = {**found.plant, "adc_noise": ADC_NOISE * of.motor.I_N}
    return real, TypicalDrive(of.motor, found.told), plant


def known_of(number: int, warm: float) -> dict[str, Any]:
    """What a run at both speeds under half of rated load leaves."""
    real, told, plant = installation(number, warm)
    motor, inverter = told.motor, told.inverter
    begin, base = start_up(motor, inverter), motor.base["omega_m"]
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            plant_motor=real,
            duration=begin + 5.0,
            omega_ref=((0.0, 0.0), (begin, 0.0), (begin + 1.0, 0.1 * base), (begin + 3.0, -0.05 * base)),
            load_torque=((0.0, 0.0), (begin + 0.5, 0.0), (begin + 0.6, 0.5 * motor.T_N)),
            plant=plant | {"seed": number},
            signals=("status",),
        )
    )
    assert result.status.fault is None
    return result.memory


def worst(number: int, memory: dict[str, Any], settings: DriveSettings | None = None) -> float:
    """Largest angle error, degrees, of a hot machine loaded 50 ms after its start; infinite: a fault."""
    real, told, plant = installation(number, HOT)
    motor, inverter = told.motor, told.inverter
    begin, base = start_up(motor, inverter) + 0.05, motor.base["omega_m"]
    result = sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=inverter,
            plant_motor=real,
            memory=memory,
            duration=begin + 4.0,
            omega_ref=((0.0, 0.0), (begin + 0.2, 0.0), (begin + 0.4, 0.02 * base)),
            load_torque=((0.0, 0.0), (begin, 0.0), (begin, motor.T_N)),
            plant=plant | {"seed": number + 7},
            settings=settings or {},
            signals=("angle_error", "status"),
        )
    )
    if result.status.fault is not None:
        return np.inf
    running = result["status"] == sf.StatusCode.RUNNING
    return float(np.abs(np.degrees(result["angle_error"][running])).max())


@pytest.mark.parametrize("number", [49, 58, 96, 100])
def test_a_hot_winding_is_found_at_a_start_whatever_the_memory_of_a_cold_one_says(number: int) -> None:
    memory = known_of(number, COLD)
    found = worst(number, memory)
    assert found < 5.0
    # A drive that holds the resistance to be known to 5 % believes it.
    assert worst(number, memory, {"prior_R_s": 0.05}) > 2.0 * found
