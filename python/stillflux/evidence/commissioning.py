"""Commissioning of motors and bridges drawn at random: what is found against the truth, and how the drive
runs with it.

A draw is a motor of 0.25 to 200 kW at 400 V or of 1 to 12 kW at 34 V, one to three pole pairs, with a
saturation curve, eddy currents in the iron and a second rotor branch, on a bridge with capacitive edges, read
by 12-bit converters with noise, offsets and gains. The commissioning gets the nameplate of the rated point,
rounded as printed, and a data sheet whose threshold, dead time and capacitance are off.

| quantity | distribution |
|---|---|
| power | log-uniform, 0.25 … 200 kW (88 %) or 1 … 12 kW at 34 V (12 %) |
| R_s, R_R | those of the size times a log-normal factor, 1σ 25 % |
| L_σ, L_s | 0.17 pu and that of the size, times log-normal factors, 1σ 20, 12 % |
| saturated part at rated flux, exponent | uniform, 0.15 … 0.8, 5 … 9 |
| iron: resistance, time constant | uniform, 25 … 60 pu, 60 … 200 µs |
| second rotor branch: conductance, inverse leakage | uniform, 5 … 25 %, 25 … 50 % |
| node capacitance | log-uniform, 0.2 … 2 nF; the data sheet says 1 nF |
| threshold, dead time, r_d | 1σ 30, 8, 20 % |
| friction of the bearings | uniform, 0.2 … 2 % of rated torque |
| delay of each switch | 1σ 25 ns, of which the data sheet says nothing |
| current channels | offset 1 % of the rated peak, gain 1 %, each uniform; noise 0.4 % of the rated rms |

The errors of a motor's values are relative to those of slip frequency, in per cent; that of the bridge's
curve is the largest between 2 and 120 % of the rated peak current, in per cent of the dead-time voltage, of
which the mean delay of the legs is a part; that of `L_M(ψ)` is the largest between half and 1.1 of rated
flux; that of the legs is the root mean square of the errors of the six `leg_delay`, in ns.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.commissioning import Commissioned, commission, pulse_delay
from stillflux.evidence.claims import Claim, at_most, reported
from stillflux.evidence.courses import COURSES, Demand
from stillflux.evidence.draws import CUT, DELAY
from stillflux.evidence.effects import DEEP_BAR, EDDY_TIME, IRON_RESISTANCE, iron_loss
from stillflux.evidence.journal import Runner
from stillflux.evidence.judge import angle
from stillflux.evidence.machines import scaled
from stillflux.evidence.report.page import cut_off
from stillflux.evidence.tolerance import EVERY, SIGNALS, loss, start_up
from stillflux.nameplate import Nameplate
from stillflux.options import DriveSettings, PlantOptions
from stillflux.parallel import run_jobs
from stillflux.parameters import Inverter, Motor
from stillflux.scenario import Scenario
from stillflux.simulation import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "DRAWS",
    "FIRST",
    "LIMITS",
    "STATED",
    "TOLD",
    "Draw",
    "Outcome",
    "claims",
    "draw",
    "figure",
    "page",
    "run",
    "run_all",
    "table",
]

FIRST, DRAWS = 3000, 200
"""First draw of a campaign, those before were looked at while the procedures were made, and number of the
draws: about two minutes on two cores, without the drive's courses."""
LIMITS: Mapping[str, float] = {
    "R_s + r_d": 1.0,
    "bridge curve": 5.0,
    "L_sigma": 5.0,
    "R_R": 5.0,
    "L_M(ψ)": 3.0,
    "J": 10.0,
}
"""Largest admissible median of each error, %; 95 % of the draws are to be within twice that."""
FRICTION = (0.002, 0.02)
"""Friction of a free shaft's bearings, of rated torque."""
CURRENT, TURN, TIME = 1.5, 1.0, 60.0
"""Largest phase current relative to the rated peak, largest turn of a free shaft at standstill in electrical
degrees, and longest duration in s."""
STATED = "rms error over stated standard deviation"
"""Quantity of a value found: 1 where its standard deviation is as large as it says."""
TOLD = ("true", "found", "nameplate")
"""What the drive is told in its courses; the nameplate alone is the negative control."""


@dataclass(frozen=True)
class Draw:
    """A motor on its bridge, and what is known of them."""

    power: float
    """W."""
    plate: Nameplate
    sheet: Inverter
    motor: Motor
    inverter: Inverter
    plant: PlantOptions
    """Options of the plant."""

    @property
    def seen(self) -> Motor:
        """The motor at slip frequency, which is that of the drive's model."""
        return self.motor.at_slip_frequency(self.plant["deep_bar"])


@dataclass(frozen=True)
class Outcome:
    """What a draw showed."""

    seed: int
    power: float
    status: str
    errors: Mapping[str, float]
    """By the names of `LIMITS` and of the capacitance, %, and of the legs, ns."""
    deviations: Mapping[str, float]
    """What the commissioning states of some of them, 1σ, in the same units."""
    current: float
    turn: float
    duration: float
    drives: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    """Largest angle error in degrees, and what was lost, by "told, course"."""


def draw(seed: int) -> Draw:
    """A draw by its number."""
    r = np.random.default_rng([seed, 16])
    low = r.random() < 0.12
    P = math.exp(r.uniform(0.0, math.log(12.0)) if low else r.uniform(math.log(0.25), math.log(200.0)))
    U, f = (34.0, 100.0) if low else (400.0, 50.0)
    n_p = int(r.choice([2, 2, 2, 1, 3]))
    z = U * U / (P * 1e3) * 0.72 * P**0.04
    omega = 2 * math.pi * f

    def about(sigma: float) -> float:
        return math.exp(sigma * float(np.clip(r.normal(), -2.5, 2.5)))

    R_s, R_R = 0.075 * P**-0.33 * about(0.25) * z, 0.055 * P**-0.33 * about(0.25) * z
    L_sigma = min(max(0.17 * about(0.2), 0.08), 0.3) * z / omega
    L_s = 1.9 * P**0.12 * about(0.12) * z / omega
    c, S = r.uniform(0.15, 0.8), r.uniform(5.0, 9.0)
    psi = math.sqrt(2 / 3) * U / omega
    T_N = _torque(R_s, R_R, L_sigma, L_s, U, omega, n_p, slip=R_R / z)
    motor = Motor.inverse_gamma(
        R_s=R_s,
        R_R=R_R,
        L_sigma=L_sigma,
        L_M=L_s - L_sigma,
        n_p=n_p,
        J=2.5e-4 * T_N**1.35 * about(0.3),
        U_N=U,
        I_N=U / (math.sqrt(3) * z),
        f_N=f,
        T_N=T_N,
        saturation=(L_s * (1 + c), c ** (1 / S) / psi, S),
    )
    plate = Nameplate.of(motor)
    motor = motor.replace(I_N=plate.I_N)
    f_s = (
        16e3 if low else next(f for limit, f in ((7.5, 10e3), (30, 8e3), (100, 5e3), (1e9, 4e3)) if limit > P)
    )
    dead_time = (
        0.8e-6 if low else next(t for limit, t in ((7.5, 2e-6), (50, 2.5e-6), (1e9, 3e-6)) if limit > P)
    )
    sheet = Inverter(
        u_dc=56.0 if low else 540.0,
        f_s=f_s,
        u_th=0.05 if low else 1.1,
        r_d=r.uniform(0.002, 0.006) * z,
        dead_time=dead_time,
        c_out=1e-9,
    )

    def off(sigma: float) -> float:
        return 1.0 + sigma * float(np.clip(r.normal(), -2.5, 2.5))

    inverter = sheet.replace(
        u_th=sheet.u_th * off(0.3),
        dead_time=dead_time * off(0.08),
        r_d=sheet.r_d * off(0.2),
        c_out=1e-9 * math.exp(r.uniform(math.log(0.2), math.log(2.0))),
    )
    R_fe = r.uniform(*IRON_RESISTANCE) * z
    plant: PlantOptions = {
        "seed": seed,
        "adc_noise": 0.004 * motor.I_N,
        "current_offset": tuple(0.01 * math.sqrt(2) * motor.I_N * r.uniform(-1, 1, 3)),
        "current_gain": tuple(1.0 + 0.01 * r.uniform(-1, 1, 3)),
        "iron_loss": iron_loss(motor, R_fe, r.uniform(*EDDY_TIME)),
        "deep_bar": (r.uniform(*DEEP_BAR[0]), r.uniform(*DEEP_BAR[1])),
    }

    def delays() -> list[tuple[float, float]]:
        # None is negative.
        return [(DELAY * (CUT + g), DELAY * (CUT + h)) for g, h in np.clip(r.normal(size=(3, 2)), -CUT, CUT)]

    plant["turn_on_delay"], plant["turn_off_delay"] = delays(), delays()
    plant["coulomb"] = motor.T_N * r.uniform(*FRICTION)
    return Draw(1e3 * P, plate, sheet, motor, inverter, plant)


def _torque(
    R_s: float, R_R: float, L_sigma: float, L_s: float, U: float, omega: float, n_p: int, slip: float
) -> float:
    """Torque at rated voltage and frequency, N·m."""
    rotor = R_R / slip
    magnetising = 1j * omega * (L_s - L_sigma)
    shared = rotor * magnetising / (rotor + magnetising)
    i_s = math.sqrt(2 / 3) * U / (R_s + 1j * omega * L_sigma + shared)
    return float(1.5 * rotor * abs(i_s * shared / rotor) ** 2 * n_p / omega)


def _inductance(motor: Motor, psi: float) -> float:
    """L_M at a flux relative to the rated one, H."""
    if motor.saturation is None:
        return motor.L_M
    L_u, a, S = motor.saturation
    saturated: float = L_u / (1 + (a * psi * motor.base["psi"]) ** S)
    return saturated - motor.L_sigma


def _leg(inverter: Inverter, i: float) -> float:
    """Loss of a leg at a positive current, V."""
    U, knee = (
        inverter.dead_time * inverter.f_s * inverter.u_dc,
        inverter.c_out * inverter.u_dc / inverter.dead_time,
    )
    return inverter.u_th + U * (1 - 0.5 * knee / i if i > knee else 0.5 * i / knee)


def errors(made: Draw, found: Commissioned) -> dict[str, float]:
    """By the names of `LIMITS` and of the capacitance, %, and of the legs, ns."""
    true, got = made.seen, found.motor
    peak = math.sqrt(2) * true.I_N
    pulses = pulse_delay(made.plant)
    common = pulses.mean(axis=0)
    # What is common to the legs and changes its sign with the current is dead time.
    real = made.inverter.replace(dead_time=made.inverter.dead_time - 0.5 * float(common[0] - common[1]))
    U = real.dead_time * real.f_s * real.u_dc
    curve = max(abs(_leg(found.inverter, i) - _leg(real, i)) / U for i in peak * np.geomspace(0.02, 1.2, 60))
    legs = np.array(found.inverter.leg_delay) - (pulses - common)
    inductance = max(
        abs(_inductance(got, psi) / _inductance(true, psi) - 1) for psi in np.linspace(0.5, 1.1, 7)
    )
    relative = {
        "R_s + r_d": abs((got.R_s + found.inverter.r_d) / (true.R_s + made.inverter.r_d) - 1),
        "bridge curve": curve,
        "L_sigma": abs(got.L_sigma / true.L_sigma - 1),
        "R_R": abs(got.R_R / true.R_R - 1),
        "L_M(ψ)": inductance,
        "J": abs(got.J / true.J - 1),
        "c_out": abs(found.inverter.c_out / real.c_out - 1),
    }
    in_per_cent = {name: 100.0 * value for name, value in relative.items()}
    return {**in_per_cent, "legs": 1e9 * float(np.sqrt(np.mean(legs**2)))}


def run(seed: int, arithmetic: str = "f32", shaft: Any = "free", courses: Sequence[str] = ()) -> Outcome:
    """Commissions a draw, and runs the drive on `courses` with each of `TOLD`."""
    made = draw(seed)
    found = commission(
        made.plate,
        made.sheet,
        plant_motor=made.motor,
        plant_inverter=made.inverter,
        shaft=shaft,
        arithmetic=arithmetic,
        **made.plant,
    )
    drives = {
        f"{told}, {course}": _drive(made, found, told, COURSES[course].build(made.motor, seed), arithmetic)
        for course in courses
        for told in TOLD
    }
    current, turn = found.extremes or (math.nan, math.nan)
    names = {
        "R_s + r_d": "R_s",
        "L_sigma": "L_sigma",
        "R_R": "R_R",
        "L_M(ψ)": "L_M",
        "J": "J",
        "c_out": "c_out",
    }
    deviations = {name: 100.0 * found.deviation[key] for name, key in names.items()}
    deviations["legs"] = 1e9 * found.deviation.get("leg_delay", math.nan)
    return Outcome(
        seed,
        made.power,
        found.status,
        errors(made, found),
        deviations,
        current,
        math.degrees(turn),
        found.duration,
        drives,
    )


def _drive(made: Draw, found: Commissioned, told: str, demand: Demand, arithmetic: str) -> tuple[float, str]:
    """Largest angle error and what was lost on what a course demands."""
    settings: DriveSettings = {}
    if told == "true":
        motor, inverter = made.seen, made.inverter
    elif told == "found":
        motor, inverter, settings = found.motor, found.inverter, found.settings
    else:
        motor, inverter = made.plate.motor(), made.sheet
    begin = start_up(motor, inverter) + 0.05
    demand = demand.after(begin)
    scenario = Scenario(
        motor=motor,
        inverter=inverter,
        plant_motor=made.motor,
        plant_inverter=made.inverter,
        arithmetic=arithmetic,
        settings=settings,
        plant=made.plant,
        omega_ref=scaled(demand.omega, made.motor.base["omega_m"]),
        load_torque=scaled(demand.load, made.motor.T_N),
        changes=demand.changes,
        duration=demand.end,
        signals=SIGNALS,
        record_every=max(1, round(EVERY * inverter.f_s)),
    )
    result = simulate(scenario)
    when, why = loss(result, begin)
    return float(np.abs(angle(result))[result.t <= begin + when].max(initial=0.0)), why


def run_all(
    seeds: Sequence[int],
    arithmetic: str = "f32",
    courses: Sequence[str] = (),
    show: Callable[[int, int, Outcome], None] | None = None,
    runner: Runner = run_jobs,
) -> list[Outcome]:
    """Runs draws on all processors."""
    jobs: list[tuple[Any, ...]] = [(seed, arithmetic, "free", tuple(courses)) for seed in seeds]
    return runner(run, jobs, first=lambda job: False, show=show)


def progress(done: int, total: int, outcome: Outcome) -> None:
    """A line on stderr for every draw that failed, and for every tenth."""
    if outcome.status != "done" or done % 10 == 0 or done == total:
        print(f"[{done:4d}/{total}] draw {outcome.seed}: {outcome.status}", file=sys.stderr, flush=True)


def claims(outcomes: Sequence[Outcome]) -> list[Claim]:
    """Distribution of every error against its limit, what no draw may exceed, and the drive's courses."""
    refused = [x for x in outcomes if x.status != "done"]
    found = [
        reported("draws", len(outcomes)),
        at_most("refused or not completed", len(refused), 0, note=", ".join(str(x.seed) for x in refused)),
        at_most("largest phase current", max(x.current for x in outcomes), CURRENT, "of the rated peak"),
        at_most("largest turn of the shaft at standstill", max(x.turn for x in outcomes), TURN, "°"),
        at_most("longest duration", max(x.duration for x in outcomes), TIME, "s"),
    ]
    for name, limit in LIMITS.items():
        values = np.array([x.errors[name] for x in outcomes if x.status == "done"])
        if len(values):
            found.append(at_most(f"{name}, median error", float(np.median(values)), limit, "%"))
            found.append(
                at_most(f"{name}, 95 % of the draws within", float(np.quantile(values, 0.95)), 2 * limit, "%")
            )
            found.append(reported(f"{name}, largest error", float(values.max()), "%"))
    done = [x for x in outcomes if x.status == "done"]
    for name, unit in (("c_out", "%"), ("legs", "ns")):
        values = np.array([x.errors[name] for x in done])
        if len(values):
            found.append(reported(f"{name}, median error", float(np.median(values)), unit))
            found.append(
                reported(f"{name}, 95 % of the draws within", float(np.quantile(values, 0.95)), unit)
            )
            found.append(reported(f"{name}, largest error", float(values.max()), unit))
    for name in done[0].deviations if done else ():
        ratio = np.array([x.errors[name] / x.deviations[name] for x in done])
        found.append(reported(f"{name}, {STATED}", float(np.sqrt(np.mean(ratio**2)))))
    for key in dict.fromkeys(key for x in outcomes for key in x.drives):
        runs = [x.drives[key] for x in outcomes if key in x.drives]
        kept = [error for error, why in runs if not why]
        found.append(reported(f"told {key}: lost of {len(runs)}", len(runs) - len(kept)))
        if kept:
            largest = float(np.median(kept))
            found.append(reported(f"told {key}: median of the largest angle error", largest, "°"))
    return found


def _verdict(claim: Claim) -> str:
    """What is only reported has none."""
    if claim.direction == "reported":
        return ""
    return "ok" if claim.ok else "FAILED"


def table(outcomes: Sequence[Outcome]) -> str:
    """The claims as plain text, one a line."""
    found = claims(outcomes)
    width, measured = (
        max(len(text) for text in texts) for texts in zip(*((c.text, c.measured) for c in found), strict=True)
    )
    return "\n".join(f"  {c.text:<{width}}  {c.measured:>{measured}}  {_verdict(c)}" for c in found)


def figure(outcomes: Sequence[Outcome]) -> Figure:
    """Distribution of every error, with its limits."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(10, 5), layout="constrained")
    for axes, (name, limit) in zip(drawn.subplots(2, 3).flat, LIMITS.items(), strict=True):
        values = np.sort([x.errors[name] for x in outcomes if x.status == "done"])
        axes.step(values, np.linspace(0, 100, len(values)), where="post")
        for x, y in ((limit, 50), (2 * limit, 95)):
            axes.plot([x], [y], "k+")
        axes.set(title=name, xlabel="error, %", ylabel="draws, %", xlim=(0, 4 * limit))
    return drawn


def page(path: Path, command: str, outcomes: Sequence[Outcome], stopped: str = "") -> None:
    """Writes the page."""
    import html

    from stillflux import html_page

    rows = "".join(
        f"<tr><td>{html.escape(c.text)}</td><td>{html.escape(c.measured)}</td><td>{_verdict(c)}</td></tr>"
        for c in claims(outcomes)
    )
    html_page.write(
        path,
        "Commissioning of motors and bridges drawn at random",
        f"<p>Made by <code>{html.escape(command)}</code>.</p>{cut_off(stopped)}"
        f"<table><tr><th>claim</th><th>measured</th><th>verdict</th></tr>{rows}</table>"
        f"<figure>{html_page.svg(figure(outcomes))}</figure>",
    )
