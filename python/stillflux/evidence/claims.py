"""A claim: a quantity, what the plant's truth says about it, and the bound it is held against."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

__all__ = [
    "Claim",
    "Direction",
    "Key",
    "at_least",
    "at_most",
    "equal",
    "holds",
    "reported",
    "worst",
    "worst_of_runs",
]

Direction: TypeAlias = Literal["at most", "at least", "equal", "boolean", "reported"]
"""How a value is held against its bound; "boolean": both are 0 or 1, and the bound is 1; "reported": a number
worth knowing that is held against nothing."""

Key: TypeAlias = tuple[str, Direction]
"""What makes two claims the same claim: quantity and direction."""

_SIGNS: Mapping[Direction, str] = {"at most": " ≤ ", "at least": " ≥ ", "equal": " = "}


@dataclass(frozen=True)
class Claim:
    """One claim about one run, or the worst of several."""

    quantity: str
    """What is measured."""
    value: float
    """What the plant's truth says; 0 or 1 if it is no number."""
    bound: float
    """What it is held against."""
    direction: Direction
    unit: str = ""
    of_motor: bool = True
    """Whether it is about how the motor runs; False: about an inner quantity of the drive."""
    note: str = ""
    """What the value alone does not say, such as the name of a fault."""
    run: str = ""
    """Which of several runs it was measured in."""
    seed: int | None = None
    """Of the noise it was measured under; None: there is no noise."""

    @property
    def excess(self) -> float:
        """How far the value is on the failing side of its bound; not positive: the claim holds."""
        if self.direction == "reported":
            return 0.0
        if math.isnan(self.value):
            return math.inf
        if self.direction == "at most":
            return self.value - self.bound
        if self.direction == "equal":
            return abs(self.value - self.bound)
        return self.bound - self.value

    @property
    def ok(self) -> bool:
        """Whether the claim holds."""
        return self.excess <= 0.0

    @property
    def key(self) -> Key:
        """What makes it the same claim in another run."""
        return self.quantity, self.direction

    @property
    def text(self) -> str:
        """Quantity and bound for the reader."""
        if self.direction not in _SIGNS:
            return self.quantity
        return f"{self.quantity}{_SIGNS[self.direction]}{self.bound:.3g}{self._unit}"

    @property
    def measured(self) -> str:
        """The value for the reader."""
        if self.direction == "boolean":
            return self.note or ("yes" if self.value else "no")
        return f"{self.value:.3g}{self._unit}{f' ({self.note})' if self.note else ''}"

    @property
    def _unit(self) -> str:
        return self.unit if self.unit in ("", "°") else f" {self.unit}"

    def inner(self) -> Claim:
        """The same, about an inner quantity of the drive."""
        return replace(self, of_motor=False)


def at_most(quantity: str, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
    """Claims `value <= bound`."""
    return Claim(quantity, float(value), float(bound), "at most", unit, note=note)


def at_least(quantity: str, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
    """Claims `value >= bound`."""
    return Claim(quantity, float(value), float(bound), "at least", unit, note=note)


def equal(quantity: str, value: float, bound: float, unit: str = "", note: str = "") -> Claim:
    """Claims `value == bound`, of something that is counted."""
    return Claim(quantity, float(value), float(bound), "equal", unit, note=note)


def holds(quantity: str, value: bool, note: str = "") -> Claim:
    """Claims that something is so."""
    return Claim(quantity, float(value), 1.0, "boolean", note=note)


def reported(quantity: str, value: float, unit: str = "", note: str = "") -> Claim:
    """A number worth knowing."""
    return Claim(quantity, float(value), 0.0, "reported", unit, note=note)


def worst(claims: Iterable[Claim]) -> Claim:
    """Of one claim about several runs the one that is furthest on the failing side."""
    return max(claims, key=lambda claim: claim.excess)


def worst_of_runs(runs: Sequence[Sequence[Claim]]) -> list[Claim]:
    """The worst of every claim over several runs of one experiment, in the order of their first occurrence.

    A run that was lost makes fewer claims: each that it does not make counts as one that fails there.
    """
    by: dict[Key, list[Claim]] = {}
    for run in runs:
        for claim in run:
            by.setdefault(claim.key, []).append(claim)
    for run in runs:
        made = {claim.key for claim in run}
        for key in by.keys() - made:
            like, seed = by[key][0], run[0].seed if run else None
            by[key].append(replace(like, value=_failing(like.direction), note="lost before", seed=seed))
    return [worst(group) for group in by.values()]


def _failing(direction: Direction) -> float:
    """The value that fails any bound."""
    return {"at most": math.inf, "at least": -math.inf, "boolean": 0.0}.get(direction, math.nan)
