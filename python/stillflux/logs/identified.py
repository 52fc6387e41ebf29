"""What the estimators identified from a log, beside what is known of motor and filter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["identified_doubts"]

_END = 0.1  # part of the log over which the resistance is taken
_AT_END = 0.02  # how near to an end of its range a resistance is at the end, relative
# Above the 0.04 of an undisturbed drive in the worst conditions (docs/tolerance.md), below the 0.3 at which
# the filter assumes that something has stepped. Allowance.
_NIS = 0.1
# The estimators hold R_s within this range, relative to their parameter; no winding comes to its ends.
_RESISTANCE_RANGE = (0.4, 2.0)


def identified_doubts(
    found: Mapping[str, NDArray[Any]], known: NDArray[np.bool_], R_s: float
) -> Iterator[str]:
    """Doubts about the log in words, by resistance and innovation of the rows with an estimate; `R_s`: of the
    motor, with the bridge's where it is identified."""
    if not known.any():
        return
    last = found["R_s"][known]
    ratio = float(np.median(last[-max(1, round(_END * len(last))) :])) / R_s
    least, most = _RESISTANCE_RANGE
    if ratio < least * (1.0 + _AT_END) or ratio > most * (1.0 - _AT_END):
        yield (
            f"the resistance ends at {ratio:.2g} times the motor's, where its range ends: voltage or current "
            f"of another scale, a delay, or R_s of another motor?"
        )
    nis = float(np.median(found["nis"][known]))
    if nis > _NIS:
        yield (
            f"the filter's normalised innovation squared is {nis:.2g} in the median, in a drive that fits "
            f"its parameters up to 0.04: speed, torque and confidence are doubtful"
        )
