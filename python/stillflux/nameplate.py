"""`Nameplate`: a motor from what its plate says."""

from __future__ import annotations

import math
import warnings
from dataclasses import MISSING, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from stillflux import _core
from stillflux.messages import MachineWarning, outside
from stillflux.parameters import Motor, instance, number

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Nameplate"]

_MOST_PAIRS = 6


def _least_efficiency(P_N: float) -> float:
    """Efficiency below which a plate is doubted. The losses of class IE1 are some 0.35 (P_N/kW)^-0.36 of the
    power at the shaft; twice as much and a fifth of the power are allowed."""
    return 1.0 / (1.2 + 0.7 * math.pow(1e-3 * P_N, -0.36))


@dataclass(frozen=True, kw_only=True)
class Nameplate:
    """Nameplate of a three-phase cage induction motor.

    Raises ValueError naming field, value and admissible range, also where no motor can have these values
    together. More than six pole pairs, as a speed in rad/s has them, and an efficiency of half a motor's, as
    the current of one connection makes with the voltage of another, are a `MachineWarning`.
    """

    P_N: float
    """Rated power at the shaft, W."""
    U_N: float
    """Rated line-to-line voltage, V rms."""
    I_N: float
    """Rated phase current, A rms."""
    f_N: float
    """Rated frequency, Hz."""
    n_N: float
    """Rated speed, r/min."""
    cos_phi: float
    """Rated power factor."""
    T_max: float | None = None
    """Pull-out torque, N·m, where the catalogue gives it: then L_sigma is that of this torque."""
    J: float | None = None
    """Inertia of the whole shaft, kg·m², where it is known."""

    def __post_init__(self) -> None:
        # Python's numbers in place of numpy's, as of a motor.
        for one in fields(self):
            value = getattr(self, one.name)
            if value is not None or one.default is MISSING:
                object.__setattr__(self, one.name, number(one.name, value))
        _core.nameplate_motor(self)
        if text := self.doubt:
            warnings.warn(text, MachineWarning, stacklevel=outside())

    @property
    def n_p(self) -> int:
        """Pole pairs: those of the synchronous speed next above n_N."""
        return int(_core.nameplate_motor(self)[0]["n_p"])

    @property
    def doubt(self) -> str | None:
        """What can hardly be meant, in words, else None."""
        pairs = self.n_p
        if pairs > _MOST_PAIRS:
            return (
                f"n_N = {self.n_N:g} r/min at f_N = {self.f_N:g} Hz are those of {pairs} pole pairs, motors "
                f"have 1 to {_MOST_PAIRS}: is n_N in r/min, not rad/s, and f_N in Hz?"
            )
        efficiency = self.P_N / (math.sqrt(3.0) * self.U_N * self.I_N * self.cos_phi)
        least = _least_efficiency(self.P_N)
        if efficiency < least:
            return (
                f"P_N, U_N, I_N and cos_phi are those of an efficiency of {efficiency:.2g}, motors of this "
                f"power have {least:.2g} or more: are U_N and I_N of the same connection, star or delta, and "
                f"P_N in W?"
            )
        return None

    @classmethod
    def of(cls, motor: Motor) -> Self:
        """The plate that a motor would have: its rated point at rated torque, without iron and friction loss,
        rounded as printed (three digits, whole r/min, two decimals of cos_phi)."""
        instance("motor", motor, Motor)
        exact = _core.nameplate_of(motor)
        printed = {name: float(f"{exact[name]:.3g}") for name in ("P_N", "I_N")}
        speed, cos_phi = round(exact["n_N"]), round(exact["cos_phi"], 2)
        with warnings.catch_warnings():
            # The pole pairs are those of the motor.
            warnings.simplefilter("ignore", MachineWarning)
            return cls(**{**exact, **printed, "n_N": float(speed), "cos_phi": cos_phi})

    def motor(self) -> Motor:
        """The motor of the rated point, without a saturation curve.

        L_sigma is assumed (0.17 per unit) unless `T_max` is given, R_s follows from the power balance and the
        size, R_R and L_M then from the rated slip and current. `deviation` says how well each is known.
        """
        return Motor(**_core.nameplate_motor(self)[0])

    @property
    def deviation(self) -> dict[str, float]:
        """Relative standard deviation of R_s, R_R, L_sigma, L_M and J of `motor()`."""
        return _core.nameplate_motor(self)[1]

    def replace(self, **changes: Any) -> Self:
        """A copy with changed fields; TypeError for an unknown one."""
        return replace(self, **changes)
