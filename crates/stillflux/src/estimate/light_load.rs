//! Stator resistance at light load: the induced voltage stands at right angles to the flux, after [9] of the paper
//! (Section III-E: "preferred at light load, but its use must be inhibited at very low speed").
//!
//! In steady state `u_s = r_s i_s + jω_s ψ_s`. The product `q = i_s × u_s = ω_s ψ_s · i_s` does not contain r_s, and with
//! `D = q/ω_s` equation (14) gives the torque without it either:
//!
//! ```text
//! |ψ_s|² = (l_s + σl_s) D - l_s σl_s i_s²                                          (14)
//! (ψ_s × i_s)² = |ψ_s|² i_s² - D² = (l_s i_s² - D)(D - σl_s i_s²)
//! u_s · i_s = r_s i_s² + ω_s ψ_s × i_s
//! ```
//!
//! so that with `û_i = u_s - r̂_s i_s` the error of the resistance is, without a division,
//!
//! ```text
//! (r_s - r̂_s) i_s² = û_i · i_s - sign(ω_s i_q) √[(ω_s l_s i_s² - q)(q - ω_s σl_s i_s²)]
//! dr̂_s/dτ = g (r_s - r̂_s) i_s²
//! ```
//!
//! The products are low-pass filtered before the root. The flux of the estimator would not do: in steady state it is at
//! right angles to its own `û_i` whatever r̂_s is, since it is its integral.
//!
//! Validity. The root vanishes without load, where an error of 1 % of l_s appears as `T = 0.1 l_s i_s²`: the error of r̂_s
//! is `ω_s T/i_s²`, proportional to the frequency. Towards zero frequency the errors of the inverter model in `q/ω_s`
//! grow as 1/ω_s. Between the two lies the range, a setting. Where |i_q| is large enough for (15) the method rests and
//! [`super::resistance`] goes on with the same integrator.

use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;
use crate::words::words;

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct LightLoadConfig<R: Real> {
    /// `l_s`.
    pub l_s: R,
    /// `σl_s`.
    pub sigma_l_s: R,
    /// Corner frequency of the low-pass filters times the time between two calls.
    pub corner: R,
    /// Gain `g` times the time between two calls.
    pub gain: R,
    /// Calls after which the filters have settled.
    pub settle: u32,
    /// Smallest `|ω_s|`.
    pub omega_min: R,
    /// Largest `|ω_s|`.
    pub omega_max: R,
}
words!(LightLoadConfig: l_s, sigma_l_s, corner, gain, settle, omega_min, omega_max);

/// State: the filtered products, and for how many calls they have been of the range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct LightLoad<R: Real> {
    p: Integrator<R>,
    q: Integrator<R>,
    i_sq: Integrator<R>,
    within: u32,
}

impl<R: Real> LightLoad<R> {
    /// One call with the induced voltage and the current; returns `(r_s - r̂_s) i_s²`, or nothing where the method
    /// rests. `light`: the load is light and steady.
    pub fn step(
        &mut self,
        c: &LightLoadConfig<R>,
        u_i: &AlphaBeta<R>,
        i_s: &AlphaBeta<R>,
        omega_s: R,
        i_q: R,
        light: bool,
    ) -> Option<R> {
        let omega = omega_s.abs();
        if !light || omega < c.omega_min || omega > c.omega_max {
            self.within = 0;
            return None;
        }
        let negative = omega_s < R::ZERO;
        let q = i_s.cross(u_i);
        let (p, q, i_sq) = (u_i.dot(i_s), if negative { -q } else { q }, i_s.norm_sq());
        if self.within == 0 {
            (self.p, self.q, self.i_sq) = (Integrator::new(p), Integrator::new(q), Integrator::new(i_sq));
        }
        let follow = |state: &mut Integrator<R>, x: R| {
            let before = state.value();
            state.add(c.corner, x - before)
        };
        let (p, q, i_sq) = (follow(&mut self.p, p), follow(&mut self.q, q), follow(&mut self.i_sq, i_sq));
        self.within = self.within.saturating_add(1);
        if self.within < c.settle {
            return None;
        }
        let wi = omega * i_sq;
        let air_gap = ((wi * c.l_s - q) * (q - wi * c.sigma_l_s)).max(R::ZERO).sqrt();
        Some(if (i_q < R::ZERO) == negative { p - air_gap } else { p + air_gap })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: LightLoadConfig<f64> = LightLoadConfig {
        l_s: 1.67,
        sigma_l_s: 0.143,
        corner: 0.01,
        gain: 1e-3,
        settle: 100,
        omega_min: 0.03,
        omega_max: 0.3,
    };

    /// What the method finds on the Heyland circle at i_q with r̂_s wrong by `delta`, over i_s².
    fn found(omega: f64, i_q: f64, delta: f64) -> Option<f64> {
        let (l, s) = (CONFIG.l_s, CONFIG.sigma_l_s);
        let b = l + s;
        let i_d = (b - (b * b - 4.0 * l * s * (1.0 + l * s * i_q * i_q)).sqrt()) / (2.0 * l * s);
        let i = AlphaBeta::new(i_d, i_q);
        let u_i = AlphaBeta::new(0.0, omega) + i * delta;
        let mut est = LightLoad::default();
        let mut last = None;
        for _ in 0..2000 {
            last = est.step(&CONFIG, &u_i, &i, omega, i_q, true);
        }
        last.map(|x| x / i.norm_sq())
    }

    #[test]
    fn the_error_of_the_resistance_is_found_in_every_quadrant() {
        for omega in [0.05, -0.05, 0.2] {
            for i_q in [0.05, -0.05, 0.1] {
                for delta in [0.02, -0.02, 0.0] {
                    let x = found(omega, i_q, delta).unwrap();
                    assert!((x - delta).abs() < 1e-6, "{omega} {i_q} {delta}: {x}");
                }
            }
        }
    }

    #[test]
    fn it_rests_at_very_low_and_at_high_speed() {
        for omega in [0.0, 0.02, -0.02, 0.4] {
            assert_eq!(found(omega, 0.05, 0.02), None);
        }
    }

    #[test]
    fn it_begins_anew_after_a_time_outside_its_range() {
        let (mut est, i) = (LightLoad::default(), AlphaBeta::new(0.6, 0.0));
        let u = AlphaBeta::new(0.01, 0.05);
        for k in 0..300 {
            let found = est.step(&CONFIG, &u, &i, 0.05, 0.0, k != 150);
            assert_eq!(found.is_some(), (99..150).contains(&k) || k >= 250, "{k}");
        }
    }
}
