"""Fig. 11: the steady state under a wrong r̂_s, loaded in steps, adaptation off.

The closed form below is a circle in the plane of the stator current, i_d to the right and i_q upwards, for
every r̂_s: with `A = l_s σl_s + κ²` its centre is `((l_s + σl_s) ψ*/2A, -κ ψ*/A)` and its radius follows
from `|i|² A` = `ψ*²` at the point nearest to the origin. For r̂_s = r_s it is the Heyland circle; "the value
of the stator resistance does have an influence both on the diameter and the origin".

At ω = 0.5, saturation off: the closed form ε = −(2 ψ* κ i_q + κ² i_s²), κ = (r̂_s − r_s)/ω_s, is that of a
linear machine. At lower ω_s the loci spread as 1/ω_s and leave the range of the flux controller. Motoring:
generating with r̂_s > r_s, flux control itself is unstable (docs/gains.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.draw import STYLE, TRUE, figure_of
from stillflux.evidence.figure import Control, Experiment, fields
from stillflux.evidence.machines import inverter_of, motor_of
from stillflux.evidence.paper import paper_drive, runs_to_the_end
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATIOS = (0.5, 0.75, 1.0, 1.25, 1.5)
"""r̂_s/r_s."""
_LOADS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
_CHANGE, _BEGIN, _STAY = 5.0, 8.0, 2.0
"""The real resistance changes, the load steps begin, each lasts, s."""


def scenarios(machine: str, arithmetic: str = "f32", omega: float = 0.5) -> tuple[Scenario, ...]:
    """One run for each r̂_s/r_s: the real resistance changes at 5 s, the drive does not follow."""
    load = [(0.0, 0.0)]
    for k, torque in enumerate(_LOADS):
        begin = _BEGIN + k * _STAY
        load += [(begin, torque), (begin + _STAY, torque)]
    runs = []
    for ratio in RATIOS:
        motor, inverter = motor_of(machine), inverter_of(machine)
        real = (motor.R_s + inverter.r_d) / ratio - inverter.r_d
        run = paper_drive(
            machine,
            arithmetic,
            name=f"Fig. 11, r̂_s/r_s = {ratio:g}",
            omega=omega,
            load=load,
            offset=0.0,
            duration=load[-1][0],
            changes=[(_CHANGE, {"R_s": real})],
        ).with_settings(resistance_adaptation=False)
        runs.append(run.replace(plant={**run.plant, "saturation": False}))
    return tuple(runs)


def locus(result: Result, ratio: float) -> NDArray[np.float64]:
    """Rows i_q, i_d, i_d of the closed form and ψ̂_s, per unit, one column for each load."""
    scenario = result.scenario
    base, motor, r_d = scenario.motor.base, scenario.motor, scenario.inverter.r_d
    l_s, sigma_l_s = motor.L_s / base["l"], motor.L_sigma / base["l"]
    r_hat = (motor.R_s + r_d) / base["z"]
    points = []
    for k in range(len(_LOADS)):
        end = _BEGIN + (k + 1) * _STAY
        steady = result.window(end - 1.0, end - 1e-3)
        turned = steady["i_s"] * np.exp(-1j * np.angle(steady["estimate.psi_s"]))
        i_d, i_q = turned.mean().real / base["i"], turned.mean().imag / base["i"]
        psi = np.abs(steady["estimate.psi_s"]).mean() / base["psi"]
        kappa = r_hat * (1.0 - 1.0 / ratio) / (steady["omega_s"].mean() / base["omega"])
        # ψ² - (l_s + σl_s) i_d ψ + l_s σl_s i² = ε = -(2 ψ κ i_q + κ² i²), solved for i_d.
        a, b = l_s * sigma_l_s + kappa**2, (l_s + sigma_l_s) * psi
        root = b * b - 4 * a * (psi**2 + 2 * psi * kappa * i_q + a * i_q**2)
        points.append((i_q, i_d, (b - np.sqrt(root)) / (2 * a) if root >= 0 else np.nan, psi))
    return np.array(points).T


def _deviation(ratio: float) -> str:
    return f"r̂_s/r_s = {ratio:g}: i_d, worst deviation from the closed form"


def claims(*results: Result) -> list[Claim]:
    """i_d(i_q) on the closed form for every r̂_s/r_s."""
    found = []
    for result, ratio in zip(results, RATIOS, strict=True):
        if result.status != "running":
            found.append(runs_to_the_end(result))
            continue
        _, i_d, expected, _ = locus(result, ratio)
        found.append(at_most(_deviation(ratio), 100 * float(np.abs(i_d / expected - 1).max()), 1, "%"))
    return found


def circle(result: Result, ratio: float) -> tuple[complex, float]:
    """Centre and radius of the closed form in the plane of i_d + j i_q, per unit."""
    scenario = result.scenario
    base, motor = scenario.motor.base, scenario.motor
    l_s, sigma_l_s = motor.L_s / base["l"], motor.L_sigma / base["l"]
    steady = result.window(_BEGIN + 1.0, _BEGIN + len(_LOADS) * _STAY)
    omega_s = float(np.median(steady["omega_s"])) / base["omega"]
    psi = float(np.median(np.abs(steady["estimate.psi_s"]))) / base["psi"]
    kappa = (motor.R_s + scenario.inverter.r_d) / base["z"] * (1.0 - 1.0 / ratio) / omega_s
    a = l_s * sigma_l_s + kappa**2
    centre = complex((l_s + sigma_l_s) * psi / (2 * a), -kappa * psi / a)
    return centre, float(np.sqrt(abs(centre) ** 2 - psi**2 / a))


def draw(*results: Result) -> Figure:
    """Loci in the plane of the stator current: the whole circles, and enlarged where the machine works."""
    import matplotlib as mpl

    figure = figure_of(9.6, 4.8)
    colours = ("#7b3294", "#b07cc0", TRUE, "#5aae61", "#1b7837")
    with mpl.rc_context(STYLE):
        whole, part = figure.subplots(1, 2)
        for result, ratio, colour in zip(results, RATIOS, colours, strict=True):
            if result.status != "running":
                continue
            i_q, i_d, _, _ = locus(result, ratio)
            centre, radius = circle(result, ratio)
            around = centre + radius * np.exp(1j * np.linspace(0, 2 * np.pi, 1500))
            for panel in (whole, part):
                panel.plot(
                    around.real,
                    around.imag,
                    color=colour,
                    linewidth=0.9,
                    label=rf"$\hat r_s/r_s$ = {ratio:g}",
                )
                panel.plot(i_d, i_q, "o", color=colour, markersize=3.5)
        most = 1.15 * max(
            float(np.abs(r["estimate.i_dq"]).max()) / r.scenario.motor.base["i"] for r in results
        )
        part.set(xlim=(0.0, most), ylim=(-most, most), title="enlarged; points: plant, lines: closed form")
        whole.set(aspect="equal", title="the circles")
        for panel in (whole, part):
            panel.set(xlabel="$i_d$, pu", ylabel="$i_q$, pu")
            panel.title.set_fontsize(9)
        part.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


EXPERIMENTS = (
    Experiment(
        "11",
        "Loci of the stator current with r̂_s as parameter",
        "i_d depends on r̂_s/r_s at given i_q",
        scenarios,
        claims,
        draw,
        Control("no error of r̂_s", fields(changes=()), (_deviation(0.5),), event=_CHANGE),
        directed=False,
        beside="the adaptation of the published scheme is switched off",
    ),
)
