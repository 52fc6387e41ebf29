//! Settings in SI to the constants of the control's blocks, per unit: gains and rates that several blocks share, and the
//! constants of each block.

use super::settings::{self, DriveParams, LowConfidence, SUPERVISION_PERIODS, Scheme};
use crate::base::{PerUnit, rounded};
use crate::control::current::CurrentConfig;
#[cfg(feature = "dclink")]
use crate::control::dclink::{self, DcLinkConfig};
use crate::control::flux::FluxControlConfig;
#[cfg(feature = "encoder")]
use crate::control::handover::{self, HandOverConfig};
use crate::control::overload::{self, OverloadConfig};
use crate::control::ramp::{self, RampConfig};
#[cfg(feature = "supervision")]
use crate::control::realign::RealignConfig;
#[cfg(feature = "shunt")]
use crate::control::shunt::ShuntConfig;
use crate::control::speed::SpeedControlConfig;
#[cfg(feature = "supervision")]
use crate::control::swing::SwingConfig;
use crate::control::weakening::{self, WeakeningConfig};
#[cfg(feature = "encoder")]
use crate::estimate::encoder::count_angle;
#[cfg(feature = "enhanced")]
use crate::estimate::kalman::FilterConfig;
#[cfg(feature = "supervision")]
use crate::estimate::kalman::nis_time;
use crate::estimate::speed::SpeedConfig;
use crate::params::{Inverter, Machine, ParamError, check};
use crate::scalar::Real;
use crate::space::SQRT_3;
use crate::supervision::SupervisionConfig;
#[cfg(feature = "supervision")]
use crate::supervision::channels::{self, ChannelConfig};
#[cfg(feature = "supervision")]
use crate::supervision::innovation::InnovationConfig;
#[cfg(feature = "supervision")]
use crate::supervision::phases::{self, PhaseConfig};
use crate::supervision::plausibility::{self, PlausibilityConfig};

/// Part of the dc link that the voltage vector may use: inscribed circle of the hexagon, less a margin.
const U_UTILISATION: f64 = 0.98 / SQRT_3;
/// The same with overmodulation: the reference reaches half way to the corners of the hexagon, and the modulator takes the
/// nearest voltage on its edge. Of a reference that turns with the length `ρ` the fundamental that is left is, with
/// `r = 1/√3` and `cos θ = r/ρ`,
///
/// ```text
/// (6/π) (r sin θ + ρ (θ/2 - sin 2θ/4) + ρ (π/6 - θ)) = 0.601,    at the corners 0.609
/// ```
const U_REACH: f64 = 0.622;
/// The steady state stays on the circle, of which field weakening leaves it a part. On the edge of the hexagon current
/// control has little room.
const U_OVERMODULATED: f64 = 1.0 / (SQRT_3 * weakening::UTILISATION);
/// Flux control in field weakening ([`crate::control::flux`]): gain by the leakage, and crossing frequency of its integral
/// part in parts of the bandwidth of current control. Largest correction at high frequency in units of the magnetising
/// current: the flux of the largest machines falls over some tenths of a second only by a current against it.
const WEAK_GAIN: f64 = 0.15;
const WEAK_RATE: f64 = 0.05;
const LIMIT_HIGH: f64 = 2.0;
/// Largest correction of flux control below high frequency in units of the magnetising current: of the published scheme,
/// and of the enhanced one.
const LIMIT: (f64, f64) = (0.3, 1.0);
/// Least flux reference of field weakening in units of the reference without it.
const WEAKEST: f64 = 0.2;
/// Largest gain from speed to torque current in field weakening, per unit of the bandwidth of current control, at rated flux. Of
/// 100 fan motors with deep bars and rotor slots 13 oscillated at twice rated speed until a fault with 12 and gains that fell with the flux
/// itself; with this and the square of the flux one does.
const SPEED_GAIN: f64 = 9.0;
/// Largest torque current in units of the one at pull-out.
pub(super) const TO_PULL_OUT: f64 = 0.8;
/// Part of full scale that a saturated current channel reads at least: the highest code of a converter of 10 bits is a
/// 512th below full scale, that of one of 12 bits a 2048th.
const SATURATED: f64 = 1.0 - 1.0 / 512.0;
/// Least time of a violation before a phase is open, s, and in control periods: the current comes up to a reference that has stepped
/// within that many.
#[cfg(feature = "supervision")]
const OPEN: f64 = 0.004;
#[cfg(feature = "supervision")]
const OPEN_PERIODS: u32 = 24;
/// The same in units of `1/ω_c`, where a load that reverses accelerates the shaft by so much that the current falls behind its
/// reference ([`Conversion::tracking_error`]), and where the field stands a phase may stay at its zero meanwhile: up to `8.3/ω_c` in random speeds and
/// loads of small drives with a control of 2 to 5 kHz, supervision off.
#[cfg(feature = "supervision")]
const OPEN_LAG: f64 = 11.0;
/// Time for which the field stands at the torque limit before the torque is halved to see why, and the least time for which
/// it is halved, s ([`crate::control::realign`]).
#[cfg(feature = "supervision")]
const REALIGN: f64 = 0.12;
/// The time for which it is halved, in rotor time constants, where that is longer.
#[cfg(feature = "supervision")]
const REALIGN_TEST: f64 = 0.5;
/// Time constant of the speed's low-pass there, s.
#[cfg(feature = "supervision")]
const REALIGN_LOW_PASS: f64 = 0.025;
/// Thresholds `h` of the tests for a lost field ([`crate::supervision::innovation`]): of any contradiction, at least, s, and of a flux
/// that falls, in rotor time constants, and at least, s; and both at least in time constants of the innovation's low-pass, which holds
/// what a transient has left. The part of the rotor time constant is measured, not derived: with a quarter
/// of it steps of `r_s` by 25 % in regeneration at 11 kW end, which are held.
#[cfg(feature = "supervision")]
const LOST_FIELD: (f64, f64) = (0.04, 2.0);
#[cfg(feature = "supervision")]
const FLUX_FALLS: f64 = 0.5;
#[cfg(feature = "supervision")]
const FLUX_FALLS_LEAST: (f64, f64) = (0.06, 3.0);

/// Validated settings of a drive, and what its blocks have in common, per unit.
pub(super) struct Conversion<'a> {
    machine: &'a Machine,
    inverter: &'a Inverter,
    p: &'a DriveParams,
    pu: &'a PerUnit,
    /// Control periods from one run to the next: of the speed estimator, of speed and flux control, of adaptation.
    speed_periods: u32,
    pub slow_periods: u32,
    adapt_periods: u32,
    /// Magnetising current at the flux reference.
    i_0: f64,
    pub i_max: f64,
    pub i_q_max: f64,
    pub i_trip: f64,
    pub i_range: f64,
    /// Largest voltage reference and largest fundamental voltage, in parts of the dc link.
    pub u_limit: f64,
    pub u_use: f64,
    /// Gains of current, flux and speed control, and the natural frequency of the speed estimator.
    current_gain: f64,
    flux_gain: f64,
    speed_gain: f64,
    omega_n: f64,
    /// Limits of the torque, `least <= 0 <= most`, N m.
    torque: (f64, f64),
}

impl<'a> Conversion<'a> {
    pub fn new(machine: &'a Machine, inverter: &'a Inverter, p: &'a DriveParams, pu: &'a PerUnit) -> Self {
        let b = pu.base;
        let slow_periods = settings::slow_periods(inverter);
        let i_0 = p.psi_ref / pu.l_s;
        let i_max = p.i_max / b.i;
        let (u_limit, u_use) =
            if p.overmodulation { (U_REACH, U_OVERMODULATED) } else { (U_UTILISATION, U_UTILISATION) };
        // A single shunt takes its window from the middle duty.
        let window = p.window(inverter);
        Self {
            machine,
            inverter,
            p,
            pu,
            speed_periods: settings::speed_periods(p.scheme, slow_periods),
            slow_periods,
            adapt_periods: settings::adapt_periods(slow_periods),
            i_0,
            i_max,
            i_q_max: libm::sqrt(i_max * i_max - i_0 * i_0),
            i_trip: p.i_trip / b.i,
            i_range: SATURATED * p.i_range / b.i,
            u_limit: u_limit * (1.0 - window),
            u_use: u_use * (1.0 - window),
            current_gain: pu.hz(p.current_bandwidth) * pu.sigma_l_s,
            flux_gain: pu.hz(p.flux_bandwidth) / pu.l_s,
            speed_gain: pu.j * pu.hz(p.speed_bandwidth),
            omega_n: pu.hz(p.pll_bandwidth),
            torque: p.torque_limits.unwrap_or((-p.torque_max, p.torque_max)),
        }
    }

    /// Control periods in a time in s.
    pub fn periods(&self, t: f64) -> u32 {
        self.inverter.periods(t)
    }

    /// Normalised time of so many control periods.
    fn time(&self, periods: u32) -> f64 {
        self.pu.t_s * f64::from(periods)
    }

    /// Seconds from one run of speed and flux control to the next.
    fn slow(&self) -> f64 {
        f64::from(self.slow_periods) / self.inverter.f_c()
    }

    /// Rotor time constant, s.
    fn tau_r(&self) -> f64 {
        self.pu.tau_r / self.pu.base.omega
    }

    fn current_k_i(&self) -> f64 {
        self.pu.t_s * self.current_gain * self.pu.hz(self.p.current_bandwidth) / 5.0
    }

    fn speed_k_i(&self) -> f64 {
        self.time(self.slow_periods) * self.speed_gain * self.pu.hz(self.p.speed_bandwidth) / 4.0
    }

    fn torque_max(&self) -> f64 {
        self.torque.1.max(-self.torque.0) / self.pu.base.torque
    }

    /// Deviation of the speed at which the proportional part alone asks for the largest torque.
    fn lead(&self) -> f64 {
        (self.torque_max() / self.speed_gain).min(1.0)
    }

    /// What an acceleration in mechanical rad/s² and a jerk in rad/s³ are in a run of the ramp.
    fn ramp_units(&self) -> (f64, f64) {
        let acceleration = self.slow() * ramp::CALLS / self.pu.base.omega_m;
        (acceleration, self.slow() * acceleration)
    }

    /// Time of the boosted current at a start, s: the flux reaches its final value under it after `τ_r ln(B/(B-1))`, or
    /// nearly so after three `τ_r`.
    pub fn boost_time(&self) -> f64 {
        let boost = self.p.boost(self.machine);
        self.tau_r() * libm::log(boost / (boost - 1.0))
    }

    /// Checks that the arithmetic holds the constants that follow.
    ///
    /// # Errors
    /// The first field of which one does not fit, with the range in which it does.
    pub fn check<R: Real>(&self) -> Result<(), ParamError> {
        let Self { machine, inverter, p, pu, .. } = self;
        let b = pu.base;
        let t_slow = self.time(self.slow_periods);
        fits::<R>("J", machine.J, "kg m^2", self.speed_gain, 1.0)?;
        fits::<R>("speed_bandwidth", p.speed_bandwidth, "Hz", self.speed_k_i(), 2.0)?;
        fits::<R>("flux_bandwidth", p.flux_bandwidth, "Hz", self.flux_gain * pu.tau_r, 1.0)?;
        fits::<R>("flux_bandwidth", p.flux_bandwidth, "Hz", t_slow * self.flux_gain, 1.0)?;
        fits::<R>("current_bandwidth", p.current_bandwidth, "Hz", 1.0 / self.current_gain, -1.0)?;
        fits::<R>("current_bandwidth", p.current_bandwidth, "Hz", self.current_k_i(), 2.0)?;
        fits::<R>("current_bandwidth", p.current_bandwidth, "Hz", self.current_gain, 1.0)?;
        fits::<R>("pll_bandwidth", p.pll_bandwidth, "Hz", 2.0 * self.omega_n, 1.0)?;
        fits::<R>(
            "pll_bandwidth",
            p.pll_bandwidth,
            "Hz",
            self.time(self.speed_periods) * self.omega_n * self.omega_n,
            2.0,
        )?;
        #[cfg(feature = "enhanced")]
        if p.scheme == Scheme::Enhanced {
            FilterConfig::<R>::check(machine, inverter)?;
        }
        let sigma_l_s = pu.sigma_l_s;
        fits::<R>("L_M", machine.L_M, "H", pu.l_m * pu.l_m, 2.0)?;
        fits::<R>("L_sigma", machine.L_sigma, "H", 4.0 * sigma_l_s * sigma_l_s, 2.0)?;
        fits::<R>("L_sigma", machine.L_sigma, "H", 0.5 / sigma_l_s, -1.0)?;
        fits::<R>("i_max", p.i_max, "A", 1.0 / (0.9 * self.i_q_max * p.psi_ref), -1.0)?;
        let (acceleration, jerk) = self.ramp_units();
        for (field, value, unit, factor) in
            [("acceleration", p.acceleration, "rad/s²", acceleration), ("jerk", p.jerk, "rad/s³", jerk)]
        {
            if let Some(value) = value {
                fits::<R>(field, value, unit, value * factor, 1.0)?;
            }
        }
        for (field, body) in [("machine_overload[0]", p.machine_overload), ("bridge_overload[0]", p.bridge_overload)] {
            if let Some((current, _)) = body {
                fits::<R>(field, current, "A", 0.5 * b.i * b.i / (current * current), -2.0)?;
            }
        }
        if p.current_sensors == 1 {
            fits::<R>("f_s", inverter.f_s, "Hz", b.omega / inverter.f_s * pu.u_dc / sigma_l_s, -1.0)?;
        }
        if let Some((on, full)) = p.u_dc_chopper {
            check("u_dc_chopper[1]", full, on + b.u / R::LARGEST, p.u_dc_max, "V")
                .map_err(|e| e.with_note("a gain that follows from it must fit the arithmetic"))?;
        }
        fits::<R>("offset_time", p.offset_time, "s", 1.0 / f64::from(self.periods(p.offset_time)), -1.0)?;
        let time = p.build_up_time(machine);
        fits::<R>("magnetise_time", time, "s", 2.0 / f64::from(self.periods(time)), -1.0)?;
        #[cfg(feature = "paper")]
        if p.scheme == Scheme::Paper {
            fits::<R>("R_s", machine.R_s, "ohm", 1.0 / pu.r_s, -1.0)?;
        }
        Ok(())
    }

    pub fn speed<R: Real>(&self) -> SpeedConfig<R> {
        let (r, t_speed) = (rounded::<R>, self.time(self.speed_periods));
        SpeedConfig {
            t_s: r(t_speed),
            sigma_l_s: r(self.pu.sigma_l_s),
            r_r: r(self.pu.r_r),
            k_p: r(2.0 * self.omega_n),
            k_i: r(t_speed * self.omega_n * self.omega_n),
        }
    }

    pub fn current<R: Real>(&self) -> CurrentConfig<R> {
        let (r, k_p) = (rounded::<R>, self.current_gain);
        CurrentConfig { k_p: r(k_p), k_i: r(self.current_k_i()), inv_k_p: r(1.0 / k_p) }
    }

    pub fn flux_control<R: Real>(&self) -> FluxControlConfig<R> {
        let Self { p, pu, flux_gain, i_0, .. } = *self;
        let (r, t_slow) = (rounded::<R>, self.time(self.slow_periods));
        let memory = p.flux_memory(self.machine, self.inverter);
        FluxControlConfig {
            psi_rated: r(p.psi_ref),
            inv_psi_rated: r(1.0 / p.psi_ref),
            inv_l_s: r(1.0 / pu.l_s),
            one_minus_sigma: r(1.0 - pu.sigma_l_s / pu.l_s),
            root_i_q: r(4.0 * pu.sigma_l_s * pu.sigma_l_s),
            inv_two_sigma_l_s: r(0.5 / pu.sigma_l_s),
            memory: r(memory),
            k_p: r((1.0 - memory) * flux_gain * pu.tau_r),
            k_i: r(t_slow * flux_gain),
            limit: r(if p.scheme == Scheme::Enhanced { LIMIT.1 } else { LIMIT.0 } * i_0),
            limit_high: r((LIMIT_HIGH * i_0).min(100.0)),
            k_p_weak: r(((1.0 - memory) * WEAK_GAIN / pu.sigma_l_s).min(100.0)),
            k_i_weak: r((t_slow * WEAK_RATE * pu.hz(p.current_bandwidth) / pu.sigma_l_s).min(100.0)),
        }
    }

    pub fn weakening<R: Real>(&self) -> WeakeningConfig<R> {
        let Self { p, pu, .. } = *self;
        let (r, u_max) = (rounded::<R>, self.u_use * pu.u_dc);
        WeakeningConfig::new(
            r(if p.field_weakening { WEAKEST } else { 1.0 } * p.psi_ref),
            // |ψ_s|/|ψ_R| is l_s/l_M/cos δ with the load angle δ; sin 2δ is the part of pull-out.
            r(pu.r_s + pu.r_r * (pu.l_s / pu.l_m) * (pu.l_s / pu.l_m) / TO_PULL_OUT),
            r(self.time(self.adapt_periods) * pu.hz(p.flux_bandwidth) / 2.0),
            r((1.0 / (u_max * u_max)).min(100.0)),
            (
                r(weakening::RISE * f64::from(self.slow_periods) / self.inverter.f_c()),
                r(weakening::RISE_OF_VOLTAGE * f64::from(self.adapt_periods) / self.inverter.f_c()),
            ),
        )
    }

    pub fn speed_control<R: Real>(&self) -> SpeedControlConfig<R> {
        let Self { p, pu, speed_gain, torque: (least, most), .. } = *self;
        let r = rounded::<R>;
        SpeedControlConfig {
            k_p: r(speed_gain),
            k_i: r(self.speed_k_i()),
            per_t: r(self.speed_k_i() / speed_gain),
            weight: r(p.set_point_weight),
            lead: r(self.lead()),
            inv_gain: r((SPEED_GAIN * pu.hz(p.current_bandwidth) / speed_gain).clamp(1.0, 100.0)),
            torque_max: r(self.torque_max()),
            torque_pos: r(most / pu.base.torque),
            torque_neg: r(-least / pu.base.torque),
        }
    }

    pub fn supervision<R: Real>(&self) -> SupervisionConfig<R> {
        let Self { p, pu, .. } = *self;
        let r = rounded::<R>;
        let calls = |t: f64| self.periods(t / f64::from(SUPERVISION_PERIODS));
        #[cfg(feature = "supervision")]
        let watched = |t: f64| if p.supervision { calls(t).max(2) } else { u32::MAX };
        #[cfg(feature = "supervision")]
        let open = OPEN.max(OPEN_LAG * self.tracking_error().min(1.0) / (core::f64::consts::TAU * p.current_bandwidth));
        SupervisionConfig {
            plausibility: PlausibilityConfig {
                psi_deviation: r(plausibility::DEVIATION * p.psi_ref),
                omega_max: r(plausibility::OVER_SPEED * p.omega_max / pu.base.omega_m),
                calls: calls(plausibility::TIME),
                confidence: p.low_confidence == LowConfidence::Fault,
            },
            #[cfg(feature = "supervision")]
            phases: PhaseConfig {
                floor_sq: r(phases::FLOOR * phases::FLOOR),
                small_floor_sq: r(phases::SMALL_FLOOR * phases::SMALL_FLOOR),
                calls_open: watched(open).max(OPEN_PERIODS / SUPERVISION_PERIODS),
                calls_control: watched(phases::CONTROL_TIME),
                calls_zero: watched(open),
                t_s: r(pu.t_s * f64::from(SUPERVISION_PERIODS)),
                lag: r((pu.t_s * f64::from(SUPERVISION_PERIODS) * pu.hz(p.current_bandwidth) / phases::LAG).min(1.0)),
            },
            #[cfg(feature = "supervision")]
            channels: ChannelConfig {
                limit: r(channels::GAIN_ERROR * self.i_range + channels::BESIDE),
                // A computed current makes the sum zero.
                calls: if p.current_sensors < 3 { u32::MAX } else { watched(channels::TIME) },
            },
            #[cfg(feature = "supervision")]
            innovation: {
                let seconds = f64::from(SUPERVISION_PERIODS) / self.inverter.f_c();
                let gain = |h: f64| r(if p.supervision { seconds / h } else { 0.0 });
                let low_pass = nis_time(self.machine, self.inverter);
                let least = |(seconds, times): (f64, f64)| f64::max(seconds, times * low_pass);
                let falling = (FLUX_FALLS * self.tau_r()).max(least(FLUX_FALLS_LEAST));
                InnovationConfig { gain: gain(least(LOST_FIELD)), gain_falling: gain(falling) }
            },
            #[cfg(feature = "supervision")]
            stall_calls: if p.stall_time > 0.0 { watched(p.stall_time) } else { u32::MAX },
        }
    }

    /// Tracking error of current control, per unit of current, while twice the rated torque accelerates the shaft: the slope of the voltage that
    /// the rated flux induces over the integral gain. At most 0.1 for the ten drives of docs/tolerance.md, 0.3
    /// for nearly all that are drawn there, 1 to 5 for small ones with a control of 2 to 5 kHz.
    #[cfg(feature = "supervision")]
    fn tracking_error(&self) -> f64 {
        let slope = 2.0 * self.pu.torque_rated / self.pu.j;
        slope * self.pu.t_s / self.current_k_i()
    }

    pub fn ramp<R: Real>(&self) -> RampConfig<R> {
        let (r, (acceleration, jerk)) = (rounded::<R>, self.ramp_units());
        RampConfig::new(
            r(self.p.acceleration.map_or(0.0, |a| a * acceleration)),
            r(self.p.jerk.map_or(0.0, |j| j * jerk)),
            r((2.0 * self.lead()).min(1.0)),
        )
    }

    /// Of the machine and of the bridge.
    pub fn overload<R: Real>(&self) -> [OverloadConfig<R>; 2] {
        let (r, b) = (rounded::<R>, self.pu.base);
        [self.p.machine_overload, self.p.bridge_overload].map(|body| {
            let (i_c_sq, rate) = body.map_or((1.0, 0.0), |(current, time)| {
                let interval = f64::from(self.adapt_periods * overload::CALLS) / self.inverter.f_c();
                (2.0 * current * current / (b.i * b.i), interval / time)
            });
            OverloadConfig::new(r(i_c_sq), r(1.0 / i_c_sq), r(rate))
        })
    }

    #[cfg(feature = "supervision")]
    pub fn realign<R: Real>(&self) -> RealignConfig<R> {
        let calls = |t: f64| self.periods(t / f64::from(self.slow_periods));
        let test = (REALIGN_TEST * self.pu.tau_r / self.pu.base.omega).max(REALIGN);
        RealignConfig {
            suspicion: if self.p.realignment { calls(REALIGN) } else { u32::MAX },
            test: match self.p.scheme {
                Scheme::Paper => 0,
                Scheme::Enhanced => calls(test),
            },
            relative_test: rounded((test / REALIGN).min(50.0)),
            low_pass: rounded((self.slow() / REALIGN_LOW_PASS).min(1.0)),
        }
    }

    #[cfg(feature = "supervision")]
    pub fn swing<R: Real>(&self) -> SwingConfig<R> {
        let found = SwingConfig::new(self.speed_gain, self.omega_n, self.time(self.slow_periods));
        if self.p.reduce_gain { found } else { SwingConfig { calls: 0, ..found } }
    }

    #[cfg(feature = "dclink")]
    pub fn dclink<R: Real>(&self) -> DcLinkConfig<R> {
        let Self { p, pu, .. } = *self;
        let (r, b) = (rounded::<R>, pu.base);
        let u = |volts: Option<f64>, without: f64| volts.map_or(without, |u| u / b.u);
        let (on, full) =
            p.u_dc_chopper.map_or((dclink::NEVER, dclink::NEVER + 1.0), |(on, full)| (on / b.u, full / b.u));
        DcLinkConfig {
            u_brake: r(u(p.u_dc_brake, dclink::NEVER)),
            u_buffer: r(u(p.u_dc_buffer, -dclink::NEVER)),
            inv_width: r((1.0 / (dclink::WIDTH * pu.u_dc)).min(100.0)),
            u_on: r(on),
            inv_span: r(1.0 / (full - on)),
        }
    }

    #[cfg(feature = "encoder")]
    pub fn hand_over<R: Real>(&self) -> HandOverConfig<R> {
        let (r, p) = (rounded::<R>, self.p);
        // The ripple of one count ([`crate::estimate::encoder`]).
        let ripple = count_angle(p.encoder_lines.max(1), self.machine.n_p) * self.omega_n / core::f64::consts::E;
        let calls = |t: f64| self.periods(t / f64::from(self.speed_periods));
        HandOverConfig {
            band: r((p.encoder_deviation / self.pu.base.omega_m + ripple).min(100.0)),
            gain: r(f64::from(self.speed_periods) / self.inverter.f_c() / handover::FILTER),
            calls_apart: calls(handover::APART),
            calls_return: calls(handover::RETURN),
            control: p.encoder_mode == settings::EncoderMode::Control,
            fault: p.encoder_fault,
        }
    }

    #[cfg(feature = "shunt")]
    pub fn shunt<R: Real>(&self) -> Option<ShuntConfig<R>> {
        let Self { p, pu, inverter, .. } = *self;
        (p.current_sensors == 1).then(|| {
            ShuntConfig::new(
                (p.window(inverter), 2.0 * p.shunt_settling * inverter.f_s),
                pu.base.omega / inverter.f_s / (2.0 * pu.sigma_l_s),
                pu.u_dc,
            )
        })
    }
}

/// Checks that the arithmetic `R` holds a constant `x`, which is proportional to this power of a field (or grows with
/// at least this power).
fn fits<R: Real>(field: &'static str, value: f64, unit: &'static str, x: f64, power: f64) -> Result<(), ParamError> {
    let at = |limit: f64| value * libm::pow(limit / x, 1.0 / power);
    let (a, b) = (at(R::LEAST_GAIN), at(R::LARGEST));
    check(field, value, a.min(b), a.max(b), unit)
        .map_err(|e| e.with_note("a gain that follows from it must fit the arithmetic"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_modulator_leaves_the_nearest_voltage_of_the_hexagon_with_the_fundamental_that_is_counted_on() {
        use crate::control::modulator::{applied, modulate};
        use crate::space::AlphaBeta;
        let steps = 3600;
        let (mut along, mut farthest) = (0.0, 0.0f64);
        for k in 0..steps {
            let (sin, cos) = libm::sincos(f64::from(k) * core::f64::consts::TAU / f64::from(steps));
            let u = AlphaBeta::new(U_REACH * cos, U_REACH * sin);
            let left = applied(&modulate(u.to_phases(), 1.0, None));
            along += (left.re() * cos + left.im() * sin) / f64::from(steps);
            // The edge that faces the reference is at right angles to what is cut off.
            let cut = u - left;
            let length = cut.norm_sq().sqrt();
            if length > 1e-9 {
                farthest = farthest.max(length);
                let distance = (left.re() * cut.re() + left.im() * cut.im()) / length;
                assert!((distance - 1.0 / 3f64.sqrt()).abs() < 1e-9, "{k}: {distance}");
            }
        }
        assert!((along - 0.6007).abs() < 1e-4 && along > U_OVERMODULATED, "{along}");
        assert!((farthest - (U_REACH - 1.0 / 3f64.sqrt())).abs() < 1e-4, "{farthest}");
    }
}
