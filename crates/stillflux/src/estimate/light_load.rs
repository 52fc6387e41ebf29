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
//! `û_i` and `i_s` are low-pass filtered in field coordinates before the products: `ω_s l_s i_s² - q` is a small difference
//! (0.7 % of either at 6 % load), and what the bridge adds to the current at five and seven times ω_s, 4 % of it at 11 kW,
//! would count in `i_s²` with `l_s` and in `q` with `σl_s`: 5 % of r_s. `û_i` is a mean over the period at whose end `i_s`
//! is sampled, so that it lags by half a period and is turned on by that (0.7 % of r_s at 11 kW and ω_s = 0.075). The flux of the estimator would not do: in steady state it is at
//! right angles to its own `û_i` whatever r̂_s is, since it is its integral.
//!
//! The gain `g` follows from the rotor time constant. A change `Δr` of r̂_s changes the flux of the machine by up to
//! `Δr i_s/ω_s`, and until that has settled, for τ_r, `l_s i_s² - D` is off by as much: for light load an apparent error
//! of the resistance several times `Δr`. So `1/(g i_s²)` has to be many τ_r: at 2 τ_r r̂_s swings by a quarter of itself
//! at 11 kW even on an ideal bridge, at 6 τ_r it overshoots by half of its change.
//!
//! Validity. The root vanishes without load, where an error of 1 % of l_s appears as `T = 0.1 l_s i_s²`: the error of r̂_s
//! is `ω_s T/i_s²`, proportional to the frequency. Towards zero frequency the errors of the inverter model in `q/ω_s`
//! grow as 1/ω_s. Between the two lies the range, a setting. Where |i_q| is large enough for (15) the method rests and
//! [`super::resistance`] goes on with the same integrator.

use crate::scalar::{Integrator, Real};
use crate::space::Dq;
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
    /// Half a control period, normalised.
    pub half_period: R,
    /// Calls after which filters and flux have settled.
    pub settle: u32,
    /// Smallest `|ω_s|`.
    pub omega_min: R,
    /// Largest `|ω_s|`.
    pub omega_max: R,
}
words!(LightLoadConfig: l_s, sigma_l_s, corner, gain, half_period, settle, omega_min, omega_max);

/// State: filtered voltage and current, and for how many calls they have been of the range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct LightLoad<R: Real> {
    u_i: [Integrator<R>; 2],
    i_s: [Integrator<R>; 2],
    within: u32,
}

impl<R: Real> LightLoad<R> {
    /// One call with the induced voltage and the current in field coordinates; returns `(r_s - r̂_s) i_s²`, or nothing where the method
    /// rests. `light`: the load is light and steady.
    pub fn step(
        &mut self,
        c: &LightLoadConfig<R>,
        u_i: &Dq<R>,
        i_s: &Dq<R>,
        omega_s: R,
        i_q: R,
        light: bool,
    ) -> Option<R> {
        let omega = omega_s.abs();
        if !light || omega < c.omega_min || omega > c.omega_max {
            self.within = 0;
            return None;
        }
        if self.within == 0 {
            self.u_i = [u_i.re(), u_i.im()].map(Integrator::new);
            self.i_s = [i_s.re(), i_s.im()].map(Integrator::new);
        }
        let follow = |state: &mut [Integrator<R>; 2], x: &Dq<R>| {
            let before = Dq::new(state[0].value(), state[1].value());
            Dq::new(state[0].add(c.corner, x.re() - before.re()), state[1].add(c.corner, x.im() - before.im()))
        };
        let (u_i, i_s) = (follow(&mut self.u_i, u_i), follow(&mut self.i_s, i_s));
        self.within = self.within.saturating_add(1);
        if self.within < c.settle {
            return None;
        }
        let lag = omega_s * c.half_period;
        let u_i = Dq::new(u_i.re() - lag * u_i.im(), u_i.im() + lag * u_i.re());
        let negative = omega_s < R::ZERO;
        let q = i_s.cross(&u_i);
        let (p, q) = (u_i.dot(&i_s), if negative { -q } else { q });
        let wi = omega * i_s.norm_sq();
        // A root each: the reciprocal root of the product would be beyond the range of fixed point.
        let air_gap = (wi * c.l_s - q).max(R::ZERO).sqrt() * (q - wi * c.sigma_l_s).max(R::ZERO).sqrt();
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
        half_period: 0.0,
        settle: 100,
        omega_min: 0.03,
        omega_max: 0.3,
    };

    /// What the method finds over i_s² on the Heyland circle at i_q, at an induced voltage for r_s.
    fn found_at(c: &LightLoadConfig<f64>, omega: f64, i_q: f64, u_i: Dq<f64>) -> Option<f64> {
        let i = current(i_q);
        let mut est = LightLoad::default();
        let mut last = None;
        for _ in 0..2000 {
            last = est.step(c, &u_i, &i, omega, i_q, true);
        }
        last.map(|x| x / i.norm_sq())
    }

    /// Current at rated flux.
    fn current(i_q: f64) -> Dq<f64> {
        let (l, s) = (CONFIG.l_s, CONFIG.sigma_l_s);
        let b = l + s;
        Dq::new((b - (b * b - 4.0 * l * s * (1.0 + l * s * i_q * i_q)).sqrt()) / (2.0 * l * s), i_q)
    }

    /// The same with r̂_s wrong by `delta`.
    fn found(omega: f64, i_q: f64, delta: f64) -> Option<f64> {
        found_at(&CONFIG, omega, i_q, Dq::new(0.0, omega) + current(i_q) * delta)
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
    fn a_voltage_that_lags_by_half_a_period_is_not_taken_for_resistance() {
        for omega in [0.1_f64, -0.1] {
            let [corrected, taken] = [0.02, 0.0].map(|half_period| {
                let (sin, cos) = (omega * 0.02).sin_cos();
                found_at(&LightLoadConfig { half_period, ..CONFIG }, omega, 0.1, Dq::new(omega * sin, omega * cos))
                    .unwrap()
            });
            assert!(corrected.abs() < 0.05 * taken.abs(), "{corrected} {taken}");
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
        let (mut est, i) = (LightLoad::default(), Dq::new(0.6, 0.0));
        let u = Dq::new(0.01, 0.05);
        for k in 0..300 {
            let found = est.step(&CONFIG, &u, &i, 0.05, 0.0, k != 150);
            assert_eq!(found.is_some(), (99..150).contains(&k) || k >= 250, "{k}");
        }
    }
}
