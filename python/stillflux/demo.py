"""The headline run: a minute at zero stator frequency, and the same without the offset estimator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stillflux import report
from stillflux.claims import Claim
from stillflux.experiments import EXPERIMENTS
from stillflux.report import Section
from stillflux.simulation import simulate

__all__ = ["run"]


def run(machines: Sequence[str], out: Path, command: str, arithmetic: str = "f32") -> bool:
    """Runs the demo on each machine, prints tables, writes `out/demo.html`; True if every claim holds."""
    sections = [section for machine in machines for section in _sections(machine, arithmetic)]
    for section in sections:
        print(f"\n{section.title}\n{report.table(section.claims)}")
    path = out / "demo.html"
    report.write(path, "Zero stator frequency without a speed sensor", command, sections)
    print(f"\nreport: {path}")
    return all(claim.ok for section in sections for claim in section.claims)


def _sections(machine: str, arithmetic: str) -> list[Section]:
    headline = EXPERIMENTS["headline"]
    scenario = headline.build(machine, arithmetic)
    (control,) = headline.control((scenario,))
    control = control.replace(name=f"{scenario.name}, {headline.control_text}")
    result, without = simulate(scenario, progress=True), simulate(control, progress=True)
    failed = [claim for claim in headline.check(without) if claim.of_motor and not claim.ok]
    verdict = Claim(
        "fails without the offset estimator",
        "; ".join(f"{claim.text}: {claim.measured}" for claim in failed[:2]) or "all claims held",
        bool(failed),
    )
    return [
        Section(
            f"{machine}: the drive",
            f"demo-{machine}",
            result,
            headline.check(result),
            "Start with current offset, offset voltage identified at 1 Hz, more than a minute at zero stator "
            "frequency, rated torque step held, load removed.",
        ),
        Section(
            f"{machine}: the same run with the offset estimator off",
            f"demo-{machine}-without",
            without,
            [verdict],
            "Negative control: this run has to fail.",
        ),
    ]
