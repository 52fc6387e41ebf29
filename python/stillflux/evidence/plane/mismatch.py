"""The machine is not what the drive was told."""

from __future__ import annotations

from functools import partial

from stillflux.evidence.errors import MISMATCHES, STEPPED
from stillflux.evidence.points import mismatch_cases, mismatch_claims
from stillflux.evidence.target import Target

TARGETS = (
    Target(
        "mismatch",
        30,
        "The machine is not what the drive was told",
        partial(mismatch_cases, "mismatch", [error for error in MISMATCHES if error not in STEPPED]),
        mismatch_claims,
        "confidence",
        "errors",
        ("angle_held", "angle_settled", "r_s"),
    ),
)
