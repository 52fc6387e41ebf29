//! Rotor flux, slip and speed.
//!
//! ```text
//! ψ̂_R = ψ̂_s - σl_s i_s                                     inverse-Γ rotor flux
//! ω̂_r = r_R (ψ̂_R × i_s) / |ψ̂_R|²                           slip, exact also in transients
//! ```
//!
//! The paper's (11b) is the steady state of the slip; with it `di_q/dτ` would have to be added (10b).
//! A phase-locked loop follows the angle of ψ̂_R, with the slip fed forward: what its integrator holds is
//! the mechanical speed, which does not jump with the torque,
//!
//! ```text
//! dω̂/dτ = k_i ε,   dθ/dτ = ω̂ + ω̂_r + k_p ε,   ε = sin(arg ψ̂_R - θ),   ω̂_s = ω̂ + ω̂_r
//! ```
//!
//! Validity: as that of ψ̂_R. Where the rotor flux (nearly) vanishes, slip and ε are limited and stay finite.

use crate::scalar::{QuickIntegrator, Real, likely};
use crate::space::{AlphaBeta, Rotator};
use crate::words::words;

/// Largest speed, per unit: more than 1.3 times the largest `omega_max`, beyond which a speed is a fault.
const OMEGA_MAX: f64 = 4.0;

/// Settings of the speed estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct SpeedConfig<R: Real> {
    /// Time between two calls, normalised.
    pub t_s: R,
    /// `σl_s` of the parameters.
    pub sigma_l_s: R,
    /// Rotor resistance `r_R`.
    pub r_r: R,
    /// Proportional gain `2 ζ ω_n` of the loop, per unit of frequency.
    pub k_p: R,
    /// Integral gain `ω_n²` times the time between two calls.
    pub k_i: R,
}
words!(SpeedConfig: t_s, sigma_l_s, r_r, k_p, k_i);

/// Speed, slip and rotor flux.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct SpeedEstimate<R: Real> {
    /// Rotor flux linkage `ψ̂_R`.
    pub psi_r: AlphaBeta<R>,
    /// Mechanical speed (electrical per unit).
    pub omega_m: R,
    /// Slip frequency.
    pub omega_r: R,
    /// Stator frequency.
    pub omega_s: R,
    /// Frequency at which the loop turns, `ω̂_s + k_p ε`: noisier, but it does not lag behind a ramp of the speed.
    pub omega_turn: R,
}

impl<R: Real> SpeedEstimate<R> {
    /// A field that turns with the shaft, at this speed.
    pub fn set_synchronous(&mut self, omega: R) {
        (self.omega_m, self.omega_s, self.omega_turn) = (omega, omega, omega);
    }
}

/// State of the speed estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct SpeedEstimator<R: Real> {
    angle: Rotator<R>,
    /// `1/|ψ̂_R|` of the last call.
    inv_psi_r: R,
    omega_m: QuickIntegrator<R>,
}

impl<R: Real> SpeedConfig<R> {
    /// Rotor flux with the leakage inductance of the parameters.
    #[inline(always)]
    pub fn rotor_flux(&self, psi_s: &AlphaBeta<R>, i_s: &AlphaBeta<R>) -> AlphaBeta<R> {
        *psi_s - *i_s * self.sigma_l_s
    }
}

impl<R: Real> SpeedEstimator<R> {
    /// Begins at a known flux and speed.
    pub fn start(&mut self, psi_r: &AlphaBeta<R>, omega_m: R) {
        self.angle = Rotator::of(psi_r).0;
        self.omega_m = QuickIntegrator::new(omega_m);
        self.inv_psi_r = R::ZERO;
    }

    /// One call, with the rotor flux.
    #[inline(always)]
    pub fn step(&mut self, c: &SpeedConfig<R>, psi_r: &AlphaBeta<R>, i_s: &AlphaBeta<R>) -> SpeedEstimate<R> {
        let n2 = psi_r.norm_sq();
        let inv = n2.rsqrt_next(self.inv_psi_r).unwrap_or_else(|| anew(n2));
        self.inv_psi_r = inv;
        let omega_r = (c.r_r * inv * (psi_r.cross(i_s) * inv)).limit(R::ONE);
        // The sine of an angle: within ±1 as it stands.
        let error = self.angle.axis().cross(psi_r) * inv;
        let omega_m = self.omega_m.add_limited(c.k_i, error, R::from_f64(OMEGA_MAX));
        let omega_s = omega_m + omega_r;
        let omega_turn = omega_s + c.k_p * error;
        let turn = (c.t_s * omega_turn).limit(R::ONE);
        // The published scheme has every second period: 0.42 rad.
        let near = cfg!(not(feature = "enhanced")) || likely(turn.within(R::HALF));
        self.angle = if near { self.angle.turned(turn) } else { turned_far(&self.angle, turn) };
        SpeedEstimate { psi_r: *psi_r, omega_m, omega_r, omega_s, omega_turn }
    }
}

/// Turned by up to 0.84 rad, where the loop runs in every fourth of 30 periods a turn.
#[cold]
#[inline(never)]
fn turned_far<R: Real>(angle: &Rotator<R>, turn: R) -> Rotator<R> {
    let half = turn.half();
    angle.turned(half).turned(half)
}

/// `1/|ψ̂_R|` without a value to start from, limited where the flux vanishes.
#[cold]
#[inline(never)]
fn anew<R: Real>(n2: R) -> R {
    n2.max(R::from_f64(0.01)).rsqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn follows_a_ramp_of_speed_and_tells_slip_from_speed() {
        let c = SpeedConfig { t_s: 0.03, sigma_l_s: 0.1, r_r: 0.05, k_p: 0.8, k_i: 0.03 * 0.16 };
        let mut est = SpeedEstimator::<f64>::default();
        let (mut theta, i_q) = (0.0_f64, 0.5);
        let mut out = SpeedEstimate::default();
        est.start(&AlphaBeta::new(1.0, 0.0), 0.0);
        for k in 0..40_000 {
            let omega_s = (f64::from(k) * 1e-4).min(0.8);
            theta += c.t_s * omega_s;
            let e = Rotator { cos: theta.cos(), sin: theta.sin() };
            let i = e.to_stator(&crate::space::Dq::new(0.6, i_q));
            let psi_r = e.axis() * 0.9;
            out = est.step(&c, &c.rotor_flux(&(psi_r + i * 0.1), &i), &i);
        }
        assert!((out.omega_r - 0.05 * i_q / 0.9).abs() < 1e-9);
        assert!((out.omega_s - 0.8).abs() < 1e-6);
        assert!((out.omega_m - (0.8 - out.omega_r)).abs() < 1e-6);
    }

    #[cfg(feature = "enhanced")]
    #[test]
    fn follows_a_field_that_turns_by_0_84_rad_between_two_calls() {
        // Every fourth of 30 periods a turn: 267 Hz at 8 kHz, a base of 100 Hz.
        let t_s = 0.5e-3 * core::f64::consts::TAU * 100.0;
        let c = SpeedConfig { t_s, sigma_l_s: 0.1, r_r: 0.05, k_p: 0.5, k_i: t_s * 0.0625 };
        for sign in [1.0, -1.0] {
            let mut est = SpeedEstimator::<f64>::default();
            est.start(&AlphaBeta::new(1.0, 0.0), 0.0);
            let (mut theta, mut out) = (0.0_f64, SpeedEstimate::default());
            for k in 0..4000 {
                let omega = sign * (f64::from(k) * 2e-3).min(2.67);
                theta += t_s * omega;
                let psi_r = Rotator { cos: theta.cos(), sin: theta.sin() }.axis() * 0.4;
                out = est.step(&c, &psi_r, &AlphaBeta::default());
            }
            assert!((out.omega_m - sign * 2.67).abs() < 2e-3, "{out:?}");
        }
    }

    const CONFIG: SpeedConfig<f64> = SpeedConfig { t_s: 0.03, sigma_l_s: 0.1, r_r: 0.05, k_p: 0.8, k_i: 0.03 * 0.16 };

    #[test]
    fn begins_at_the_speed_and_the_angle_of_the_flux() {
        let (psi, i) = (AlphaBeta::new(-0.6, 0.8), AlphaBeta::default());
        let mut est = SpeedEstimator::<f64>::default();
        // As after a run: what it left must not matter.
        est.step(&CONFIG, &AlphaBeta::new(0.02, 0.0), &AlphaBeta::new(1.0, 1.0));
        est.start(&psi, 0.4);
        let out = est.step(&CONFIG, &psi, &i);
        assert!((out.omega_m - 0.4).abs() < 1e-9 && (out.omega_s - 0.4).abs() < 1e-9, "{out:?}");
        est.start(&AlphaBeta::new(10.0, 0.0), 0.0);
        let i = AlphaBeta::new(0.0, 5.0);
        let psi_r = CONFIG.rotor_flux(&AlphaBeta::new(10.0, 0.0), &i);
        let slip = est.step(&CONFIG, &psi_r, &i).omega_r;
        assert!((psi_r.im() + 0.5).abs() < 1e-12);
        assert!((slip - 0.05 * psi_r.cross(&i) / psi_r.norm_sq()).abs() < 1e-9);
    }

    #[test]
    fn slip_speed_and_angle_step_are_limited() {
        // A long interval and a rotor flux that stays a quarter turn ahead of the loop, whatever the loop does.
        let c = SpeedConfig { t_s: 0.3, ..CONFIG };
        for sign in [1.0, -1.0] {
            let mut est = SpeedEstimator::<f64>::default();
            est.start(&AlphaBeta::new(1.0, 0.0), 0.0);
            let mut out = SpeedEstimate::default();
            for _ in 0..2000 {
                let before = est.angle;
                let ahead = |x: AlphaBeta<f64>| AlphaBeta::new(-x.im(), x.re());
                let psi_r = ahead(before.axis()) * (0.15 * sign);
                let i = ahead(psi_r) * (sign * 5.0 / 0.15);
                out = est.step(&c, &psi_r, &i);
                let turn = before.to_field(&est.angle.axis());
                assert!(turn.im().abs() < 0.9 && turn.re() > 0.5, "{turn:?}");
            }
            assert_eq!((out.omega_r, out.omega_m), (sign, OMEGA_MAX * sign));
        }
    }

    #[test]
    fn a_rotor_flux_next_to_nothing_says_next_to_nothing() {
        let mut est = SpeedEstimator::<f64>::default();
        est.start(&AlphaBeta::new(1.0, 0.0), 0.0);
        let i = AlphaBeta::new(1.0, 0.0);
        let out = est.step(&CONFIG, &AlphaBeta::new(0.0, 1e-3), &i);
        assert!((out.omega_m - CONFIG.k_i * 0.01).abs() < 1e-9, "an error of a hundredth, not of one: {out:?}");
        assert!((out.omega_r + 0.005).abs() < 1e-9, "{out:?}");
    }
}
