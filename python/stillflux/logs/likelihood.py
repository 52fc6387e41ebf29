"""How unlikely the steady blocks of a log are for a motor.

The voltage tells the flux without an integral, and the rotor equation has no speed in it:

```text
Z = mean(u i*)/mean|i|²,   ψ_s = (Z - R_s) i/(j ω_s),   ψ_R = ψ_s - L_σ i,   |ψ_R|² = λ(|ψ_s|) L_M i·ψ_R
```

with the saturation λ; a direct current has `Z = R_s`. The unlikelihood is the least of

```text
J = Σ (ln(parameter/the motor's)/σ)² + Σ (residual/σ_r)² + (ln(flux/rated)/σ_ψ)²
```

over the parameters, minus twice the logarithm of the likelihood, with a term for a current beyond
what a drive keeps up: without it a larger motor under load is a small one far beyond its pull-out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stillflux.logs.steady import Steady
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Blocks", "ratios"]

# Standard deviations of ln R_s (winding from 20 to 70 °C), L_M, L_σ, of the bridge's loss, relative, and of
# the logarithm of the saturation, relative: an unknown curve lies between none and twice the typical.
_SIGMA = np.array([0.2, 0.1, 0.2, 0.15, 1.0])
_CURVE_KNOWN = 0.3  # part of that of a curve among the parameters
# Of a typical curve: saturated part of the magnetising current at rated flux, and exponent, as in the filter.
_TYPICAL = (0.15, 8.0)
_RESIDUAL = 0.05  # of a block: sensors, delay, what is not quite steady
_POINTS = 4.0  # independent blocks at most: what is left is the same in all of them
_CURRENT = (1.5, 0.1)  # of rated in the median block, and ln of what is beyond
_FLUX = (0.35, 0.1)  # ln of the flux over rated, below and above it: a drive lowers the flux, none doubles it


@dataclass(frozen=True)
class Blocks:
    """Impedances of steady blocks, and the motor that they should be of."""

    z: NDArray[np.complex128]
    loss: NDArray[np.complex128]
    i: NDArray[np.float64]
    turning: NDArray[np.float64]
    motor: Motor
    r_d: float
    psi_n: float
    omega_n: float
    i_n: float

    @classmethod
    def of(
        cls, steady: Steady, factors: tuple[float, float, float], motor: Motor, inverter: Inverter
    ) -> Blocks:
        """Of a log whose voltage, current and dc link are too large by these factors."""
        z, loss, i = steady.impedance(*factors, inverter)
        base = motor.base
        return cls(z, loss, i, steady.turning, motor, inverter.r_d, base["psi"], base["omega"], base["i"])

    def fit(self) -> tuple[float, NDArray[np.float64]]:
        """J, and parameters in units of their deviation: Gauss-Newton with the damping of Levenberg."""
        x = np.zeros(len(_SIGMA))
        rest = self._residual(x)
        cost, damping, step = float(rest @ rest), 1e-2, 1e-4 * np.eye(len(x))
        for _ in range(25):
            slope = np.stack([(self._residual(x + one) - rest) / 1e-4 for one in step], axis=1)
            move = np.linalg.solve(slope.T @ slope + damping * np.eye(len(x)), -slope.T @ rest)
            other = self._residual(x + move)
            less = cost - float(other @ other)
            if less > 0.0:
                x, rest, cost, damping = x + move, other, cost - less, damping / 3.0
            else:
                damping *= 5.0
            if 0.0 < less < 1e-3:
                break
        return cost, x

    def _residual(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        motor, of_R, of_L_M, of_L_sigma = self.motor, *np.exp(_SIGMA[:3] * x[:3])
        R, L_M, L_sigma = motor.R_s * of_R + self.r_d, motor.L_M * of_L_M, motor.L_sigma * of_L_sigma
        z = self.z - (1.0 + _SIGMA[3] * x[3]) * self.loss
        n = len(self.turning)
        i, direct = self.i[:n], np.maximum(z[n:].real, 1e-3 * R)
        psi_s = (z[:n] - R) * i / (1j * self.turning)
        psi_r = psi_s - L_sigma * i
        square = np.abs(psi_r) ** 2
        # Where the current would not magnetise at all, far off is far enough.
        ratio = square / np.maximum(L_M * i * psi_r.real, 1e-2 * square)
        curve = np.log(ratio) - self._saturation(np.abs(psi_s), x[4])
        rest = np.concatenate((curve, np.log(direct / R)))
        rest /= _RESIDUAL * math.sqrt(max(1.0, len(rest) / _POINTS))
        return np.concatenate((x, rest, self._flux(np.abs(psi_s)), self._current(i)))

    def _saturation(self, psi: NDArray[np.float64], x: float) -> NDArray[np.float64]:
        """ln of the magnetising inductance over that of the motor."""
        motor = self.motor
        if motor.saturation is None:
            c, exponent = _TYPICAL
            return np.asarray(
                -np.log1p(c * (np.minimum((psi / self.psi_n) ** exponent, 8.0) - 1.0)) * (1.0 + x)
            )
        L_u, a, S = motor.saturation
        curve = (L_u / (1.0 + (a * psi) ** S) - motor.L_sigma) / motor.L_M
        return np.asarray(np.log(np.maximum(curve, 0.05)) * (1.0 + _CURVE_KNOWN * x))

    def _flux(self, psi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Deviation of the flux from the rated one, from that of full voltage in field weakening."""
        if not len(psi):
            return np.zeros(0)
        full = psi / self.psi_n * np.maximum(1.0, np.abs(self.turning) / self.omega_n)
        size = math.log(max(float(np.median(full)), 1e-3))
        return np.array([size / _FLUX[int(size > 0.0)]])

    def _current(self, i: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far the current is beyond what a drive keeps up."""
        most, sigma = _CURRENT
        size = float(np.median(i)) / self.i_n if len(i) else 0.0
        return np.array([math.log(max(size / most, 1.0)) / sigma])

    def flux(self) -> float | None:
        """Flux of the median block with the motor's resistance, of rated; None at standstill."""
        n = len(self.turning)
        if not n:
            return None
        R = self.motor.R_s + self.r_d
        return (
            float(np.median(np.abs((self.z - self.loss - R) * self.i)[:n] / np.abs(self.turning)))
            / self.psi_n
        )


def ratios(x: NDArray[np.float64]) -> dict[str, float]:
    """Parameters over those of the motor, for what `Blocks.fit` found."""
    return dict(zip(("R_s", "L_M", "L_sigma"), map(float, np.exp(_SIGMA[:3] * x[:3])), strict=True))
