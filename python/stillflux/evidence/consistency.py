"""Consistency of the estimate: whether the drive knows how large its angle error is.

With the angle error e and the standard deviation σ that the drive expects of it, the normalised estimation
error squared `NEES = e²/σ²` has a mean of one where the filter's model and noise are those of the machine:
above one it is overconfident, below one too careful. The normalised innovation squared (NIS) says the same
of the innovation, which needs no truth. Both by region of the true stator frequency and load,

| region | abs(ω_s) | abs(load) |
|---|---|---|
| rotating, loaded | ≥ 0.01 | ≥ 0.3 T_N |
| rotating, unloaded | ≥ 0.01 | < 0.1 T_N |
| near ω_s = 0, loaded | < 0.01 | ≥ 0.3 T_N |
| at ω_s = 0, unloaded | < 0.01 | < 0.1 T_N |

over installations with every parameter off at once (`draws`), up to a loss of control and through it. Where
nothing is seen at all (no load, ω_s = 0) the mean says little: there the rank correlation of abs(e) with σ
tells whether a larger σ means a larger error. The confidence is judged as everywhere (`judge`). Of the start
the runs show how far the estimated resistance, r_d of the bridge included, is off when control begins.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stillflux.evidence.claims import Claim, at_least, at_most, reported
from stillflux.evidence.conditions import slip
from stillflux.evidence.courses import Course, Points, in_every_draw
from stillflux.evidence.journal import Runner
from stillflux.evidence.judge import CALM, CONFIDENT, angle, confidence
from stillflux.evidence.seeds import seed_of
from stillflux.evidence.tolerance import SIGNALS as JUDGED
from stillflux.evidence.tolerance import loss, scenario, start_up
from stillflux.metrics import resistance_error, running, smoothed
from stillflux.parallel import run_jobs
from stillflux.parameters import Motor
from stillflux.result import Result

__all__ = [
    "DRAWS",
    "REGIONS",
    "Consistency",
    "Sample",
    "by_claim",
    "judged",
    "progress",
    "rank_correlation",
    "run_all",
]

DRAWS = 40
"""Draws of each drive: the walks of ten are too few for a correlation."""
REGIONS = ("rotating, loaded", "rotating, unloaded", "near ω_s = 0, loaded", "at ω_s = 0, unloaded")
SIGNALS = (*JUDGED, "R_s", "estimate.R_s")
"""Recorded: what a loss is judged by, and the resistances."""
NEES_RANGE, NIS_MAX = (0.5, 2.0), 1.0
"""Bounds of the means. Innovations may be smaller than the filter assumes: it allows for machines that are
not as modelled."""
ANNOUNCED, NEEDLESS = 95.0, 1.0
"""Least share of excursions announced, and largest share of time with a needless alarm, %."""
LINE, LOADED, UNLOADED = 0.01, 0.3, 0.1
"""Borders of the regions, per unit of rated frequency and of rated torque."""
RESISTANCE = "error of the estimated resistance after the start, rms"
RESISTANCE_WORST = "largest error of the estimated resistance after the start"
_MEAN_OVER, _EVERY = 0.1, 0.1
"""True stator frequencies are means over the first, s; samples are taken every second, s."""


def _course(motor: Motor) -> tuple[Points, Points]:
    """Each region for several seconds; the one in which the estimate may be lost comes last."""
    line = -slip(motor, 1.0)
    omega = [(0, 0), (10, 0), (10.5, 0.08), (18.5, 0.08), (19, 0.08), (26, 0.08)]
    omega += [(27, line + 0.03), (28, line + 0.03), (38, line - 0.03), (39, line - 0.03)]
    load = [(0, 0), (13.5, 0), (14, 1), (18.5, 1), (19, -1), (23.5, -1), (24, 0.5), (26, 1)]
    return omega, load


COURSE = Course("every region", in_every_draw(_course), None)


@dataclass(frozen=True)
class Sample:
    """One run: what the table is made of."""

    machine: str
    draw: int
    region: NDArray[np.int8]
    """Of each sample, position in `REGIONS`."""
    error: NDArray[np.float64]
    """Angle error, rad."""
    sigma: NDArray[np.float64]
    """What the drive expects of it, rad."""
    nis: NDArray[np.float64]
    excursions: int
    misses: int
    needless: float
    running: float
    resistance: float
    """Relative error of the estimated resistance when control begins."""
    lost: str
    """A fault by name, "angle" or "speed"; empty: nothing was lost."""


@dataclass(frozen=True)
class Consistency:
    """All runs of one drive."""

    machine: str
    samples: Sequence[Sample]

    @property
    def claims(self) -> list[Claim]:
        """The rows of the table."""
        region, error, sigma, nis = (
            np.concatenate([getattr(x, name) for x in self.samples])
            for name in ("region", "error", "sigma", "nis")
        )
        found = [
            reported("draws", len(self.samples)),
            reported("lost", sum(bool(x.lost) for x in self.samples)),
        ]
        for k, name in enumerate(REGIONS):
            here = (region == k) & (sigma > 0.0)
            if not here.any():
                continue
            nees = float(np.mean((error[here] / sigma[here]) ** 2))
            found += [
                at_most(f"NEES, {name}", nees, NEES_RANGE[1]),
                at_least(f"NEES, {name}", nees, NEES_RANGE[0]),
                at_most(f"NIS, {name}", float(np.mean(nis[here])), NIS_MAX),
            ]
        unseen = (region == len(REGIONS) - 1) & (sigma > 0.0)
        correlation = rank_correlation(np.abs(error[unseen]), sigma[unseen])
        found.append(at_least(f"rank correlation of error and deviation, {REGIONS[-1]}", correlation, 0.0))
        excursions, misses = sum(x.excursions for x in self.samples), sum(x.misses for x in self.samples)
        found.append(reported("excursions beyond 15°", excursions))
        if excursions:
            announced = 100.0 * (excursions - misses) / excursions
            found.append(at_least("share of excursions announced", announced, ANNOUNCED, "%"))
        time = max(sum(x.running for x in self.samples), 1e-9)
        needless = 100.0 * sum(x.needless for x in self.samples) / time
        found.append(at_most("share of time with a needless alarm", needless, NEEDLESS, "%"))
        off = 100.0 * np.array([x.resistance for x in self.samples])
        found.append(reported(RESISTANCE, float(np.sqrt(np.mean(off**2))), "%"))
        found.append(reported(RESISTANCE_WORST, float(np.abs(off).max()), "%"))
        return found


def rank_correlation(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Spearman's: the correlation of the ranks, ties with their mean rank; 0 where either does not vary."""

    def ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
        _, where, counts = np.unique(values, return_inverse=True, return_counts=True)
        ends = np.cumsum(counts)
        middle: NDArray[np.float64] = (ends - 0.5 * (counts + 1.0))[where]
        centred: NDArray[np.float64] = middle - middle.mean()
        return centred

    if len(x) < 2:
        return 0.0
    a, b = ranks(x), ranks(y)
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0.0 else 0.0


def sampled(machine: str, draw: int, result: Result) -> Sample:
    """What the table needs of a run."""
    motor = result.scenario.motor
    begin = start_up(motor, result.scenario.inverter)
    when, why = loss(result, begin)
    dt = float(result.t[1] - result.t[0])
    turned = np.unwrap(np.angle(result["psi_s"]))
    omega_s = smoothed(np.gradient(turned, dt), round(_MEAN_OVER / dt)) / motor.base["omega"]
    load = np.abs(result["load_torque"]) / motor.T_N
    near, loaded, unloaded = np.abs(omega_s) < LINE, load >= LOADED, load < UNLOADED
    which = [~near & loaded, ~near & unloaded, near & loaded, near & unloaded]
    region = np.select(which, range(len(REGIONS)), -1).astype(np.int8)
    runs, error = running(result), np.abs(angle(result))
    # The first row under control has no confidence yet.
    known = runs & np.concatenate(([False], runs[:-1]))
    doubt = known & (result["estimate.confidence"] < CONFIDENT) & (error < CALM)
    trust = confidence(result, begin + when)
    part = np.flatnonzero(known & (result.t <= begin + when))[:: max(1, round(_EVERY / dt))]
    return Sample(
        machine=machine,
        draw=draw,
        region=region[part],
        error=result["angle_error"][part],
        sigma=result["estimate.angle_deviation"][part],
        nis=result["estimate.nis"][part],
        excursions=trust.excursions,
        misses=trust.misses,
        needless=dt * float(np.count_nonzero(doubt)),
        running=dt * float(np.count_nonzero(known)),
        resistance=float(resistance_error(result)[np.argmax(known)]),
        lost=why,
    )


def run(machine: str, draw: int, scheme: str, arithmetic: str, beyond_model: bool = False) -> Sample:
    """One draw of a drive through every region; `beyond_model`: with `effects`."""
    from stillflux.simulation import simulate

    seed = seed_of("consistency", machine, draw)
    made, _ = scenario(machine, COURSE, seed, scheme, arithmetic, beyond_model=beyond_model, signals=SIGNALS)
    return sampled(machine, draw, simulate(made))


def run_all(
    machines: Sequence[str],
    draws: Sequence[int],
    scheme: str = "enhanced",
    arithmetic: str = "f32",
    show: Callable[[int, int, Sample], None] | None = None,
    runner: Runner = run_jobs,
    beyond_model: bool = False,
) -> list[Sample]:
    """All runs, on all processors. On Ctrl-C raises `parallel.Stopped`."""
    jobs = [(machine, draw, scheme, arithmetic, beyond_model) for draw in draws for machine in machines]
    return runner(run, jobs, first=lambda job: False, show=show)


def progress(done: int, total: int, sample: Sample) -> None:
    """A line on stderr for every run that is lost, and for every tenth."""
    if sample.lost or done % 10 == 0 or done == total:
        what = f"{sample.machine}, draw {sample.draw}: {sample.lost or 'ok'}"
        print(f"[{done:4d}/{total}] {what}", file=sys.stderr, flush=True)


def judged(samples: Sequence[Sample]) -> list[Consistency]:
    """By drive."""
    groups: dict[str, list[Sample]] = {}
    for sample in samples:
        groups.setdefault(sample.machine, []).append(sample)
    return [Consistency(*item) for item in groups.items()]


def by_claim(found: Sequence[Consistency]) -> Mapping[tuple[str, str], dict[str, Claim]]:
    """Claims of every drive, by quantity and direction."""
    table: dict[tuple[str, str], dict[str, Claim]] = {}
    for x in found:
        for claim in x.claims:
            table.setdefault(claim.key, {})[x.machine] = claim
    return table
