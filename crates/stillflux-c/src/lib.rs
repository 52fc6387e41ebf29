//! The drive in C: what `stillflux.h` declares. Nothing of its own: every function hands over to the core.
//!
//! The comments of this file are those of the header.
#![cfg_attr(not(test), no_std)]
#![allow(non_camel_case_types, non_snake_case)]

use core::ffi::c_char;
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
#[cfg(not(test))]
use core::panic::PanicInfo;
use core::{ptr, slice};

use drive::config::{DriveParams, EncoderMode, EnhancedParams, LowConfidence, Scheme};
use drive::counts::{Converters, Counts, Layout, Resolution};
use drive::drive::{Fault, Status};
use drive::interrupt::CountsDrive;
use drive::page::{Page, Ready, WORDS};
use drive::params::{Inverter, Machine, ParamError, Saturation};
use drive::si::MemorySi;
use drive::telemetry::{SetPoint, Telemetry};

#[cfg(not(feature = "q"))]
type Arithmetic = f32;
#[cfg(feature = "q")]
type Arithmetic = drive::scalar::Q;

/// The call has done what its name says.
pub const STILLFLUX_OK: u32 = 0;
/// The parameter page is torn, of another arithmetic, of another choice of schemes, or of another version.
pub const STILLFLUX_ERROR_PAGE: u32 = 1;
/// The state has another size than the library's: the header belongs to another build.
pub const STILLFLUX_ERROR_SIZE: u32 = 2;
/// A parameter is outside its admissible range; `stillflux_error` says which.
pub const STILLFLUX_ERROR_PARAMETER: u32 = 3;
/// The state holds no drive: `stillflux_open` has not been called, or has failed.
pub const STILLFLUX_ERROR_CLOSED: u32 = 4;

/// Words of a parameter page.
pub const STILLFLUX_PAGE_WORDS: usize = 384;
const _: () = assert!(STILLFLUX_PAGE_WORDS == WORDS);

/// Gates off, waiting for a set point.
pub const STILLFLUX_STOPPED: u32 = 0;
/// Reading the zero of the current sensors, gates off.
pub const STILLFLUX_READING_OFFSET: u32 = 1;
/// Building up the flux.
pub const STILLFLUX_MAGNETISING: u32 = 2;
/// Under control.
pub const STILLFLUX_RUNNING: u32 = 3;
/// Gates off after a fault, until `stillflux_reset`.
pub const STILLFLUX_FAULTED: u32 = 4;

/// Set point: gates off.
pub const STILLFLUX_STOP: u32 = 0;
/// Set point: speed control, `value` is the mechanical speed in rad/s.
pub const STILLFLUX_SPEED: u32 = 1;
/// Set point: torque control, `value` is the torque in N m.
pub const STILLFLUX_TORQUE: u32 = 2;

/// Data register right-aligned (ALIGN = 0), no offset or one with SATEN: unsigned; oversampled results too.
pub const STILLFLUX_RIGHT: u32 = 0;
/// Data register left-aligned (ALIGN = 1), no offset or one with SATEN: unsigned.
pub const STILLFLUX_LEFT: u32 = 1;
/// Data register right-aligned, offset by hardware (OFFSETy_EN = 1, SATEN = 0, OFFSETPOS = 0 or 1): signed.
pub const STILLFLUX_RIGHT_OFFSET: u32 = 2;
/// Data register left-aligned, offset by hardware (OFFSETy_EN = 1, SATEN = 0, OFFSETPOS = 0): signed, one bit lower.
pub const STILLFLUX_LEFT_OFFSET: u32 = 3;

/// The published scheme.
pub const STILLFLUX_PAPER: u32 = 0;
/// The enhanced scheme.
pub const STILLFLUX_ENHANCED: u32 = 1;

/// Low confidence: nothing.
pub const STILLFLUX_LOW_CONFIDENCE_KEEP: u32 = 0;
/// Low confidence: torque limited in proportion to it.
pub const STILLFLUX_LOW_CONFIDENCE_LIMIT_TORQUE: u32 = 1;
/// Low confidence: a fault.
pub const STILLFLUX_LOW_CONFIDENCE_FAULT: u32 = 2;

/// The speed of the encoder is compared with the estimate, and nothing depends on it.
pub const STILLFLUX_ENCODER_COMPARE: u32 = 0;
/// The speed control follows the encoder as long as it is valid.
pub const STILLFLUX_ENCODER_CONTROL: u32 = 1;

/// The encoder is not read: the drive is sensorless.
pub const STILLFLUX_ENCODER_SILENT: u32 = 0;
/// Measured and estimated speed agree, or nothing has contradicted that yet.
pub const STILLFLUX_ENCODER_AGREES: u32 = 1;
/// The encoder is wrong: the drive is sensorless.
pub const STILLFLUX_ENCODER_APART: u32 = 2;
/// The shaft turns faster than the estimate near zero stator frequency: the field is lost, and the confidence zero.
pub const STILLFLUX_ENCODER_ESTIMATE_APART: u32 = 3;

/// A drive: state of known size, without pointers; it may be copied and moved. All zero is no drive, which blocks the
/// bridge.
#[repr(C, align(8))]
pub struct stillflux_drive {
    // First: with something before it more of its fields lie beyond the reach of one instruction.
    drive: MaybeUninit<CountsDrive<Arithmetic>>,
    open: u32,
}

/// `open` of a state that holds a drive: four equal bytes, which a comparison takes as its own constant.
const OPEN: u32 = 0x6F6F_6F6F;

impl stillflux_drive {
    #[inline(always)]
    fn get(&self) -> Option<&CountsDrive<Arithmetic>> {
        // SAFETY: `open` is set after the drive was written, by `stillflux_open` alone.
        (self.open == OPEN).then(|| unsafe { self.drive.assume_init_ref() })
    }
    #[inline(always)]
    fn get_mut(&mut self) -> Option<&mut CountsDrive<Arithmetic>> {
        // SAFETY: as in `get`; what `stillflux_open` writes is a drive, not the place of one.
        (self.open == OPEN).then(|| unsafe {
            let drive = self.drive.assume_init_mut();
            core::hint::assert_unchecked(drive.is_some());
            drive
        })
    }
}

/// One set of readings as fractions of full scale, n / 2^15.
#[repr(C)]
pub struct stillflux_counts {
    /// Phase currents, positive into the machine; INT16_MIN and INT16_MAX: the channel is saturated.
    pub i_abc: [i16; 3],
    /// dc-link voltage, 0 to INT16_MAX; INT16_MAX: the channel is saturated.
    pub u_dc: i16,
}

/// Converters of a drive.
#[repr(C)]
pub struct stillflux_converters {
    /// Layout of the data registers of the current channels: STILLFLUX_RIGHT to STILLFLUX_LEFT_OFFSET.
    pub current: u32,
    /// Bits of their results: 6, 8, 10 or 12, if oversampled 6 to 16; any other number reads as 12.
    pub current_bits: u32,
    /// Code of each current channel at zero current, nominally half of the range: 2048 of 12 bits.
    pub zero: [u16; 3],
    /// What the hardware subtracts from the codes of the current channels, 0 without an offset; negative with
    /// OFFSETPOS. A code as all others: OFFSETy at 12 bits, OFFSETy >> 2 of 10 bits, >> 4 of 8, >> 6 of 6.
    pub offset: [i16; 3],
    /// Layout of the data register of the dc-link channel: STILLFLUX_RIGHT or STILLFLUX_LEFT.
    pub u_dc: u32,
    /// Bits of its results.
    pub u_dc_bits: u32,
}

/// What a drive is to do.
#[repr(C)]
pub struct stillflux_set_point {
    /// STILLFLUX_STOP, STILLFLUX_SPEED or STILLFLUX_TORQUE; any other number is a stop.
    pub kind: u32,
    /// Mechanical speed in rad/s, or torque in N m.
    pub value: f32,
}

/// What the timer's preload registers take.
#[repr(C)]
pub struct stillflux_command {
    /// Compare values of the three legs, counts: 0 to `stillflux_timer_full`.
    pub compare: [u32; 3],
    /// 0: block the bridge at once. 1: gates on.
    pub gates_on: u32,
}

/// Pulses of the next period for a single shunt, which need not be centred, counts.
#[repr(C)]
pub struct stillflux_pulses {
    /// Compare values of the half period with the rising edges, 0 to `stillflux_timer_full`.
    pub rising: [u32; 3],
    /// Compare values of the half period with the falling edges.
    pub falling: [u32; 3],
    /// Counts in the half period with the falling edges at which the two samples have to be complete, ascending. A third
    /// one is taken at the end of the period. They are `i_abc` of the counts of the next call but one, in this order.
    pub sample: [u32; 2],
}

/// What the encoder says, SI.
#[repr(C)]
pub struct stillflux_encoder {
    /// Measured speed, mechanical rad/s.
    pub omega_m: f32,
    /// Measured less estimated speed, filtered, mechanical rad/s.
    pub difference: f32,
    /// STILLFLUX_ENCODER_SILENT to STILLFLUX_ENCODER_ESTIMATE_APART.
    pub state: u32,
}

/// A latched fault with what was measured, SI.
#[repr(C)]
pub struct stillflux_fault_report {
    /// Its code, STILLFLUX_FAULT_...
    pub code: u32,
    /// Control period in which it happened, since power-up.
    pub period: u32,
    /// What was measured: A, V, V s, mechanical rad/s or a number, by the cause; of a measurement or an open phase the number of the
    /// channel or phase, 1 to 3, 4 for the dc link.
    pub value: f32,
    /// The limit that it violated, in the same unit; 0 where there is none.
    pub limit: f32,
}

/// State and estimates, SI. While the bridge is blocked nothing is estimated: torque and currents are zero, speed, frequency and
/// flux stay those of the latest period before, whatever the shaft does.
#[repr(C)]
pub struct stillflux_telemetry {
    /// STILLFLUX_STOPPED to STILLFLUX_FAULTED.
    pub status: u32,
    /// Code of the fault (STILLFLUX_FAULT_...), 0 without one.
    pub fault: u32,
    /// Control periods since power-up (wraps).
    pub period: u32,
    /// Mechanical speed, rad/s.
    pub omega_m: f32,
    /// Stator frequency, electrical rad/s.
    pub omega_s: f32,
    /// Torque, N m.
    pub torque: f32,
    /// Stator flux linkage, magnitude, V s.
    pub psi_s: f32,
    /// Magnetising current, A peak.
    pub i_d: f32,
    /// Torque-producing current, A peak.
    pub i_q: f32,
    /// Stator resistance with that of the bridge, ohm.
    pub R_s: f32,
    /// Expected standard deviation of the field angle, rad; pi while the drive does not run.
    pub angle_deviation: f32,
    /// Confidence, 0 to 1.
    pub confidence: f32,
    /// Part of the gains of the speed controller that a swing has left, 1 without one: the shaft has about this part of the
    /// inertia told.
    pub speed_gain: f32,
}
const _: () = assert!(size_of::<stillflux_telemetry>() == size_of::<Telemetry>());

/// Induction machine: inverse-Gamma parameters and rating, SI.
#[repr(C)]
pub struct stillflux_machine {
    /// Stator resistance, ohm.
    pub R_s: f64,
    /// Rotor resistance of the inverse-Gamma circuit, ohm.
    pub R_R: f64,
    /// Leakage inductance, H.
    pub L_sigma: f64,
    /// Magnetising inductance of the inverse-Gamma circuit, H.
    pub L_M: f64,
    /// Pole pairs.
    pub n_p: u32,
    /// Moment of inertia of the whole shaft, kg m^2.
    pub J: f64,
    /// Rated line-to-line voltage, V rms.
    pub U_N: f64,
    /// Rated phase current, A rms.
    pub I_N: f64,
    /// Rated frequency, Hz.
    pub f_N: f64,
    /// Rated torque, N m.
    pub T_N: f64,
    /// Saturation of the Gamma-form stator inductance, L_s(psi) = L_u / (1 + (a psi)^S): L_u in H; 0: not known.
    pub L_u: f64,
    /// a, 1/(V s).
    pub a: f64,
    /// S.
    pub S: f64,
}

/// Two-level inverter, SI.
#[repr(C)]
pub struct stillflux_inverter {
    /// Rated dc-link voltage, V.
    pub u_dc: f64,
    /// Switching frequency, Hz.
    pub f_s: f64,
    /// Threshold voltage of switches and diodes, V.
    pub u_th: f64,
    /// Differential resistance of switches and diodes, ohm.
    pub r_d: f64,
    /// Dead time, s.
    pub dead_time: f64,
    /// Clock of the PWM timer, Hz; with f_s it gives the counts of a full duty, f_clk / (2 f_s). 0: the finest that compare values
    /// have, 4194304, for a host.
    pub f_clk: f64,
    /// Capacitance of one leg's node, F.
    pub c_out: f64,
    /// Half periods of the carrier in a control period: 2; 1 for an update at each of its extremes (feature `modes`);
    /// 4, 6 to 16.
    pub half_periods: u32,
    /// Time by which the pulse of each leg is longer than commanded, for a positive and for a negative current, s: from
    /// commissioning; zeros if unknown.
    pub leg_delay: [[f64; 2]; 3],
    /// Current sensors: 3, or 2 in phases a and b (feature `modes`), or 1, a single shunt in the dc link (feature `shunt`).
    pub current_sensors: u32,
    /// Current that a current channel reads as full scale, A: more than `i_range` of the settings by a thousandth, so that
    /// a saturated channel, which reads up to so much less, is a fault.
    pub i_full: f64,
    /// Voltage that the dc-link channel reads as full scale, V: more than `u_dc_max` by a thousandth.
    pub u_full: f64,
}

/// Settings of a drive, SI. `stillflux_defaults` fills them in.
#[repr(C)]
pub struct stillflux_settings {
    /// STILLFLUX_PAPER or STILLFLUX_ENHANCED.
    pub scheme: u32,
    /// Flux reference, relative to the rated flux.
    pub psi_ref: f64,
    /// Largest current reference, A peak.
    pub i_max: f64,
    /// Largest torque reference, N m.
    pub torque_max: f64,
    /// Largest mechanical speed reference, rad/s.
    pub omega_max: f64,
    /// Over-current trip level, A peak of the space vector.
    pub i_trip: f64,
    /// Full scale of the current sensors, A: a reading at or beyond it is a fault.
    pub i_range: f64,
    /// Smallest dc-link voltage, V; below 1/32 of the base voltage it is that.
    pub u_dc_min: f64,
    /// Largest dc-link voltage, V.
    pub u_dc_max: f64,
    /// dc-link voltage at which no braking torque is left, V (feature `dclink`); 0: braking is not limited.
    pub u_dc_brake: f64,
    /// dc-link voltage below which the machine feeds the link while it turns, V (feature `dclink`); 0: never.
    pub u_dc_buffer: f64,
    /// dc-link voltages at which the brake chopper begins and at which it is fully on, V (feature `dclink`); both 0: none.
    pub u_dc_chopper: [f64; 2],
    /// Bandwidth of current control, Hz.
    pub current_bandwidth: f64,
    /// Bandwidth of flux control, Hz.
    pub flux_bandwidth: f64,
    /// Bandwidth of speed control, Hz: 9, less where the inertia is large.
    pub speed_bandwidth: f64,
    /// Part of a change of the speed reference that speed control answers at once, 0 to 1; the rest follows with the time constant of its
    /// integral part. 0.3: a step does not overshoot.
    pub set_point_weight: f64,
    /// Natural frequency of the speed estimator, Hz: 25, more where the shaft is light.
    pub pll_bandwidth: f64,
    /// Duration of the reading of the sensors' zero, s.
    pub offset_time: f64,
    /// Duration of the magnetisation, s.
    pub magnetise_time: f64,
    /// Time for which a state that a single shunt is sampled in lasts, s: dead time, settling, sampling. Without effect with
    /// more sensors.
    pub shunt_window: f64,
    /// Time constant of the shunt's amplifier, s; 0: none.
    pub shunt_settling: f64,
    /// 0: the flux is not lowered where the voltage is used up, and the speed ends there. 1: field weakening.
    pub field_weakening: u32,
    /// 1: use the voltage between the circle within the hexagon and the hexagon, 5.2 % more. 0: do not.
    pub overmodulation: u32,
    /// Discontinuous modulation from this part of u_dc/sqrt(3) on, 0.3 to 1 (feature `modes`); 0: never.
    pub discontinuous_above: f64,
    /// Largest acceleration of the speed reference, mechanical rad/s^2; 0: no limit.
    pub acceleration: f64,
    /// Largest jerk of the speed reference, mechanical rad/s^3, with an acceleration; 0: no limit.
    pub jerk: f64,
    /// Negative and positive limit of the torque reference, N m, within torque_max; both 0: no torque. Infinite, the
    /// default: that of torque_max.
    pub torque_limits: [f64; 2],
    /// Negative and positive limit of the mechanical speed reference, rad/s, within omega_max; both 0: no speed.
    /// Infinite, the default: that of omega_max.
    pub speed_limits: [f64; 2],
    /// Continuous current of the machine, A rms, and the time constant of its heat, s; both 0: no derating. Heat
    /// is counted while the drive runs, not while it magnetises.
    pub machine_overload: [f64; 2],
    /// The same of the bridge.
    pub bridge_overload: [f64; 2],
    /// While the confidence is low: STILLFLUX_LOW_CONFIDENCE_KEEP, ..._LIMIT_TORQUE or ..._FAULT.
    pub low_confidence: u32,
    /// Time after a stop within which a start is as short as the current allows, s; 0: never.
    pub fresh_time: f64,
    /// 1: monitors of phases, current channels, stall and lost field (feature `supervision`). 0: off, for tests of the bridge
    /// without a machine.
    pub supervision: u32,
    /// Time at the torque limit at low speed that is a stall, s; 0: any (feature `supervision`).
    pub stall_time: f64,
    /// 1: the flux is taken to lie along the current where the torque is at its limit and the field stands still, also at
    /// half of the torque (feature `supervision`).
    pub realignment: u32,
    /// 1: the gains of the speed controller are reduced until the next start where the speed swings between the limits of the
    /// torque, as with a shaft that is far lighter than told (feature `supervision`).
    pub reduce_gain: u32,
    /// Stator frequency that is kept under load, electrical rad/s: where it would be smaller the flux is lowered; 0: it is not
    /// (enhanced scheme).
    pub omega_s_min: f64,
    /// Amplitude of an oscillation of the torque near zero stator frequency in parts of rated torque, 0 to 0.3; 0: none (enhanced
    /// scheme, feature `dither`).
    pub dither: f64,
    /// Lines of an encoder on the shaft, a quarter of the steps of a resolver; 0: none (feature `encoder`).
    pub encoder_lines: u32,
    /// States of its counter: 65536 of one of 16 bits.
    pub encoder_states: u32,
    /// STILLFLUX_ENCODER_COMPARE or STILLFLUX_ENCODER_CONTROL.
    pub encoder_mode: u32,
    /// Difference from which on measured and estimated speed do not agree, mechanical rad/s.
    pub encoder_deviation: f64,
    /// 1: an encoder that does not agree, or is not read, stops the drive. 0: the drive is sensorless then.
    pub encoder_fault: u32,
    /// 1: the rotor resistance follows the temperature of the winding (enhanced scheme). 0: it does not.
    pub temperature: u32,
    /// Temperature of the winding that R_s and R_R hold for, degrees Celsius.
    pub winding_temperature: f64,
    /// Constant of the cage's material, K: 225 for aluminium, 235 for copper.
    pub cage_constant: f64,
    /// Rise of the rotor's temperature over that of the winding's.
    pub rotor_rise: f64,
    /// Rise of the winding's temperature at rated current, K, and its time constant, s; both 0: not known.
    pub winding_heat: [f64; 2],
}

/// What a drive remembers over a stop, SI. `stillflux_memory_of` fills it in for a drive that has not run; one that is all zero
/// is refused.
#[repr(C)]
pub struct stillflux_memory {
    /// Offset voltage, V: real and imaginary part.
    pub u_off: [f64; 2],
    /// Stator resistance with that of the bridge, ohm.
    pub R_s: f64,
    /// Zero of the current channels, A.
    pub i_off: [f64; 3],
    /// Error of the inverter model, relative.
    pub loss_error: f64,
    /// Knee of the inverter model, relative to that of the parameters.
    pub knee: f64,
    /// Leakage inductance, H.
    pub L_sigma: f64,
    /// Magnetising inductance, H.
    pub L_M: f64,
    /// Time by which the pulse of each leg is longer than commanded, for a positive and for a negative current, s.
    pub leg_delay: [[f64; 2]; 3],
}

/// A parameter outside its admissible range.
#[repr(C)]
pub struct stillflux_error {
    /// Name of the field, terminated by a zero.
    pub field: [c_char; 32],
    /// The value given.
    pub value: f64,
    /// Smallest admissible value; above `max` where no value is admissible, and `note` says what is missing.
    pub min: f64,
    /// Largest admissible value.
    pub max: f64,
    /// Unit of all three, UTF-8, terminated by a zero; empty for a number.
    pub unit: [c_char; 16],
    /// What else explains the range, UTF-8, terminated by a zero; may be empty.
    pub note: [c_char; 128],
}

/// Reads a parameter page and puts a stopped drive into `drive`.
///
/// `bytes` is `sizeof *drive`. Returns STILLFLUX_OK, STILLFLUX_ERROR_PAGE or STILLFLUX_ERROR_SIZE. After
/// STILLFLUX_ERROR_PAGE the state holds no drive, and blocks the bridge; with a size that is not that of the library's state
/// nothing is written. Takes no double precision and no memory but
/// `drive`. Not to be called while the control interrupt may run with the same state.
///
/// # Safety
/// `drive` is aligned to 8 bytes; `page` has STILLFLUX_PAGE_WORDS words, aligned to 4 bytes; both are not null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn stillflux_open(drive: *mut stillflux_drive, bytes: usize, page: *const u32) -> u32 {
    if bytes != size_of::<stillflux_drive>() {
        return STILLFLUX_ERROR_SIZE;
    }
    // SAFETY: the caller's promise; no reference to memory that holds no drive yet.
    unsafe {
        (&raw mut (*drive).open).write(0);
        let words = ptr::read(page.cast::<[u32; WORDS]>());
        let Some(ready) = Page::new(words).open::<Arithmetic>() else { return STILLFLUX_ERROR_PAGE };
        (&raw mut (*drive).drive).cast::<CountsDrive<Arithmetic>>().write(CountsDrive::new(&ready));
        (&raw mut (*drive).open).write(OPEN);
    }
    STILLFLUX_OK
}

/// One control period: the content of the control interrupt.
///
/// `counts` are the readings at the start of the period, `set_point` what the drive is to do, SI; `command` takes the
/// compare values of the next period and whether the gates are on. A state without a drive blocks the bridge. Never
/// fails, allocates, waits or divides by software.
// Not inlined where it is called here: so the period of the core has one caller, which takes it in.
#[unsafe(no_mangle)]
#[inline(never)]
pub extern "C" fn stillflux_period(
    drive: &mut stillflux_drive,
    counts: &stillflux_counts,
    set_point: &stillflux_set_point,
    command: &mut stillflux_command,
) {
    let Some(drive) = drive.get_mut() else {
        (command.compare, command.gates_on) = ([0; 3], 0);
        return;
    };
    let out = drive.period(&counts_of(counts), &set_point_of(set_point));
    command.compare = out.compare;
    command.gates_on = u32::from(out.gates_on);
}

/// stillflux_period() with the stamp of the PWM period, a number that the hardware counts up by one in each, 0 to
/// 65535, then 0 again: calls that are missed or come twice are a fault if there are too many of them (feature
/// `supervision`; without it the stamp has no effect).
///
/// Returns 1, and 0 for a period that has been computed before: `command` is untouched then, and what was commanded stays.
/// A stop and a fault are commanded with any stamp.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_period_at(
    drive: &mut stillflux_drive,
    stamp: u16,
    counts: &stillflux_counts,
    set_point: &stillflux_set_point,
    command: &mut stillflux_command,
) -> u32 {
    #[cfg(feature = "supervision")]
    if let Some(drive) = drive.get_mut() {
        let Some(out) = drive.period_at(stamp, &counts_of(counts), &set_point_of(set_point)) else { return 0 };
        (command.compare, command.gates_on) = (out.compare, u32::from(out.gates_on));
        return 1;
    }
    let _ = stamp;
    stillflux_period(drive, counts, set_point, command);
    1
}

#[inline(always)]
fn counts_of(counts: &stillflux_counts) -> Counts {
    Counts { i_abc: counts.i_abc, u_dc: counts.u_dc }
}

#[inline(always)]
fn set_point_of(set_point: &stillflux_set_point) -> SetPoint {
    let stillflux_set_point { kind, value } = *set_point;
    let kind = if kind <= STILLFLUX_TORQUE { kind } else { STILLFLUX_STOP };
    // SAFETY: both are a number of 32 bits, which is that of a variant, and a value.
    unsafe { core::mem::transmute::<stillflux_set_point, SetPoint>(stillflux_set_point { kind, value }) }
}

/// Readings from the content of the converters' data registers (STM32: JDRy). A channel at an end of its range reads
/// full scale, which is a fault of the drive.
///
/// `i_abc` are the three current registers, `u_dc` that of the dc link.
///
/// # Safety
/// `i_abc` has three elements; no pointer is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn stillflux_counts_from_raw(
    i_abc: *const u16,
    u_dc: u16,
    converters: &stillflux_converters,
    counts: &mut stillflux_counts,
) {
    let c = converters;
    let layouts = Converters {
        current: layout(c.current, c.current_bits),
        zero: c.zero,
        offset: c.offset,
        u_dc: layout(c.u_dc, c.u_dc_bits),
    };
    // SAFETY: the caller's promise.
    let i_abc = unsafe { ptr::read(i_abc.cast::<[u16; 3]>()) };
    let read = Counts::from_raw(i_abc, u_dc, &layouts);
    (counts.i_abc, counts.u_dc) = (read.i_abc, read.u_dc);
}

fn layout(layout: u32, bits: u32) -> Layout {
    let bits = Resolution::of(bits).unwrap_or(Resolution::Twelve);
    match layout {
        STILLFLUX_LEFT => Layout::Left(bits),
        STILLFLUX_RIGHT_OFFSET => Layout::RightOffset(bits),
        STILLFLUX_LEFT_OFFSET => Layout::LeftOffset(bits),
        _ => Layout::Right(bits),
    }
}

/// Pulses of the next period with a single shunt, after `stillflux_period`, in place of the compare values there.
///
/// Returns 1, or 0 with more sensors, without a drive, or in a library without the feature `shunt`: `pulses` is untouched
/// then.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_pulses_read(drive: &stillflux_drive, pulses: &mut stillflux_pulses) -> u32 {
    #[cfg(feature = "shunt")]
    if let Some(p) = drive.get().and_then(CountsDrive::pulses) {
        *pulses = stillflux_pulses { rising: p.rising, falling: p.falling, sample: p.sample };
        return 1;
    }
    let _ = (drive, pulses);
    0
}

/// Compare value of the brake chopper's channel at the link voltage of these readings, counts, 0 to
/// `stillflux_timer_full`, in every state of the drive, also while the bridge is blocked. 0 without a drive, without the
/// setting `u_dc_chopper`, or in a library without the feature `dclink`.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_chopper(drive: &stillflux_drive, counts: &stillflux_counts) -> u32 {
    #[cfg(feature = "dclink")]
    if let Some(drive) = drive.get() {
        return drive.chopper(&counts_of(counts));
    }
    let _ = (drive, counts);
    0
}

/// Content of the encoder's counter at the instant of the readings of the next period, below `encoder_states`: once a
/// period, before `stillflux_period`. Without effect in a library without the feature `encoder`.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_encoder_set(drive: &mut stillflux_drive, count: u32) {
    #[cfg(feature = "encoder")]
    if let Some(drive) = drive.get_mut() {
        drive.set_encoder(count);
    }
    let _ = (drive, count);
}

/// What the encoder says.
///
/// Returns 1, or 0 without an encoder, without a drive, or in a library without the feature `encoder`: `encoder` is
/// untouched then.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_encoder_read(drive: &stillflux_drive, encoder: &mut stillflux_encoder) -> u32 {
    #[cfg(feature = "encoder")]
    if let Some(e) = drive.get().and_then(CountsDrive::encoder) {
        *encoder = stillflux_encoder { omega_m: e.omega_m, difference: e.difference, state: e.state };
        return 1;
    }
    let _ = (drive, encoder);
    0
}

/// State of the sequence: STILLFLUX_STOPPED to STILLFLUX_FAULTED.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_status(drive: &stillflux_drive) -> u32 {
    drive.get().map_or(STILLFLUX_STOPPED, |d| d.status().code())
}

/// Code of the fault (STILLFLUX_FAULT_...), 0 without one.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_fault(drive: &stillflux_drive) -> u32 {
    match drive.get().map(CountsDrive::status) {
        Some(Status::Faulted { cause, .. }) => cause.code(),
        _ => 0,
    }
}

/// The latched fault with what was measured.
///
/// Returns 1, or 0 without a fault or without a drive: `report` is untouched then.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_fault_read(drive: &stillflux_drive, report: &mut stillflux_fault_report) -> u32 {
    let Some(f) = drive.get().and_then(CountsDrive::fault) else { return 0 };
    *report = stillflux_fault_report { code: f.cause.code(), period: f.period, value: f.value, limit: f.limit };
    1
}

/// Text of a fault's code in English, as much of it as `text` takes, terminated by a zero; "none" for a code without a
/// fault. `size` is that of `text` in bytes; with 0 nothing is written.
///
/// # Safety
/// `text` has `size` bytes; with a `size` of 0 it may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn stillflux_fault_text(code: u32, text: *mut c_char, size: usize) {
    if size == 0 {
        return;
    }
    // SAFETY: the caller's promise.
    let text = unsafe { slice::from_raw_parts_mut(text.cast::<u8>(), size) };
    let mut to = Text(text.iter_mut());
    // What does not fit is left out.
    let _ = match Fault::ALL.iter().find(|f| f.code() == code) {
        Some(fault) => write!(to, "{fault}"),
        None => to.write_str("none"),
    };
    if let Some(end) = to.0.next() {
        *end = 0;
    }
}

/// Text that leaves room for the zero at its end.
struct Text<'a>(slice::IterMut<'a, u8>);

impl Write for Text<'_> {
    fn write_str(&mut self, s: &str) -> fmt::Result {
        for letter in s.bytes() {
            if self.0.len() > 1
                && let Some(to) = self.0.next()
            {
                *to = letter;
            }
        }
        Ok(())
    }
}

/// Leaves a fault; the drive is stopped then, and starts with the next set point that is no stop.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_reset(drive: &mut stillflux_drive) {
    if let Some(drive) = drive.get_mut() {
        drive.reset();
    }
}

/// Counts of a full duty, from carrier valley to peak: the reload value of a centre-aligned timer. 0 without a drive.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_timer_full(drive: &stillflux_drive) -> u32 {
    drive.get().and_then(CountsDrive::timer).map_or(0, drive::scalar::Timer::full)
}

/// State and estimates of the latest period in SI, in single precision. All zero without a drive.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_telemetry_read(drive: &stillflux_drive, telemetry: &mut stillflux_telemetry) {
    let Telemetry {
        status,
        fault,
        period,
        omega_m,
        omega_s,
        torque,
        psi_s,
        i_d,
        i_q,
        R_s,
        angle_deviation,
        confidence,
        speed_gain,
        ..
    } = drive.get().map_or(Telemetry::default(), CountsDrive::telemetry);
    *telemetry = stillflux_telemetry {
        status,
        fault,
        period,
        omega_m,
        omega_s,
        torque,
        psi_s,
        i_d,
        i_q,
        R_s,
        angle_deviation,
        confidence,
        speed_gain,
    };
}

/// Writes a parameter page with what the drive has learned, to be kept over a loss of supply: `page` is the one it was
/// opened with, `to` takes the same parameters with what is in `stillflux_memory` as it is now: offsets, resistance,
/// error and knee of the inverter model, inductances, delays of the legs.
///
/// Returns STILLFLUX_OK, STILLFLUX_ERROR_PAGE or STILLFLUX_ERROR_CLOSED. To be called after a stop.
///
/// # Safety
/// `page` and `to` have STILLFLUX_PAGE_WORDS words, aligned to 4 bytes, and may be the same; none is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn stillflux_store(drive: &stillflux_drive, page: *const u32, to: *mut u32) -> u32 {
    let Some(drive) = drive.get().and_then(CountsDrive::drive) else { return STILLFLUX_ERROR_CLOSED };
    // SAFETY: the caller's promise.
    let words = unsafe { ptr::read(page.cast::<[u32; WORDS]>()) };
    let Some(stored) = Page::new(words).with_memory::<Arithmetic>(&drive.memory()) else { return STILLFLUX_ERROR_PAGE };
    // SAFETY: the caller's promise.
    unsafe { ptr::write(to.cast::<[u32; WORDS]>(), *stored.words()) };
    STILLFLUX_OK
}

/// Default settings for a machine on an inverter. Computes in double precision: for a host, or for commissioning.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_defaults(
    machine: &stillflux_machine,
    inverter: &stillflux_inverter,
    settings: &mut stillflux_settings,
) {
    *settings = settings_of(&DriveParams::new(&machine_of(machine), &inverter_of(inverter)));
}

/// What a drive that has not run yet remembers: the parameters.
#[unsafe(no_mangle)]
pub extern "C" fn stillflux_memory_of(
    machine: &stillflux_machine,
    inverter: &stillflux_inverter,
    memory: &mut stillflux_memory,
) {
    let m = MemorySi::of(&machine_of(machine), &inverter_of(inverter));
    *memory = stillflux_memory {
        u_off: m.u_off,
        R_s: m.R_s,
        i_off: m.i_off,
        loss_error: m.loss_error,
        knee: m.knee,
        L_sigma: m.L_sigma,
        L_M: m.L_M,
        leg_delay: m.leg_delay,
    };
}

/// Writes the parameter page of a drive: validated, with every division done. Computes in double precision: for a host,
/// or for commissioning.
///
/// Returns STILLFLUX_OK, or STILLFLUX_ERROR_PARAMETER and in `error` the parameter, the value given and its admissible
/// range; `page` is untouched then.
///
/// # Safety
/// `page` has STILLFLUX_PAGE_WORDS words, aligned to 4 bytes; no pointer is null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn stillflux_page(
    machine: &stillflux_machine,
    inverter: &stillflux_inverter,
    settings: &stillflux_settings,
    memory: &stillflux_memory,
    page: *mut u32,
    error: &mut stillflux_error,
) -> u32 {
    let (m, i) = (machine_of(machine), inverter_of(inverter));
    let &stillflux_memory { u_off, R_s, i_off, loss_error, knee, L_sigma, L_M, leg_delay } = memory;
    let memory = MemorySi { u_off, R_s, i_off, loss_error, knee, L_sigma, L_M, leg_delay };
    let defaults = DriveParams { current_sensors: inverter.current_sensors, ..DriveParams::new(&m, &i) };
    let ready = params_of(settings, defaults)
        .and_then(|params| Ready::<Arithmetic>::new(&m, &i, &params, (inverter.i_full, inverter.u_full), &memory));
    match ready {
        Ok(ready) => {
            // SAFETY: the caller's promise. What `page` holds so far need not be initialised.
            unsafe { ptr::write(page.cast::<[u32; WORDS]>(), *Page::seal(&ready).words()) };
            STILLFLUX_OK
        }
        Err(e) => {
            *error = error_of(&e);
            STILLFLUX_ERROR_PARAMETER
        }
    }
}

fn error_of(e: &ParamError) -> stillflux_error {
    let &ParamError { field, value, min, max, unit, note } = e;
    stillflux_error { field: text(field), value, min, max, unit: text(unit), note: text(note) }
}

/// A text as C has it, cut to its length at the end of a character.
fn text<const N: usize>(of: &str) -> [c_char; N] {
    let mut to = [0; N];
    let letters = of.char_indices().take_while(|(k, letter)| k + letter.len_utf8() < N);
    let length = letters.last().map_or(0, |(k, letter)| k + letter.len_utf8());
    for (to, letter) in to.iter_mut().zip(of.bytes().take(length)) {
        *to = letter as c_char;
    }
    to
}

/// Settings of C and of the core, one of the other: each field stands once, and one that is in no list does not
/// compile.
macro_rules! settings {
    (same: $($same:ident),*; enhanced: $($enhanced:ident),*; number: $($number:ident of $numbers:ident),*;
        limits: $($limits:ident within $most:ident),*) => {
        fn settings_of(d: &DriveParams) -> stillflux_settings {
            stillflux_settings {
                $($same: d.$same.to_c(),)*
                $($enhanced: d.enhanced.$enhanced.to_c(),)*
                $($number: number_of(&$numbers, d.$number),)*
                $($limits: d.$limits.map_or([f64::NEG_INFINITY, f64::INFINITY], |(a, b)| [a, b]),)*
                temperature: u32::from(d.enhanced.winding_temperature.is_some()),
                winding_temperature: d.enhanced.winding_temperature.unwrap_or(0.0),
            }
        }

        fn params_of(s: &stillflux_settings, d: DriveParams) -> Result<DriveParams, ParamError> {
            Ok(DriveParams {
                $($same: InC::from_c(s.$same),)*
                $($number: named_by(stringify!($number), &$numbers, s.$number)?,)*
                $($limits: Some(limits_of(s.$limits, s.$most)),)*
                enhanced: EnhancedParams {
                    $($enhanced: InC::from_c(s.$enhanced),)*
                    winding_temperature: (s.temperature != 0).then_some(s.winding_temperature),
                    ..d.enhanced
                },
                ..d
            })
        }
    };
}
settings! {
    same: psi_ref, i_max, torque_max, omega_max, i_trip, i_range, u_dc_min, u_dc_max, u_dc_brake, u_dc_buffer,
        u_dc_chopper, current_bandwidth, flux_bandwidth, speed_bandwidth, set_point_weight, pll_bandwidth,
        offset_time, magnetise_time, shunt_window, shunt_settling, field_weakening, overmodulation,
        discontinuous_above, acceleration, jerk, machine_overload, bridge_overload, fresh_time, supervision,
        stall_time, realignment, reduce_gain, encoder_lines, encoder_states, encoder_deviation, encoder_fault;
    enhanced: omega_s_min, dither, cage_constant, rotor_rise, winding_heat;
    number: scheme of SCHEMES, low_confidence of REACTIONS, encoder_mode of ENCODER_MODES;
    limits: torque_limits within torque_max, speed_limits within omega_max
}

const SCHEMES: [(u32, Scheme); 2] = [(STILLFLUX_PAPER, Scheme::Paper), (STILLFLUX_ENHANCED, Scheme::Enhanced)];
const REACTIONS: [(u32, LowConfidence); 3] = [
    (STILLFLUX_LOW_CONFIDENCE_KEEP, LowConfidence::Keep),
    (STILLFLUX_LOW_CONFIDENCE_LIMIT_TORQUE, LowConfidence::LimitTorque),
    (STILLFLUX_LOW_CONFIDENCE_FAULT, LowConfidence::Fault),
];
const ENCODER_MODES: [(u32, EncoderMode); 2] =
    [(STILLFLUX_ENCODER_COMPARE, EncoderMode::Compare), (STILLFLUX_ENCODER_CONTROL, EncoderMode::Control)];

/// A setting as C has it.
trait InC<C> {
    fn to_c(self) -> C;
    fn from_c(c: C) -> Self;
}

impl<T> InC<T> for T {
    fn to_c(self) -> T {
        self
    }
    fn from_c(c: T) -> Self {
        c
    }
}

impl InC<u32> for bool {
    fn to_c(self) -> u32 {
        u32::from(self)
    }
    fn from_c(c: u32) -> Self {
        c != 0
    }
}

/// Zero is none.
impl InC<f64> for Option<f64> {
    fn to_c(self) -> f64 {
        self.unwrap_or(0.0)
    }
    fn from_c(c: f64) -> Self {
        (c != 0.0).then_some(c)
    }
}

/// Both zero is none.
impl InC<[f64; 2]> for Option<(f64, f64)> {
    fn to_c(self) -> [f64; 2] {
        self.map_or([0.0; 2], |(a, b)| [a, b])
    }
    fn from_c(c: [f64; 2]) -> Self {
        (c != [0.0; 2]).then_some((c[0], c[1]))
    }
}

/// Limits by direction; an infinite one is that of both directions.
fn limits_of([least, most]: [f64; 2], of_both: f64) -> (f64, f64) {
    (if least == f64::NEG_INFINITY { -of_both } else { least }, if most == f64::INFINITY { of_both } else { most })
}

fn number_of<T: Copy + PartialEq>(named: &[(u32, T)], value: T) -> u32 {
    named.iter().find(|(_, of)| *of == value).map_or(0, |(number, _)| *number)
}

/// # Errors
/// A number that names nothing.
fn named_by<T: Copy>(field: &'static str, named: &[(u32, T)], number: u32) -> Result<T, ParamError> {
    let known = named.iter().find(|(of, _)| *of == number).map(|(_, value)| *value);
    let max = named.len().saturating_sub(1) as f64;
    known.ok_or(ParamError { field, value: f64::from(number), min: 0.0, max, unit: "", note: "" })
}

fn machine_of(m: &stillflux_machine) -> Machine {
    let &stillflux_machine { R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N, L_u, a, S } = m;
    let saturation = (L_u != 0.0).then_some(Saturation { L_u, a, S });
    Machine { R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N, saturation }
}

fn inverter_of(i: &stillflux_inverter) -> Inverter {
    let &stillflux_inverter { u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out, half_periods, leg_delay, .. } = i;
    Inverter { u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out, half_periods, leg_delay }
}

/// Unreachable from every function of the header.
#[cfg(not(test))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

#[cfg(test)]
mod tests;
