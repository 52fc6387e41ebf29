"""Writes the committed table into the documents: what they say was measured is nowhere else.

Between two markers in a Markdown file stands what this module makes of the table:

    <!-- table: NAME -->
    (one of `TABLES`)
    <!-- end -->

    text <!-- value: KIND, NAME, MACHINE, SCHEME: QUANTITY -->12 %<!-- end --> text
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast, get_args

import numpy as np

from stillflux.evidence import plane_points
from stillflux.evidence.commissioning import STATED
from stillflux.evidence.conditions import SCHEMES
from stillflux.evidence.courses import COURSES
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.errors import ERRORS
from stillflux.evidence.guarantee import (
    ENDED,
    GO_ON,
    LONGEST_ANGLE,
    LONGEST_SPEED,
    NEEDLESSLY,
    RUNS,
    SCALES,
    WITHOUT,
)
from stillflux.evidence.guarantee import rerun as rerun_guarantee
from stillflux.evidence.machines import ALL_MACHINES, MACHINES
from stillflux.evidence.population import DRAWN
from stillflux.evidence.registry import experiments, figures, operations, targets
from stillflux.evidence.sensitivity import FIGURES as OF_MARGINS
from stillflux.evidence.sensitivity import LESS, MORE, Margin
from stillflux.evidence.table import (
    BEYOND_MODEL,
    COMMISSIONING,
    DRAWS,
    LOST_AFTER,
    Group,
    Kind,
    Line,
    Table,
    guarantee_at,
)
from stillflux.evidence.tolerance import EXCURSIONS, MISSES, NEEDLESS, interval, rerun

__all__ = ["DOCUMENTS", "PLANE", "TABLES", "draw_plane", "drawn_from", "rendered", "tests_named", "update"]

DOCUMENTS = (
    Path("README.md"),
    Path("docs/figures.md"),
    Path("docs/beyond.md"),
    Path("docs/limits.md"),
    Path("docs/tolerance.md"),
    Path("docs/operations.md"),
    Path("docs/commissioning.md"),
)
"""The files that hold tables, from the root of the project."""

PLANE = Path("docs/plane.png")
"""The map in the README, drawn from `plane_points.FILE`."""
README_MACHINES = MACHINES
_TABLE = re.compile(r"(<!-- table: (?P<name>[^>]*?) -->\n).*?(<!-- end -->)", re.DOTALL)
_VALUE = re.compile(r"(<!-- value: (?P<group>[^:>]*): (?P<quantity>[^>]*?) -->).*?(<!-- end -->)", re.DOTALL)
_SIGNS = {"at most": "≤", "at least": "≥", "equal": "="}
_UNKNOWN = "–"


def rendered(text: str, table: Table) -> str:
    """A document with everything between its markers made anew.

    Raises ValueError for a marker that names no table, KeyError for one that names no line.
    """

    def filled(match: re.Match[str]) -> str:
        if match["name"] not in TABLES:
            raise ValueError(f"there is no table {match['name']}; there are {', '.join(TABLES)}")
        return f"{match[1]}{TABLES[match['name']](table)}\n{match[3]}"

    def valued(match: re.Match[str]) -> str:
        kind, name, machine, scheme = match["group"].split(", ")
        if kind not in get_args(Kind):
            raise ValueError(f"kind = {kind}: there are {', '.join(get_args(Kind))}")
        line = table.get((cast(Kind, kind), name, machine, scheme), match["quantity"])
        return f"{match[1]}{value(line)}{match[4]}"

    return _VALUE.sub(valued, _TABLE.sub(filled, text))


def update(root: Path, table: Table) -> list[Path]:
    """Brings the documents below `root` up to date; returns those that were not."""
    stale = []
    for document in DOCUMENTS:
        path = root / document
        text = path.read_text(encoding="utf-8")
        fresh = rendered(text, table)
        if fresh != text:
            path.write_text(fresh, encoding="utf-8")
            stale.append(document)
    return stale


def draw_plane(root: Path, points: Path) -> list[Path]:
    """Draws the maps of `README_MACHINES` below `root` from the committed points, as far as there are any,
    unless the picture there is of the same; returns what was drawn."""
    from stillflux.evidence.report import maps

    chosen = [point for point in plane_points.read(points) if point.machine in README_MACHINES]
    path = root / PLANE
    digest = plane_points.digest(points) if chosen else ""
    if not chosen or (path.exists() and drawn_from(path) == digest):
        return []
    maps.plane(chosen).savefig(path, dpi=90, metadata={"Description": digest, "Software": None})
    return [PLANE]


def drawn_from(path: Path) -> str:
    """The digest of the points that a picture was drawn from."""
    from PIL import Image

    with Image.open(path) as image:
        return str(image.info.get("Description", ""))


# Cells.


def value(line: Line | None) -> str:
    """What a line says: the number with its unit."""
    if line is None:
        return _UNKNOWN
    if line.direction == "boolean":
        return "yes" if line.number else "no"
    if not math.isfinite(line.number):
        return "lost" if line.unit == "°" else "never"
    bound = float(line.bound) if line.direction in _SIGNS else math.inf
    return f"{_number(line.number, bound)}{_unit(line)}"


def _number(x: float, bound: float = math.inf) -> str:
    """Two digits, a large number or a count in full, never with an exponent; three where two would show it on
    another side of the bound."""
    if x == round(x) or abs(x) >= 100.0:
        return str(round(x))
    shown = float(f"{x:.2g}")
    if (shown > bound, shown < bound) != (x > bound, x < bound):
        shown = float(f"{x:.3g}")
    return np.format_float_positional(shown, trim="-")


def _unit(line: Line) -> str:
    if line.unit in ("", "runs"):
        return ""
    return line.unit if line.unit == "°" else f" {line.unit}"


def judged(line: Line | None) -> str:
    """The same, in bold where it is not as it should be."""
    return f"**{value(line)}**" if line is not None and not line.holds else value(line)


def claim(line: Line) -> str:
    """Quantity and bound."""
    if line.direction not in _SIGNS:
        return line.quantity
    return f"{line.quantity} {_SIGNS[line.direction]} {line.bound}{_unit(line)}"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; a bar within a cell is escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


# The paper's figures.


def _lines(
    table: Table, kind: Kind, name: str, schemes: Sequence[str] = SCHEMES[:1]
) -> list[tuple[Line, list[Line | None]]]:
    """Lines of a figure where they are found first, and each at every machine, scheme after scheme."""
    columns = [table.find(kind, name, machine, scheme) for scheme in schemes for machine in MACHINES]
    first: dict[tuple[str, str], Line] = {}
    for column in columns[: len(MACHINES)]:
        for line in column:
            first.setdefault((line.quantity, line.direction), line)
    return [
        (line, [next((x for x in column if (x.quantity, x.direction) == key), None) for column in columns])
        for key, line in first.items()
    ]


def _verdicts(table: Table) -> str:
    """Every claim of every figure, what the other scheme does beside it, its negative control below."""
    rows = []
    count = len(MACHINES)
    for name in figures():
        experiment = experiments()[name]
        found = _lines(table, "figure", name, SCHEMES)
        rows.append([f"**{name}**", f"*{experiment.title}*", *[""] * (2 * count), _verdict(table, name)])
        rows += [["", claim(line), *map(judged, lines), ""] for line, lines in found]
        rows.append(["", *_control(table, name), *[""] * (count + 1)])
    beside = [f"{machine} {SCHEMES[1]}" for machine in MACHINES]
    return markdown(["fig.", "must show", *MACHINES, *beside, "verdict"], rows)


def _verdict(table: Table, name: str) -> str:
    """As `reproduce.judge` has it, at the machine where it is worst: a claim that fails without a documented
    reason, or a negative control that does not fail as it must, leaves nothing reproduced."""
    experiment = experiments()[name]
    for machine in filter(experiment.at, MACHINES):
        control = table.find("control", name, machine)
        if not table.find("figure", name, machine) or bool(control) != (experiment.control is not None):
            return _UNKNOWN
    if _unexplained(table, name):
        return "**FAILED**"
    failing = any(not line.holds for m in MACHINES for line in table.find("figure", name, m))
    return "limit" if failing else "reproduced"


def _control(table: Table, name: str) -> list[str]:
    """What the negative control leaves out, and what fails then at each machine."""
    control = experiments()[name].control
    if control is None:
        return [f"no control found: {experiments()[name].no_control}", *[""] * len(MACHINES)]
    return [f"control: {control.text}", *(_failure(table, name, machine) for machine in MACHINES)]


def _failure(table: Table, name: str, machine: str) -> str:
    """What a negative control fails, and when it was lost, if it was."""
    lines = table.find("control", name, machine)
    if not lines:
        return _UNKNOWN
    failed, lost = (next(x for x in lines if (x.quantity == LOST_AFTER) == when) for when in (False, True))
    when = f"lost at {lost.value} s" if math.isfinite(lost.number) else f"{failed.quantity}: {value(failed)}"
    return when if failed.holds and lost.holds else f"**{when}: does not fail as it must**"


def _limits(table: Table) -> str:
    """Why claims are not met, and which fail without a documented reason."""
    texts = []
    for name in figures():
        experiment = experiments()[name]
        for reason in dict.fromkeys(limit.reason for limit in experiment.limits.values()):
            texts.append(f"**Fig. {name}.** {reason}")
        unexplained = _unexplained(table, name)
        if unexplained:
            where = "; ".join(
                f"{x.machine}, {'control, ' * (x.kind == 'control')}{claim(x)}" for x in unexplained
            )
            texts.append(f"**Fig. {name}** fails without a documented reason: {where}.")
    return "\n\n".join(texts) or "None: every claim holds at both machines, under each realisation."


def _unexplained(table: Table, name: str) -> list[Line]:
    """Claims of a figure that fail and that no limit explains, and negative controls that do not fail as they
    must."""
    limits = experiments()[name].limits
    excused = {(machine, quantity) for machine, limit in limits.items() for quantity in limit.quantities}
    failing = [line for m in MACHINES for line in table.find("figure", name, m) if not line.holds]
    controls = [line for m in MACHINES for line in table.find("control", name, m) if not line.holds]
    return [line for line in failing if (line.machine, line.quantity) not in excused] + controls


def _margins(machine: str, table: Table) -> str:
    """How far each parameter may be off."""

    def cell(figure: str, error: str) -> str:
        group: Group = ("margin", figure, machine, SCHEMES[0])
        found = {line.quantity: line.number for line in table.find(*group)}
        kind = ERRORS[error]
        if f"{error}{MORE}" not in found:
            return _UNKNOWN
        sides = [found.get(f"{error}{side}") for side in (LESS, MORE)]
        down, up = (None if x is None else round(x / kind.scale, 9) for x in sides)
        return str(Margin(figure, machine, error, down, up or 0.0))

    rows = [[error, *(cell(figure, error) for figure in OF_MARGINS)] for error in ERRORS]
    return markdown([f"{machine}: real value off by", *(f"Fig. {figure}" for figure in OF_MARGINS)], rows)


@dataclass(frozen=True)
class Shown:
    """A row of a table in the README: some quantities of a figure or target, and the test that checks
    them."""

    text: str
    name: str
    quantities: tuple[str, ...]
    test: str
    """File and function in `tests`."""


_FIGURE = "test_figures.py::test_figure"
_AROUND_ZERO = (
    Shown("9 start with offset", "9", ("û_off, deviation from the true offset",), _FIGURE),
    Shown(
        "10 estimator off: circle round, angle wrong",
        "10",
        ("ripple of |ψ̂_s|", "field angle error over u_0/(ω_s ψ)"),
        _FIGURE,
    ),
    Shown("13b r_s + 25 % at 30 % load", "13b", ("time until r̂_s is within 5 %",), _FIGURE),
    Shown(
        "15 ω = 0.023 with offset",
        "15",
        ("mean field angle error", "û_off, deviation from the true offset"),
        _FIGURE,
    ),
    Shown(
        "15 with 250 mV",
        "15-250mV",
        ("mean field angle error", "û_off, deviation from the true offset"),
        _FIGURE,
    ),
    Shown("18 a minute at ω_s = 0, rated step", "18", ("field angle error meanwhile",), _FIGURE),
    Shown(
        "19 120 % step at zero speed",
        "19",
        ("speed back within ±0.002 pu after the 120 % step", "field angle error from 1 s after the step"),
        _FIGURE,
    ),
    Shown(
        "20 regeneration at ω = 0.003",
        "20",
        ("time of regeneration", "field angle error meanwhile"),
        _FIGURE,
    ),
)


def _around_zero(table: Table) -> str:
    """The figures about zero frequency."""
    rows = []
    for row in _AROUND_ZERO:
        found = [(x, lines) for x, lines in _lines(table, "figure", row.name) if x.quantity in row.quantities]
        asked = ", ".join(claim(line) for line, _ in found)
        # A quantity with two bounds has one value.
        cells = [
            ", ".join(dict.fromkeys(judged(lines[k]) for _, lines in found)) for k in range(len(MACHINES))
        ]
        rows.append([row.text, asked, *cells, _left_out(table, row.name), f"`{row.test}`"])
    return markdown(["figure", "must show", *MACHINES, "negative control, which fails", "test"], rows)


def _left_out(table: Table, name: str) -> str:
    """What a negative control leaves out, and in bold where it does not fail as it must."""
    control = experiments()[name].control
    if control is None:
        return "none found"
    machines = list(filter(experiments()[name].at, MACHINES))
    lines = {machine: table.find("control", name, machine) for machine in machines}
    unknown = [machine for machine in machines if not lines[machine]]
    passing = [machine for machine in machines if not all(line.holds for line in lines[machine])]
    text = control.text
    if unknown:
        text += f" ({_UNKNOWN} at {', '.join(unknown)})"
    if passing:
        text += f" (**does not fail as it must at {', '.join(passing)}**)"
    return text


def _headline(table: Table) -> str:
    """The run of the demo."""
    rows = [
        [claim(line), *map(judged, lines), f"`{_FIGURE}`"]
        for line, lines in _lines(table, "figure", "headline")
        if line.direction != "boolean"
    ]
    text, *cells = _control(table, "headline")
    rows.append([f"*{text}*", *(f"*{cell}*" for cell in cells), f"`{_FIGURE}`"])
    return markdown(["", *MACHINES, "test"], rows)


# The plane.

_COLUMNS = tuple((machine, scheme) for machine in ALL_MACHINES for scheme in SCHEMES)
_HEAD = tuple(f"{machine} {scheme}" for machine, scheme in _COLUMNS)
_MET, _LOST = "runs that meet the target", "runs lost"


def _counts(table: Table, names: Sequence[str], machine: str, scheme: str) -> str:
    """Runs that meet targets, of all, and in brackets those that are lost."""
    met = runs = lost = 0
    for name in names:
        lines = {line.quantity: line for line in table.find("target", name, machine, scheme)}
        if _MET in lines:
            met += round(lines[_MET].number)
            runs += round(float(lines[_MET].bound))
            lost += round(lines[_LOST].number)
    if not runs:
        return _UNKNOWN
    return f"{met} of {runs} ({lost})" if met < runs else f"all {runs} (0)"


def _cell(table: Table, name: str, machine: str, scheme: str, quantity: str) -> Line | None:
    try:
        return table.get(("target", name, machine, scheme), quantity)
    except KeyError:
        return None


@dataclass(frozen=True)
class Counted:
    """A row of the README's table of the plane."""

    text: str
    names: tuple[str, ...]
    test: str
    quantity: str = ""
    """What to show the worst of; empty: how many runs meet the target."""


_NO_WORSE = "test_beyond.py::test_target_is_no_worse_than_the_committed_table"
_PLANE_HELD = "test_beyond.py::test_the_whole_plane_is_held_as_the_readme_says"
_TRANSIENTS = ("transient-torque", "transient-load", "transient-reversal", "transient-weakening")
_PLANE = (
    Counted("plane: speed ±0.1 by torque ±1.2 T_N, 20 s each", ("plane-ramps",), _PLANE_HELD),
    Counted(
        "&emsp;largest angle error away from ω_s = 0", ("plane-ramps",), _PLANE_HELD, "field angle error"
    ),
    Counted("&emsp;a coarse map, each point under five seeds", ("plane-seeds",), _NO_WORSE),
    Counted(
        "the same, 1 % offset appears while running",
        ("plane-drift",),
        "test_beyond.py::test_an_offset_that_appears_once_running_is_found",
    ),
    Counted("load at rest before the first turn", ("plane-rest",), _NO_WORSE),
    Counted("reversals 0.1 → −0.1 at ±T_N in 20 s and 60 s", ("crossing",), _NO_WORSE),
    Counted("ten minutes at ω_s = 0 without load, drifting; rated step", ("persistence-no-load",), _NO_WORSE),
    Counted(
        "±T_N kept at ω_s = 0: 15° passed after (of 120 s)",
        ("persistence-rated",),
        _NO_WORSE,
        "time with an angle error below 15°",
    ),
    Counted(
        "ten minutes of ±T_N where ω_s would be 0, flux shifted: largest angle error",
        ("persistence-shifted",),
        _NO_WORSE,
        "field angle error",
    ),
    Counted("one parameter wrong (17 errors, 6 points)", ("mismatch",), _NO_WORSE),
    Counted("reversal −1 → 1, field weakening to ±2, ±120 % steps, torque steps", _TRANSIENTS, _NO_WORSE),
    Counted("start on a coasting, demagnetised machine, −1 … 1", ("flying",), _NO_WORSE),
    Counted(
        "angle errors beyond 15°",
        ("confidence",),
        "test_beyond.py::test_confidence_is_judged_through_a_loss",
        "excursions beyond 15°",
    ),
    Counted(
        "&emsp;that the confidence had not announced",
        ("confidence",),
        "test_beyond.py::test_confidence_is_judged_through_a_loss",
        "excursions not announced",
    ),
)


def _plane(table: Table) -> str:
    """Both schemes over the plane."""
    rows = []
    for row in _PLANE:
        cells = [
            value(_cell(table, row.names[0], *column, row.quantity))
            if row.quantity
            else _counts(table, row.names, *column)
            for column in _COLUMNS
        ]
        rows.append([row.text, *cells, f"`{row.test}`"])
    return markdown(["runs that meet their target (lost)", *_HEAD, "test"], rows)


def _targets(table: Table) -> str:
    """Every target, and the worst of every claim."""
    verdicts = dict.fromkeys(target.verdict for target in targets().values() if target.verdict)
    rows = []
    for name in [*targets(), *verdicts]:
        counted = name in targets()
        if counted:
            rows.append([f"`{name}`", *(_counts(table, (name,), *column) for column in _COLUMNS)])
        else:
            rows.append([f"`{name}`", *[""] * len(_COLUMNS)])
        found: dict[tuple[str, str], Line] = {}
        for column in _COLUMNS:
            for line in table.find("target", name, *column):
                if line.quantity not in (_MET, _LOST):
                    found.setdefault((line.quantity, line.direction), line)
        rows += [
            [f"&emsp;{claim(line)}", *(judged(_cell(table, name, *column, quantity)) for column in _COLUMNS)]
            for (quantity, _), line in found.items()
        ]
    return markdown(["target", *_HEAD], rows)


# Drawn installations.

_ENHANCED = SCHEMES[-1]
_LOSS = re.compile(r"draw (?P<draw>\d+) lost at")


def _losses(lines: Iterable[Line]) -> list[Line]:
    return [line for line in lines if _LOSS.fullmatch(line.quantity)]


def _draws(lines: Iterable[Line]) -> int:
    return sum(round(line.number) for line in lines if line.quantity == DRAWS)


def _rate(lines: Sequence[Line]) -> str:
    """Runs lost of all, with the 95 % interval; in bold where the rate misses its target."""
    runs, lost = _draws(lines), len(_losses(lines))
    if not runs:
        return _UNKNOWN
    low, high = (100.0 * x for x in interval(lost, runs))
    text = f"{lost} of {runs} ({_number(low)} … {_number(high)} %)"
    return text if all(line.holds for line in lines) else f"**{text}**"


def _tolerance(table: Table, plant: str = "") -> str:
    """Rates of loss by course and drive."""
    rows = []
    for name, course in COURSES.items():
        by = [table.find("tolerance", name + plant, machine, _ENHANCED) for machine in DRIVES]
        target = _UNKNOWN if course.target is None else f"{course.target:g} %"
        together = [line for lines in by for line in lines]
        rows.append([f"{course.title} (`{name}`)", target, *map(_rate, by), _rate(together)])
    return markdown(["lost of all draws", "target", *DRIVES, "all"], rows)


def _population(table: Table) -> str:
    """The same of drives of which each draw has another one."""
    rows = []
    for name, course in COURSES.items():
        lines = table.find("tolerance", name, DRAWN, _ENHANCED)
        kept = next((x for x in lines if x.quantity == "largest angle error of the runs kept"), None)
        target = _UNKNOWN if course.target is None else f"{course.target:g} %"
        rows.append([f"{course.title} (`{name}`)", target, _rate(lines), value(kept)])
    return markdown(["lost of all drives", "target", "lost", "largest angle error of runs kept"], rows)


def _tolerance_angles(table: Table) -> str:
    """Largest angle error of the runs that were kept."""
    rows = []
    for name, course in COURSES.items():
        cells = []
        for machine in DRIVES:
            lines = table.find("tolerance", name, machine, _ENHANCED)
            found = [line for line in lines if line.quantity == "largest angle error of the runs kept"]
            cells.append(value(found[0] if found else None))
        rows.append([course.title, *cells])
    return markdown(["largest angle error of runs kept", *DRIVES], rows)


def _tolerance_confidence(table: Table) -> str:
    """What the confidence announced over all draws, by drive."""
    rows = []
    for machine in DRIVES:
        lines = [line for name in COURSES for line in table.find("tolerance", name, machine, _ENHANCED)]
        by = {
            q: [line.number for line in lines if line.quantity == q] for q in (EXCURSIONS, MISSES, NEEDLESS)
        }
        excursions, misses = round(sum(by[EXCURSIONS])), round(sum(by[MISSES]))
        # Courses differ in length: the largest share of any stands for all of them.
        needless = f"{_number(max(by[NEEDLESS]))} %" if by[NEEDLESS] else _UNKNOWN
        rows.append([machine, str(excursions), str(excursions - misses), needless])
    head = ["drive", "excursions beyond 15°", "announced", "needless alarms, part of the time, worst course"]
    return markdown(head, rows)


def _tolerance_losses(table: Table, plant: str = "", machines: Iterable[str] = tuple(DRIVES)) -> str:
    """Every loss, and how to run it again."""
    rows = [
        [
            machine,
            name,
            line.seed,
            value(line),
            line.run,
            f"`{rerun(machine, name, int(line.seed), _ENHANCED, bool(plant))}`",
        ]
        for name in COURSES
        for machine in machines
        for line in _losses(table.find("tolerance", name + plant, machine, _ENHANCED))
    ]
    return markdown(["drive", "course", "draw", "lost at", "by", "run again"], rows)


def _consistency(table: Table, plant: str = "") -> str:
    """NEES, NIS, rank correlation, and the truth of the confidence; a quantity with two bounds in one row."""
    by = {m: table.find("consistency", "consistency" + plant, m, _ENHANCED) for m in DRIVES}
    rows = []
    for quantity in dict.fromkeys(line.quantity for lines in by.values() for line in lines):
        cells = [[x for x in lines if x.quantity == quantity] for lines in by.values()]
        bounds = [claim(x).removeprefix(quantity) for x in next(filter(None, cells))]
        # That which misses its bound, if any does.
        shown = (min(lines, key=lambda x: x.holds, default=None) for lines in cells)
        rows.append([quantity + ",".join(bounds), *map(judged, shown)])
    return markdown(["", *DRIVES], rows)


def _guarantee(table: Table) -> str:
    """Runs that go on lost, and what supervision costs, by scale and drive."""
    rows = []
    for scale in SCALES:
        by = {m: table.find("guarantee", guarantee_at(scale), m, _ENHANCED) for m in DRIVES}
        for quantity in (RUNS, GO_ON, WITHOUT, ENDED, NEEDLESSLY, LONGEST_SPEED, LONGEST_ANGLE):
            found = [next((x for x in by[m] if x.quantity == quantity), None) for m in DRIVES]
            measured = [line for line in found if line is not None]
            together = _UNKNOWN
            if measured:
                of_all = max if measured[0].unit else sum
                together = f"{_number(of_all(x.number for x in measured))}{_unit(measured[0])}"
            if measured and quantity == GO_ON:
                runs = sum(round(x.number) for m in DRIVES for x in by[m] if x.quantity == RUNS)
                low, high = (100.0 * x for x in interval(int(together), runs))
                together += f" ({_number(low)} … {_number(high)} %)"
            rows.append([f"{scale:g} times: {quantity}", *map(judged, found), together])
    return markdown(["", *DRIVES, "all"], rows)


def _guarantee_runs(table: Table) -> str:
    """Every run that goes on lost or is ended needlessly, and how to run it again."""
    rows = []
    for scale in SCALES:
        for machine in DRIVES:
            lines = table.find("guarantee", guarantee_at(scale), machine, _ENHANCED)
            for line in (x for x in lines if x.seed):
                what = line.quantity.removeprefix(f"draw {line.seed} of {line.run} ")
                seconds = f", {value(line)}" if line.number else ""
                again = rerun_guarantee(machine, line.run, int(line.seed), scale)
                rows.append([machine, line.run, f"{scale:g}", line.seed, what + seconds, f"`{again}`"])
    return markdown(["drive", "course", "times", "draw", "what", "run again"], rows)


def _operations(table: Table) -> str:
    """What was asked, and the worst over the drives of what happened."""
    rows = []
    for name, operation in operations().items():
        for scheme in operation.schemes:
            by = {m: table.find("operation", name, m, scheme) for m in operation.machines}
            for quantity, direction in dict.fromkeys(
                (x.quantity, x.direction) for lines in by.values() for x in lines
            ):
                lines = [
                    x for ls in by.values() for x in ls if (x.quantity, x.direction) == (quantity, direction)
                ]
                worst = max(lines, key=lambda x: x.excess)
                held = f"{sum(x.holds for x in lines)} of {len(lines)}"
                rows.append(
                    [
                        f"{operation.asked} (`{name}`)",
                        scheme,
                        claim(worst),
                        judged(worst),
                        worst.machine,
                        held,
                    ]
                )
    return markdown(["asked", "scheme", "what must happen", "worst", "at", "drives"], rows)


def _temperature(table: Table) -> str:
    """Speed and torque, cold and hot, of the operations that heat a machine up."""
    of = [
        (f"temperature-{course}", f"{quantity} {state}, of rated")
        for quantity, courses in (
            ("speed error", ("motoring", "regenerating")),
            ("torque deviation", ("torque", "torque-regenerating")),
        )
        for course in courses
        for state in ("cold", "hot")
    ]
    rows = []
    for drive in DRIVES:
        found = [
            next(
                (x for x in table.find("operation", name, drive, SCHEMES[1]) if x.quantity == quantity), None
            )
            for name, quantity in of
        ]
        rows.append(
            [drive, *(f"{judged(a)}, {judged(b)}" for a, b in zip(found[::2], found[1::2], strict=True))]
        )
    head = [f"{what}, {way}" for what in ("speed", "torque") for way in ("motoring", "regenerating")]
    return markdown(["cold, hot", *head], rows)


_FOUND = {
    "R_s + r_d": "R_s + r_d",
    "bridge curve": "curve of the bridge from 2 to 120 % of the rated peak current, of the dead-time voltage",
    "c_out": "capacitance of a leg",
    "L_sigma": "L_σ",
    "R_R": "R_R",
    "L_M(ψ)": "L_M(ψ) from half to 1.1 of rated flux",
    "J": "J",
    "legs": "delays of the legs, rms of the six",
}


def _commissioning(table: Table) -> str:
    lines = {line.quantity: line for line in table.find(*COMMISSIONING)}

    def row(name: str, text: str) -> list[str]:
        median, most = (lines.get(f"{name}, {of}") for of in ("median error", "95 % of the draws within"))
        limits = [line.bound for line in (median, most) if line is not None and line.bound]
        cells = (median, most, lines.get(f"{name}, largest error"), lines.get(f"{name}, {STATED}"))
        return [
            text,
            *map(value, cells[:3]),
            f"{', '.join(limits)} %" if limits else _UNKNOWN,
            value(cells[3]),
        ]

    head = [
        "error",
        "median",
        "95 % of the draws within",
        "largest",
        "limit of median and 95 %",
        STATED,
    ]
    return markdown(head, (row(*of) for of in _FOUND.items()))


TABLES: Mapping[str, Callable[[Table], str]] = {
    "headline": _headline,
    "plane": _plane,
    "around-zero": _around_zero,
    "verdicts": _verdicts,
    "limits": _limits,
    "sensitivity-2.2kW": partial(_margins, "2.2kW"),
    "sensitivity-11kW": partial(_margins, "11kW"),
    "targets": _targets,
    "tolerance": _tolerance,
    "tolerance-angles": _tolerance_angles,
    "population": _population,
    "population-losses": partial(_tolerance_losses, machines=(DRAWN,)),
    "tolerance-confidence": _tolerance_confidence,
    "tolerance-losses": _tolerance_losses,
    "consistency": _consistency,
    "tolerance-beyond-model": partial(_tolerance, plant=BEYOND_MODEL),
    "tolerance-beyond-model-losses": partial(_tolerance_losses, plant=BEYOND_MODEL),
    "consistency-beyond-model": partial(_consistency, plant=BEYOND_MODEL),
    "guarantee": _guarantee,
    "guarantee-runs": _guarantee_runs,
    "operations": _operations,
    "temperature": _temperature,
    "commissioning": _commissioning,
}
"""By the name in the marker."""


def tests_named() -> set[str]:
    """The tests that rows of the README name."""
    return {_FIGURE, *(row.test for row in _AROUND_ZERO), *(row.test for row in _PLANE)}
