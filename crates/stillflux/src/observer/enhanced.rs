//! Estimators of the enhanced scheme: one filter, and the balance of the current sensors. Where even they do not see, at
//! `ω_s = 0` under load, the scheme asks for less flux.

use super::{Seen, Slow};
use crate::base::{Base, PerUnit, rounded};
use crate::config::{DriveConfig, DriveParams, SLOW_PERIODS};
use crate::control::shift::{FluxShift, ShiftConfig};
use crate::drive::Memory;
use crate::estimate::balance::{Balance, BalanceConfig};
use crate::estimate::flux::FluxEstimate;
use crate::estimate::kalman::{Filter, FilterConfig, Identified, Input, Learned};
use crate::params::{Inverter, Machine};
use crate::scalar::{Real, clamp_seldom};
use crate::space::{AlphaBeta, Dq};
use crate::words::words;

/// Duration for which a start only looks, s: how fast the machine turns.
const PROBE_TIME: f64 = 0.01;
/// Speed above which a machine counts as rotating at the start.
const TURNING: f64 = 0.03;
/// Rate of the fit of the current sensors' gains at rated magnetising current, 1/s, and of its constant.
const BALANCE_RATE: f64 = 17.0;
const BALANCE_OFFSET_RATE: f64 = 0.34;
/// Rate of the flux shift in units of rated flux, 1/s: flux control follows without a lag that torque would show.
const SHIFT_RATE: f64 = 0.5;

/// Settings of the estimators.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct EnhancedConfig<R: Real> {
    pub filter: FilterConfig<R>,
    pub balance: BalanceConfig<R>,
    pub shift: ShiftConfig<R>,
    pub probe_periods: u32,
}
words!(EnhancedConfig: filter, balance, shift, probe_periods);

impl<R: Real> EnhancedConfig<R> {
    /// Settings for validated parameters; `i_q_max`: the largest torque current.
    pub fn new(machine: &Machine, inverter: &Inverter, pu: &PerUnit<R>, p: &DriveParams, i_q_max: f64) -> Self {
        let b = Base::new(machine);
        // At the rotor flux of no load; under load it is a little less, and the slip more.
        let psi_r = p.psi_ref * machine.L_M / machine.L_s();
        let identified =
            Identified { offset: p.offset_estimator, resistance: p.resistance_adaptation, flux: p.noise_compensator };
        Self {
            filter: FilterConfig::new(machine, inverter, pu, p.psi_ref, p.calibrate_offset, identified),
            balance: BalanceConfig {
                step: rounded(BALANCE_RATE / inverter.f_s),
                step_offset: rounded(BALANCE_OFFSET_RATE / inverter.f_s),
            },
            shift: ShiftConfig {
                omega_s_min: rounded(p.omega_s_min / b.omega),
                slip: rounded(machine.R_R / b.z / (psi_r * psi_r)),
                // From 0.1 to 0.3 of rated torque.
                inv_torque_fade: rounded(5.0 * b.torque / machine.T_N),
                // A tenth of the torque that the current allows is kept in reserve.
                inv_torque: rounded(1.0 / (0.9 * i_q_max * p.psi_ref)),
                step: rounded(SHIFT_RATE * f64::from(SLOW_PERIODS) / inverter.f_s),
            },
            probe_periods: inverter.periods(PROBE_TIME),
        }
    }
}

impl<R: Real> DriveConfig<R> {
    /// Settings of the filter, for its use alone.
    pub fn filter_config(&self) -> &FilterConfig<R> {
        &self.enhanced.filter
    }

    /// Settings of the flux shift.
    pub fn shift_config(&self) -> &ShiftConfig<R> {
        &self.enhanced.shift
    }

    /// Settings of the fit of the current sensors' gains.
    pub fn balance_config(&self) -> &BalanceConfig<R> {
        &self.enhanced.balance
    }
}

/// A sample and what was applied before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Applied<R: Real> {
    /// Current vector and sum of the three currents, as measured.
    pub i_s: AlphaBeta<R>,
    pub sum: R,
    /// Voltage between the last two samples, and the part that the inverter model took.
    pub u_s: AlphaBeta<R>,
    pub u_l: AlphaBeta<R>,
}

/// State of the estimators.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Enhanced<R: Real> {
    filter: Filter<R>,
    balance: Balance<R>,
    shift: FluxShift<R>,
    /// Sums of `ψ_R × dψ_R` without its slip part and of `|ψ_R|²`: their ratio is the speed, which takes their place.
    probe: [R; 2],
}

impl<R: Real> Enhanced<R> {
    /// Estimators that know the priors.
    pub fn new(c: &EnhancedConfig<R>) -> Self {
        Self {
            filter: Filter::new(&c.filter),
            balance: Balance::default(),
            shift: FluxShift::default(),
            probe: [R::ZERO; 2],
        }
    }

    /// One period; `blind` while the machine has no flux.
    #[inline(always)]
    pub fn period(&mut self, c: &EnhancedConfig<R>, x: &Applied<R>, i_ref: &Dq<R>, omega_s: R, blind: bool) -> Seen<R> {
        let i_m = self.balance.step(&c.balance, &x.i_s, x.sum);
        let o = &mut self.filter;
        let i_dq = o.step(&c.filter, &Input { u_s: x.u_s, u_l: x.u_l, i_m, i_ref: *i_ref, omega_s }, blind);
        Seen { field: o.field(), magnitude: o.magnitude(), r_s: o.r_s(), i_dq }
    }

    /// Begins with a machine without flux.
    pub fn start(&mut self, c: &EnhancedConfig<R>, i_s: &AlphaBeta<R>) {
        self.filter.start(&c.filter, i_s);
    }

    /// Begins anew with the flux that a direct current has built up in a machine at rest.
    pub fn settle(&mut self, c: &EnhancedConfig<R>, psi_s: R) {
        self.filter.settle(&c.filter, psi_s);
    }

    /// One period of the look at a machine's speed: what `ψ_R` has turned by, without its slip part, and its square.
    pub fn probe(&mut self, turned: R, square: R) {
        self.probe[0] += turned;
        self.probe[1] += square;
    }

    /// The speed that was seen.
    pub fn probed(&mut self) -> R {
        let omega = self.probe[0] * self.probe[1].recip();
        let omega = clamp_seldom(omega, R::from_f64(-1.5), R::from_f64(1.5));
        self.probe = [omega, R::ZERO];
        omega
    }

    /// Once probed: the machine turned when the start began.
    pub fn turning(&self) -> bool {
        !self.probe[0].within(R::from_f64(TURNING))
    }

    pub fn rest(&mut self, i_s: &AlphaBeta<R>) {
        self.filter.rest(i_s);
    }

    #[inline(always)]
    pub fn i_s(&self) -> AlphaBeta<R> {
        self.filter.i_s()
    }

    #[inline(always)]
    pub fn psi_s(&self) -> AlphaBeta<R> {
        self.filter.value()
    }

    #[inline(always)]
    pub fn magnitude(&self) -> R {
        self.filter.magnitude()
    }

    #[inline(always)]
    pub fn loss_gain(&self) -> R {
        R::ONE + self.filter.v()
    }

    pub fn flux(&self) -> FluxEstimate<R> {
        self.filter.estimate()
    }

    pub fn r_s(&self) -> R {
        self.filter.r_s()
    }

    pub fn u_off(&self) -> AlphaBeta<R> {
        self.filter.b() * -self.filter.r_s()
    }

    pub fn psi_1(&self) -> AlphaBeta<R> {
        self.filter.value()
    }

    pub fn residual(&self) -> R {
        self.filter.residual()
    }

    pub fn confidence(&self) -> R {
        self.filter.confidence()
    }

    pub fn learned(&self) -> (R, R) {
        (self.filter.v(), self.filter.learned().gamma)
    }

    pub fn restore(&mut self, c: &DriveConfig<R>, memory: &Memory<R>, u_off: AlphaBeta<R>) {
        // Readings at rest replace what was learned beyond the readings of that run.
        let b = if c.calibrate_offset { AlphaBeta::default() } else { u_off * -memory.r_s.recip() };
        let Memory { r_s, loss_error: v, inv_l_m: gamma, .. } = *memory;
        self.filter.restore(&c.enhanced.filter, &Learned { b, r_s, v, gamma });
    }

    pub fn begin(&mut self) {
        self.probe = [R::ZERO; 2];
        self.shift = FluxShift::default();
    }

    #[inline(always)]
    pub fn flux_factor(&mut self, c: &DriveConfig<R>, omega_m: R, torque: R) -> R {
        self.shift.step(&c.enhanced.shift, omega_m, torque)
    }

    /// The filter gets the stator frequency with every period.
    #[inline(always)]
    pub fn follow(&mut self, _: &DriveConfig<R>, _: R) {}

    #[inline(always)]
    pub fn adapt(&mut self, c: &DriveConfig<R>, _: &Slow<R>) {
        self.filter.confine(&c.enhanced.filter);
    }
}
