//! Inertia and friction, with a free shaft: a run of the drive at constant torque up and down.
//!
//! ```text
//! J (ω_2 - ω_1) = ∫T dt - T_f t      up from ω_1 to ω_2, and down again: two equations for J and T_f
//! ```
//!
//! The drive runs with the parameters found at standstill under torque control, so that no inertia has to be known. Its
//! estimates of torque and speed are integrated between a tenth and three tenths of rated speed. `J` is that of the
//! whole shaft, `T_f` the mean friction over this range.
//!
//! **Assumes** a shaft that may turn, and no load but friction. The torque is that of the estimated flux: its error, some
//! percent with the flux inductance's, is that of `J`.

use crate::drive::Reference;
use crate::scalar::{Integrator, Real};

/// Torque, relative to the rated one.
const TORQUE: f64 = 0.4;
/// Speeds between which is integrated, per unit.
const SPEED: (f64, f64) = (0.1, 0.3);
/// Time after the drive's start without torque, and after which the run has failed, s.
const WAIT: f64 = 0.3;
const TIMEOUT: f64 = 12.0;

/// Part of the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Wait,
    Up,
    Down,
    Done,
    Failed,
}

/// Constants, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertiaConfig<R: Real> {
    torque: R,
    low: R,
    high: R,
    /// Control period in normalised time over 1024: integrals of seconds stay within fixed point.
    t_s: R,
    wait: u32,
    timeout: u32,
}

impl<R: Real> InertiaConfig<R> {
    /// For a rated torque per unit, a control period in normalised time, and a control frequency in Hz.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(torque_rated: f64, t_s: f64, f_s: f64) -> Self {
        Self {
            torque: R::from_f64(TORQUE * torque_rated),
            low: R::from_f64(SPEED.0),
            high: R::from_f64(SPEED.1),
            t_s: R::from_f64(t_s / 1024.0),
            wait: (WAIT * f_s) as u32,
            timeout: (TIMEOUT * f_s) as u32,
        }
    }
}

/// State and record.
#[derive(Clone, Copy, Debug)]
pub struct Inertia<R: Real> {
    part: Part,
    tick: u32,
    /// Impulse and duration between the two speeds, up and down, over 1024; and the speeds at their ends.
    impulse: [Integrator<R>; 2],
    duration: [u32; 2],
    first: [R; 2],
    last: [R; 2],
}

/// What was found, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertiaFound {
    /// Inertia: the torque that changes the speed by one in normalised time.
    pub j: f64,
    /// Mean friction torque.
    pub friction: f64,
}

impl<R: Real> Inertia<R> {
    /// Before the drive's start.
    #[must_use]
    pub fn new() -> Self {
        Self {
            part: Part::Wait,
            tick: 0,
            impulse: [Integrator::default(); 2],
            duration: [0; 2],
            first: [R::ZERO; 2],
            last: [R::ZERO; 2],
        }
    }

    /// One period of the running drive with its estimates: the reference for it.
    pub fn step(&mut self, c: &InertiaConfig<R>, omega: R, torque: R) -> Reference<R> {
        self.tick = self.tick.saturating_add(1);
        if self.tick > c.timeout && self.part != Part::Done {
            self.part = Part::Failed;
        }
        let counts = omega > c.low && omega < c.high;
        match self.part {
            Part::Wait => {
                if self.tick > c.wait {
                    self.part = Part::Up;
                }
                Reference::Torque(R::ZERO)
            }
            Part::Up => {
                self.add(0, counts, c, omega, torque);
                if omega > c.high {
                    self.part = Part::Down;
                }
                Reference::Torque(c.torque)
            }
            Part::Down => {
                self.add(1, counts, c, omega, torque);
                if omega < c.low {
                    self.part = Part::Done;
                }
                Reference::Torque(-c.torque)
            }
            Part::Done | Part::Failed => Reference::Stop,
        }
    }

    fn add(&mut self, k: usize, counts: bool, c: &InertiaConfig<R>, omega: R, torque: R) {
        if counts {
            if self.duration[k] == 0 {
                self.first[k] = omega;
            }
            self.last[k] = omega;
            self.duration[k] += 1;
            self.impulse[k].add(c.t_s, torque);
        }
    }

    /// Whether the run is over.
    pub fn is_over(&self) -> bool {
        matches!(self.part, Part::Done | Part::Failed)
    }

    /// Part of the run that is over, 0 to 1.
    pub fn progress(&self) -> f64 {
        match self.part {
            Part::Wait => 0.1,
            Part::Up => 0.4,
            Part::Down => 0.7,
            Part::Done | Part::Failed => 1.0,
        }
    }

    /// Inertia and friction, if both parts of the run were completed.
    pub fn found(&self, c: &InertiaConfig<R>) -> Option<InertiaFound> {
        if self.part != Part::Done || self.duration.contains(&0) {
            return None;
        }
        let [p, q] = self.impulse.map(|x| 1024.0 * x.value().to_f64());
        let [s, t] = self.duration.map(|n| 1024.0 * f64::from(n) * c.t_s.to_f64());
        let [up, down] = [0, 1].map(|k| self.last[k].to_f64() - self.first[k].to_f64());
        // J up = p - T_f s, J down = q - T_f t.
        let det = up * t - down * s;
        let (j, friction) = ((p * t - q * s) / det, (up * q - down * p) / det);
        (j.is_finite() && j > 0.0).then_some(InertiaFound { j, friction })
    }
}

impl<R: Real> Default for Inertia<R> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    fn run<R: Real>() -> InertiaFound {
        let (j, friction, t_s) = (120.0, 0.02, 0.0314);
        let c = InertiaConfig::<R>::new(0.66, t_s, 10e3);
        let (mut x, mut omega, mut torque) = (Inertia::<R>::new(), 0.0, 0.0);
        while !x.is_over() {
            if let Reference::Torque(t) = x.step(&c, R::from_f64(omega), R::from_f64(torque)) {
                torque = t.to_f64();
            }
            let brake = if omega > 0.0 { friction } else { 0.0 };
            omega += t_s / j * (torque - brake);
        }
        x.found(&c).unwrap()
    }

    #[test]
    fn acceleration_and_deceleration_tell_inertia_from_friction() {
        for x in [run::<f32>(), run::<f64>(), run::<Q>()] {
            assert!((x.j / 120.0 - 1.0).abs() < 0.01 && (x.friction / 0.02 - 1.0).abs() < 0.05, "{x:?}");
        }
    }

    #[test]
    fn a_shaft_that_does_not_turn_ends_the_run_without_a_result() {
        let c = InertiaConfig::<f32>::new(0.66, 0.0314, 10e3);
        let mut x = Inertia::<f32>::new();
        let mut n = 0;
        while !x.is_over() {
            x.step(&c, 0.0, 0.2);
            n += 1;
        }
        assert!(n <= 120_001 && x.found(&c).is_none());
        assert_eq!(x.step(&c, 0.0, 0.0), Reference::Stop);
    }
}
