"""Fig. 10: low speed with offset, the offset estimator off; judged beside Fig. 15, where it is on.

The compensator of gain k leaves an offset u_0 a ripple of |ψ̂_s| of at least 2 u_0/k. At 25 mV its default,
0.06, is enough for a circle. What the paper shows, a smooth circle with errors of angle beyond 10° and
swinging speed, is met at a gain of 0.3 with 75 mV ("10-75mV"). With the scale taken here, ±10 V = 2.5 I_N,
its 250 mV are more than that; the figure is run with three gains ("10-250mV"). The paper gives neither the
scale nor its gain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stillflux import metrics
from stillflux.evidence.claims import Claim, at_least, at_most, reported
from stillflux.evidence.draw import (
    ESTIMATE,
    STYLE,
    TRUE,
    figure_of,
    from_time,
    parts,
    recorder,
    spaced,
    until_fault,
)
from stillflux.evidence.figure import Control, Experiment, Limit, first, settings
from stillflux.evidence.figures import fig15
from stillflux.evidence.judge import angle
from stillflux.evidence.machines import MACHINES
from stillflux.evidence.paper import OFFSET_25_MV, OFFSET_250_MV, RUN, runs_to_the_end
from stillflux.result import Result
from stillflux.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ANGLE = "field angle error over u_0/(ω_s ψ)"


def scenarios(
    machine: str, arithmetic: str = "f32", offset: float = OFFSET_25_MV
) -> tuple[Scenario, Scenario]:
    """The run without offset estimator, and that of Fig. 15."""
    without = fig15.scenario(machine, arithmetic, offset, name="Fig. 10")
    return without.with_settings(offset_estimator=False), fig15.scenario(machine, arithmetic, offset)


def claims(result: Result, fig15_result: Result) -> list[Claim]:
    """The circle stays round, the angle does not stay right."""
    if result.status != "running":
        return [runs_to_the_end(result)]
    settled = result.window(fig15.SETTLED)
    error = float(np.abs(angle(settled)).max())
    rate = abs(settled["omega_s"].mean()) * np.abs(settled["psi_s"]).mean()
    bound = float(np.degrees(abs(metrics.offset_voltage(settled)) / rate))
    quiet = metrics.speed_ripple(fig15_result.window(fig15.SETTLED))
    return [
        runs_to_the_end(result),
        at_most(fig15.RIPPLE, 100 * metrics.flux_ripple(settled), 3, "%"),
        at_least(_ANGLE, error / bound, 1, note=f"{error:.2g}° against {bound:.2g}°"),
        at_least("speed ripple over Fig. 15's", metrics.speed_ripple(settled) / quiet, 5),
    ]


_CONTROL = Control("offset estimator on", first(settings(offset_estimator=True)), (_ANGLE,), event=RUN)

GAINS = (0.06, 0.3, 1.0)
"""Gains of the noise compensator with the tenfold offset."""
_MIDDLE = 1
_ROUND = "ripple of |ψ̂_s| at k = 0.3"
_TURNS = "revolutions of the field over those of the reference, at k = 0.3"


def _with_gain(run: Scenario, k: float) -> Scenario:
    """The compensator alone: its floor k, and as in motoring when the swinging drive seems to regenerate.

    The monitors, which would stop a drive that swings so, are off.
    """
    return run.replace(name=f"Fig. 10, k = {k:g}").with_settings(
        noise_gain=(k, max(k, 0.5)), noise_regeneration=4.0, supervision=False
    )


def threefold(machine: str, arithmetic: str = "f32") -> tuple[Scenario, Scenario]:
    """75 mV at a gain of 0.3, and Fig. 15 at the same offset."""
    without, quiet = scenarios(machine, arithmetic, 3 * OFFSET_25_MV)
    return _with_gain(without, GAINS[_MIDDLE]), quiet


def tenfold(machine: str, arithmetic: str = "f32") -> tuple[Scenario, ...]:
    """Without offset estimator at each gain, and Fig. 15 at the same offset."""
    without, quiet = scenarios(machine, arithmetic, OFFSET_250_MV)
    return (*(_with_gain(without, k) for k in GAINS), quiet)


def tenfold_claims(*results: Result) -> list[Claim]:
    """At the gain in the middle the field turns; the circle is as round as that offset leaves it."""
    for result in results:
        if result.status != "running":
            return [runs_to_the_end(result)]
    quiet = metrics.speed_ripple(results[-1].window(fig15.SETTLED))
    found, others = [], []
    for result, k in zip(results, GAINS, strict=False):
        settled = result.window(fig15.SETTLED)
        base, motor = result.scenario.motor.base, result.scenario.motor
        u_0 = (motor.R_s + result.scenario.inverter.r_d) * abs(_offset(result))
        error = float(np.abs(angle(settled)).max())
        # At the reference, since the field may swing or stand.
        omega = float(np.abs(settled["reference"]).mean()) * motor.n_p
        turns = abs(float(metrics.turns(settled)[-1])) / (omega * float(np.ptp(settled.t)) / (2 * np.pi))
        ripple, law = 100 * metrics.flux_ripple(settled), f"2 u_0/k = {200 * u_0 / k / base['u']:.2g} %"
        if k == GAINS[_MIDDLE]:
            bound = float(np.degrees(u_0 / (omega * base["psi"])))
            found = [
                runs_to_the_end(result),
                at_least(_TURNS, turns, 0.8),
                at_most(_ROUND, ripple, 3, "%", law),
                at_least(_ANGLE, error / bound, 1, note=f"{error:.2g}° against {bound:.2g}°"),
                at_least("speed ripple over Fig. 15's", metrics.speed_ripple(settled) / quiet, 5),
            ]
        else:
            what = fig15.RIPPLE if k == GAINS[0] else f"ripple of |ψ̂_s| at k = {k:g}"
            note = f"{turns:.2g} of the revolutions"
            others.append(reported(what, ripple, "%", law))
            others.append(reported(f"field angle error at k = {k:g}", error, "°", note))
    return [*found, *others]


_LARGE = Limit(
    (_ROUND, _TURNS, "speed ripple over Fig. 15's"),
    "What decides is the angle that the offset leaves, u_0/(ω_s ψ*), and with it how far speed and "
    "torque swing: the law of a field that turns evenly, 2 u_0/k, is the least. With a gain of 0.3 the "
    "ripple stays within 3 % up to some 85 mV (2.2 kW) and 140 mV (11 kW) at ±10 V = 2.5 I_N, with 11° "
    "to 30° of error as in the paper's figure; a larger gain does not help, since the rotation is lost "
    "(k = 1). So the paper's sensors gave a volt for two to three times less current than assumed here, "
    "or its r_s was smaller; its scale is not given.",
)


def _offset(result: Result) -> complex:
    offset = result.scenario.plant["current_offset"]
    assert isinstance(offset, complex)
    return offset


def _compared(*results: Result) -> Figure:
    """Circles and angle errors at the three gains."""
    import matplotlib as mpl

    figure = figure_of(10.5, 5.6)
    for part, result, k in zip(parts(figure, 1, len(GAINS)), results, GAINS, strict=False):
        upper, lower = parts(part, 2, 1, height_ratios=(3, 2))
        part_run = until_fault(result)
        begin = min(fig15.SETTLED, max(0.0, float(part_run.t[-1]) - 4.0))
        pu = from_time(part_run, begin, begin + 4.0)
        with mpl.rc_context(STYLE):
            panel = upper.subplots()
            panel.plot(*spaced(pu.psi("estimate.psi_s")), color=ESTIMATE, linewidth=0.9, label="estimated")
            panel.plot(*spaced(pu.psi("psi_s")), color=TRUE, linewidth=0.9, label="true")
            panel.set(aspect="equal", xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), title=f"k = {k:g}")
            panel.set(xlabel=r"$\psi_\alpha$", ylabel=r"$\psi_\beta$")
            panel.legend(loc="center")
        recorder(lower, pu.t, [pu.speed(), pu.angle(60.0)])
    return figure


EXPERIMENTS = (
    Experiment(
        "10",
        "Low speed with offset, without offset estimator",
        "Circle round, field angle wrong, torque and speed oscillate",
        scenarios,
        claims,
        fig15.draw,
        _CONTROL,
        beside="a block of the published scheme is switched off",
    ),
    Experiment(
        "10-75mV",
        "Low speed with threefold offset, without offset estimator, gain of the compensator 0.3",
        "Circle round, field angle wrong, torque and speed oscillate",
        threefold,
        claims,
        fig15.draw,
        _CONTROL,
        beside="a block of the published scheme is switched off",
    ),
    Experiment(
        "10-250mV",
        "Low speed with tenfold offset, without offset estimator, gain of the compensator 0.3",
        "Circle round, field angle wrong, torque and speed oscillate",
        tenfold,
        tenfold_claims,
        _compared,
        Control("offset estimator on", settings(offset_estimator=True), (_ANGLE,), event=RUN),
        limits=dict.fromkeys(MACHINES, _LARGE),
        beside="a block of the published scheme is switched off",
    ),
)
