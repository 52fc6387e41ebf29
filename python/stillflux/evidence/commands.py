"""The commands that prove: `demo`, `reproduce`, `beyond`."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from stillflux.evidence.machines import ALL_MACHINES, MACHINES

__all__ = ["beyond", "demo", "reproduce"]


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

    parser.add_argument(
        "targets", nargs="*", metavar="TARGET", help="such as plane, plane-drift, mismatch; none: all of them"
    )
    _where(parser, ALL_MACHINES)
    parser.add_argument("--scheme", choices=[*SCHEMES, "all"], default="all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every run there as JSON")
    _metrics(parser)
    parser.set_defaults(run=_beyond)


def _where(parser: argparse.ArgumentParser, machines: Sequence[str]) -> None:
    parser.add_argument("--machine", choices=[*machines, "all"], default="all")
    parser.add_argument("--arithmetic", choices=["f32", "f64", "q"], default="f32")
    parser.add_argument("--out", type=Path, default=Path("reports"), help="folder for report and plots")


def _metrics(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--metrics", type=Path, metavar="FILE", help="bring this table of what was measured up to date"
    )


def _chosen(machine: str, machines: Sequence[str]) -> Sequence[str]:
    return machines if machine == "all" else (machine,)


def _demo(options: argparse.Namespace) -> int:
    from stillflux.evidence import demo

    machines = _chosen(options.machine, MACHINES)
    return 0 if demo.run(machines, options.out, options.command_line, options.arithmetic) else 1


def _reproduce(options: argparse.Namespace) -> int:
    import sys

    from stillflux.evidence import beyond, reproduce, sensitivity
    from stillflux.evidence.conditions import SCHEMES
    from stillflux.evidence.registry import choose_figures, choose_targets
    from stillflux.evidence.report import figures as report
    from stillflux.evidence.report import plane
    from stillflux.evidence.table import of_margin, of_outcome, of_summary, update

    machines = _chosen(options.machine, MACHINES)
    figures = choose_figures(options.figures)
    options.out.mkdir(parents=True, exist_ok=True)
    outcomes = reproduce.run_all(figures, machines, options.arithmetic, options.out, reproduce.progress)
    margins = []
    if options.sensitivity:
        margins = sensitivity.run_all(figures, machines, options.arithmetic, sensitivity.progress)
    section, found = "", []
    if options.beyond:
        wanted = _chosen(options.machine, ALL_MACHINES)
        rows = beyond.run_all(choose_targets(()), wanted, SCHEMES, options.arithmetic, beyond.progress)
        section, found = plane.section(rows, options.out), beyond.summaries(rows)
    if options.metrics:
        fresh = [of_outcome(x) for x in outcomes] + [of_margin(x) for x in margins]
        update(options.metrics, [*fresh, *map(of_summary, found)])
    as_json = report.to_json(outcomes)
    if options.json == "-":
        print(as_json)
    else:
        print(report.table(outcomes))
        if margins:
            print(f"\n{sensitivity.to_markdown(margins)}")
    if options.json not in (None, "-"):
        Path(options.json).write_text(as_json + "\n", encoding="utf-8")
    path = options.out / "reproduce.html"
    table = sensitivity.to_html(margins) if margins else ""
    report.write(path, options.command_line, outcomes, table, section)
    print(f"report: {path}", file=sys.stderr)
    return 1 if any(outcome.verdict == "FAILED" for outcome in outcomes) else 0


def _beyond(options: argparse.Namespace) -> int:
    import sys

    from stillflux.evidence import beyond
    from stillflux.evidence.conditions import SCHEMES
    from stillflux.evidence.registry import choose_targets
    from stillflux.evidence.report import page, plane
    from stillflux.evidence.table import of_summary, update
    from stillflux.parallel import Stopped

    machines = _chosen(options.machine, ALL_MACHINES)
    schemes = _chosen(options.scheme, SCHEMES)
    chosen = choose_targets(options.targets)
    stopped = ""
    try:
        rows = beyond.run_all(chosen, machines, schemes, options.arithmetic, beyond.progress)
    except Stopped as stop:
        rows, stopped = stop.results, str(stop)
    found = beyond.summaries(rows)
    print(plane.table(found))
    if options.metrics and not stopped:
        update(options.metrics, map(of_summary, found))
    options.out.mkdir(parents=True, exist_ok=True)
    if options.json:
        data = page.finite(plane.to_rows(rows))
        options.json.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    path = options.out / "beyond.html"
    plane.write(path, options.command_line, rows, stopped)
    print(f"report: {path}", file=sys.stderr)
    if stopped:
        print(f"stillflux: {stopped}", file=sys.stderr)
    return 130 if stopped else 0
