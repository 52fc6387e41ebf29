"""What the drive's model does not contain, drawn at random for a real machine and its sensors.

| effect | range, uniform | why |
|---|---|---|
| eddy currents in the iron | 25 to 60 times the rated impedance, 60 to 200 µs | 2 to 4 % of iron loss |
| deep bar | 5 to 25 % of the cage's conductance, 25 to 50 % of the inverse leakage | standard cages |
| saturation of the leakage | 5 to 25 % lost at 1.5 times the rated peak current | closed slots |
| rotor slots | 11 to 18 a pole pair; permeance 0 to 1 %, leakage 0.5 to 3 % | skewed rotors |
| sampling of the channels | up to 1.5 µs apart | a converter that samples in turn |
| drift of the current sensors | 0.1 % of rated peak current a minute (1σ, each axis) | sensors warm |

The leakage of the parameters is that of high frequency. At slip frequency a bar with shares `g` and `s` has
`(1 - g)²/(1 - s) + g²/s` times as much: 1.0 to 1.81, in the mean 1.25.

The filter's allowances (`noise.rs` of the core) stand for effects such as these. On a plant without them it
is expected to be more careful than it needs to be.
"""

from __future__ import annotations

import math
from random import Random
from statistics import NormalDist

from stillflux.options import PlantOptions
from stillflux.parameters import Motor

__all__ = ["DEEP_BAR", "EDDY_TIME", "IRON_RESISTANCE", "effects", "iron_loss"]

IRON_RESISTANCE, EDDY_TIME = (25.0, 60.0), (60e-6, 200e-6)
"""Resistance of the iron in units of the rated impedance, and time constant of its eddy currents, s."""
DEEP_BAR = ((0.05, 0.25), (0.25, 0.5))
"""Shares of the second rotor branch: of the cage's conductance, of the inverse leakage."""


def iron_loss(motor: Motor, R_fe: float, time: float) -> tuple[float, float]:
    """The plant's option, with more than the time constant that leakage and `R_fe` have: it asks for that."""
    return R_fe, max(time, 2.1 * motor.to_gamma()["L_l"] / R_fe)


def effects(motor: Motor, seed: int) -> PlantOptions:
    """Options of the plant, beside those of an installation. Their numbers follow from the seed alone."""
    # Apart from the draws of the installation with the same seed.
    random = Random(seed ^ 0x5EED)

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * random.random()

    def normal() -> float:
        return NormalDist().inv_cdf(uniform(1e-6, 1.0 - 1e-6))

    peak = math.sqrt(2) * motor.I_N
    drift = 1e-3 * peak / 60.0
    conductance, leakage = DEEP_BAR
    return {
        "iron_loss": iron_loss(motor, uniform(*IRON_RESISTANCE) * motor.base["z"], uniform(*EDDY_TIME)),
        "deep_bar": (uniform(*conductance), uniform(*leakage)),
        "leakage_saturation": (uniform(0.05, 0.25), 1.5 * peak),
        "slot_ripple": (motor.n_p * int(uniform(11.0, 19.0)), uniform(0.0, 0.01), uniform(0.005, 0.03)),
        "adc_skew": [uniform(0.0, 1.5e-6) for _ in range(3)],
        "current_offset_drift": complex(drift * normal(), drift * normal()),
    }
