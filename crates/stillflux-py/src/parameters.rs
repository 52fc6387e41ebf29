//! Motor and inverter data classes of Python as Rust parameters, and the settings of a drive.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use stillflux::base::{Base, PerUnit};
use stillflux::config::{DriveParams, EncoderMode, EnhancedParams, LowConfidence, PaperParams, Scheme};
use stillflux::params::{self, Gamma, Machine, Rating, Saturation, TModel, check};
use stillflux::si::Arithmetic;

use crate::convert::{all_parts, changed, extract, fields_of, parts, value_error};

/// What is read from a Python `Motor`.
#[derive(FromPyObject)]
pub struct Motor {
    R_s: f64,
    R_R: f64,
    L_sigma: f64,
    L_M: f64,
    n_p: f64,
    J: f64,
    U_N: f64,
    I_N: f64,
    f_N: f64,
    T_N: f64,
    saturation: Option<(f64, f64, f64)>,
}

impl Motor {
    /// Validated parameters.
    pub fn machine(&self) -> PyResult<Machine> {
        check("n_p", self.n_p, 1.0, 60.0, "").map_err(value_error)?;
        if self.n_p.fract() != 0.0 {
            return Err(PyValueError::new_err(format!("n_p = {} is not a whole number from 1 to 60", self.n_p)));
        }
        let m = Machine {
            R_s: self.R_s,
            R_R: self.R_R,
            L_sigma: self.L_sigma,
            L_M: self.L_M,
            n_p: self.n_p as u32,
            J: self.J,
            U_N: self.U_N,
            I_N: self.I_N,
            f_N: self.f_N,
            T_N: self.T_N,
            saturation: self.saturation.map(|(L_u, a, S)| Saturation { L_u, a, S }),
        };
        m.validate().map_err(value_error)?;
        Ok(m)
    }
}

/// What is read from a Python `Inverter`.
#[derive(FromPyObject)]
pub struct Inverter {
    u_dc: f64,
    f_s: f64,
    u_th: f64,
    r_d: f64,
    dead_time: f64,
    f_clk: f64,
    c_out: f64,
    half_periods: f64,
    leg_delay: [[f64; 2]; 3],
}

impl Inverter {
    /// Validated parameters.
    pub fn params(&self) -> PyResult<params::Inverter> {
        let Self { u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out, half_periods, leg_delay } = *self;
        if half_periods.fract() != 0.0 {
            return Err(PyValueError::new_err(format!(
                "half_periods = {half_periods} is not a whole number from 1 to 16"
            )));
        }
        check("half_periods", half_periods, 1.0, 16.0, "").map_err(value_error)?;
        let half_periods = half_periods as u32;
        let inverter = params::Inverter { u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out, half_periods, leg_delay };
        inverter.validate().map_err(value_error)?;
        Ok(inverter)
    }
}

/// Validated parameters of an argument that is a `Motor`.
pub fn machine_of(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Machine> {
    fields_of::<Motor>(name, value, "Motor")?.machine()
}

/// Validated parameters of an argument that is an `Inverter`.
pub fn inverter_of(name: &str, value: &Bound<'_, PyAny>) -> PyResult<params::Inverter> {
    fields_of::<Inverter>(name, value, "Inverter")?.params()
}

/// Raises ValueError for the first field of a motor outside its range.
#[pyfunction]
pub fn validate_motor(motor: Motor) -> PyResult<()> {
    motor.machine().map(drop)
}

/// Raises ValueError for the first field of an inverter outside its range.
#[pyfunction]
pub fn validate_inverter(inverter: Inverter) -> PyResult<()> {
    inverter.params().map(drop)
}

/// A dict of the named fields of a struct.
macro_rules! dict {
    ($py:expr, $value:expr; $($field:ident),* $(,)?) => {{
        let (dict, value) = (PyDict::new($py), $value);
        $(dict.set_item(stringify!($field), value.$field)?;)*
        dict
    }};
}

/// A preset of that name.
fn preset<T: Copy>(name: &Bound<'_, PyAny>, of_2k2: T, of_11k: T) -> PyResult<T> {
    let name: String = extract("preset", name)?;
    found(&name, &[("2.2kW", of_2k2), ("11kW", of_11k)])
        .ok_or_else(|| PyValueError::new_err(format!("preset = '{name}' is unknown, there are '2.2kW' and '11kW'")))
}

/// Fields of a preset motor.
#[pyfunction]
pub fn motor_preset<'py>(py: Python<'py>, name: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyDict>> {
    machine_dict(py, &preset(name, Machine::preset_2k2(), Machine::preset_11k())?)
}

/// Fields of a motor.
pub fn machine_dict<'py>(py: Python<'py>, m: &Machine) -> PyResult<Bound<'py, PyDict>> {
    let fields = dict!(py, m; R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N);
    fields.set_item("saturation", m.saturation.map(|s| (s.L_u, s.a, s.S)))?;
    Ok(fields)
}

/// Fields of a preset inverter.
#[pyfunction]
pub fn inverter_preset<'py>(py: Python<'py>, name: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyDict>> {
    inverter_dict(py, &preset(name, params::Inverter::preset_2k2(), params::Inverter::preset_11k())?)
}

/// Delays of the legs, as nested tuples.
pub fn leg_delay_tuple(delay: &[[f64; 2]; 3]) -> ((f64, f64), (f64, f64), (f64, f64)) {
    let [a, b, c] = delay.map(|[plus, minus]| (plus, minus));
    (a, b, c)
}

/// Fields of an inverter.
pub fn inverter_dict<'py>(py: Python<'py>, inverter: &params::Inverter) -> PyResult<Bound<'py, PyDict>> {
    let fields = dict!(py, inverter; u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out, half_periods);
    fields.set_item("leg_delay", leg_delay_tuple(&inverter.leg_delay))?;
    Ok(fields)
}

/// No part of a conversion between equivalent circuits depends on the rating.
const NO_RATING: Rating = Rating { n_p: 1, J: 1.0, U_N: 1.0, I_N: 1.0, f_N: 1.0, T_N: 1.0 };

/// Parameters of the inverse-Γ circuit as dict.
pub fn inverse_gamma<'py>(py: Python<'py>, m: &Machine) -> PyResult<Bound<'py, PyDict>> {
    Ok(dict!(py, m; R_s, R_R, L_sigma, L_M))
}

/// Least resistance and inductance of a branch before the conversion, which the ranges of the inverse-Γ circuit follow.
const LEAST: f64 = 1e-6;

/// A resistance or an inductance of another circuit.
fn branch(name: &'static str, value: &Bound<'_, PyAny>, least: f64, unit: &'static str) -> PyResult<f64> {
    let value = extract(name, value)?;
    check(name, value, least, 1e3, unit).map_err(value_error)?;
    Ok(value)
}

/// Inverse-Γ parameters of a Γ circuit.
#[pyfunction]
pub fn from_gamma<'py>(
    py: Python<'py>,
    R_s: &Bound<'py, PyAny>,
    R_r: &Bound<'py, PyAny>,
    L_l: &Bound<'py, PyAny>,
    L_s: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let gamma = Gamma {
        R_s: branch("R_s", R_s, LEAST, "ohm")?,
        R_r: branch("R_r", R_r, LEAST, "ohm")?,
        L_l: branch("L_l", L_l, LEAST, "H")?,
        L_s: branch("L_s", L_s, LEAST, "H")?,
    };
    inverse_gamma(py, &Machine::from_gamma(gamma, NO_RATING))
}

/// Inverse-Γ parameters of a T circuit.
#[pyfunction]
pub fn from_t_model<'py>(
    py: Python<'py>,
    R_s: &Bound<'py, PyAny>,
    R_r: &Bound<'py, PyAny>,
    L_ls: &Bound<'py, PyAny>,
    L_lr: &Bound<'py, PyAny>,
    L_m: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    // One of the leakages may be that of both sides.
    let t_model = TModel {
        R_s: branch("R_s", R_s, LEAST, "ohm")?,
        R_r: branch("R_r", R_r, LEAST, "ohm")?,
        L_ls: branch("L_ls", L_ls, 0.0, "H")?,
        L_lr: branch("L_lr", L_lr, 0.0, "H")?,
        L_m: branch("L_m", L_m, LEAST, "H")?,
    };
    inverse_gamma(py, &Machine::from_t_model(t_model, NO_RATING))
}

/// Γ parameters of a motor.
#[pyfunction]
pub fn to_gamma(py: Python<'_>, motor: Motor) -> PyResult<Bound<'_, PyDict>> {
    Ok(dict!(py, motor.machine()?.to_gamma(); R_s, R_r, L_l, L_s))
}

/// T parameters of a motor, with equal leakages.
#[pyfunction]
pub fn to_t_model(py: Python<'_>, motor: Motor) -> PyResult<Bound<'_, PyDict>> {
    Ok(dict!(py, motor.machine()?.to_t_model(); R_s, R_r, L_ls, L_lr, L_m))
}

/// Base quantities of a motor's per-unit system, SI.
#[pyfunction]
pub fn base(py: Python<'_>, motor: Motor) -> PyResult<Bound<'_, PyDict>> {
    Ok(dict!(py, Base::new(&motor.machine()?); u, i, omega, psi, z, l, torque, omega_m))
}

/// Arithmetic of that name.
pub fn arithmetic(name: &str) -> PyResult<Arithmetic> {
    one_of("arithmetic", name, &[("f32", Arithmetic::F32), ("f64", Arithmetic::F64), ("q", Arithmetic::Q)])
}

const SCHEMES: [(&str, Scheme); 2] = [("enhanced", Scheme::Enhanced), ("paper", Scheme::Paper)];
const LOW_CONFIDENCE: [(&str, LowConfidence); 3] =
    [("keep", LowConfidence::Keep), ("limit", LowConfidence::LimitTorque), ("fault", LowConfidence::Fault)];

const ENCODER_MODE: [(&str, EncoderMode); 2] = [("compare", EncoderMode::Compare), ("control", EncoderMode::Control)];

/// The choice of that name.
pub fn one_of<T: Copy>(field: &str, name: &str, choices: &[(&str, T)]) -> PyResult<T> {
    found(name, choices)
        .ok_or_else(|| PyValueError::new_err(format!("{field} = '{name}' is not one of {}", names_of(choices))))
}

/// What has that name.
pub fn found<T: Copy>(name: &str, choices: &[(&str, T)]) -> Option<T> {
    choices.iter().find(|(known, _)| *known == name).map(|&(_, choice)| choice)
}

/// The names of choices in quotation marks.
pub fn names_of<T>(choices: &[(&str, T)]) -> String {
    choices.iter().map(|(name, _)| format!("'{name}'")).collect::<Vec<_>>().join(", ")
}

macro_rules! drive_settings {
    (common: $($field:ident),* ; paper: $($paper:ident),* ; enhanced: $($enhanced:ident),* $(;)?) => {
        /// Every setting, of both schemes.
        const SETTINGS: &[&str] =
            &[$(stringify!($field),)* $(stringify!($paper),)* $(stringify!($enhanced),)* "low_confidence", "encoder_mode"];
        const PAPER: &[&str] = &[$(stringify!($paper)),*];
        const ENHANCED: &[&str] = &[$(stringify!($enhanced)),*];

        fn set(p: &mut DriveParams, name: &str, value: &Bound<'_, PyAny>) -> PyResult<bool> {
            match name {
                $(stringify!($field) => p.$field = extract(name, value)?,)*
                $(stringify!($paper) => p.paper.$paper = extract(name, value)?,)*
                $(stringify!($enhanced) => p.enhanced.$enhanced = extract(name, value)?,)*
                "low_confidence" => {
                    p.low_confidence = one_of(name, &extract::<String>(name, value)?, &LOW_CONFIDENCE)?;
                }
                "encoder_mode" => p.encoder_mode = one_of(name, &extract::<String>(name, value)?, &ENCODER_MODE)?,
                _ => return Ok(false),
            }
            Ok(true)
        }

        /// The settings of a drive as dict: those of its scheme.
        pub fn settings_dict<'py>(py: Python<'py>, p: &DriveParams) -> PyResult<Bound<'py, PyDict>> {
            // Without `..`: a setting added to the drive has to be added here.
            let DriveParams { scheme, low_confidence, encoder_mode, paper, enhanced, $($field),* } = *p;
            let PaperParams { $($paper),* } = paper;
            let EnhancedParams { $($enhanced),* } = enhanced;
            let dict = PyDict::new(py);
            $(dict.set_item(stringify!($field), $field)?;)*
            let name = LOW_CONFIDENCE.iter().find(|(_, what)| *what == low_confidence).map(|(name, _)| *name);
            dict.set_item("low_confidence", name)?;
            let name = ENCODER_MODE.iter().find(|(_, mode)| *mode == encoder_mode).map(|(name, _)| *name);
            dict.set_item("encoder_mode", name)?;
            match scheme {
                Scheme::Paper => { $(dict.set_item(stringify!($paper), $paper)?;)* }
                Scheme::Enhanced => { $(dict.set_item(stringify!($enhanced), $enhanced)?;)* }
            }
            Ok(dict)
        }
    };
}

drive_settings! {
    common:
    psi_ref, i_max, torque_max, omega_max, i_trip, i_range, u_dc_min, u_dc_max,
    current_bandwidth, flux_bandwidth, speed_bandwidth, set_point_weight, pll_bandwidth,
    inverter_model, calibrate_offset, offset_time, current_sensors, shunt_window, shunt_settling, magnetise_time, fresh_time, supervision, stall_time,
    realignment, reduce_gain, discontinuous_above, field_weakening, overmodulation, acceleration, jerk, torque_limits,
    speed_limits, machine_overload, bridge_overload,
    u_dc_brake, u_dc_buffer, u_dc_chopper, encoder_lines, encoder_states, encoder_deviation, encoder_fault;
    paper:
    offset_estimator, offset_gain, noise_compensator, noise_gain, noise_regeneration, resistance_adaptation,
    resistance_gain, resistance_at_rest, resistance_at_light_load, resistance_quotient, initial_flux, low_pass, limiter;
    enhanced:
    identify_offset, identify_resistance, identify_legs, find_slow_rotation, hold_inductances, apply_innovation,
    omega_s_min, dither, prior_R_s, prior_loss, prior_c_out, prior_L_sigma, prior_R_R, prior_L_M,
    winding_temperature, cage_constant, rotor_rise, winding_heat;
}

/// A setting of the other scheme is an error, whatever its value.
fn check_scheme(scheme: Scheme, name: &str) -> PyResult<()> {
    let (own, other, others) = match scheme {
        Scheme::Paper => ("paper", "enhanced", ENHANCED),
        Scheme::Enhanced => ("enhanced", "paper", PAPER),
    };
    if others.contains(&name) {
        return Err(PyTypeError::new_err(format!(
            "'{name}' is a setting of the scheme '{other}', the scheme of this drive is '{own}'"
        )));
    }
    Ok(())
}

/// What the two numbers of a setting are that may be None.
const PAIRS: [(&str, &str); 7] = [
    ("torque_limits", "negative limit, positive limit in N m"),
    ("speed_limits", "negative limit, positive limit in rad/s"),
    ("machine_overload", "continuous current in A rms, time constant in s"),
    ("bridge_overload", "continuous current in A rms, time constant in s"),
    ("u_dc_chopper", "voltage from which on the chopper takes current, voltage at which its duty is 1, in V"),
    ("initial_flux", "alpha, beta per unit of rated flux"),
    ("winding_heat", "rise at rated current in K, time constant in s"),
];

/// Settings of a drive: the defaults of machine and inverter, changed by keywords.
pub fn drive_params(
    machine: &Machine,
    inverter: &params::Inverter,
    scheme: &str,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<DriveParams> {
    let scheme = one_of("scheme", scheme, &SCHEMES)?;
    let p = DriveParams { scheme, ..DriveParams::new(machine, inverter) };
    let set = |p: &mut DriveParams, name: &str, value: &Bound<'_, PyAny>| {
        check_scheme(scheme, name)?;
        if let Some((_, meaning)) = PAIRS.iter().find(|(pair, _)| *pair == name) {
            parts::<[f64; 2]>(name, value, meaning)?;
        }
        if name == "noise_gain" {
            all_parts::<[f64; 2]>(name, value, "smallest gain, largest gain per unit")?;
        }
        set(p, name, value)
    };
    // A machine and a bridge that do not go together come first: the ranges of the settings follow from them.
    PerUnit::new(machine, inverter).map_err(value_error)?;
    changed(p, settings, ("the drive", SETTINGS), set, |p| p.validate(machine, inverter))
}
