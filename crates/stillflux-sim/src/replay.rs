//! The estimators of both schemes over a record of voltages and currents, without a drive.
//!
//! ```text
//! u_s(k) = u(k) - u_l(i(k - 1/2))       u: mean over the interval that ends at sample k
//! ```
//!
//! A drive evaluates the inverter model `u_l` at its current reference, which is free from noise. A record has none:
//! here it is the current in field coordinates behind a low-pass of [`SMOOTHING`], turned to the middle of the
//! interval. With [`InverterModel`] parameters of zero the voltage is that of the terminals.
//!
//! The deviation of the angle begins at that of the flux with which the record begins, π without flux: the filter has one of
//! its own after its first block, and the confidence model of the published scheme goes on from there.
//!
//! [`InverterModel`]: stillflux::inverter::InverterModel

use core::f64::consts::PI;

use stillflux::base::{Base, PerUnit};
use stillflux::config::{BALANCE_PERIODS, DriveConfig, DriveParams, Scheme};
use stillflux::estimate::balance::Balance;
use stillflux::estimate::confidence::Confidence;
use stillflux::estimate::flux::FluxEstimator;
use stillflux::estimate::kalman::{Filter, Input};
use stillflux::estimate::regeneration::Regeneration;
use stillflux::estimate::resistance::{self, ResistanceEstimator};
use stillflux::estimate::speed::{SpeedConfig, SpeedEstimate, SpeedEstimator};
use stillflux::inverter::{Distortion, Knee};
use stillflux::params::{Inverter, Machine, ParamError, check};
use stillflux::si::Vector;
use stillflux::space::{AlphaBeta, Dq, Rotator};

/// Time constant of the current at which the inverter model is evaluated, s. The low-pass is of second order, critically
/// damped, and follows a ramp without lag: near the zero of a phase current, where the loss of a leg changes by 10 to 20 V
/// per ampere, 0.2 A of lag are volts for as long as the current passes it.
const SMOOTHING: f64 = 2e-3;
/// Deviation from the smoothed current, per unit, from which on it is taken for a step of the current, several times the noise
/// of converters: the low-pass follows the faster, the larger the deviation is beside this. Otherwise the loss has the
/// direction of the current before the step, and the flux integrates that: at 3 kW a step of the speed turns it by 1° then,
/// with this by 0.4°.
const CHANGE: f64 = 0.02;
/// Time after a start without flux in which the filter corrects nothing, s: as in a drive.
const INTEGRATING_TIME: f64 = 0.01;
/// Standard deviation of the direction of a direct current that is taken to lie along the a-axis, rad.
const ALONG_A: f64 = 0.02;

/// One row of a record, SI.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// Mean voltage over the interval that ends at this sample, V.
    pub u_s: Vector,
    /// Current sample, A.
    pub i_s: Vector,
    /// Sum of the three measured phase currents, A; zero with two sensors.
    pub i_sum: f64,
    /// dc-link voltage, V.
    pub u_dc: f64,
    /// Flux reference, V·s: the published scheme holds the flux there.
    pub psi_ref: f64,
}

/// Where the estimators begin, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(non_snake_case)]
pub struct Start {
    /// Stator flux, V·s.
    pub psi_s: Vector,
    /// Standard deviation of each of its components, V·s; 0: a machine without flux.
    pub deviation: f64,
    /// The flux is that of a direct current in a machine at rest: an error of it is one of `L_M`, as in the start-up of
    /// a drive, whose current has the direction of the a-axis.
    pub settled: bool,
    /// Speed, mechanical rad/s.
    pub omega_m: f64,
    /// Stator resistance for the published scheme, if it is known better than by the parameters, Ω.
    pub R_s: Option<f64>,
}

impl Start {
    /// Standard deviation of the angle of the flux, rad: π of a machine without flux.
    fn angle_deviation(&self) -> f64 {
        let sigma = if self.settled {
            ALONG_A
        } else if self.deviation > 0.0 {
            self.deviation / libm::hypot(self.psi_s[0], self.psi_s[1])
        } else {
            PI
        };
        // A flux of zero has no angle.
        sigma.min(PI)
    }
}

/// Estimates after one row, SI.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(non_snake_case)]
pub struct Estimates {
    /// Stator flux, V·s.
    pub psi_s: Vector,
    /// Rotor flux (inverse-Γ), V·s.
    pub psi_r: Vector,
    /// Current less the estimated offset, A.
    pub i_s: Vector,
    /// Voltage less the loss of the inverter model, V.
    pub u_s: Vector,
    /// Offset voltage, V.
    pub u_off: Vector,
    /// Speed, mechanical rad/s.
    pub omega_m: f64,
    /// Stator frequency, electrical rad/s.
    pub omega_s: f64,
    /// Torque, N·m.
    pub torque: f64,
    /// Resistance in series with the stator flux, Ω.
    pub R_s: f64,
    /// Confidence in the field angle, 0 to 1.
    pub confidence: f64,
    /// Expected standard deviation of the field angle, rad.
    pub angle_deviation: f64,
    /// Normalised innovation squared, low-passed; zero in the published scheme.
    pub nis: f64,
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)]
enum Estimators {
    Enhanced {
        filter: Filter<f64>,
        balance: Balance<f64>,
    },
    Paper {
        flux: FluxEstimator<f64>,
        resistance: ResistanceEstimator<f64>,
        confidence: Confidence<f64>,
        regeneration: Regeneration<f64>,
    },
}

/// Estimators of one scheme with their state.
#[derive(Clone, Debug)]
pub struct Replay {
    config: DriveConfig<f64>,
    base: Base,
    r_s: f64,
    f_s: f64,
    estimators: Estimators,
    speed_estimator: SpeedEstimator<f64>,
    speed: SpeedEstimate<f64>,
    knee: Knee<f64>,
    /// Smoothed current, field coordinates.
    i_slow: Dq<f64>,
    /// Its change from row to row.
    i_slope: Dq<f64>,
    i_s: AlphaBeta<f64>,
    u_s: AlphaBeta<f64>,
    period: u32,
    integrating: u32,
    /// Deviation of the angle with which it began, rad.
    sigma: f64,
}

impl Replay {
    /// Estimators for a record whose rows are one control period of the inverter apart.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn new(machine: &Machine, inverter: &Inverter, params: &DriveParams) -> Result<Self, ParamError> {
        let config = DriveConfig::new(machine, inverter, params)?;
        // What is not evaluated here has no silent meaning.
        for (field, on) in [
            ("resistance_at_light_load", params.paper.resistance_at_light_load),
            ("resistance_at_rest", params.paper.resistance_at_rest),
        ] {
            check(field, f64::from(u8::from(on)), 0.0, 0.0, "")
                .map_err(|e| e.with_note("records are evaluated without this adaptation"))?;
        }
        let pu = PerUnit::new(machine, inverter)?;
        let estimators = match params.scheme {
            Scheme::Enhanced => {
                Estimators::Enhanced { filter: Filter::new(config.filter_config()), balance: Balance::default() }
            }
            Scheme::Paper => Estimators::Paper {
                flux: FluxEstimator::default(),
                resistance: {
                    let mut resistance = ResistanceEstimator::default();
                    resistance.start(pu.r_s);
                    resistance
                },
                confidence: Confidence::default(),
                regeneration: Regeneration::default(),
            },
        };
        Ok(Self {
            base: pu.base,
            r_s: pu.r_s,
            f_s: inverter.f_c(),
            estimators,
            speed_estimator: SpeedEstimator::default(),
            speed: SpeedEstimate::default(),
            knee: *config.inverter_model().nominal(),
            i_slow: Dq::default(),
            i_slope: Dq::default(),
            i_s: AlphaBeta::default(),
            u_s: AlphaBeta::default(),
            period: 0,
            integrating: 0,
            sigma: PI,
            config,
        })
    }

    /// Begins, or begins anew after a gap, at the sample `row`; identified parameters stay.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn start(&mut self, at: &Start, row: &Row) {
        let b = self.base;
        let (psi_s, i_s) = (vector(at.psi_s, b.psi), vector(row.i_s, b.i));
        self.integrating = if at.deviation > 0.0 { 0 } else { (INTEGRATING_TIME * self.f_s) as u32 };
        self.sigma = at.angle_deviation();
        match &mut self.estimators {
            Estimators::Enhanced { filter, .. } => {
                let c = self.config.filter_config();
                if at.settled {
                    filter.start(c, &i_s);
                    filter.settle(c, psi_s.re());
                } else if at.deviation > 0.0 {
                    filter.join(c, &i_s, psi_s, at.deviation / b.psi);
                } else {
                    filter.start(c, &i_s);
                }
                self.knee = self.config.inverter_model().knee(filter.knee());
            }
            Estimators::Paper { flux, resistance, confidence, regeneration } => {
                *regeneration = Regeneration::default();
                flux.start(psi_s, i_s);
                if let Some(r_s) = at.R_s {
                    let (lo, hi) = resistance::range(self.r_s);
                    resistance.start((r_s / b.z).clamp(lo, hi));
                }
                confidence.join(self.sigma);
            }
        }
        self.i_s = i_s;
        let psi_r = self.rotor_flux();
        self.speed_estimator.start(&psi_r, at.omega_m / b.omega_m);
        self.speed = self.speed_estimator.step(&self.speed_config(), &psi_r, &i_s);
        (self.i_slow, self.i_slope) = (Rotator::of(&psi_s).0.to_field(&i_s), Dq::default());
        self.period = 0;
    }

    /// Rotor flux, with the leakage inductance that the scheme knows.
    fn rotor_flux(&self) -> AlphaBeta<f64> {
        match &self.estimators {
            Estimators::Enhanced { filter, .. } => filter.rotor_flux(self.config.filter_config()),
            Estimators::Paper { flux, .. } => self.config.speed_config().rotor_flux(&flux.value(), &self.i_s),
        }
    }

    /// Settings of the speed estimator, with the rotor resistance that the scheme knows.
    fn speed_config(&self) -> SpeedConfig<f64> {
        let c = self.config.speed_config();
        match &self.estimators {
            Estimators::Enhanced { filter, .. } => {
                SpeedConfig { r_r: c.r_r * filter.rotor_resistance(self.config.filter_config()), ..*c }
            }
            Estimators::Paper { .. } => *c,
        }
    }

    /// Loss of the inverter model in the interval that ends now.
    fn loss(&self, u_dc: f64) -> Distortion<f64> {
        let (field, gain) = match &self.estimators {
            Estimators::Enhanced { filter, .. } => (filter.field(), 1.0 + filter.v()),
            Estimators::Paper { flux, .. } => (flux.field(), 1.0),
        };
        let half = 0.5 * self.config.speed_config().t_s / f64::from(self.config.speed_periods());
        let i_s = field.ahead(self.speed.omega_s * half).to_stator(&self.i_slow);
        self.config.inverter_model().distortion(&self.knee, &i_s, u_dc, gain)
    }

    /// One row.
    pub fn step(&mut self, row: &Row) {
        let b = self.base;
        self.period = self.period.wrapping_add(1);
        let speed_due = self.period.is_multiple_of(self.config.speed_periods());
        let slow_due = self.period.is_multiple_of(self.config.adapt_periods());
        let loss = self.loss(row.u_dc / b.u);
        let (u_s, i_m) = (vector(row.u_s, b.u) - loss.vector(), vector(row.i_s, b.i));
        self.u_s = u_s;
        let (c, omega_s) = (&self.config, self.speed.omega_s);
        let i_dq = match &mut self.estimators {
            Estimators::Enhanced { filter, balance } => {
                if self.period % BALANCE_PERIODS == 2 {
                    balance.fit(c.balance_config(), &i_m, row.i_sum / b.i);
                }
                let i_m = balance.remove(&i_m);
                let input = Input { u_s, loss: &loss, i_m, i_ref: &self.i_slow, omega_s };
                let (_, _, i_dq) = filter.step(c.filter_config(), &input, self.integrating > 0);
                self.integrating = self.integrating.saturating_sub(1);
                if slow_due {
                    filter.confine(c.filter_config());
                    self.knee = c.inverter_model().knee(filter.knee());
                }
                self.i_s = filter.i_s();
                i_dq
            }
            Estimators::Paper { flux, resistance, confidence, regeneration } => {
                flux.step(c.flux_config(), (&u_s, &i_m), resistance.r_s(), row.psi_ref / b.psi, self.period);
                // û_off is that of an offset of the current sensors, as in the drive.
                self.i_s = i_m + flux.offset.u_off() * (1.0 / self.r_s);
                let i_dq = flux.field().to_field(&self.i_s);
                if slow_due {
                    let (corner, least) = c.regeneration_config();
                    flux.set_regenerating(regeneration.step(corner, least, &self.speed));
                    if let Some(r) = c.resistance_config() {
                        resistance.step(r, flux.magnitude(), &i_dq, omega_s, self.speed.omega_m);
                    }
                    let corrected = (flux.offset.updates() > 0).then(|| flux.offset.last_correction());
                    confidence.step(c.confidence_config(), omega_s, flux.effort(), corrected);
                }
                i_dq
            }
        };
        let deviation = i_dq - (self.i_slow + self.i_slope);
        let (corner, weight) = (1.0 / (SMOOTHING * self.f_s), 1.0 + deviation.norm_sq() / (CHANGE * CHANGE));
        self.i_slow += self.i_slope + deviation * (2.0 * corner * weight).min(1.0);
        self.i_slope += deviation * (corner * corner).min(0.25);
        if speed_due {
            let psi_r = self.rotor_flux();
            self.speed = self.speed_estimator.step(&self.speed_config(), &psi_r, &self.i_s);
            if let Estimators::Paper { flux, .. } = &mut self.estimators {
                flux.set_stator_frequency(self.config.flux_config(), self.speed.omega_s);
            }
        }
    }

    /// Estimates after the latest row.
    #[must_use]
    pub fn estimates(&self) -> Estimates {
        let b = &self.base;
        let (psi_s, u_off, r_s, confidence, sigma, nis) = match &self.estimators {
            Estimators::Enhanced { filter: f, .. } => {
                // Zero until the first block of the filter has weighed its covariance: as it began until then.
                let (confidence, sigma) = if f.sigma() > 0.0 {
                    (f.confidence(), f.sigma())
                } else {
                    let mut begin = Confidence::default();
                    begin.join(self.sigma);
                    (begin.value(), begin.sigma())
                };
                (f.value(), f.b() * -f.r_s(), f.r_s(), confidence, sigma, f.nis())
            }
            Estimators::Paper { flux, resistance, confidence, .. } => {
                let c = confidence;
                (flux.value(), flux.offset.u_off(), resistance.r_s(), c.value(), c.sigma(), 0.0)
            }
        };
        let psi_r = self.rotor_flux();
        let si = |v: AlphaBeta<f64>, base: f64| [v.re() * base, v.im() * base];
        Estimates {
            psi_s: si(psi_s, b.psi),
            psi_r: si(psi_r, b.psi),
            i_s: si(self.i_s, b.i),
            u_s: si(self.u_s, b.u),
            u_off: si(u_off, b.u),
            omega_m: self.speed.omega_m * b.omega_m,
            omega_s: self.speed.omega_s * b.omega,
            torque: psi_s.cross(&self.i_s) * b.torque,
            R_s: r_s * b.z,
            confidence,
            angle_deviation: sigma,
            nis,
        }
    }
}

fn vector(v: Vector, base: f64) -> AlphaBeta<f64> {
    AlphaBeta::new(v[0] / base, v[1] / base)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steady rotation at rated flux and torque, exact in every row; voltages at the bridge or at the terminals.
    fn run(scheme: Scheme, terminal: bool, start: Option<f64>) -> (Replay, Vector) {
        let machine = Machine { saturation: None, ..Machine::preset_11k() };
        let mut inverter = Inverter { c_out: 0.0, ..Inverter::preset_11k() };
        if terminal {
            inverter = Inverter { u_th: 0.0, r_d: 0.0, dead_time: 0.0, ..inverter };
        }
        let params = DriveParams { scheme, calibrate_offset: false, ..DriveParams::new(&machine, &inverter) };
        let mut replay = Replay::new(&machine, &inverter, &params).unwrap();
        let (b, f_s) = (Base::new(&machine), inverter.f_s);
        let (psi_r, torque) = (0.95 * b.psi, 0.8 * machine.T_N);
        let i_dq = [psi_r / machine.L_M, torque / (1.5 * f64::from(machine.n_p) * psi_r)];
        let omega = 2.0 * core::f64::consts::PI * 4.0;
        let turn = |v: Vector, t: f64| {
            let (s, c) = (omega * t).sin_cos();
            [c * v[0] - s * v[1], s * v[0] + c * v[1]]
        };
        let psi_dq = [psi_r + machine.L_sigma * i_dq[0], machine.L_sigma * i_dq[1]];
        // The published scheme holds the flux at its reference.
        let psi_ref = (psi_dq[0] * psi_dq[0] + psi_dq[1] * psi_dq[1]).sqrt();
        let steps = (8.0 * f_s) as u32;
        let mut last = [0.0; 2];
        for k in 0..=steps {
            let (t, before) = (f64::from(k) / f_s, (f64::from(k) - 1.0) / f_s);
            let (i, i_before) = (turn(i_dq, t), turn(i_dq, before));
            let (psi, psi_before) = (turn(psi_dq, t), turn(psi_dq, before));
            let mean = AlphaBeta::new(0.5 * (i[0] + i_before[0]) / b.i, 0.5 * (i[1] + i_before[1]) / b.i);
            let model = replay.config.inverter_model();
            let loss: Vector = model.distortion(model.nominal(), &mean, inverter.u_dc / b.u, 1.0).vector().into();
            let r = machine.R_s + inverter.r_d;
            let u = [0, 1].map(|k| (psi[k] - psi_before[k]) * f_s + r * 0.5 * (i[k] + i_before[k]) + loss[k] * b.u);
            let row = Row { u_s: u, i_s: i, i_sum: 0.0, u_dc: inverter.u_dc, psi_ref };
            if k == 0 {
                let error = start.unwrap_or(0.0);
                let psi_s = [psi[0] + error * b.psi, psi[1] - error * b.psi];
                let deviation = (error.abs() * b.psi).max(0.02 * b.psi);
                let omega_m = 0.0;
                replay.start(&Start { psi_s, deviation, settled: false, omega_m, R_s: None }, &row);
            } else {
                replay.step(&row);
            }
            last = psi;
        }
        (replay, last)
    }

    fn angle(replay: &Replay, psi: &Vector) -> f64 {
        let e = replay.estimates().psi_s;
        (psi[0] * e[1] - psi[1] * e[0]).atan2(psi[0] * e[0] + psi[1] * e[1]).to_degrees()
    }

    #[test]
    fn both_schemes_follow_a_record_of_either_voltage() {
        for scheme in [Scheme::Enhanced, Scheme::Paper] {
            for terminal in [false, true] {
                let (replay, psi) = run(scheme, terminal, None);
                let e = replay.estimates();
                assert!(angle(&replay, &psi).abs() < 0.5, "{scheme:?}, {terminal}: {}°", angle(&replay, &psi));
                assert!((e.torque / (0.8 * Machine::preset_11k().T_N) - 1.0).abs() < 0.02, "{e:?}");
                assert!((e.omega_s - 8.0 * core::f64::consts::PI).abs() < 0.1, "{e:?}");
            }
        }
    }

    #[test]
    fn the_deviation_of_the_angle_begins_with_that_of_the_flux() {
        let machine = Machine::preset_11k();
        let inverter = Inverter::preset_11k();
        let psi = Base::new(&machine).psi;
        for scheme in [Scheme::Enhanced, Scheme::Paper] {
            let params = DriveParams { scheme, ..DriveParams::new(&machine, &inverter) };
            let start =
                Start { psi_s: [0.6 * psi, 0.8 * psi], deviation: 0.0, settled: false, omega_m: 0.0, R_s: None };
            for (start, sigma) in [
                (start, PI),
                (Start { deviation: 0.1 * psi, ..start }, 0.1),
                (Start { deviation: 0.1 * psi, psi_s: [0.0; 2], ..start }, PI),
                (Start { deviation: 0.1 * psi, settled: true, ..start }, ALONG_A),
            ] {
                let mut replay = Replay::new(&machine, &inverter, &params).unwrap();
                replay.start(&start, &Row { psi_ref: psi, u_dc: 540.0, ..Row::default() });
                let e = replay.estimates();
                assert!((e.angle_deviation - sigma).abs() < 1e-9, "{scheme:?}: {} for {sigma}", e.angle_deviation);
                let confidence = 1.0 / (1.0 + (sigma / stillflux::estimate::confidence::SIGMA_HALF).powi(2));
                assert!((e.confidence - confidence).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn an_error_of_the_flux_at_the_beginning_is_corrected_as_far_as_the_filter_expects() {
        // 0.2 pu in each component are 16°; what is left is a tenth of that at most, and expected by the filter.
        let (replay, psi) = run(Scheme::Enhanced, true, Some(0.2));
        let (error, sigma) = (angle(&replay, &psi).abs(), replay.estimates().angle_deviation.to_degrees());
        assert!(error < 1.6 && error < 2.0 * sigma && sigma < 2.0, "{error}°, {sigma}° expected");
        assert!(replay.estimates().confidence > 0.9);
    }
}
