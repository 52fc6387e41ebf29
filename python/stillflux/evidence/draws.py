"""A real installation drawn at random: every parameter off at once, and the drive told the nominal ones.

Independent draws; `g` is normal, cut at ±2.5 of its standard deviations:

| quantity | distribution |
|---|---|
| R_s, R_R, L_σ, L_M | 1 + (8, 12, 10, 6) % g; the saturation curve goes with the stator inductance |
| u_th, T_d | 1 + (30, 8) % g |
| node capacitance C | `I_k = C u_dc/T_d` log-uniform, 0.5 … 20 % of peak current, C in 0.1 … 10 nF |
| capacitance the drive is told | C times a log-normal factor, 1σ 0.4, within 1/3 … 3 |
| inertia | factor uniform in 0.8 … 3 |
| Coulomb friction | uniform in 0 … 2 % of rated torque |
| offset of each current channel | 0.7 % g of rated peak current |
| gain of each current channel | 1 + 0.5 % g |
| dc link | 2 % of ripple at 100 Hz, its phase uniform |
| delay of each switch, on and off | 1σ 25 ns about a delay common to all |
| noise of the current channels | 0.4 % of rated rms current, its own seed |

Delays of gate drivers: data sheets of drivers with digital isolators allow 5 to 30 ns between two of them, those with
optocouplers ten times as much, and switches add some tens. The drive is told nothing of the delays.

The ripple is a staircase with ten steps a period: the link is a source whose voltage changes at given times.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from random import Random
from statistics import NormalDist
from typing import Any

from stillflux.evidence.drives import TypicalDrive
from stillflux.evidence.machines import ADC_NOISE
from stillflux.options import PlantOptions
from stillflux.parameters import Inverter, Motor

__all__ = ["C_RANGE", "KNEE_RANGE", "Installation", "capacitance_range", "drawn", "ripple"]

C_RANGE = (0.1e-9, 10e-9)
"""Node capacitance of one leg, F."""
KNEE_RANGE = (0.005, 0.2)
"""`I_k`, in units of the rated peak current."""
TOLD_SIGMA, TOLD_RANGE = 0.4, (1.0 / 3.0, 3.0)
"""Standard deviation of the logarithm, and range, of the capacitance told over the real one."""
RIPPLE, RIPPLE_FREQUENCY, RIPPLE_STEP = 0.02, 100.0, 1e-3
"""Amplitude over the mean, Hz, and s between two steps."""
DELAY = 25e-9
"""Standard deviation of the delay of a switch, s."""
CUT = 2.5
LEAST_FACTOR = 0.3

_MOTOR = {"R_s": 0.08, "R_R": 0.12, "L_sigma": 0.10, "L_M": 0.06}
_INVERTER = {"u_th": 0.30, "dead_time": 0.08}


@dataclass(frozen=True)
class Installation:
    """What was drawn."""

    motor: Motor
    """The real motor."""
    inverter: Inverter
    """The real inverter."""
    told: Inverter
    """The inverter as the drive knows it."""
    plant: PlantOptions
    phase: float
    """Of the ripple of the dc link, rad."""
    numbers: Mapping[str, float]
    """What was drawn, by name: factors, and `I_k` in units of the rated peak current."""


def capacitance_range(drive: TypicalDrive) -> tuple[float, float]:
    """Node capacitances that a drive may have, F: both of `C_RANGE` and `KNEE_RANGE`, or the nearest to
    both."""
    farad = math.sqrt(2) * drive.motor.I_N * drive.inverter.dead_time / drive.inverter.u_dc
    low, high = (min(max(part * farad, C_RANGE[0]), C_RANGE[1]) for part in KNEE_RANGE)
    return low, high


def drawn(drive: TypicalDrive, seed: int, scale: float = 1.0) -> Installation:
    """One installation. Its numbers follow from the seed alone, whatever the processor. `scale`: of the
    standard deviations; a factor is at least 0.3 then."""
    random = Random(seed)
    uniform = random.random

    def g() -> float:
        # Of `random` only this is promised to stay as it is from one version to the next.
        return min(max(NormalDist().inv_cdf(max(uniform(), 1e-12)), -CUT), CUT)

    motor, inverter = drive.motor, drive.inverter
    factors = {
        name: max(1.0 + scale * sigma * g(), LEAST_FACTOR) for name, sigma in {**_MOTOR, **_INVERTER}.items()
    }
    low, high = capacitance_range(drive)
    c_out = low * (high / low) ** uniform()
    told = min(max(math.exp(scale * TOLD_SIGMA * g()), TOLD_RANGE[0]), TOLD_RANGE[1])
    inertia, friction = 0.8 + 2.2 * uniform(), 0.02 * uniform()
    peak = math.sqrt(2) * motor.I_N
    real = motor.replace(
        J=inertia * motor.J, **{name: factors[name] * getattr(motor, name) for name in _MOTOR}
    )
    if motor.saturation is not None:
        L_u, *shape = motor.saturation
        real = real.replace(saturation=(L_u * real.L_s / motor.L_s, *shape))
    plant: PlantOptions = {
        "seed": seed,
        "adc_noise": ADC_NOISE * motor.I_N,
        "current_offset": [scale * 0.007 * peak * g() for _ in range(3)],
        "current_gain": [1.0 + scale * 0.005 * g() for _ in range(3)],
        "coulomb": friction * motor.T_N,
    }
    phase = 2.0 * math.pi * uniform()

    def delays() -> list[tuple[float, float]]:
        # What is common to the switches is no voltage; none is negative.
        return [(scale * DELAY * (CUT + g()), scale * DELAY * (CUT + g())) for _ in range(3)]

    plant["turn_on_delay"], plant["turn_off_delay"] = delays(), delays()
    return Installation(
        motor=real,
        inverter=inverter.replace(
            c_out=c_out, **{name: factors[name] * getattr(inverter, name) for name in _INVERTER}
        ),
        told=inverter.replace(c_out=min(told * c_out, C_RANGE[1])),
        plant=plant,
        phase=phase,
        numbers={
            **factors,
            "knee": c_out * inverter.u_dc / inverter.dead_time / peak,
            "capacitance told": min(told * c_out, C_RANGE[1]) / c_out,
            "J": inertia,
        },
    )


def ripple(u_dc: float, phase: float, duration: float) -> list[tuple[float, dict[str, Any]]]:
    """The ripple of the dc link over `duration` s, as changes of a scenario."""
    omega = 2.0 * math.pi * RIPPLE_FREQUENCY
    times = (k * RIPPLE_STEP for k in range(round(duration / RIPPLE_STEP)))
    return [
        (t, {"u_dc": u_dc * (1.0 + RIPPLE * math.sin(omega * (t + 0.5 * RIPPLE_STEP) + phase))})
        for t in times
    ]
