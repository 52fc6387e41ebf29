"""State in which the estimators begin with a log: at rest, or in operation.

```text
at rest:       dψ_R/dt = R_R i - ψ_R/τ_r              current of constant direction, from zero flux
in operation:  τ_r/2 d|ψ_R|²/dt + |ψ_R|² - λ L_M i·ψ_R = 0                        fit of ψ_R0 over a window
```
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.logs.signals import TURN, Rows, space
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Fit", "Start", "bridge_loss", "fit_flux", "starts"]

_REST = 0.02  # s without a change of the current: the bridge is blocked
_FIRST = 0.02  # s over which the speed at the first row is taken


def bridge_loss(
    i: NDArray[np.complex128], u_dc: NDArray[np.float64], inverter: Inverter
) -> NDArray[np.complex128]:
    """Loss of the bridge with capacitive edges (stillflux::inverter), for the start of the estimators
    alone."""
    full = u_dc * inverter.dead_time * inverter.f_s
    knee = inverter.c_out * u_dc / inverter.dead_time if inverter.dead_time > 0.0 else np.zeros_like(u_dc)
    phases = []
    for axis in (1.0, TURN, np.conj(TURN)):
        x = (i * np.conj(axis)).real
        size = np.maximum(np.abs(x), 1e-9)
        knee_part = np.where(size >= knee, 1.0 - knee / (2 * size), size / np.maximum(2 * knee, 1e-9))
        phases.append(np.sign(x) * (inverter.u_th + full * knee_part))
    return space(*phases)


@dataclass(frozen=True)
class Fit:
    """Rotor flux at the first row of a window, V·s."""

    psi_r: complex
    residual: float
    """rms of the rotor equation along the flux, over a block, per unit of squared rated flux."""
    deviation: float
    """Of each component of `psi_r`, V·s, if the residual is systematic."""
    path: NDArray[np.complex128]
    """Rotor flux over the window."""


def fit_flux(u: Any, i: Any, step: float, R: float, motor: Motor) -> Fit:
    """Least squares of the rotor equation along the rotor flux, which is free of the speed,

    `τ_r/2 d|ψ_R|²/dt + |ψ_R|² - λ L_M i·ψ_R = 0`,   `ψ_R = ψ_R0 + χ`,   `χ = ∫(u - R i)dt - L_σ (i - i_0)`,

    integrated over blocks: linear in `ψ_R0` and `|ψ_R0|²` for a given `λ`, the saturation, which is searched
    from 0.5 to 1.3.
    """
    psi_n, n = motor.base["psi"], len(i)
    steps = (u[1:] - R * 0.5 * (i[1:] + i[:-1])) * step
    chi = np.concatenate(([0j], np.cumsum(steps))) - motor.L_sigma * (i - i[0])
    edges = np.unique(np.linspace(0, n - 1, min(60, n // 2) + 1).astype(int))
    length = np.diff(edges)

    def mean(x: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(np.add.reduceat(x[:-1], edges[:-1]) / length)

    rate = motor.tau_r / (2.0 * length * step)
    square = np.abs(chi) ** 2
    fixed = rate * np.diff(square[edges]) + mean(square)
    by_flux = 2.0 * rate * np.diff(chi[edges]) + 2.0 * mean(chi)
    drag, of_drag = motor.L_M * mean(i), motor.L_M * mean((np.conj(i) * chi).real)
    best: tuple[float, float, complex, float] | None = None
    for scale in np.linspace(0.5, 1.3, 33):
        rows = by_flux - scale * drag
        table = np.column_stack((rows.real, rows.imag, np.full(len(rows), psi_n))) / psi_n
        right = -(fixed - scale * of_drag) / psi_n**2
        left, singular, right_t = np.linalg.svd(table / math.sqrt(len(rows)), full_matrices=False)
        inverse = (left.T @ right) / math.sqrt(len(rows)) / np.maximum(singular, 1e-9)
        psi_r = complex(*(right_t.T @ inverse)[:2]) * psi_n
        error = (fixed + (np.conj(rows) * psi_r).real - scale * of_drag + abs(psi_r) ** 2) / psi_n**2
        residual = float(np.sqrt(np.mean(error**2)))
        cost = residual + 0.05 * abs(scale - 1.0)
        if best is None or cost < best[0]:
            best = cost, residual, psi_r, float(singular[-1])
    assert best is not None
    _, residual, psi_r, least = best
    return Fit(psi_r, residual, residual / max(least, 1e-6) * psi_n, psi_r + chi)


@dataclass(frozen=True)
class Start:
    """From a row on: the state with which the estimators begin."""

    row: int
    psi_s: complex
    deviation: float
    omega_m: float
    known: bool
    """Whether there is an estimate from here on."""
    R_s: float | None = None
    settled: bool = False
    """Flux of a direct current along the a-axis in a machine at rest."""


def starts(
    rows: Rows, motor: Motor, inverter: Inverter, scheme: str, notes: list[str]
) -> tuple[list[Start], complex | None]:
    """Where the estimators begin, and the offset of the currents if the log begins with the bridge
    blocked."""
    offset, first = _blocked(rows, motor)
    if offset is None:
        return [_underway(rows, motor, inverter, notes)], None
    notes.append(
        f"current offset {abs(offset):.3g} A, read over the first {rows.t[first] - rows.t[0]:.3g} s without "
        f"current"
    )
    starts = [Start(0, 0j, 0.0, 0.0, False), Start(first, 0j, 0.0, 0.0, False)][1 if first == 0 else 0 :]
    settled = _magnetised(rows, first, offset, motor, inverter, scheme)
    if settled is not None:
        return [*starts, settled], offset
    # The field turns before it has settled: its flux is the integral from zero.
    later = first + round(3 * motor.tau_r / rows.step)
    if later < len(rows.t) - 1:
        notes.append(
            "the field turns before it has settled: flux from its build-up, without a reading of R_s"
        )
    return [*starts[:-1], Start(first, 0j, 0.0, 0.0, True)], offset


def _blocked(rows: Rows, motor: Motor) -> tuple[complex | None, int]:
    """Mean current of a beginning without current, and the row at which it ends."""
    least = round(_REST / rows.step)
    if len(rows.i) <= least:
        return None, 0
    head = rows.i[:least]
    mean, noise = complex(head.mean()), float(np.sqrt(np.mean(np.abs(head - head.mean()) ** 2)))
    base = motor.base
    if abs(mean) > 0.15 * base["i"] or noise > 0.03 * base["i"]:
        return None, 0
    moved = np.abs(rows.i - mean) > max(8.0 * noise, 0.02 * base["i"])
    end = int(np.argmax(moved)) if moved.any() else len(rows.i)
    if end < least:
        return None, 0
    end = max(0, min(end, len(rows.i) - 1) - 2)
    return complex(rows.i[: end + 1].mean()), end


def _magnetised(
    rows: Rows, first: int, offset: complex, motor: Motor, inverter: Inverter, scheme: str
) -> Start | None:
    """The flux that a current of constant direction builds up in a machine at rest, `dψ_R/dt = R_R i -
    ψ_R/τ_r`: the enhanced scheme begins before its end, the published one at its end, with the
    resistance read there."""
    every = max(1, round(1e-3 / rows.step))
    i = rows.i[first:] - offset
    u = rows.u[first:] - (
        bridge_loss(i, rows.u_dc[first:], inverter) if inverter.dead_time or inverter.u_th else 0.0
    )
    n = len(i) // every
    mean = i[: n * every].reshape(n, every).mean(axis=1)
    volts = u[: n * every].reshape(n, every).mean(axis=1)
    base, step = motor.base, every * rows.step
    psi = np.zeros(n, complex)
    for k in range(1, n):
        psi[k] = psi[k - 1] + step * (motor.R_R * mean[k] - psi[k - 1] / motor.tau_r)
        # Once there is flux the current has to stay along it: otherwise there is torque.
        if abs(psi[k]) > 0.2 * base["psi"] and abs((np.conj(psi[k]) * mean[k]).imag) > 0.1 * abs(
            psi[k] * mean[k]
        ):
            n = k
            break
    size, steady = np.abs(psi[:n]), motor.L_M * np.abs(mean[:n])
    settled = np.flatnonzero((np.abs(size - steady) < 0.05 * size) & (size > 0.4 * base["psi"]))
    if not len(settled):
        return None
    # The rest of the time finds R_s and the bridge, which only another current tells apart: the start is
    # before the first change of the settled current, or in the middle if there is none.
    level = np.abs(mean[:n])
    changed = np.flatnonzero(np.abs(level / level[settled[0]] - 1.0) > 0.1)
    changed = changed[changed > settled[0]]
    until = int(changed[0]) if len(changed) else n // 2
    k, R_s = int(settled[settled < max(until, settled[0] + 1)][-1]), None
    if scheme == "paper":
        k = int(settled[-1])
        last = slice(max(0, k - max(1, n // 8)), k + 1)
        R_s = float((np.conj(mean[last]) * volts[last]).real.sum() / (np.abs(mean[last]) ** 2).sum())
    row = min(first + (k + 1) * every, len(rows.i) - 1)
    psi_s = complex(psi[k] + motor.L_sigma * (rows.i[row] - offset))
    # The start-up of a drive: the covariance of its flux is known better than that of any other one.
    along_a = abs(np.angle(psi_s)) < 0.02
    return Start(row, psi_s, 0.07 * abs(psi_s), 0.0, True, R_s, bool(along_a))


def _underway(rows: Rows, motor: Motor, inverter: Inverter, notes: list[str]) -> Start:
    """A log that begins in operation: the flux by the fit over the shortest window that determines it."""
    step, base = rows.step, motor.base
    u = rows.u - (bridge_loss(rows.i, rows.u_dc, inverter) if inverter.dead_time or inverter.u_th else 0.0)
    best: Fit | None = None
    for seconds in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6):
        n = min(round(seconds / step), len(rows.t))
        fit = fit_flux(u[:n], rows.i[:n], step, motor.R_s + inverter.r_d, motor)
        size = float(np.median(np.abs(fit.path))) / base["psi"]
        if 0.2 < size < 2.0 and (best is None or fit.deviation < best.deviation):
            best = fit
        if n == len(rows.t) or (best is not None and best.deviation < 0.05 * base["psi"]):
            break
    turned = 0.0 if best is None else float(np.ptp(np.unwrap(np.angle(best.path))))
    if best is None or (best.deviation > 0.3 * base["psi"] and turned < 1.0):
        psi_r = motor.L_M * complex(rows.i[0])
        notes.append("the field hardly turns at the beginning: its position is taken from the current, ± 30°")
        return Start(0, psi_r + motor.L_sigma * complex(rows.i[0]), 0.5 * abs(psi_r), 0.0, True)
    few = best.path[: max(2, round(_FIRST / step))]
    omega_s = float(np.unwrap(np.angle(few))[-1] - np.angle(few[0])) / (step * (len(few) - 1))
    mean = rows.i[: len(few)]
    slip = motor.R_R * float(np.mean((np.conj(few) * mean).imag / np.abs(few) ** 2))
    deviation = min(max(best.deviation, 0.02 * base["psi"]), 0.3 * base["psi"])
    psi_s = best.psi_r + motor.L_sigma * complex(rows.i[0])
    return Start(0, psi_s, deviation, (omega_s - slip) / motor.n_p, True)
