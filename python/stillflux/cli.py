"""Command line: `stillflux simulate`, `replay`, `sweep`, `commission`, `demo`, `reproduce`, `beyond`."""

from __future__ import annotations

import argparse
import io
import os
import shlex
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillflux import __version__, sweep_file
from stillflux.machine_file import beside, in_file, load_machine, read_toml, simulated_guess, with_machine
from stillflux.messages import MachineWarning
from stillflux.outputs import apart, check_file, keep
from stillflux.parallel import EndedEarlyError, undisturbed
from stillflux.parameters import PRESETS
from stillflux.replay import replay
from stillflux.scenario import Scenario, ScenarioWarning
from stillflux.simulation import DivergenceError, Interrupted, simulate
from stillflux.sweep import SweepInterrupted, sweep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # A console that knows no Ω or ° is no reason to lose a result.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            options = _parser(given).parse_args(given)
        except SystemExit:
            _flush()
            raise
        options.command_line = shlex.join(["stillflux", *given])
        with warnings.catch_warnings():
            warnings.showwarning = partial(_warned, warnings.showwarning)
            status: int = options.run(options)
        _flush()
    except OSError as error:
        if isinstance(error, BrokenPipeError) and error.filename is None:
            return _unread()
        text = f"{error.filename}: {error.strerror}" if error.filename and error.strerror else error
        print(f"stillflux: {text}", file=sys.stderr)
        return 2
    except (ValueError, TypeError, ImportError, ArithmeticError, EndedEarlyError) as error:
        print(f"stillflux: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        print(f"\nstillflux: {str(error) or 'interrupted'}", file=sys.stderr)
        return 130
    return status


def _flush() -> None:
    """That what reads the output has gone shows here, not after the end of the program."""
    if sys.stdout is not None:
        sys.stdout.flush()


_UNREAD = 128 + 13
"""Exit status of a program that SIGPIPE ends, as shells show it."""


def _unread() -> int:
    """What reads the output has seen enough: files are written, nothing is left to say."""
    # Or the interpreter would try again at its end, and complain.
    if sys.stdout is sys.__stdout__ and sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return _UNREAD


def _warned(otherwise: Callable[..., None], message: Warning | str, *where: Any, **how: Any) -> None:
    """A warning of a scenario or a machine as one line, without the place in the code."""
    if isinstance(message, ScenarioWarning | MachineWarning):
        print(f"stillflux: {message}", file=sys.stderr)
    else:
        otherwise(message, *where, **how)


@dataclass(frozen=True)
class Command:
    """A command whose arguments are declared by a function of a module, imported when the command is
    given."""

    name: str
    help: str
    module: str
    """Its function of the command's name takes an `argparse.ArgumentParser`."""


COMMANDS = (
    Command("demo", "a minute at zero stator frequency, by both schemes", "stillflux.evidence.commands"),
    Command(
        "commission",
        "find a motor's parameters from its nameplate, simulated",
        "stillflux.commissioning_command",
    ),
    Command("reproduce", "the paper's figures on plant truth, with verdicts", "stillflux.evidence.commands"),
    Command(
        "beyond",
        "the torque-speed plane, crossings, mismatches, starts, for each scheme",
        "stillflux.evidence.commands",
    ),
    Command(
        "docs", "writes what was measured into README and docs (in a checkout)", "stillflux.evidence.commands"
    ),
)
"""Registered by name only: the library imports nothing of what proves it."""


def _parser(given: Sequence[str]) -> argparse.ArgumentParser:
    """The parser of a command line; of the registered commands only the one given is imported."""
    parser = argparse.ArgumentParser(
        prog="stillflux",
        description="Sensorless control of induction motors down to zero stator frequency, simulated. "
        "`stillflux COMMAND --help` has the options of a command.",
    )
    parser.add_argument("--version", action="version", version=f"stillflux {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", title="commands")
    wanted = next((word for word in given if not word.startswith("-")), "")
    for command in COMMANDS:
        added = commands.add_parser(command.name, help=command.help)
        if command.name == wanted:
            getattr(import_module(command.module), command.name)(added)

    run = commands.add_parser(
        "simulate",
        help="run a scenario from a TOML file",
        epilog="The exit status is 1 if the drive ends with a fault, 2 if there is an error.",
    )
    run.add_argument(
        "file",
        type=Path,
        help="fields of stillflux.Scenario; motor and inverter by preset, motor file or table",
    )
    _motor_option(run, None)
    run.add_argument("--plot", type=Path, help="write the overview plot there (png, svg, pdf)")
    run.add_argument("--save", type=Path, help="write the record there (npz)")
    run.set_defaults(run=_simulate)

    log = commands.add_parser("replay", help="run the estimators over a recorded log")
    log.add_argument(
        "log",
        type=Path,
        help="CSV, Parquet, NPZ or MAT: currents (i_a, i_b, i_c; i_alpha, i_beta; i_d, i_q, angle), voltages "
        "(the same with u_, u_ab, u_bc) or duties (d_a, d_b, d_c) with u_dc; t in s",
    )
    _motor_option(log, "2.2kW")
    log.add_argument(
        "--scheme", choices=["enhanced", "paper"], default="enhanced", help="estimators; default: enhanced"
    )
    log.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="QUANTITY=NAME[:UNIT]",
        help="a quantity's column in the log, such as i_a=Iu:mA",
    )
    log.add_argument(
        "--rate", type=float, metavar="HZ", help="sampling rate of a log without t, or to check it"
    )
    log.add_argument(
        "--voltage",
        choices=["terminal", "bridge", "compensated"],
        help="at the machine's terminals (default), commanded at the bridge (default for duties), or a "
        "reference without the inverter compensation",
    )
    log.add_argument("--delay", type=float, metavar="ROWS", help="rows until a voltage's interval ends")
    log.add_argument("--max-gap", type=float, default=0.0, metavar="S", help="longest gap that is bridged")
    log.add_argument("--out", type=Path, help="write the estimates there (CSV, NPZ, Parquet)")
    log.add_argument("--plot", type=Path, help="write the plot there (png, svg, pdf)")
    log.set_defaults(run=_replay)

    many = commands.add_parser(
        "sweep",
        help="run many scenarios of a TOML file and keep numbers of each",
        epilog="The exit status is 1 if a row has an error (a fault of the drive is none), 2 without rows.",
    )
    many.add_argument("file", type=Path, help="a sweep file, see stillflux.sweep_file")
    _motor_option(many, None)
    many.add_argument(
        "--out", type=Path, help="write the rows there (CSV); without it an interrupted sweep prints them"
    )
    many.add_argument("--plot", type=Path, help="write the map of [plot], or the distributions, there")
    many.add_argument("--resume", type=Path, metavar="FILE", help="keep rows there; if killed, go on with it")
    many.set_defaults(run=_sweep)
    return parser


def _motor_option(parser: argparse.ArgumentParser, default: str | None) -> None:
    parser.add_argument(
        "--motor",
        metavar="FILE",
        default=default,
        help=f"motor file (TOML) or preset ({', '.join(PRESETS)})"
        + (f"; default: {default}" if default else ""),
    )


_MACHINES = ("motor", "inverter", "plant_motor", "plant_inverter")
"""Fields of a scenario that may name a motor file."""
_PLOTS = (".png", ".svg", ".pdf")


def _plot(figure: Callable[[], Figure]) -> Callable[[Path], None]:
    """Writes a figure, which is drawn for it."""
    return lambda path: figure().savefig(path, dpi=110)


def _simulate(options: argparse.Namespace) -> int:
    check_file(options.save, ".npz")
    check_file(options.plot, *_PLOTS)
    apart({"file": options.file, "--save": options.save, "--plot": options.plot})
    data = read_toml(options.file)
    found = beside(options.file, _with_motor(data, options.motor), _MACHINES)
    with in_file(options.file):
        scenario = Scenario.from_dict(found)
    if scenario.plant_motor is None:
        _say_guess(options.motor or found["motor"])
    ended = ""
    try:
        result = simulate(scenario, progress=True)
        status = int(result.status.fault is not None)
    except Interrupted as stop:
        result, status, ended = stop.result, 130, f"\nstillflux: {stop}"
    except DivergenceError as stop:
        result, status, ended = stop.result, 2, f"stillflux: {stop}"
    with undisturbed():
        if ended:
            print(ended, file=sys.stderr)
        keep(result.summary(), record=(options.save, result.save), plot=(options.plot, _plot(result.plot)))
    return status


_ARGUMENTS = {
    "columns={": "--column QUANTITY=NAME[:UNIT]",
    "rate = …": "--rate HZ",
    "max_gap =": "--max-gap S",
}
"""What errors of `replay` ask for as an argument, and its option."""


def _replay(options: argparse.Namespace) -> int:
    check_file(options.out, ".csv", ".npz", ".parquet")
    check_file(options.plot, *_PLOTS)
    apart({"LOG": options.log, "--out": options.out, "--plot": options.plot})
    columns: dict[str, Any] = {}
    for text in options.column:
        quantity, equals, name = text.partition("=")
        if not equals or not name:
            raise ValueError(f"--column {text}: write QUANTITY=NAME or QUANTITY=NAME:UNIT")
        name, colon, unit = name.rpartition(":") if ":" in name else (name, "", "")
        if quantity in columns:
            raise ValueError(f"--column {text}: {quantity} is given twice")
        columns[quantity] = (name, unit) if colon else name
    machine = load_machine(options.motor)
    try:
        found = replay(
            options.log,
            machine.motor,
            machine.inverter,
            options.scheme,
            columns,
            voltage=options.voltage,
            rate=options.rate,
            delay=options.delay,
            max_gap=options.max_gap,
        )
    except ValueError as error:
        named = [option for argument, option in _ARGUMENTS.items() if argument in str(error)]
        raise ValueError(f"{error}\non the command line: {', '.join(named)}" if named else error) from None
    said = f"machine: {machine.name}\n{found.summary()}"
    keep(said, estimates=(options.out, found.save), plot=(options.plot, _plot(found.plot)))
    return 0


def _sweep(options: argparse.Namespace) -> int:
    check_file(options.out, ".csv")
    check_file(options.plot, *_PLOTS)
    check_file(options.resume)
    apart({"file": options.file, "--resume": options.resume, "--out": options.out, "--plot": options.plot})
    data = read_toml(options.file)
    tables = _with_motor(data, options.motor, "scenario")
    if "scenario" in tables:
        tables = {**tables, "scenario": beside(options.file, tables["scenario"], _MACHINES, "scenario")}
    with in_file(options.file):
        asked = sweep_file.parse(tables)
    if not any(point.scenario and point.scenario.plant_motor for point in asked.points):
        _say_guess(options.motor or tables["scenario"]["motor"])
    ended = ""
    try:
        found = sweep(asked.points, list(asked.metrics), resume=options.resume, progress=True)
        status = int(bool(found.failed))
    except SweepInterrupted as stop:
        found, status, ended = stop.result, 130, f"stillflux: {stop}"
    with undisturbed():
        if ended:
            print(ended, file=sys.stderr)
        said = "\n".join([found.summary(), *(f"failed: {row['error']}" for row in found.failed[:5])])
        # What an interruption leaves is in no file then, and took the time of its runs.
        if ended and options.out is None and options.resume is None and len(found):
            said = f"{said}\n{found.to_csv().rstrip()}"
        figure = partial(found.map, **asked.plot) if asked.plot else found.spread
        keep(said, rows=(options.out, found.save), plot=(options.plot if len(found) else None, _plot(figure)))
    return status


def _with_motor(data: dict[str, Any], motor: str | None, table: str = "") -> dict[str, Any]:
    """The tables of a file with the motor and inverter of `--motor` instead of those in it; with those that
    its file simulates, and with the settings that follow from how well it knows its values."""
    if motor is None:
        return data
    scenario = with_machine(data.get(table, {}) if table else data, load_machine(motor))
    return {**data, table: scenario} if table else scenario


def _say_guess(source: Any) -> None:
    """Says of a scenario without a motor of its plant, of a motor file or a preset, that the file has only a
    plate."""
    if isinstance(source, str) and load_machine(source).of_plate:
        print(f"stillflux: {simulated_guess(source)}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
