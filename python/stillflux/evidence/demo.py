"""The headline run: a minute at zero stator frequency, and the same without the offset estimator."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stillflux.evidence.claims import holds
from stillflux.evidence.registry import experiments
from stillflux.evidence.report import page
from stillflux.evidence.report.page import Section
from stillflux.simulation import simulate

__all__ = ["run"]


def run(machines: Sequence[str], out: Path, command: str, arithmetic: str = "f32") -> bool:
    """Runs the demo on each machine, prints tables, writes `out/demo.html`; True if every claim holds."""
    sections = [section for machine in machines for section in _sections(machine, arithmetic)]
    for section in sections:
        print(f"\n{section.title}\n{page.table(section.claims)}")
    path = out / "demo.html"
    page.write(path, "Zero stator frequency without a speed sensor", command, sections)
    print(f"\nreport: {path}")
    return all(claim.ok for section in sections for claim in section.claims)


def _sections(machine: str, arithmetic: str) -> list[Section]:
    headline = experiments()["headline"]
    assert headline.control is not None
    (scenario,) = headline.runs(machine, arithmetic)
    (control,) = headline.runs(machine, arithmetic, control=True)
    control = control.replace(name=f"{scenario.name}, {headline.control.text}")
    result, without = simulate(scenario, progress=True), simulate(control, progress=True)
    judged = headline.judge_control((without,))
    failed = [claim for claim in judged.expected if not claim.ok]
    verdict = holds(
        f"fails with the {headline.control.text}, not before {judged.event:g} s",
        judged.ok,
        "; ".join(f"{claim.text}: {claim.measured}" for claim in failed) or "all claims held",
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
            f"{machine}: the same run with the {headline.control.text}",
            f"demo-{machine}-without",
            without,
            [verdict],
            "Negative control: this run has to fail.",
        ),
    ]
