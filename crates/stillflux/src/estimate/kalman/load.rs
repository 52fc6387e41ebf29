//! Whether the load is steady: leakage, magnetising inductance and its saturation are not corrected then.
//!
//! In the steady state below `|ω_s| = 0.2` the innovation is one constant, to which an error of `r_s` contributes
//! `2 δr_s i_q/ω_s`, one of the leakage about `l_M δl i_q²/|ψ_R|`, and one of `γ` `m δγ`. One equation does not tell them
//! apart. A filter that corrects all of them keeps the sum right, but not the single states: what is left of the errors of
//! the bridge near the zeros of the phase currents is a ripple of `6 ω_s`, the gain has a ripple of the same frequency, and
//! the mean of their product is a drift, along which the innovation stays zero and against which nothing acts. At
//! 2.2 kW and rated torque in slow regeneration the leakage went to 1.5 to 2 times its value within 200 s, `L_M` to 0.63 to
//! 0.88, and the speed was 0.5 to 1.2 % wrong (four realisations of the noise). `r_s` is corrected alone then; it is the
//! one that changes with the winding's temperature.
//!
//! A change of the load, faster than the rotor time constant, one of the stator frequency, and the voltage beyond
//! `|ω_s| = 0.2` tell them apart. Below a torque current of 0.1 errors of resistance and leakage do not matter, and `γ` is
//! alone in the innovation; it is best known from the flux that a start builds up.
//!
//! ```text
//! dx/dt = (i_q - x)/1 s,   dy/dt = (ω_s - y)/1 s,        steady:  |i_q - x| < (|i_q| - 0.1)/8  and  |ω_s - y| < 0.02
//! ```
//!
//! with the torque current of the *reference*, which has no noise of the converters. After a step from zero the load is
//! steady after some two seconds, several rotor time constants. Without the second condition a motor whose winding has
//! warmed at high speed, where `γ` takes the error of the resistance, comes back with both.

use crate::scalar::Real;

/// Time constant of the low-pass, s.
pub(super) const LOAD_TIME: f64 = 1.0;
/// Torque current, per unit, from which on a load can be steady, and the part of what is above it by which it may differ
/// from its low-pass.
const LOADED: f64 = 0.1;
const STEADY: f64 = 0.125;
/// Stator frequency, per unit, by which it may differ.
const SAME: f64 = 0.02;

/// Low-passes of torque current and stator frequency, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Load<R: Real> {
    i_q: R,
    omega_s: R,
    /// Largest recent torque current over the magnetising one, up to one.
    of_late: R,
}

impl<R: Real> Load<R> {
    /// One block with a torque current and a stator frequency, and the `corner` of the low-passes per block; whether the
    /// load is steady.
    #[inline(always)]
    pub fn is_steady(&mut self, corner: R, i_q: R, omega_s: R) -> bool {
        let (change, of_omega) = (i_q - self.i_q, omega_s - self.omega_s);
        self.i_q += corner * change;
        self.omega_s += corner * of_omega;
        let load = i_q.abs() - R::from_f64(LOADED);
        load >= R::ZERO && change.within(load * R::from_f64(STEADY)) && of_omega.within(R::from_f64(SAME))
    }

    /// One block with a torque current over the magnetising one, of which a part is `remembered` by the next.
    #[inline(always)]
    pub fn remember(&mut self, load: R, remembered: R) {
        self.of_late = (self.of_late * remembered).max(load.abs().min(R::ONE));
    }

    /// The largest recent torque current over the magnetising one, up to one.
    #[inline(always)]
    pub fn of_late(&self) -> R {
        self.of_late
    }

    /// By how much a torque current has changed within the last second, per unit.
    #[inline(always)]
    pub fn change(&self, i_q: R) -> R {
        (i_q - self.i_q).abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    const CORNER: f64 = 1e-3 / LOAD_TIME;

    /// Blocks until a load is steady, after a long time at `from`.
    fn blocks(from: f64, to: f64) -> Option<u32> {
        let mut load = Load { i_q: from, omega_s: 0.05, ..Load::default() };
        (0..20_000).find(|_| load.is_steady(CORNER, to, 0.05))
    }

    #[test]
    fn a_load_is_steady_some_seconds_after_its_step_in_either_direction() {
        for (from, to) in [(0.0, 0.9), (0.0, -0.9), (0.9, 0.45), (-0.9, 0.9)] {
            let after = blocks(from, to).unwrap();
            assert!((2000..5000).contains(&after), "{from} to {to}: {after}");
        }
    }

    #[test]
    fn a_load_that_stays_or_grows_slowly_is_steady() {
        assert_eq!(blocks(0.5, 0.5), Some(0));
        let mut load = Load { i_q: 0.5, omega_s: 0.05, ..Load::default() };
        // 0.01 pu a second.
        assert!((0..40_000).all(|k| load.is_steady(CORNER, 0.5 + f64::from(k) * 1e-5, 0.05)));
    }

    #[test]
    fn a_change_of_the_frequency_is_waited_for_and_a_slow_one_is_none() {
        let mut load = Load { i_q: 0.5, omega_s: 0.3, ..Load::default() };
        let after = (0..20_000).find(|_| load.is_steady(CORNER, 0.5, 0.05));
        assert!((2000..4000).contains(&after.unwrap()), "{after:?}");
        // 0.01 pu a second, through zero.
        assert!((0..20_000).all(|k| load.is_steady(CORNER, 0.5, 0.05 - f64::from(k) * 1e-5)));
    }

    #[test]
    fn the_largest_recent_load_is_remembered_and_fades() {
        let mut load = Load::default();
        let mut after = |x: f64, blocks: u32| {
            (0..blocks).for_each(|_| load.remember(x, 1.0 - 1.0 / 512.0));
            load.of_late()
        };
        assert_eq!(after(-0.6, 1), 0.6, "of either direction, at once");
        assert!((after(0.1, 512) - 0.6 / 1f64.exp()).abs() < 1e-3);
        assert_eq!(after(0.1, 2000), 0.1);
        assert_eq!(after(3.0, 1), 1.0, "up to one");
    }

    #[test]
    fn without_load_nothing_is_steady() {
        for i_q in [0.0, 0.05, -0.09] {
            assert_eq!(blocks(i_q, i_q), None);
        }
    }

    #[test]
    fn fixed_point_judges_every_course_of_the_load_as_floating_point() {
        let (mut load, mut fixed) = (Load::default(), Load::default());
        let q = Q::from_f64;
        let mut apart = 0;
        for k in 0..40_000 {
            let t = f64::from(k) * 1e-3;
            let i_q = (0.4 * t).sin() * (0.07 * t).cos();
            let steady = load.is_steady(CORNER, i_q, 0.05);
            apart += u32::from(steady != fixed.is_steady(q(CORNER), q(i_q), q(0.05)));
        }
        // Where the load passes the bound, by a bit.
        assert!(apart < 400, "{apart}");
    }
}
