//! Direct currents of a start at standstill that tell resistance, loss and knee of the bridge apart.
//!
//! The voltage of the resistance is proportional to the current, that of the bridge is not. Currents relative to the
//! magnetising one, times in sixteenths of the magnetisation from the settled flux on:
//!
//! ```text
//! two levels:      0.7 until 10/16,                   0.4 until 13/16,                      then the boosted current until ψ_s = 1
//! three levels:   -0.5 until ψ_s has fallen to 0.4,   0.4 until 12/16,   0.2 until 13/16,   then the boosted current until ψ_s = 1
//! ```
//!
//! The flux goes to that of the current with `τ_r dψ_s/dt = i - ψ_s`, and what it induces meanwhile shows `r_R`
//! ([`crate::estimate::kalman`]'s `direct`). With two levels an eighth of its error goes into `r̂_s` at 11 and 15 kW. A current
//! `i_1` beyond the level `i_2` takes the flux there within
//!
//! ```text
//! t = τ_r ln ((1 - i_1)/(i_2 - i_1))
//! ```
//!
//! 0.51 τ_r here, two of the sixteenths with the default magnetisation: the larger step induces more, and a twentieth of the
//! error of `r_R` at the most is left in `r̂_s` (`stillflux-sim/tests/tolerance.rs`). At the third level the bridge's loss is the
//! largest part of the voltage.
//!
//! Three levels need offsets that were read before the start, since an offset counts for more the smaller the current is,
//! and three sensors: the gains of two are compared in these currents ([`crate::estimate::pair`]), and a single shunt sees a
//! small current worst.

use crate::base::{PerUnit, rounded};
use crate::params::Inverter;
use crate::scalar::Real;
use crate::words::words;

/// The first of two levels.
const REDUCED: f64 = 0.7;
/// The second.
const SMALL: f64 = 0.4;
/// The first of three: beyond the second, which is the same.
const FALL: f64 = -0.5;
/// The last of three.
const LEAST: f64 = 0.2;

/// Settings; durations in periods.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct LevelsConfig<R: Real> {
    /// The first current, and how long it flows.
    first: R,
    first_periods: u32,
    /// Of the boosted current that brings the flux back.
    recovery_periods: u32,
}
words!(LevelsConfig: first, first_periods, recovery_periods);

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
    /// For a magnetisation of `build_up` s with `boost` times the magnetising current; `three`: with three levels.
    pub fn new(pu: &PerUnit, inverter: &Inverter, build_up: f64, boost: f64, three: bool) -> Self {
        let tau_r = pu.tau_r / pu.base.omega;
        let sixteenths = |n: f64| n / 16.0 * build_up;
        let settled = |psi: f64, i: f64, seconds: f64| i + (psi - i) * libm::exp(-seconds / tau_r);
        // The first current, how long it flows, and the flux after the last one.
        let (first, first_periods, psi) = if three {
            let fall = (libm::log((1.0 - FALL) / (SMALL - FALL)) * tau_r).min(sixteenths(3.0));
            let psi = settled(settled(1.0, FALL, fall), SMALL, sixteenths(3.0) - fall);
            (FALL, inverter.periods(fall), settled(psi, LEAST, sixteenths(1.0)))
        } else {
            let psi = settled(1.0, REDUCED, sixteenths(1.0));
            // The sixteenth of `at`, in whole periods.
            (REDUCED, (inverter.periods(build_up) / 16).max(1), settled(psi, SMALL, sixteenths(3.0)))
        };
        let recovery = (libm::log((boost - psi) / (boost - 1.0)) * tau_r).min(sixteenths(3.0));
        Self { first: rounded(first), first_periods, recovery_periods: inverter.periods(recovery) }
    }

    /// The level in a period of the magnetisation, a sixteenth of which is `sixteenth` periods.
    pub fn at(&self, stage: u32, sixteenth: u32) -> Level<R> {
        let small = R::from_f64(SMALL);
        match stage / sixteenth {
            9..=11 if stage < 9 * sixteenth + self.first_periods => Level::Part(self.first),
            12 if self.first < small => Level::Part(R::from_f64(LEAST)),
            9..=12 => Level::Part(small),
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
    fn levels(build_up: f64, boost: f64, three: bool) -> (LevelsConfig<f64>, f64, f64) {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let levels = LevelsConfig::new(&pu, &inverter, build_up, boost, three);
        (levels, pu.tau_r / pu.base.omega, inverter.f_c())
    }

    /// The flux in every period from the settled one on.
    fn flux(build_up: f64, boost: f64, three: bool) -> Vec<f64> {
        let (levels, tau_r, f_c) = levels(build_up, boost, three);
        let sixteenth = (build_up * f_c / 16.0) as u32;
        let mut psi = 1.0;
        (9 * sixteenth..16 * sixteenth)
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
    fn the_flux_stands_at_each_level_and_is_back_at_the_end() {
        for three in [true, false] {
            let tau_r = levels(1.0, 2.0, three).1;
            let psi = flux(8.0 * tau_r, 2.0, three);
            let at = |sixteenth: f64| psi[((sixteenth - 9.0) / 7.0 * psi.len() as f64) as usize - 1];
            if three {
                for end in [11.2, 12.0] {
                    assert!((at(end) - SMALL).abs() < 2e-3, "{}", at(end));
                }
            }
            assert!((at(16.0) - 1.0).abs() < 5e-3, "{}", at(16.0));
        }
    }

    #[test]
    fn a_magnetisation_too_short_for_the_fall_ends_with_the_least_current_and_the_way_back() {
        let (levels, tau_r, f_c) = levels(0.1, 1.01, true);
        assert!(tau_r > 0.1);
        let sixteenth = (0.1 * f_c / 16.0) as u32;
        let at = |n: u32| levels.at(n * sixteenth + sixteenth / 2, sixteenth);
        assert_eq!([at(8), at(9), at(10)], [Level::Full, Level::Part(FALL), Level::Part(FALL)]);
        assert_eq!([at(11), at(12), at(15)], [Level::Part(FALL), Level::Part(LEAST), Level::Boosted]);
    }
}
