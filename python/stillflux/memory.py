"""What a drive stores over a stop: whether it can be that of a machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stillflux.parameters import Inverter, Motor

__all__ = ["RESISTANCE_RANGE", "check_machine"]

RESISTANCE_RANGE = (0.4, 2.0)
"""Range to which a drive limits R_s, relative to R_s + r_d of its parameters."""


def check_machine(memory: Mapping[str, Any], motor: Motor, inverter: Inverter) -> None:
    """Raises ValueError for a resistance that this motor cannot have: the memory is another one's."""
    told, value = motor.R_s + inverter.r_d, memory.get("R_s")
    low, high = RESISTANCE_RANGE
    # What a drive has limited comes back rounded.
    if isinstance(value, int | float) and not 0.999 * low * told <= value <= 1.001 * high * told:
        raise ValueError(
            f"memory R_s = {value:.4g} Ω is outside the admissible range {low * told:.4g} to "
            f"{high * told:.4g} Ω, {low:g} to {high:g} of R_s + r_d of motor and inverter: it is another "
            f"machine's"
        )
