//! What follows from the settings: the course of a start, and the window of a single shunt.

use super::scheme::Scheme;
use super::types::DriveParams;
use crate::base::Base;
#[cfg(all(feature = "enhanced", feature = "legs"))]
pub(super) use crate::estimate::legs::legs_time;
use crate::params::{Inverter, Machine};

/// Magnetising current during the build-up of the flux, as multiple of its final value.
pub(crate) const BOOST: f64 = 1.5;

/// The largest current of a start, as part of the largest current.
pub(crate) const QUICK: f64 = 0.9;

/// Least boost by which the duration of the build-up is computed: three rotor time constants.
const LEAST_BOOST: f64 = 1.05;

/// Least duration of the magnetisation, in rotor time constants.
pub(super) const LEAST_BUILD_UP: f64 = 3.0;

/// Duration of the comparison of the legs, s: without the enhanced scheme there is none.
#[cfg(not(all(feature = "enhanced", feature = "legs")))]
pub(super) fn legs_time(_: f64, _: f64) -> f64 {
    0.0
}

impl DriveParams {
    /// Current of the build-up of the flux as multiple of its final value, as far as the largest current allows.
    pub(crate) fn boost(&self, machine: &Machine) -> f64 {
        let i_0 = self.psi_ref * Base::new(machine).psi / machine.L_s();
        BOOST.min(QUICK * self.i_max / i_0).max(LEAST_BOOST)
    }

    /// Whether a start compares the legs of the bridge. Offsets of the sensors that were not read would be taken for a
    /// voltage of the legs.
    pub(crate) fn compares_legs(&self, machine: &Machine) -> bool {
        let known = self.inverter_model && self.calibrate_offset;
        let fast = legs_time(machine.L_M / machine.R_R, self.current_bandwidth) > 0.0;
        self.scheme == Scheme::Enhanced && self.enhanced.identify_legs && known && fast
    }

    /// Part of the magnetisation in which the flux builds up and settles and the resistance is identified, s.
    pub(crate) fn build_up_time(&self, machine: &Machine) -> f64 {
        if !self.compares_legs(machine) {
            return self.magnetise_time;
        }
        let left = self.magnetise_time - legs_time(machine.L_M / machine.R_R, self.current_bandwidth);
        left.max(LEAST_BUILD_UP * machine.L_M / machine.R_R)
    }

    /// Window of a single shunt in parts of half of the carrier period: a whole and even number of timer counts, so
    /// that edges moved by it, and a duty moved by half of it, are whole counts; 0 with more sensors.
    pub(crate) fn window(&self, inverter: &Inverter) -> f64 {
        if self.current_sensors > 1 {
            return 0.0;
        }
        let part = 2.0 * self.shunt_window * inverter.f_s;
        match inverter.timer() {
            Ok(Some(timer)) => {
                let full = f64::from(timer.full());
                2.0 * libm::ceil(0.5 * part * full - 1e-6) / full
            }
            _ => part,
        }
    }
}
