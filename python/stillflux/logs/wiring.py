"""Whether currents and voltages of a log belong to the same phases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from stillflux.logs.read import Log
from stillflux.logs.scale import Scale
from stillflux.logs.signals import TURN, Rows, space
from stillflux.logs.start import bridge_loss, fit_flux
from stillflux.parameters import Inverter, Motor

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["check_wiring"]


_MISFIT = 0.5  # relative misfit from which on a log is hardly one of this motor
_JUMP = 0.125  # turns within a millisecond by which a field does not change its way
_FLUX = (0.5, 1.6)  # of rated, the same: field weakening and saturation lie between


def check_wiring(
    log: Log, rows: Rows, motor: Motor, inverter: Inverter, scale: Scale | None, notes: list[str]
) -> None:
    """Currents and voltages of the same phases, by the fit of the flux over the fastest two turns.

    A misfit that no other wiring explains is a note that motor, unit, angle or rate may be another, where
    nothing is known of the `scale` of the log.
    """
    i, step = rows.i, rows.step
    total = np.sqrt(np.mean(rows.i_sum**2))
    if len(rows.currents) == 3 and total > 0.3 * np.sqrt(np.mean(np.abs(i) ** 2)):
        names = log.place(rows.currents)
        raise ValueError(
            f"{names}: the three currents do not add up to zero: one is inverted, or its unit another"
        )
    every = max(1, round(1e-3 / step))
    slow = i[: len(i) // every * every].reshape(-1, every).mean(axis=1)
    moved = np.angle((slow[1:] + 1e-30) * np.conj(slow[:-1] + 1e-30)) / (2 * np.pi)
    # No rotation: a current that is reversed or set along another axis, as a start does to compare the legs.
    uneven = np.abs((np.diff(moved) + 0.5) % 1.0 - 0.5) > _JUMP
    moved[(np.abs(moved) > _JUMP) & (np.append(uneven, False) | np.append(False, uneven))] = 0.0
    turned = np.concatenate(([0.0], np.cumsum(moved)))
    window = min(len(slow) - 1, round(1.0 / (every * step)))
    swing = np.abs(turned[window:] - turned[:-window])
    if not len(swing) or swing.max() < 1.0:
        return
    begin = int(swing.argmax())
    two = np.flatnonzero(np.abs(turned[begin:] - turned[begin]) >= 2.0)
    length = min(window, int(two[0]) if len(two) else window)
    part = slice(begin * every, (begin + length) * every)
    u, i, u_dc = rows.u[part], rows.i[part], rows.u_dc[part]
    R = motor.R_s + inverter.r_d

    def fitted(current: NDArray[np.complex128]) -> tuple[float, float]:
        """Relative misfit, and flux per unit of rated."""
        loss = bridge_loss(current, u_dc, inverter) if inverter.dead_time or inverter.u_th else 0.0
        fit = fit_flux(u - loss, current, step, R, motor)
        # A flux that no machine has fits nothing, however round it is.
        size = float(np.median(np.abs(fit.path))) / motor.base["psi"]
        return fit.residual + max(0.0, size - 1.5) + max(0.0, 0.2 - size), size

    given, flux = fitted(i)
    if given >= 0.3:
        # Another scale may explain the log, too; a third of a turn hardly differs from a load.
        other = f"; or {scale.text}" if scale and scale.text and scale.explained else ""
        _check_other_wirings(log, rows.currents, i, given, other, lambda current: fitted(current)[0])
    if scale is None and (given > _MISFIT or not _FLUX[0] < flux < _FLUX[1]):
        notes.append(
            f"currents and voltages hardly fit this motor (flux {flux:.2g} of rated, relative misfit "
            f"{given:.2g}): are the motor, the units, the angle and the sampling rate right?"
        )


def _check_other_wirings(
    log: Log,
    names: tuple[str, ...],
    i: NDArray[np.complex128],
    given: float,
    other: str,
    misfit: Callable[[NDArray[np.complex128]], float],
) -> None:
    best, text = min(((misfit(current), text) for text, current in _rewired(i, names)), key=lambda x: x[0])
    # Only if the other way explains the log: a machine that is not this one fits in no way.
    if best < min(0.15, 0.5 * given):
        raise ValueError(
            f"{log.place(names)}: currents and voltages are not those of the same phases; they fit with "
            f"{text} (relative misfit {best:.2f} instead of {given:.2f}){other}; "
            f"check=False accepts the log as it is"
        )


def _rewired(
    i: NDArray[np.complex128], names: tuple[str, ...]
) -> Iterator[tuple[str, NDArray[np.complex128]]]:
    """Other ways to connect the channels."""
    phases = [(i * np.conj(axis)).real for axis in (1.0, TURN, np.conj(TURN))]
    if names[0][2:] not in ("a", "b", "c"):
        yield "the current inverted", -i
        yield (
            f"{names[-1] if len(names) > 1 else 'the β-component'} inverted (or two phases swapped)",
            np.conj(i),
        )
        yield "α and β swapped", 1j * np.conj(i)
        yield "two phases swapped and the current inverted", -np.conj(i)
        for turn, text in ((TURN, "a third of a turn ahead"), (np.conj(TURN), "a third of a turn behind")):
            yield f"the phases shifted by {text}", i * turn
        return
    at = ["abc".index(name[2:]) for name in names]
    for order in permutations(range(len(names))):
        signs = product((1.0, -1.0), repeat=2) if len(names) == 2 else ((s, s) for s in (1.0, -1.0))
        for sign in signs:
            if order == tuple(range(len(names))) and all(s > 0 for s in sign):
                continue
            values: list[Any] = [None, None, None]
            for to, source in enumerate(order):
                values[at[to]] = phases[at[source]] * sign[min(source, len(sign) - 1)]
            if len(names) == 2:
                last = next(k for k in range(3) if k not in at)
                values[last] = -values[at[0]] - values[at[1]]
            moved = [names[k] for k in range(len(names)) if order[k] != k]
            flipped = [names[k] for k in range(len(names)) if sign[min(k, len(sign) - 1)] < 0]
            words = []
            if len(moved) == 2:
                words.append(f"{moved[0]} and {moved[1]} swapped")
            elif moved:
                words.append("phases in the order " + ", ".join(names[k] for k in order))
            if flipped:
                words.append(f"{', '.join(flipped)} inverted")
            yield " and ".join(words), space(*values)
