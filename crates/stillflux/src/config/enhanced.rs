//! Configuration of the enhanced scheme: constants of its estimators and of its flux shift, per unit.

use super::settings::{BALANCE_PERIODS, DriveParams, EnhancedParams, adapt_periods, slow_periods};
use crate::base::{PerUnit, rounded};
#[cfg(feature = "dither")]
use crate::control::dither::{self, DitherConfig};
use crate::control::levels::LevelsConfig;
use crate::control::shift::ShiftConfig;
#[cfg(feature = "supervision")]
use crate::control::sides::SidesConfig;
use crate::estimate::balance::BalanceConfig;
use crate::estimate::catch::CatchConfig;
use crate::estimate::kalman::{FilterConfig, Identified};
#[cfg(feature = "legs")]
use crate::estimate::legs::{LegsConfig, half_plateau};
use crate::estimate::priors::Priors;
use crate::estimate::search::SearchConfig;
#[cfg(feature = "restart")]
use crate::estimate::slow_turn::SlowTurnConfig;
use crate::params::{Inverter, Machine};
use crate::scalar::Real;
use crate::words::words;

/// Duration of a block in which the induced voltage is measured at the beginning of a start, s.
const CATCH_BLOCK: f64 = 1e-3;
/// Time, in rotor time constants of a small flux, after which a rated one is none. What is left makes the comparison of the
/// legs wrong, by 0.3 µs at rated flux, by 2 ns at e⁻⁵ of it, and by 6 ns where the rotor resistance is 20 % less than known.
const DECAYED: f64 = 5.0;
/// How much larger the inductance of a small flux is than the rated one, where no curve tells it. Allowance.
const UNSATURATED: f64 = 1.2;
/// Rate of the fit of the current sensors' gains at rated magnetising current, 1/s, and of its constant. Gains change
/// with temperature; a faster fit follows the noise of its samples.
const BALANCE_RATE: f64 = 2.1;
const BALANCE_OFFSET_RATE: f64 = 0.34;
/// Largest load in the shifted flux, relative to the pull-out torque there.
const SHIFTED_TO_PULL_OUT: f64 = 0.6;
/// Durations for which a flux has to have collapsed, or a shaft to turn against the torque, before another side of the current
/// is tried, and of the trial, in rotor time constants ([`crate::control::sides`]).
#[cfg(feature = "supervision")]
const COLLAPSE_TIME: f64 = 0.3;
#[cfg(feature = "supervision")]
const AGAINST_TIME: f64 = 0.21;
#[cfg(feature = "supervision")]
const TRIAL_TIME: f64 = 0.25;
/// Least time for which a shaft turns against the torque, s: a load that comes does it until the speed loop has caught the shaft.
/// With 0.1 a rated load that comes at once after a start without offsets still begins a trial at 11 kW.
#[cfg(feature = "supervision")]
const AGAINST_TIME_LEAST: f64 = 0.15;
/// Rate of the flux shift in units of rated flux, 1/s: slow against flux control (5 Hz), which follows it.
const SHIFT_RATE: f64 = 0.5;
/// Rotor time constant below which it is faster in proportion, s. Measured, not derived. On the line an error of `Δr_s` moves the flux by `Δr_s i_s` in a normalised time
/// of 1, and small motors, whose rotor time constant is short, have a large `r_s`: one of 0.4 kW (20 ms, `r_s` 0.14, 87 to 100 Hz) lost its field within 0.1 s,
/// in which 0.5/s has taken a third of the way, in 10 of 48 realisations of the noise, and with this in one.
const SHIFT_TAU_R: f64 = 0.05;
/// Time constant of the low-pass that leaves loads alone which pass the flux shift's range, s: longer than a load takes to pass,
/// and a third of the shortest time after which an angle error of 15° was seen on the line without the shift.
const SHIFT_TIME: f64 = 2.0;

/// Settings of the estimators.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct EnhancedConfig<R: Real> {
    pub filter: FilterConfig<R>,
    pub balance: BalanceConfig<R>,
    pub shift: ShiftConfig<R>,
    #[cfg(feature = "supervision")]
    pub sides: SidesConfig,
    #[cfg(feature = "dither")]
    pub dither: DitherConfig<R>,
    pub catch: CatchConfig<R>,
    /// What one control period takes off the logarithm of a free rotor flux, times 64.
    pub decay: R,
    /// Periods after which a free rotor flux has decayed.
    pub decay_periods: u32,
    pub search: SearchConfig<R>,
    #[cfg(feature = "restart")]
    pub slow_turn: SlowTurnConfig<R>,
    pub levels: LevelsConfig<R>,
    #[cfg(feature = "legs")]
    pub legs: LegsConfig<R>,
    /// The gains of two current sensors are compared in the second half of the magnetisation: reciprocal of its periods;
    /// 0 with three sensors.
    #[cfg(feature = "modes")]
    pub pair_weight: R,
}
words!(EnhancedConfig: filter, balance, shift,
    #[cfg(feature = "supervision")] sides,
    #[cfg(feature = "dither")] dither,
    catch, decay, decay_periods, search, levels,
    #[cfg(feature = "restart")] slow_turn,
    #[cfg(feature = "legs")] legs,
    #[cfg(feature = "modes")] pair_weight);

impl<R: Real> EnhancedConfig<R> {
    /// Settings for validated parameters; `i_q_max`: the largest torque current.
    #[allow(non_snake_case)]
    pub fn new(machine: &Machine, inverter: &Inverter, pu: &PerUnit, p: &DriveParams, i_q_max: f64) -> Self {
        let build_up_time = p.build_up_time(machine);
        // Seconds from one call of the flux shift to the next.
        let adapt = f64::from(adapt_periods(slow_periods(inverter)));
        let call = adapt / inverter.f_c();
        // In s.
        let tau_r = pu.tau_r / pu.base.omega;
        // At the rotor flux of no load; under load it is a little less, and the slip more.
        let psi_r = p.psi_ref * pu.l_m / pu.l_s;
        let pull_out = pu.pull_out(p.psi_ref * p.psi_ref);
        let identified = {
            let EnhancedParams { identify_offset, identify_resistance, apply_innovation, .. } = p.enhanced;
            Identified { offset: identify_offset, resistance: identify_resistance, flux: apply_innovation }
        };
        let priors = {
            let EnhancedParams { prior_R_s, prior_loss, prior_c_out, prior_L_sigma, prior_R_R, prior_L_M, .. } =
                p.enhanced;
            let (leakage, r_r, l_m) = (prior_L_sigma, prior_R_R, prior_L_M);
            Priors { r_s: prior_R_s, loss: prior_loss, knee: prior_c_out, leakage, r_r, l_m }
        };
        let filter = FilterConfig::new(machine, inverter, pu, p.psi_ref, p.calibrate_offset, identified);
        let filter = filter.with_priors(&priors);
        let filter = if p.enhanced.hold_inductances { filter } else { filter.never_steady() };
        let filter = p.enhanced.temperature().map_or(filter, |t| filter.with_temperature(machine, inverter, pu, &t));
        Self {
            filter,
            balance: {
                // Nothing to fit where the third current is computed.
                let on = if p.current_sensors == 3 { f64::from(BALANCE_PERIODS) / inverter.f_c() } else { 0.0 };
                // The state is a third of the difference of the gains.
                BalanceConfig { step: rounded(BALANCE_RATE / 3.0 * on), step_offset: rounded(BALANCE_OFFSET_RATE * on) }
            },
            shift: ShiftConfig {
                omega_s_min: rounded(p.enhanced.omega_s_min / pu.base.omega),
                slip: rounded(pu.r_r / (psi_r * psi_r)),
                // From a twentieth to three twentieths of rated torque, within what fixed point holds.
                inv_torque_fade: rounded((10.0 / pu.torque_rated).min(100.0)),
                // A tenth of the torque that the current allows is kept in reserve.
                inv_torque: rounded(1.0 / (0.9 * i_q_max * p.psi_ref)),
                inv_pull_out: rounded(1.0 / (SHIFTED_TO_PULL_OUT * pull_out)),
                step: rounded(SHIFT_RATE * (SHIFT_TAU_R / tau_r).max(1.0) * call),
                corner: rounded(call / SHIFT_TIME),
            },
            #[cfg(feature = "supervision")]
            sides: {
                let calls = |time: f64| inverter.periods(time / adapt);
                // Not for a flux that is only integrated: what it is off by is its drift.
                let on = p.realignment && p.enhanced.apply_innovation;
                let suspicion = |time: f64| if on { calls(time) } else { u32::MAX };
                SidesConfig {
                    collapse: suspicion(COLLAPSE_TIME * tau_r),
                    against: suspicion((AGAINST_TIME * tau_r).max(AGAINST_TIME_LEAST)),
                    trial: calls(TRIAL_TIME * tau_r),
                }
            },
            #[cfg(feature = "dither")]
            dither: DitherConfig {
                amplitude: rounded(p.enhanced.dither * pu.torque_rated),
                inv_torque: rounded((1.0 / (dither::TORQUE * pu.torque_rated)).min(100.0)),
                step: rounded(4.0 / dither::PERIOD * f64::from(slow_periods(inverter)) / inverter.f_c()),
            },
            catch: CatchConfig::new(pu, CATCH_BLOCK, inverter.f_c()),
            decay: rounded(64.0 * pu.t_s / pu.tau_r),
            decay_periods: {
                let unsaturated = machine.saturation.map_or(UNSATURATED, |x| x.L_u / (pu.l_s * pu.base.l));
                inverter.periods(DECAYED * unsaturated * pu.tau_r / pu.base.omega)
            },
            levels: {
                let exact = p.current_sensors == 3 && p.calibrate_offset;
                LevelsConfig::new(pu, inverter, build_up_time, p.boost(machine), exact)
            },
            search: {
                let current = p.boost(machine) * p.psi_ref / pu.l_s;
                SearchConfig::new(pu, inverter.f_c(), current, p.enhanced.find_slow_rotation)
            },
            #[cfg(feature = "restart")]
            slow_turn: SlowTurnConfig::new(pu, p.enhanced.find_slow_rotation),
            #[cfg(feature = "legs")]
            legs: {
                let half = if p.compares_legs(machine) {
                    inverter.periods(half_plateau(machine.L_M / machine.R_R, p.current_bandwidth))
                } else {
                    0
                };
                LegsConfig::new(pu, half)
            },
            #[cfg(feature = "modes")]
            pair_weight: if p.current_sensors == 2 {
                rounded(2.0 / f64::from(inverter.periods(build_up_time)))
            } else {
                R::ZERO
            },
        }
    }
}
