"""Command line: `stillflux demo`, `reproduce`, `beyond`, `simulate`, `replay`."""

from __future__ import annotations

import argparse
import csv
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stillflux._core import FluxEstimator
from stillflux.beyond.scenarios import SCHEMES
from stillflux.parameters import Inverter, Motor
from stillflux.scenario import Scenario
from stillflux.scenarios import ALL_MACHINES, MACHINES
from stillflux.simulation import Interrupted, simulate

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    options = _parser().parse_args(given)
    options.command_line = shlex.join(["stillflux", *given])
    try:
        status: int = options.run(options)
    except (ValueError, TypeError, OSError) as error:
        print(f"stillflux: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        print(f"\nstillflux: {error or 'interrupted'}", file=sys.stderr)
        return 130
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="stillflux", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")

    demo = commands.add_parser("demo", help="the headline run: a minute at zero stator frequency")
    demo.add_argument("--machine", choices=[*MACHINES, "all"], default="all")
    demo.add_argument("--arithmetic", choices=["f32", "f64", "q"], default="f32")
    demo.add_argument("--out", type=Path, default=Path("reports"), help="folder for report and plots")
    demo.set_defaults(run=_demo)

    figures = commands.add_parser("reproduce", help="the paper's figures on plant truth, with verdicts")
    figures.add_argument(
        "figures", nargs="*", metavar="FIG", help="numbers such as 9, 13b; none: all of them"
    )
    figures.add_argument("--machine", choices=[*MACHINES, "all"], default="all")
    figures.add_argument("--arithmetic", choices=["f32", "f64", "q"], default="f32")
    figures.add_argument("--out", type=Path, default=Path("reports"), help="folder for report and plots")
    figures.add_argument("--json", metavar="FILE", help="write the verdicts there as JSON; -: to stdout")
    figures.add_argument(
        "--metrics", type=Path, metavar="FILE", help="bring this table of key metrics up to date"
    )
    figures.add_argument(
        "--sensitivity", action="store_true", help="also how far parameters may be off (minutes)"
    )
    figures.add_argument(
        "--beyond", action="store_true", help="also what `stillflux beyond` measures (minutes)"
    )
    figures.set_defaults(run=_reproduce)

    beyond = commands.add_parser(
        "beyond", help="the torque-speed plane, crossings, mismatches, starts, for each scheme"
    )
    beyond.add_argument(
        "targets", nargs="*", metavar="TARGET", help="such as plane, plane-drift, mismatch; none: all of them"
    )
    beyond.add_argument("--machine", choices=[*ALL_MACHINES, "all"], default="all")
    beyond.add_argument("--scheme", choices=[*SCHEMES, "all"], default="all")
    beyond.add_argument("--arithmetic", choices=["f32", "f64", "q"], default="f32")
    beyond.add_argument("--out", type=Path, default=Path("reports"), help="folder for report and plots")
    beyond.add_argument("--json", type=Path, metavar="FILE", help="write every run there as JSON")
    beyond.add_argument(
        "--metrics", type=Path, metavar="FILE", help="bring this table of key metrics up to date"
    )
    beyond.set_defaults(run=_beyond)

    run = commands.add_parser("simulate", help="run a scenario from a TOML file")
    run.add_argument(
        "file", type=Path, help="fields of stillflux.Scenario; motor and inverter by preset or table"
    )
    run.add_argument("--plot", type=Path, help="write the overview plot there (png, svg, pdf)")
    run.add_argument("--save", type=Path, help="write the record there (npz)")
    run.set_defaults(run=_simulate)

    replay = commands.add_parser("replay", help="run the flux estimator over a recorded CSV log")
    replay.add_argument(
        "log",
        type=Path,
        help="CSV sampled at f_s with header and columns u_alpha, u_beta in V, i_alpha, i_beta in A",
    )
    replay.add_argument("--machine", choices=MACHINES, default="2.2kW")
    replay.add_argument("--f-s", type=float, metavar="HZ", help="sampling frequency of the log")
    replay.add_argument("--out", type=Path, required=True, help="write the estimates there (CSV)")
    replay.set_defaults(run=_replay)
    return parser


def _demo(options: argparse.Namespace) -> int:
    from stillflux import demo

    machines = MACHINES if options.machine == "all" else (options.machine,)
    return 0 if demo.run(machines, options.out, options.command_line, options.arithmetic) else 1


def _reproduce(options: argparse.Namespace) -> int:
    from stillflux import reproduce, sensitivity
    from stillflux.beyond import page, runner, targets

    machines = MACHINES if options.machine == "all" else (options.machine,)
    figures = reproduce.choose(options.figures)
    options.out.mkdir(parents=True, exist_ok=True)
    outcomes = reproduce.run_all(figures, machines, options.arithmetic, options.out, reproduce.progress)
    extra = ""
    if options.sensitivity:
        rows = sensitivity.run_all(figures, machines, options.arithmetic, sensitivity.progress)
        extra = sensitivity.to_html(rows)
    judged: list[reproduce.Judged] = list(outcomes)
    section = ""
    if options.beyond:
        wanted = ALL_MACHINES if options.machine == "all" else machines
        runs = runner.run_all(targets.choose(()), wanted, SCHEMES, options.arithmetic, runner.progress)
        section = page.section(runs, options.out)
        judged += runner.summaries(runs)
    as_json = reproduce.to_json(outcomes)
    if options.json == "-":
        print(as_json)
    else:
        print(reproduce.table(outcomes))
        if options.sensitivity:
            print(f"\n{sensitivity.to_markdown(rows)}")
    if options.json not in (None, "-"):
        Path(options.json).write_text(as_json + "\n", encoding="utf-8")
    if options.metrics:
        before = reproduce.read_metrics(options.metrics)
        options.metrics.write_text(reproduce.metrics_table(judged, before), encoding="utf-8")
    path = options.out / "reproduce.html"
    reproduce.write_report(path, options.command_line, outcomes, extra, section)
    print(f"report: {path}", file=sys.stderr)
    return 1 if any(outcome.verdict == "FAILED" for outcome in outcomes) else 0


def _beyond(options: argparse.Namespace) -> int:
    from stillflux import reproduce
    from stillflux.beyond import page, runner, targets
    from stillflux.parallel import Stopped

    machines = ALL_MACHINES if options.machine == "all" else (options.machine,)
    schemes = SCHEMES if options.scheme == "all" else (options.scheme,)
    chosen = targets.choose(options.targets)
    stopped = ""
    try:
        rows = runner.run_all(chosen, machines, schemes, options.arithmetic, runner.progress)
    except Stopped as stop:
        rows, stopped = stop.results, str(stop)
    found = runner.summaries(rows)
    print(page.table(found))
    options.out.mkdir(parents=True, exist_ok=True)
    if options.json:
        data = reproduce.finite(page.to_rows(rows))
        options.json.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if options.metrics and not stopped:
        before = reproduce.read_metrics(options.metrics)
        options.metrics.write_text(reproduce.metrics_table(found, before), encoding="utf-8")
    path = options.out / "beyond.html"
    page.write(path, options.command_line, rows, stopped)
    print(f"report: {path}", file=sys.stderr)
    if stopped:
        print(f"stillflux: {stopped}", file=sys.stderr)
    return 130 if stopped else 0


def _simulate(options: argparse.Namespace) -> int:
    with options.file.open("rb") as file:
        scenario = Scenario.from_dict(tomllib.load(file))
    try:
        result, status = simulate(scenario, progress=True), 0
    except Interrupted as stop:
        result, status = stop.result, 130
    print(f"status: {result.status}, {result.t[-1] if len(result.t) else 0.0:.3f} s simulated")
    if options.save:
        result.save(options.save)
        print(f"record: {options.save}")
    if options.plot:
        result.plot().savefig(options.plot, dpi=110)
        print(f"plot: {options.plot}")
    return status


def _replay(options: argparse.Namespace) -> int:
    inverter = Inverter.preset(options.machine)
    if options.f_s is not None:
        inverter = inverter.replace(f_s=options.f_s)
    log = _columns(options.log, ("u_alpha", "u_beta", "i_alpha", "i_beta"))
    estimator = FluxEstimator(Motor.preset(options.machine), inverter)
    trace = estimator.run(log[0] + 1j * log[1], log[2] + 1j * log[3])
    columns: dict[str, Any] = {
        "t": trace.t,
        "psi_alpha": trace.psi_s.real,
        "psi_beta": trace.psi_s.imag,
        "angle": trace.angle,
        "u_off_alpha": trace.u_off.real,
        "u_off_beta": trace.u_off.imag,
        "omega_s": trace.omega_s,
        "omega_m": trace.omega_m,
    }
    np.savetxt(
        options.out,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    print(f"{len(trace.t)} samples: {options.out}")
    return 0


def _columns(path: Path, names: Sequence[str]) -> Any:
    """The named columns of a CSV file with header, shape (len(names), samples)."""
    with path.open(newline="") as file:
        rows = csv.reader(file)
        header = [name.strip() for name in next(rows, [])]
        missing = [name for name in names if name not in header]
        if missing:
            raise ValueError(f"{path}: column {', '.join(missing)} is missing; there are {', '.join(header)}")
        at = [header.index(name) for name in names]
        try:
            return np.array([[float(row[k]) for k in at] for row in rows if row]).reshape(-1, len(names)).T
        except (ValueError, IndexError) as error:
            raise ValueError(f"{path}, line {rows.line_num}: {error}") from error


if __name__ == "__main__":
    sys.exit(main())
