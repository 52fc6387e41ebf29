//! Direct currents of a start at standstill that tell the resistances, the inductance, and loss and knee of the bridge apart.
//!
//! The voltage of the resistance is proportional to the current, that of the bridge is not: a small current shows the
//! bridge. On its way to that of the current, `τ_r dψ_s/dt = i - ψ_s`, the flux induces `r_R (i - ψ_s)`, and the more of
//! these ways there are, and the longer each is, the better they show `r_R` and `l_M` ([`crate::estimate::kalman`]'s `direct`).
//! Currents relative to the magnetising one, times in sixteenths of the magnetisation, from the settled flux on:
//!
//! ```text
//! 7: 0.2      9: 0.8      10: 0.2      12: 0.6      13: the boosted current until ψ_s = 1
//! ```
//!
//! Over 24 draws each of seven drives this leaves two thirds of the error of `r̂_s` that 0.7 and 0.4 with one way back leave
//! (1.8 % instead of 2.7, rms; 3.0 instead of 4.3 with effects in the plant that the model does not contain).
//!
//! No current flows against the flux. It would bring the flux down faster, but a shaft does not stay in it: from what the
//! slots of the rotor turn it by, the angle grows by `exp t √(3/2 n_p² ψ i/J)`, and a motor of 160 kW turned by two electrical revolutions within the
//! fall to 0.4 with half of the magnetising current.
//!
//! An offset of the sensors that was not read counts for more the smaller the current is, and so does a difference of the
//! gains of two ([`crate::estimate::pair`]); a single shunt sees a small current worst. The least current is larger then.

use crate::base::{PerUnit, rounded};
use crate::params::Inverter;
use crate::scalar::Real;
use crate::words::words;

/// Sixteenth of the magnetisation in which the flux has settled.
pub const SETTLED: u32 = 7;
/// The least current, with three sensors whose offsets are read before the start, and else.
const LEAST: f64 = 0.2;
const LEAST_OTHERWISE: f64 = 0.4;
/// What flows between two sixteenths of the least one, and after the second.
const BETWEEN: f64 = 0.8;
const AFTER: f64 = 0.6;
/// Most sixteenths of the boosted current.
const RECOVERY: f64 = 3.0;

/// Settings; durations in periods.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct LevelsConfig<R: Real> {
    least: R,
    /// Of the boosted current that brings the flux back.
    recovery_periods: u32,
}
words!(LevelsConfig: least, recovery_periods);

/// What flows in a period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Level<R> {
    /// The current of the build-up.
    Full,
    /// A part of it.
    Part(R),
    /// The largest current.
    Boosted,
}

impl<R: Real> LevelsConfig<R> {
    /// For a magnetisation of `build_up` s with `boost` times the magnetising current; `exact`: the currents are measured by
    /// three sensors whose offsets are read before the start.
    pub fn new(pu: &PerUnit, inverter: &Inverter, build_up: f64, boost: f64, exact: bool) -> Self {
        let least = if exact { LEAST } else { LEAST_OTHERWISE };
        let tau_r = pu.tau_r / pu.base.omega;
        let sixteenth = build_up / 16.0;
        let psi = [(least, 2.0), (BETWEEN, 1.0), (least, 2.0), (AFTER, 1.0)]
            .iter()
            .fold(1.0, |psi, (i, n)| i + (psi - i) * libm::exp(-n * sixteenth / tau_r));
        let recovery = (libm::log((boost - psi) / (boost - 1.0)) * tau_r).min(RECOVERY * sixteenth);
        Self { least: rounded(least), recovery_periods: inverter.periods(recovery) }
    }

    /// The level in a period of the magnetisation, a sixteenth of which is `sixteenth` periods.
    pub fn at(&self, stage: u32, sixteenth: u32) -> Level<R> {
        match stage / sixteenth {
            SETTLED..=8 | 10..=11 => Level::Part(self.least),
            9 => Level::Part(R::from_f64(BETWEEN)),
            12 => Level::Part(R::from_f64(AFTER)),
            13..=15 if stage < 13 * sixteenth + self.recovery_periods => Level::Boosted,
            _ => Level::Full,
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec::Vec;

    use super::*;
    use crate::params::Machine;

    /// Of one machine: all times scale with `τ_r`.
    fn levels(build_up: f64, boost: f64, exact: bool) -> (LevelsConfig<f64>, f64, f64) {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let levels = LevelsConfig::new(&pu, &inverter, build_up, boost, exact);
        (levels, pu.tau_r / pu.base.omega, inverter.f_c())
    }

    /// The flux in every period from the settled one on.
    fn flux(build_up: f64, boost: f64, exact: bool) -> Vec<f64> {
        let (levels, tau_r, f_c) = levels(build_up, boost, exact);
        let sixteenth = (build_up * f_c / 16.0) as u32;
        let mut psi = 1.0;
        (SETTLED * sixteenth..16 * sixteenth)
            .map(|stage| {
                let i = match levels.at(stage, sixteenth) {
                    Level::Full => 1.0,
                    Level::Part(x) => x,
                    Level::Boosted => boost,
                };
                psi += (i - psi) / (tau_r * f_c);
                psi
            })
            .collect()
    }

    #[test]
    fn the_flux_rises_and_falls_twice_and_is_back_at_the_end() {
        for (exact, lowest) in [(true, 0.5), (false, 0.64)] {
            let tau_r = levels(1.0, 2.0, exact).1;
            let psi = flux(8.0 * tau_r, 2.0, exact);
            let at = |sixteenth: f64| psi[((sixteenth - 7.0) / 9.0 * psi.len() as f64) as usize - 1];
            let ends = [9.0, 10.0, 12.0, 13.0].map(at);
            assert!(ends[0] < lowest && ends[2] < lowest, "{ends:?}");
            assert!(ends[1] > ends[0] + 0.05 && ends[3] > ends[2] + 0.03, "{ends:?}");
            assert!((at(16.0) - 1.0).abs() < 5e-3, "{}", at(16.0));
        }
    }

    #[test]
    fn no_current_flows_against_the_flux_in_which_a_shaft_would_not_stay() {
        for exact in [true, false] {
            let (levels, ..) = levels(1.4, 2.0, exact);
            for stage in 0..1600 {
                if let Level::Part(i) = levels.at(stage, 100) {
                    assert!(i > 0.0, "{stage}: {i}");
                }
            }
        }
    }

    #[test]
    fn a_magnetisation_too_short_for_the_way_back_ends_with_the_boosted_current() {
        let (levels, tau_r, f_c) = levels(0.1, 1.01, true);
        assert!(tau_r > 0.1);
        let sixteenth = (0.1 * f_c / 16.0) as u32;
        let at = |n: u32| levels.at(n * sixteenth + sixteenth / 2, sixteenth);
        assert_eq!([at(6), at(7), at(9)], [Level::Full, Level::Part(LEAST), Level::Part(BETWEEN)]);
        assert_eq!([at(11), at(12), at(15)], [Level::Part(LEAST), Level::Part(AFTER), Level::Boosted]);
    }
}
