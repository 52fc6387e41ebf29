"""The oscillation of the torque near zero stator frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import stillflux as sf
from stillflux.evidence import tolerance

#: Draws of the 48-V machine, and how many of them are lost without the oscillation at least. The few ones are
#: chosen: each was lost without it.
DRAWS = [
    ((107, 108, 116, 118), 3),
    pytest.param(range(100, 140), 6, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("draws", "least"), DRAWS, ids=["few", "many"])
def test_of_light_loads_at_rest_most_that_are_lost_without_it_are_held(
    draws: Sequence[int], least: int
) -> None:
    def lost(**settings: float) -> int:
        given = tuple(settings.items())
        return sum(bool(tolerance.run("48V", "light-load", draw, settings=given)[0].why) for draw in draws)

    without = lost(dither=0.0)
    assert without >= least
    assert lost() <= without / 3


@pytest.mark.parametrize("machine", ["2.2kW", "11kW"])
def test_the_torque_oscillates_near_zero_stator_frequency_alone(
    machine: str,
) -> None:
    motor, inverter = sf.Motor.preset(machine), sf.Inverter.preset(machine)

    def ripple(omega: float, dither: float) -> tuple[float, float]:
        """Amplitude of the torque in parts of rated torque, of a triangle with its deviation, and deviation
        of the speed per unit."""
        base = motor.base
        scenario = sf.Scenario(
            motor=motor,
            inverter=inverter,
            omega_ref=omega * base["omega_m"],
            duration=3.0,
            signals=["torque", "omega_m"],
            record_every=4,
        ).with_settings(dither=dither)
        result = sf.simulate(scenario)
        late = result.t > 2.5
        speed = result["omega_m"][late] / base["omega_m"]
        return float(np.sqrt(3.0) * np.std(result["torque"][late]) / motor.T_N), float(np.std(speed))

    still, without = ripple(0.0, 0.05), ripple(0.0, 0.0)
    assert without[0] < 0.005
    assert 0.045 < still[0] < 0.06
    assert still[1] < 0.001
    turning, turning_without = ripple(0.03, 0.05), ripple(0.03, 0.0)
    assert turning == pytest.approx(turning_without, abs=0.005)
