"""What one run learned serves the next: a second start, into rated load at rest."""

from __future__ import annotations

from dataclasses import replace

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import AT_SPEED, START, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import ramp
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Profile, Scenario

_LEARNED = 16.0


def scenarios(machine: str, scheme: str, arithmetic: str = "f32") -> tuple[Scenario, Scenario]:
    """A run that turns and is loaded, then a start into rated load at rest: the second takes the memory.

    The offset of the sensors is not read at rest, the real machine is warm (r_s + 20 %) and the real
    thresholds are half as large again as the drive was told: all of it has to be learned.
    """

    def made(name: str, omega: Profile, load: Profile, duration: float) -> Scenario:
        built = drive(
            machine, scheme, arithmetic, name=name, omega=omega, load=load, duration=duration
        ).with_settings(calibrate_offset=False)
        return built.replace(
            plant_motor=built.motor.replace(R_s=1.2 * built.motor.R_s),
            plant_inverter=built.inverter.replace(u_th=1.5 * built.inverter.u_th),
        )

    load = [(0.0, 0.0), (4.0, 0.0), (5.0, 0.8), (9.0, 0.8), (11.0, -0.8), (_LEARNED, -0.8)]
    return (
        made("run that learns", ramp(START, AT_SPEED, 0.03), load, _LEARNED),
        made("second start", 0.0, ramp(START, START + 0.5, 1.0), START + 5.5),
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    first, second = scenarios(machine, scheme, arithmetic)
    window = (START, second.duration)
    without = Case("memory", machine, scheme, "nothing restored", second, window, window, traced=True)
    return [without, replace(without, label="memory of the first run restored", before=first)]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del result
    which = "restored" if case.before is not None else "nothing restored"
    return [at_most(f"{which}: field angle error from the start on", m.angle_held, 5.0, "°")]


TARGETS = (
    Target(
        "memory",
        60,
        "Second start, into rated load at rest, with what the first run learned",
        _cases,
        _claims,
        view="courses",
        numbers=("angle_held", "r_s"),
    ),
)
