"""An offset of 5 % steps in while the drive runs."""

from __future__ import annotations

from functools import partial

from stillflux.evidence.errors import MISMATCHES, STEPPED
from stillflux.evidence.points import mismatch_cases, mismatch_claims
from stillflux.evidence.target import Target

TARGETS = (
    Target(
        "mismatch-stepped",
        31,
        "An offset of 5 % steps in while the drive runs",
        partial(mismatch_cases, "mismatch-stepped", [error for error in MISMATCHES if error in STEPPED]),
        mismatch_claims,
        "confidence-stepped",
        "errors",
        ("angle_held", "angle_settled", "r_s"),
    ),
)
