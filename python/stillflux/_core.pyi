"""The compiled part of stillflux. SI units, complex amplitude-invariant space vectors."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self, Unpack

from stillflux.nameplate import Nameplate
from stillflux.options import Arithmetic, DriveSettings, PlantOptions, Scheme
from stillflux.parameters import Inverter, Motor
from stillflux.scenario import Scenario

__all__ = [
    "COMMISSIONING_TRIP",
    "CommissioningCore",
    "CommissioningRun",
    "Drive",
    "Estimate",
    "FluxEstimator",
    "Plant",
    "PlantState",
    "RecordEstimator",
    "Run",
    "Status",
    "StatusWarning",
    "Trace",
    "at_slip_frequency",
    "base",
    "from_gamma",
    "from_t_model",
    "inverter_preset",
    "motor_preset",
    "nameplate_motor",
    "nameplate_of",
    "priors",
    "signals",
    "to_gamma",
    "to_t_model",
    "validate_inverter",
    "validate_motor",
]

def validate_motor(motor: Motor) -> None:
    """Raises ValueError for the first field of a motor outside its range."""

def validate_inverter(inverter: Inverter) -> None:
    """Raises ValueError for the first field of an inverter outside its range."""

def motor_preset(name: str) -> dict[str, Any]:
    """Fields of a preset motor."""

def inverter_preset(name: str) -> dict[str, Any]:
    """Fields of a preset inverter."""

def from_gamma(R_s: float, R_r: float, L_l: float, L_s: float) -> dict[str, float]:
    """Inverse-Γ parameters of a Γ circuit."""

def from_t_model(R_s: float, R_r: float, L_ls: float, L_lr: float, L_m: float) -> dict[str, float]:
    """Inverse-Γ parameters of a T circuit."""

def to_gamma(motor: Motor) -> dict[str, float]:
    """Γ parameters of a motor."""

def at_slip_frequency(motor: Motor, deep_bar: tuple[float, float] | None) -> dict[str, float]:
    """Inverse-Γ parameters at slip frequency of a motor with a second rotor branch; None: its own."""

def to_t_model(motor: Motor) -> dict[str, float]:
    """T parameters of a motor, with equal leakages."""

def base(motor: Motor) -> dict[str, float]:
    """Base quantities of a motor's per-unit system, SI."""

COMMISSIONING_TRIP: float
"""Current at which a commissioning blocks the gates, of the rated peak."""

def signals() -> dict[str, str]:
    """Names and units of all signals a run can record."""

def nameplate_motor(plate: Nameplate) -> tuple[dict[str, Any], dict[str, float]]:
    """Fields of the motor that a nameplate describes, and the relative standard deviation of each parameter.

    Raises ValueError for the first value that no induction machine can have."""

def nameplate_of(motor: Motor) -> dict[str, float]:
    """Fields of the nameplate of a motor: its rated point at rated torque, without iron and friction loss."""

def priors(deviation: Mapping[str, float]) -> DriveSettings:
    """Settings with which a drive begins for relative standard deviations of R_s, R_R, L_sigma, L_M, J, of
    the loss of the bridge and of c_out."""

class StatusWarning(UserWarning):
    """A status is compared with a text that is the name of no state: the answer is always "unequal"."""

@final
class Status:
    """State of a drive's sequence, and the cause and time of a fault.

    Compares equal to its state ("stopped", "reading offset", "magnetising", "running", "faulted") and to the
    coarser "starting" (reading offset or magnetising) and "fault" (faulted); a text that is none of these is
    a `StatusWarning`. Since it equals several texts it has no hash: take `state` for a set."""

    def __new__(
        cls,
        state: str,
        fault: str | None = None,
        time: float | None = None,
        value: float | None = None,
        limit: float | None = None,
    ) -> Status: ...
    @property
    def state(self) -> str:
        """ "stopped", "reading offset", "magnetising", "running" or "faulted"."""
    @property
    def fault(self) -> str | None:
        """Cause of the fault, else None."""
    @property
    def time(self) -> float | None:
        """Time of the fault since power-up in s, else None."""
    @property
    def value(self) -> float | None:
        """What was measured when it happened, in `unit`, else None."""
    @property
    def limit(self) -> float | None:
        """The limit that it violated, in `unit`, else None; 0 where there is none."""
    @property
    def fault_code(self) -> int | None:
        """The cause of the fault as a stable number, else None."""
    @property
    def unit(self) -> str | None:
        """Unit of `value` and `limit`, empty for numbers, else None."""
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __format__(self, spec: str, /) -> str: ...
    def __getnewargs__(
        self,
    ) -> tuple[str, str | None, float | None, float | None, float | None]: ...

@final
class Estimate:
    """Everything a drive estimates, of the latest period. Stator coordinates unless named `dq`."""

    def __new__(
        cls,
        psi_s: complex,
        psi_r: complex,
        psi_1: complex,
        i_s: complex,
        u_s: complex,
        u_i: complex,
        u_off: complex,
        u_hf: complex,
        i_dq: complex,
        i_dq_ref: complex,
        psi_ref: float,
        omega_m: float,
        omega_s: float,
        omega_r: float,
        torque: float,
        R_s: float,
        R_R: float,
        epsilon: float,
        innovation: float,
        nis: float,
        angle_deviation: float,
        confidence: float,
        speed_gain: float,
    ) -> Estimate: ...
    @property
    def psi_s(self) -> complex:
        """Stator flux linkage, V·s."""
    @property
    def psi_r(self) -> complex:
        """Rotor flux linkage of the inverse-Γ circuit, V·s."""
    @property
    def psi_1(self) -> complex:
        """Flux of the parallel path that finds the offset, V·s."""
    @property
    def i_s(self) -> complex:
        """Stator current, A."""
    @property
    def u_s(self) -> complex:
        """Voltage applied between the last two samples, V."""
    @property
    def u_i(self) -> complex:
        """Induced voltage, V."""
    @property
    def u_off(self) -> complex:
        """Offset voltage, V."""
    @property
    def u_hf(self) -> complex:
        """Output of the noise compensator, V."""
    @property
    def i_dq(self) -> complex:
        """Current in field coordinates, A."""
    @property
    def i_dq_ref(self) -> complex:
        """Its reference, A."""
    @property
    def psi_ref(self) -> float:
        """Flux reference, V·s."""
    @property
    def omega_m(self) -> float:
        """Speed, mechanical rad/s."""
    @property
    def omega_s(self) -> float:
        """Stator frequency, electrical rad/s."""
    @property
    def omega_r(self) -> float:
        """Slip frequency, electrical rad/s."""
    @property
    def torque(self) -> float:
        """Torque, N·m."""
    @property
    def R_s(self) -> float:
        """Stator resistance including the inverter's r_d, Ω."""
    @property
    def R_R(self) -> float:
        """Rotor resistance of the inverse-Γ circuit, which slip and speed are taken from, Ω: what the latest
        start found, with the warming and the saturation that are told; that of the parameters in the scheme
        "paper"."""
    @property
    def epsilon(self) -> float:
        """Residual ε of equation (15), per unit; zero in the scheme "enhanced"."""
    @property
    def innovation(self) -> float:
        """Innovation of the filter, rotor flux of the current model less that of the voltage model, V·s;
        zero in the
        scheme "paper"."""
    @property
    def nis(self) -> float:
        """Normalised innovation squared (NIS), low-passed with the innovation's sign over one turn of the
        rated field: one where it stays at the deviation that the filter expects, less where it alternates;
        zero in the scheme "paper"."""
    @property
    def angle_deviation(self) -> float:
        """Standard deviation that the drive expects of its field angle, rad; π while it does not run."""
    @property
    def confidence(self) -> float:
        """Confidence in the field angle, 0 to 1."""
    @property
    def speed_gain(self) -> float:
        """Part of the gains of the speed controller that a swing has left, 1 without one: the shaft has about
        this part of the inertia told."""
    def __getnewargs__(self) -> tuple[complex, ...]: ...
    def __copy__(self) -> Self: ...
    def __deepcopy__(self, memo: dict[int, Any], /) -> Self: ...

@final
class Drive:
    """A sensorless induction motor drive: currents and dc-link voltage in, duties out.

    Currents sampled at the start of control period k give the duties applied during period k + 1.

    Parameters
    ----------
    motor, inverter
        The machine and the inverter as the drive knows them.
    arithmetic
        "f32", "f64" or "q" (fixed point).
    scheme
        "enhanced" (one filter for flux, offset, resistance and inverter error) or "paper" (the published
        scheme).
    **settings
        Limits, bandwidths and switches, see `stillflux.options.DriveSettings`.

    Raises ValueError for a value outside its range, TypeError for an unknown setting.
    """

    def __new__(
        cls,
        motor: Motor,
        inverter: Inverter,
        arithmetic: Arithmetic = "f32",
        scheme: Scheme = "enhanced",
        **settings: Unpack[DriveSettings],
    ) -> Drive: ...
    def step(
        self,
        i_abc: Iterable[float],
        u_dc: float,
        omega_ref: float | None = None,
        torque_ref: float | None = None,
        cycle: int | None = None,
        encoder: int | None = None,
    ) -> NDArray[np.float64]:
        """One control period.

        Parameters
        ----------
        i_abc
            Phase currents in A, positive into the machine; three numbers.
        u_dc
            dc-link voltage in V.
        omega_ref
            Speed reference, mechanical rad/s.
        torque_ref
            Torque reference in N·m, instead of a speed reference. Neither: stop.
        cycle
            Stamp of the PWM period, a number that the hardware counts up by one in each, 0 to 65535, then
            0 again: missed
            and doubled calls are seen by it. A doubled call changes nothing and returns the duties of the
            first, but for a stop or a fault, which block the bridge.
        encoder
            Position of the encoder at the instant of the currents, in counts (four a line) from anywhere;
            with the setting `encoder_lines`. None: it has not been read.

        Returns the duties of the three legs for the next period, an array of shape (3,) in [0, 1].
        Raises ValueError if both references are given or one is not finite, and for an encoder without that
        setting. Implausible measurements do not raise: they are faults, see `status`.
        """
    @property
    def pulses(self) -> tuple[list[float], list[float], list[float]] | None:
        """Pulses of the next period with `current_sensors=1`: half widths of the three legs' pulses before
        and after the middle of the carrier period, and the two instants after it at which the shunt is
        sampled, all in half periods of the carrier. None with more sensors."""
    @property
    def gates_on(self) -> bool:
        """False: the bridge has to be blocked; the duties are then 0.5 each."""
    @property
    def estimate(self) -> Estimate:
        """Estimates of the latest period."""
    @property
    def encoder(self) -> tuple[float, float, str] | None:
        """What the encoder says: measured speed and its filtered difference from the estimate in mechanical
        rad/s, and "silent", "agrees", "apart" or "estimate apart". None without `encoder_lines`."""
    @property
    def status(self) -> Status:
        """State of the sequence, or the fault with its cause and time."""
    @property
    def settings(self) -> DriveSettings:
        """All settings, defaults included."""
    def memory(self) -> dict[str, Any]:
        """Data worth keeping over a stop: u_off (complex, V), R_s (with r_d, Ω), i_off (three values, A),
        loss_error (of the inverter model's voltage, relative), knee (of its curve, relative to that of
        `c_out`), L_sigma and L_M (H), leg_delay (as of `Inverter`, s)."""
    def restore(self, memory: dict[str, Any]) -> None:
        """Takes back what `memory` gave; values beyond their limits are limited, `knee` and `leg_delay` may
        be missing, `u_off` may be (re, im). The next start reads the offsets of the current sensors anew;
        the enhanced scheme takes `u_off` back with `calibrate_offset=False` only.

        Raises TypeError for a value that there is not, ValueError for R_s, L_sigma or L_M that no drive of
        this motor and inverter has (the memory is another machine's), RuntimeError while the bridge switches:
        an estimate that is in use stays as it is."""
    def reset(self) -> None:
        """Leaves a fault; the drive is stopped then."""

@final
class Trace:
    """What a `FluxEstimator` made of a record: arrays of the record's length."""

    @property
    def t(self) -> NDArray[np.float64]:
        """Time, s."""
    @property
    def psi_s(self) -> NDArray[np.complex128]:
        """Stator flux linkage, V·s, complex."""
    @property
    def psi_1(self) -> NDArray[np.complex128]:
        """Flux of the parallel path, V·s, complex."""
    @property
    def u_off(self) -> NDArray[np.complex128]:
        """Offset voltage, V, complex."""
    @property
    def u_hf(self) -> NDArray[np.complex128]:
        """Output of the noise compensator, V, complex."""
    @property
    def omega_s(self) -> NDArray[np.float64]:
        """Stator frequency, electrical rad/s."""
    @property
    def omega_m(self) -> NDArray[np.float64]:
        """Speed, mechanical rad/s."""
    @property
    def angle(self) -> NDArray[np.float64]:
        """Angle of psi_s, rad."""

@final
class FluxEstimator:
    """The stator flux estimator of Fig. 7 alone, with offset estimator and noise compensator, offline.

    Takes motor and inverter as `Drive` does, and its settings (those about the flux estimator matter),
    with one
    difference: `inverter_model` is off unless it is given. Without it `u_s` is the voltage at the
    machine's terminals
    and the resistance the motor's. With `inverter_model=True` `u_s` is what an ideal bridge would have
    applied
    (duties times dc link): threshold, dead time and `r_d` of the inverter are taken into account."""

    def __new__(
        cls, motor: Motor, inverter: Inverter, **settings: Unpack[DriveSettings]
    ) -> FluxEstimator: ...
    def run(
        self,
        u_s: NDArray[np.complex128],
        i_s: NDArray[np.complex128],
        omega_s: float | NDArray[np.float64] | None = None,
        R_s: float | NDArray[np.float64] | None = None,
        psi_s0: complex | None = None,
        u_dc: float | NDArray[np.float64] | None = None,
    ) -> Trace:
        """Estimates the flux over a record with one row for each control period of the inverter.

        Parameters
        ----------
        u_s
            Voltage in V, complex, shape (n,): `u_s[k]` was applied between samples k - 1 and k. At the
            terminals, or
            with `inverter_model=True` that of an ideal bridge.
        i_s
            Stator current in A, complex, shape (n,).
        omega_s
            Known stator frequency, electrical rad/s, a number or shape (n,); None: the estimated one.
        R_s
            Resistance in series with the stator flux in Ω, a number or shape (n,); None: the motor's,
            with
            `inverter_model=True` plus the inverter's r_d.
        psi_s0
            Flux at the first sample, V·s, complex; None: rated flux on the a-axis.
        u_dc
            dc-link voltage in V for the inverter model, a number or shape (n,); None: the inverter's
            rated one.

        Raises ValueError for lengths that differ and for samples that are not finite.
        """

@final
class RecordEstimator:
    """Estimators of a scheme over records whose rows are one control period of the inverter apart.

    Takes motor, inverter and settings as `Drive` does."""

    def __new__(
        cls,
        motor: Motor,
        inverter: Inverter,
        scheme: Scheme = "enhanced",
        **settings: Unpack[DriveSettings],
    ) -> RecordEstimator: ...
    def run(
        self,
        u_s: NDArray[np.complex128],
        i_s: NDArray[np.complex128],
        i_sum: NDArray[np.float64],
        u_dc: NDArray[np.float64],
        psi_ref: NDArray[np.float64],
        psi_s0: complex,
        deviation: float,
        omega_m: float,
        settled: bool = False,
        R_s: float | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Begins at the first row and runs over all; what was identified before stays.

        Parameters
        ----------
        u_s, i_s
            Voltage in V (mean over the interval that ends at the row) and current in A, complex, shape
            (n,).
        i_sum, u_dc, psi_ref
            Sum of the phase currents in A, dc-link voltage in V, flux reference in V·s, shape (n,).
        psi_s0
            Stator flux at the first row, V·s.
        deviation
            Standard deviation of each of its components, V·s; 0: a machine without flux.
        settled
            The flux is that of a direct current along the a-axis in a machine at rest.
        omega_m
            Speed at the first row, mechanical rad/s.
        R_s
            Resistance for the scheme "paper", Ω; None: that of the parameters.

        Returns the estimates after each row by name. Raises ValueError for lengths that differ and values
        that are not
        finite.
        """

@final
class PlantState:
    """The true state of a plant at the end of the last period. Stator coordinates."""

    def __new__(
        cls,
        psi_s: complex,
        psi_r: complex,
        i_s: complex,
        u_s: complex,
        t: float,
        omega_m: float,
        omega_s: float,
        theta_m: float,
        torque: float,
        load_torque: float,
        R_s: float,
        u_dc: float,
        omega_load: float,
    ) -> PlantState: ...
    @property
    def t(self) -> float:
        """Time, s."""
    @property
    def psi_s(self) -> complex:
        """Stator flux linkage, V·s."""
    @property
    def psi_r(self) -> complex:
        """Rotor flux linkage of the inverse-Γ circuit, V·s."""
    @property
    def i_s(self) -> complex:
        """Stator current, A."""
    @property
    def u_s(self) -> complex:
        """Terminal voltage, mean of the last period, V."""
    @property
    def omega_m(self) -> float:
        """Speed, mechanical rad/s."""
    @property
    def omega_s(self) -> float:
        """Speed of psi_s, mean of the last period, electrical rad/s."""
    @property
    def theta_m(self) -> float:
        """Shaft angle, not wrapped, mechanical rad."""
    @property
    def torque(self) -> float:
        """Air-gap torque, N·m."""
    @property
    def load_torque(self) -> float:
        """Load torque of the last period, N·m."""
    @property
    def R_s(self) -> float:
        """Stator resistance as it is now, without r_d, Ω."""
    @property
    def u_dc(self) -> float:
        """dc-link voltage, V."""
    @property
    def omega_load(self) -> float:
        """Speed of the load, mechanical rad/s: omega_m without an elastic coupling."""
    def __getnewargs__(self) -> tuple[complex, ...]: ...
    def __copy__(self) -> Self: ...
    def __deepcopy__(self, memo: dict[int, Any], /) -> Self: ...

@final
class Plant:
    """Induction machine, inverter, sensors and shaft, resolved at every switching edge.

    Parameters
    ----------
    motor, inverter
        The real machine and inverter. Without keywords: switching model, no friction, 12-bit converters
        over ±2.5 √2 I_N, no measurement error.
    **options
        See `stillflux.options.PlantOptions`.

    Raises ValueError for a value outside its range, TypeError for an unknown option.
    """

    def __new__(cls, motor: Motor, inverter: Inverter, **options: Unpack[PlantOptions]) -> Plant: ...
    def step(
        self,
        duty: Iterable[float],
        load_torque: float = 0.0,
        gates_on: bool = True,
        pulses: tuple[Sequence[float], Sequence[float], Sequence[float]] | None = None,
    ) -> tuple[NDArray[np.float64], float]:
        """Runs one PWM period and returns the reading at its end: i_abc in A, shape (3,), and u_dc in V.

        `duty` (three finite values, clamped to [0, 1]) acts in the *next* period, as from a modulator's
        preload register: the plant holds the one-period delay. `gates_on=False` blocks the bridge at once.
        `load_torque` in N·m, up to ten times the rated torque, opposes positive rotation and is active, as a
        crane's. `pulses`, of `Drive.pulses`, take the place of `duty`: with the option `shunt` the reading is
        that of the shunt at their two instants and at the end of the period, in A."""
    def step_voltage(self, u_s: complex, dt: float, load_torque: float = 0.0) -> None:
        """Applies the constant voltage `u_s` (complex, V, up to ten times the rated voltage) to the terminals
        for `dt` seconds, at most 100, past the bridge."""
    def sample(self) -> tuple[NDArray[np.float64], float]:
        """A reading now: i_abc in A, shape (3,), and u_dc in V. Every call draws fresh noise."""
    @property
    def state(self) -> PlantState:
        """The truth."""
    def set_state(self, psi_s: complex, psi_r: complex, omega_m: float) -> None:
        """Puts the machine into a state: stator and inverse-Γ rotor flux (complex, V·s), mechanical rad/s.

        Raises ValueError for another speed than the one that is imposed, and for a flux or a speed that the
        equations' longest step cannot follow."""
    R_s: float
    u_dc: float
    speed: float | None
    @property
    def encoder(self) -> int | None:
        """Position of the encoder (option `encoder_lines`) at the instant of the latest reading, counts, four
        a line; None without one."""
    @property
    def current_offset(self) -> tuple[float, float, float]:
        """Offsets of the current channels as last set, A; takes a complex space vector or three values."""
    @current_offset.setter
    def current_offset(self, value: complex | Iterable[float]) -> None: ...

@final
class Run:
    """A scenario being run, advanced in pieces with the GIL released.

    Raises ValueError or TypeError for what is wrong with the scenario."""

    def __new__(cls, scenario: Scenario) -> Run: ...
    def advance(self, periods: int) -> bool:
        """Runs at most `periods` further control periods; False when the run is complete."""
    @property
    def time(self) -> float:
        """Simulated time so far, s."""
    @property
    def status(self) -> Status:
        """Status of the drive."""
    def memory(self) -> dict[str, Any]:
        """What the drive would store now."""
    def record(self) -> dict[str, NDArray[Any]]:
        """The record so far: name to array, time as "t" in s."""

@final
class CommissioningCore:
    """A commissioning, one control period at a time."""

    def __new__(
        cls,
        plate: Nameplate,
        inverter: Inverter,
        shaft: str,
        arithmetic: str,
        only: str | None,
        current_sensors: int,
    ) -> CommissioningCore: ...
    def step(self, i_abc: Iterable[float], u_dc: float) -> NDArray[np.float64]:
        """One control period."""
    @property
    def gates_on(self) -> bool:
        """False: block the bridge."""
    @property
    def progress(self) -> float:
        """Part that is over, 0 to 1."""
    @property
    def stage(self) -> str:
        """Name of the procedure under way."""
    @property
    def status(self) -> str:
        """ "running", "done", or the fault with its cause and time."""
    @property
    def cause(self) -> str | None:
        """Cause of a fault, else None."""
    def abort(self) -> None:
        """Blocks the gates for good."""
    def found(self) -> dict[str, Any]:
        """What has been found so far."""

@final
class CommissioningRun:
    """A commissioning on a plant, advanced in pieces with the GIL released."""

    def __new__(
        cls,
        plate: Nameplate,
        inverter: Inverter,
        shaft: str,
        arithmetic: str,
        only: str | None,
        current_sensors: int,
        plant_motor: Motor,
        plant_inverter: Inverter,
        channels: tuple[int, int, int] | None,
        channel_factor: tuple[float, float, float] | None,
        options: dict[str, Any],
    ) -> CommissioningRun: ...
    def advance(self, periods: int) -> bool:
        """Runs at most `periods` further control periods; False when the commissioning is over."""
    @property
    def time(self) -> float:
        """Simulated time so far, s."""
    @property
    def progress(self) -> float:
        """Part that is over, 0 to 1."""
    @property
    def stage(self) -> str:
        """Name of the procedure under way."""
    @property
    def status(self) -> str:
        """ "running", "done", or the fault with its cause and time."""
    @property
    def cause(self) -> str | None:
        """Cause of a fault, else None."""
    @property
    def extremes(self) -> tuple[float, float]:
        """Largest phase current relative to the rated peak, and the largest angle of the shaft at
        standstill,
        electrical rad."""
    def found(self) -> dict[str, Any]:
        """What has been found so far."""
