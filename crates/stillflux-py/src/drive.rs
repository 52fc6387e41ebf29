//! `Drive`, what it estimates, and its status.

use std::ffi::CString;

use numpy::{Complex64, PyArray1};
use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString, PyTuple};
use stillflux::drive::{self as core, Fault};
use stillflux::params::{Inverter, Machine};
use stillflux::si::{MeasurementSi, MemorySi, ReferenceSi, SiDrive};

use crate::convert::{
    Given, arguments, complex, extract, extract_some, fields, finite, is_not, pair, three, value_error,
};
use crate::parameters::{
    arithmetic, drive_params, found, inverter_of, leg_delay_tuple, machine_of, names_of, one_of, settings_dict,
};

create_exception!(
    stillflux,
    StatusWarning,
    PyUserWarning,
    "A status is compared with a text that is the name of no state: the answer is always \"unequal\"."
);

/// State of a drive's sequence, and the cause and time of a fault.
///
/// Compares equal to its state ("stopped", "reading offset", "magnetising", "running", "faulted") and to the coarser
/// "starting" (reading offset or magnetising) and "fault" (faulted); a text that is none of these is a `StatusWarning`. Since
/// it equals several texts it has no hash: take `state` for a set.
#[pyclass(frozen, get_all, module = "stillflux", from_py_object)]
#[derive(Clone)]
pub struct Status {
    /// "stopped", "reading offset", "magnetising", "running" or "faulted".
    state: String,
    /// Cause of the fault, else None.
    fault: Option<String>,
    /// Time of the fault since power-up in s, else None.
    time: Option<f64>,
    /// What was measured when it happened, in `unit`, else None.
    value: Option<f64>,
    /// The limit that it violated, in `unit`, else None; 0 where there is none.
    limit: Option<f64>,
}

/// States of a drive's sequence by name, and what each is called more coarsely.
const STATES: [(&str, &str); 5] = [
    ("stopped", "stopped"),
    ("reading offset", "starting"),
    ("magnetising", "starting"),
    ("running", "running"),
    ("faulted", "fault"),
];

impl Status {
    /// Of a drive with control frequency `f_s`.
    pub fn of(drive: &SiDrive, f_s: f64) -> Self {
        let state = match drive.status() {
            core::Status::Stopped => "stopped",
            core::Status::ReadingOffset => "reading offset",
            core::Status::Magnetising => "magnetising",
            core::Status::Running => "running",
            core::Status::Faulted { .. } => "faulted",
        };
        let report = drive.fault();
        Self {
            state: state.to_owned(),
            fault: report.map(|r| r.cause.to_string()),
            time: report.map(|r| f64::from(r.period) / f_s),
            value: report.map(|r| r.value),
            limit: report.map(|r| r.limit),
        }
    }

    fn cause(&self) -> Option<Fault> {
        let name = self.fault.as_deref()?;
        Fault::ALL.iter().copied().find(|fault| fault.text() == name)
    }

    fn coarse(&self) -> &str {
        found(&self.state, &STATES).unwrap_or(&self.state)
    }
}

#[pymethods]
impl Status {
    #[new]
    #[pyo3(signature = (state, fault=None, time=None, value=None, limit=None))]
    fn new(
        state: &Bound<'_, PyAny>,
        fault: Option<&Bound<'_, PyAny>>,
        time: Option<&Bound<'_, PyAny>>,
        value: Option<&Bound<'_, PyAny>>,
        limit: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let mut state: String = extract("state", state)?;
        // The one coarser word that is one state.
        if state == "fault" {
            "faulted".clone_into(&mut state);
        }
        one_of("state", &state, &STATES)?;
        let fault: Option<String> = extract_some("fault", fault)?;
        if let Some(cause) = &fault {
            let known: Vec<_> = Fault::ALL.iter().map(|fault| (fault.text(), ())).collect();
            one_of("fault", cause, &known)?;
            if state != "faulted" {
                return Err(PyValueError::new_err(format!("fault = '{cause}': state = '{state}' is not 'faulted'")));
            }
        }
        let number = |name, x| extract_some::<f64>(name, x);
        Ok(Self {
            state,
            fault,
            time: number("time", time)?,
            value: number("value", value)?,
            limit: number("limit", limit)?,
        })
    }

    /// The cause of the fault as a stable number, else None.
    #[getter]
    fn fault_code(&self) -> Option<u32> {
        self.cause().map(Fault::code)
    }

    /// Unit of `value` and `limit`, empty for numbers, else None.
    #[getter]
    fn unit(&self) -> Option<&'static str> {
        self.cause().map(|fault| fault.quantity().unit())
    }

    #[allow(clippy::type_complexity)]
    fn __getnewargs__(&self) -> (String, Option<String>, Option<f64>, Option<f64>, Option<f64>) {
        (self.state.clone(), self.fault.clone(), self.time, self.value, self.limit)
    }

    fn __str__(&self) -> String {
        match (&self.fault, self.time) {
            (Some(fault), Some(time)) => format!("fault: {fault} at {time:.4} s"),
            _ => self.coarse().to_owned(),
        }
    }

    fn __repr__(&self) -> String {
        format!("<Status {}>", self.__str__())
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> PyResult<bool> {
        let Ok(text) = other.extract::<&str>() else {
            return Ok(other.cast::<Self>().is_ok_and(|s| s.get().__getnewargs__() == self.__getnewargs__()));
        };
        if !STATES.iter().any(|&(state, coarse)| text == state || text == coarse) {
            let known = names_of(&STATES);
            let said = format!("no state is called '{text}'; there are {known}, 'starting', 'fault'");
            let py = other.py();
            PyErr::warn(py, &py.get_type::<StatusWarning>(), &CString::new(said.replace('\0', "?"))?, 1)?;
        }
        Ok(text == self.state || text == self.coarse())
    }

    fn __hash__(&self) -> PyResult<isize> {
        Err(PyTypeError::new_err("unhashable type: 'Status', which equals several texts: take its state, a text"))
    }

    fn __format__<'py>(&self, py: Python<'py>, spec: &str) -> PyResult<Bound<'py, PyAny>> {
        PyString::new(py, &self.__str__()).call_method1("__format__", (spec,))
    }
}

macro_rules! estimate {
    (complex: $($(#[$zdoc:meta])* $z:ident,)* ; real: $($(#[$xdoc:meta])* $x:ident,)*) => {
        /// Everything a drive estimates, of the latest period. Stator coordinates unless named `dq`.
        #[pyclass(frozen, get_all, module = "stillflux")]
        pub struct Estimate {
            $($(#[$zdoc])* $z: Complex64,)*
            $($(#[$xdoc])* $x: f64,)*
        }

        #[pymethods]
        impl Estimate {
            #[new]
            #[allow(clippy::too_many_arguments)]
            fn new($($z: &Bound<'_, PyAny>,)* $($x: &Bound<'_, PyAny>,)*) -> PyResult<Self> {
                Ok(Self { $($z: extract(stringify!($z), $z)?,)* $($x: extract(stringify!($x), $x)?,)* })
            }

            // For pickle.
            fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
                arguments(py, &[$(self.$z),*], &[$(self.$x),*])
            }

            fn __repr__(&self) -> String {
                let complex = [$((stringify!($z), self.$z)),*];
                let real = [$((stringify!($x), self.$x)),*];
                format!("<Estimate {}>", fields(&complex, &real))
            }

            // Nothing of it changes: it is its own copy.
            fn __copy__(slf: Py<Self>) -> Py<Self> {
                slf
            }

            fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
                slf
            }
        }

        impl Estimate {
            fn of(drive: &SiDrive) -> Self {
                let e = drive.estimate();
                Self { $($z: complex(e.$z),)* $($x: e.$x,)* }
            }
        }
    };
}

estimate! {
    complex:
    /// Stator flux linkage, V·s.
    psi_s,
    /// Rotor flux linkage of the inverse-Γ circuit, V·s.
    psi_r,
    /// Flux of the parallel path that finds the offset, V·s.
    psi_1,
    /// Stator current, A.
    i_s,
    /// Voltage applied between the last two samples, V.
    u_s,
    /// Induced voltage, V.
    u_i,
    /// Offset voltage, V.
    u_off,
    /// Output of the noise compensator, V.
    u_hf,
    /// Current in field coordinates, A.
    i_dq,
    /// Its reference, A.
    i_dq_ref,
    ;
    real:
    /// Flux reference, V·s.
    psi_ref,
    /// Speed, mechanical rad/s.
    omega_m,
    /// Stator frequency, electrical rad/s.
    omega_s,
    /// Slip frequency, electrical rad/s.
    omega_r,
    /// Torque, N·m.
    torque,
    /// Stator resistance including the inverter's r_d, Ω.
    R_s,
    /// Rotor resistance of the inverse-Γ circuit, which slip and speed are taken from, Ω: what the latest start found,
    /// with the warming and the saturation that are told; that of the parameters in the scheme "paper".
    R_R,
    /// Residual ε of equation (15), per unit; zero in the scheme "enhanced".
    epsilon,
    /// Innovation of the filter, rotor flux of the current model less that of the voltage model, V·s; zero in the
    /// scheme "paper".
    innovation,
    /// Normalised innovation squared (NIS), low-passed with the innovation's sign over one turn of the rated field:
    /// one where it stays at the deviation that the filter expects, less where it alternates; zero in the scheme "paper".
    nis,
    /// Standard deviation that the drive expects of its field angle, rad; π while it does not run.
    angle_deviation,
    /// Confidence in the field angle, 0 to 1.
    confidence,
    /// Part of the gains of the speed controller that a swing has left, 1 without one: the shaft has about this part of the
    /// inertia told.
    speed_gain,
}

/// What a drive stores at a stop, as dict.
pub fn memory_dict<'py>(py: Python<'py>, m: &MemorySi) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("u_off", complex(m.u_off))?;
    dict.set_item("R_s", m.R_s)?;
    dict.set_item("i_off", (m.i_off[0], m.i_off[1], m.i_off[2]))?;
    dict.set_item("loss_error", m.loss_error)?;
    dict.set_item("knee", m.knee)?;
    dict.set_item("L_sigma", m.L_sigma)?;
    dict.set_item("L_M", m.L_M)?;
    dict.set_item("leg_delay", leg_delay_tuple(&m.leg_delay))?;
    Ok(dict)
}

/// Names of the values of a memory.
const VALUES: [&str; 8] = ["u_off", "R_s", "i_off", "loss_error", "knee", "L_sigma", "L_M", "leg_delay"];

/// What `memory_dict` gave; what it does not know is that of the parameters.
pub fn memory_from(dict: &Bound<'_, PyDict>, leg_delay: [[f64; 2]; 3]) -> PyResult<MemorySi> {
    for name in dict.keys() {
        if !name.extract::<&str>().is_ok_and(|name| VALUES.contains(&name)) {
            let known = VALUES.join(", ");
            return Err(PyTypeError::new_err(format!("memory has no value {}; there are {known}", name.repr()?)));
        }
    }
    let item = |name: &'static str| {
        dict.get_item(name)?.ok_or_else(|| PyValueError::new_err(format!("memory has no '{name}'")))
    };
    let memory = MemorySi {
        u_off: pair(u_off(&item("u_off")?)?),
        R_s: extract("memory R_s", &item("R_s")?)?,
        i_off: three("memory i_off", &item("i_off")?)?,
        loss_error: extract("memory loss_error", &item("loss_error")?)?,
        // A memory from before the knee was learned has none, nor of the legs.
        knee: dict.get_item("knee")?.map_or(Ok(1.0), |x| extract("memory knee", &x))?,
        L_sigma: extract("memory L_sigma", &item("L_sigma")?)?,
        L_M: extract("memory L_M", &item("L_M")?)?,
        leg_delay: dict.get_item("leg_delay")?.map_or(Ok(leg_delay), |x| extract("memory leg_delay", &x))?,
    };
    Ok(memory)
}

/// A complex number, or its parts as plain data have them.
fn u_off(value: &Bound<'_, PyAny>) -> PyResult<Complex64> {
    if let Ok([re, im]) = value.extract::<[Bound<'_, PyAny>; 2]>() {
        let part = |x| extract("memory u_off", x);
        return Ok(Complex64::new(part(&re)?, part(&im)?));
    }
    extract("memory u_off", value)
}

/// A sensorless induction motor drive: currents and dc-link voltage in, duties out.
///
/// Currents sampled at the start of control period k give the duties applied during period k + 1.
///
/// Parameters
/// ----------
/// motor, inverter
///     The machine and the inverter as the drive knows them.
/// arithmetic
///     "f32", "f64" or "q" (fixed point).
/// scheme
///     "enhanced" (one filter for flux, offset, resistance and inverter error) or "paper" (the published scheme).
/// **settings
///     Limits, bandwidths and switches, see `stillflux.options.DriveSettings`.
///
/// Raises ValueError for a value outside its range, TypeError for an unknown setting.
#[pyclass(module = "stillflux")]
pub struct Drive {
    drive: SiDrive,
    settings: Py<PyDict>,
    f_s: f64,
    machine: Machine,
    inverter: Inverter,
    duty: [f64; 3],
    gates_on: bool,
}

#[pymethods]
impl Drive {
    #[new]
    #[pyo3(
        signature = (motor, inverter, arithmetic=Given::NOTHING, scheme=Given::NOTHING, **settings),
        text_signature = "(motor, inverter, arithmetic='f32', scheme='enhanced', **settings)"
    )]
    fn new(
        py: Python<'_>,
        motor: &Bound<'_, PyAny>,
        inverter: &Bound<'_, PyAny>,
        arithmetic: Given<'_>,
        scheme: Given<'_>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (machine, inverter) = (machine_of("motor", motor)?, inverter_of("inverter", inverter)?);
        let (arithmetic, scheme) =
            (arithmetic.or("arithmetic", "f32".to_owned())?, scheme.or("scheme", "enhanced".to_owned())?);
        let params = drive_params(&machine, &inverter, &scheme, settings)?;
        let arithmetic = self::arithmetic(&arithmetic)?;
        let drive = SiDrive::new(&machine, &inverter, &params, arithmetic).map_err(value_error)?;
        Ok(Self {
            drive,
            settings: settings_dict(py, &params)?.unbind(),
            f_s: inverter.f_c(),
            machine,
            inverter,
            duty: [0.5; 3],
            gates_on: false,
        })
    }

    /// One control period.
    ///
    /// Parameters
    /// ----------
    /// i_abc
    ///     Phase currents in A, positive into the machine; three numbers.
    /// u_dc
    ///     dc-link voltage in V.
    /// omega_ref
    ///     Speed reference, mechanical rad/s.
    /// torque_ref
    ///     Torque reference in N·m, instead of a speed reference. Neither: stop.
    /// cycle
    ///     Stamp of the PWM period, a number that the hardware counts up by one in each, 0 to 65535, then 0 again:
    ///     missed and doubled calls are seen by it. A doubled call changes nothing and returns the duties of the first,
    ///     but for a stop or a fault, which block the bridge.
    /// encoder
    ///     Position of the encoder at the instant of the currents, in counts (four a line) from anywhere; with the setting
    ///     `encoder_lines`. None: it has not been read.
    ///
    /// Returns the duties of the three legs for the next period, an array of shape (3,) in [0, 1].
    /// Raises ValueError if both references are given or one is not finite, and for an encoder without that setting.
    /// Implausible measurements do not raise: they are faults, see `status`.
    #[pyo3(signature = (i_abc, u_dc, omega_ref=None, torque_ref=None, cycle=None, encoder=None))]
    fn step<'py>(
        &mut self,
        i_abc: &Bound<'py, PyAny>,
        u_dc: &Bound<'py, PyAny>,
        omega_ref: Option<&Bound<'py, PyAny>>,
        torque_ref: Option<&Bound<'py, PyAny>>,
        cycle: Option<&Bound<'py, PyAny>>,
        encoder: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let (omega_ref, torque_ref) = (extract_some("omega_ref", omega_ref)?, extract_some("torque_ref", torque_ref)?);
        let (cycle, encoder) = (extract_some::<u16>("cycle", cycle)?, extract_some::<i64>("encoder", encoder)?);
        let command = match (omega_ref, torque_ref) {
            (None, None) => ReferenceSi::Stop,
            (Some(omega), None) => ReferenceSi::Speed(finite("omega_ref", omega)?),
            (None, Some(torque)) => ReferenceSi::Torque(finite("torque_ref", torque)?),
            (Some(omega), Some(torque)) => {
                return Err(PyValueError::new_err(format!(
                    "omega_ref = {omega} and torque_ref = {torque}: only one of them can be followed"
                )));
            }
        };
        let sample = MeasurementSi { i_abc: three("i_abc", i_abc)?, u_dc: extract("u_dc", u_dc)? };
        if let Some(position) = encoder {
            if self.drive.encoder().is_none() {
                return Err(PyValueError::new_err(format!(
                    "encoder = {position}: this drive has none; it is told of one by the setting encoder_lines"
                )));
            }
            self.drive.set_encoder(position);
        }
        let out = match cycle {
            None => Some(self.drive.step(&sample, &command)),
            Some(stamp) => self.drive.step_at(stamp, &sample, &command),
        };
        if let Some((duty, gates_on)) = out {
            (self.duty, self.gates_on) = (duty, gates_on);
        }
        Ok(PyArray1::from_slice(i_abc.py(), &self.duty))
    }

    /// Pulses of the next period with `current_sensors=1`: half widths of the three legs' pulses before and after the middle
    /// of the carrier period, and the two instants after it at which the shunt is sampled, all in half periods of the
    /// carrier. None with more sensors.
    #[getter]
    fn pulses(&self) -> Option<([f64; 3], [f64; 3], [f64; 2])> {
        self.drive.pulses().map(|p| (p.rising, p.falling, p.sample))
    }

    /// False: the bridge has to be blocked; the duties are then 0.5 each.
    #[getter]
    fn gates_on(&self) -> bool {
        self.gates_on
    }

    /// Estimates of the latest period.
    #[getter]
    fn estimate(&self) -> Estimate {
        Estimate::of(&self.drive)
    }

    /// What the encoder says: measured speed and its filtered difference from the estimate in mechanical rad/s, and
    /// "silent", "agrees", "apart" or "estimate apart". None without the setting `encoder_lines`.
    #[getter]
    fn encoder(&self) -> Option<(f64, f64, &'static str)> {
        self.drive.encoder().map(|e| (e.omega_m, e.difference, e.state.text()))
    }

    /// State of the sequence, or the fault with its cause and time.
    #[getter]
    fn status(&self) -> Status {
        Status::of(&self.drive, self.f_s)
    }

    /// All settings, defaults included.
    #[getter]
    fn settings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.settings.bind(py).copy()
    }

    /// Data worth keeping over a stop: u_off (complex, V), R_s (with r_d, Ω), i_off (three values, A), loss_error
    /// (of the inverter model's voltage, relative), knee (of its curve, relative to that of `c_out`), L_sigma and L_M (H),
    /// leg_delay (as of `Inverter`, s).
    fn memory<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        memory_dict(py, &self.drive.memory())
    }

    /// Takes back what `memory` gave; values beyond their limits are limited, `knee` and `leg_delay` may be missing, `u_off` may
    /// be (re, im). The next start reads the offsets of the current sensors anew; the enhanced scheme takes `u_off` back with
    /// `calibrate_offset=False` only.
    ///
    /// Raises TypeError for a value that there is not, ValueError for R_s, L_sigma or L_M that no drive of this motor
    /// and inverter has (the memory is another machine's), RuntimeError while the bridge switches: an estimate that is
    /// in use stays as it is.
    fn restore(&mut self, memory: &Bound<'_, PyAny>) -> PyResult<()> {
        let Ok(memory) = memory.cast::<PyDict>() else {
            return Err(is_not("memory", memory, "not a dict, as Drive.memory() gives it"));
        };
        let memory = memory_from(memory, self.inverter.leg_delay)?;
        memory.validate(&self.machine, &self.inverter).map_err(value_error)?;
        if self.drive.restore(&memory) {
            return Ok(());
        }
        Err(PyRuntimeError::new_err("restore: the bridge switches; stop the drive first (a step without a reference)"))
    }

    /// Leaves a fault; the drive is stopped then.
    fn reset(&mut self) {
        self.drive.reset();
    }

    fn __repr__(&self) -> String {
        format!("<Drive: {}, gates {}>", self.status().__str__(), if self.gates_on { "on" } else { "off" })
    }
}
