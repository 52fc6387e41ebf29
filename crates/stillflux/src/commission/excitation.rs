//! Excitation of a machine at standstill: a voltage in any direction, or a controlled current along the a-axis.
//!
//! ```text
//! u_α* = k_p (i* - i) + k_i ∫(i* - i) dt + R' i* + L_σ di*/dt + u_l(i*) + u_x       u_β* = 0
//! i = (i_a - 2 i_b - 2 i_c)/3
//! ```
//!
//! With `u_β* = 0` phases b and c carry half the current of phase a each, whatever the gains of the sensors are: `i` is
//! the mean of three readings of one current, `i_a`, `-2 i_b` and `-2 i_c`. A current along one axis makes no torque,
//! so a free shaft stays where it is. `u_l` is the loss by the inverter's data sheet, `R'` the sum of stator and rotor
//! resistance by the nameplate, `u_x` an injected voltage.
//!
//! Currents sampled at the start of period *k* give the duties applied during period *k + 1*, as in the drive. The
//! voltage handed to the procedures is that of the quantised duties of ideal legs, between the last two samples. The
//! reference changes at a constant rate, in the same time whatever the change: the current does not overshoot.

use crate::control::modulator::{Duty, applied, modulate, zero_duty};
use crate::inverter::InverterModel;
use crate::scalar::{QuickIntegrator, Real, Timer};
use crate::space::AlphaBeta;

/// What a procedure asks for in a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command<R: Real> {
    /// Gates off.
    Blocked,
    /// A voltage, per unit.
    Voltage(AlphaBeta<R>),
    /// A current along the a-axis, and a voltage added to that of its controller, per unit.
    Current(R, R),
}

/// What a procedure sees of a period, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<R: Real> {
    /// Phase currents, without offset once that is known.
    pub i_abc: [R; 3],
    /// Current along the a-axis now, and one period before.
    pub i: R,
    /// The same one period before.
    pub i_last: R,
    /// Voltage of ideal legs along the a-axis between the two.
    pub u: R,
}

/// Constants, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ExcitationConfig<R: Real> {
    pub inverter: InverterModel<R>,
    pub timer: Option<Timer>,
    /// Gains for the expected leakage inductance.
    pub k_p: R,
    /// That of the integrator, for a period.
    pub k_i: R,
    /// Stator and rotor resistance in series.
    pub r: R,
    /// Leakage inductance over the control period.
    pub l: R,
    /// Largest voltage.
    pub u_max: R,
    /// One over the periods in which the current reference changes from one value to the next.
    pub inv_rise: R,
}

/// State.
#[derive(Clone, Copy, Debug)]
pub(super) struct Excitation<R: Real> {
    /// Ideal voltage of the last two commands, per unit of dc link; the older one acted before the present sample.
    commanded: [AlphaBeta<R>; 2],
    integral: QuickIntegrator<R>,
    reference: R,
    /// Where the reference goes, and by how much in a period.
    target: R,
    slope: R,
    i_last: R,
    /// Periods for which the voltage has been at its limit.
    limited: u32,
}

impl<R: Real> Excitation<R> {
    pub fn new() -> Self {
        Self {
            commanded: [AlphaBeta::default(); 2],
            integral: QuickIntegrator::new(R::ZERO),
            reference: R::ZERO,
            target: R::ZERO,
            slope: R::ZERO,
            i_last: R::ZERO,
            limited: 0,
        }
    }

    /// Periods for which the voltage has been at its limit.
    pub fn limited(&self) -> u32 {
        self.limited
    }

    /// The sample of a period.
    pub fn sample(&mut self, i_abc: [R; 3], u_dc: R) -> Sample<R> {
        let [a, b, c] = i_abc;
        let i = (a - (b + c) * R::TWO) * R::from_f64(1.0 / 3.0);
        let i_last = core::mem::replace(&mut self.i_last, i);
        Sample { i_abc, i, i_last, u: self.commanded[0].re() * u_dc }
    }

    /// Duties for a command.
    pub fn duties(&mut self, c: &ExcitationConfig<R>, gain: R, command: &Command<R>, i: R, u_dc: R) -> Duty<R> {
        let u = match *command {
            Command::Blocked => {
                *self = Self { i_last: self.i_last, ..Self::new() };
                return zero_duty();
            }
            Command::Voltage(u) => {
                (self.integral, self.reference, self.target) = (QuickIntegrator::new(R::ZERO), R::ZERO, R::ZERO);
                u.to_phases()
            }
            Command::Current(target, add) => {
                if target != self.target {
                    self.target = target;
                    self.slope = (target - self.reference).abs() * c.inv_rise;
                }
                let change = (target - self.reference).limit(self.slope);
                self.reference += change;
                let e = self.reference - i;
                let loss =
                    c.inverter.distortion(c.inverter.nominal(), &AlphaBeta::new(self.reference, R::ZERO), u_dc, R::ONE);
                let integral = self.integral.add_limited(c.k_i * gain, e, c.u_max);
                let wanted = gain * (c.k_p * e + c.l * change) + integral + c.r * self.reference;
                let u = wanted.limit(c.u_max);
                self.limited = if u == wanted { 0 } else { self.limited.saturating_add(1) };
                let u = u + add;
                let [a, b, c] = loss.phases;
                [u + a, b - u.half(), c - u.half()]
            }
        };
        let duty = modulate(u, u_dc.recip(), c.timer.as_ref());
        self.commanded = [self.commanded[1], applied(&duty)];
        duty
    }
}
