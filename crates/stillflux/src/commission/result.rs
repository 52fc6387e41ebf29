//! Result of a commissioning: machine and inverter with the deviation of each value, from the means that the
//! procedures kept.
//!
//! ```text
//! R_s = R - r_d      ψ_N: rated flux      L_s = L_u/(1 + c)      L_l = bar/(1/L_σ' - 1/L_u)      L_σ = L_s L_l/(L_s + L_l)
//! L_M = L_s - L_σ    R_R = R_r (L_s/(L_s + L_l))²
//! ```
//!
//! The machine found is the equivalent circuit at slip frequency. Ramps show the leakage `L_σ'` at high frequency; that of slip frequency, from
//! which the rotor flux follows, is larger by the factor `bar` ([`MagnetisingCurve::bar`]) where the rotor has deep bars. The gains of current
//! control follow from it as well: it is faster by up to that factor than with `L_σ'`.
//!
//! The fits begin with the nameplate's values, the later ones with what the earlier found. A procedure that was not
//! completed leaves the nameplate's value with its deviation.

use super::bridge::{self, BridgeCurve};
use super::magnetising::{self, Guess, MagnetisingCurve, Reading};
use super::nameplate::Deviation;
use super::{Commissioning, RISE, Stage};
use crate::config::DriveParams;
#[cfg(feature = "enhanced")]
use crate::config::EnhancedParams;
use crate::estimate::priors::Priors;
use crate::page::Ready;
use crate::params::{Gamma, Inverter, Machine, ParamError, Rating, Saturation};
use crate::scalar::Real;
use crate::si::MemorySi;

/// Relative standard deviation that the gains of the current sensors add to every impedance: three channels of 1 %, or one.
const DEVIATION_GAIN: [f64; 2] = [0.006, 0.01];
/// Model error of the leakage inductance: frequency, iron loss.
const DEVIATION_LEAKAGE: f64 = 0.02;
/// Model error of rotor resistance and magnetising inductance.
const DEVIATION_MODEL: f64 = 0.01;

/// The same of the magnetising inductance, by the square of the part of the rotor time constant in which the current goes from one value to
/// the next: the flux has begun to follow by then. Allowance: at 2.2 kW it is off by 1.5, 4 and 13 % where that part is 0.12, 0.16 and 0.23.
const DEVIATION_RISE: f64 = 3.0;

/// What a value may change after the commissioning, relative: temperature of winding and cage (38 K), switches, capacitance of
/// the cables; and what one value of an inductance leaves out: the leakage at other frequencies and currents, the iron beyond its curve.
/// With 0.03 and 0.02 for the inductances, and the leakage of high frequency, 10 of 120 runs of commissioned drives on motors with deep bars and eddy
/// currents (slow crossing, load steps, random speeds and loads) were lost, 9 of them by "field lost", and 2 with these; of 90 runs of other motors, at
/// which nothing had been looked at before, 9 and 3.
const LATER: Priors = Priors { r_s: 0.15, loss: 0.02, knee: 0.1, leakage: 0.1, r_r: 0.15, l_m: 0.06 };
/// Range of a deviation that a prior is made of.
const PRIOR: (f64, f64) = (0.01, 0.7);

/// Priors of a drive for deviations of the machine and, of the inverter, those of threshold and dead time and of the knee:
/// what is known well moves little, but may change after the commissioning.
#[must_use]
pub fn priors(d: &Deviation, [loss, knee]: [f64; 2]) -> Priors {
    let with = |found: f64, later: f64| libm::hypot(found.clamp(PRIOR.0, PRIOR.1), later);
    Priors {
        r_s: with(d.R_s, LATER.r_s).min(0.5),
        loss: with(loss, LATER.loss),
        knee: with(knee, LATER.knee),
        leakage: with(d.L_sigma, LATER.leakage),
        r_r: with(d.R_R, LATER.r_r).min(0.5),
        l_m: with(d.L_M, LATER.l_m).min(0.5),
    }
}

/// What should be looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Warnings {
    /// The curve of the bridge does not fit: legs differ, or its capacitance is not constant.
    pub bridge_fit: bool,
    /// The curve of the magnetising flux does not fit.
    pub magnetising_fit: bool,
    /// Rated flux was not reached: `L_M` is extrapolated.
    pub flux_not_reached: bool,
    /// A value is further than four deviations from the nameplate's: wrong plate or wrong connection.
    pub far_from_nameplate: bool,
    /// Not all procedures were completed.
    pub incomplete: bool,
    /// The run with a free shaft gave no inertia.
    pub no_inertia: bool,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// The machine, with its saturation curve if that was found.
    pub machine: Machine,
    /// The inverter with its curve.
    pub inverter: Inverter,
    /// Relative standard deviations of the machine's values.
    pub deviation: Deviation,
    /// Standard deviation of the factor of threshold and dead time, and relative one of the knee.
    pub deviation_inverter: [f64; 2],
    /// Standard deviation of each of `leg_delay` of the inverter, s, if the legs were compared.
    pub deviation_legs: Option<f64>,
    /// Mean friction torque at low speed, N·m, if the shaft was free.
    pub friction: Option<f64>,
    /// The fits, where there are any.
    pub bridge: Option<BridgeCurve>,
    /// The magnetising curve.
    pub magnetising: Option<MagnetisingCurve>,
    /// What should be looked at.
    pub warnings: Warnings,
}

impl Found {
    /// Settings of a drive for what was found: the defaults, with the deviations as priors.
    #[must_use]
    pub fn params(&self) -> DriveParams {
        let params = DriveParams::new(&self.machine, &self.inverter);
        #[cfg(feature = "enhanced")]
        let params = {
            let Priors { r_s, loss, knee, leakage, r_r, l_m } = priors(&self.deviation, self.deviation_inverter);
            let enhanced = EnhancedParams {
                prior_R_s: r_s,
                prior_loss: loss,
                prior_c_out: knee,
                prior_L_sigma: leakage,
                prior_R_R: r_r,
                prior_L_M: l_m,
                ..params.enhanced
            };
            DriveParams { enhanced, ..params }
        };
        params
    }

    /// Content of a parameter page for what was found ([`crate::page`]), by [`Found::params`]. `full`: full scale of the
    /// current channels in A and of the dc-link channel in V.
    ///
    /// # Errors
    /// A value found that no drive accepts.
    pub fn ready<R: Real>(&self, full: (f64, f64)) -> Result<Ready<R>, ParamError> {
        let memory = MemorySi::of(&self.machine, &self.inverter);
        Ready::new(&self.machine, &self.inverter, &self.params(), full, &memory)
    }
}

impl<R: Real> Commissioning<R> {
    /// Voltage, current and fitted voltage of the levels of the bridge that were read, per unit.
    #[must_use]
    pub fn bridge_readings(&self) -> [Option<[f64; 3]>; bridge::LEVELS.len()] {
        let (found, record) = (self.result().ok(), &self.state.bridge);
        let curve =
            found.and_then(|f| Some((f.bridge?, BridgeCurve::mean_loss(&f.bridge?.inverter, &f.machine).ok()?)));
        core::array::from_fn(|k| {
            let (fit, loss) = curve.as_ref().filter(|_| k < record.level)?;
            let (u, i) = (record.u[k].to_f64(), record.i[k].to_f64());
            Some([u, i, fit.r * i + loss(i)])
        })
    }

    /// What the completed procedures have found. Double precision, some seconds on a microcontroller without such a
    /// unit: not for the control interrupt.
    ///
    /// # Errors
    /// A value found that no machine or inverter can have.
    #[allow(non_snake_case)]
    pub fn result(&self) -> Result<Found, ParamError> {
        let (c, s) = (&self.config, &self.state);
        let pu = &c.pu;
        let mut machine = c.machine;
        let mut found = Found {
            machine,
            inverter: c.sheet,
            deviation: c.deviation,
            deviation_inverter: [0.15, 0.7],
            deviation_legs: None,
            friction: None,
            bridge: None,
            magnetising: None,
            warnings: Warnings::default(),
        };
        let done = |procedure| c.completed(procedure, s.stage);
        found.warnings.incomplete = !Stage::PROCEDURES.into_iter().all(done);
        let (u, i) = (s.bridge.u.map(R::to_f64), s.bridge.i.map(R::to_f64));
        // The leakage inductance moves the sampled current against that at the edges: fit, inductance, fit. The differences
        // of the legs need the resistance, and move it by less than a thousandth.
        #[cfg_attr(not(feature = "legs"), allow(unused_mut))]
        let mut sheet = c.sheet;
        let fit = |machine: &Machine, sheet: &Inverter| match done(Stage::Bridge) {
            true => bridge::fit(machine, sheet, &u, &i, s.bridge.level),
            false => {
                let (inverter, deviation) = (*sheet, found.deviation_inverter);
                Ok(BridgeCurve { inverter, r: pu.r_s + pu.r_r, deviation, residual: 0.0 })
            }
        };
        let mut curve = fit(&machine, &sheet)?;
        if done(Stage::Leakage) {
            let (l, saturated) = s.leakage.inductance(curve.r, pu.t_s);
            machine.L_sigma = l * pu.base.l;
            machine.validate()?;
            curve = fit(&machine, &sheet)?;
            let model = libm::hypot(DEVIATION_LEAKAGE, DEVIATION_GAIN[usize::from(!c.third)]);
            found.deviation.L_sigma = libm::hypot(model, saturated);
        }
        #[cfg(feature = "legs")]
        if done(Stage::Legs) {
            let limited;
            (sheet.leg_delay, limited) = self.leg_delay();
            found.warnings.bridge_fit |= limited;
            curve = fit(&machine, &sheet)?;
            found.deviation_legs = Some(super::legs::deviation(&curve.inverter, &machine)?);
        }
        found.machine = machine;
        found.inverter = curve.inverter;
        found.deviation_inverter = curve.deviation;
        found.warnings.bridge_fit |= curve.residual > 0.1 * (pu.u_th + pu.dead_time * pu.u_dc);
        found.bridge = done(Stage::Bridge).then_some(curve);
        let levels = s.magnetising.level;
        if levels < 2 {
            return Ok(found);
        }
        self.magnetising(&mut found, curve.r, levels)?;
        Ok(found)
    }

    /// Differences of the legs in s, and whether one is beyond its range.
    #[cfg(feature = "legs")]
    fn leg_delay(&self) -> ([[f64; 2]; 3], bool) {
        let c = &self.config;
        let most = c.sheet.leg_delay_max();
        let found = self.state.legs.legs.of_period().map(|leg| leg.map(|x| x / c.sheet.f_s));
        let within = found.map(|leg| leg.map(|x| x.clamp(-most, most)));
        (within, within != found)
    }

    #[allow(non_snake_case)]
    fn magnetising(&self, found: &mut Found, r_fast: f64, levels: usize) -> Result<(), ParamError> {
        let (c, s) = (&self.config, &self.state);
        let (pu, plate) = (&c.pu, &c.machine);
        let loss = BridgeCurve::loss(&found.inverter, &found.machine)?;
        let record = &s.magnetising.record;
        let rise = f64::from(RISE) / f64::from(c.magnetising.settle);
        let readings: [Reading; magnetising::LEVELS] = core::array::from_fn(|k| {
            let before = if k > 0 { record[k - 1].i.to_f64() } else { 0.0 };
            Reading::new(&record[k], before, rise, &loss)
        });
        let l_sigma = found.machine.L_sigma / pu.base.l;
        let share = pu.r_s / (pu.r_s + pu.r_r);
        let guess = Guess {
            r: r_fast * share,
            r_r: r_fast * (1.0 - share),
            l_s: pu.l_s,
            l_sigma,
            loss: found.deviation_inverter[0],
            settle: f64::from(c.magnetising.settle) * pu.t_s,
            window: f64::from(c.magnetising.window) * pu.t_s,
            sigma_psi: magnetising::SIGMA_PSI,
        };
        let fit = magnetising::fit(&guess, readings.get(..levels).unwrap_or(&readings));
        let (l_s, l_u) = (fit.inductance(1.0), fit.l_u);
        // The leakage of a cage does not rise with frequency.
        let l_l = MagnetisingCurve { bar: fit.bar.max(1.0), ..fit }.leakage(l_sigma);
        let Machine { n_p, J, U_N, I_N, f_N, T_N, .. } = *plate;
        let gamma = Gamma {
            R_s: fit.r * pu.base.z - c.sheet.r_d,
            R_r: fit.r_r * pu.base.z,
            L_l: l_l * pu.base.l,
            L_s: l_s * pu.base.l,
        };
        let mut machine = Machine::from_gamma(gamma, Rating { n_p, J, U_N, I_N, f_N, T_N });
        machine.saturation = (fit.c > 0.0).then(|| Saturation {
            L_u: l_u * pu.base.l,
            a: libm::pow(fit.c, 1.0 / fit.s) / pu.base.psi,
            S: fit.s,
        });
        machine.validate()?;
        let gain = |x: f64| libm::hypot(x, DEVIATION_GAIN[usize::from(!c.third)]);
        let model = |x: f64| libm::hypot(gain(x), DEVIATION_MODEL);
        let d = &c.deviation;
        let far = |x: f64, y: f64, d: f64| libm::fabs(libm::log(x / y)) > 4.0 * d;
        found.warnings.far_from_nameplate =
            far(machine.R_R, plate.R_R, d.R_R) || far(machine.L_M, plate.L_M, d.L_M) || far(fit.r, pu.r_s, d.R_s);
        found.warnings.magnetising_fit = fit.residual > 0.05 * fit.r_r;
        found.warnings.flux_not_reached = fit.psi_max < 1.0;
        found.deviation.R_s = gain(fit.deviation[0]);
        found.deviation.R_R = model(fit.deviation[1]);
        found.deviation.L_sigma = libm::hypot(found.deviation.L_sigma, fit.deviation[6]);
        let rise = f64::from(RISE) * machine.R_R / (machine.L_M * c.sheet.f_c());
        found.deviation.L_M = libm::hypot(model(fit.deviation_rated), DEVIATION_RISE * rise * rise);
        found.machine = machine;
        found.inverter.u_th *= 1.0 + fit.d;
        found.inverter.dead_time *= 1.0 + fit.d;
        found.magnetising = Some(fit);
        Ok(())
    }
}
