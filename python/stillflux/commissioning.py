"""From the nameplate to the parameters of a drive: `Commissioning`, one control period at a time, and
`commission`, closed loop on a plant."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stillflux._core import COMMISSIONING_TRIP, CommissioningCore, CommissioningRun
from stillflux.machine_file import machine_to_toml, priors
from stillflux.messages import meant
from stillflux.nameplate import Nameplate
from stillflux.options import DriveSettings, PlantOptions
from stillflux.parallel import undisturbed
from stillflux.parameters import Inverter, Motor, instance
from stillflux.simulation import check_progress, in_pieces, progress_bar

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = [
    "PROCEDURES",
    "Commissioned",
    "Commissioning",
    "CommissioningInterrupted",
    "Procedure",
    "Shaft",
    "commission",
    "pulse_delay",
]

Shaft = Literal["locked", "free"]
"""Whether the shaft may turn: "free" adds a run to three tenths of rated speed, for J."""


Procedure = Literal["wiring", "legs", "bridge", "leakage", "magnetising", "inertia"]
"""A procedure that can be run alone, after the check of the wiring."""
PROCEDURES: tuple[Procedure, ...] = get_args(Procedure)
"""All of them, in the order in which they are run."""


_FAR_INERTIA = 8.0
"""Factor from the inertia by the plate beyond which the one that is found is named."""


def pulse_delay(options: Mapping[str, Any]) -> NDArray[np.float64]:
    """By what the pulse of each leg is longer than commanded, s, shape (3, 2): for a positive and for a
    negative current, from the `turn_on_delay` and `turn_off_delay` of the plant's options."""
    on, off = (np.array(options.get(name, np.zeros((3, 2)))) for name in ("turn_on_delay", "turn_off_delay"))
    return np.stack([off[:, 0] - on[:, 0], on[:, 1] - off[:, 1]], axis=1)


@dataclass(frozen=True, kw_only=True)
class Commissioned:
    """What a commissioning has found. Values of procedures that were not completed are the nameplate's."""

    motor: Motor
    """The motor at slip frequency, with its saturation curve if that was found."""
    inverter: Inverter
    """The inverter with its curve: u_th, dead_time and c_out, and with what its legs differ: leg_delay."""
    deviation: Mapping[str, float]
    """Relative standard deviation of R_s (with r_d), R_R, L_sigma, L_M, J, of the loss of the bridge
    ("loss": threshold and dead time) and of c_out; and the standard deviation of each leg_delay in s, if the
    legs were compared."""
    warnings: tuple[str, ...] = ()
    """What should be looked at, in words."""
    status: str = "done"
    """"done", or the fault with its cause and time."""
    cause: str | None = None
    """Cause of the fault, None without one."""
    duration: float = 0.0
    """Time from the first to the last control period, s; 0 where it is not known."""
    friction: float | None = None
    """Mean friction torque at low speed, N·m; None without a run of the free shaft."""
    bridge_levels: tuple[tuple[float, float, float], ...] = ()
    """Current along the a-axis in A, voltage and fitted voltage in V of each level of the bridge's curve."""
    psi_max: float | None = None
    """Largest flux of the magnetising curve relative to the rated one, None if it was not found."""
    extremes: tuple[float, float] | None = field(default=None, repr=False)
    """On a plant: largest phase current relative to the rated peak, and the largest angle of the shaft in the
    procedures at standstill, electrical rad."""

    @property
    def settings(self) -> DriveSettings:
        """What the drive begins with: `Drive(found.motor, found.inverter, **found.settings)`.

        The deviations, with what may change later: the temperature of the winding (15 %) in that of R_s."""
        return priors(self.deviation)

    def to_toml(
        self, name: str = "", plant_motor: Motor | None = None, plant_inverter: Inverter | None = None
    ) -> str:
        """The text of a motor file: status, cause and warnings, tables motor, inverter and deviation; with
        motor and inverter that were simulated, if they are given."""
        return machine_to_toml(
            self.motor,
            self.inverter,
            name=name,
            deviation=self.deviation,
            warnings=self.warnings,
            status=self.status,
            cause=self.cause,
            plant_motor=plant_motor,
            plant_inverter=plant_inverter,
        )


class CommissioningInterrupted(KeyboardInterrupt):
    """A commissioning on a plant ended by Ctrl-C; `result` is what it had found."""

    def __init__(self, result: Commissioned) -> None:
        super().__init__(f"interrupted after {result.duration:.3f} s")
        self.result = result

    def __reduce__(self) -> tuple[type[CommissioningInterrupted], tuple[Commissioned]]:
        return CommissioningInterrupted, (self.result,)


class Commissioning:
    """Finds the parameters of a motor and of its bridge, through the bridge itself.

    `step` is called once a control period, with the same timing as `Drive.step`: currents sampled at the
    start of period k give the duties applied during period k + 1. At standstill every current flows along one
    axis: a free shaft does not turn. The current stays below 1.45 times the rated one, which the current
    channels have to show: of one that ends before, nothing is known beyond.

    Parameters
    ----------
    plate
        The motor's nameplate.
    inverter
        What the data sheet says: dc-link voltage, frequencies and r_d are taken as they are, the rest is
        found.
    shaft
        "locked" (or not to be turned), or "free": then a run to three tenths of rated speed follows.
    arithmetic
        "f32", "f64" or "q".
    only
        One procedure alone, after the check of the wiring: "wiring" (that check and nothing else), "legs",
        "bridge", "leakage", "magnetising", or, with a free shaft, "inertia". The values of the
        others are those of nameplate and data sheet. None: all of them.
    current_sensors
        3, or 2 with sensors in phases a and b: the third reading is not looked at, every impedance has the
        gain of phase a, and of `leg_delay` only the part is found that does not change its sign with the
        current. A drive for the result wants the setting `current_sensors=2`, too.

    Raises ValueError for a value outside its range. Bad wiring does not raise, see `status`.
    """

    def __init__(
        self,
        plate: Nameplate,
        inverter: Inverter,
        shaft: Shaft = "locked",
        arithmetic: str = "f32",
        *,
        only: Procedure | None = None,
        current_sensors: int = 3,
    ) -> None:
        instance("plate", plate, Nameplate)
        instance("inverter", inverter, Inverter)
        self._plate = plate
        self._core = CommissioningCore(plate, inverter, shaft, arithmetic, only, current_sensors)

    def step(self, i_abc: Iterable[float], u_dc: float) -> NDArray[np.float64]:
        """One control period: phase currents in A (three numbers), dc-link voltage in V; returns the duties
        of the three legs for the next period, shape (3,) in [0, 1]."""
        return self._core.step(i_abc, u_dc)

    @property
    def gates_on(self) -> bool:
        """False: the bridge has to be blocked; the duties are then 0.5 each."""
        return self._core.gates_on

    @property
    def done(self) -> bool:
        """Whether it is over, completed or by a fault."""
        return self._core.status != "running"

    @property
    def progress(self) -> float:
        """Part that is over, 0 to 1."""
        return self._core.progress

    @property
    def stage(self) -> str:
        """Procedure under way or in which it ended: "wiring", "legs", "bridge", "leakage", "magnetising",
        "inertia", "complete"."""
        return self._core.stage

    @property
    def status(self) -> str:
        """ "running", "done", or the fault with its cause and time: "fault: open phase at 0.1284 s"."""
        return self._core.status

    @property
    def cause(self) -> str | None:
        """Cause of the fault, None without one."""
        return self._core.cause

    def abort(self) -> None:
        """Blocks the gates for good; what has been found stays."""
        self._core.abort()

    def __reduce__(self) -> Any:
        # A shallow copy would share what runs: two halves of one commissioning, each with every other sample.
        raise TypeError("a Commissioning is not copied, nor pickled: keep its result, or begin a new one")

    def __repr__(self) -> str:
        return f"<Commissioning: {self.status}, {self.stage}, {100 * self.progress:.0f} %>"

    @property
    def result(self) -> Commissioned:
        """What has been found so far.

        Raises ValueError if that is no motor or inverter that a drive accepts."""
        return _result(self._core, self._plate)


def commission(
    plate: Nameplate,
    inverter: Inverter,
    *,
    plant_motor: Motor,
    plant_inverter: Inverter | None = None,
    shaft: Shaft = "locked",
    arithmetic: str = "f32",
    only: Procedure | None = None,
    current_sensors: int = 3,
    channels: tuple[int, int, int] | None = None,
    channel_factor: tuple[float, float, float] | None = None,
    progress: Callable[[float, str], object] | bool | None = None,
    **plant: Unpack[PlantOptions],
) -> Commissioned:
    """Commissions a simulated motor and returns what was found.

    Parameters
    ----------
    plate, inverter, arithmetic, only, current_sensors
        As of `Commissioning`.
    shaft
        "locked": the plant's shaft stands still as well, unless its option `speed` says otherwise (None: the
        procedures at standstill alone, on a shaft that nothing holds). "free": J is found, too.
    plant_motor, plant_inverter
        The real ones; `plant_inverter` is `inverter` if it is not given.
    channels, channel_factor
        Faults of the wiring: the leg whose current each channel reads (0, 1, 2), and a factor of each
        channel, negative for an inverted, 0 for a dead one.
    progress
        Called with the fraction done, 0 to 1, and the name of the procedure; True: a bar on stderr.
    **plant
        See `stillflux.options.PlantOptions`.

    Releases the GIL; raises `CommissioningInterrupted` within 0.2 s of Ctrl-C, and ValueError for a value
    outside its range. A fault does not raise: see `status` and `cause` of the result.
    """
    real = inverter if plant_inverter is None else plant_inverter
    check_progress(progress)
    instance("plate", plate, Nameplate)
    instance("plant_motor", plant_motor, Motor)
    for name, bridge in (("inverter", inverter), ("plant_inverter", real)):
        instance(name, bridge, Inverter)
    for key in plant:
        if key not in PlantOptions.__annotations__:
            known = [*PlantOptions.__annotations__, *inspect.signature(commission).parameters]
            raise TypeError(
                f"neither commission nor the plant has the setting {key!r}{meant(key, known[:-1])}"
            )
    adc_range = plant.get("adc_range")
    if isinstance(adc_range, (int, float)):
        least = COMMISSIONING_TRIP * math.sqrt(2.0) * plate.I_N
        if not adc_range >= least:
            raise ValueError(
                f"adc_range = {adc_range:g} A is outside the admissible range {least:.4g} A to inf: currents "
                f"go up to {COMMISSIONING_TRIP:g} times the rated peak; a channel that ends before lets them "
                "grow on"
            )
    if shaft == "locked":
        plant.setdefault("speed", 0.0)
    run = CommissioningRun(
        plate,
        inverter,
        shaft,
        arithmetic,
        only,
        current_sensors,
        plant_motor,
        real,
        channels,
        channel_factor,
        dict(plant),
    )

    bar = progress_bar("commissioning") if progress is True else None

    def show() -> None:
        if bar is not None:
            bar(run.progress)
        elif callable(progress):
            progress(run.progress, run.stage)

    try:
        in_pieces(run.advance, show)
    except KeyboardInterrupt:
        with undisturbed():
            raise CommissioningInterrupted(_result(run, plate, run.time, run.extremes)) from None
    return _result(run, plate, run.time, run.extremes)


def _doubts(plate: Nameplate, J: float) -> Iterator[str]:
    """What speaks against the plate, in words."""
    if text := plate.doubt:
        yield text
    expected = plate.motor().J
    if not expected / _FAR_INERTIA < J < expected * _FAR_INERTIA:
        known = "of the plate" if plate.J is not None else "that a motor of this torque has"
        yield (
            f"J = {J:.3g} kg·m² is not within a factor of {_FAR_INERTIA:g} of the {expected:.3g} kg·m² "
            f"{known}: is n_p = {plate.n_p} right, which follows from n_N and f_N, or is a load coupled?"
        )


def _result(
    source: CommissioningCore | CommissioningRun,
    plate: Nameplate,
    duration: float = 0.0,
    extremes: tuple[float, float] | None = None,
) -> Commissioned:
    found: dict[str, Any] = source.found()
    return Commissioned(
        motor=Motor(**found["motor"]),
        inverter=Inverter(**found["inverter"]),
        deviation=found["deviation"],
        warnings=(*found["warnings"], *_doubts(plate, found["motor"]["J"])),
        status=source.status,
        cause=source.cause,
        duration=duration,
        friction=found["friction"],
        bridge_levels=tuple(found["bridge_levels"]),
        psi_max=found["psi_max"],
        extremes=extremes,
    )
