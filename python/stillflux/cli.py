"""Command line: `stillflux demo`, `reproduce`, `beyond`, `simulate`, `replay`."""

from __future__ import annotations

import argparse
import csv
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from stillflux._core import FluxEstimator
from stillflux.machine_file import load_machine, read_toml
from stillflux.parameters import PRESETS
from stillflux.scenario import Scenario
from stillflux.simulation import Interrupted, simulate

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    options = _parser(given).parse_args(given)
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


@dataclass(frozen=True)
class Command:
    """A command whose arguments are declared by a function of a module, imported when the command is
    given."""

    name: str
    help: str
    module: str
    """Its function of the command's name takes an `argparse.ArgumentParser`."""


COMMANDS = (
    Command("demo", "the headline run: a minute at zero stator frequency", "stillflux.evidence.commands"),
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
    parser = argparse.ArgumentParser(prog="stillflux", description=__doc__)
    commands = parser.add_subparsers(required=True, metavar="command")
    wanted = next((word for word in given if not word.startswith("-")), "")
    for command in COMMANDS:
        added = commands.add_parser(command.name, help=command.help)
        if command.name == wanted:
            getattr(import_module(command.module), command.name)(added)

    run = commands.add_parser("simulate", help="run a scenario from a TOML file")
    run.add_argument(
        "file",
        type=Path,
        help="fields of stillflux.Scenario; motor and inverter by preset, motor file or table",
    )
    _motor_option(run, None)
    run.add_argument("--plot", type=Path, help="write the overview plot there (png, svg, pdf)")
    run.add_argument("--save", type=Path, help="write the record there (npz)")
    run.set_defaults(run=_simulate)

    replay = commands.add_parser("replay", help="run the flux estimator over a recorded CSV log")
    replay.add_argument(
        "log",
        type=Path,
        help="CSV sampled at f_s with header and columns u_alpha, u_beta in V, i_alpha, i_beta in A",
    )
    _motor_option(replay, "2.2kW")
    replay.add_argument("--f-s", type=float, metavar="HZ", help="sampling frequency of the log")
    replay.add_argument("--out", type=Path, required=True, help="write the estimates there (CSV)")
    replay.set_defaults(run=_replay)
    return parser


def _motor_option(parser: argparse.ArgumentParser, default: str | None) -> None:
    parser.add_argument(
        "--motor",
        metavar="FILE",
        default=default,
        help=f"motor file (TOML) or preset ({', '.join(PRESETS)})"
        + (f"; default: {default}" if default else ""),
    )


def _simulate(options: argparse.Namespace) -> int:
    data = read_toml(options.file)
    if options.motor is not None:
        machine = load_machine(options.motor)
        data = {**data, "motor": asdict(machine.motor), "inverter": asdict(machine.inverter)}
    scenario = Scenario.from_dict(data)
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
    machine = load_machine(options.motor)
    inverter = machine.inverter
    if options.f_s is not None:
        inverter = inverter.replace(f_s=options.f_s)
    log = _columns(options.log, ("u_alpha", "u_beta", "i_alpha", "i_beta"))
    estimator = FluxEstimator(machine.motor, inverter)
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
