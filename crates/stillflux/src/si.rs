//! The SI boundary: measurements, references, estimates and memory between SI and per unit ([`SiUnits`]), and a drive
//! of any arithmetic behind one type ([`SiDrive`]).
//!
//! ```text
//! x_pu = x_SI/x_b        x_b: bases of the rated machine, [`crate::base`]
//! ```
//!
//! A NaN measurement becomes full scale in fixed point, which is a measurement fault; values beyond the range of fixed
//! point saturate. The conversions compute in double precision and round once: they are for hosts and for firmware
//! outside the control interrupt.

use crate::base::Base;
use crate::config::{DriveConfig, DriveParams};
#[cfg(feature = "shunt")]
use crate::control::shunt::Pulses;
#[cfg(feature = "encoder")]
use crate::drive::EncoderState;
use crate::drive::{Drive, Estimate, Fault, FaultReport, Measurement, Memory, Quantity, Reference, Status};
use crate::estimate::kalman;
#[cfg(feature = "legs")]
use crate::inverter::Legs;
use crate::params::{Inverter, Machine, ParamError, check};
use crate::scalar::{Q, Real};
use crate::space::{AlphaBeta, Space};

/// Arithmetic a drive computes in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arithmetic {
    /// Single precision.
    #[default]
    F32,
    /// Double precision.
    F64,
    /// Fixed point Q7.24.
    Q,
}

/// A space vector, real and imaginary part.
pub type Vector = [f64; 2];

/// What a drive measures at the start of a period, SI.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MeasurementSi {
    /// Phase currents, positive into the machine, A.
    pub i_abc: [f64; 3],
    /// dc-link voltage, V.
    pub u_dc: f64,
}

/// What a drive is to do, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ReferenceSi {
    /// Gates off.
    Stop,
    /// Mechanical speed, rad/s.
    Speed(f64),
    /// Torque, N·m.
    Torque(f64),
}

/// Everything a drive estimates, SI; stator coordinates unless named `dq`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[allow(non_snake_case)]
#[non_exhaustive]
pub struct EstimateSi {
    /// Stator flux linkage, V·s.
    pub psi_s: Vector,
    /// Rotor flux linkage (inverse-Γ), V·s.
    pub psi_r: Vector,
    /// Flux of the parallel path, V·s.
    pub psi_1: Vector,
    /// Stator current, A.
    pub i_s: Vector,
    /// Voltage applied between the last two samples, V.
    pub u_s: Vector,
    /// Induced voltage, V.
    pub u_i: Vector,
    /// Offset voltage, V.
    pub u_off: Vector,
    /// Output of the noise compensator, V.
    pub u_hf: Vector,
    /// Current in field coordinates, A.
    pub i_dq: Vector,
    /// Its reference, A.
    pub i_dq_ref: Vector,
    /// Flux reference, V·s.
    pub psi_ref: f64,
    /// Mechanical speed, rad/s.
    pub omega_m: f64,
    /// Stator frequency, electrical rad/s.
    pub omega_s: f64,
    /// Slip frequency, electrical rad/s.
    pub omega_r: f64,
    /// Torque, N·m.
    pub torque: f64,
    /// Stator resistance with `r_d`, Ω.
    pub R_s: f64,
    /// Rotor resistance of the inverse-Γ circuit, Ω ([`crate::drive::Estimate::r_r`]).
    pub R_R: f64,
    /// Residual ε of (15), per unit; zero in the enhanced scheme.
    pub epsilon: f64,
    /// Innovation of the filter, rotor flux of the current model less that of the voltage model, V·s; zero in the
    /// published scheme.
    pub innovation: f64,
    /// Normalised innovation squared, low-passed ([`crate::drive::Estimate::nis`]); zero in the published scheme.
    pub nis: f64,
    /// Expected standard deviation of the field angle, rad; π while the drive does not run.
    pub angle_deviation: f64,
    /// Confidence, 0 to 1.
    pub confidence: f64,
    /// Part of the gains of the speed controller that a swing has left ([`crate::drive::Estimate::speed_gain`]).
    pub speed_gain: f64,
}

/// What the encoder of a drive says, SI ([`crate::drive::EncoderReading`]).
#[cfg(feature = "encoder")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct EncoderSi {
    /// Measured speed, mechanical rad/s.
    pub omega_m: f64,
    /// Measured less estimated speed, filtered, mechanical rad/s.
    pub difference: f64,
    /// Whether the two agree, and which of them is wrong otherwise.
    pub state: EncoderState,
}

/// What a drive stores at a stop, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[allow(non_snake_case)]
pub struct MemorySi {
    /// Offset voltage, V.
    pub u_off: Vector,
    /// Stator resistance with `r_d`, Ω.
    pub R_s: f64,
    /// Offsets of the current channels, A.
    pub i_off: [f64; 3],
    /// Error of the inverter model's voltage, relative; 0 in the published scheme.
    pub loss_error: f64,
    /// Knee of the inverter model, relative to that of the parameters; 1 in the published scheme.
    pub knee: f64,
    /// Leakage inductance, H; the parameter in the published scheme.
    pub L_sigma: f64,
    /// Magnetising inductance, H; the parameter in the published scheme.
    pub L_M: f64,
    /// Time by which the pulse of each leg is longer than commanded, for a positive and for a negative current, s, less
    /// what is common to the legs; zero in the published scheme.
    pub leg_delay: [[f64; 2]; 3],
}

impl MemorySi {
    /// What a drive that has not run yet remembers: the parameters.
    #[must_use]
    pub fn of(machine: &Machine, inverter: &Inverter) -> Self {
        let r_s = machine.R_s + inverter.r_d;
        let (Machine { L_sigma, L_M, .. }, leg_delay) = (*machine, inverter.leg_delay);
        Self { u_off: [0.0; 2], R_s: r_s, i_off: [0.0; 3], loss_error: 0.0, knee: 1.0, L_sigma, L_M, leg_delay }
    }

    /// Checks that every value is a finite number, the knee positive, and resistance and inductances within the limits that a
    /// drive of this machine and inverter keeps. What is beyond the limits of the others is limited as the drive takes it back.
    ///
    /// # Errors
    /// The first value that is not.
    pub fn validate(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let &Self { u_off, R_s, i_off, loss_error, knee, L_sigma, L_M, leg_delay } = self;
        let any =
            [("memory loss_error", loss_error, ""), ("memory u_off", u_off[0], "V"), ("memory u_off", u_off[1], "V")];
        let any = any.into_iter().chain(i_off.map(|i| ("memory i_off", i, "A")));
        for (name, x, unit) in any.chain(leg_delay.into_iter().flatten().map(|x| ("memory leg_delay", x, "s"))) {
            check(name, x, -1e9, 1e9, unit)?;
        }
        let told = Self::of(machine, inverter);
        let (least_gamma, most_gamma) = kalman::GAMMA_RANGE;
        for (name, x, told, (least, most), unit) in [
            ("memory R_s", R_s, told.R_s, kalman::R_S_RANGE, "Ω"),
            ("memory knee", knee, told.knee, (0.0, f64::INFINITY), ""),
            ("memory L_sigma", L_sigma, told.L_sigma, kalman::LEAKAGE_RANGE, "H"),
            ("memory L_M", L_M, told.L_M, (most_gamma.recip(), least_gamma.recip()), "H"),
        ] {
            check(name, x, 1e-9, 1e9, unit)
                .map_err(|e| e.with_note("finite and positive; a drive that has not run remembers its parameters"))?;
            let (min, max) = (least * told, most * told);
            // What a drive has limited comes back rounded.
            if !(0.999 * min..=1.001 * max).contains(&x) {
                let note = "a drive keeps to this range around its parameters: the memory is another machine's";
                return Err(ParamError { field: name, value: x, min, max, unit, note });
            }
        }
        Ok(())
    }
}

/// A latched fault with what was measured, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FaultSi {
    /// What happened.
    pub cause: Fault,
    /// Control period in which it happened, since power-up.
    pub period: u32,
    /// What was measured, in the unit of the cause's quantity ([`Fault::quantity`]).
    pub value: f64,
    /// The limit that it violated, in the same unit; zero where there is none.
    pub limit: f64,
}

/// Conversion between SI and per unit for one machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiUnits {
    base: Base,
    /// The parameter `L_M`, H: the estimated inductance is relative to it.
    l_m: f64,
    /// The parameter `L_sigma`, H, likewise.
    l_sigma: f64,
    /// Switching frequency, Hz.
    f_s: f64,
}

impl SiUnits {
    /// Units of a machine's rating, with the switching frequency of its inverter.
    #[must_use]
    pub fn new(machine: &Machine, inverter: &Inverter) -> Self {
        Self { base: Base::new(machine), l_m: machine.L_M, l_sigma: machine.L_sigma, f_s: inverter.f_s }
    }

    /// Base quantities.
    #[must_use]
    pub fn base(&self) -> &Base {
        &self.base
    }

    /// A measurement in per unit. NaN has no fixed-point counterpart: full scale is a measurement
    /// fault in every arithmetic.
    #[must_use]
    pub fn measurement<R: Real>(&self, m: &MeasurementSi) -> Measurement<R> {
        let b = &self.base;
        let r = |x: f64| if x.is_nan() { R::from_f64(f64::MAX) } else { R::from_f64(x) };
        Measurement { i_abc: m.i_abc.map(|i| r(i / b.i)), u_dc: r(m.u_dc / b.u) }
    }

    /// A reference in per unit. NaN is a fault of the drive in floating point; fixed point has no such number, and it is a
    /// stop, as an infinite reference is in every arithmetic.
    #[must_use]
    pub fn reference<R: Real>(&self, reference: &ReferenceSi) -> Reference<R> {
        let b = &self.base;
        let (x, y) = match *reference {
            ReferenceSi::Stop => return Reference::Stop,
            ReferenceSi::Speed(w) => (w, w / b.omega_m),
            ReferenceSi::Torque(t) => (t, t / b.torque),
        };
        let y = R::from_f64(y);
        match *reference {
            _ if !x.is_finite() && y.is_finite() => Reference::Stop,
            ReferenceSi::Torque(_) => Reference::Torque(y),
            _ => Reference::Speed(y),
        }
    }

    /// Estimates in SI.
    #[must_use]
    pub fn estimate<R: Real>(&self, e: &Estimate<R>) -> EstimateSi {
        let b = &self.base;
        EstimateSi {
            psi_s: si(&e.flux.psi_s, b.psi),
            psi_r: si(&e.speed.psi_r, b.psi),
            psi_1: si(&e.psi_1, b.psi),
            i_s: si(&e.i_s, b.i),
            u_s: si(&e.u_s, b.u),
            u_i: si(&e.flux.u_i, b.u),
            u_off: si(&e.u_off, b.u),
            u_hf: si(&e.flux.u_hf, b.u),
            i_dq: si(&e.i_dq, b.i),
            i_dq_ref: si(&e.i_dq_ref, b.i),
            psi_ref: e.psi_ref.to_f64() * b.psi,
            omega_m: e.speed.omega_m.to_f64() * b.omega_m,
            omega_s: e.speed.omega_s.to_f64() * b.omega,
            omega_r: e.speed.omega_r.to_f64() * b.omega,
            torque: e.torque.to_f64() * b.torque,
            R_s: e.r_s.to_f64() * b.z,
            R_R: e.r_r.to_f64() * b.z,
            epsilon: e.epsilon.to_f64(),
            innovation: e.innovation.to_f64() * b.psi,
            nis: e.nis.to_f64(),
            angle_deviation: e.angle_deviation.to_f64(),
            confidence: e.confidence.to_f64(),
            speed_gain: e.speed_gain.to_f64(),
        }
    }

    /// A fault report in SI.
    #[must_use]
    pub fn fault<R: Real>(&self, report: &FaultReport<R>) -> FaultSi {
        let (b, trip) = (&self.base, &report.trip);
        let base = match trip.cause.quantity() {
            Quantity::Current => b.i,
            Quantity::Voltage => b.u,
            Quantity::Flux => b.psi,
            Quantity::Speed => b.omega_m,
            Quantity::Nothing | Quantity::Number | Quantity::Channel => 1.0,
        };
        let (value, limit) = (trip.value.to_f64() * base, trip.limit.to_f64() * base);
        FaultSi { cause: trip.cause, period: report.period, value, limit }
    }

    /// Stored data in SI.
    #[must_use]
    pub fn memory<R: Real>(&self, m: &Memory<R>) -> MemorySi {
        let b = &self.base;
        MemorySi {
            u_off: si(&m.u_off, b.u),
            R_s: m.r_s.to_f64() * b.z,
            i_off: m.i_off.map(|i| i.to_f64() * b.i),
            loss_error: m.loss_error.to_f64(),
            knee: m.knee.to_f64(),
            L_sigma: self.l_sigma * m.leakage.to_f64(),
            L_M: self.l_m / m.inv_l_m.to_f64(),
            #[cfg(feature = "legs")]
            leg_delay: m.legs.of_period().map(|x| x.map(|x| x / self.f_s)),
            #[cfg(not(feature = "legs"))]
            leg_delay: [[0.0; 2]; 3],
        }
    }

    /// Stored data in per unit.
    #[must_use]
    pub fn memory_per_unit<R: Real>(&self, m: &MemorySi) -> Memory<R> {
        let b = &self.base;
        Memory {
            u_off: AlphaBeta::new(R::from_f64(m.u_off[0] / b.u), R::from_f64(m.u_off[1] / b.u)),
            r_s: R::from_f64(m.R_s / b.z),
            i_off: m.i_off.map(|i| R::from_f64(i / b.i)),
            loss_error: R::from_f64(m.loss_error),
            knee: R::from_f64(m.knee),
            leakage: R::from_f64(m.L_sigma / self.l_sigma),
            inv_l_m: R::from_f64(self.l_m / m.L_M),
            #[cfg(feature = "legs")]
            legs: Legs::new(&m.leg_delay.map(|x| x.map(|x| x * self.f_s))),
        }
    }
}

fn si<R: Real, F>(v: &Space<R, F>, base: f64) -> Vector {
    [v.re().to_f64() * base, v.im().to_f64() * base]
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)]
enum Inner {
    F32(Drive<f32>),
    F64(Drive<f64>),
    Q(Drive<Q>),
}

/// Runs `$body` with `$d` bound to the drive, whatever its arithmetic.
macro_rules! with {
    ($inner:expr, $d:ident => $body:expr) => {
        match $inner {
            Inner::F32($d) => $body,
            Inner::F64($d) => $body,
            Inner::Q($d) => $body,
        }
    };
}

/// A drive with SI inputs and outputs.
#[derive(Clone, Debug)]
pub struct SiDrive {
    units: SiUnits,
    /// States of the encoder's counter.
    #[cfg(feature = "encoder")]
    states: u32,
    inner: Inner,
}

impl SiDrive {
    /// A stopped drive.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        params: &DriveParams,
        arithmetic: Arithmetic,
    ) -> Result<Self, ParamError> {
        let inner = match arithmetic {
            Arithmetic::F32 => Inner::F32(Drive::new(DriveConfig::new(machine, inverter, params)?)),
            Arithmetic::F64 => Inner::F64(Drive::new(DriveConfig::new(machine, inverter, params)?)),
            Arithmetic::Q => Inner::Q(Drive::new(DriveConfig::new(machine, inverter, params)?)),
        };
        Ok(Self {
            units: SiUnits::new(machine, inverter),
            #[cfg(feature = "encoder")]
            states: params.encoder_states,
            inner,
        })
    }

    /// Base quantities.
    #[must_use]
    pub fn base(&self) -> &Base {
        self.units.base()
    }

    /// One control period: measurement in, duties and gate signal out.
    pub fn step(&mut self, measured: &MeasurementSi, reference: &ReferenceSi) -> ([f64; 3], bool) {
        let units = &self.units;
        with!(&mut self.inner, d => {
            let out = d.step(&units.measurement(measured), &units.reference(reference));
            (out.duty.map(Real::to_f64), out.gates_on)
        })
    }

    /// One control period with the stamp of its PWM period ([`Drive::step_at`]). `None`: it has been computed before,
    /// its duties stay.
    #[cfg(feature = "supervision")]
    pub fn step_at(
        &mut self,
        stamp: u16,
        measured: &MeasurementSi,
        reference: &ReferenceSi,
    ) -> Option<([f64; 3], bool)> {
        let units = &self.units;
        with!(&mut self.inner, d => {
            let out = d.step_at(stamp, &units.measurement(measured), &units.reference(reference))?;
            Some((out.duty.map(Real::to_f64), out.gates_on))
        })
    }

    /// Position of the encoder at the instant of the next measurement, in counts from anywhere: a counter of the drive's
    /// number of states would hold its remainder ([`Drive::set_encoder`]).
    #[cfg(feature = "encoder")]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn set_encoder(&mut self, position: i64) {
        let count = position.rem_euclid(i64::from(self.states.max(1))) as u32;
        with!(&mut self.inner, d => d.set_encoder(count));
    }

    /// What the encoder says; `None` without one.
    #[cfg(feature = "encoder")]
    #[must_use]
    pub fn encoder(&self) -> Option<EncoderSi> {
        let omega_m = self.units.base.omega_m;
        with!(&self.inner, d => d.encoder().map(|e| EncoderSi {
            omega_m: e.omega_m.to_f64() * omega_m,
            difference: e.difference.to_f64() * omega_m,
            state: e.state,
        }))
    }

    /// Pulses of the next period and instants of its samples with a single shunt ([`Drive::pulses`]).
    #[cfg(feature = "shunt")]
    #[must_use]
    pub fn pulses(&self) -> Option<Pulses<f64>> {
        with!(&self.inner, d => d.pulses().map(|p| Pulses {
            rising: p.rising.map(Real::to_f64),
            falling: p.falling.map(Real::to_f64),
            sample: p.sample.map(Real::to_f64),
        }))
    }

    /// Duty of the brake chopper at a measured link voltage in V, 0 to 1.
    #[cfg(feature = "dclink")]
    #[must_use]
    pub fn chopper(&self, u_dc: f64) -> f64 {
        with!(&self.inner, d => d.chopper(Real::from_f64(u_dc / self.units.base.u)).to_f64())
    }

    /// Heat of machine and bridge in units of that at their continuous currents; 0 without the settings.
    #[must_use]
    pub fn overload(&self) -> [f64; 2] {
        with!(&self.inner, d => d.overload().map(Real::to_f64))
    }

    /// State of the sequence.
    #[must_use]
    pub fn status(&self) -> Status {
        with!(&self.inner, d => d.status())
    }

    /// The latched fault: cause, period, and what was measured; `None` unless the drive is in a fault.
    #[must_use]
    pub fn fault(&self) -> Option<FaultSi> {
        with!(&self.inner, d => d.fault().map(|report| self.units.fault(&report)))
    }

    /// Control periods since power-up.
    #[must_use]
    pub fn period(&self) -> u32 {
        with!(&self.inner, d => d.period())
    }

    /// Leaves a fault.
    pub fn reset(&mut self) {
        with!(&mut self.inner, d => d.reset());
    }

    /// Estimates of the latest period.
    #[must_use]
    pub fn estimate(&self) -> EstimateSi {
        with!(&self.inner, d => self.units.estimate(&d.estimate()))
    }

    /// Induced voltage of the latest period, V, while the drive is running.
    #[must_use]
    pub fn induced_voltage(&self) -> Option<Vector> {
        with!(&self.inner, d => {
            (d.status() == Status::Running).then(|| si(&d.estimate().flux.u_i, self.units.base.u))
        })
    }

    /// Data to be kept over a stop.
    #[must_use]
    pub fn memory(&self) -> MemorySi {
        with!(&self.inner, d => self.units.memory(&d.memory()))
    }

    /// Restores what an earlier run stored; `false`: not while the bridge switches ([`Drive::restore`]).
    pub fn restore(&mut self, m: &MemorySi) -> bool {
        let units = &self.units;
        with!(&mut self.inner, d => d.restore(&units.memory_per_unit(m)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_comes_back_in_every_arithmetic() {
        let units = SiUnits::new(&Machine::preset_11k(), &Inverter::preset_11k());
        let m = MemorySi {
            u_off: [0.5, -0.25],
            R_s: 0.3,
            i_off: [0.2, -0.1, 0.05],
            loss_error: 0.1,
            knee: 1.5,
            L_sigma: 2e-3,
            L_M: 0.06,
            leg_delay: [[50e-9, -20e-9], [-40e-9, 30e-9], [-10e-9, -10e-9]],
        };
        fn back<R: Real>(units: &SiUnits, m: &MemorySi) -> MemorySi {
            units.memory(&units.memory_per_unit::<R>(m))
        }
        for got in [back::<f32>(&units, &m), back::<f64>(&units, &m), back::<Q>(&units, &m)] {
            assert!((got.u_off[0] - m.u_off[0]).abs() < 1e-4 && (got.u_off[1] - m.u_off[1]).abs() < 1e-4);
            assert!(
                (got.R_s - m.R_s).abs() < 1e-5
                    && (got.L_M - m.L_M).abs() < 1e-7
                    && (got.L_sigma - m.L_sigma).abs() < 1e-8
            );
            #[cfg(feature = "legs")]
            assert!(got.leg_delay.iter().zip(m.leg_delay).all(|(x, y)| (x[0] - y[0]).hypot(x[1] - y[1]) < 1e-10));
            assert!((got.i_off[0] - m.i_off[0]).abs() < 1e-5 && (got.loss_error - m.loss_error).abs() < 1e-6);
        }
    }

    #[test]
    fn a_measurement_that_is_not_a_number_is_a_fault_in_every_arithmetic() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let params = DriveParams::new(&machine, &inverter);
        for arithmetic in [Arithmetic::F32, Arithmetic::F64, Arithmetic::Q] {
            let mut drive = SiDrive::new(&machine, &inverter, &params, arithmetic).unwrap();
            let measured = MeasurementSi { i_abc: [f64::NAN, 0.0, 0.0], u_dc: 540.0 };
            drive.step(&measured, &ReferenceSi::Speed(0.0));
            let (duty, gates_on) = drive.step(&measured, &ReferenceSi::Speed(0.0));
            assert!(!gates_on && duty == [0.5; 3]);
            let fault = drive.fault().unwrap();
            assert!(fault.cause == Fault::Measurement && fault.value == 1.0, "channel a: {fault:?}");
        }
    }
}
