//! Field weakening: the flux reference at the limit of the voltage, per unit.
//!
//! In field coordinates the stator voltage of a steady state is `u_d = r_s i_d`, `u_q = r_s i_q + ω_s ψ_s`, with the slip
//! `ω_r = r_R i_q ψ_s/|ψ_R|²`. The largest flux at which there is voltage for the torque current `i_q` that is wanted
//! follows from the largest voltage `u_max`; a voltage controller corrects it by what the current controller asks for,
//!
//! ```text
//! ψ* = min(ψ_rated, (κ u_max - r' i_q sgn ω)/|ω|),    at least psi_min,    r' = r_s + r_R (|ψ_s|/|ψ_R|)²
//! dκ/dτ = k (U² - |u*|²/u_max,N²),    0.9 ≤ κ ≤ U = 0.97
//! ```
//!
//! `u*` is the voltage reference before its limitation. `κ` is not lowered while the flux is above its reference: then
//! the voltage is short because the flux has not yet followed. With the torque current that flows in place of the wanted
//! one the flux would stay at what leaves no voltage for more. The induced voltage is what the flux estimators measure,
//! so the first equation alone is good to the errors of resistance and inverter model; the controller removes those, and
//! gives way where the link is lower than measured.
//!
//! **Validity.** `ω` has to be known to about a percent, which holds wherever the voltage limit is met. Below it, `ψ*`
//! is the rated flux and `κ = U`. `|ψ_s|/|ψ_R|` is taken as constant, that at 80 % of pull-out.
//!
//! **A flux that lags.** After a step across the range the reference may rise faster than the current limit lets the flux follow,
//! at a motor of 134 kW from half to all of rated flux within a tenth of its rotor time constant. It rises to
//! [`AHEAD_OF_FLUX`] above the flux and no further, which [`crate::supervision`] takes for what it is, a flux that follows; it is not
//! lowered with a flux that falls.
//!
//! **Ripple of the link.** Where the voltage reference is at its limit, the torque current is limited to the one that flows
//! ([`crate::drive`]). A rectified link has that voltage and more by turns, 100 or 300 times a second: with 2 % of it a current
//! of `0.02/(ω_s σl_s)`, at large motors more than the rated one. A reference that follows asks for what the mean voltage
//! cannot drive. So the limit rises by [`RISE`] only. The flux is weakened for the least voltage, too: `u_max` falls at once
//! and rises by [`RISE_OF_VOLTAGE`] while it is. Otherwise, at a speed where the voltage is enough for the rated flux
//! by turns, the reference would step as often between it and a weaker one, with a current of a sixth of rated peak by each
//! step (3 kHz, 60 Hz, 2 % of ripple at 100 Hz).

use crate::scalar::{Integrator, Real, clamp_seldom, likely};
use crate::words::words;

/// Part of the largest voltage that the voltage controller leaves to the steady state; the rest is for current control.
pub(crate) const UTILISATION: f64 = 0.97;
/// Least part.
const UTILISATION_MIN: f64 = 0.9;
/// Rise of the largest torque current where the voltage is no longer at its limit, per unit in a second: in half a period of the
/// ripple of a three-phase rectifier 0.17 pu. Allowance.
pub(crate) const RISE: f64 = 100.0;
/// Rise of the voltage that the flux is weakened for, per unit in a second: in a period of the ripple of a single-phase rectifier
/// 0.005 pu. Allowance.
pub(crate) const RISE_OF_VOLTAGE: f64 = 0.5;
/// A limit of the torque current, or of the voltage, that is none, per unit, and the one from which on it counts as none.
pub(crate) const FREE: f64 = 100.0;
const I_Q_MAX: f64 = 3.0;
/// Flux reference above the flux, per unit, up to which it rises: three quarters of the deviation that is a fault.
const AHEAD_OF_FLUX: f64 = 0.3;
/// Lag of the flux behind its reference, per unit, from which on torque gives way to it: half of that. Allowance.
pub(crate) const LAG_ALLOWED: f64 = 0.15;
/// Excess of the flux over its reference, per unit, from which on the flux has not yet followed.
const LAGGING: f64 = 0.01;

/// Settings of field weakening.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct WeakeningConfig<R: Real> {
    /// Smallest flux reference, per unit as all of these.
    pub psi_min: R,
    /// `r'`.
    pub resistance: R,
    /// Gain of the voltage controller times the time between two calls.
    pub k: R,
    /// `1/u_max²` at the rated dc link.
    pub inv_u_max_sq: R,
    /// [`RISE`] times the time between two references.
    pub rise: R,
    /// [`RISE_OF_VOLTAGE`] times the time between two calls.
    pub rise_of_voltage: R,
}
impl<R: Real> WeakeningConfig<R> {
    /// Of a smallest flux reference, `r'`, the gain of the voltage controller, `1/u_max²` and the rises of torque current and
    /// voltage.
    pub fn new(psi_min: R, resistance: R, k: R, inv_u_max_sq: R, (rise, rise_of_voltage): (R, R)) -> Self {
        Self { psi_min, resistance, k, inv_u_max_sq, rise, rise_of_voltage }
    }

    /// A flux, at least the smallest reference.
    #[inline(always)]
    pub fn at_least(&self, psi_s: R) -> R {
        psi_s.max(self.psi_min)
    }
}
words!(WeakeningConfig: psi_min, resistance, k, inv_u_max_sq, rise, rise_of_voltage);

/// State of field weakening.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Weakening<R: Real> {
    /// `κ`.
    part: Integrator<R>,
    /// `ψ*` of the last call.
    psi_ref: R,
    /// Flux reference as the voltage allows it; zero while the current of a start follows a flux that builds up.
    most: R,
    /// Torque current that the voltage allows.
    i_q_most: R,
    /// Largest voltage, on which the flux reference counts.
    u_max: R,
}

impl<R: Real> Default for Weakening<R> {
    fn default() -> Self {
        Self {
            part: Integrator::new(R::from_f64(UTILISATION)),
            psi_ref: R::ZERO,
            most: R::ZERO,
            i_q_most: R::from_f64(FREE),
            u_max: R::from_f64(FREE),
        }
    }
}

impl<R: Real> Weakening<R> {
    /// A start-up begins, to rated flux.
    pub fn begin(&mut self, psi_rated: R) {
        self.most = psi_rated;
    }

    /// The current of a start follows a flux that builds up.
    pub fn follow_flux(&mut self) {
        (self.most, self.u_max) = (R::ZERO, R::from_f64(FREE));
    }

    /// Begins anew at rated flux.
    pub fn start(&mut self, psi_rated: R) {
        *self = Self { most: psi_rated, ..Self::default() };
    }

    /// Flux reference as the voltage allows it.
    #[inline(always)]
    pub fn most(&self, _psi_rated: R) -> R {
        self.most
    }

    /// Whether that is the rated one.
    #[inline(always)]
    pub fn is_rated(&self, psi_rated: R) -> bool {
        self.most == psi_rated
    }

    /// Whether the flux reference of a drive that runs is below it.
    #[inline(always)]
    pub fn is_weak(&self, psi_rated: R) -> bool {
        !self.is_rated(psi_rated)
    }

    /// Whether the voltage, now or of late, limits the torque current.
    #[inline(always)]
    pub fn limits_torque(&self) -> bool {
        self.i_q_most < R::from_f64(FREE)
    }

    /// Torque current that the voltage allows; `now`: the one at the limit of the voltage, None where it is not there.
    #[inline(always)]
    pub fn torque_current(&mut self, c: &WeakeningConfig<R>, now: Option<R>, psi_rated: R) -> R {
        let most = now.unwrap_or(self.i_q_most + c.rise);
        self.i_q_most = if self.is_rated(psi_rated) || most > R::from_f64(I_Q_MAX) { R::from_f64(FREE) } else { most };
        most
    }

    /// [`Self::step`] as the flux reference from now on; whether field weakening ends with it.
    #[inline(always)]
    pub fn limit(
        &mut self,
        c: &WeakeningConfig<R>,
        omega: R,
        i_q: R,
        (psi_rated, psi_s): (R, R),
        (u_max, u_sq): (R, R),
    ) -> bool {
        let before = if self.is_rated(psi_rated) { R::from_f64(FREE) } else { self.u_max };
        self.u_max = u_max.min(before + c.rise_of_voltage);
        let most = self.step(c, omega, i_q, (psi_rated, psi_s), (self.u_max, u_sq));
        let most = most.min(self.most.max(psi_s + R::from_f64(AHEAD_OF_FLUX)));
        let ends = most == psi_rated && self.most != most;
        self.most = most;
        ends
    }

    /// One call: `ψ*` at a speed `omega` (electrical), for a torque current, with the rated flux and the one that there is, the
    /// largest voltage and the square of the voltage reference.
    #[inline(always)]
    pub fn step(
        &mut self,
        c: &WeakeningConfig<R>,
        omega: R,
        i_q: R,
        (psi_rated, psi_s): (R, R),
        (u_max, u_sq): (R, R),
    ) -> R {
        let drop = c.resistance * if omega < R::ZERO { -i_q } else { i_q };
        let (omega, part) = (omega.abs(), self.part.value());
        self.psi_ref = if likely(omega * psi_rated <= part * u_max - drop) {
            self.part.set(R::from_f64(UTILISATION));
            psi_rated
        } else {
            let mut left = R::from_f64(UTILISATION * UTILISATION) - u_sq * c.inv_u_max_sq;
            if psi_s > self.psi_ref + R::from_f64(LAGGING) {
                left = left.max(R::ZERO);
            }
            self.part.add_clamped(c.k, left, R::from_f64(UTILISATION_MIN), R::from_f64(UTILISATION));
            clamp_seldom((part * u_max - drop) * omega.recip(), c.psi_min, psi_rated)
        };
        self.psi_ref
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const R: f64 = 0.12;
    const CONFIG: WeakeningConfig<f64> =
        WeakeningConfig { psi_min: 0.2, resistance: R, k: 0.01, inv_u_max_sq: 1.0, rise: 0.01, rise_of_voltage: 1e-3 };

    /// `ψ*` with a voltage reference that leaves the voltage controller where it is.
    fn reference(omega: f64, i_q: f64) -> f64 {
        Weakening::default().step(&CONFIG, omega, i_q, (1.0, 1.0), (1.0, 0.9))
    }

    #[test]
    fn below_the_voltage_limit_the_flux_is_rated() {
        for (omega, i_q) in [(0.0, 1.5), (0.5, 1.5), (-0.9, 0.0), (0.96, 0.0), (1.0, -0.5)] {
            assert_eq!(reference(omega, i_q), 1.0, "{omega} {i_q}");
        }
    }

    #[test]
    fn beyond_it_the_steady_state_voltage_is_the_utilised_one_in_all_four_quadrants() {
        for (omega, i_q) in [(2.0, 1.0), (2.0, -1.0), (-2.0, -1.0), (-2.0, 1.0), (1.1, 0.0)] {
            let u_q = omega * reference(omega, i_q) + R * i_q;
            assert!((u_q.abs() - UTILISATION).abs() < 1e-12, "{omega} {i_q}: {u_q}");
        }
        assert_eq!(reference(100.0, 0.0), 0.2);
    }

    #[test]
    fn the_voltage_controller_takes_flux_off_until_the_voltage_asked_for_is_there() {
        // The machine needs 4 % more voltage than the equation knows of.
        let mut weakening = Weakening::default();
        let mut psi = 0.4;
        for _ in 0..3000 {
            let u = 1.04 * 2.0 * psi;
            psi = weakening.step(&CONFIG, 2.0, 0.0, (1.0, psi), (1.0, u * u));
        }
        assert!((1.04 * 2.0 * psi - UTILISATION).abs() < 1e-3, "{psi}");
    }

    #[test]
    fn a_ripple_of_the_link_does_not_move_the_flux_reference_to_and_fro() {
        // 2 % of ripple, and a speed at which its mean is enough for the rated flux.
        let span = |rise_of_voltage: f64| {
            let (c, mut weakening) = (WeakeningConfig { rise_of_voltage, ..CONFIG }, Weakening::default());
            weakening.start(1.0);
            let (mut lo, mut hi, mut ends) = (1.0_f64, 0.0_f64, 0);
            for k in 0..300 {
                let u_max = 1.0 + 0.02 * (0.6 * f64::from(k)).sin();
                ends += u32::from(weakening.limit(&c, 0.965, 0.0, (1.0, 0.99), (u_max, 0.9 * 0.9)));
                if k > 20 {
                    (lo, hi) = (lo.min(weakening.most(1.0)), hi.max(weakening.most(1.0)));
                }
            }
            (hi - lo, ends)
        };
        let (swing, ends) = span(CONFIG.rise_of_voltage);
        assert!(swing < 0.012 && ends == 0, "{swing} {ends}");
        let (swing, ends) = span(1.0);
        assert!(swing > 0.013 && ends > 20, "a reference that follows the link: {swing} {ends}");
    }

    #[test]
    fn the_reference_rises_no_further_than_the_flux_may_lag_and_does_not_fall_with_the_flux() {
        let mut weakening = Weakening::default();
        weakening.start(1.0);
        let mut reference = |omega, psi_s, expected: f64, what: &str| {
            weakening.limit(&CONFIG, omega, 0.0, (1.0, psi_s), (1.0, 0.9));
            let found = weakening.most(1.0);
            assert!((found - expected).abs() < 1e-3, "{what}: {found}");
        };
        reference(2.0, 0.5, 0.485, "by the voltage");
        reference(0.5, 0.5, 0.8, "the voltage is there for rated flux, which takes a rotor time constant");
        reference(0.5, 0.6, 0.9, "a flux that follows");
        reference(0.5, 0.2, 0.9, "a flux that is lost");
        reference(0.5, 0.75, 1.0, "a flux that is near");
        reference(0.5, 0.2, 1.0, "beyond field weakening");
        reference(2.0, 0.2, 0.485, "less voltage counts at once");
    }

    #[test]
    fn the_torque_current_rises_slowly_after_the_limit_of_the_voltage_and_is_free_for_braking() {
        let mut weakening = Weakening::default();
        let mut current =
            |now, psi_rated| (weakening.torque_current(&CONFIG, now, psi_rated), weakening.limits_torque());
        // Below field weakening nothing is remembered.
        assert_eq!(current(Some(0.6), 0.0), (0.6, false));
        assert_eq!(current(Some(0.6), 1.0), (0.6, true));
        assert_eq!(current(None, 1.0), (0.61, true));
        assert_eq!(current(None, 1.0), (0.62, true));
        assert_eq!(current(Some(0.5), 1.0), (0.5, true));
        assert_eq!(current(Some(FREE), 1.0), (FREE, false));
        // It ends by itself.
        assert_eq!(current(Some(2.98), 1.0), (2.98, true));
        assert!(current(None, 1.0).1);
        assert!((0..3).map(|_| current(None, 1.0).1).any(|limits| !limits));
    }

    #[test]
    fn it_does_not_while_the_flux_has_not_yet_followed() {
        let mut weakening = Weakening::default();
        let psi = (0..3000).map(|_| weakening.step(&CONFIG, 2.0, 0.0, (1.0, 0.7), (1.0, 2.0))).last();
        assert_eq!(psi, Some(UTILISATION / 2.0));
    }
}
