//! How often the blocks of the control run, in control periods.

use super::scheme::Scheme;
use crate::params::Inverter;

/// Control periods from one run to the next of the supervision.
pub(crate) const SUPERVISION_PERIODS: u32 = 4;

/// Control periods between two samples of the fit of the current sensors' gains, and between two curves of the inverter
/// model.
pub const BALANCE_PERIODS: u32 = 8;

/// Least rate, Hz, of speed and flux control where they run in every eighth period only: a hundred times the bandwidths
/// of the default settings (docs/gains.md), 5 to 9 Hz.
const SLOW_RATE: f64 = 1e3;

/// Control periods from one run of these to the next: eight, or four where the control is slow.
pub(crate) fn slow_periods(inverter: &Inverter) -> u32 {
    if inverter.f_c() >= 8.0 * SLOW_RATE { 8 } else { 4 }
}

/// Control periods from one run of the speed estimator to the next, given those of speed and flux control. In the
/// enhanced scheme at least 80 runs in the reciprocal of its bandwidth, 25 Hz; in the published one, where gain and
/// clock of the flux estimator follow it, every second: with every fourth it loses 4 of 40 reversals at 11 kW, and Fig.
/// 16.
pub(crate) fn speed_periods(scheme: Scheme, slow_periods: u32) -> u32 {
    match scheme {
        Scheme::Paper => 2,
        Scheme::Enhanced => slow_periods / 2,
    }
}

/// Control periods from one run to the next of field weakening, resistance adaptation, confidence and flux shift:
/// sixteen, 0.1 of the reciprocal of the fastest of their bandwidths, the 5 Hz of field weakening, or four where the
/// control is slow.
pub(crate) fn adapt_periods(slow_periods: u32) -> u32 {
    if slow_periods == 8 { 16 } else { slow_periods }
}
