"""What the drive was told is wrong: the real motor, inverter or sensors are not what it knows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from stillflux.evidence.conditions import OFFSET, OFFSET_AT, REACHED
from stillflux.parameters import Motor
from stillflux.scenario import Scenario

__all__ = ["ERRORS", "MISMATCHES", "STEPPED", "Error"]

_RELATIVE = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)


def _motor(change: Callable[[Motor, float], Motor]) -> Callable[[Scenario, float], Scenario]:
    """The real motor changed; what happens to R_s during the run changes in proportion."""

    def apply(scenario: Scenario, x: float) -> Scenario:
        real = change(scenario.motor, x)
        ratio = real.R_s / scenario.motor.R_s
        changes = [
            (t, {k: v * ratio if k == "R_s" else v for k, v in c.items()}) for t, c in scenario.changes
        ]
        return scenario.replace(plant_motor=real, changes=changes)

    return apply


def _l_s(motor: Motor, x: float) -> Motor:
    """Stator inductance, at the same leakage and rotor time constant."""
    L_M = (1 + x) * motor.L_s - motor.L_sigma
    return _saturating(motor, 1 + x).replace(L_M=L_M, R_R=L_M / motor.tau_r)


def _saturating(motor: Motor, ratio: float) -> Motor:
    """The saturation curve scaled, so that it still is that of the stator inductance at small flux."""
    if motor.saturation is None:
        return motor
    L_u, *shape = motor.saturation
    return motor.replace(saturation=(ratio * L_u, *shape))


def _sigma_l_s(motor: Motor, x: float) -> Motor:
    """Leakage inductance, at the same stator inductance and rotor time constant."""
    L_sigma = (1 + x) * motor.L_sigma
    L_M = motor.L_s - L_sigma
    return motor.replace(L_sigma=L_sigma, L_M=L_M, R_R=L_M / motor.tau_r)


def _inverter(name: str) -> Callable[[Scenario, float], Scenario]:
    def apply(scenario: Scenario, x: float) -> Scenario:
        inverter = scenario.inverter
        return scenario.replace(plant_inverter=inverter.replace(**{name: (1 + x) * getattr(inverter, name)}))

    return apply


def _offset(scenario: Scenario, x: float) -> Scenario:
    return scenario.replace(plant={**scenario.plant, "current_offset": x * _complex(scenario)})


def _complex(scenario: Scenario) -> complex:
    offset = scenario.plant["current_offset"]
    assert isinstance(offset, complex)
    return offset


def _gain(scenario: Scenario, x: float) -> Scenario:
    return scenario.replace(plant={**scenario.plant, "current_gain": (1 + x, 1.0, 1.0)})


@dataclass(frozen=True)
class Error:
    """One kind of mismatch."""

    apply: Callable[[Scenario, float], Scenario]
    steps: Sequence[float] = _RELATIVE
    """Sizes tried, ascending, in both directions if `signed`."""
    signed: bool = True
    scale: float = 100.0
    unit: str = "%"


ERRORS: Mapping[str, Error] = {
    "r_s": Error(_motor(lambda motor, x: motor.replace(R_s=(1 + x) * motor.R_s))),
    "σl_s": Error(_motor(_sigma_l_s)),
    "l_s": Error(_motor(_l_s)),
    "τ_r": Error(_motor(lambda motor, x: motor.replace(R_R=motor.R_R / (1 + x)))),
    "u_th": Error(_inverter("u_th"), (0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)),
    "dead time": Error(_inverter("dead_time"), (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3)),
    "current offset": Error(_offset, (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0), False, 25.0, "mV"),
    "gain of one current channel": Error(_gain, (0.002, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1)),
}
"""What may be off. The real value is meant, the drive keeps its own."""


def _l_m(scenario: Scenario, x: float) -> Scenario:
    """Magnetising inductance of the inverse-Γ circuit off by `x`, everything else as it is (also R_R)."""
    motor = scenario.motor
    L_M = (1 + x) * motor.L_M
    real = _saturating(motor, (L_M + motor.L_sigma) / motor.L_s).replace(L_M=L_M)
    return scenario.replace(plant_motor=real)


def _r_s_step(scenario: Scenario, x: float) -> Scenario:
    """r_s changes by `x` once the point is reached."""
    changes = [*scenario.changes, (REACHED, {"R_s": (1 + x) * scenario.motor.R_s})]
    return scenario.replace(changes=sorted(changes, key=lambda change: change[0]))


def _offset_after(scenario: Scenario, x: float) -> Scenario:
    """An offset `x` times that of the plane, only once the drive runs."""
    ampere = x * OFFSET * scenario.motor.base["i"]
    return scenario.replace(
        plant={**scenario.plant, "current_offset": 0j},
        changes=[(OFFSET_AT, {"current_offset": ampere}), *scenario.changes],
    )


def _dead_time(scenario: Scenario, x: float) -> Scenario:
    """The real dead time off by `x` µs."""
    inverter = scenario.inverter
    return scenario.replace(plant_inverter=inverter.replace(dead_time=inverter.dead_time + 1e-6 * x))


def _nothing(scenario: Scenario, x: float) -> Scenario:
    del x
    return scenario


MISMATCHES: Mapping[str, tuple[Callable[[Scenario, float], Scenario], float]] = {
    "nothing": (_nothing, 0.0),
    "r_s +30 %": (ERRORS["r_s"].apply, 0.3),
    "r_s −30 %": (ERRORS["r_s"].apply, -0.3),
    "r_s step +25 %": (_r_s_step, 0.25),
    "τ_r +20 %": (ERRORS["τ_r"].apply, 0.2),
    "τ_r −20 %": (ERRORS["τ_r"].apply, -0.2),
    "L_M +10 %": (_l_m, 0.1),
    "L_M −10 %": (_l_m, -0.1),
    "σl_s +20 %": (ERRORS["σl_s"].apply, 0.2),
    "σl_s −20 %": (ERRORS["σl_s"].apply, -0.2),
    "u_th +50 %": (ERRORS["u_th"].apply, 0.5),
    "u_th −50 %": (ERRORS["u_th"].apply, -0.5),
    "dead time +0.3 µs": (_dead_time, 0.3),
    "dead time −0.3 µs": (_dead_time, -0.3),
    "offset 5 %": (ERRORS["current offset"].apply, 5.0),
    "offset 5 % once running": (_offset_after, 5.0),
    "gain of a channel +2 %": (ERRORS["gain of one current channel"].apply, 0.02),
    "gain of a channel −2 %": (ERRORS["gain of one current channel"].apply, -0.02),
}
"""What is off in the real machine, inverter or sensors; the drive keeps its own values."""
STEPPED = ("offset 5 % once running",)
"""Those in which a sensor changes while the drive runs."""
