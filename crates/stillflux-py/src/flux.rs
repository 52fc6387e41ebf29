//! `FluxEstimator`: Fig. 7 over recorded signals.

use numpy::{Complex64, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stillflux::base::{Base, PerUnit};
use stillflux::config::DriveConfig;
use stillflux::estimate::flux::FluxEstimator as CoreFlux;
use stillflux::estimate::speed::{SpeedEstimate, SpeedEstimator};
use stillflux::space::AlphaBeta;

use crate::convert::{extract_some, finite_parts, interrupt, record, scaled, value_error};
use crate::parameters::{drive_params, inverter_of, machine_of};

/// Per-unit values for `n` samples, of one number for all or one for each, not below a least one.
fn values(name: &str, series: &Bound<'_, PyAny>, n: usize, (least, base): (f64, f64)) -> PyResult<Vec<f64>> {
    let values = match series.extract::<f64>() {
        Ok(x) => vec![x; n],
        Err(_) => record::<f64>(name, series)?.as_array().to_vec(),
    };
    same_length(name, values.len(), n)?;
    match values.iter().position(|x| !(x.is_finite() && *x >= least)) {
        Some(k) if values[k].is_finite() => Err(PyValueError::new_err(format!(
            "{name}[{k}] = {} is outside the admissible range from {least} on",
            values[k]
        ))),
        Some(k) => Err(PyValueError::new_err(format!("{name}[{k}] = {} is not finite", values[k]))),
        None => Ok(values.into_iter().map(|x| x / base).collect()),
    }
}

fn same_length(name: &str, len: usize, n: usize) -> PyResult<()> {
    if len == n { Ok(()) } else { Err(PyValueError::new_err(format!("{name} has {len} samples, u_s has {n}"))) }
}

fn vectors(name: &str, a: &Bound<'_, PyAny>, base: f64) -> PyResult<Vec<AlphaBeta<f64>>> {
    let scale = |(k, z): (usize, &Complex64)| {
        if z.is_finite() {
            Ok(AlphaBeta::new(z.re / base, z.im / base))
        } else {
            Err(PyValueError::new_err(format!("{name}[{k}] = {z} is not finite")))
        }
    };
    record::<Complex64>(name, a)?.as_array().iter().enumerate().map(scale).collect()
}

/// What a `FluxEstimator` made of a record: arrays of the record's length.
#[pyclass(frozen, get_all, module = "stillflux")]
pub struct Trace {
    /// Time, s.
    t: Py<PyArray1<f64>>,
    /// Stator flux linkage, V·s, complex.
    psi_s: Py<PyArray1<Complex64>>,
    /// Flux of the parallel path, V·s, complex.
    psi_1: Py<PyArray1<Complex64>>,
    /// Offset voltage, V, complex.
    u_off: Py<PyArray1<Complex64>>,
    /// Output of the noise compensator, V, complex.
    u_hf: Py<PyArray1<Complex64>>,
    /// Stator frequency, electrical rad/s.
    omega_s: Py<PyArray1<f64>>,
    /// Speed, mechanical rad/s.
    omega_m: Py<PyArray1<f64>>,
    /// Angle of psi_s, rad.
    angle: Py<PyArray1<f64>>,
}

/// Columns of a trace before they become arrays.
#[derive(Default)]
struct Columns {
    psi_s: Vec<Complex64>,
    psi_1: Vec<Complex64>,
    u_off: Vec<Complex64>,
    u_hf: Vec<Complex64>,
    omega_s: Vec<f64>,
    omega_m: Vec<f64>,
}

/// The stator flux estimator of Fig. 7 alone, with offset estimator and noise compensator, offline.
///
/// Takes motor and inverter as `Drive` does, and its settings (those about the flux estimator matter), with one
/// difference: `inverter_model` is off unless it is given. Without it `u_s` is the voltage at the machine's terminals
/// and the resistance the motor's. With `inverter_model=True` `u_s` is what an ideal bridge would have applied
/// (duties times dc link): threshold, dead time and `r_d` of the inverter are taken into account.
#[pyclass(frozen, module = "stillflux")]
pub struct FluxEstimator {
    config: DriveConfig<f64>,
    base: Base,
    psi_ref: f64,
    r_s: f64,
    u_dc: f64,
    f_s: f64,
}

#[pymethods]
impl Trace {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Trace of {} samples>", self.t.bind(py).len()?))
    }
}

#[pymethods]
impl FluxEstimator {
    #[new]
    #[pyo3(signature = (motor, inverter, **settings))]
    fn new(
        motor: &Bound<'_, PyAny>,
        inverter: &Bound<'_, PyAny>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (machine, inverter) = (machine_of("motor", motor)?, inverter_of("inverter", inverter)?);
        let mut params = drive_params(&machine, &inverter, "paper", settings)?;
        let modelled = settings.map_or(Ok(None), |s| s.get_item("inverter_model"))?.is_some() && params.inverter_model;
        params.inverter_model = modelled;
        let pu = PerUnit::new(&machine, &inverter).map_err(value_error)?;
        Ok(Self {
            config: DriveConfig::new(&machine, &inverter, &params).map_err(value_error)?,
            psi_ref: params.psi_ref,
            r_s: if modelled { pu.r_s } else { machine.R_s / pu.base.z },
            u_dc: pu.u_dc,
            f_s: inverter.f_c(),
            base: pu.base,
        })
    }

    /// Estimates the flux over a record with one row for each control period of the inverter.
    ///
    /// Parameters
    /// ----------
    /// u_s
    ///     Voltage in V, complex, shape (n,): `u_s[k]` was applied between samples k - 1 and k. At the terminals, or
    ///     with `inverter_model=True` that of an ideal bridge.
    /// i_s
    ///     Stator current in A, complex, shape (n,).
    /// omega_s
    ///     Known stator frequency, electrical rad/s, a number or shape (n,); None: the estimated one.
    /// R_s
    ///     Resistance in series with the stator flux in Ω, a number or shape (n,); None: the motor's, with
    ///     `inverter_model=True` plus the inverter's r_d.
    /// psi_s0
    ///     Flux at the first sample, V·s, complex; None: rated flux on the a-axis.
    /// u_dc
    ///     dc-link voltage in V for the inverter model, a number or shape (n,); None: the inverter's rated one.
    ///
    /// Raises ValueError for lengths that differ and for samples that are not finite, KeyboardInterrupt within some
    /// tenths of a second of Ctrl-C.
    #[pyo3(signature = (u_s, i_s, omega_s=None, R_s=None, psi_s0=None, u_dc=None))]
    #[allow(clippy::too_many_arguments)]
    fn run(
        &self,
        py: Python<'_>,
        u_s: &Bound<'_, PyAny>,
        i_s: &Bound<'_, PyAny>,
        omega_s: Option<&Bound<'_, PyAny>>,
        R_s: Option<&Bound<'_, PyAny>>,
        psi_s0: Option<&Bound<'_, PyAny>>,
        u_dc: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Trace> {
        let b = &self.base;
        let mut u = vectors("u_s", u_s, b.u)?;
        let i = vectors("i_s", i_s, b.i)?;
        let n = u.len();
        same_length("i_s", i.len(), n)?;
        let omega = omega_s.map(|s| values("omega_s", s, n, (f64::NEG_INFINITY, b.omega))).transpose()?;
        let r_s = R_s.map_or_else(|| Ok(vec![self.r_s; n]), |s| values("R_s", s, n, (0.0, b.z)))?;
        let u_dc = u_dc.map_or_else(|| Ok(vec![self.u_dc; n]), |s| values("u_dc", s, n, (0.0, b.u)))?;
        let model = self.config.inverter_model();
        for k in 1..n {
            let i_mean = (i[k - 1] + i[k]) * 0.5;
            u[k] = u[k] - model.distortion(model.nominal(), &i_mean, u_dc[k], 1.0).vector();
        }
        let start = match extract_some("psi_s0", psi_s0)? {
            None => AlphaBeta::new(self.psi_ref, 0.0),
            Some(z) => {
                let [re, im] = finite_parts("psi_s0", z)?;
                AlphaBeta::new(re / b.psi, im / b.psi)
            }
        };

        let c = py.detach(|| self.estimate(&u, &i, omega.as_deref(), &r_s, start))?;
        let t = (0..n).map(|k| k as f64 / self.f_s).collect();
        let angle = c.psi_s.iter().map(|z| z.arg()).collect();
        let real = |v: Vec<f64>| PyArray1::from_vec(py, v).unbind();
        let complex = |v: Vec<Complex64>| PyArray1::from_vec(py, v).unbind();
        Ok(Trace {
            t: real(t),
            psi_s: complex(c.psi_s),
            psi_1: complex(c.psi_1),
            u_off: complex(c.u_off),
            u_hf: complex(c.u_hf),
            omega_s: real(c.omega_s),
            omega_m: real(c.omega_m),
            angle: real(angle),
        })
    }
}

impl FluxEstimator {
    fn estimate(
        &self,
        u: &[AlphaBeta<f64>],
        i: &[AlphaBeta<f64>],
        omega: Option<&[f64]>,
        r_s: &[f64],
        start: AlphaBeta<f64>,
    ) -> PyResult<Columns> {
        let b = &self.base;
        let mut c = Columns::default();
        let (mut flux, mut speed) = (CoreFlux::default(), SpeedEstimator::default());
        let mut estimate = SpeedEstimate::default();
        for k in 0..u.len() {
            interrupt(k)?;
            if k == 0 {
                flux.start(start, i[0]);
                speed.start(&self.config.speed_config().rotor_flux(&start, &i[0]), 0.0);
            } else {
                #[allow(clippy::cast_possible_truncation)]
                flux.step(self.config.flux_config(), (&u[k], &i[k]), r_s[k], self.psi_ref, k as u32);
            }
            let psi_s = flux.value();
            // As often as in the drive.
            if k % self.config.speed_periods() as usize == 0 {
                let c = self.config.speed_config();
                estimate = speed.step(c, &c.rotor_flux(&psi_s, &i[k]), &i[k]);
                flux.set_stator_frequency(self.config.flux_config(), omega.map_or(estimate.omega_s, |w| w[k]));
            }
            let u_hf = flux.estimate().u_hf;
            c.psi_s.push(scaled(&psi_s, b.psi));
            c.psi_1.push(scaled(&flux.offset.psi_1(), b.psi));
            c.u_off.push(scaled(&flux.offset.u_off(), b.u));
            c.u_hf.push(scaled(&u_hf, b.u));
            c.omega_s.push(estimate.omega_s * b.omega);
            c.omega_m.push(estimate.omega_m * b.omega_m);
        }
        Ok(c)
    }
}
