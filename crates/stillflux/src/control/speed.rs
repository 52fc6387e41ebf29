//! Speed control: PI with anti-windup, output a torque reference.
//!
//! `J dω/dτ = T - T_load`; with `k_p = J ω_c` and `k_i = k_p ω_c / 4` the loop is critically damped.
//! The integrator is clamped to the torque limit less the proportional part, so that it never holds torque
//! that the limit would cut.
//!
//! That zero of the controller would overshoot by 13 % a step of the reference, and with the lag of the estimated speed (two poles at
//! 25 Hz, 40° at 9 Hz) by 54 %. So the reference passes `(1 + b s T)/(1 + s T)` with the time constant `T = k_p/(k_i/t)` of the zero:
//! linearly a set-point weight `b` of the proportional part, which leaves the answer to a load as it is. Of `b` = 0.3 a linear loop
//! does not overshoot with 1/1.5 to 1.5 times the inertia that it knows. Of a step that takes the torque to its limit all the same
//! the filter holds back no more than the deviation with which the proportional part reaches this limit: such a step is over as fast
//! as without it.
//!
//! In field weakening a torque takes more current, and errors of leakage and rotor resistance make more of an estimated speed of it: both
//! gains fall with the square of the flux ([`SpeedControlConfig::part`]), that of the integral once more, by which the loop stays as
//! well damped as it is.

use crate::scalar::{Integrator, Real, likely};
use crate::words::words;

/// Settings of the speed controller.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct SpeedControlConfig<R: Real> {
    /// Proportional gain, torque per speed.
    pub k_p: R,
    /// Integral gain times the time between two calls.
    pub k_i: R,
    /// Time between two calls over the time constant `T` of the reference: `k_i/k_p`.
    pub per_t: R,
    /// Part `b` of a change of the reference that counts at once.
    pub weight: R,
    /// Deviation of the speed at which the proportional part reaches the largest torque.
    pub lead: R,
    /// Largest gain from speed to torque current, at rated flux, over `k_p`; 1 where that is less.
    pub inv_gain: R,
    /// Largest torque of either sign, and of the positive and the negative one.
    pub torque_max: R,
    /// Largest positive torque.
    pub torque_pos: R,
    /// Largest negative torque, its magnitude.
    pub torque_neg: R,
}
words!(SpeedControlConfig: k_p, k_i, per_t, weight, lead, inv_gain, torque_max, torque_pos, torque_neg);

impl<R: Real> SpeedControlConfig<R> {
    /// Part of the gains that counts at a flux of so much of the rated one. An error `Δl` of the leakage turns the flux by
    /// `Δl i_q/|ψ_R|`, and the estimated speed contains the derivative of that: of a torque it makes `1/ψ²` as much.
    #[inline(always)]
    pub fn part(&self, of_rated: R) -> R {
        (of_rated * of_rated * self.inv_gain).min(R::ONE)
    }

    /// Limits of the torque, of which `torque_max` is available now.
    #[inline(always)]
    pub fn limits(&self, torque_max: R) -> (R, R) {
        (-torque_max.min(self.torque_neg), torque_max.min(self.torque_pos))
    }
}

/// State of the speed controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct SpeedController<R: Real> {
    x: Integrator<R>,
    /// The reference behind a low-pass filter of `T`.
    omega_ref: Integrator<R>,
    /// Torque that the last call would have asked for without a limit to its proportional part.
    #[cfg(feature = "weakening")]
    demand: R,
}

impl<R: Real> SpeedController<R> {
    /// Begins with a torque in force and a speed.
    pub fn start(&mut self, torque: R, omega_m: R) {
        self.follow(torque, torque, omega_m);
    }

    /// Torque control: holds the torque in force, the one that was asked for, and the speed.
    #[cfg_attr(not(feature = "weakening"), allow(unused_variables))]
    pub fn follow(&mut self, torque: R, demand: R, omega_m: R) {
        self.x = Integrator::new(torque);
        self.omega_ref = Integrator::new(omega_m);
        #[cfg(feature = "weakening")]
        {
            self.demand = demand;
        }
    }

    /// Torque that the last call would have asked for without a limit to its proportional part, for which field weakening provides; none
    /// without that.
    #[inline(always)]
    #[cfg_attr(not(feature = "weakening"), allow(clippy::unused_self))]
    pub fn demand(&self) -> R {
        #[cfg(feature = "weakening")]
        return self.demand;
        #[cfg(not(feature = "weakening"))]
        R::ZERO
    }

    /// A step beyond the torque limit: the filtered reference stays within `lead` of the reference.
    #[inline(always)]
    fn keep_within_lead(&mut self, c: &SpeedControlConfig<R>, reference: R) {
        let change = (reference - self.omega_ref.value()).limit(c.lead);
        self.omega_ref.set(reference - change);
    }

    /// One period with the speed's `reference`, the speed, and the limits `lo` and `hi` of the torque. `part`: of the bandwidth, for the
    /// inertia told; `inertia`: part of that, with which both gains fall (feature `supervision`). Returns the torque reference.
    #[inline(always)]
    #[cfg_attr(not(feature = "supervision"), allow(unused_variables))]
    pub fn step(
        &mut self,
        c: &SpeedControlConfig<R>,
        reference: R,
        omega_m: R,
        (part, inertia): (R, R),
        (lo, hi): (R, R),
    ) -> R {
        let change = reference - self.omega_ref.value();
        let omega_ref = self.omega_ref.add(c.per_t * part, change);
        let error = (omega_ref + change * c.weight - omega_m) * part;
        // Nothing else than a swing changes it, and a product with one costs fixed point as much as any other.
        #[cfg(feature = "supervision")]
        let error = error * inertia;
        let p = error * c.k_p;
        #[cfg(feature = "weakening")]
        {
            self.demand = p + self.x.value();
        }
        let p = if likely(p >= lo && p <= hi) {
            p
        } else {
            self.keep_within_lead(c, reference);
            p.clamp(lo, hi)
        };
        // Of limits on both sides of zero the sum keeps within them whatever the proportional part; of others it only
        // makes up for what that lacks.
        let (least, most) = if likely(lo <= R::ZERO && hi >= R::ZERO) {
            if p < R::ZERO { (lo - p, hi) } else { (lo, hi - p) }
        } else {
            (lo - p.min(lo.max(R::ZERO)), hi - p.max(hi.min(R::ZERO)))
        };
        let x = self.x.add_clamped(c.k_i, error * part, least, most);
        (p + x).clamp(lo, hi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_load_step_is_answered_without_steady_error_and_without_windup() {
        let j = 50.0; // normalised inertia
        let (omega_c, t_s) = (0.06, 0.03);
        let c = SpeedControlConfig {
            k_p: j * omega_c,
            k_i: t_s * j * omega_c * omega_c / 4.0,
            per_t: t_s * omega_c / 4.0,
            weight: 0.3,
            lead: 1.0 / (j * omega_c),
            inv_gain: 1.0,
            torque_max: 1.0,
            torque_pos: 1.0,
            torque_neg: 1.0,
        };
        let mut ctrl = SpeedController::<f64>::default();
        let mut omega = 0.0;
        for k in 0..200_000 {
            let load = if k > 1000 { 0.7 } else { 0.0 };
            let reference = if k > 60_000 { 0.5 } else { 0.0 };
            let t = ctrl.step(&c, reference, omega, (1.0, 1.0), (-1.0, 1.0));
            assert!(t.abs() <= 1.0);
            omega += t_s * (t - load) / j;
            assert!(omega < 0.501, "neither by a wound-up integrator nor by the zero of the controller: {omega}");
        }
        assert!((omega - 0.5).abs() < 1e-4);
    }

    const CONFIG: SpeedControlConfig<f64> = SpeedControlConfig {
        k_p: 3.0,
        k_i: 0.01,
        per_t: 0.01 / 3.0,
        weight: 0.3,
        lead: 1.0 / 3.0,
        inv_gain: 1.0,
        torque_max: 1.0,
        torque_pos: 1.0,
        torque_neg: 1.0,
    };

    #[test]
    fn the_torque_never_exceeds_what_is_available_now_nor_what_is_set() {
        for sign in [1.0, -1.0] {
            for (available, limit) in [(0.4, 0.4), (5.0, 1.0)] {
                let mut ctrl = SpeedController::default();
                for _ in 0..1000 {
                    assert!(ctrl.step(&CONFIG, 0.0, -sign, (1.0, 1.0), CONFIG.limits(available)) * sign <= limit);
                }
                assert_eq!(ctrl.step(&CONFIG, 0.0, -sign, (1.0, 1.0), CONFIG.limits(available)) * sign, limit);
            }
        }
    }

    #[test]
    fn each_direction_has_its_limit() {
        let c = SpeedControlConfig { torque_pos: 0.8, torque_neg: 0.3, ..CONFIG };
        assert_eq!((c.limits(2.0), c.limits(0.5)), ((-0.3, 0.8), (-0.3, 0.5)));
        for (sign, most) in [(1.0, 0.8), (-1.0, 0.3)] {
            let mut ctrl = SpeedController::default();
            let torque = (0..1000).map(|_| ctrl.step(&c, 0.0, -sign, (1.0, 1.0), c.limits(2.0))).last();
            assert_eq!(torque, Some(sign * most));
        }
    }

    #[test]
    fn a_limit_beyond_zero_is_kept() {
        let mut ctrl = SpeedController::default();
        for _ in 0..100 {
            assert_eq!(ctrl.step(&CONFIG, 0.0, -1.0, (1.0, 1.0), (-1.0, -0.4)), -0.4);
        }
    }

    #[test]
    fn what_the_limit_cuts_is_not_held() {
        for sign in [1.0, -1.0] {
            let mut ctrl = SpeedController::default();
            for _ in 0..10_000 {
                ctrl.step(&CONFIG, 0.0, -sign, (1.0, 1.0), (-1.0, 1.0));
            }
            // Proportional part and limit are equal at an error of 1/3: nothing is left for the integrator.
            assert!(ctrl.step(&CONFIG, 0.0, 0.0, (1.0, 1.0), (-1.0, 1.0)).abs() < 1e-12);
            for _ in 0..10_000 {
                ctrl.step(&CONFIG, 0.0, -0.1 * sign, (1.0, 1.0), (-1.0, 1.0));
            }
            assert!((ctrl.step(&CONFIG, 0.0, 0.0, (1.0, 1.0), (-1.0, 1.0)) * sign - 0.7).abs() < 1e-12);
        }
    }

    #[test]
    fn the_gains_fall_with_the_square_of_the_flux_from_where_they_would_be_too_large_and_are_whole_at_rated_flux() {
        for inv_gain in [1.0, 2.0, 100.0] {
            let c = SpeedControlConfig { inv_gain, ..CONFIG };
            assert_eq!(c.part(1.0), 1.0);
            for of_rated in [0.2, 0.5, 0.8] {
                assert_eq!(c.part(of_rated), (inv_gain * of_rated * of_rated).min(1.0));
            }
        }
        // As well damped, by k_p²/(J k_i): the integral part falls with the square of the proportional one.
        let mut ctrl = SpeedController::<f64>::default();
        let torque = [(); 3].map(|()| ctrl.step(&CONFIG, 0.0, -0.1, (0.5, 1.0), (-1.0, 1.0)));
        assert!((torque[0] - 0.05 * (CONFIG.k_p + 0.5 * CONFIG.k_i)).abs() < 1e-12);
        assert!((torque[2] - torque[1] - 0.025 * CONFIG.k_i).abs() < 1e-12);
    }

    /// Largest speed after a step of the reference to so many times the speed at which the proportional part reaches the torque limit, and
    /// when it stays within 5 %, in parts of `2π/ω_c`. The shaft has `j` times the inertia that the controller knows, its speed is
    /// estimated by a loop of 25/9 of the bandwidth. Without the filter of the reference as the control.
    fn step_of_the_reference(j: f64, step: f64, filter: bool) -> (f64, f64) {
        let (t_s, omega_n) = (1e-3, 25.0 / 9.0);
        let c = SpeedControlConfig {
            k_p: 1.0,
            k_i: t_s / 4.0,
            per_t: t_s / 4.0,
            weight: if filter { 0.3 } else { 1.0 },
            lead: 1.0,
            ..CONFIG
        };
        let mut ctrl = SpeedController::<f64>::default();
        let (mut omega, mut omega_m, mut angle) = (0.0_f64, 0.0, 0.0);
        let (mut most, mut settled) = (0.0_f64, 0);
        for k in 0..60_000 {
            let torque = ctrl.step(&c, step, omega_m, (1.0, 1.0), (-1.0, 1.0));
            angle += t_s * (omega - omega_m - 2.0 * omega_n * angle);
            omega_m += t_s * omega_n * omega_n * angle;
            omega += t_s * torque / j;
            most = most.max(omega / step);
            if (omega / step - 1.0).abs() > 0.05 {
                settled = k;
            }
        }
        (most, f64::from(settled) * t_s / core::f64::consts::TAU)
    }

    #[test]
    fn a_step_of_the_reference_does_not_overshoot_and_one_beyond_the_torque_limit_is_as_fast_as_without_the_filter() {
        for j in [1.0 / 1.5, 1.0, 1.5] {
            for step in [0.1, 0.5, 1.0, 2.0, 3.0, 4.0, 8.0, 15.0] {
                let (most, settled) = step_of_the_reference(j, step, true);
                let (control, before) = step_of_the_reference(j, step, false);
                // The proportional part alone reaches the limit from about 1/0.3 on.
                if step <= 2.0 {
                    assert!(most < 1.001 && control > 1.1, "{j} {step}: {most}, {control} without the filter");
                    assert!(settled < 1.5, "{j} {step}: {settled}");
                } else {
                    assert!(most < 1.09 && most < control, "{j} {step}: {most}, {control} without the filter");
                    assert!(settled < before + 0.35, "{j} {step}: {settled}, {before} without the filter");
                }
            }
        }
    }

    #[cfg(feature = "supervision")]
    #[test]
    fn both_gains_fall_with_the_inertia() {
        let mut ctrl = SpeedController::<f64>::default();
        let torque = [(); 3].map(|()| ctrl.step(&CONFIG, 0.0, -0.1, (1.0, 0.5), (-1.0, 1.0)));
        assert!((torque[0] - 0.05 * (CONFIG.k_p + CONFIG.k_i)).abs() < 1e-12);
        assert!((torque[2] - torque[1] - 0.05 * CONFIG.k_i).abs() < 1e-12);
    }

    #[test]
    fn begins_with_the_torque_in_force() {
        let mut ctrl = SpeedController::default();
        ctrl.start(0.6, 0.8);
        assert_eq!(ctrl.step(&CONFIG, 0.8, 0.8, (1.0, 1.0), (-1.0, 1.0)), 0.6);
    }
}
