//! Sensors and wiring: offsets with gates off, then voltage pulses in the directions of the three phases.
//!
//! ```text
//! pulse +u for n periods, -u for n periods      Δi_j = u_eff n T_s/L_σ · E_kj       E_kj = 1 (j = k), -1/2 (j ≠ k)
//! ```
//!
//! in direction *k*, response of channel *j*; the odd part of a positive and a negative pulse holds no offset. A pulse
//! lasts some periods: resistance does not count, and a short circuit shows in the first one. The amplitude begins at a
//! quarter of what should give a tenth of the rated peak current and is doubled until it does, four times at most. The
//! response is that of the wiring:
//!
//! | response | finding |
//! |---|---|
//! | above 0.6 pu at any time | [`Cause::ShortCircuit`] |
//! | none in all channels | [`Cause::NoMotor`] |
//! | none in one channel, the other two equal and opposite | [`Cause::OpenPhase`] |
//! | none in a channel, the others do not add up to zero | [`Cause::DeadChannel`] |
//! | channel *j* largest in another direction than *j* | [`Cause::SwappedChannels`] |
//! | negative in its own direction | [`Cause::InvertedChannel`] |
//! | more than 15 % from the mean of all channels | [`Cause::ChannelGain`] |
//! | `L_σ` beyond a factor of five of the nameplate's | [`Cause::WrongMotor`]; star for delta: [`super::bridge`] |
//!
//! **Assumes** a shaft at rest and a machine without flux. Swapped motor cables change the direction of rotation only
//! and are no fault. The loss of the bridge at small currents is estimated by the data sheet; the `L_σ` found here
//! serves current control and the check above, nothing else.

use super::excitation::{Command, Sample};
use super::status::Cause;
use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;

/// Response that is wanted, per unit.
pub(super) const RESPONSE: f64 = 0.1;
/// Least response at which the amplitude is large enough.
const ENOUGH: f64 = 0.06;
/// Amplitudes, each twice the one before.
const AMPLITUDES: u32 = 5;
/// Periods without voltage after a pulse.
const REST: u32 = 10;
/// Current of a short circuit, per unit.
const SHORT: f64 = 0.6;
/// Largest offset of a healthy channel, per unit, and the largest difference from the mean gain.
const OFFSET_MAX: f64 = 0.1;
const GAIN_MAX: f64 = 0.15;
/// Factor between expected and found leakage inductance of another machine.
const FACTOR: f64 = 5.0;

/// Constants, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WiringConfig<R: Real> {
    pub offset_periods: u32,
    pub inv_offset_periods: R,
    /// Length of a pulse in periods.
    pub pulse: u32,
    /// First amplitude.
    pub u: R,
    /// Largest one.
    pub u_max: R,
    /// Loss of the bridge.
    pub loss: R,
    /// `n T_s/L_σ` of the nameplate.
    pub per_volt: R,
}

/// State and result.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wiring<R: Real> {
    tick: u32,
    amplitude: u32,
    u: R,
    offset: [Integrator<R>; 3],
    /// Response of channel *j* to direction *k*: `[k][j]`.
    response: [[R; 3]; 3],
    /// Leakage inductance relative to that of the nameplate.
    pub leakage: R,
}

impl<R: Real> Wiring<R> {
    pub fn new(c: &WiringConfig<R>) -> Self {
        Self {
            tick: 0,
            amplitude: 0,
            u: c.u,
            offset: [Integrator::default(); 3],
            response: [[R::ZERO; 3]; 3],
            leakage: R::ONE,
        }
    }

    /// Offsets of the channels.
    pub fn offset(&self) -> [R; 3] {
        self.offset.map(|o| o.value())
    }

    /// One period; `None` when the wiring has been found right.
    pub fn step(&mut self, c: &WiringConfig<R>, x: &Sample<R>) -> Result<Option<Command<R>>, Cause> {
        let tick = self.tick;
        self.tick += 1;
        if tick < c.offset_periods {
            for (o, i) in self.offset.iter_mut().zip(x.i_abc) {
                o.add(c.inv_offset_periods, i);
            }
            return Ok(Some(Command::Blocked));
        }
        if tick == c.offset_periods && self.offset().iter().any(|o| !o.within(R::from_f64(OFFSET_MAX))) {
            return Err(Cause::CurrentOffset);
        }
        let i_abc = {
            let (o, [a, b, e]) = (self.offset(), x.i_abc);
            [a - o[0], b - o[1], e - o[2]]
        };
        if i_abc.iter().any(|i| !i.within(R::from_f64(SHORT))) {
            return Err(Cause::ShortCircuit);
        }
        let length = 2 * c.pulse + REST;
        let since = tick - c.offset_periods;
        let (pulse, at) = (since / length, since % length);
        if pulse == 6 {
            return self.judge(c);
        }
        let (k, negative) = ((pulse / 2) as usize, pulse % 2 == 1);
        // The command of a call acts up to the sample of the call after next.
        if at == c.pulse + 1 {
            for j in 0..3 {
                let half = i_abc[j].half();
                self.response[k][j] += if negative { -half } else { half };
            }
        }
        let sign = if (at < c.pulse) == negative { -R::ONE } else { R::ONE };
        let u = if at < 2 * c.pulse { self.u * sign } else { R::ZERO };
        let mut phases = [-u.half(); 3];
        phases[k] = u;
        Ok(Some(Command::Voltage(AlphaBeta::from_phases(phases))))
    }

    /// All six pulses of an amplitude are done.
    fn judge(&mut self, c: &WiringConfig<R>) -> Result<Option<Command<R>>, Cause> {
        let m = self.response;
        let largest = m.iter().flatten().fold(R::ZERO, |x, y| x.max(y.abs()));
        if largest < R::from_f64(ENOUGH) && self.amplitude + 1 < AMPLITUDES {
            self.amplitude += 1;
            self.u = (self.u * R::TWO).min(c.u_max);
            self.tick = c.offset_periods;
            self.response = [[R::ZERO; 3]; 3];
            return Ok(Some(Command::Voltage(AlphaBeta::default())));
        }
        if largest < R::from_f64(0.25 * ENOUGH) {
            return Err(Cause::NoMotor);
        }
        let none = |j: usize| (0..3).all(|k| m[k][j].abs() < largest * R::from_f64(0.15));
        for j in 0..3 {
            if none(j) {
                let closed = (0..3).all(|k| {
                    let sum = m[k][(j + 1) % 3] + m[k][(j + 2) % 3];
                    sum.abs() < largest * R::from_f64(0.2)
                });
                return Err(if closed { Cause::OpenPhase } else { Cause::DeadChannel });
            }
        }
        let mut gain = [R::ZERO; 3];
        for j in 0..3 {
            let own = m[j][j];
            if (0..3).any(|k| m[k][j].abs() > own.abs() * R::from_f64(1.25)) {
                return Err(Cause::SwappedChannels);
            }
            if own < R::ZERO {
                return Err(Cause::InvertedChannel);
            }
            // Least-squares scale of the column: Σ E² = 3/2.
            let others = m[(j + 1) % 3][j] + m[(j + 2) % 3][j];
            gain[j] = (own - others.half()) * R::from_f64(2.0 / 3.0);
        }
        let mean = (gain[0] + gain[1] + gain[2]) * R::from_f64(1.0 / 3.0);
        if gain.iter().any(|g| !(*g - mean).within(mean.max(R::ZERO) * R::from_f64(GAIN_MAX))) {
            return Err(Cause::ChannelGain);
        }
        self.leakage = (self.u - c.loss).max(self.u.quarter()) * c.per_volt * mean.recip();
        if !(self.leakage > R::from_f64(1.0 / FACTOR) && self.leakage < R::from_f64(FACTOR)) {
            return Err(Cause::WrongMotor);
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use crate::commission::{Cause, Commissioning, CommissioningConfig, Nameplate, Stage, Status};
    use crate::drive::Measurement;
    use crate::params::Inverter;
    use crate::scalar::{Q, Real};

    const PLATE: Nameplate =
        Nameplate { P_N: 4000.0, U_N: 400.0, I_N: 8.2, f_N: 50.0, n_N: 1435.0, cos_phi: 0.82, T_max: None, J: None };

    /// What is wrong with a winding of three resistive inductances in star.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Winding {
        Healthy,
        /// A phase is open.
        Open(usize),
        /// All are.
        Disconnected,
        /// A phase has this share of its inductance.
        Shorted(usize, f64),
        /// Two terminals are connected by this share of the inductance.
        Terminals(f64),
    }

    /// The first stage on such a winding, ideal legs: how it ends, and the largest current, per unit.
    fn run<R: Real>(winding: Winding) -> (Status, Stage, f64) {
        let config = CommissioningConfig::<R>::new(&PLATE, &Inverter::preset_2k2()).unwrap();
        let (l, r, t_s) = (config.pu.sigma_l_s, config.pu.r_s + config.pu.r_r, config.pu.t_s);
        let u_dc = config.pu.u_dc;
        let mut x = Commissioning::new(config);
        let (mut i, mut bridge) = ([0.0f64; 3], 0.0);
        let (mut preload, mut largest) = ([0.5; 3], 0.0f64);
        while x.status() == Status::Running && x.stage() == Stage::Wiring {
            let read = [i[0], i[1] + bridge, i[2] - bridge].map(R::from_f64);
            let out = x.step(&Measurement { i_abc: read, u_dc: R::from_f64(u_dc) });
            let v = core::mem::replace(&mut preload, out.duty.map(Real::to_f64)).map(|d| d * u_dc);
            for _ in 0..10 {
                let mut g = [1.0 / l; 3];
                match winding {
                    Winding::Open(k) => g[k] = 0.0,
                    Winding::Disconnected => g = [0.0; 3],
                    Winding::Shorted(k, share) => g[k] /= share,
                    Winding::Terminals(share) => bridge += (v[1] - v[2]) / (share * l) * 0.1 * t_s,
                    Winding::Healthy => {}
                }
                let sum: f64 = g.iter().sum();
                let star = if sum > 0.0 { (0..3).map(|k| g[k] * (v[k] - r * i[k])).sum::<f64>() / sum } else { 0.0 };
                for k in 0..3 {
                    i[k] += g[k] * (v[k] - r * i[k] - star) * 0.1 * t_s;
                    largest = largest.max(i[k].abs()).max(bridge.abs());
                }
            }
        }
        (x.status(), x.stage(), largest)
    }

    fn faults<R: Real>() {
        let next = if cfg!(feature = "legs") { Stage::Legs } else { Stage::Bridge };
        assert_eq!(run::<R>(Winding::Healthy).1, next, "{}", R::NAME);
        for (winding, cause) in [
            (Winding::Open(0), Cause::OpenPhase),
            (Winding::Open(1), Cause::OpenPhase),
            (Winding::Open(2), Cause::OpenPhase),
            (Winding::Disconnected, Cause::NoMotor),
            (Winding::Shorted(1, 0.4), Cause::ChannelGain),
            (Winding::Terminals(0.02), Cause::ShortCircuit),
        ] {
            let (status, _, largest) = run::<R>(winding);
            assert!(matches!(status, Status::Faulted { cause: c, .. } if c == cause), "{winding:?}: {status:?}");
            // A short of a fiftieth of the leakage inductance: one period more passes before the gates block.
            assert!(largest < 2.0, "{winding:?}: {largest}");
        }
    }

    #[test]
    fn a_winding_that_is_open_or_shorted_is_named() {
        faults::<f32>();
        faults::<f64>();
        faults::<Q>();
    }

    #[test]
    fn the_state_takes_no_more_than_two_kilobytes() {
        assert!(size_of::<crate::commission::State<f64>>() <= 2048);
        assert!(size_of::<crate::commission::State<f32>>() <= 1024);
        assert!(size_of::<crate::commission::State<Q>>() <= 1280);
    }
}
