"""A machine fed open loop from a bridge, nothing is compensated: u* turns on a circle (Figs. 2 and 6), or
stands still."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stillflux._core import Plant
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["DirectCurrent", "Line", "OpenLoop", "VoltageFed", "Waveforms"]


class OpenLoop:
    """A run in which neither a drive nor noise takes part."""

    def run(self) -> Any:
        """What happened."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class VoltageFed(OpenLoop):
    """Rated flux at an imposed speed, begun in the steady state that sinusoidal voltage would give."""

    motor: Motor
    """The machine; its saturation is left out."""
    inverter: Inverter
    """The bridge."""
    omega_s: float
    """Stator frequency, per unit."""
    omega_r: float
    """Slip frequency, per unit; positive: motoring."""
    periods: int = 2
    """Fundamental periods to record, after one that is not."""

    def replace(self, **changes: Any) -> Self:
        """A copy with changed fields."""
        return replace(self, **changes)

    def run(self) -> Waveforms:
        """Steps the plant period by period."""
        motor, inverter = self.motor.replace(saturation=None), self.inverter
        base = motor.base
        omega, omega_r = self.omega_s * base["omega"], self.omega_r * base["omega"]
        g = motor.R_R / (1j * omega_r + 1.0 / motor.tau_r)  # ψ_R = g i_s
        i = complex(base["psi"] / (g + motor.L_sigma))
        psi_s = complex((g + motor.L_sigma) * i)
        threshold = inverter.u_th + inverter.dead_time * inverter.f_s * inverter.u_dc
        u = (motor.R_s + inverter.r_d) * i + 1j * omega * psi_s + 4 / np.pi * threshold * i / abs(i)
        speed = (omega - omega_r) / motor.n_p
        plant = Plant(motor, inverter, speed=speed)
        plant.set_state(psi_s, complex(g * i), speed)
        T_s = 1.0 / inverter.f_s
        period = 2 * np.pi / omega * inverter.f_s
        n, first = int((self.periods + 1) * period), int(period)
        u_ref = u * np.exp(1j * omega * T_s * (np.arange(n) + 0.5))
        axes = np.exp(-2j * np.pi / 3 * np.arange(3))
        duty = 0.5 + (u_ref[:, None] * axes).real / inverter.u_dc
        u_s, i_s = np.empty(n, np.complex128), np.empty(n, np.complex128)
        for k in range(n):
            plant.step(duty[k])
            state = plant.state
            u_s[k], i_s[k] = state.u_s, state.i_s
        # Duties act a period after they are given; the mean current of a period lies between two samples.
        return Waveforms(
            run=self,
            threshold=threshold,
            t=np.arange(n - first, dtype=np.float64) * T_s,
            angle=(np.arange(first, n, dtype=np.float64) - 0.5) * (omega * T_s),
            u_ref=u_ref[first - 1 : -1],
            u_av=u_s[first:],
            i_mean=np.asarray(0.5 * (i_s[first:] + i_s[first - 1 : -1]), np.complex128),
            i_s=i_s[first:],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Waveforms:
    """What happened, one value per switching period. Space vectors in stator coordinates, SI."""

    run: VoltageFed
    """What was run."""
    threshold: float
    """Voltage a leg loses in the direction of its current: u_th and the dead time's mean, V."""
    t: NDArray[np.float64]
    """Time, s."""
    angle: NDArray[np.float64]
    """`ω_s t` at the middle of each period."""
    u_ref: NDArray[np.complex128]
    """Reference u*."""
    u_av: NDArray[np.complex128]
    """Mean terminal voltage of the switching period."""
    i_mean: NDArray[np.complex128]
    """Mean current of the switching period."""
    i_s: NDArray[np.complex128]
    """Current at its end."""

    @property
    def distortion(self) -> NDArray[np.complex128]:
        """What thresholds and dead time take: `u* - u_av - r_d i`."""
        taken: NDArray[np.complex128] = self.u_ref - self.u_av - self.run.inverter.r_d * self.i_mean
        return taken

    def harmonic(self, signal: NDArray[np.complex128], order: int) -> complex:
        """Space-vector harmonic of a signal; negative orders turn backwards."""
        return complex(np.mean(signal * np.exp(-1j * order * self.angle)))


@dataclass(frozen=True, kw_only=True)
class DirectCurrent(OpenLoop):
    """Direct current along the a-axis at rest, level after level."""

    motor: Motor
    """The machine."""
    inverter: Inverter
    """The bridge."""
    parts: tuple[float, ...]
    """Levels that the reference voltage aims at, per unit of rated peak current."""
    dead_time: float
    """Dead time whose mean voltage is taken off, s."""

    def replace(self, **changes: Any) -> Self:
        """A copy with changed fields."""
        return replace(self, **changes)

    def run(self) -> Line:
        """Applies each level for ten time constants of the winding and reads the mean of the last tenth."""
        motor, inverter = self.motor, self.inverter
        resistance = motor.R_s + inverter.r_d
        n = int(10.0 * max(motor.L_s / resistance, motor.tau_r) * inverter.f_s)
        plant = Plant(motor, inverter, speed=0.0)
        drop = 4.0 / 3.0 * (inverter.u_th + inverter.dead_time * inverter.f_s * inverter.u_dc)
        levels, currents = [], []
        for part in self.parts:
            u = resistance * part * motor.base["i"] + drop
            duty = 0.5 + u * np.array([1.0, -0.5, -0.5]) / inverter.u_dc
            read = []
            for k in range(n):
                plant.step(duty)
                if k >= n - n // 10:
                    read.append(plant.state.i_s.real)
            levels.append(u)
            currents.append(float(np.mean(read)))
        return Line(run=self, u=np.array(levels), i=np.array(currents))


@dataclass(frozen=True, eq=False, kw_only=True)
class Line:
    """Reference voltage over direct current, SI, and the straight line through the points."""

    run: DirectCurrent
    """What was run."""
    u: NDArray[np.float64]
    """Reference along the a-axis, V."""
    i: NDArray[np.float64]
    """Current, A."""

    @property
    def slope(self) -> float:
        """Resistance, Ω."""
        return float(np.polyfit(self.i, self.u, 1)[0])

    @property
    def intercept(self) -> float:
        """What is lost whatever the current, V."""
        return float(np.polyfit(self.i, self.u, 1)[1])

    @property
    def threshold(self) -> float:
        """Of one leg, the dead time taken off, V."""
        known = self.run.dead_time * self.run.inverter.f_s * self.run.inverter.u_dc
        return 0.75 * self.intercept - known
