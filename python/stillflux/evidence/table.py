"""The committed table: what every claim measured, one line each, from which the documents are written.

`kind` says what a line is about: a "figure" of the paper, its negative "control", the "margin" of a
parameter, a "target" of the plane, losses over drawn installations on a course ("tolerance"), the
"consistency" of the estimate over them, the "guarantee" that none of them goes on lost, an "operation"
with its negative control ("without: …"), or what a "commissioning" of drawn motors finds. `value` is the
worst that was found; `run` and `seed` say where: which run of a target it was, and under which
realisation of the noise, empty where there is none; of a figure the realisation of noise and offset
(`seeds.REALISATIONS`), of a loss what was lost and the number of the draw. `ok` says that it is as it
should be: that the claim holds, or, of a control, that it fails for its reason and not before its time.

The closed loop is chaotic where phase currents cross zero, so digits move with the compiler. A line that
agrees with the one there (see `agree`), is of the same run and seed and no worse, is left as it stands: only
real changes show in a diff, and none is better in the table than it was measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from stillflux.evidence import csv_file
from stillflux.evidence.beyond import Summary
from stillflux.evidence.claims import Claim, Direction, at_least
from stillflux.evidence.conditions import SCHEMES
from stillflux.evidence.consistency import Consistency
from stillflux.evidence.courses import COURSES
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.guarantee import SCALES, Found
from stillflux.evidence.machines import ALL_MACHINES
from stillflux.evidence.operate import Performed
from stillflux.evidence.population import DRAWN
from stillflux.evidence.registry import experiments, operations, targets
from stillflux.evidence.reproduce import Outcome
from stillflux.evidence.sensitivity import Margin
from stillflux.evidence.tolerance import Rate
from stillflux.outputs import write_text

__all__ = [
    "BEYOND_MODEL",
    "COMMISSIONING",
    "Group",
    "Kind",
    "Line",
    "Table",
    "agree",
    "guarantee_at",
    "line_of",
    "of_commissioning",
    "of_consistency",
    "of_guarantee",
    "of_margin",
    "of_operation",
    "of_outcome",
    "of_rate",
    "of_summary",
    "shown",
]

Kind: TypeAlias = Literal[
    "figure",
    "control",
    "margin",
    "target",
    "tolerance",
    "consistency",
    "guarantee",
    "operation",
    "commissioning",
]
Group: TypeAlias = tuple[Kind, str, str, str]
"""Kind, name, machine, scheme: lines that are measured together."""

_OF_PAPER, _BEYOND = SCHEMES
DRAWS = "draws"
"""Quantity of a campaign: over how many drawn installations the others of its group are."""
_COUNTED = {"tolerance", "guarantee", "commissioning"}
"""Kinds whose lines count runs, or are of the distribution over them."""
COMMISSIONING: Group = ("commissioning", "commissioning", DRAWN, _BEYOND)
"""What commissionings of drawn motors show."""
LOST_AFTER = "time of the loss, not before the mechanism is needed"
"""Quantity of a control: when it was lost, held against its event."""


@dataclass(frozen=True)
class Line:
    """One line; every field as it is written."""

    kind: Kind
    name: str
    """The figure, the target, or the verdict on the confidence."""
    machine: str
    scheme: str
    quantity: str
    value: str
    bound: str
    direction: Direction
    unit: str
    run: str
    """Which run of a target it is, empty where there is but one."""
    seed: str
    ok: str

    @property
    def group(self) -> Group:
        """What it is measured together with."""
        return self.kind, self.name, self.machine, self.scheme

    @property
    def key(self) -> tuple[Group, str, Direction]:
        """What tells it from every other line."""
        return self.group, self.quantity, self.direction

    @property
    def holds(self) -> bool:
        """Whether it is as it should be."""
        return self.ok == "yes"

    @property
    def number(self) -> float:
        """Its value."""
        return float(self.value)

    @property
    def excess(self) -> float:
        """How far the value is on the failing side of its bound."""
        return Claim(self.quantity, self.number, float(self.bound or 0.0), self.direction).excess


def shown(value: float) -> str:
    """A number to three digits; a count in full."""
    if abs(value) < 1e-9:
        return "0"
    if math.isfinite(value) and value == round(value) and abs(value) < 1e6:
        return str(round(value))
    return f"{float(f'{value:.3g}'):g}"


def line_of(group: Group, claim: Claim, ok: bool | None = None) -> Line:
    """A claim as a line; `ok` where it is not the claim's own."""
    kind, name, machine, scheme = group
    return Line(
        kind,
        name,
        machine,
        scheme,
        claim.quantity,
        shown(claim.value),
        "" if claim.direction == "reported" else f"{claim.bound:g}",
        claim.direction,
        claim.unit,
        claim.run,
        "" if claim.seed is None else str(claim.seed),
        "yes" if (claim.ok if ok is None else ok) else "no",
    )


def of_outcome(outcome: Outcome) -> list[Line]:
    """The lines of a figure and of its negative control."""
    where = (outcome.figure, outcome.machine, _OF_PAPER)
    found = [line_of(("figure", *where), claim) for claim in outcome.claims]
    beside: Group = ("figure", outcome.figure, outcome.machine, _BEYOND)
    found += [line_of(beside, claim) for claim in outcome.enhanced]
    claim = outcome.control_claim
    if claim is not None:
        ok = all(run.ok for run in outcome.control)
        lost = min(run.lost for run in outcome.control)
        found.append(line_of(("control", *where), claim, ok))
        found.append(line_of(("control", *where), at_least(LOST_AFTER, lost, outcome.control[0].event, "s")))
    return found


def of_margin(margin: Margin) -> list[Line]:
    """The lines of how far a parameter may be off."""
    group: Group = ("margin", margin.figure, margin.machine, _OF_PAPER)
    return [line_of(group, claim) for claim in margin.claims]


def of_summary(summary: Summary) -> list[Line]:
    """The lines of a target at one machine under one scheme."""
    group: Group = ("target", summary.name, summary.machine, summary.scheme)
    return [line_of(group, claim) for claim in summary.claims]


BEYOND_MODEL = "-beyond-model"
"""Ends the name of what was measured on plants with `effects`."""


def of_rate(rate: Rate) -> list[Line]:
    """The lines of a drive on a course, over all draws."""
    name = rate.course + (BEYOND_MODEL if rate.beyond_model else "")
    return [line_of(("tolerance", name, rate.machine, rate.scheme), claim) for claim in rate.claims]


def of_consistency(found: Consistency, scheme: str, beyond_model: bool = False) -> list[Line]:
    """The lines of the consistency of the estimate of a drive; `beyond_model`: on plants with `effects`."""
    name = "consistency" + (BEYOND_MODEL if beyond_model else "")
    group: Group = ("consistency", name, found.machine, scheme)
    return [line_of(group, claim) for claim in found.claims]


def guarantee_at(scale: float) -> str:
    """Name of the lines at so many times the tolerances."""
    return f"guarantee-{scale:g}"


def of_guarantee(found: Found, scheme: str) -> list[Line]:
    """The lines of the guarantee of a drive at one scale."""
    group: Group = ("guarantee", guarantee_at(found.scale), found.machine, scheme)
    return [line_of(group, claim) for claim in found.claims]


def of_operation(found: Performed) -> list[Line]:
    """The lines of an operation at one drive under one scheme, and of its negative control."""
    group: Group = ("operation", found.name, found.machine, found.scheme)
    return [line_of(group, claim) for claim in (*found.claims, *found.without)]


def of_commissioning(claims: Iterable[Claim]) -> list[Line]:
    """The lines of what commissionings show."""
    return [line_of(COMMISSIONING, claim) for claim in claims]


def agree(old: Line, new: Line) -> bool:
    """Whether two lines say the same: equal, or within 30 % or 5 % of the bound where both are as they should
    be."""
    if (old.ok, old.bound, old.unit) != (new.ok, new.bound, new.unit):
        return False
    if old.value == new.value or not new.holds:
        return old.value == new.value
    if not (math.isfinite(old.number) and math.isfinite(new.number)):
        return False
    margin = max(0.3 * abs(old.number), 0.05 * abs(float(new.bound or 0.0)))
    return abs(old.number - new.number) <= margin


def _stands(old: Line, new: Line) -> bool:
    """Whether a line may stay although it was measured anew. Counts and rates of a campaign are those of one
    measurement: an interval of three losses beside a rate of four would be neither."""
    if new.kind in _COUNTED and new.unit in {"", "%"}:
        return False
    same = (old.run, old.seed) == (new.run, new.seed) and agree(old, new)
    return same and old.excess >= new.excess


class Table:
    """The lines, each group together, in the order of figures and targets."""

    def __init__(self, lines: Iterable[Line] = ()) -> None:
        self.lines = list(lines)
        self._groups: dict[Group, list[Line]] = {}
        for line in self.lines:
            self._groups.setdefault(line.group, []).append(line)

    @classmethod
    def read(cls, path: Path) -> Table:
        """From a file; empty if there is none. Raises ValueError naming file and line for one that is none of
        this kind."""
        return cls(csv_file.read(path, _COLUMNS, "line of this table", _line))

    def write(self, path: Path) -> None:
        """To a file, whole or not at all."""
        write_text(path, self.text())

    def text(self) -> str:
        """As CSV."""
        return csv_file.text(_COLUMNS, ([getattr(line, name) for name in _COLUMNS] for line in self.lines))

    def updated(self, fresh: Sequence[Line]) -> Table:
        """With groups that were measured anew in place of theirs; a group that no longer exists goes."""
        known = {line.key: line for line in self.lines}
        measured = {line.group for line in fresh}
        # A figure is measured together with its negative control and the other scheme, if it has them.
        for kind, name, machine, _ in tuple(measured):
            if kind == "figure":
                measured |= {("control", name, machine, _OF_PAPER), ("figure", name, machine, _BEYOND)}
        kept = [line for line in self.lines if line.group not in measured]
        # A group that was measured over another number of draws is taken as a whole.
        others = {x.group for x in fresh if x.quantity == DRAWS and known.get(x.key, x).value != x.value}
        standing = {
            x.key for x in fresh if x.key in known and x.group not in others and _stands(known[x.key], x)
        }
        renewed = [known[x.key] if x.key in standing else x for x in fresh]
        groups: dict[Group, list[Line]] = {}
        for line in [*kept, *renewed]:
            groups.setdefault(line.group, []).append(line)
        return Table(line for group in order() for line in groups.get(group, []))

    def find(self, kind: Kind, name: str, machine: str, scheme: str = _OF_PAPER) -> list[Line]:
        """The lines of a group."""
        return list(self._groups.get((kind, name, machine, scheme), ()))

    def get(self, group: Group, quantity: str) -> Line:
        """The line of a quantity. Raises KeyError if there is none."""
        for line in self._groups.get(group, ()):
            if line.quantity == quantity:
                return line
        raise KeyError(f"no line {', '.join(group)}: {quantity}")


def update(path: Path, fresh: Iterable[Sequence[Line]]) -> None:
    """Brings a file up to date."""
    Table.read(path).updated([line for group in fresh for line in group]).write(path)


_COLUMNS = tuple(column.name for column in fields(Line))


def _line(row: Sequence[str]) -> Line:
    """Of a line of a file. Raises ValueError or TypeError for what is none."""
    line = Line(*row)  # type: ignore[arg-type]
    float(line.value), float(line.bound or 0.0)
    if line.direction not in get_args(Direction) or line.ok not in ("yes", "no"):
        raise ValueError(f"direction = {line.direction}, ok = {line.ok}")
    return line


def order() -> list[Group]:
    """Every group the table may hold, in its order."""
    found: list[Group] = []
    for name in experiments():
        for machine in ALL_MACHINES:
            found += [("figure", name, machine, _OF_PAPER), ("control", name, machine, _OF_PAPER)]
            found.append(("figure", name, machine, _BEYOND))
    found += [("margin", name, machine, _OF_PAPER) for name in experiments() for machine in ALL_MACHINES]
    verdicts = [target.verdict for target in targets().values() if target.verdict]
    for name in dict.fromkeys([*targets(), *verdicts]):
        found += [("target", name, machine, scheme) for machine in ALL_MACHINES for scheme in SCHEMES]
    for plant in ("", BEYOND_MODEL):
        for machine in (*DRIVES, DRAWN):
            found += [("tolerance", name + plant, machine, scheme) for name in COURSES for scheme in SCHEMES]
    for plant in ("", BEYOND_MODEL):
        name = "consistency" + plant
        found += [("consistency", name, machine, scheme) for machine in DRIVES for scheme in SCHEMES]
    for scale in SCALES:
        name = guarantee_at(scale)
        found += [("guarantee", name, machine, scheme) for machine in DRIVES for scheme in SCHEMES]
    for name in operations():
        found += [("operation", name, machine, scheme) for machine in DRIVES for scheme in SCHEMES]
    found.append(COMMISSIONING)
    return found
