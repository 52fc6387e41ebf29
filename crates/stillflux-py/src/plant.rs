//! `Plant` and its true state.

use numpy::{Complex64, PyArray1};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use stillflux::control::shunt::Pulses;
use stillflux::params::{self, Machine, check, check_resistance};
use stillflux::si::MeasurementSi;
use stillflux_sim::{
    Coupling, DcLink, DeepBar, Encoder, EncoderFault, Grid, IronLoss, LeakageSaturation, Mode, PlantParams, Shunt,
    SlotRipple, Thermal, Truth,
};

use crate::convert::{
    Given, arguments, changed, complex, extract, fields, finite, finite_parts, offsets, parts, three, value_error,
};
use crate::parameters::{Motor, found, inverse_gamma, inverter_of, machine_of, names_of, one_of};

fn mode(name: &str) -> PyResult<Mode> {
    one_of("mode", name, &[("switching", Mode::Switching), ("averaged", Mode::Averaged)])
}

/// Second rotor branch of the option `deep_bar`.
fn deep_bar_of(value: &Bound<'_, PyAny>) -> PyResult<Option<DeepBar>> {
    let found = parts::<(f64, f64)>("deep_bar", value, "share of the conductance, share of the inverse leakage")?;
    Ok(found.map(|(conductance, leakage)| DeepBar { conductance, leakage }))
}

/// Inverse-Γ parameters at slip frequency of a motor with a second rotor branch; `None`: its own.
#[pyfunction]
pub fn at_slip_frequency<'py>(
    py: Python<'py>,
    motor: Motor,
    deep_bar: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let machine = motor.machine()?;
    let Some(bar) = deep_bar_of(deep_bar)? else { return inverse_gamma(py, &machine) };
    bar.validate().map_err(value_error)?;
    inverse_gamma(py, &bar.at_slip_frequency(&machine))
}

const OPTIONS: &[&str] = &[
    "mode",
    "seed",
    "saturation",
    "J_load",
    "coupling",
    "viscous",
    "coulomb",
    "stribeck",
    "stribeck_speed",
    "speed",
    "turn_on_delay",
    "turn_off_delay",
    "adc_bits",
    "adc_range",
    "adc_noise",
    "current_offset",
    "current_offset_drift",
    "current_gain",
    "iron_loss",
    "deep_bar",
    "leakage_saturation",
    "slot_ripple",
    "shunt",
    "encoder_lines",
    "adc_skew",
    "missed_calls",
    "doubled_calls",
    "dc_link",
    "grid",
    "thermal",
];

fn set(p: &mut PlantParams, name: &str, value: &Bound<'_, PyAny>) -> PyResult<bool> {
    match name {
        "mode" => p.mode = mode(&extract::<String>(name, value)?)?,
        "seed" => p.seed = extract(name, value)?,
        "saturation" => p.saturation = extract(name, value)?,
        "J_load" => p.mechanics.J_load = extract(name, value)?,
        "coupling" => {
            p.mechanics.coupling =
                parts::<(f64, f64, f64)>(name, value, "stiffness in N·m/rad, damping in N·m·s/rad, backlash in rad")?
                    .map(|(stiffness, damping, backlash)| Coupling { stiffness, damping, backlash });
        }
        "viscous" => p.mechanics.viscous = extract(name, value)?,
        "coulomb" => p.mechanics.coulomb = extract(name, value)?,
        "stribeck" => p.mechanics.stribeck = extract(name, value)?,
        "stribeck_speed" => p.mechanics.stribeck_speed = extract(name, value)?,
        "speed" => p.mechanics.speed = extract(name, value)?,
        "turn_on_delay" => p.gate_delays.on = extract(name, value)?,
        "turn_off_delay" => p.gate_delays.off = extract(name, value)?,
        "adc_bits" => p.adc.bits = extract(name, value)?,
        "adc_range" => p.adc.range = extract::<Option<f64>>(name, value)?.unwrap_or(p.adc.range),
        "adc_noise" => p.adc.noise = extract(name, value)?,
        "current_offset" => p.adc.offset = offsets(name, value)?,
        "current_offset_drift" => p.adc.offset_drift = offsets(name, value)?,
        "current_gain" => p.adc.gain = three(name, value)?,
        "iron_loss" => {
            p.iron_loss = parts::<(f64, f64)>(name, value, "R_fe in Ω, time constant in s")?
                .map(|(R_fe, time_constant)| IronLoss { R_fe, time_constant });
        }
        "deep_bar" => p.deep_bar = deep_bar_of(value)?,
        "leakage_saturation" => {
            p.leakage_saturation = parts::<(f64, f64)>(name, value, "share of the leakage, peak current in A")?
                .map(|(share, current)| LeakageSaturation { share, current });
        }
        "slot_ripple" => {
            p.slot_ripple = parts::<(u32, f64, f64)>(
                name,
                value,
                "number of slots, amplitude of the permeance, amplitude of the inverse leakage",
            )?
            .map(|(slots, permeance, leakage)| SlotRipple { slots, permeance, leakage });
        }
        "shunt" => p.shunt = extract::<Option<f64>>(name, value)?.map(|settling| Shunt { settling }),
        "encoder_lines" => p.encoder = extract::<Option<u32>>(name, value)?.map(|lines| Encoder { lines }),
        "adc_skew" => p.adc.skew = three(name, value)?,
        "missed_calls" => p.calls.missed = extract(name, value)?,
        "doubled_calls" => p.calls.doubled = extract(name, value)?,
        "dc_link" => {
            p.dc_link = parts::<(f64, f64, Option<f64>)>(name, value, "C in F, R_supply in Ω, R_chopper in Ω or None")?
                .map(|(C, R_supply, R_chopper)| DcLink { C, R_supply, R_chopper: R_chopper.unwrap_or(f64::INFINITY) });
        }
        "grid" => {
            p.grid = parts::<(f64, f64)>(name, value, "frequency in Hz, inductance in H")?
                .map(|(frequency, inductance)| Grid { frequency, inductance });
        }
        "thermal" => {
            p.thermal = parts::<Vec<f64>>(
                name,
                value,
                "time constant in s, rise in K, alpha in 1/K, alpha_R in 1/K or nothing",
            )?
            .map(|parts| match parts[..] {
                [time_constant, rise, alpha] => Ok(Thermal { time_constant, rise, alpha, alpha_R: 0.0 }),
                [time_constant, rise, alpha, alpha_R] => Ok(Thermal { time_constant, rise, alpha, alpha_R }),
                _ => Err(PyTypeError::new_err(format!("thermal: {} numbers instead of three or four", parts.len()))),
            })
            .transpose()?;
        }
        _ => return Ok(false),
    }
    Ok(true)
}

/// Plant parameters: the defaults of machine and inverter, changed by keywords.
pub fn plant_params(
    machine: Machine,
    inverter: params::Inverter,
    options: Option<&Bound<'_, PyDict>>,
) -> PyResult<PlantParams> {
    changed(PlantParams::new(machine, inverter), options, ("the plant", OPTIONS), set, PlantParams::validate)
}

/// Stator resistance that a plant admits.
pub fn resistance(R_s: f64) -> PyResult<f64> {
    check_resistance(R_s).map_err(value_error)?;
    Ok(R_s)
}

/// Dc-link voltage that a plant admits.
pub fn dc_link(u_dc: f64) -> PyResult<f64> {
    check("u_dc", u_dc, 0.0, 10e3, "V").map_err(value_error)?;
    Ok(u_dc)
}

/// How an encoder fails, by name; `None`: it is whole.
pub fn encoder_fault(name: Option<&str>) -> PyResult<Option<EncoderFault>> {
    let faults = [
        ("broken", EncoderFault::Broken),
        ("channel", EncoderFault::Channel),
        ("swapped", EncoderFault::Swapped),
        ("silent", EncoderFault::Silent),
    ];
    let Some(name) = name else { return Ok(None) };
    let unknown = || PyValueError::new_err(format!("encoder = {name:?} is not one of {}, None", names_of(&faults)));
    found(name, &faults).map(Some).ok_or_else(unknown)
}

/// What the pulses of a step are.
const PULSES: &str = "three half widths before, three after the middle, two instants of the shunt";
/// Largest load, of rated torque.
const LOAD_MAX: f64 = 10.0;
/// Largest voltage at the terminals, relative to the rated one.
const VOLTAGE_MAX: f64 = 10.0;

/// Imposed speed that a plant admits.
pub fn shaft_speed(speed: Option<f64>) -> PyResult<Option<f64>> {
    check("speed", speed.unwrap_or(0.0), -1e5, 1e5, "rad/s").map_err(value_error)?;
    Ok(speed)
}

macro_rules! plant_state {
    (complex: $($(#[$zdoc:meta])* $z:ident,)* ; real: $($(#[$xdoc:meta])* $x:ident,)*) => {
        /// The true state of a plant at the end of the last period. Stator coordinates.
        #[pyclass(frozen, get_all, module = "stillflux")]
        pub struct PlantState {
            $($(#[$zdoc])* $z: Complex64,)*
            $($(#[$xdoc])* $x: f64,)*
        }

        #[pymethods]
        impl PlantState {
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
                format!("<PlantState {}>", fields(&complex, &real))
            }

            // Nothing of it changes: it is its own copy.
            fn __copy__(slf: Py<Self>) -> Py<Self> {
                slf
            }

            fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
                slf
            }
        }

        impl From<&Truth> for PlantState {
            fn from(t: &Truth) -> Self {
                Self { $($z: complex(t.$z),)* $($x: t.$x,)* }
            }
        }
    };
}

plant_state! {
    complex:
    /// Stator flux linkage, V·s.
    psi_s,
    /// Rotor flux linkage of the inverse-Γ circuit, V·s.
    psi_r,
    /// Stator current, A.
    i_s,
    /// Terminal voltage, mean of the last period, V.
    u_s,
    ;
    real:
    /// Time, s.
    t,
    /// Speed, mechanical rad/s.
    omega_m,
    /// Speed of psi_s, mean of the last period, electrical rad/s.
    omega_s,
    /// Shaft angle, not wrapped, mechanical rad.
    theta_m,
    /// Air-gap torque, N·m.
    torque,
    /// Load torque of the last period, N·m.
    load_torque,
    /// Stator resistance as it is now, without r_d, Ω.
    R_s,
    /// dc-link voltage, V.
    u_dc,
    /// Speed of the load, mechanical rad/s: omega_m without an elastic coupling.
    omega_load,
}

/// Induction machine, inverter, sensors and shaft, resolved at every switching edge.
///
/// Parameters
/// ----------
/// motor, inverter
///     The real machine and inverter. Without keywords: switching model, no friction, 12-bit converters
///     over ±2.5 √2 I_N, no measurement error.
/// **options
///     See `stillflux.options.PlantOptions`.
///
/// Raises ValueError for a value outside its range, TypeError for an unknown option.
#[pyclass(module = "stillflux")]
pub struct Plant {
    plant: stillflux_sim::Plant,
    speed: Option<f64>,
    current_offset: [f64; 3],
    load_max: f64,
    u_max: f64,
}

type Reading<'py> = (Bound<'py, PyArray1<f64>>, f64);

fn reading(py: Python<'_>, s: MeasurementSi) -> Reading<'_> {
    (PyArray1::from_slice(py, &s.i_abc), s.u_dc)
}

impl Plant {
    /// Admits a load: the shaft does not run away beyond what can be computed.
    fn load(&self, torque: f64) -> PyResult<f64> {
        check("load_torque", torque, -self.load_max, self.load_max, "N m").map_err(value_error)?;
        Ok(torque)
    }
}

#[pymethods]
impl Plant {
    #[new]
    #[pyo3(signature = (motor, inverter, **options))]
    fn new(
        motor: &Bound<'_, PyAny>,
        inverter: &Bound<'_, PyAny>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (machine, inverter) = (machine_of("motor", motor)?, inverter_of("inverter", inverter)?);
        let (load_max, u_max) = (LOAD_MAX * machine.T_N, VOLTAGE_MAX * machine.U_N);
        let params = plant_params(machine, inverter, options)?;
        let plant = stillflux_sim::Plant::new(params).map_err(value_error)?;
        for (name, chance) in [("missed_calls", params.calls.missed), ("doubled_calls", params.calls.doubled)] {
            if chance > 0.0 {
                return Err(PyValueError::new_err(format!(
                    "{name} = {chance} is an option of the plant of a scenario: who calls Plant.step leaves out or doubles calls \
                     of Drive.step"
                )));
            }
        }
        Ok(Self { plant, speed: params.mechanics.speed, current_offset: params.adc.offset, load_max, u_max })
    }

    /// Runs one PWM period and returns the reading at its end: i_abc in A, shape (3,), and u_dc in V.
    ///
    /// `duty` (three finite values, clamped to [0, 1]) acts in the *next* period, as from a modulator's preload
    /// register: the plant holds the one-period delay. `gates_on=False` blocks the bridge at once.
    /// `load_torque` in N·m, up to ten times the rated torque, opposes positive rotation and is active, as a
    /// crane's. `pulses`, of `Drive.pulses`, take the place of `duty`: with the option `shunt` the reading is that of the
    /// shunt at their two instants and at the end of the period, in A.
    #[pyo3(
        signature = (duty, load_torque=Given::NOTHING, gates_on=Given::NOTHING, pulses=None),
        text_signature = "($self, duty, load_torque=0.0, gates_on=True, pulses=None)"
    )]
    fn step<'py>(
        &mut self,
        duty: &Bound<'py, PyAny>,
        load_torque: Given<'py>,
        gates_on: Given<'py>,
        pulses: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Reading<'py>> {
        let (duties, load) = (three("duty", duty)?, self.load(load_torque.or("load_torque", 0.0)?)?);
        let gates_on = gates_on.or("gates_on", true)?;
        let pulses = match pulses {
            Some(given) => parts::<([f64; 3], [f64; 3], [f64; 2])>("pulses", given, PULSES)?,
            None => None,
        };
        for duty in duties {
            finite("duty", duty)?;
        }
        let s = match pulses {
            None => self.plant.step(duties, gates_on, load),
            Some((rising, falling, sample)) => {
                for instant in rising.iter().chain(&falling).chain(&sample) {
                    check("pulses", *instant, 0.0, 1.0, "periods").map_err(value_error)?;
                }
                self.plant.step_pulses(&Pulses { rising, falling, sample }, gates_on, load)
            }
        };
        Ok(reading(duty.py(), s))
    }

    /// Applies the constant voltage `u_s` (complex, V, up to ten times the rated voltage) to the terminals for `dt` seconds,
    /// at most 100, past the bridge.
    #[pyo3(signature = (u_s, dt, load_torque=Given::NOTHING), text_signature = "($self, u_s, dt, load_torque=0.0)")]
    fn step_voltage<'py>(
        &mut self,
        py: Python<'py>,
        u_s: &Bound<'py, PyAny>,
        dt: &Bound<'py, PyAny>,
        load_torque: Given<'py>,
    ) -> PyResult<()> {
        let (u_s, dt) = (extract::<Complex64>("u_s", u_s)?, extract("dt", dt)?);
        check("dt", dt, 1e-12, 100.0, "s").map_err(value_error)?;
        let u_s = [u_s.re, u_s.im];
        for part in u_s {
            check("u_s", part, -self.u_max, self.u_max, "V").map_err(value_error)?;
        }
        let load_torque = self.load(load_torque.or("load_torque", 0.0)?)?;
        py.detach(|| self.plant.step_voltage(u_s, dt, load_torque));
        Ok(())
    }

    /// A reading now: i_abc in A, shape (3,), and u_dc in V. Every call draws fresh noise.
    fn sample<'py>(&mut self, py: Python<'py>) -> Reading<'py> {
        reading(py, self.plant.sample())
    }

    /// The truth.
    #[getter]
    fn state(&self) -> PlantState {
        self.plant.truth().into()
    }

    /// Puts the machine into a state: stator and inverse-Γ rotor flux (complex, V·s), mechanical rad/s.
    ///
    /// Raises ValueError for another speed than the one that is imposed, and for a flux or a speed that the equations'
    /// longest step cannot follow.
    fn set_state(
        &mut self,
        psi_s: &Bound<'_, PyAny>,
        psi_r: &Bound<'_, PyAny>,
        omega_m: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let flux = |name, value| finite_parts(name, extract(name, value)?);
        let (psi_s, psi_r, omega_m) = (flux("psi_s", psi_s)?, flux("psi_r", psi_r)?, extract("omega_m", omega_m)?);
        self.plant.set_state(psi_s, psi_r, omega_m).map_err(value_error)
    }

    /// Resistance of the cold winding, Ω.
    #[getter]
    fn R_s(&self) -> f64 {
        self.plant.params().machine.R_s
    }

    #[setter]
    fn set_R_s(&mut self, R_s: &Bound<'_, PyAny>) -> PyResult<()> {
        self.plant.set_R_s(resistance(extract("R_s", R_s)?)?);
        Ok(())
    }

    /// Position of the encoder (option `encoder_lines`) at the instant of the latest reading, counts, four a line; None
    /// without one.
    #[getter]
    fn encoder(&self) -> Option<i64> {
        self.plant.encoder()
    }

    /// Imposed shaft speed, mechanical rad/s; None: the shaft is free.
    #[getter]
    fn speed(&self) -> Option<f64> {
        self.speed
    }

    #[setter]
    fn set_speed(&mut self, speed: &Bound<'_, PyAny>) -> PyResult<()> {
        self.speed = shaft_speed(extract("speed", speed)?)?;
        self.plant.set_speed(self.speed);
        Ok(())
    }

    /// Offsets of the current channels as last set, A; takes a complex space vector or three values.
    #[getter]
    fn current_offset(&self) -> (f64, f64, f64) {
        self.current_offset.into()
    }

    #[setter]
    fn set_current_offset(&mut self, offset: &Bound<'_, PyAny>) -> PyResult<()> {
        let offset = offsets("current_offset", offset)?;
        self.plant.params().adc.check_offset(&offset).map_err(value_error)?;
        self.current_offset = offset;
        self.plant.set_offset(offset);
        Ok(())
    }

    /// dc-link voltage, V.
    #[getter]
    fn u_dc(&self) -> f64 {
        self.plant.truth().u_dc
    }

    #[setter]
    fn set_u_dc(&mut self, u_dc: &Bound<'_, PyAny>) -> PyResult<()> {
        self.plant.set_u_dc(dc_link(extract("u_dc", u_dc)?)?);
        Ok(())
    }

    fn __repr__(&self) -> String {
        let truth = self.plant.truth();
        format!("<Plant: {}>", fields(&[], &[("t", truth.t), ("omega_m", truth.omega_m), ("torque", truth.torque)]))
    }
}
