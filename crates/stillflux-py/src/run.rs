//! `Run`: a closed-loop experiment that Python advances in pieces.

use std::borrow::Cow;

use numpy::{Complex64, PyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict};
use stillflux::params::check;
use stillflux_sim::ChannelFault;
use stillflux_sim::simulate::{self as sim, Change, Profile, ReferenceProfile, SIGNALS};

use crate::convert::{each_keyword, extract, named, offsets, value_error};
use crate::drive::{Status, memory_dict, memory_from};
use crate::parameters::{Inverter, Motor, arithmetic, drive_params};
use crate::plant::{dc_link, encoder_fault, plant_params, resistance, shaft_speed};

/// A constant, or points `(t, value)`.
#[derive(FromPyObject)]
enum Points {
    Constant(f64),
    Points(Vec<(f64, f64)>),
}

impl Points {
    fn profile(self, name: &str) -> PyResult<Profile> {
        let points = match self {
            Self::Constant(value) => vec![(0.0, value)],
            Self::Points(points) => points,
        };
        Profile::new(points).map_err(|e| PyValueError::new_err(format!("{name}: {e}")))
    }
}

/// What is read from a Python `Scenario`.
#[derive(FromPyObject)]
struct Scenario<'py> {
    motor: Motor,
    inverter: Inverter,
    arithmetic: String,
    scheme: String,
    settings: Bound<'py, PyDict>,
    plant: Bound<'py, PyDict>,
    plant_motor: Option<Motor>,
    plant_inverter: Option<Inverter>,
    omega_ref: Points,
    torque_ref: Option<Points>,
    load_torque: Points,
    changes: Vec<(f64, Bound<'py, PyDict>)>,
    duration: f64,
    record_every: u32,
    signals: Option<Vec<String>>,
    memory: Option<Bound<'py, PyDict>>,
    cycle_stamps: bool,
}

impl Scenario<'_> {
    fn build(self) -> PyResult<sim::Scenario> {
        let (machine, inverter) = (self.motor.machine()?, self.inverter.params()?);
        let plant_machine = self.plant_motor.map_or(Ok(machine), |m| m.machine())?;
        let plant_inverter = self.plant_inverter.map_or(Ok(inverter), |i| i.params())?;
        let drive = drive_params(&machine, &inverter, &self.scheme, Some(&self.settings))?;
        let plant = plant_params(plant_machine, plant_inverter, Some(&self.plant))?;
        // A channel that ends below hides an over-current, and current control would let it grow on. What is not given follows
        // from the real motor, whatever the drive is told.
        if self.plant.get_item("adc_range")?.is_some_and(|range| !range.is_none()) {
            check("adc_range", plant.adc.range, drive.i_trip, 1e6, "A")
                .map_err(|e| e.with_note("the current channels have to show i_trip, the drive's over-current level"))
                .map_err(value_error)?;
        }
        Ok(sim::Scenario {
            drive,
            plant,
            machine,
            inverter,
            arithmetic: arithmetic(&self.arithmetic)?,
            reference: match self.torque_ref {
                Some(torque) => ReferenceProfile::Torque(torque.profile("torque_ref")?),
                None => ReferenceProfile::Speed(self.omega_ref.profile("omega_ref")?),
            },
            load: self.load_torque.profile("load_torque")?,
            changes: changes(&self.changes)?,
            duration: self.duration,
            record_every: self.record_every,
            signals: self.signals,
            memory: self.memory.map(|m| memory_from(&m, inverter.leg_delay)).transpose()?,
            cycle_stamps: self.cycle_stamps,
        })
    }
}

/// One entry a change: a dict with several names makes several changes at one time.
const CHANGES: &[&str] =
    &["R_s", "R_R", "current_offset", "u_dc", "speed", "open_phase", "channel", "encoder", "stop", "reset"];

fn changes(list: &[(f64, Bound<'_, PyDict>)]) -> PyResult<Vec<(f64, Change)>> {
    let mut all = Vec::new();
    for (k, (t, what)) in list.iter().enumerate() {
        let named = |e: PyErr| named(what.py(), &format!("changes[{k}]"), &e);
        each_keyword(Some(what), "a change of plant or drive", CHANGES, |name, value| {
            let change = match name {
                "R_s" => Change::StatorResistance(resistance(extract(name, value)?)?),
                "R_R" => Change::RotorResistance(extract(name, value)?),
                "current_offset" => Change::CurrentOffset(offsets(name, value)?),
                "u_dc" => Change::DcLink(dc_link(extract(name, value)?)?),
                "speed" => Change::Speed(shaft_speed(extract(name, value)?)?),
                "open_phase" => Change::OpenPhase(phase(name, value)?),
                "channel" => channel(value)?,
                "encoder" => Change::Encoder(encoder_fault(extract::<Option<String>>(name, value)?.as_deref())?),
                "stop" => Change::Stop(extract(name, value)?),
                "reset" => {
                    if extract(name, value)? {
                        Change::Reset
                    } else {
                        return Ok(true);
                    }
                }
                _ => return Ok(false),
            };
            all.push((*t, change));
            Ok(true)
        })
        .map_err(named)?;
    }
    Ok(all)
}

/// Number of a phase or channel.
fn phase(name: &str, value: &Bound<'_, PyAny>) -> PyResult<usize> {
    match value.extract::<usize>() {
        Ok(number) if number < 3 && !value.is_instance_of::<PyBool>() => Ok(number),
        _ => Err(PyValueError::new_err(format!("{name} = {} is not a whole number from 0 to 2", value.repr()?))),
    }
}

/// A channel that fails: its number, how, and a value where it takes one.
fn channel(value: &Bound<'_, PyAny>) -> PyResult<Change> {
    let given = value;
    let (number, kind, value) = match value.extract::<(Bound<'_, PyAny>, String)>() {
        Ok((number, kind)) => (number, kind, None),
        Err(_) => value.extract::<(Bound<'_, PyAny>, String, Option<f64>)>().map_err(|_| {
            PyValueError::new_err(format!("channel = {given} is not (number, how) or (number, how, value)"))
        })?,
    };
    let fault = match (kind.as_str(), value) {
        ("held", None) => ChannelFault::Held,
        ("stuck", Some(ampere)) => ChannelFault::Stuck(ampere),
        ("once", Some(ampere)) => ChannelFault::Once(ampere),
        ("gain", Some(factor)) => ChannelFault::Gain(factor),
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        ("of", Some(other)) if [0.0, 1.0, 2.0].contains(&other) => ChannelFault::Of(other as usize),
        ("of", Some(_)) => ChannelFault::Of(phase("channel of", &given.get_item(2)?)?),
        _ => {
            return Err(PyValueError::new_err(format!(
                "channel = {given}: admissible are 'held' without a value, and 'stuck', 'once', 'gain' and 'of' with one"
            )));
        }
    };
    Ok(Change::Channel(phase("channel", &number)?, fault))
}

/// Names and units of all signals a run can record.
#[pyfunction]
pub fn signals(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    for s in SIGNALS {
        dict.set_item(s.name, s.unit)?;
    }
    Ok(dict)
}

/// A scenario being run, advanced in pieces with the GIL released.
///
/// Raises ValueError or TypeError for what is wrong with the scenario.
#[pyclass(module = "stillflux._core")]
pub struct Run {
    run: sim::Run<'static>,
    f_s: f64,
}

#[pymethods]
impl Run {
    #[new]
    fn new(scenario: Scenario<'_>) -> PyResult<Self> {
        let scenario = scenario.build()?;
        let f_s = scenario.inverter.f_c();
        Ok(Self { run: sim::Run::new(Cow::Owned(scenario)).map_err(value_error)?, f_s })
    }

    /// Runs at most `periods` further control periods; False when the run is complete.
    fn advance(&mut self, py: Python<'_>, periods: u64) -> bool {
        py.detach(|| self.run.advance(periods))
    }

    /// Simulated time so far, s.
    #[getter]
    fn time(&self) -> f64 {
        self.run.time()
    }

    /// Status of the drive.
    #[getter]
    fn status(&self) -> Status {
        Status::of(self.run.drive(), self.f_s)
    }

    /// What the drive would store now.
    fn memory<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        memory_dict(py, &self.run.drive().memory())
    }

    /// The record so far: name to array, time as "t" in s.
    fn record<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let record = self.run.record();
        let dict = PyDict::new(py);
        dict.set_item("t", PyArray1::from_slice(py, &record.t))?;
        for column in &record.columns {
            if column.complex {
                let data = column.data.chunks_exact(2).map(|v| Complex64::new(v[0], v[1])).collect();
                dict.set_item(column.name, PyArray1::from_vec(py, data))?;
            } else {
                dict.set_item(column.name, PyArray1::from_slice(py, &column.data))?;
            }
        }
        Ok(dict)
    }
}
