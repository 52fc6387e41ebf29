"""The commands that prove: `demo`, `reproduce`, `beyond`; and `docs`, which writes down what they found."""

from __future__ import annotations

import argparse
import ast
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillflux.evidence.machines import ALL_MACHINES, MACHINES, OwnMachine
from stillflux.machine_file import simulated_guess
from stillflux.outputs import apart, check_file, check_folder, write_text
from stillflux.parameters import PRESETS

if TYPE_CHECKING:
    from stillflux.evidence.journal import Journal

__all__ = ["beyond", "demo", "docs", "reproduce"]


def demo(parser: argparse.ArgumentParser) -> None:
    """Arguments of `demo`."""
    _where(parser, MACHINES)
    parser.set_defaults(run=_demo)


def reproduce(parser: argparse.ArgumentParser) -> None:
    """Arguments of `reproduce`."""
    parser.add_argument("figures", nargs="*", metavar="FIG", help="numbers such as 9, 13b; none: all of them")
    _where(parser, MACHINES)
    parser.add_argument("--json", metavar="FILE", help="write the verdicts there as JSON; -: to stdout")
    parser.add_argument(
        "--sensitivity", action="store_true", help="also how far parameters may be off (minutes)"
    )
    parser.add_argument(
        "--beyond", action="store_true", help="also what `stillflux beyond` measures (minutes)"
    )
    _metrics(parser)
    parser.set_defaults(run=_reproduce)


def beyond(parser: argparse.ArgumentParser) -> None:
    """Arguments of `beyond`."""
    from stillflux.evidence.conditions import SCHEMES
    from stillflux.evidence.courses import COURSES
    from stillflux.evidence.drives import DRIVES
    from stillflux.evidence.population import DRAWN

    parser.add_argument(
        "targets",
        nargs="*",
        metavar="TARGET",
        help="such as plane, plane-drift, mismatch; none: all of them; or alone one of the campaigns over "
        "installations drawn at random, tolerance, consistency, guarantee and commissioning, or operations",
    )
    _where(parser, tuple(dict.fromkeys([*ALL_MACHINES, *DRIVES, DRAWN])))
    drawn = parser.add_argument_group("tolerance, consistency, guarantee and commissioning")
    drawn.add_argument("--draws", type=_count, metavar="N", help="draws of each drive (and course)")
    drawn.add_argument(
        "--first",
        type=_index,
        metavar="K",
        help="the draws from this one on; default: 3000 (commissioning), 0 (the others)",
    )
    drawn.add_argument("--draw", type=_index, action="append", metavar="K", help="only this draw")
    drawn.add_argument(
        "--course",
        choices=COURSES,
        action="append",
        help="only this course (tolerance, guarantee); on this one as well (commissioning)",
    )
    drawn.add_argument(
        "--scale",
        type=_scale,
        action="append",
        help="at so many times the tolerances; default: 1 (tolerance), 1 and 2.5 (guarantee)",
    )
    drawn.add_argument(
        "--beyond-model",
        action="store_true",
        help="plants with what the drive's model does not contain: iron loss, deep bar, saturation of the "
        "leakage, rotor slots, skew and drift of the sensors (tolerance, consistency)",
    )
    drawn.add_argument(
        "--set",
        action="append",
        metavar="NAME=VALUE",
        help="a setting of the drive in place of its default (tolerance)",
    )
    parser.add_argument(
        "--operation",
        action="append",
        metavar="NAME",
        help="only this one (operations), or those that begin so",
    )
    parser.add_argument("--scheme", choices=[*SCHEMES, "all"], default="all", help="default: all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every run there as JSON")
    _metrics(parser)
    parser.set_defaults(run=_beyond)


def docs(parser: argparse.ArgumentParser) -> None:
    """Arguments of `docs`."""
    parser.add_argument(
        "--metrics",
        type=Path,
        metavar="FILE",
        default=Path("tests/metrics.csv"),
        help="the table of what was measured",
    )
    parser.add_argument("--root", type=Path, default=Path(), help="the project's folder")
    parser.set_defaults(run=_docs)


def _where(parser: argparse.ArgumentParser, machines: Sequence[str]) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--machine", choices=[*machines, "all"], default="all", help="default: all")
    which.add_argument(
        "--motor",
        metavar="FILE",
        help=f"your machine instead: a motor file (TOML) or a preset ({', '.join(PRESETS)})",
    )
    parser.add_argument(
        "--arithmetic", choices=["f32", "f64", "q"], default="f32", help="of the drive; default: f32"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("reports"), help="folder for report and plots; default: reports"
    )


def _metrics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--metrics", type=Path, metavar="FILE", help="bring this table of what was measured up to date"
    )
    parser.add_argument(
        "--journal",
        type=Path,
        metavar="FILE",
        help="write runs down there as they are done; if killed, go on with it",
    )


def _chosen(choice: str, choices: Sequence[str]) -> Sequence[str]:
    return choices if choice == "all" else (choice,)


def _machines(options: argparse.Namespace, machines: Sequence[str]) -> Sequence[str]:
    """The machines of a command line: those of the project, or the user's own."""
    if options.motor is None:
        return _chosen(options.machine, machines)
    if options.motor in PRESETS:
        return (options.motor,)
    if getattr(options, "metrics", None):
        raise ValueError("--metrics: the table holds the project's machines, not those of --motor")
    own = OwnMachine.load(options.motor)
    if own.is_guess:
        print(f"stillflux: {simulated_guess(options.motor)}", file=sys.stderr)
    return (own,)


def _check_outputs(options: argparse.Namespace, report: str) -> None:
    """Before a run of minutes: whether what it finds can be written, each file apart from the others, and
    whether the table to be brought up to date is one. Raises OSError or ValueError."""
    from stillflux.evidence import plane_points
    from stillflux.evidence.table import Table

    metrics: Path | None = getattr(options, "metrics", None)
    # Beside the table, of what runs the plane.
    plane = metrics if report in ("beyond.html", "reproduce.html") else None
    points = plane.with_name(plane_points.FILE) if plane else None
    json_file = getattr(options, "json", None)
    files: dict[str, Path | None] = {
        "--motor": None if options.motor is None or options.motor in PRESETS else Path(options.motor),
        "--json": None if json_file in (None, "-") else Path(json_file),
        "--metrics": metrics,
        "the plane of --metrics": points,
        "--journal": getattr(options, "journal", None),
        "report": options.out / report,
    }
    apart(files)
    check_folder(options.out)
    for name, path in files.items():
        if name != "--motor":
            check_file(path)
    if metrics:
        Table.read(metrics)
    if points:
        plane_points.read(points)


def _journal(options: argparse.Namespace, campaign: str) -> Journal | None:
    """The journal of a campaign, if there is to be one. Raises ValueError for a file that is none of it."""
    from stillflux.evidence.journal import Journal

    return Journal(options.journal, campaign) if options.journal else None


def _write_json(path: Path | str, data: Any) -> None:
    """Writes data for machines, whole or not at all."""
    write_text(Path(path), json.dumps(data, indent=1, ensure_ascii=False) + "\n")


def _demo(options: argparse.Namespace) -> int:
    from stillflux.evidence import demo

    machines = _machines(options, MACHINES)
    _check_outputs(options, "demo.html")
    return demo.run(machines, options.out, options.command_line, options.arithmetic)


def _reproduce(options: argparse.Namespace) -> int:
    from stillflux.evidence import beyond, plane_points, reproduce, sensitivity
    from stillflux.evidence.conditions import SCHEMES
    from stillflux.evidence.registry import choose_figures, choose_targets
    from stillflux.evidence.report import figures as report
    from stillflux.evidence.report import plane
    from stillflux.evidence.table import of_margin, of_outcome, of_summary, update
    from stillflux.parallel import Stopped, run_jobs

    machines = _machines(options, MACHINES)
    figures = choose_figures(options.figures)
    _check_outputs(options, "reproduce.html")
    journal = _journal(options, "reproduce")
    runner = journal.run if journal else run_jobs
    arithmetic = options.arithmetic
    stopped = ""
    try:
        outcomes = reproduce.run_all(
            figures, machines, arithmetic, options.out, reproduce.progress, runner=runner
        )
    except Stopped as stop:
        outcomes = reproduce.outcomes(reproduce.whole(stop.results, figures, machines))
        stopped = str(stop)
    margins = []
    if options.sensitivity and not stopped:
        try:
            margins = sensitivity.run_all(figures, machines, arithmetic, sensitivity.progress, runner=runner)
        except Stopped as stop:
            margins, stopped = stop.results, str(stop)
    section, found, rows = "", [], []
    if options.beyond and not stopped:
        wanted = machines if options.motor else _chosen(options.machine, ALL_MACHINES)
        try:
            rows = beyond.run_all(
                choose_targets(()), wanted, SCHEMES, arithmetic, beyond.progress, runner=runner
            )
        except Stopped as stop:
            rows, stopped = stop.results, str(stop)
        section, found = plane.section(rows, options.out), beyond.summaries(rows)
    if options.metrics and not stopped:
        fresh = [of_outcome(x) for x in outcomes] + [of_margin(x) for x in margins]
        update(options.metrics, [*fresh, *map(of_summary, found)])
        plane_points.update(options.metrics.with_name(plane_points.FILE), rows)
    as_json = report.to_json(outcomes)
    if options.json not in (None, "-"):
        write_text(Path(options.json), as_json + "\n")
    path = options.out / "reproduce.html"
    table = sensitivity.to_html(margins) if margins else ""
    report.write(path, options.command_line, outcomes, table, section, stopped)
    if options.json == "-":
        print(as_json)
    else:
        print(report.table(outcomes))
        if margins:
            print(f"\n{sensitivity.to_markdown(margins)}")
    # A table that is brought up to date records a failing verdict; it is not stopped by one.
    failed = any(outcome.verdict == "FAILED" for outcome in outcomes)
    return _ended(path, journal, stopped) or int(failed and not options.metrics)


def _beyond(options: argparse.Namespace) -> int:
    from stillflux.evidence import beyond, plane_points
    from stillflux.evidence.conditions import SCHEMES
    from stillflux.evidence.registry import choose_targets, targets
    from stillflux.evidence.report import page, plane
    from stillflux.evidence.table import of_summary, update
    from stillflux.parallel import Stopped, run_jobs

    drawn = [name for name in options.targets if name in _CAMPAIGNS]
    for option, campaigns in _ONLY_WITH.items():
        value = getattr(options, option)
        if value and not set(campaigns) & set(drawn):
            given = value if isinstance(value, int) else ", ".join(map(str, value))
            name = option.replace("_", "-")
            raise ValueError(f"--{name} = {given}: admissible with {', '.join(campaigns)}")
    if drawn:
        if len(options.targets) > 1:
            raise ValueError(f"TARGET = {' '.join(options.targets)}: {drawn[0]} stands alone")
        _check_outputs(options, f"{drawn[0]}.html")
        return _CAMPAIGNS[drawn[0]](options)
    if options.machine not in ("all", *ALL_MACHINES):
        raise ValueError(f"--machine {options.machine}: admissible here are {', '.join(ALL_MACHINES)}, all")
    machines = _machines(options, ALL_MACHINES)
    schemes = _chosen(options.scheme, SCHEMES)
    chosen = choose_targets(options.targets)
    _check_outputs(options, "beyond.html")
    journal = _journal(options, "beyond")
    runner = journal.run if journal else run_jobs
    stopped = ""
    try:
        rows = beyond.run_all(chosen, machines, schemes, options.arithmetic, beyond.progress, runner=runner)
    except Stopped as stop:
        rows, stopped = stop.results, str(stop)
    found = beyond.summaries(rows)
    if options.metrics and not stopped:
        # A verdict on the confidence is one over all its targets.
        partial = {target.verdict for name, target in targets().items() if name not in chosen}
        update(options.metrics, [of_summary(x) for x in found if x.name not in partial])
        plane_points.update(options.metrics.with_name(plane_points.FILE), rows)
    if options.json:
        _write_json(options.json, page.finite(plane.to_rows(rows)))
    path = options.out / "beyond.html"
    plane.write(path, options.command_line, rows, stopped)
    print(plane.table(found))
    return _ended(path, journal, stopped)


def _count(text: str) -> int:
    """A number of draws. Raises what `argparse` expects."""
    return _whole(text, "draws", 1, 100_000)


def _index(text: str) -> int:
    """Which draw. Raises what `argparse` expects."""
    return _whole(text, "draw", 0, 99_999)


def _whole(text: str, what: str, least: int, most: int) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if not least <= number <= most:
        raise argparse.ArgumentTypeError(
            f"{what} = {text}: admissible are whole numbers from {least} to {most}"
        )
    return number


def _drives(options: argparse.Namespace) -> Sequence[str]:
    """Drives of a campaign over drawn installations."""
    from stillflux.evidence.drives import DRIVES

    if options.motor is not None:
        raise ValueError(
            "--motor: the campaigns over drawn installations have drives of their own (--machine)"
        )
    if options.machine not in ("all", *DRIVES):
        raise ValueError(f"--machine {options.machine}: admissible here are {', '.join(DRIVES)}, all")
    return _chosen(options.machine, tuple(DRIVES))


def _scale(text: str) -> float:
    """A factor of the tolerances. Raises what `argparse` expects."""
    try:
        scale = float(text)
    except ValueError:
        scale = -1.0
    if not 0.0 <= scale <= 5.0:
        raise argparse.ArgumentTypeError(f"scale = {text}: admissible are 0 to 5")
    return scale


def _setting(text: str) -> tuple[str, Any]:
    """A setting of the drive."""
    name, given, value = text.partition("=")
    if not name.isidentifier() or not given:
        raise ValueError(f"--set {text}: give NAME=VALUE, as dither=0.05")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value


def _draws(options: argparse.Namespace, default: int, since: int = 0) -> Sequence[int]:
    for name in ("draws", "first"):
        if options.draw and getattr(options, name):
            raise ValueError(f"--{name} {getattr(options, name)} and --draw: give only one")
    first = since if options.first is None else options.first
    if first != since and options.metrics:
        raise ValueError(
            f"--metrics {options.metrics}: a table of the draws from {since} on, and --first is given"
        )
    return options.draw or range(first, first + (options.draws or default))


def _tolerance(options: argparse.Namespace) -> int:
    from stillflux.evidence import tolerance
    from stillflux.evidence.courses import COURSES
    from stillflux.evidence.population import DRAWN, POPULATION
    from stillflux.evidence.report import installations
    from stillflux.evidence.table import of_rate, update
    from stillflux.parallel import Stopped, run_jobs

    drawn = options.machine == DRAWN
    machines, courses = (DRAWN,) if drawn else _drives(options), options.course or tuple(COURSES)
    draws = _draws(options, POPULATION if drawn else tolerance.DRAWS)
    scheme = "enhanced" if options.scheme == "all" else options.scheme
    settings = tuple(map(_setting, options.set or ()))
    scale, *more = options.scale or (1.0,)
    if more:
        raise ValueError(f"--scale {scale:g}, {more[0]:g}: give one, which is that of every run")
    for name, changed in (("set", bool(settings)), ("scale", scale != 1.0)):
        if changed and options.metrics:
            raise ValueError(f"--metrics {options.metrics}: a table of the defaults, and --{name} is given")
    if len(machines) == len(courses) == len(draws) == 1:
        for option in ("metrics", "journal"):
            if path := getattr(options, option):
                raise ValueError(f"--{option} {path}: not of a single run, which is no rate: give more draws")
        job = (
            machines[0],
            courses[0],
            draws[0],
            scheme,
            options.arithmetic,
            options.beyond_model,
            settings,
            scale,
        )
        outcome, result = tolerance.run(*job, signals=None)
        if options.json:
            write_text(options.json, installations.to_json([outcome]) + "\n")
        path = options.out / f"tolerance-{machines[0]}-{courses[0]}-{draws[0]}.png"
        result.plot().savefig(path, dpi=110)
        print(installations.describe(outcome))
        print(f"plot: {path}", file=sys.stderr)
        return 0
    journal = _journal(options, "beyond tolerance")
    runner, stopped = (journal.run if journal else run_jobs), ""
    try:
        found = tolerance.run_all(
            machines,
            courses,
            draws,
            (scheme,),
            options.arithmetic,
            tolerance.Progress(),
            runner,
            options.beyond_model,
            settings,
            scale,
        )
    except Stopped as stop:
        found, stopped = stop.results, str(stop)
    if options.metrics and not stopped:
        update(options.metrics, map(of_rate, tolerance.rates(found)))
    if options.json:
        write_text(options.json, installations.to_json(found) + "\n")
    path = options.out / "tolerance.html"
    installations.write_tolerance(path, options.command_line, found, stopped)
    print(installations.table(found))
    return _ended(path, journal, stopped)


def _consistency(options: argparse.Namespace) -> int:
    from stillflux.evidence import consistency
    from stillflux.evidence.report import installations
    from stillflux.evidence.table import of_consistency, update
    from stillflux.parallel import Stopped, run_jobs

    if options.json:
        raise ValueError("--json: not of consistency, which has no runs to list")
    machines, draws = _drives(options), _draws(options, consistency.DRAWS)
    scheme = "enhanced" if options.scheme == "all" else options.scheme
    journal = _journal(options, "beyond consistency")
    runner, stopped = (journal.run if journal else run_jobs), ""
    try:
        samples = consistency.run_all(
            machines,
            draws,
            scheme,
            options.arithmetic,
            consistency.progress,
            runner,
            options.beyond_model,
        )
    except Stopped as stop:
        samples, stopped = stop.results, str(stop)
    found = consistency.judged(samples)
    if options.metrics and not stopped:
        update(options.metrics, (of_consistency(x, scheme, options.beyond_model) for x in found))
    path = options.out / "consistency.html"
    installations.write_consistency(path, options.command_line, found, samples, stopped)
    print(installations.consistency_table(found))
    return _ended(path, journal, stopped)


def _commissioning(options: argparse.Namespace) -> int:
    from stillflux.evidence import commissioning
    from stillflux.evidence.report import page
    from stillflux.evidence.table import of_commissioning, update
    from stillflux.parallel import Stopped, run_jobs

    if options.motor is not None or options.machine != "all":
        raise ValueError("--motor and --machine: not of commissioning, whose motors are drawn")
    if options.metrics and options.course:
        raise ValueError(f"--metrics {options.metrics}: a table without courses, and --course is given")
    draws = _draws(options, commissioning.DRAWS, commissioning.FIRST)
    journal = _journal(options, "beyond commissioning")
    runner, stopped = (journal.run if journal else run_jobs), ""
    try:
        found = commissioning.run_all(
            draws, options.arithmetic, options.course or (), commissioning.progress, runner
        )
    except Stopped as stop:
        found, stopped = stop.results, str(stop)
    if options.metrics and not stopped:
        update(options.metrics, [of_commissioning(commissioning.claims(found))])
    if options.json:
        _write_json(options.json, page.finite([asdict(x) for x in found]))
    path = options.out / "commissioning.html"
    if found:
        commissioning.page(path, options.command_line, found, stopped)
        print(commissioning.table(found))
    return _ended(path, journal, stopped)


def _operations(options: argparse.Namespace) -> int:
    from stillflux.evidence import operate
    from stillflux.evidence.conditions import SCHEMES
    from stillflux.evidence.registry import choose_operations
    from stillflux.evidence.report import operations
    from stillflux.evidence.table import of_operation, update
    from stillflux.parallel import Stopped, run_jobs

    if options.json:
        raise ValueError("--json: not of operations")
    names, schemes = choose_operations(options.operation or ()), _chosen(options.scheme, SCHEMES)
    journal = _journal(options, "beyond operations")
    runner, stopped = (journal.run if journal else run_jobs), ""
    try:
        found = operate.perform_all(names, _drives(options), schemes, options.arithmetic, None, runner)
    except Stopped as stop:
        found, stopped = stop.results, str(stop)
    found = operate.worst(found)
    if options.metrics and not stopped:
        update(options.metrics, map(of_operation, found))
    path = options.out / "operations.html"
    operations.write(path, options.command_line, found, stopped)
    print(operations.table(found))
    failed = _ended(path, journal, stopped)
    return failed or int(not options.metrics and not all(x.ok for x in found))


def _guarantee(options: argparse.Namespace) -> int:
    from stillflux.evidence import guarantee
    from stillflux.evidence.courses import COURSES
    from stillflux.evidence.table import of_guarantee, update
    from stillflux.parallel import Stopped, run_jobs

    if options.json:
        raise ValueError("--json: not of guarantee")
    machines, courses = _drives(options), options.course or tuple(COURSES)
    draws, scales = _draws(options, guarantee.DRAWS), options.scale or guarantee.SCALES
    if options.metrics and (options.course or not set(scales) <= set(guarantee.SCALES)):
        admissible = ", ".join(f"{scale:g}" for scale in guarantee.SCALES)
        raise ValueError(f"--metrics: of all courses, and at --scale {admissible}")
    journal = _journal(options, "beyond guarantee")
    try:
        found = guarantee.run_all(
            machines,
            courses,
            draws,
            scales,
            guarantee.progress,
            journal.run if journal else run_jobs,
        )
    except Stopped as stop:
        print(guarantee.table(stop.results))
        print(f"stillflux: {stop}", file=sys.stderr)
        return 130
    if options.metrics:
        update(options.metrics, (of_guarantee(x, "enhanced") for x in guarantee.found(found)))
    print(guarantee.table(found))
    if journal:
        journal.remove()
    # A table that is brought up to date records a violation; it is not stopped by one.
    return int(any(x.violated for x in found) and not options.metrics)


def _ended(path: Path, journal: Journal | None, stopped: str) -> int:
    """Where the report is; a journal has served once all is done."""
    print(f"report: {path}", file=sys.stderr)
    if stopped:
        print(f"stillflux: {stopped}", file=sys.stderr)
    elif journal:
        journal.remove()
    return 130 if stopped else 0


_CAMPAIGNS: Mapping[str, Callable[[argparse.Namespace], int]] = {
    "tolerance": _tolerance,
    "consistency": _consistency,
    "guarantee": _guarantee,
    "commissioning": _commissioning,
    "operations": _operations,
}
"""Over installations drawn at random, and what drives are asked to do; with machines and options of
their own."""

_ONLY_WITH: Mapping[str, tuple[str, ...]] = {
    "draws": ("tolerance", "consistency", "guarantee", "commissioning"),
    "draw": ("tolerance", "consistency", "guarantee", "commissioning"),
    "first": ("tolerance", "consistency", "guarantee", "commissioning"),
    "course": ("tolerance", "guarantee", "commissioning"),
    "scale": ("tolerance", "guarantee"),
    "beyond_model": ("tolerance", "consistency"),
    "set": ("tolerance",),
    "operation": ("operations",),
}
"""Options that only some campaigns have."""


def _docs(options: argparse.Namespace) -> int:
    from stillflux.evidence import plane_points
    from stillflux.evidence.documents import draw_plane, update
    from stillflux.evidence.table import Table

    drawn = draw_plane(options.root, options.metrics.with_name(plane_points.FILE))
    for path in [*update(options.root, Table.read(options.metrics)), *drawn]:
        print(f"updated: {path}")
    return 0
