//! Configuration of a drive: what a user sets, in SI units where there are any, and what the control
//! step reads, per unit, with every division done beforehand.

use crate::base::{Base, PerUnit, rounded};
use crate::control::current::CurrentConfig;
use crate::control::flux::FluxControlConfig;
use crate::control::speed::SpeedControlConfig;
use crate::estimate::speed::SpeedConfig;
use crate::inverter::InverterModel;
#[cfg(feature = "enhanced")]
use crate::observer::EnhancedConfig;
#[cfg(feature = "paper")]
use crate::observer::PublishedConfig;
use crate::params::{Inverter, Machine, ParamError, check};
use crate::scalar::{Real, Timer};
use crate::words::{Words, words};

/// Magnetising current during the build-up of the flux, as multiple of its final value.
pub(crate) const BOOST: f64 = 1.5;

/// Largest offset of a current channel at rest, per unit.
pub(crate) const I_OFF_MAX: f64 = 0.15;

/// Control periods from one run of the speed estimator to the next, and of each slower block.
pub const SPEED_PERIODS: u32 = 2;
/// Control periods from one run to the next of speed and flux control, resistance adaptation and confidence.
pub const SLOW_PERIODS: u32 = 4;

/// Which estimators a drive runs, of those that the build has (features `paper` and `enhanced`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Scheme {
    /// The published scheme: offset estimator, noise compensator, resistance adaptation.
    Paper,
    /// One filter for flux, offset, resistance and inverter error, with a covariance that says how far it can
    /// be trusted.
    Enhanced,
}

impl Scheme {
    /// The schemes of this build.
    pub const ALL: &[Self] = &[
        #[cfg(feature = "paper")]
        Self::Paper,
        #[cfg(feature = "enhanced")]
        Self::Enhanced,
    ];

    /// The same as a word: bit 0 the published one, bit 1 the enhanced one. A stored configuration fits only
    /// a build of the same schemes.
    pub const BUILT: u32 = cfg!(feature = "paper") as u32 | (cfg!(feature = "enhanced") as u32) << 1;

    /// An error if the scheme is left out of this build.
    fn check(self) -> Result<(), ParamError> {
        let (first, last) = (f64::from(u8::from(Self::BUILT & 1 == 0)), f64::from(Self::BUILT >> 1));
        check("scheme", f64::from(self as u8), first, last, "(0: feature paper, 1: feature enhanced)")
    }
}

impl Default for Scheme {
    /// The enhanced one, if the build has it.
    fn default() -> Self {
        if cfg!(feature = "enhanced") { Self::Enhanced } else { Self::Paper }
    }
}

impl Words for Scheme {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self as u32);
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        if from() == Self::Paper as u32 { Self::Paper } else { Self::Enhanced }
    }
}

/// What a drive does while its confidence in the field angle is below one half: an error of 15° and more must be
/// expected then, and torque is no longer what it is asked to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum LowConfidence {
    /// Nothing: the signal is for the user.
    #[default]
    Keep,
    /// Limits the torque in proportion to the confidence: to the whole at one half, to nothing at zero.
    LimitTorque,
    /// Stops with [`crate::drive::Fault::LowConfidence`] after 50 ms.
    Fault,
}

impl Words for LowConfidence {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self as u32);
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        match from() {
            0 => Self::Keep,
            1 => Self::LimitTorque,
            _ => Self::Fault,
        }
    }
}

/// Settings of a drive. [`DriveParams::new`] derives every value from machine and inverter; change single
/// fields from there.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DriveParams {
    /// Which estimators to run.
    pub scheme: Scheme,
    /// Flux reference, per unit of rated flux `U_N √(2/3) / omega_sR`; 0.3 to 1.2.
    pub psi_ref: f64,
    /// Largest current reference, A peak.
    pub i_max: f64,
    /// Largest torque reference, N·m.
    pub torque_max: f64,
    /// Largest mechanical speed reference, rad/s.
    pub omega_max: f64,
    /// Over-current trip level, A peak of the space vector.
    pub i_trip: f64,
    /// Full scale of the current sensors, A: a reading at or beyond it is a fault.
    pub i_range: f64,
    /// Smallest dc-link voltage, V.
    pub u_dc_min: f64,
    /// Largest dc-link voltage, V.
    pub u_dc_max: f64,
    /// Bandwidth of current control, Hz.
    pub current_bandwidth: f64,
    /// Bandwidth of flux control, Hz.
    pub flux_bandwidth: f64,
    /// Bandwidth of speed control, Hz.
    pub speed_bandwidth: f64,
    /// Natural frequency of the speed estimator's phase-locked loop, Hz.
    pub pll_bandwidth: f64,
    /// Inverter model: compensation of threshold and dead time.
    pub inverter_model: bool,
    /// Offset estimator; in the enhanced scheme, offsets as states of the filter.
    pub offset_estimator: bool,
    /// Part of the measured offset voltage taken over per fundamental period.
    pub offset_gain: f64,
    /// Noise compensator; in the enhanced scheme, correction by the filter's residual at all.
    pub noise_compensator: bool,
    /// Smallest and largest gain of the noise compensator, per unit.
    pub noise_gain: (f64, f64),
    /// Stator resistance adaptation; in the enhanced scheme, resistance and inverter error as states.
    pub resistance_adaptation: bool,
    /// Gain of the adaptation: change of `r̂_s` in per unit, per second and unit of ε. In per unit the answer to a
    /// wrong resistance, `2 k i_q/ω_s`, is the same for all machines.
    pub resistance_gain: f64,
    /// Read the current offsets with gates off before each start, and `r̂_s` while magnetising.
    pub calibrate_offset: bool,
    /// Duration of the reading of the offsets, s.
    pub offset_time: f64,
    /// Duration of the magnetisation, s.
    pub magnetise_time: f64,
    /// What to do while the confidence is low.
    pub low_confidence: LowConfidence,
    /// Stator frequency that the enhanced scheme keeps under load, electrical rad/s: where it would be smaller the
    /// flux is lowered, by at most 30 % ([`crate::control::shift`]). 0: the flux stays.
    pub omega_s_min: f64,
}

impl DriveParams {
    /// Defaults for a machine on an inverter.
    #[must_use]
    pub fn new(machine: &Machine, inverter: &Inverter) -> Self {
        let i_n = machine.I_N * core::f64::consts::SQRT_2;
        let tau_r = machine.L_M / machine.R_R;
        Self {
            scheme: Scheme::default(),
            psi_ref: 1.0,
            i_max: 1.8 * i_n,
            torque_max: 1.5 * machine.T_N,
            omega_max: 2.2 * machine.omega_sR() / f64::from(machine.n_p),
            i_trip: 2.3 * i_n,
            i_range: 2.5 * i_n,
            u_dc_min: 0.6 * inverter.u_dc,
            u_dc_max: 1.45 * inverter.u_dc,
            current_bandwidth: 0.03 * inverter.f_s,
            flux_bandwidth: 5.0,
            speed_bandwidth: 9.0,
            pll_bandwidth: 25.0,
            inverter_model: true,
            offset_estimator: true,
            offset_gain: 0.5,
            noise_compensator: true,
            noise_gain: (0.06, 0.5),
            resistance_adaptation: true,
            resistance_gain: 0.42,
            calibrate_offset: true,
            offset_time: 0.1,
            magnetise_time: (4.0 * tau_r).max(1.4),
            low_confidence: LowConfidence::Keep,
            omega_s_min: 0.006 * machine.omega_sR(),
        }
    }

    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let i_n = machine.I_N * core::f64::consts::SQRT_2;
        let f_s = inverter.f_s;
        let tau_r = machine.L_M / machine.R_R;
        check("psi_ref", self.psi_ref, 0.3, 1.2, "p.u.")?;
        let i_0 = self.psi_ref * Base::new(machine).psi / machine.L_s();
        check("i_max", self.i_max, 1.1 * i_0, 5.0 * i_n, "A")?;
        check("torque_max", self.torque_max, 0.05 * machine.T_N, 5.0 * machine.T_N, "N m")?;
        let omega_n = machine.omega_sR() / f64::from(machine.n_p);
        check("omega_max", self.omega_max, 0.01 * omega_n, 3.0 * omega_n, "rad/s")?;
        check("i_trip", self.i_trip, self.i_max, 8.0 * i_n, "A")?;
        check("i_range", self.i_range, self.i_trip, 20.0 * i_n, "A")?;
        check("u_dc_min", self.u_dc_min, 0.0, inverter.u_dc, "V")?;
        check("u_dc_max", self.u_dc_max, inverter.u_dc, 3.0 * inverter.u_dc, "V")?;
        check("current_bandwidth", self.current_bandwidth, 10.0, 0.06 * f_s, "Hz")?;
        check("flux_bandwidth", self.flux_bandwidth, 0.1, 30.0, "Hz")?;
        check("speed_bandwidth", self.speed_bandwidth, 0.05, 20.0, "Hz")?;
        // A fifteenth of the rate at which the loop runs.
        check("pll_bandwidth", self.pll_bandwidth, 2.0, (0.03 * f_s).min(100.0), "Hz")?;
        check("offset_gain", self.offset_gain, 0.01, 1.0, "")?;
        check("noise_gain[0]", self.noise_gain.0, 0.0, 1.0, "")?;
        check("noise_gain[1]", self.noise_gain.1, self.noise_gain.0, 4.0, "")?;
        check("resistance_gain", self.resistance_gain, 0.0, 5.0, "p.u./s")?;
        check("offset_time", self.offset_time, 10.0 / f_s, 10.0, "s")?;
        check("magnetise_time", self.magnetise_time, 3.0 * tau_r, 60.0, "s")?;
        check("omega_s_min", self.omega_s_min, 0.0, 0.05 * machine.omega_sR(), "rad/s")
    }
}

/// What the control step reads: constants, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DriveConfig<R: Real> {
    pub(crate) t_s: R,
    pub(crate) inverter: InverterModel<R>,
    pub(crate) timer: Option<Timer>,
    pub(crate) scheme: Scheme,
    #[cfg(feature = "paper")]
    pub(crate) published: PublishedConfig<R>,
    #[cfg(feature = "enhanced")]
    pub(crate) enhanced: EnhancedConfig<R>,
    pub(crate) speed: SpeedConfig<R>,
    pub(crate) current: CurrentConfig<R>,
    pub(crate) flux_control: FluxControlConfig<R>,
    pub(crate) speed_control: SpeedControlConfig<R>,
    pub(crate) low_confidence: LowConfidence,
    /// From a sample to the middle of the duties' effect.
    pub(crate) t_ahead: R,
    pub(crate) i_range: R,
    /// Sum of the squared phase currents below which neither range nor trip level can be reached.
    pub(crate) i_plain_sq: R,
    pub(crate) i_trip: R,
    pub(crate) i_q_max: R,
    pub(crate) pull_out_use: R,
    pub(crate) u_dc_min: R,
    pub(crate) u_dc_max: R,
    pub(crate) omega_max: R,
    pub(crate) omega_trip: R,
    pub(crate) psi_deviation: R,
    pub(crate) implausible_max: u32,
    pub(crate) calibrate_offset: bool,
    pub(crate) offset_periods: u32,
    pub(crate) inv_offset_periods: R,
    pub(crate) magnetise_periods: u32,
    pub(crate) boost_periods: u32,
}
words! {
    DriveConfig:
    t_s, inverter, timer, scheme,
    #[cfg(feature = "paper")] published,
    #[cfg(feature = "enhanced")] enhanced,
    speed, current, flux_control, speed_control, low_confidence, t_ahead, i_range, i_plain_sq,
    i_trip, i_q_max, pull_out_use, u_dc_min, u_dc_max, omega_max, omega_trip, psi_deviation,
    implausible_max, calibrate_offset, offset_periods, inv_offset_periods, magnetise_periods, boost_periods,
}

impl<R: Real> DriveConfig<R> {
    /// Settings of the speed estimator, for its use alone.
    pub fn speed_config(&self) -> &SpeedConfig<R> {
        &self.speed
    }

    /// Settings of the current controller.
    pub fn current_config(&self) -> &CurrentConfig<R> {
        &self.current
    }

    /// Settings of the flux controller.
    pub fn flux_control_config(&self) -> &FluxControlConfig<R> {
        &self.flux_control
    }

    /// The inverter model.
    pub fn inverter_model(&self) -> &InverterModel<R> {
        &self.inverter
    }

    /// Resolution of the PWM timer, if duties are multiples of its counts.
    pub fn timer(&self) -> Option<&Timer> {
        self.timer.as_ref()
    }

    /// Settings of the speed controller.
    pub fn speed_control_config(&self) -> &SpeedControlConfig<R> {
        &self.speed_control
    }

    /// Per-unit configuration of validated settings.
    ///
    /// # Errors
    /// The first field of machine, inverter or settings outside its admissible range.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(machine: &Machine, inverter: &Inverter, p: &DriveParams) -> Result<Self, ParamError> {
        let pu = PerUnit::<R>::new(machine, inverter)?;
        p.scheme.check()?;
        p.validate(machine, inverter)?;
        let b = Base::new(machine);
        let r = rounded::<R>;
        let hz = |f: f64| core::f64::consts::TAU * f / b.omega;
        let periods = |t: f64| inverter.periods(t);

        let t_s = b.omega / inverter.f_s;
        let (t_speed, t_slow) = (t_s * f64::from(SPEED_PERIODS), t_s * f64::from(SLOW_PERIODS));
        let slow_periods = |t: f64| periods(t / f64::from(SLOW_PERIODS));
        let l_s = machine.L_s() / b.l;
        let sigma_l_s = machine.L_sigma / b.l;
        let tau_r = machine.L_M / machine.R_R * b.omega;
        let l_product = l_s * sigma_l_s;
        let i_0 = p.psi_ref / l_s;
        let i_max = p.i_max / b.i;
        let i_q_max = libm::sqrt(i_max * i_max - i_0 * i_0);
        let i_trip = p.i_trip / b.i;
        // Readings are within their range if the currents are, less the largest offset taken off them.
        let plain = (p.i_range / b.i - I_OFF_MAX).max(0.0);

        let k_p = hz(p.current_bandwidth) * sigma_l_s;
        let flux_gain = hz(p.flux_bandwidth) / l_s;
        let j = machine.J * b.omega_m * b.omega / b.torque;
        let speed_gain = j * hz(p.speed_bandwidth);
        let omega_n = hz(p.pll_bandwidth);
        let magnetise_periods = periods(p.magnetise_time);
        // Flux reaches its final value under the boosted current after τ_r ln(B/(B-1)).
        let boost_time = tau_r / b.omega * libm::log(BOOST / (BOOST - 1.0));

        Ok(Self {
            t_s: pu.t_s,
            inverter: if p.inverter_model {
                InverterModel::new(machine, inverter, &pu)
            } else {
                InverterModel::ideal()
            },
            timer: (inverter.f_clk > 0.0).then(|| Timer::new((inverter.f_clk / (2.0 * inverter.f_s)) as u32)),
            scheme: p.scheme,
            #[cfg(feature = "paper")]
            published: PublishedConfig::new(machine, inverter, &pu, p, magnetise_periods),
            #[cfg(feature = "enhanced")]
            enhanced: EnhancedConfig::new(machine, inverter, &pu, p, i_q_max),
            speed: SpeedConfig {
                t_s: r(t_speed),
                sigma_l_s: pu.sigma_l_s,
                r_r: pu.r_r,
                k_p: r(2.0 * omega_n),
                k_i: r(t_speed * omega_n * omega_n),
            },
            current: CurrentConfig {
                k_p: r(k_p),
                k_i: r(t_s * k_p * hz(p.current_bandwidth) / 5.0),
                inv_k_p: r(1.0 / k_p),
            },
            flux_control: FluxControlConfig {
                psi_rated: r(p.psi_ref),
                inv_psi_rated: r(1.0 / p.psi_ref),
                psi_min: r(0.2 * p.psi_ref),
                l_sum: r(l_s + sigma_l_s),
                root_psi: r((l_s - sigma_l_s) * (l_s - sigma_l_s)),
                root_i_q: r(4.0 * l_product * l_product),
                inv_two_l_product: r(0.5 / l_product),
                k_p: r(flux_gain * tau_r),
                k_i: r(t_slow * flux_gain),
                limit: r(0.3 * i_0),
            },
            speed_control: SpeedControlConfig {
                k_p: r(speed_gain),
                k_i: r(t_slow * speed_gain * hz(p.speed_bandwidth) / 4.0),
                torque_max: r(p.torque_max / b.torque),
            },
            low_confidence: p.low_confidence,
            t_ahead: r(1.5 * t_s),
            i_range: r(p.i_range / b.i),
            i_plain_sq: r((plain * plain).min(1.5 * i_trip * i_trip).min(100.0)),
            i_trip: r(i_trip),
            i_q_max: r(i_q_max),
            pull_out_use: r(0.8 * (1.0 - sigma_l_s / l_s) / (2.0 * sigma_l_s)),
            u_dc_min: r(p.u_dc_min / b.u),
            u_dc_max: r(p.u_dc_max / b.u),
            omega_max: r(p.omega_max / b.omega_m),
            omega_trip: r(1.3 * p.omega_max / b.omega_m),
            psi_deviation: r(0.4 * p.psi_ref),
            implausible_max: slow_periods(0.05),
            calibrate_offset: p.calibrate_offset,
            offset_periods: periods(p.offset_time),
            inv_offset_periods: r(1.0 / f64::from(periods(p.offset_time))),
            magnetise_periods,
            boost_periods: periods(boost_time),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scheme_that_is_not_built_is_refused_by_name() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        for scheme in [Scheme::Paper, Scheme::Enhanced] {
            let params = DriveParams { scheme, ..DriveParams::new(&machine, &inverter) };
            match DriveConfig::<f32>::new(&machine, &inverter, &params) {
                Ok(_) => assert!(Scheme::ALL.contains(&scheme)),
                Err(e) => assert!(e.field == "scheme" && !Scheme::ALL.contains(&scheme), "{e}"),
            }
        }
        assert!(Scheme::ALL.contains(&Scheme::default()));
    }
}
