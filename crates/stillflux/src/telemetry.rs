//! Set points and telemetry in SI, single precision: for the firmware of a product, which has no double precision.
//!
//! ```text
//! x_SI = x_pu x_b        x_b: bases of the rated machine, [`crate::base`], rounded to `f32` once by a host
//! ```
//!
//! [`crate::si`] is the same in double precision, for hosts.

use crate::base::Base;
use crate::drive::{Drive, Fault, FaultReport, Quantity, Reference, Status, Trip};
use crate::params::Machine;
use crate::scalar::{Real, likely};
use crate::words::{Words, layout};

/// What a drive is to do, SI. In memory a number of 32 bits, 0 to 2 in this order, and the value.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u32)]
pub enum SetPoint {
    /// Gates off.
    #[default]
    Stop,
    /// Mechanical speed, rad/s.
    Speed(f32),
    /// Torque, N·m.
    Torque(f32),
}

/// State and estimates of a drive, SI.
///
/// While the bridge is blocked nothing is estimated: torque and currents are zero, speed, frequency and flux stay those of the
/// latest period before. A shaft that coasts, or stands, shows in none of them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(non_snake_case)]
#[non_exhaustive]
#[repr(C)]
pub struct Telemetry {
    /// [`Status::code`].
    pub status: u32,
    /// [`crate::drive::Fault::code`], 0 without a fault.
    pub fault: u32,
    /// Control periods since power-up (wraps).
    pub period: u32,
    /// Mechanical speed, rad/s.
    pub omega_m: f32,
    /// Stator frequency, electrical rad/s.
    pub omega_s: f32,
    /// Torque, N·m.
    pub torque: f32,
    /// Stator flux linkage, magnitude, V·s.
    pub psi_s: f32,
    /// Current in field coordinates, A peak: magnetising part.
    pub i_d: f32,
    /// Current in field coordinates, A peak: torque-producing part.
    pub i_q: f32,
    /// Stator resistance with the bridge's `r_d`, Ω.
    pub R_s: f32,
    /// Expected standard deviation of the field angle, rad; π while the drive does not run.
    pub angle_deviation: f32,
    /// Confidence, 0 to 1.
    pub confidence: f32,
    /// Part of the gains of the speed controller that a swing has left, 1 without one: the shaft has about this part of the
    /// inertia told.
    pub speed_gain: f32,
}

impl Telemetry {
    /// All zero: without a drive. `const`: for a `static`.
    pub const ZERO: Self = Self {
        status: 0,
        fault: 0,
        period: 0,
        omega_m: 0.0,
        omega_s: 0.0,
        torque: 0.0,
        psi_s: 0.0,
        i_d: 0.0,
        i_q: 0.0,
        R_s: 0.0,
        angle_deviation: 0.0,
        confidence: 0.0,
        speed_gain: 0.0,
    };
}

impl Default for Telemetry {
    fn default() -> Self {
        Self::ZERO
    }
}

/// What the encoder of a drive says, SI ([`crate::drive::EncoderReading`]).
#[cfg(feature = "encoder")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(C)]
pub struct EncoderTelemetry {
    /// Measured speed, mechanical rad/s.
    pub omega_m: f32,
    /// Measured less estimated speed, filtered, mechanical rad/s.
    pub difference: f32,
    /// [`crate::drive::EncoderState::code`].
    pub state: u32,
}

/// A latched fault with what was measured, SI in single precision.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FaultTelemetry {
    /// What happened.
    pub cause: Fault,
    /// Control period in which it happened, since power-up.
    pub period: u32,
    /// What was measured, in the unit of the cause's quantity ([`Fault::quantity`]).
    pub value: f32,
    /// The limit that it violated, in the same unit; zero where there is none.
    pub limit: f32,
}

/// Base quantities in single precision, and the reciprocals that replace divisions by them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Units {
    i: f32,
    omega: f32,
    omega_m: f32,
    torque: f32,
    psi: f32,
    z: f32,
    inv_omega_m: f32,
    inv_torque: f32,
}

impl Units {
    /// Units of a machine's rating.
    #[must_use]
    #[allow(clippy::cast_possible_truncation)]
    pub fn new(machine: &Machine) -> Self {
        let b = Base::new(machine);
        Self {
            i: b.i as f32,
            omega: b.omega as f32,
            omega_m: b.omega_m as f32,
            torque: b.torque as f32,
            psi: b.psi as f32,
            z: b.z as f32,
            inv_omega_m: (1.0 / b.omega_m) as f32,
            inv_torque: (1.0 / b.torque) as f32,
        }
    }

    /// A set point in per unit. NaN is a fault of the drive in floating point; fixed point has no such number, and it is a
    /// stop, as an infinite set point is in every arithmetic.
    #[inline]
    pub fn reference<R: Real>(&self, set_point: &SetPoint) -> Reference<R> {
        let (x, inverse) = match *set_point {
            SetPoint::Stop => return Reference::Stop,
            SetPoint::Speed(x) => (x, self.inv_omega_m),
            SetPoint::Torque(x) => (x, self.inv_torque),
        };
        let product = x * inverse;
        // NaN stays what it is where there is one.
        let y = R::from_f32(product);
        // A product that is finite needs no further check.
        if !likely(product.is_finite()) && !x.is_finite() && y.is_finite() {
            return Reference::Stop;
        }
        match set_point {
            SetPoint::Stop => Reference::Stop,
            SetPoint::Speed(_) => Reference::Speed(y),
            SetPoint::Torque(_) => Reference::Torque(y),
        }
    }

    /// What the encoder of a drive says; `None` without one.
    #[cfg(feature = "encoder")]
    pub fn encoder<R: Real>(&self, drive: &Drive<R>) -> Option<EncoderTelemetry> {
        drive.encoder().map(|e| EncoderTelemetry {
            omega_m: e.omega_m.to_f32() * self.omega_m,
            difference: e.difference.to_f32() * self.omega_m,
            state: e.state.code(),
        })
    }

    /// The latched fault of a drive with what was measured; `None` without one.
    pub fn fault<R: Real>(&self, drive: &Drive<R>) -> Option<FaultTelemetry> {
        let FaultReport { trip: Trip { cause, value, limit }, period } = drive.fault()?;
        let base = match cause.quantity() {
            Quantity::Current => self.i,
            Quantity::Voltage => self.z * self.i,
            Quantity::Flux => self.psi,
            Quantity::Speed => self.omega_m,
            Quantity::Nothing | Quantity::Number | Quantity::Channel => 1.0,
        };
        Some(FaultTelemetry { cause, period, value: value.to_f32() * base, limit: limit.to_f32() * base })
    }

    /// State and estimates of a drive.
    #[inline(never)]
    pub fn telemetry<R: Real>(&self, drive: &Drive<R>) -> Telemetry {
        let (e, status) = (drive.estimate(), drive.status());
        Telemetry {
            status: status.code(),
            fault: match status {
                Status::Faulted { cause, .. } => cause.code(),
                _ => 0,
            },
            period: drive.period(),
            omega_m: e.speed.omega_m.to_f32() * self.omega_m,
            omega_s: e.speed.omega_s.to_f32() * self.omega,
            torque: e.torque.to_f32() * self.torque,
            psi_s: e.flux.magnitude.to_f32() * self.psi,
            i_d: e.i_dq.re().to_f32() * self.i,
            i_q: e.i_dq.im().to_f32() * self.i,
            R_s: e.r_s.to_f32() * self.z,
            angle_deviation: e.angle_deviation.to_f32(),
            confidence: e.confidence.to_f32(),
            speed_gain: e.speed_gain.to_f32(),
        }
    }
}

impl Words for Units {
    const LEN: usize = 8;
    const LAYOUT: u32 = layout(8, "i omega omega_m torque psi z inv_omega_m inv_torque");
    const BLANK: Self =
        Self { i: 0.0, omega: 0.0, omega_m: 0.0, torque: 0.0, psi: 0.0, z: 0.0, inv_omega_m: 0.0, inv_torque: 0.0 };
    fn put(&self, out: &mut impl FnMut(u32)) {
        let Self { i, omega, omega_m, torque, psi, z, inv_omega_m, inv_torque } = *self;
        [i, omega, omega_m, torque, psi, z, inv_omega_m, inv_torque].put(out);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        let Self { i, omega, omega_m, torque, psi, z, inv_omega_m, inv_torque } = self;
        for x in [i, omega, omega_m, torque, psi, z, inv_omega_m, inv_torque] {
            x.fill(from);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DriveConfig, DriveParams, Scheme};
    use crate::drive::Measurement;
    use crate::params::Inverter;
    use crate::scalar::Q;
    use crate::si::SiUnits;

    fn agrees<R: Real>() {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        let params = DriveParams { calibrate_offset: false, ..DriveParams::new(&machine, &inverter) };
        let mut drive = Drive::<R>::new(DriveConfig::new(&machine, &inverter, &params).unwrap());
        let r = |x: f64| R::from_f64(x);
        // 20 A of magnetisation, 10 A across it.
        for _ in 0..1100 {
            drive.step(
                &Measurement { i_abc: [r(0.6), r(-0.2), r(-0.4)], u_dc: r(1.65) },
                &Units::new(&machine).reference(&SetPoint::Speed(10.0)),
            );
        }
        let (t, e) =
            (Units::new(&machine).telemetry(&drive), SiUnits::new(&machine, &inverter).estimate(&drive.estimate()));
        assert_eq!((t.status, t.fault, t.period), (2, 0, 1100), "magnetising");
        let abs = |[x, y]: [f64; 2]| libm::hypot(x, y);
        for (got, want) in [
            (t.omega_m, e.omega_m),
            (t.omega_s, e.omega_s),
            (t.torque, e.torque),
            (t.i_d, e.i_dq[0]),
            (t.i_q, e.i_dq[1]),
            (t.R_s, e.R_s),
            (t.angle_deviation, e.angle_deviation),
        ] {
            assert!((f64::from(got) - want).abs() < 1e-5 * want.abs() + 1e-5, "{} {t:?} {e:?}", R::NAME);
        }
        // The drive's magnitude is that of a Newton step from an earlier period.
        assert!((f64::from(t.psi_s) - abs(e.psi_s)).abs() <= 2e-4 * abs(e.psi_s));
        // The published scheme's estimator starts when the machine is magnetised: there is no flux before.
        assert_eq!(t.psi_s != 0.0, params.scheme == Scheme::Enhanced);
        assert!(t.i_d != 0.0 && t.R_s > 0.0);
    }

    #[test]
    fn telemetry_is_that_of_double_precision() {
        agrees::<f32>();
        agrees::<f64>();
        agrees::<Q>();
    }

    #[test]
    fn a_set_point_is_its_part_of_the_base() {
        let machine = Machine::preset_2k2();
        let (units, base) = (Units::new(&machine), Base::new(&machine));
        let Reference::Speed(x) = units.reference::<f32>(&SetPoint::Speed(157.0)) else { panic!() };
        assert!((f64::from(x) - 157.0 / base.omega_m).abs() < 1e-6);
        let Reference::Torque(x) = units.reference::<Q>(&SetPoint::Torque(-14.6)) else { panic!() };
        assert!((x.to_f64() + 14.6 / base.torque).abs() < 1e-6);
        assert_eq!(units.reference::<Q>(&SetPoint::Stop), Reference::Stop);
    }

    #[test]
    fn a_set_point_that_is_not_finite_never_becomes_a_number() {
        let units = Units::new(&Machine::preset_2k2());
        assert!(matches!(units.reference::<f32>(&SetPoint::Speed(f32::NAN)), Reference::Speed(x) if x.is_nan()));
        for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(units.reference::<Q>(&SetPoint::Torque(x)), Reference::Stop);
        }
    }
}
