"""Motor and inverter parameters."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from stillflux import _core
from stillflux.messages import MachineWarning, outside

if TYPE_CHECKING:
    from typing_extensions import Self, Unpack

__all__ = ["PRESETS", "Inverter", "Motor", "Rating", "instance", "number", "truth"]

PRESETS = ("2.2kW", "11kW")
"""Names of the motors and inverters that `preset` knows."""


_MOST_TORQUE = 1.05
"""Largest rated torque, of √3 U_N I_N n_p/(2π f_N): what crosses the air gap is at most the power factor of
it; the rest is for values that are rounded."""
_SPIN_UP = 100.0
"""Time to rated speed with rated torque, s, above which a motor's inertia is doubted: 0.02 to 3 s are usual,
and of one in kg·cm² it is 10⁴ times as long."""


def number(name: str, value: Any) -> float:
    """A real number as a float; whatever stands for none is a TypeError that names it."""
    if isinstance(value, bool | str | bytes | bytearray | complex | np.bool_ | np.complexfloating):
        raise TypeError(f"{name} = {value!r} is not a number")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{name} is a whole number beyond the range of a float, 1.8e308") from None
    except (TypeError, ValueError):
        raise TypeError(f"{name} = {value!r} is not a number") from None


def truth(name: str, value: Any) -> bool:
    """True or False, also numpy's; whatever else is a TypeError that names it."""
    if not isinstance(value, bool | np.bool_):
        raise TypeError(f"{name} = {value!r} is neither True nor False")
    return bool(value)


def instance(name: str, value: Any, kind: type) -> None:
    """Raises TypeError naming an argument that is none of a kind, and a preset's name for what it is."""
    if not isinstance(value, kind):
        title = kind.__name__
        hint = f": give {title}.preset({value!r})" if isinstance(value, str) and value in PRESETS else ""
        raise TypeError(f"{name} = {value!r} is not a stillflux.{title}{hint}")


LegDelay = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


def leg_delay(value: Any) -> LegDelay:
    """Three pairs of plain numbers."""
    try:
        a, b, c = ((number("leg_delay", plus), number("leg_delay", minus)) for plus, minus in value)
    except (TypeError, ValueError) as e:
        raise ValueError(f"leg_delay = {value!r} is not a pair of numbers for each of three legs") from e
    return a, b, c


def _plain_numbers(of: Motor | Inverter) -> None:
    """Python's numbers in place of numpy's: equal objects have equal text and can be written as JSON."""
    for one in fields(of):
        if one.name == "saturation":
            continue
        if one.name == "leg_delay":
            object.__setattr__(of, one.name, leg_delay(getattr(of, one.name)))
            continue
        value = number(one.name, getattr(of, one.name))
        whole = one.name in ("n_p", "half_periods") and value.is_integer()
        object.__setattr__(of, one.name, int(value) if whole else value)


class Rating(TypedDict):
    """What the nameplate says, and the inertia."""

    n_p: int
    J: float
    U_N: float
    I_N: float
    f_N: float
    T_N: float


def _least_torque(power: float) -> float:
    """Least rated torque, of √3 U_N I_N n_p/(2π f_N): efficiency times power factor by the apparent power in
    VA. They are 0.54 at 0.8 kVA to 0.85 at 190 kVA, and 0.61 of a motor of many poles at 9 kVA. The bound
    lies a quarter below them or more, and above most of what a wrong number of pole pairs makes of them."""
    return min(0.45, 0.08 * math.pow(power, 0.2))


@dataclass(frozen=True, kw_only=True)
class Motor:
    """Induction motor: inverse-Γ parameters and rating.

    Raises ValueError naming field, value and admissible range. Values that cannot be those of one machine
    together, as a rated torque in another unit, are a `MachineWarning`.
    """

    R_s: float
    """Stator resistance, Ω."""
    R_R: float
    """Rotor resistance of the inverse-Γ circuit, Ω."""
    L_sigma: float
    """Leakage inductance σL_s, H."""
    L_M: float
    """Magnetising inductance of the inverse-Γ circuit, H."""
    n_p: int
    """Pole pairs."""
    J: float
    """Moment of inertia of the whole shaft, kg·m²."""
    U_N: float
    """Rated line-to-line voltage, V rms."""
    I_N: float
    """Rated phase current, A rms."""
    f_N: float
    """Rated frequency, Hz."""
    T_N: float
    """Rated torque, N·m."""
    saturation: tuple[float, float, float] | None = None
    """Magnetising curve: (L_u, a, S) of the Γ form, L_s(ψ) = L_u/(1 + (a ψ)^S), in H, 1/(V·s), 1. The plant
    simulates it; the enhanced scheme starts its model of the curve from it. None: a plant without saturation,
    and a typical curve for the scheme."""

    def __post_init__(self) -> None:
        if self.saturation is not None:
            try:
                # An array without dimensions says that it can be gone through, and cannot.
                given = None if isinstance(self.saturation, str | bytes | Mapping) else [*self.saturation]
            except TypeError:
                given = None
            if given is None:
                raise TypeError(f"saturation = {self.saturation!r} is not (L_u, a, S), nor None")
            curve = tuple(number("saturation", x) for x in given)
            if len(curve) != 3:
                raise ValueError(f"saturation has {len(curve)} values, three are needed: L_u, a, S")
            object.__setattr__(self, "saturation", curve)
        _plain_numbers(self)
        _core.validate_motor(self)
        if doubts := list(self._doubts()):
            warnings.warn("; ".join(doubts), MachineWarning, stacklevel=outside())

    def _doubts(self) -> Iterator[str]:
        """Values that do not fit the rating, in words."""
        power = math.sqrt(3.0) * self.U_N * self.I_N
        torque = power * self.n_p / (2.0 * math.pi * self.f_N)
        least, most = _least_torque(power) * torque, _MOST_TORQUE * torque
        if not least <= self.T_N <= most:
            yield (
                f"T_N = {self.T_N:.4g} N·m does not fit U_N, I_N, f_N and n_p, by which it is {least:.3g} to "
                f"{most:.3g} N·m: are all in V, A, Hz, N·m, and n_p pairs of poles?"
            )
        impedance = self.U_N / (math.sqrt(3.0) * self.I_N)
        for name in ("R_s", "R_R"):
            if (value := getattr(self, name)) > impedance:
                yield (
                    f"{name} = {value:.4g} Ω takes more than the rated voltage at rated current: "
                    f"up to {impedance:.3g} Ω fit U_N and I_N"
                )
        spin_up = self.J * 2.0 * math.pi * self.f_N / (self.n_p * self.T_N)
        if spin_up > _SPIN_UP:
            yield (
                f"with J = {self.J:.4g} kg·m² rated torque takes {spin_up:.3g} s to rated speed: "
                f"is it in kg·m²?"
            )

    @classmethod
    def preset(cls, name: str) -> Self:
        """The "2.2kW" or the "11kW" motor."""
        return cls(**_core.motor_preset(name))

    @classmethod
    def inverse_gamma(
        cls,
        *,
        R_s: float,
        R_R: float,
        L_sigma: float,
        L_M: float,
        saturation: tuple[float, float, float] | None = None,
        **rating: Unpack[Rating],
    ) -> Self:
        """From inverse-Γ parameters in Ω and H: `psi_s = L_M (i_s + i_R) + L_sigma i_s`."""
        return cls(R_s=R_s, R_R=R_R, L_sigma=L_sigma, L_M=L_M, saturation=saturation, **rating)

    @classmethod
    def gamma(
        cls,
        *,
        R_s: float,
        R_r: float,
        L_l: float,
        L_s: float,
        saturation: tuple[float, float, float] | None = None,
        **rating: Unpack[Rating],
    ) -> Self:
        """From Γ parameters in Ω and H: all leakage `L_l` on the rotor side."""
        return cls(**_core.from_gamma(R_s, R_r, L_l, L_s), saturation=saturation, **rating)

    @classmethod
    def t_model(
        cls,
        *,
        R_s: float,
        R_r: float,
        L_ls: float,
        L_lr: float,
        L_m: float,
        saturation: tuple[float, float, float] | None = None,
        **rating: Unpack[Rating],
    ) -> Self:
        """From T parameters in Ω and H."""
        return cls(**_core.from_t_model(R_s, R_r, L_ls, L_lr, L_m), saturation=saturation, **rating)

    def replace(self, **changes: Any) -> Self:
        """A copy with changed fields; TypeError for an unknown one."""
        return replace(self, **changes)

    @property
    def tau_r(self) -> float:
        """Rotor time constant L_M/R_R, s."""
        return self.L_M / self.R_R

    @property
    def L_s(self) -> float:
        """Stator inductance, H."""
        return self.L_M + self.L_sigma

    @property
    def sigma(self) -> float:
        """Total leakage factor."""
        return self.L_sigma / self.L_s

    @property
    def base(self) -> dict[str, float]:
        """Base values of the per-unit system: u (V), i (A), omega (rad/s), psi, z, l, torque, omega_m."""
        return _core.base(self)

    def at_slip_frequency(self, deep_bar: tuple[float, float] | None) -> Self:
        """What a drive should be told of this motor if the plant has the option `deep_bar`: the motor without
        a second rotor branch that has the same rotor currents at small slip, with `(1 - g)²/(1 - s) + g²/s`
        times the leakage of the Γ circuit for the shares `g` of the conductance and `s` of the inverse
        leakage, and the same `R_r` and `L_s`. None: the motor itself. ValueError for a share outside 0.01 to
        0.9."""
        return self.replace(**_core.at_slip_frequency(self, deep_bar))

    def to_gamma(self) -> dict[str, float]:
        """Γ parameters R_s, R_r, L_l, L_s."""
        return _core.to_gamma(self)

    def to_t_model(self) -> dict[str, float]:
        """T parameters R_s, R_r, L_ls, L_lr, L_m, with equal leakages: the terminals cannot tell."""
        return _core.to_t_model(self)


@dataclass(frozen=True, kw_only=True)
class Inverter:
    """Two-level inverter.

    The defaults are the inverter of the 2.2-kW motor. A motor file, which may be of any motor, takes for what
    it does not say what suits it (`machine_file.typical_inverter`): `r_d` is a twentieth of its R_s there.

    Raises ValueError naming field, value and admissible range.
    """

    u_dc: float = 540.0
    """Rated dc-link voltage, V."""
    f_s: float = 10e3
    """Switching frequency, Hz; also that of the control with `half_periods` = 2."""
    u_th: float = 1.0
    """Threshold voltage of switches and diodes, V."""
    r_d: float = 0.2
    """Differential resistance of switches and diodes, Ω."""
    dead_time: float = 2e-6
    """Dead time, s."""
    f_clk: float = 170e6
    """Clock of the PWM timer, Hz; 0: duties are not quantised."""
    c_out: float = 1e-9
    """Total capacitance of one leg's node against the dc link (switches, motor cable, machine), F, from 0 to
    10 nF. During the dead time the phase current has to charge it; 0: the node follows at once."""
    half_periods: int = 2
    """Half periods of the carrier in a control period: 2, the duties are updated once per carrier period; 1,
    at both of its extremes, with samples at both; 4, 6 … 16: in every second, third … eighth carrier
    period."""
    leg_delay: LegDelay = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    """Time by which the pulse of each leg is longer than commanded, for a positive and for a negative current
    of the leg, s, within ±1 µs and a two-hundredth of the period: delays of its switches and drivers. Only
    differences between the legs act. A drive compensates them; the enhanced scheme measures them at each
    start."""

    def __post_init__(self) -> None:
        _plain_numbers(self)
        _core.validate_inverter(self)

    @property
    def f_c(self) -> float:
        """Control frequency, Hz: samples and updates of the duties per second."""
        return 2.0 * self.f_s / self.half_periods

    @classmethod
    def preset(cls, name: str) -> Self:
        """The inverter of the "2.2kW" or the "11kW" motor."""
        return cls(**_core.inverter_preset(name))

    def replace(self, **changes: Any) -> Self:
        """A copy with changed fields; TypeError for an unknown one."""
        return replace(self, **changes)
