"""What the drive's model does not contain, drawn at random for a real machine and its sensors.

| effect | range, uniform | why |
|---|---|---|
| eddy currents in the iron | 25 to 60 times the rated impedance, 60 to 200 µs | 2 to 4 % of iron loss |
| deep bar | 5 to 25 % of the cage's conductance, 25 to 50 % of the inverse leakage | standard cages |
| saturation of the leakage | 5 to 25 % lost at 1.5 times the rated peak current | closed slots |
| rotor slots | 11 to 18 a pole pair; permeance 0 to 1 %, leakage 0.5 to 3 % | skewed rotors |
| sampling of the channels | up to 1.5 µs apart | a converter that samples in turn |
| drift of the current sensors | 0.1 % of rated peak current a minute (1σ, each axis) | sensors warm |

The filter's allowances (`noise.rs` of the core) stand for effects such as these. On a plant without them it
is expected to be more careful than it needs to be.
"""

from __future__ import annotations

import math
from random import Random
from statistics import NormalDist

from stillflux.options import PlantOptions
from stillflux.parameters import Motor

__all__ = ["effects"]


def effects(motor: Motor, seed: int) -> PlantOptions:
    """Options of the plant, beside those of an installation. Their numbers follow from the seed alone."""
    # Apart from the draws of the installation with the same seed.
    random = Random(seed ^ 0x5EED)

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * random.random()

    def normal() -> float:
        return NormalDist().inv_cdf(uniform(1e-6, 1.0 - 1e-6))

    peak = math.sqrt(2) * motor.I_N
    R_fe = uniform(25.0, 60.0) * motor.base["z"]
    eddy = uniform(60e-6, 200e-6)
    drift = 1e-3 * peak / 60.0
    return {
        # The plant asks for more than the time constant that leakage and R_fe have.
        "iron_loss": (R_fe, max(eddy, 2.1 * motor.to_gamma()["L_l"] / R_fe)),
        "deep_bar": (uniform(0.05, 0.25), uniform(0.25, 0.5)),
        "leakage_saturation": (uniform(0.05, 0.25), 1.5 * peak),
        "slot_ripple": (motor.n_p * int(uniform(11.0, 19.0)), uniform(0.0, 0.01), uniform(0.005, 0.03)),
        "adc_skew": [uniform(0.0, 1.5e-6) for _ in range(3)],
        "current_offset_drift": complex(drift * normal(), drift * normal()),
    }
