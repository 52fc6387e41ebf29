"""`stillflux commission`: from a nameplate to a motor file, on a simulated motor, with a report.

```toml
[nameplate]                    # or [motor], or a preset's name instead of a file: the plate is then its own;
                               # motor = "FILE" names a motor file beside this one
P_N = 4000.0
U_N = 400.0
I_N = 8.2
f_N = 50.0
n_N = 1435.0
cos_phi = 0.82

[inverter]                     # what its data sheet says, or preset = "2.2kW" and what differs; optional
u_dc = 540.0

[plant]                        # options of stillflux.Plant, and channels, channel_factor, current_sensors
adc_noise = 0.03               # of stillflux.commission; optional

[plant.motor]                  # the motor that is simulated, or beside [motor] what differs; without it that
R_s = 1.5                      # of [motor] or of the plate
# …

[plant.inverter]               # its inverter where it differs from the data sheet
dead_time = 2.2e-6
```

The motor file that `--out` writes holds what was found and, as its plant, what was simulated:
`stillflux beyond --motor FILE` tells a drive the one and runs it on the other.
"""

from __future__ import annotations

import argparse
import html
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.commissioning import PROCEDURES, Commissioned, CommissioningInterrupted, pulse_delay
from stillflux.commissioning import commission as run_commissioning
from stillflux.html_page import page, svg
from stillflux.machine_file import (
    beside,
    check_tables,
    checked,
    checked_name,
    deviation_of,
    in_file,
    inverter_of,
    load_machine,
    motor_file,
    part,
    plate_of,
    read_toml,
    simulated_guess,
)
from stillflux.messages import meant
from stillflux.nameplate import Nameplate
from stillflux.options import PlantOptions
from stillflux.outputs import apart, check_file, keep, write_text
from stillflux.parallel import undisturbed
from stillflux.parameters import PRESETS, Inverter, Motor, leg_delay
from stillflux.scenario import rich
from stillflux.simulation import progress_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["commission", "figure", "report"]

_FRICTION = 0.02
"""To what part of rated torque the friction is resolved: what is left of the torque's error between
acceleration and braking. Allowance: 1.4 to 2.7 % were found on four machines without friction."""
_FAR = 4.0
"""Deviations of the nameplate's value beyond which one is named: as the core's warning has it."""
_PLANT = (
    *PlantOptions.__annotations__,
    "motor",
    "inverter",
    "channels",
    "channel_factor",
    "current_sensors",
)
"""What [plant] may have: options of a plant, its two tables, and the faults of the wiring."""
_UNITS = {"R_s": "Ω", "R_R": "Ω", "L_sigma": "mH", "L_M": "mH", "J": "kg·m²"}


@dataclass(frozen=True)
class _Task:
    """What is commissioned."""

    name: str
    plate: Nameplate
    sheet: Inverter
    motor: Motor
    inverter: Inverter
    options: dict[str, Any]
    told: Motor | None
    """The motor of a file that has no plate."""


def commission(parser: argparse.ArgumentParser) -> None:
    """Arguments of `commission`."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "machine",
        nargs="?",
        help=f"a TOML file with [nameplate] or [motor], [inverter] and [plant], or a preset "
        f"({', '.join(PRESETS)}): see stillflux.commissioning_command",
    )
    source.add_argument("--motor", metavar="FILE", help="the same, as the other commands call it")
    parser.add_argument(
        "--shaft",
        choices=["locked", "free"],
        default="locked",
        help="locked: it stands still; free: J is found as well",
    )
    parser.add_argument(
        "--only",
        choices=PROCEDURES,
        help="run one procedure alone, after the check of the wiring (inertia: with --shaft free)",
    )
    parser.add_argument(
        "--arithmetic", choices=["f32", "f64", "q"], default="f32", help="of the control; default: f32"
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the motor file there (TOML)")
    parser.add_argument(
        "--report", type=Path, metavar="FILE", help="write curves, values, warnings there (HTML)"
    )
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    source = options.motor if options.machine is None else options.machine
    check_file(options.out, ".toml")
    check_file(options.report, ".html", ".htm")
    apart({"MACHINE": source, "--out": options.out, "--report": options.report})
    task = _task(source)
    bar = progress_bar("commissioning")
    status, ended = 0, ""
    try:
        with nullcontext() if source in PRESETS else in_file(source), _in_plant(task.options):
            found = run_commissioning(
                task.plate,
                task.sheet,
                plant_motor=task.motor,
                plant_inverter=task.inverter,
                shaft=options.shaft,
                arithmetic=options.arithmetic,
                only=options.only,
                progress=lambda fraction, stage: bar(fraction),
                **task.options,
            )
    except CommissioningInterrupted as stop:
        found, status, ended = stop.result, 130, f"\nstillflux: {stop}"
    with undisturbed():
        if ended:
            print(ended, file=sys.stderr)
        _keep(task, found, options)
    return status or int(found.cause is not None)


def _keep(task: _Task, found: Commissioned, options: argparse.Namespace) -> None:
    """Prints what was found and writes it."""
    if task.told is not None:
        # The rating is that of the motor, not of the rounded plate that the procedures go by.
        found = replace(found, motor=found.motor.replace(I_N=task.told.I_N, T_N=task.told.T_N))
    rows, far = list(_rows(task, found)), list(_far(task.plate, found))
    said = [f"status: {found.status}, {found.duration:.1f} s simulated"]
    said += [
        f"{name:20} {value:>14}  ± {deviation:>8}   error {error}" for name, value, deviation, error in rows
    ]
    said += [f"warning: {text}" for text in (*found.warnings, *far)]
    text = found.to_toml(name=task.name, plant_motor=task.motor, plant_inverter=_simulated(task))
    keep(
        "\n".join(said),
        motor_file=(options.out, lambda path: write_text(path, text)),
        report=(options.report, lambda path: write_text(path, report(task.name, found, rows, far))),
    )


def _task(source: str) -> _Task:
    if source in PRESETS:
        machine = load_machine(source)
        plate = Nameplate.of(machine.motor)
        return _Task(source, plate, machine.inverter, machine.motor, machine.inverter, {}, machine.motor)
    path = motor_file(source)
    data = read_toml(path)
    with in_file(path):
        return _of_file(path, data)


def _of_file(path: Path, data: Mapping[str, Any]) -> _Task:
    """What the tables of a file say. Raises ValueError, TypeError."""
    check_tables(path, data, "commissioning", named=("motor", "inverter"))
    # What is found has its own; those of the file are only what a motor file may have.
    deviation_of(path, data)
    data = beside(path, data, ("motor", "inverter"))
    plant = beside(path, data.get("plant", {}), ("motor", "inverter"), "plant")
    for key in plant:
        if key not in _PLANT:
            raise ValueError(f"[plant] {key} is not known{meant(key, _PLANT)}")
    simulated, changes = plant.pop("motor", None), plant.pop("inverter", {})
    if ("nameplate" in data) == ("motor" in data):
        raise ValueError(
            "give one of the tables [nameplate] and [motor]; the motor that is simulated in "
            "place of that of the plate is [plant.motor]"
        )
    told = None
    if "nameplate" in data:
        plate = checked(path, "nameplate", plate_of, data["nameplate"])
        if simulated is None:
            print(simulated_guess(path))
        motor = plate.motor()
    else:
        told = motor = checked(path, "motor", partial(part, Motor), data["motor"])
        plate = Nameplate.of(told)
    if simulated is not None:
        # Beside a plate it has to be whole: a guess of which something is changed is still a guess.
        motor = checked(path, "plant.motor", lambda t: part(Motor, t, told), simulated)
    sheet = checked(path, "inverter", lambda t: inverter_of(t, plate.motor()), data.get("inverter"))
    inverter = checked(path, "plant.inverter", lambda t: part(Inverter, t, sheet), changes)
    with _in_plant(plant):
        options = {key: rich(value, key) for key, value in plant.items()}
    name = checked_name(path, data.get("name", path.stem))
    return _Task(name, plate, sheet, motor, inverter, options, told)


@contextmanager
def _in_plant(options: Mapping[str, Any]) -> Iterator[None]:
    """Puts the name of the table in front of an error that begins with one of the plant's options."""
    try:
        yield
    except (ValueError, TypeError) as error:
        if re.split(r"\W", str(error), maxsplit=1)[0] not in options:
            raise
        raise type(error)(f"[plant] {error}") from None


def _rows(task: _Task, found: Commissioned) -> Iterator[tuple[str, str, str, str]]:
    """Name, value, deviation and, against the simulated motor, error of everything found."""
    psi = found.motor.base["psi"]
    motor = task.motor.at_slip_frequency(task.options.get("deep_bar"))
    truth = {name: getattr(motor, name) for name in _UNITS}
    if motor.saturation is not None:
        inductance, a, exponent = motor.saturation
        truth["L_M"] = inductance / (1.0 + (a * psi) ** exponent) - motor.L_sigma
    values = {name: getattr(found.motor, name) for name in _UNITS}
    truth["R_s"] += task.inverter.r_d
    values["R_s"] += found.inverter.r_d
    pairs = found.motor.n_p
    yield (
        "n_p, by the plate",
        f"{pairs}",
        "–",
        "–" if pairs == task.motor.n_p else f"{task.motor.n_p} simulated",
    )
    for name, unit in _UNITS.items():
        scale = 1e3 if unit == "mH" else 1.0
        yield (
            "R_s + r_d" if name == "R_s" else name,
            f"{values[name] * scale:.4g} {unit}",
            f"{100 * found.deviation[name]:.1f} %",
            f"{100 * (values[name] / truth[name] - 1):+.1f} %",
        )
    loss, real = _loss(found.inverter), _loss(task.inverter)
    yield (
        "threshold, dead time",
        f"{loss:.3g} V",
        f"{100 * found.deviation['loss']:.1f} %",
        f"{100 * (loss / real - 1):+.1f} %",
    )
    c = (found.inverter.c_out, task.inverter.c_out)
    error = f"{100 * (c[0] / c[1] - 1):+.0f} %" if c[1] else "–"
    yield "c_out", f"{1e9 * c[0]:.3g} nF", f"{100 * found.deviation['c_out']:.0f} %", error
    if "leg_delay" in found.deviation:
        legs, real_legs = (
            1e9 * (pulses - pulses.mean(axis=0))
            for pulses in (np.array(found.inverter.leg_delay), np.array(_simulated(task).leg_delay))
        )
        yield (
            "legs, largest delay",
            f"{np.abs(legs).max():.3g} ns",
            f"{1e9 * found.deviation['leg_delay']:.2g} ns",
            f"{np.abs(legs - real_legs).max():.2g} ns",
        )
    if found.friction is not None:
        real_friction = task.options.get("coulomb", 0.0)
        error = "–" if "viscous" in task.options else f"{found.friction - real_friction:+.1g} N·m"
        yield "friction", f"{found.friction:.2g} N·m", f"{_FRICTION * found.motor.T_N:.1g} N·m", error


def _simulated(task: _Task) -> Inverter:
    """The inverter that is simulated, with the delays of its switches as `leg_delay`."""
    pulses = np.array(task.inverter.leg_delay) + pulse_delay(task.options)
    return task.inverter.replace(leg_delay=leg_delay(pulses))


def _far(plate: Nameplate, found: Commissioned) -> list[str]:
    """Values that are further than `_FAR` deviations from what the nameplate gives, in words."""
    expected = plate.motor()
    far = []
    for name in ("R_s", "R_R", "L_M"):
        value, by_plate, deviation = (
            getattr(found.motor, name),
            getattr(expected, name),
            plate.deviation[name],
        )
        if abs(np.log(value / by_plate)) > _FAR * deviation:
            scale, unit = (1e3, "mH") if name == "L_M" else (1.0, "Ω")
            far.append(
                f"{name} is {value * scale:.3g} {unit}; by the nameplate {by_plate * scale:.3g} {unit} "
                f"± {100 * deviation:.0f} %"
            )
    return far


def _loss(inverter: Inverter) -> float:
    """Voltage that a leg loses far from current zero, V."""
    return inverter.u_th + inverter.dead_time * inverter.f_s * inverter.u_dc


def figure(found: Commissioned) -> Figure:
    """The curve of the bridge with its fit, and the magnetising curve."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    drawn = Figure(figsize=(10, 4), layout="constrained")
    bridge, curve = drawn.subplots(1, 2)
    if found.bridge_levels:
        i, u, fit = np.array(found.bridge_levels).T
        slope = (fit[-1] - fit[-2]) / (i[-1] - i[-2])
        bridge.semilogx(i, u - slope * i, "o", label="measured")
        bridge.semilogx(i, fit - slope * i, "-", label="fit")
        bridge.legend()
        bridge.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        bridge.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        bridge.xaxis.set_minor_formatter(NullFormatter())
    bridge.set(xlabel="current along the a-axis, A", ylabel="voltage less its slope at the last level, V")
    bridge.set_title("bridge")
    motor = found.motor
    psi = np.linspace(0.0, 1.2, 121)
    if motor.saturation is not None:
        inductance, a, exponent = motor.saturation
        current = psi * motor.base["psi"] / inductance * (1 + (a * psi * motor.base["psi"]) ** exponent)
    else:
        current = psi * motor.base["psi"] / motor.L_s
    seen = psi <= (found.psi_max or 0.0)
    curve.plot(current[seen], psi[seen], "-", label="found")
    curve.plot(current[~seen], psi[~seen], "--", label="not reached")
    curve.axhline(1.0, color="grey", linewidth=0.8)
    curve.set(xlabel="magnetising current, A", ylabel="stator flux, p.u. of rated", title="magnetising curve")
    curve.legend()
    return drawn


def report(
    name: str, found: Commissioned, rows: Iterable[tuple[str, str, str, str]], warnings: Sequence[str] = ()
) -> str:
    """A page with the values and their deviations, the warnings, the curves, and the motor file."""
    cells = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    texts = (*found.warnings, *warnings)
    listed = "".join(f"<li>{html.escape(text)}</li>" for text in texts) or "<li>none</li>"
    limits = ""
    if found.extremes is not None:
        limits = (
            f"<p>Largest phase current {found.extremes[0]:.2f} of the rated peak; the shaft turned by "
            f"{np.degrees(found.extremes[1]):.3f}° electrical in the procedures at standstill.</p>"
        )
    return page(
        f"Commissioning: {name}",
        f"<p>{html.escape(found.status)}, {found.duration:.1f} s</p>"
        "<h2>Values</h2><table><tr><th>quantity</th><th>found</th><th>deviation (1σ)</th>"
        f"<th>error on the plant</th></tr>{cells}</table>"
        f"<h2>Warnings</h2><ul>{listed}</ul>{limits}"
        f"<h2>Curves</h2><figure>{svg(figure(found))}</figure>"
        f"<h2>Motor file</h2><pre>{html.escape(found.to_toml(name=name))}</pre>",
    )
