//! Slow rotation during the magnetisation of a start: a shaft that something else turns below what the search
//! ([`super::search`]) finds. Per unit.
//!
//! In a machine that turns at `x = ω τ_r` a direct current builds up a flux that is not along it:
//!
//! ```text
//! τ_r dψ_R/dτ = ψ_0 - (1 - jx) ψ_R,     ψ_0 = l_M i_α              ψ_R = ψ_0/(1 - jx) in the end
//! ```
//!
//! 45° at `x` = 1, which is 0.03 pu at 2.2 kW and 0.0025 pu at 160 kW. Taken for the flux of a machine at rest the field of the start
//! is off by this angle. The flux *across* the current is known: no current flows there, so that neither the resistance nor the loss
//! of the bridge, which is along the current, has a part in
//!
//! ```text
//! ψ_Rβ = ∫(u - r_s i)_β dτ - σl_s i_β
//! ```
//!
//! What offsets, gains and legs add to it grows with the time, the flux itself has settled after some `τ_r`: it is watched for
//! [`WINDOW`] of them. At rest it was 0.060 at most with every parameter off (400 installations of ten drives, half of them with
//! effects that the drive has no model for). From [`ACROSS`] on the machine turns. Its speed and the flux along the current, in which the voltage has the errors of resistance and bridge, follow
//! from the rotor equation integrated over the build-up, time in units of `τ_r`:
//!
//! ```text
//! x = (ψ_Rβ + ∫ψ_Rβ)/∫ψ_Rα,     ψ_Rα' = ψ_0 - ψ_Rα - x ψ_Rβ
//! ```
//!
//! Below [`FAR`] the start goes on as at standstill, which identifies resistance and bridge, with the flux where it is; from
//! there on the flux is lower than half of the rated one's square, and the current follows it as in a machine that the search
//! has found to turn.

use super::search::Found;
use crate::base::{PerUnit, rounded};
use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;
use crate::words::words;

/// Flux across the current, per unit, of a machine that turns: twice what machines at rest have shown.
const ACROSS: f64 = 0.12;
/// Rotor time constants in which it is looked for.
const WINDOW: f64 = 4.0;
/// `x` from which on the current follows the flux.
const FAR: f64 = 1.0;
/// Largest `x` of a machine that the search has not found to turn.
const FASTEST: f64 = 40.0;
/// Standard deviation of the flux along the current by the rotor equation. Allowance: rotor resistance and inductance off by a tenth.
const UNKNOWN: f64 = 0.05;
/// Largest integral of the voltage along the current, per unit: some fluxes more than its errors make of it.
const INTEGRAL_MOST: f64 = 40.0;
/// Least `∫ψ_Rα`.
const FLOOR: f64 = 0.01;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct SlowTurnConfig<R: Real> {
    /// Control period, in normalised time and, times 64, relative to `τ_r`.
    t_s: R,
    part: R,
    /// `1/τ_r`.
    inv_tau_r: R,
    l_m: R,
    /// Periods in which a slow rotation is looked for.
    pub periods: u32,
}
words!(SlowTurnConfig: t_s, part, inv_tau_r, l_m, periods);

impl<R: Real> SlowTurnConfig<R> {
    /// For a machine; not `on`: nothing is found.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(pu: &PerUnit, on: bool) -> Self {
        Self {
            t_s: rounded(pu.t_s),
            part: rounded(64.0 * pu.t_s / pu.tau_r),
            inv_tau_r: rounded(1.0 / pu.tau_r),
            l_m: rounded(pu.l_m),
            periods: if on { (WINDOW * pu.tau_r / pu.t_s) as u32 } else { 0 },
        }
    }
}

/// State.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct SlowTurn<R: Real> {
    /// Integrals of the voltage along the current and across it.
    psi_s: [Integrator<R>; 2],
    /// `ψ_Rα`, and the integrals of both components.
    along: Integrator<R>,
    sum_along: Integrator<R>,
    sum_across: Integrator<R>,
    /// `x` while the flux across the current shows it, else zero.
    x: R,
}

impl<R: Real> SlowTurn<R> {
    /// One period of the build-up, counted from one: with the voltage `u - r_s i` since the last one, the current, and `σl_s`. What is
    /// found of a machine that turns so fast that the current is to follow it.
    #[cold]
    #[inline(never)]
    pub fn step(
        &mut self,
        c: &SlowTurnConfig<R>,
        period: u32,
        u_i: &AlphaBeta<R>,
        i_s: &AlphaBeta<R>,
        sigma_l_s: R,
    ) -> Option<Found<R>> {
        let r = R::from_f64;
        let part = |x: R| x * r(1.0 / 64.0);
        let integral = self.psi_s[0].add_limited(c.t_s, u_i.re(), r(INTEGRAL_MOST)) - sigma_l_s * i_s.re();
        let across = self.psi_s[1].add_limited(c.t_s, u_i.im(), R::TWO) - sigma_l_s * i_s.im();
        let swept = across + self.sum_across.add_limited(c.part, part(across), r(FASTEST));
        let x = (swept * self.sum_along.value().max(r(FLOOR)).recip()).limit(r(FASTEST));
        let along = self.along.value();
        let along = self.along.add_limited(c.part, part(c.l_m * i_s.re() - along - x * across), R::TWO);
        self.sum_along.add_limited(c.part, part(along), r(FASTEST));
        self.x = if across.within(r(ACROSS)) { R::ZERO } else { x };
        (!self.x.within(r(FAR))).then(|| Found {
            omega: x * c.inv_tau_r,
            psi_r: Some(AlphaBeta::new(along, across)),
            error: Some([integral - along, r(UNKNOWN)].map(|x| x * (c.t_s * r(64.0)).periods(period).recip()).into()),
        })
    }

    /// Rotor flux in the end, relative to that at rest, and speed of a machine in which the current keeps its direction; `None`
    /// of one at rest.
    pub fn dragged(&self, c: &SlowTurnConfig<R>) -> Option<(AlphaBeta<R>, R)> {
        (self.x != R::ZERO).then(|| {
            let x = self.x.limit(R::from_f64(FAR));
            let along = (R::ONE + x * x).recip();
            (AlphaBeta::new(along, x * along), x * c.inv_tau_r)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::PerUnit;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;

    /// Build-up by the current of rated flux in a machine whose rotor turns at `x`: deviation of the flux that is found, speed over
    /// the true one, and whether the current is to follow it; `None`: it was not found.
    fn build_up<R: Real>(machine: Machine, inverter: Inverter, x: f64, tau_r: f64) -> Option<(f64, f64, bool)> {
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let c = SlowTurnConfig::<R>::new(&pu, true);
        let mut state = SlowTurn::<R>::default();
        let (i, sigma_l_s) = (1.0 / pu.l_m, R::from_f64(pu.sigma_l_s));
        let h = pu.t_s / (pu.tau_r * tau_r);
        let mut psi = (0.0, 0.0);
        for k in 0..c.periods {
            let d = (1.0 - psi.0 - x * psi.1, x * psi.0 - psi.1);
            psi = (psi.0 + h * d.0, psi.1 + h * d.1);
            // The leakage flux of a current that begins is not across it.
            let u = AlphaBeta::new(R::ZERO, R::from_f64(h * d.1 / pu.t_s));
            let i_s = AlphaBeta::new(R::from_f64(i), R::ZERO);
            let away = |flux: AlphaBeta<R>| (flux.re().to_f64() - psi.0).hypot(flux.im().to_f64() - psi.1);
            let true_omega = x / (pu.tau_r * tau_r);
            if let Some(Found { omega, psi_r, .. }) = state.step(&c, k + 1, &u, &i_s, sigma_l_s) {
                assert!(k > 3);
                return Some((away(psi_r.unwrap()), omega.to_f64() / true_omega, true));
            }
            if k + 1 == c.periods {
                return state.dragged(&c).map(|(flux, omega)| (away(flux), omega.to_f64() / true_omega, false));
            }
        }
        None
    }

    fn drives() -> [(Machine, Inverter); 2] {
        [(Machine::preset_2k2(), Inverter::preset_2k2()), (Machine::preset_11k(), Inverter::preset_11k())]
    }

    #[test]
    fn a_machine_that_turns_slowly_is_found_with_its_flux_and_its_speed() {
        for (machine, inverter) in drives() {
            for x in [0.2, -0.5, 0.9, 1.2, 3.0, -4.0] {
                let found = build_up::<f64>(machine, inverter, x, 1.0).expect("it turns");
                assert!(found.0 < 0.02 && (found.1 - 1.0).abs() < 0.02, "{x}: {found:?}");
                assert_eq!(found.2, x.abs() > 1.0, "{x}");
                let found = build_up::<Q>(machine, inverter, x, 1.0).expect("it turns");
                assert!(found.0 < 0.02 && (found.1 - 1.0).abs() < 0.05, "{x}: {found:?}");
                assert_eq!(found.2, x.abs() > 1.0, "{x}");
            }
        }
    }

    #[test]
    fn a_rotor_resistance_that_is_30_percent_off_leaves_the_flux_within_what_the_filter_expects() {
        for tau_r in [0.7, 1.3] {
            for x in [0.2, 0.5, -1.5, 3.0] {
                let (machine, inverter) = drives()[0];
                let found = build_up::<f64>(machine, inverter, x, tau_r).expect("it turns");
                assert!(found.0 < 0.15 && (found.1 - 1.0).abs() < 0.6, "{tau_r} {x}: {found:?}");
            }
        }
    }

    #[test]
    fn a_shaft_that_stops_while_the_flux_builds_up_is_at_rest_in_the_end() {
        let pu = PerUnit::new(&Machine::preset_2k2(), &Inverter::preset_2k2()).unwrap();
        let c = SlowTurnConfig::<f64>::new(&pu, true);
        let (mut state, mut psi) = (SlowTurn::default(), (0.0, 0.0));
        let i_s = AlphaBeta::new(1.0 / pu.l_m, 0.0);
        let h = pu.t_s / pu.tau_r;
        let mut turned = false;
        for k in 0..c.periods {
            let x = if k < c.periods / 4 { 0.7 } else { 0.0 };
            let d = (1.0 - psi.0 - x * psi.1, x * psi.0 - psi.1);
            psi = (psi.0 + h * d.0, psi.1 + h * d.1);
            assert_eq!(state.step(&c, k + 1, &AlphaBeta::new(0.0, h * d.1 / pu.t_s), &i_s, pu.sigma_l_s), None);
            turned |= state.dragged(&c).is_some();
        }
        assert!(turned && state.dragged(&c).is_none());
    }

    #[test]
    fn what_is_left_unfound_turns_the_field_by_less_than_eight_degrees() {
        for (machine, inverter) in drives() {
            assert_eq!(build_up::<f64>(machine, inverter, 0.0, 1.0), None);
            for x in [0.06, 0.11, -0.11] {
                assert_eq!(build_up::<f64>(machine, inverter, x, 1.0), None, "{x}");
                assert!(f64::atan(x).to_degrees().abs() < 8.0);
            }
        }
    }
}
