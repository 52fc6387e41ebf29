"""Ten minutes at zero stator frequency without load."""

from __future__ import annotations

from stillflux.evidence.claims import Claim, at_most
from stillflux.evidence.conditions import OFFSET, drive
from stillflux.evidence.judge import Measured
from stillflux.evidence.machines import motor_of, step
from stillflux.evidence.paper import HOLD, identify_then
from stillflux.evidence.target import Case, Target
from stillflux.result import Result
from stillflux.scenario import Scenario

_STEP_LASTS = 6.0
"""The rated step at the end is held that long, s."""


def scenario(machine: str, scheme: str, arithmetic: str = "f32", *, time: float = 600.0) -> Scenario:
    """No load at ω_s = 0 for `time` s after 12 s at 1 Hz, as in Fig. 18, then a rated torque step.

    Meanwhile the offset of the current sensors drifts by 0.1 % of rated peak current a minute (along i_α and
    i_β alike) and r_s rises by 10 %, in steps every 2 s.
    """
    motor = motor_of(machine)
    end, steps = HOLD + time, max(1, round(time / 2.0))
    warming = [
        (HOLD + time * k / steps, {"R_s": motor.R_s * (1.0 + 0.1 * k / steps)}) for k in range(1, steps + 1)
    ]
    return drive(
        machine,
        scheme,
        arithmetic,
        name=f"no load at ω_s = 0 for {time:g} s",
        omega=identify_then(0.0),
        load=step(end, 1.0),
        changes=warming,
        plant={"current_offset_drift": 0.1 * OFFSET * motor.base["i"] / 60.0},
        duration=end + _STEP_LASTS,
    )


def _cases(machine: str, scheme: str, arithmetic: str) -> list[Case]:
    run = scenario(machine, scheme, arithmetic).replace(record_every=200)
    end = run.duration
    return [
        Case(
            "persistence-no-load",
            machine,
            scheme,
            "600 s, then a rated step",
            run,
            (HOLD, end),
            (end - 2.0, end),
            traced=True,
        )
    ]


def _claims(case: Case, result: Result, m: Measured) -> list[Claim]:
    del case, result
    return [at_most("speed error under the rated step", m.speed_settled, 0.003, "pu")]


TARGETS = (
    Target(
        "persistence-no-load",
        20,
        "Ten minutes at zero stator frequency, offset and resistance drifting",
        _cases,
        _claims,
        "confidence",
        "courses",
        ("angle_held", "angle_settled", "angle_passed", "r_s"),
    ),
)
