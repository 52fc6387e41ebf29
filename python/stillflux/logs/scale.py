"""Whether voltages and currents of a log have their scale: line-to-line for phase, rms for peak, the link.

What a wrong factor changes in what is identified from the log:

| | R_s, L_σ, L_M | flux | slip, by the motor's R_R | torque |
|---|---|---|---|---|
| voltage (or link, with duties) times k | k | k | 1/k | k |
| current times k | 1/k | 1 | k | k |
| both times k | 1 | k | 1 | k² |

The log alone cannot tell: a machine with k times the impedances is one, too. How well the motor's parameters
are known tells (`stillflux.logs.likelihood`): the log is held against each of the usual mistakes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stillflux.logs.likelihood import Blocks, ratios
from stillflux.logs.signals import Rows
from stillflux.logs.steady import steady_blocks
from stillflux.parameters import Inverter, Motor

__all__ = ["Scale", "scale_of"]

# One log in ten has a wrong scale: a factor is noted if the log is nine times as likely with it. Others that
# are at least a third as likely are named beside it. Beyond 4 σ a log is not one of this motor.
_ODDS = 2.0 * math.log(9.0)
_ALIKE = 2.0 * math.log(3.0)
_UNLIKELY = 16.0
_FACTORS = {"√2": math.sqrt(2.0), "√3": math.sqrt(3.0), "2": 2.0}
_CAUSES = {
    "voltage": {
        "√2": "peak and rms values",
        "√3": "line-to-line and phase values",
        "2": "a divider, or peak to peak",
    },
    "link": {
        "√2": "rms of the line for the link",
        "√3": "the unit of the modulation: u_dc/√3 for 1",
        "2": "duties from -1 to 1, or one half of the link",
    },
    "current": {
        "√2": "peak and rms values",
        "√3": "line and winding current of a delta",
        "2": "the turns through a transducer, or peak to peak",
    },
    "both": {
        "√2": "peak and rms values",
        "√3": "values of a delta's winding and line",
        "2": "peak to peak",
    },
}


@dataclass(frozen=True)
class Scale:
    """What was found of the scale of a log."""

    text: str | None
    """The note; None: the log is one of this motor."""
    explained: bool
    """Whether the log is one of this motor, with the factors of the note if there is one."""


@dataclass(frozen=True)
class _Factor:
    """A mistake: what is larger than it should be by which factor."""

    word: str
    voltage: float
    current: float

    def near(self) -> Iterator[_Factor]:
        """The same with a factor that need not be a root."""
        for part in np.exp(np.linspace(-0.2, 0.2, 17)):
            voltage, current = (1.0 if k == 1.0 else k * float(part) for k in (self.voltage, self.current))
            yield _Factor(self.word, voltage, current)

    def shown(self) -> str:
        """What a log with it shows."""
        if self.voltage == self.current:
            return f"power {self.voltage * self.current:.3g} times too large for its flux"
        return f"impedances (R_s, L_sigma, L_M) {self.voltage / self.current:.3g} times the motor's"

    def cause(self, of_link: bool) -> str:
        """In words."""
        voltage = "duties times link" if of_link else "voltage"
        if self.voltage == self.current:
            return f"{voltage} and current {self._root} times too large ({_CAUSES['both'][self._root]})"
        what, k, kind = ("current", self.current, "current")
        if self.current == 1.0:
            what, k, kind = (voltage, self.voltage, "link" if of_link else "voltage")
        size = "large" if k > 1.0 else "small"
        return f"{what} {self._root} times too {size} ({_CAUSES[kind][self._root]})"

    @property
    def _root(self) -> str:
        return self.word.removeprefix("1/")


def scale_of(rows: Rows, motor: Motor, inverter: Inverter, of_link: bool) -> Scale | None:
    """The scale of a log, None where nothing in the log is steady; `of_link`: voltages are duties times
    `u_dc`."""
    steady = steady_blocks(rows, motor)
    if steady is None:
        return None

    def cost(f: _Factor) -> float:
        factors = f.voltage, f.current, f.voltage if of_link else 1.0
        return Blocks.of(steady, factors, motor, inverter).fit()[0]

    given = Blocks.of(steady, (1.0, 1.0, 1.0), motor, inverter)
    unlikely, suiting = given.fit()
    ranked = sorted(((cost(f), f) for f in _mistakes()), key=lambda x: x[0])
    least, best = ranked[0]
    if unlikely - least > _ODDS and least < _UNLIKELY:
        measured = min(((cost(f), f) for f in best.near()), key=lambda x: x[0])[1]
        causes = ", or ".join(f.cause(of_link) for other, f in ranked if other - least < _ALIKE)
        wrong = "Torque is" if best.voltage == best.current else "Slip, torque and flux are"
        text = f"{measured.shown()}{_flux(given)}: {causes}, or another motor? {wrong} wrong then"
    elif unlikely > _UNLIKELY:
        taken = ", ".join(f"{name} {ratio:.2g}" for name, ratio in ratios(suiting).items())
        text = (
            f"it would take {taken} times what they are{_flux(given)}, and no factor of √2, √3 or 2 "
            f"explains that: are the motor, the units, the angle and the sampling rate right?"
        )
    else:
        return Scale(None, True)
    return Scale(f"currents and voltages hardly fit this motor: {text}", least < _UNLIKELY)


def _flux(blocks: Blocks) -> str:
    flux = blocks.flux()
    return "" if flux is None else f", flux {flux:.2g} of rated"


def _mistakes() -> Iterator[_Factor]:
    for word, k in _FACTORS.items():
        for text, factor in ((word, k), (f"1/{word}", 1.0 / k)):
            yield _Factor(text, factor, 1.0)
            yield _Factor(text, 1.0, factor)
        # Both too small are a drive with little flux.
        yield _Factor(word, k, k)
