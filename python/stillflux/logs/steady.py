"""Steady blocks of a log: what a machine has for an impedance there, without an integral."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.logs.signals import Rows
from stillflux.logs.start import bridge_loss
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Steady", "steady_blocks"]

_BLOCK = 0.1  # s, of a shorter log a quarter of it
_MOST = 60  # blocks, evenly chosen
# From block to block and within one, at most: of the current, relative, and of the frequency, of rated.
_CHANGE = (0.05, 0.02)
_LEAST = 0.1  # current, per unit
_SLOWEST = 0.03  # of rated frequency: below it the flux is the difference of two voltages
_STILL = 0.003  # the same: below it the current is direct
_SETTLED = 3.0  # rotor time constants after which the flux of a direct current no longer induces a voltage


@dataclass(frozen=True)
class Steady:
    """Rows of the steady blocks of a log, shape (blocks, rows), and their frequency."""

    u: NDArray[np.complex128]
    i: NDArray[np.complex128]
    u_dc: NDArray[np.float64]
    turning: NDArray[np.float64]
    """Stator frequency, rad/s: of those blocks that turn, which are the first ones; the rest has a direct
    current."""
    step: float

    def impedance(
        self, voltage: float, current: float, link: float, inverter: Inverter
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.float64]]:
        """Voltage over current and the bridge's loss over current in Ω, and the current in A, where the log's
        values are too large by these factors."""
        i = self.i / current
        square = np.mean(np.abs(i) ** 2, axis=1)
        z = np.mean(self.u / voltage * np.conj(i), axis=1) / square
        # A voltage is the mean up to its sample, half an interval behind the current.
        z[: len(self.turning)] *= np.exp(0.5j * self.turning * self.step)
        loss = np.zeros_like(z)
        if inverter.dead_time or inverter.u_th:
            loss = np.mean(bridge_loss(i, self.u_dc / link, inverter) * np.conj(i), axis=1) / square
        return z, loss, np.sqrt(square)


def steady_blocks(rows: Rows, motor: Motor) -> Steady | None:
    """None for a log without a steady block."""
    step, base = rows.step, motor.base
    length = max(4, round(min(_BLOCK, 0.25 * (rows.t[-1] - rows.t[0])) / step))
    n = len(rows.i) // length

    def blocks(x: NDArray[Any]) -> NDArray[Any]:
        return x[: n * length].reshape(n, length)

    i = blocks(rows.i)
    every = max(1, min(length // 4, round(1e-3 / step)))
    slow = i[:, : length // every * every].reshape(n, -1, every).mean(axis=2)
    turned = np.angle(slow[:, 1:] * np.conj(slow[:, :-1])) / (every * step)
    omega, size = turned.mean(axis=1), np.sqrt(np.mean(np.abs(i) ** 2, axis=1)) + 1e-30
    half, middle = length // 2, turned.shape[1] // 2
    first = np.sqrt(np.mean(np.abs(i[:, :half]) ** 2, axis=1))
    drift = np.abs(turned[:, :middle].mean(axis=1) - turned[:, middle:].mean(axis=1))
    of_current, of_frequency = _CHANGE[0], _CHANGE[1] * base["omega"]
    steady = (
        (np.abs(first / size - 1.0) < of_current)
        & (np.abs(np.diff(size, prepend=size[0])) < of_current * size)
        & (drift < of_frequency)
        & (np.abs(np.diff(omega, prepend=omega[0])) < of_frequency)
        & (size > _LEAST * base["i"])
    )
    still = steady & (np.abs(omega) < _STILL * base["omega"]) & (np.abs(i.mean(axis=1)) > 0.9 * size)
    still &= _run_length(still) > math.ceil(_SETTLED * motor.tau_r / (length * step))
    turning = np.flatnonzero(steady & (np.abs(omega) > _SLOWEST * base["omega"]))
    chosen = [_evenly(turning), _evenly(np.flatnonzero(still))]
    at = np.concatenate(chosen)
    if not len(at):
        return None
    return Steady(blocks(rows.u)[at], i[at], blocks(rows.u_dc)[at], omega[chosen[0]], step)


def _run_length(x: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Blocks up to each one that are true without a gap."""
    at = np.arange(1, len(x) + 1)
    return np.asarray(at - np.maximum.accumulate(np.where(x, 0, at)))


def _evenly(at: NDArray[np.int64]) -> NDArray[np.int64]:
    if len(at) <= _MOST // 2:
        return at
    return np.asarray(at[np.linspace(0, len(at) - 1, _MOST // 2).astype(int)])
