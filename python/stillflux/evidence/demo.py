"""The headline run: a minute at zero stator frequency, by either scheme, and without the offset estimator;
and where the schemes differ: rated load at a speed at which the stator frequency is zero."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path

from stillflux.evidence.claims import Claim, at_most, holds, reported
from stillflux.evidence.conditions import SCHEMES, line_speed
from stillflux.evidence.figure import enhanced, until_it_runs_away
from stillflux.evidence.judge import EXCURSION, angle, lost
from stillflux.evidence.machines import motor_of, ramp
from stillflux.evidence.paper import paper_drive
from stillflux.evidence.registry import experiments
from stillflux.evidence.report import page
from stillflux.evidence.report.page import Section
from stillflux.parallel import undisturbed
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.simulation import simulate

__all__ = ["run"]

_SLOW, _ZERO, _END = 8.0, 10.0, 70.0
"""At ω = 0.05 under rated load until the first, at zero stator frequency from the second on, s."""


def run(machines: Sequence[str], out: Path, command: str, arithmetic: str = "f32") -> int:
    """Runs the demo on each machine, prints tables, writes `out/demo.html`.

    Returns the exit status: 0 if every claim holds and the negative control fails, 1 if not, 130 after
    Ctrl-C, with what was done by then.
    """
    sections: list[Section] = []
    stopped = ""
    try:
        for machine in machines:
            sections.extend(_sections(machine, arithmetic))
    except KeyboardInterrupt as stop:
        stopped = str(stop) or "interrupted"
    path = out / "demo.html"
    with undisturbed() if stopped else nullcontext():
        page.write(path, "Zero stator frequency without a speed sensor", command, sections, stopped)
    for section in sections:
        print(f"\n{section.title}\n{page.table(section)}")
    print(f"\nreport: {path}")
    if stopped:
        print(f"stillflux: {stopped}", file=sys.stderr)
        return 130
    return 0 if all(section.as_it_must for section in sections) else 1


def _sections(machine: str, arithmetic: str) -> Iterator[Section]:
    headline = experiments()["headline"]
    assert headline.control is not None
    (scenario,) = headline.runs(machine, arithmetic)
    (control,) = headline.runs(machine, arithmetic, role="control")
    control = control.replace(name=f"{scenario.name}, {headline.control.text}")
    (beyond,) = headline.runs(machine, arithmetic, role="enhanced")
    course = (
        "Start with current offset, offset voltage identified at 1 Hz, more than a minute at zero stator "
        "frequency, rated torque step held, load removed."
    )
    result = simulate(scenario, progress=True)
    title, slug = f"{machine}: the published scheme", f"demo-{machine}"
    yield Section(title, slug, result, headline.check(result), course)
    other = simulate(beyond, progress=True)
    yield Section(
        f"{machine}: the enhanced scheme, same run",
        f"{slug}-enhanced",
        other,
        [claim for claim in headline.check(other) if claim.of_motor],
        course,
    )
    without = simulate(control, progress=True)
    yield Section(
        f"{title} with the {headline.control.text}",
        f"{slug}-without",
        without,
        list(headline.judge_control((without,)).claims),
        "Negative control: this run has to fail, and not before the offset estimate is needed.",
        headline.control.expected,
    )
    for scheme in SCHEMES:
        yield _loaded(machine, arithmetic, scheme)


def _at_zero(machine: str, arithmetic: str) -> Scenario:
    """Rated load; from ω = 0.05 to the speed of zero stator frequency, where the winding warms by 10 %."""
    motor = motor_of(machine)
    line = line_speed(motor, 1.0)
    return paper_drive(
        machine,
        arithmetic,
        name="rated load at zero stator frequency",
        omega=[(0.0, 0.05), (_SLOW, 0.05), (_ZERO, line), (_END, line)],
        load=ramp(4.0, 5.0, 1.0),
        duration=_END,
        changes=[
            (_ZERO + 0.6 * k, {"R_s": motor.R_s * (1.0 + 0.001 * k)})
            for k in range(1, 101)
            if 0.6 * k < _END - _ZERO
        ],
    )


def _loaded(machine: str, arithmetic: str, scheme: str) -> Section:
    """What tells the schemes apart: here the published one is measured, not judged."""
    scenario = _at_zero(machine, arithmetic)
    result = until_it_runs_away(enhanced(scenario) if scheme == SCHEMES[1] else scenario, progress=True)
    return Section(
        f"{machine}: rated load at zero stator frequency, scheme {scheme}",
        f"demo-{machine}-loaded-{scheme}",
        result,
        _difference(result, judged=scheme == SCHEMES[1]),
        "The winding warms by 10 % within a minute. Under load at zero stator frequency one direction of "
        "the flux error cannot be seen by any estimator. The published scheme keeps its memory for some "
        "seconds; the enhanced one lowers the flux, so that the field goes on turning, and says how sure it "
        "is.",
    )


def _difference(result: Result, judged: bool) -> list[Claim]:
    when, why = lost(result, since=_SLOW)
    error = abs(angle(result.window(_ZERO)))
    most = float(error.max())
    beyond = result.window(_ZERO).t[error > EXCURSION]
    passed = reported(
        f"time at zero stator frequency until the angle error passes {EXCURSION:g}°",
        float(beyond[0]) - _ZERO if len(beyond) else _END - _ZERO,
        "s",
        "" if len(beyond) else "never, in the whole run",
    )
    if not judged:
        text = f"lost: {why} at {when:.3g} s" if why else "held to the end"
        return [reported("largest field angle error", most, "°", text), passed]
    return [
        holds("never lost", not why, f"lost at {when:.3g} s ({why})" if why else "held"),
        at_most("field angle error", most, EXCURSION, "°"),
        passed,
    ]
