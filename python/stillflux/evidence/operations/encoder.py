"""An encoder in control of the speed that fails under load, and is whole again."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from stillflux.evidence.claims import Claim, at_least, at_most, holds
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.operation import Control, Operation, asked, magnetised
from stillflux.metrics import faulted
from stillflux.options import DriveSettings
from stillflux.result import Result
from stillflux.scenario import Scenario
from stillflux.status import EncoderCode

_OMEGA = 0.3
"""Speed, per unit, at which the encoder fails, under rated load."""
_LINES = 1024
_BROKEN = 0.6
"""Time until it is whole again, and that is looked at afterwards, s."""
_SIGNALS = (
    "omega_m",
    "reference",
    "torque",
    "encoder.omega_m",
    "encoder.state",
    "estimate.omega_m",
    "status",
)
_SHOWN = ("omega_m", "encoder.omega_m", "encoder.state", "torque")

_FAULTS = {
    "break": ("An encoder whose wire breaks", "broken"),
    "channel": ("An encoder that loses one of its channels", "channel"),
    "swapped": ("An encoder whose channels are swapped while it runs", "swapped"),
}


def _fails(fault: str, machine: str, scheme: str, arithmetic: str) -> Scenario:
    """At 0.3 pu under rated load, with speed control by the encoder."""
    motor = DRIVES[machine].motor
    begin, omega = magnetised(machine), _OMEGA * motor.base["omega_m"]
    end = begin + max(0.4, 2.0 * _OMEGA * motor.J * motor.base["omega_m"] / motor.T_N)
    event = end + 2.0 * motor.tau_r + 0.6
    changes: list[tuple[float, dict[str, Any]]] = [
        (event, {"encoder": fault}),
        (event + _BROKEN, {"encoder": None}),
    ]
    settings: DriveSettings = {"encoder_lines": _LINES, "encoder_mode": "control"}
    return asked(
        f"encoder {fault}",
        machine,
        scheme,
        arithmetic,
        plant={"encoder_lines": _LINES},
        settings=settings,
        omega_ref=[(0.0, 0.0), (begin, 0.0), (end, omega)],
        load_torque=[(0.0, 0.0), (end, 0.0), (end + 0.1, motor.T_N)],
        changes=changes,
        duration=event + 2.0 * _BROKEN,
        record_every=2,
        signals=_SIGNALS,
    )


def _times(result: Result) -> tuple[float, float]:
    """When the encoder fails and when it is whole again, s."""
    (fails, _), (whole, _) = result.scenario.changes
    return float(fails), float(whole)


def _bump(result: Result, begin: float, end: float) -> float:
    """Largest deviation of the true speed from that before the encoder fails, per unit."""
    fails, _ = _times(result)
    before = float(np.mean(result.window(fails - 0.1, fails)["omega_m"]))
    late = result.window(begin, end)["omega_m"]
    return float(np.abs(late - before).max()) / result.scenario.motor.base["omega_m"]


def _until(result: Result, begin: float, state: EncoderCode) -> float:
    """Time from `begin` to a state, s; inf: it does not come."""
    seen = np.flatnonzero((result.t >= begin) & (result["encoder.state"] == state))
    return float(result.t[seen[0]]) - begin if len(seen) else float("inf")


def _check(result: Result) -> list[Claim]:
    fails, whole = _times(result)
    return [
        holds("no fault", not faulted(result).any()),
        at_most("time until it is distrusted, ms", 1e3 * _until(result, fails, EncoderCode.APART), 40.0),
        at_most("speed moves at the hand-over", _bump(result, fails, whole), 0.01, "pu"),
        at_most("time until it is trusted again, ms", 1e3 * _until(result, whole, EncoderCode.AGREES), 400.0),
        at_most("speed moves at the way back", _bump(result, whole, float(result.t[-1])), 0.01, "pu"),
    ]


def _trusting(scenario: Scenario) -> Scenario:
    """Any difference is agreement."""
    return scenario.with_settings(encoder_deviation=9.0 * scenario.motor.base["omega_m"])


def _runs_away(result: Result) -> list[Claim]:
    fails, whole = _times(result)
    return [
        at_most("speed moves before it", _bump(result, fails - 0.1, fails), 0.01, "pu"),
        at_least("speed moves after it", _bump(result, fails, whole), 0.1, "pu"),
    ]


OPERATIONS = tuple(
    Operation(
        f"encoder-{name}",
        90 + k,
        f"{what}, in control of the speed at 0.3 pu under rated load",
        partial(_fails, fault),
        _check,
        Control("the comparison with the estimate", _trusting, _runs_away),
        shown=_SHOWN,
        schemes=("enhanced", "paper") if name == "break" else ("enhanced",),
    )
    for k, (name, (what, fault)) in enumerate(_FAULTS.items())
)
