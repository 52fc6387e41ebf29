//! Excitation of a machine at standstill: a voltage in any direction, or a controlled current along one axis.
//!
//! ```text
//! u_α* = k_p (i* - i) + k_i ∫(i* - i) dt + R' i* + L_σ di*/dt + u_l(i*) + u_x       u_β* = 0 + u_l(i*)
//! i = (i_a - 2 i_b - 2 i_c)/3     along the a-axis: the mean of three readings of one current, `i_a`, `-2 i_b`, `-2 i_c`
//! ```
//!
//! Along another axis `i` is the component of the space vector of the readings. A current along one axis makes no torque, so
//! a free shaft stays where it is, as long as nothing flows across that axis. Across it the machine is short-circuited: with a
//! current imposed in both components the rotor would turn at every reversal, half a turn brings its flux into the
//! new direction. But a constant voltage there, of legs whose delays differ, is not compensated by any controller: at
//! large machines some tenths of a volt are several percent of the rated current, and with the flux that it builds up a
//! direct current makes a torque. So the differences of the legs are found first ([`super::legs`]), with a current that
//! alternates, and compensated from then on.
//!
//! `u_l` is the loss by the inverter's data sheet, with the differences of the legs once they are known, `R'` the sum of
//! stator and rotor resistance by the nameplate, `u_x` an injected voltage.
//!
//! Currents sampled at the start of period *k* give the duties applied during period *k + 1*, as in the drive. The
//! voltage handed to the procedures is that of the quantised duties of ideal legs, between the last two samples. The
//! reference changes at a constant rate, in the same time whatever the change: the current does not overshoot.

use crate::control::modulator::{Duty, applied, modulate, zero_duty};
use crate::inverter::{InverterModel, Knee};
use crate::scalar::{QuickIntegrator, Real, Timer};
use crate::space::AlphaBeta;
#[cfg(feature = "legs")]
use crate::space::Rotator;

/// Deviation of a current from its reference that no transient of a healthy one has for long, per unit.
const OFF: f64 = 0.15;

/// What a procedure asks for in a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command<R: Real> {
    /// Gates off.
    Blocked,
    /// A voltage, per unit.
    Voltage(AlphaBeta<R>),
    /// A current along the a-axis, and a voltage added to that of its controller, per unit.
    Current(R, R),
    /// A current along this axis, per unit.
    #[cfg(feature = "legs")]
    Along(Rotator<R>, R),
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
    /// Space vectors of the currents now and of that voltage, and the dc link.
    pub i_s: AlphaBeta<R>,
    pub u_s: AlphaBeta<R>,
    pub u_dc: R,
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
    /// Curve of the bridge with what is known of its legs.
    pub knee: Knee<R>,
    reference: AlphaBeta<R>,
    /// Where the reference goes, and by how much each component changes in a period.
    target: AlphaBeta<R>,
    slope: AlphaBeta<R>,
    i_last: R,
    /// Periods for which the voltage has been at its limit, and for which the current has been off its reference.
    limited: u32,
    off: u32,
}

impl<R: Real> Excitation<R> {
    pub fn new(c: &ExcitationConfig<R>) -> Self {
        Self {
            knee: *c.inverter.nominal(),
            commanded: [AlphaBeta::default(); 2],
            integral: QuickIntegrator::new(R::ZERO),
            reference: AlphaBeta::default(),
            target: AlphaBeta::default(),
            slope: AlphaBeta::default(),
            i_last: R::ZERO,
            limited: 0,
            off: 0,
        }
    }

    /// Periods for which the voltage has been at its limit.
    pub fn limited(&self) -> u32 {
        self.limited
    }

    /// Periods for which the current has been off its reference by more than [`OFF`].
    pub fn off(&self) -> u32 {
        self.off
    }

    /// The sample of a period.
    pub fn sample(&mut self, i_abc: [R; 3], u_dc: R) -> Sample<R> {
        let [a, b, c] = i_abc;
        let i = (a - (b + c) * R::TWO) * R::from_f64(1.0 / 3.0);
        let i_last = core::mem::replace(&mut self.i_last, i);
        let u_s = self.commanded[0] * u_dc;
        Sample { i_abc, i, i_last, u: u_s.re(), i_s: AlphaBeta::from_phases(i_abc), u_s, u_dc }
    }

    /// Duties for a command, by the sample of the period.
    pub fn duties(&mut self, c: &ExcitationConfig<R>, gain: R, command: &Command<R>, x: &Sample<R>) -> Duty<R> {
        let u = match *command {
            Command::Blocked => return zero_duty(),
            Command::Voltage(u) => {
                self.integral = QuickIntegrator::new(R::ZERO);
                (self.reference, self.target) = (AlphaBeta::default(), AlphaBeta::default());
                u.to_phases()
            }
            Command::Current(target, add) => {
                let (change, loss) = self.refer(c, AlphaBeta::new(target, R::ZERO), x.u_dc);
                let u = self.control(c, gain, [self.reference.re(), change.re(), x.i]) + add;
                [u + loss[0], loss[1] - u.half(), loss[2] - u.half()]
            }
            #[cfg(feature = "legs")]
            Command::Along(axis, target) => {
                let n = axis.axis();
                let (change, loss) = self.refer(c, n * target, x.u_dc);
                let u = self.control(c, gain, [n.dot(&self.reference), n.dot(&change), n.dot(&x.i_s)]);
                let [a, b, e] = (n * u).to_phases();
                [a + loss[0], b + loss[1], e + loss[2]]
            }
        };
        let duty = modulate(u, x.u_dc.recip(), c.timer.as_ref());
        self.commanded = [self.commanded[1], applied(&duty)];
        duty
    }

    /// The reference on its way to its target: its change in this period, and the loss of each leg at it.
    fn refer(&mut self, c: &ExcitationConfig<R>, target: AlphaBeta<R>, u_dc: R) -> (AlphaBeta<R>, [R; 3]) {
        let left = target - self.reference;
        if target != self.target {
            self.target = target;
            self.slope = AlphaBeta::new(left.re().abs() * c.inv_rise, left.im().abs() * c.inv_rise);
        }
        let change = AlphaBeta::new(left.re().limit(self.slope.re()), left.im().limit(self.slope.im()));
        self.reference += change;
        (change, c.inverter.distortion(&self.knee, &self.reference, u_dc, R::ONE).phases)
    }

    /// Voltage along the current, by its reference, the change of that, and the current.
    fn control(&mut self, c: &ExcitationConfig<R>, gain: R, [reference, change, i]: [R; 3]) -> R {
        let e = reference - i;
        self.off = if e.within(R::from_f64(OFF)) { 0 } else { self.off.saturating_add(1) };
        let integral = self.integral.add_limited(c.k_i * gain, e, c.u_max);
        let wanted = gain * (c.k_p * e + c.l * change) + integral + c.r * reference;
        let u = wanted.limit(c.u_max);
        self.limited = if u == wanted { 0 } else { self.limited.saturating_add(1) };
        u
    }
}
