//! Current control in estimated field coordinates.
//!
//! With the stator flux on the d axis the machine behind its leakage is
//! `σl_s di/dτ = u - r_s i - jω_s ψ_s - (dψ_R/dτ in field coordinates)`. Resistance and induced voltage are
//! fed forward from reference and estimate; a PI controller per axis does the rest,
//!
//! ```text
//! u* = k_p (i* - i) + x + r̂_s i* + jω̂_s ψ̂_s,     dx/dτ = k_i (i* - i + (u*_limited - u*)/k_p)
//! k_p = ω_c σl_s,   k_i = k_p ω_c / 5
//! ```
//!
//! The bracket is the anti-windup: the integrator sees the error that the limited voltage would have
//! asked for. The voltage vector is limited to the circle `|u*| <= u_max` with priority for the axis that sets the flux:
//!
//! ```text
//! |u_d| ≤ u_max/2,    |u_q| ≤ √(u_max² - u_d²)
//! ```
//!
//! With too little voltage the torque current falls, and the flux is what its controller asks for. A vector shortened
//! along its direction would lose the small `u_d` that lowers the flux, and stay short of voltage. The bound of `u_d`
//! leaves 87 % to `u_q`: without it the field would stop, which is full braking torque.

use crate::scalar::{QuickIntegrator, Real, likely};
use crate::space::Dq;
use crate::words::words;

/// Settings of the current controller.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct CurrentConfig<R: Real> {
    /// Proportional gain.
    pub k_p: R,
    /// Integral gain times the control period.
    pub k_i: R,
    /// `1/k_p`.
    pub inv_k_p: R,
}
words!(CurrentConfig: k_p, k_i, inv_k_p);

/// State of the current controller.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct CurrentController<R: Real> {
    x: [QuickIntegrator<R>; 2],
    /// Square of the last voltage reference before its limitation.
    u_sq: R,
}

impl<R: Real> CurrentController<R> {
    /// Forgets the past.
    pub fn start(&mut self) {
        *self = Self::default();
    }

    /// Square of the last voltage reference before its limitation.
    #[inline(always)]
    pub fn u_sq(&self) -> R {
        self.u_sq
    }

    /// One period; `u_ff` is the voltage fed forward. Returns the limited voltage reference.
    #[inline(always)]
    pub fn step(&mut self, c: &CurrentConfig<R>, i_ref: &Dq<R>, i: &Dq<R>, u_ff: &Dq<R>, u_max: R) -> Dq<R> {
        let error = *i_ref - *i;
        let x = Dq::new(self.x[0].value(), self.x[1].value());
        let u = error * c.k_p + x + *u_ff;
        self.x[0].add(c.k_i, error.re());
        self.x[1].add(c.k_i, error.im());
        let (n2, most) = (u.norm_sq(), u_max * u_max);
        self.u_sq = n2;
        let held = Dq::new(self.x[0].value(), self.x[1].value());
        // One comparison where reference and integrators are far within the limit: a sum of two squares is below it only
        // if each of them is. What the integrators hold is small beside what is fed forward.
        if likely(n2 + held.norm_sq() <= most) {
            return u;
        }
        let u_limited = if likely(n2 <= most) {
            u
        } else {
            let u_d = u.re().limit(u_max.half());
            let limited = Dq::new(u_d, u.im().limit((most - u_d * u_d).sqrt()));
            let cut = (limited - u) * c.inv_k_p;
            self.x[0].add(c.k_i, cut.re());
            self.x[1].add(c.k_i, cut.im());
            limited
        };
        // One comparison for both.
        let held = Dq::new(self.x[0].value(), self.x[1].value());
        if !likely(held.norm_sq() <= most) {
            self.x[0].limit(u_max);
            self.x[1].limit(u_max);
        }
        u_limited
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_saturation_integrator_and_feedforward_add_up_to_the_limited_voltage() {
        let c = CurrentConfig { k_p: 1.0, k_i: 0.03, inv_k_p: 1.0 };
        let mut ctrl = CurrentController::<f32>::default();
        let u_ff = Dq::new(0.3, 0.2);
        assert_eq!(ctrl.step(&c, &Dq::default(), &Dq::default(), &u_ff, 1.0), u_ff, "acts at once");
        for _ in 0..10_000 {
            let u = ctrl.step(&c, &Dq::new(3.0, 4.0), &Dq::default(), &u_ff, 1.0);
            assert!(u.norm_sq() < 1.0 + 1e-5);
        }
        let u = ctrl.step(&c, &Dq::default(), &Dq::default(), &u_ff, 1.0);
        let limit = Dq::new(0.5, 0.75f32.sqrt());
        assert!((u - limit).norm_sq() < 1e-8, "control goes on from where the limit was: {u:?}");
    }

    #[test]
    fn the_axis_of_the_flux_comes_first_and_leaves_the_torque_most_of_the_voltage() {
        let c = CurrentConfig { k_p: 1.0, k_i: 0.0, inv_k_p: 1.0 };
        let u = |d: f64, q: f64| {
            let mut ctrl = CurrentController::<f64>::default();
            let u = ctrl.step(&c, &Dq::new(d, q), &Dq::default(), &Dq::default(), 1.0);
            assert!((ctrl.u_sq() - d * d - q * q).abs() < 1e-12, "before the limitation");
            (u.re(), u.im())
        };
        assert_eq!(u(-0.1, 5.0), (-0.1, 0.99f64.sqrt()), "a small u_d beside a large u_q is kept as it is");
        assert_eq!(u(0.1, -5.0), (0.1, -0.99f64.sqrt()));
        assert_eq!(u(-5.0, 5.0), (-0.5, 0.75f64.sqrt()));
        assert_eq!(u(-5.0, 0.3), (-0.5, 0.3));
    }

    #[test]
    fn the_integrator_never_holds_more_than_the_voltage_there_is() {
        let c = CurrentConfig { k_p: 1.0, k_i: 0.03, inv_k_p: 1.0 };
        for sign in [1.0, -1.0] {
            let mut ctrl = CurrentController::<f64>::default();
            // A voltage fed forward that the limit cannot follow; both axes.
            for _ in 0..1000 {
                let i_ref = Dq::new(sign, -sign);
                ctrl.step(&c, &i_ref, &Dq::default(), &Dq::new(-4.0 * sign, 4.0 * sign), 1.0);
            }
            // Beyond half of the voltage the limit of u_d would hide what its integrator holds.
            let u = ctrl.step(&c, &Dq::new(-0.9 * sign, 0.5 * sign), &Dq::default(), &Dq::default(), 1.0);
            assert!(sign * u.re() < 0.101 && -sign * u.im() < 0.501, "{u:?}");
        }
    }

    #[test]
    fn the_current_recovers_from_saturation_as_fast_as_the_integrator_acts() {
        // σl_s di/dτ = u - r i - e, with an induced voltage that leaves no voltage for the current asked for.
        let (r, l, t_s, e) = (0.08, 0.143, 0.03, Dq::new(0.0, 0.9));
        let c = CurrentConfig { k_p: 0.8, k_i: t_s * 0.9, inv_k_p: 1.25 };
        let integrator_time = (c.k_p / c.k_i) as u32;
        let mut ctrl = CurrentController::<f64>::default();
        let (mut i, mut settled) = (Dq::new(0.6, 0.0), None);
        for k in 0..4000 {
            let i_ref = Dq::new(0.6, if k < 3000 { 1.5 } else { 0.2 });
            let u = ctrl.step(&c, &i_ref, &i, &(i_ref * r + e), 1.0);
            i += (u - i * r - e) * (t_s / l);
            let away = (i - i_ref).norm_sq() > 0.02 * 0.02;
            assert!(away || k >= 3000, "in saturation");
            settled = if away { None } else { settled.or(Some(k - 3000)) };
        }
        assert!(settled.is_some_and(|n| n < 3 * integrator_time), "{settled:?} of {integrator_time} periods");
    }

    #[test]
    fn removes_the_steady_error_of_a_first_order_plant() {
        let c = CurrentConfig { k_p: 0.8, k_i: 0.03 * 0.9, inv_k_p: 1.25 };
        let mut ctrl = CurrentController::<f64>::default();
        let mut i = Dq::<f64>::default();
        for _ in 0..3000 {
            let u = ctrl.step(&c, &Dq::new(0.6, 0.3), &i, &Dq::default(), 1.0);
            i += (u - i * 0.08) * (0.03 / 0.143);
        }
        assert!((i - Dq::new(0.6, 0.3)).norm_sq() < 1e-12);
    }
}
