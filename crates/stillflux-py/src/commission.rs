//! Nameplates and self-commissioning.

use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stillflux::commission::si::{Shaft, SiCommissioning};
use stillflux::commission::{Deviation, Nameplate as Plate, Stage, Status, Warnings, priors as priors_of};
use stillflux::params::check;
use stillflux::si::{Arithmetic, MeasurementSi};
use stillflux_sim::commission::{self as sim, Wiring};

use crate::convert::{counted, extract, extract_some, finite, parts, three, value_error};
use crate::parameters::{Inverter, Motor, arithmetic, found, inverter_dict, machine_dict, names_of};
use crate::plant::plant_params;

/// What is read from a Python `Nameplate`.
#[derive(FromPyObject)]
pub struct Nameplate {
    P_N: f64,
    U_N: f64,
    I_N: f64,
    f_N: f64,
    n_N: f64,
    cos_phi: f64,
    T_max: Option<f64>,
    J: Option<f64>,
}

impl Nameplate {
    /// As the core has it.
    pub fn plate(&self) -> Plate {
        let Self { P_N, U_N, I_N, f_N, n_N, cos_phi, T_max, J } = *self;
        Plate { P_N, U_N, I_N, f_N, n_N, cos_phi, T_max, J }
    }
}

/// Relative deviations as dict.
pub fn deviation_dict<'py>(py: Python<'py>, d: &Deviation) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, value) in [("R_s", d.R_s), ("R_R", d.R_R), ("L_sigma", d.L_sigma), ("L_M", d.L_M), ("J", d.J)] {
        dict.set_item(name, value)?;
    }
    Ok(dict)
}

/// Deviations of a machine and its inverter, as Python has them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Deviations {
    R_s: f64,
    R_R: f64,
    L_sigma: f64,
    L_M: f64,
    J: f64,
    loss: f64,
    c_out: f64,
}

/// Settings with which a drive begins for these relative standard deviations.
#[pyfunction]
pub fn priors(py: Python<'_>, deviation: Deviations) -> PyResult<Fields<'_>> {
    let Deviations { R_s, R_R, L_sigma, L_M, J, loss, c_out } = deviation;
    let p = priors_of(&Deviation { R_s, R_R, L_sigma, L_M, J }, [loss, c_out]);
    let dict = PyDict::new(py);
    for (name, value) in [
        ("prior_R_s", p.r_s),
        ("prior_loss", p.loss),
        ("prior_c_out", p.knee),
        ("prior_L_sigma", p.leakage),
        ("prior_R_R", p.r_r),
        ("prior_L_M", p.l_m),
    ] {
        dict.set_item(name, value)?;
    }
    Ok(dict)
}

type Fields<'py> = Bound<'py, PyDict>;

/// Fields of the motor that a nameplate describes, and the relative standard deviation of each parameter.
///
/// Raises ValueError for the first value that no induction machine can have.
#[pyfunction]
pub fn nameplate_motor<'py>(py: Python<'py>, plate: Nameplate) -> PyResult<(Fields<'py>, Fields<'py>)> {
    let (machine, deviation) = plate.plate().machine().map_err(value_error)?;
    Ok((machine_dict(py, &machine)?, deviation_dict(py, &deviation)?))
}

/// Fields of the nameplate of a motor: its rated point at rated torque, without iron and friction loss.
#[pyfunction]
pub fn nameplate_of(py: Python<'_>, motor: Motor) -> PyResult<Fields<'_>> {
    let plate = Plate::of(&motor.machine()?).map_err(value_error)?;
    let dict = PyDict::new(py);
    for (name, value) in [
        ("P_N", plate.P_N),
        ("U_N", plate.U_N),
        ("I_N", plate.I_N),
        ("f_N", plate.f_N),
        ("n_N", plate.n_N),
        ("cos_phi", plate.cos_phi),
    ] {
        dict.set_item(name, value)?;
    }
    Ok(dict)
}

fn shaft(name: &Bound<'_, PyAny>) -> PyResult<Shaft> {
    quoted("shaft", &extract::<String>("shaft", name)?, &[("locked", Shaft::Locked), ("free", Shaft::Free)])
}

/// The choice of that name, which stands between double quotation marks in the error.
fn quoted<T: Copy>(field: &str, name: &str, choices: &[(&str, T)]) -> PyResult<T> {
    found(name, choices)
        .ok_or_else(|| PyValueError::new_err(format!("{field} = {name:?} is not one of {}", names_of(choices))))
}

fn arithmetic_of(name: &Bound<'_, PyAny>) -> PyResult<Arithmetic> {
    arithmetic(&extract::<String>("arithmetic", name)?)
}

/// Stage that is run alone; that of the free shaft is `Complete`.
fn only(name: Option<&Bound<'_, PyAny>>, shaft: Shaft) -> PyResult<Option<Stage>> {
    let Some(name) = extract_some::<String>("only", name)? else { return Ok(None) };
    let stages = [
        ("wiring", Stage::Wiring),
        ("legs", Stage::Legs),
        ("bridge", Stage::Bridge),
        ("leakage", Stage::Leakage),
        ("magnetising", Stage::Magnetising),
        ("inertia", Stage::Complete),
    ];
    let stage = quoted("only", &name, &stages)?;
    if stage == Stage::Complete && shaft != Shaft::Free {
        return Err(PyValueError::new_err("only = \"inertia\" needs shaft = \"free\": the shaft turns"));
    }
    Ok(Some(stage))
}

/// What the flags say, in words.
fn warnings(w: &Warnings) -> Vec<&'static str> {
    [
        (w.incomplete, "not all procedures were completed: other values are the nameplate's"),
        (
            w.bridge_fit,
            "the curve of the bridge fits poorly: its legs differ by more than is compensated, or its capacitance is not \
             constant",
        ),
        (w.magnetising_fit, "the magnetising curve fits poorly"),
        (w.flux_not_reached, "rated flux was not reached: L_M is extrapolated"),
        (w.far_from_nameplate, "a value is far from the nameplate's: check plate and connection (star or delta)"),
        (w.no_inertia, "the run with a free shaft gave no inertia: J is the nameplate's"),
    ]
    .into_iter()
    .filter_map(|(on, text)| on.then_some(text))
    .collect()
}

/// What was found, as dict of fields.
fn found_dict<'py>(py: Python<'py>, c: &SiCommissioning) -> PyResult<Bound<'py, PyDict>> {
    let found = c.result().map_err(value_error)?;
    let dict = PyDict::new(py);
    dict.set_item("motor", machine_dict(py, &found.machine)?)?;
    dict.set_item("inverter", inverter_dict(py, &found.inverter)?)?;
    let deviation = deviation_dict(py, &found.deviation)?;
    deviation.set_item("loss", found.deviation_inverter[0])?;
    deviation.set_item("c_out", found.deviation_inverter[1])?;
    if let Some(delay) = found.deviation_legs {
        deviation.set_item("leg_delay", delay)?;
    }
    dict.set_item("deviation", deviation)?;
    dict.set_item("warnings", warnings(&found.warnings))?;
    dict.set_item("friction", found.friction)?;
    let levels: Vec<_> = c.bridge_readings().into_iter().flatten().map(|[u, i, fit]| (i, u, fit)).collect();
    dict.set_item("bridge_levels", levels)?;
    dict.set_item("psi_max", found.magnetising.map(|m| m.psi_max))?;
    Ok(dict)
}

fn status_text(c: &SiCommissioning, f_s: f64) -> String {
    match c.status() {
        Status::Running => "running".to_owned(),
        Status::Done => "done".to_owned(),
        Status::Faulted { cause, period } => format!("fault: {cause} at {:.4} s", f64::from(period) / f_s),
    }
}

fn cause_text(c: &SiCommissioning) -> Option<String> {
    c.cause().map(|cause| cause.to_string())
}

/// A commissioning, one control period at a time.
#[pyclass(module = "stillflux._core")]
pub struct CommissioningCore {
    inner: SiCommissioning,
    f_s: f64,
    gates_on: bool,
}

#[pymethods]
impl CommissioningCore {
    #[new]
    #[pyo3(signature = (plate, inverter, shaft, arithmetic, only, current_sensors))]
    fn new(
        plate: Nameplate,
        inverter: Inverter,
        shaft: &Bound<'_, PyAny>,
        arithmetic: &Bound<'_, PyAny>,
        only: Option<&Bound<'_, PyAny>>,
        current_sensors: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let inverter = inverter.params()?;
        let (shaft, arithmetic) = (self::shaft(shaft)?, arithmetic_of(arithmetic)?);
        let only = self::only(only, shaft)?;
        let inner = SiCommissioning::new(&plate.plate(), &inverter, shaft, arithmetic).map_err(value_error)?;
        let inner = counted("current_sensors", current_sensors, |sensors| inner.current_sensors(sensors))?;
        let inner = match only {
            Some(stage) => inner.only(stage),
            None => inner,
        };
        Ok(Self { inner, f_s: inverter.f_c(), gates_on: false })
    }

    /// One control period.
    fn step<'py>(
        &mut self,
        i_abc: &Bound<'py, PyAny>,
        u_dc: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let sample = MeasurementSi { i_abc: three("i_abc", i_abc)?, u_dc: extract("u_dc", u_dc)? };
        let (duty, gates_on) = self.inner.step(&sample);
        self.gates_on = gates_on;
        Ok(PyArray1::from_slice(i_abc.py(), &duty))
    }

    /// False: block the bridge.
    #[getter]
    fn gates_on(&self) -> bool {
        self.gates_on
    }

    /// Part that is over, 0 to 1.
    #[getter]
    fn progress(&self) -> f64 {
        self.inner.progress()
    }

    /// Name of the procedure under way.
    #[getter]
    fn stage(&self) -> &'static str {
        self.inner.stage()
    }

    /// "running", "done", or the fault with its cause and time.
    #[getter]
    fn status(&self) -> String {
        status_text(&self.inner, self.f_s)
    }

    /// Cause of a fault, else None.
    #[getter]
    fn cause(&self) -> Option<String> {
        cause_text(&self.inner)
    }

    /// Blocks the gates for good.
    fn abort(&mut self) {
        self.inner.abort();
        self.gates_on = false;
    }

    /// What has been found so far.
    fn found<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        found_dict(py, &self.inner)
    }
}

/// A commissioning on a plant, advanced in pieces with the GIL released.
#[pyclass(module = "stillflux._core")]
pub struct CommissioningRun {
    run: sim::CommissioningRun,
    f_s: f64,
}

#[pymethods]
impl CommissioningRun {
    #[new]
    #[allow(clippy::too_many_arguments)]
    #[pyo3(signature = (plate, inverter, shaft, arithmetic, only, current_sensors, plant_motor, plant_inverter, channels, channel_factor, options))]
    fn new(
        plate: Nameplate,
        inverter: Inverter,
        shaft: &Bound<'_, PyAny>,
        arithmetic: &Bound<'_, PyAny>,
        only: Option<&Bound<'_, PyAny>>,
        current_sensors: &Bound<'_, PyAny>,
        plant_motor: Motor,
        plant_inverter: Inverter,
        channels: Option<&Bound<'_, PyAny>>,
        channel_factor: Option<&Bound<'_, PyAny>>,
        options: &Bound<'_, PyDict>,
    ) -> PyResult<Self> {
        let inverter = inverter.params()?;
        let plant = plant_params(plant_motor.machine()?, plant_inverter.params()?, Some(options))?;
        let of_legs = |value| parts::<[usize; 3]>("channels", value, "the legs of three channels, each 0, 1 or 2");
        let channels = channels.map_or(Ok(None), of_legs)?;
        for leg in channels.iter().flatten() {
            check("channels", *leg as f64, 0.0, 2.0, "").map_err(value_error)?;
        }
        let gain = channel_factor.map(|value| three("channel_factor", value)).transpose()?;
        for factor in gain.iter().flatten() {
            finite("channel_factor", *factor)?;
        }
        let (shaft, arithmetic) = (self::shaft(shaft)?, arithmetic_of(arithmetic)?);
        let only = self::only(only, shaft)?;
        let wiring = Wiring { channels, gain };
        let run = sim::CommissioningRun::new(&plate.plate(), &inverter, shaft, arithmetic, plant, wiring)
            .map_err(value_error)?;
        let run = counted("current_sensors", current_sensors, |sensors| run.current_sensors(sensors))?;
        let run = match only {
            Some(stage) => run.only(stage),
            None => run,
        };
        Ok(Self { run, f_s: inverter.f_c() })
    }

    /// Runs at most `periods` further control periods; False when the commissioning is over.
    fn advance(&mut self, py: Python<'_>, periods: u32) -> bool {
        py.detach(|| self.run.advance(periods))
    }

    /// Simulated time so far, s.
    #[getter]
    fn time(&self) -> f64 {
        self.run.time()
    }

    /// Part that is over, 0 to 1.
    #[getter]
    fn progress(&self) -> f64 {
        self.run.commissioning().progress()
    }

    /// Name of the procedure under way.
    #[getter]
    fn stage(&self) -> &'static str {
        self.run.commissioning().stage()
    }

    /// "running", "done", or the fault with its cause and time.
    #[getter]
    fn status(&self) -> String {
        status_text(self.run.commissioning(), self.f_s)
    }

    /// Cause of a fault, else None.
    #[getter]
    fn cause(&self) -> Option<String> {
        cause_text(self.run.commissioning())
    }

    /// Largest phase current relative to the rated peak, and the largest angle of the shaft at standstill,
    /// electrical rad.
    #[getter]
    fn extremes(&self) -> (f64, f64) {
        self.run.extremes()
    }

    /// What has been found so far.
    fn found<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        found_dict(py, self.run.commissioning())
    }
}
