//! Closed loop: a drive on a plant, references and load from profiles, signals into columns.
//!
//! The drive sees what the ADC delivers and nothing else. Truth and estimate are recorded apart:
//! truth under the plain name (`omega_m`), the drive's view under `estimate.`; what links the two
//! (`angle_error`, `drift`) is computed from plant truth.

use std::borrow::Cow;
use std::fmt;

use stillflux::config::DriveParams;
use stillflux::control::shunt::Pulses;
use stillflux::params::{Inverter, Machine, ParamError, check, check_resistance};

use crate::adc::ChannelFault;
use crate::encoder::EncoderFault;
use crate::mechanics::Mechanics;
use crate::plant::{Calls, Mode, Plant, PlantParams};
use crate::rng::Rng;
use stillflux::si::{Arithmetic, EstimateSi, MeasurementSi, MemorySi, ReferenceSi, SiDrive, Vector};
use stillflux::space::AlphaBeta;

/// Piecewise linear function of time; two points at one time make a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    points: Vec<(f64, f64)>,
}

impl Profile {
    /// A constant.
    #[must_use]
    pub fn constant(value: f64) -> Self {
        Self { points: vec![(0.0, value)] }
    }

    /// Through points `(t, value)` with `t` ascending; constant before the first and after the last.
    ///
    /// # Errors
    /// A time that is below the one before it, or a value that is not finite.
    pub fn new(points: Vec<(f64, f64)>) -> Result<Self, ParamError> {
        let mut last = f64::MIN;
        for &(t, value) in &points {
            check("profile time", t, last, 1e9, "s")?;
            check("profile value", value, -1e9, 1e9, "")?;
            last = t;
        }
        Ok(Self { points })
    }

    /// Value at `t`; `from` remembers the segment, since time only advances.
    fn at(&self, t: f64, from: &mut usize) -> f64 {
        let p = &self.points;
        if p.is_empty() {
            return 0.0;
        }
        while *from + 1 < p.len() && p[*from + 1].0 <= t {
            *from += 1;
        }
        let (t0, v0) = p[*from];
        match p.get(*from + 1) {
            Some(&(t1, v1)) if t > t0 => v0 + (v1 - v0) * (t - t0) / (t1 - t0),
            _ => v0,
        }
    }
}

/// What a reference profile is of.
#[derive(Clone, Debug, PartialEq)]
pub enum ReferenceProfile {
    /// Mechanical speed, rad/s.
    Speed(Profile),
    /// Torque, N·m.
    Torque(Profile),
}

/// Something that happens during a run, to the plant or to the drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// Stator resistance at its reference temperature, Ω.
    StatorResistance(f64),
    /// Rotor resistance of the inverse-Γ circuit at its reference temperature, Ω.
    RotorResistance(f64),
    /// Offsets of the current channels, A.
    CurrentOffset([f64; 3]),
    /// dc-link voltage, V; of a link with a capacitor that of its supply.
    DcLink(f64),
    /// Imposed shaft speed, rad/s, or free again.
    Speed(Option<f64>),
    /// A phase (0 to 2) that is disconnected from its leg.
    OpenPhase(usize),
    /// A current channel (0 to 2) that fails, or a single sample that is wrong.
    Channel(usize, ChannelFault),
    /// An encoder that fails, or is healed.
    Encoder(Option<EncoderFault>),
    /// The drive is told to stop, or to follow its reference again.
    Stop(bool),
    /// The drive is told to leave a fault.
    Reset,
}

impl Change {
    /// Checks what changes against its range and against what the plant has.
    fn check(&self, plant: &PlantParams) -> Result<(), ParamError> {
        match self {
            Self::CurrentOffset(offset) => plant.adc.check_offset(offset),
            Self::StatorResistance(value) => check_resistance(*value),
            Self::DcLink(value) => check("u_dc", *value, 0.0, 10e3, "V"),
            Self::Speed(value) => Mechanics { speed: *value, ..plant.mechanics }.validate(&plant.machine),
            Self::RotorResistance(value) => {
                PlantParams { machine: Machine { R_R: *value, ..plant.machine }, ..*plant }.validate()
            }
            Self::Channel(channel, fault) => fault.validate(*channel),
            Self::OpenPhase(phase) => {
                let phases = if plant.mode == Mode::Switching { 2.0 } else { -1.0 };
                check("open_phase", *phase as f64, 0.0, phases, "").map_err(|e| e.with_note("in the switching model"))
            }
            Self::Encoder(_) => {
                let lines = plant.encoder.map_or(0.0, |e| f64::from(e.lines));
                check("encoder_lines", lines, 1.0, f64::INFINITY, "")
                    .map_err(|e| e.with_note("an encoder that fails or heals has to be there"))
            }
            Self::Stop(_) | Self::Reset => Ok(()),
        }
    }
}

/// A closed-loop experiment.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Machine as the drive knows it.
    pub machine: Machine,
    /// Inverter as the drive knows it.
    pub inverter: Inverter,
    /// Settings of the drive.
    pub drive: DriveParams,
    /// Arithmetic of the drive.
    pub arithmetic: Arithmetic,
    /// The real machine, inverter, sensors and shaft.
    pub plant: PlantParams,
    /// Reference.
    pub reference: ReferenceProfile,
    /// Load torque, N·m.
    pub load: Profile,
    /// Changes, ascending in time.
    pub changes: Vec<(f64, Change)>,
    /// Duration, s.
    pub duration: f64,
    /// Record every so many control periods.
    pub record_every: u32,
    /// Signals to record; `None`: all of [`SIGNALS`].
    pub signals: Option<Vec<String>>,
    /// What an earlier run stored.
    pub memory: Option<MemorySi>,
    /// Whether every call carries the stamp of its PWM period.
    pub cycle_stamps: bool,
}

impl Scenario {
    /// Speed zero, no load, drive and plant with the same parameters.
    #[must_use]
    pub fn new(machine: Machine, inverter: Inverter, duration: f64) -> Self {
        Self {
            drive: DriveParams::new(&machine, &inverter),
            plant: PlantParams::new(machine, inverter),
            machine,
            inverter,
            arithmetic: Arithmetic::default(),
            reference: ReferenceProfile::Speed(Profile::constant(0.0)),
            load: Profile::constant(0.0),
            changes: Vec::new(),
            duration,
            record_every: 10,
            signals: None,
            memory: None,
            cycle_stamps: false,
        }
    }
}

/// One moment of a run: what the signals are taken from.
struct Moment<'a> {
    plant: &'a Plant,
    estimate: EstimateSi,
    drive: &'a SiDrive,
    measured: Vector,
    u_dc: f64,
    reference: f64,
    drift: Vector,
}

/// Value of a signal.
enum Value {
    Real(f64),
    Complex(Vector),
}

/// Definition of a recordable signal.
pub struct Signal {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    get: fn(&Moment<'_>) -> Value,
}

macro_rules! signals {
    ($($name:literal, $unit:literal, $kind:ident, |$m:ident| $e:expr;)*) => {
        /// All signals a run can record.
        pub const SIGNALS: &[Signal] = &[$(Signal { name: $name, unit: $unit, get: |$m| Value::$kind($e) },)*];
    };
}

signals! {
    "psi_s", "V s", Complex, |m| m.plant.truth().psi_s;
    "psi_r", "V s", Complex, |m| m.plant.truth().psi_r;
    "i_s", "A", Complex, |m| m.plant.truth().i_s;
    "u_s", "V", Complex, |m| m.plant.truth().u_s;
    "omega_m", "rad/s", Real, |m| m.plant.truth().omega_m;
    "omega_s", "rad/s", Real, |m| m.plant.truth().omega_s;
    "torque", "N m", Real, |m| m.plant.truth().torque;
    "load_torque", "N m", Real, |m| m.plant.truth().load_torque;
    "omega_load", "rad/s", Real, |m| m.plant.truth().omega_load;
    "R_s", "ohm", Real, |m| m.plant.truth().R_s;
    "u_dc", "V", Real, |m| m.plant.truth().u_dc;
    "angle_error", "rad", Real, |m| angle_between(&m.plant.truth().psi_s, &m.estimate.psi_s);
    "drift", "V s", Complex, |m| m.drift;
    "measured.i_s", "A", Complex, |m| m.measured;
    "reference", "rad/s or N m", Real, |m| m.reference;
    "estimate.psi_s", "V s", Complex, |m| m.estimate.psi_s;
    "estimate.psi_r", "V s", Complex, |m| m.estimate.psi_r;
    "estimate.psi_1", "V s", Complex, |m| m.estimate.psi_1;
    "estimate.i_s", "A", Complex, |m| m.estimate.i_s;
    "estimate.u_s", "V", Complex, |m| m.estimate.u_s;
    "estimate.u_off", "V", Complex, |m| m.estimate.u_off;
    "estimate.u_hf", "V", Complex, |m| m.estimate.u_hf;
    "estimate.i_dq", "A", Complex, |m| m.estimate.i_dq;
    "estimate.i_dq_ref", "A", Complex, |m| m.estimate.i_dq_ref;
    "estimate.omega_m", "rad/s", Real, |m| m.estimate.omega_m;
    "estimate.omega_s", "rad/s", Real, |m| m.estimate.omega_s;
    "estimate.omega_r", "rad/s", Real, |m| m.estimate.omega_r;
    "estimate.torque", "N m", Real, |m| m.estimate.torque;
    "estimate.R_s", "ohm", Real, |m| m.estimate.R_s;
    "estimate.R_R", "ohm", Real, |m| m.estimate.R_R;
    "estimate.epsilon", "p.u.", Real, |m| m.estimate.epsilon;
    "estimate.innovation", "V s", Real, |m| m.estimate.innovation;
    "estimate.nis", "", Real, |m| m.estimate.nis;
    "estimate.angle_deviation", "rad", Real, |m| m.estimate.angle_deviation;
    "estimate.confidence", "", Real, |m| m.estimate.confidence;
    "estimate.speed_gain", "", Real, |m| m.estimate.speed_gain;
    "encoder.omega_m", "rad/s", Real, |m| m.drive.encoder().unwrap_or_default().omega_m;
    "encoder.difference", "rad/s", Real, |m| m.drive.encoder().unwrap_or_default().difference;
    "encoder.state", "", Real, |m| f64::from(m.drive.encoder().unwrap_or_default().state.code());
    "chopper", "", Real, |m| m.drive.chopper(m.u_dc);
    "status", "", Real, |m| f64::from(m.drive.status().code());
}

/// Angle from `a` to `b`, rad.
fn angle_between(a: &Vector, b: &Vector) -> f64 {
    libm::atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
}

/// One recorded signal.
#[derive(Clone, Debug)]
pub struct Column {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Complex signals hold real and imaginary parts in turn.
    pub complex: bool,
    /// The samples.
    pub data: Vec<f64>,
}

/// What a run has recorded so far.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Time of each row, s.
    pub t: Vec<f64>,
    /// The signals.
    pub columns: Vec<Column>,
}

/// Rows of a record for which room is made at the start.
const MOST_ROWS: u64 = 1 << 18;

/// Tells the chance of the control's calls from the sensors' noise of the same seed.
const CALLS: u64 = 0x0063_616c_6c73;

/// What is wrong with a scenario.
#[derive(Clone, Debug, PartialEq)]
pub enum ScenarioError {
    /// A parameter outside its admissible range.
    Param(ParamError),
    /// A name that is none of [`SIGNALS`].
    UnknownSignal(String),
}

impl ScenarioError {
    /// The field that is wrong.
    #[must_use]
    pub fn field(&self) -> &'static str {
        match self {
            Self::Param(e) => e.field,
            Self::UnknownSignal(_) => "signals",
        }
    }
}

impl From<ParamError> for ScenarioError {
    fn from(e: ParamError) -> Self {
        Self::Param(e)
    }
}

impl fmt::Display for ScenarioError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Param(e) => e.fmt(f),
            Self::UnknownSignal(name) => {
                let known: Vec<_> = SIGNALS.iter().map(|s| s.name).collect();
                write!(f, "signals: {name:?} is not one of {}", known.join(", "))
            }
        }
    }
}

impl std::error::Error for ScenarioError {}

/// A run in progress: advance it in pieces, look at the record any time.
pub struct Run<'s> {
    scenario: Cow<'s, Scenario>,
    plant: Plant,
    drive: SiDrive,
    getters: Vec<fn(&Moment<'_>) -> Value>,
    record: Record,
    sample: MeasurementSi,
    /// What the drive last asked for, and the chance of its next call.
    duty: [f64; 3],
    pulses: Option<Pulses<f64>>,
    gates_on: bool,
    chance: Rng,
    period: u64,
    periods: u64,
    reference_at: usize,
    load_at: usize,
    next_change: usize,
    stopped: bool,
    u_i_integral: Vector,
    psi_begin: Option<Vector>,
}

impl<'s> Run<'s> {
    /// Prepares a run.
    ///
    /// # Errors
    /// The first parameter outside its admissible range, or the first unknown signal.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(scenario: Cow<'s, Scenario>) -> Result<Self, ScenarioError> {
        let s = &*scenario;
        // Without a period there is no sample of which anything could be said.
        check("duration", s.duration, 1.0 / s.inverter.f_c(), 1e5, "s")
            .map_err(|e| e.with_note("one control period at least"))?;
        check("record_every", f64::from(s.record_every), 1.0, 1e9, "periods")?;
        s.plant.check_period(&s.inverter)?;
        let mut last = 0.0;
        for (t, change) in &s.changes {
            check("changes time", *t, last, 1e9, "s")?;
            last = *t;
            change.check(&s.plant)?;
        }
        let sensors = if s.plant.shunt.is_some() { (1.0, 1.0) } else { (2.0, 3.0) };
        check("current_sensors", f64::from(s.drive.current_sensors), sensors.0, sensors.1, "")
            .map_err(|e| e.with_note("1 is for a plant with shunt, and for no other"))?;
        let mut plant = Plant::new(s.plant)?;
        let mut drive = SiDrive::new(&s.machine, &s.inverter, &s.drive, s.arithmetic)?;
        if let Some(m) = &s.memory {
            m.validate(&s.machine, &s.inverter)?;
            drive.restore(m);
        }
        let sample = plant.sample();
        let chosen: Vec<&Signal> = match &s.signals {
            None => SIGNALS.iter().collect(),
            Some(names) => names
                .iter()
                .map(|name| {
                    SIGNALS.iter().find(|s| s.name == name).ok_or_else(|| ScenarioError::UnknownSignal(name.clone()))
                })
                .collect::<Result<_, _>>()?,
        };
        let periods = (s.duration * s.inverter.f_c()).round() as u64;
        // A run that goes on for long has its record taken as it goes.
        let rows = (periods / u64::from(s.record_every) + 1).min(MOST_ROWS) as usize;
        let mut run = Self {
            plant,
            drive,
            getters: chosen.iter().map(|s| s.get).collect(),
            record: Record { t: Vec::with_capacity(rows), columns: Vec::new() },
            sample,
            duty: [0.5; 3],
            pulses: None,
            gates_on: false,
            chance: Rng::new(s.plant.seed ^ CALLS),
            period: 0,
            periods,
            reference_at: 0,
            load_at: 0,
            next_change: 0,
            stopped: false,
            u_i_integral: [0.0; 2],
            psi_begin: None,
            scenario,
        };
        let moment = run.moment(0.0);
        let columns = chosen
            .iter()
            .map(|s| {
                let complex = matches!((s.get)(&moment), Value::Complex(_));
                let data = Vec::with_capacity(if complex { 2 * rows } else { rows });
                Column { name: s.name, unit: s.unit, complex, data }
            })
            .collect();
        run.record.columns = columns;
        Ok(run)
    }

    /// Runs at most `periods` further control periods; `false` when the run is complete.
    pub fn advance(&mut self, periods: u64) -> bool {
        let until = self.periods.min(self.period.saturating_add(periods));
        while self.period < until {
            self.step();
        }
        self.period < self.periods
    }

    /// Simulated time so far, s.
    #[must_use]
    #[allow(clippy::cast_precision_loss)]
    pub fn time(&self) -> f64 {
        self.period as f64 / self.scenario.inverter.f_c()
    }

    /// The plant.
    #[must_use]
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The drive.
    #[must_use]
    pub fn drive(&self) -> &SiDrive {
        &self.drive
    }

    /// The record so far.
    #[must_use]
    pub fn record(&self) -> &Record {
        &self.record
    }

    /// Takes the record so far out of the run, which goes on with an empty one.
    pub fn take_record(&mut self) -> Record {
        let columns = self.record.columns.iter().map(|c| Column { data: Vec::new(), ..*c }).collect();
        std::mem::replace(&mut self.record, Record { t: Vec::new(), columns })
    }

    /// The plant, for changes beside those of the scenario.
    pub fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// Another reference from now on; its profile is over the time of the run.
    pub fn set_reference(&mut self, reference: ReferenceProfile) {
        self.scenario.to_mut().reference = reference;
        self.reference_at = 0;
    }

    /// Another load from now on, N·m; its profile is over the time of the run.
    pub fn set_load(&mut self, load: Profile) {
        self.scenario.to_mut().load = load;
        self.load_at = 0;
    }

    /// Ends the run: record and drive.
    #[must_use]
    pub fn into_parts(self) -> (Record, SiDrive) {
        (self.record, self.drive)
    }

    fn step(&mut self) {
        let t = self.time();
        while let Some(&(when, change)) = self.scenario.changes.get(self.next_change) {
            if when > t {
                break;
            }
            self.next_change += 1;
            match change {
                Change::StatorResistance(r) => self.plant.set_R_s(r),
                Change::RotorResistance(r) => self.plant.set_R_R(r),
                Change::CurrentOffset(o) => self.plant.set_offset(o),
                Change::DcLink(u) => self.plant.set_u_dc(u),
                Change::Speed(w) => self.plant.set_speed(w),
                Change::OpenPhase(k) => self.plant.set_open_phase(k, true),
                Change::Channel(k, fault) => self.plant.set_channel(k, Some(fault)),
                Change::Encoder(fault) => self.plant.set_encoder(fault),
                Change::Stop(stopped) => self.stopped = stopped,
                Change::Reset => self.drive.reset(),
            }
        }
        let (mut command, reference) = match &self.scenario.reference {
            ReferenceProfile::Speed(p) => {
                let w = p.at(t, &mut self.reference_at);
                (ReferenceSi::Speed(w), w)
            }
            ReferenceProfile::Torque(p) => {
                let x = p.at(t, &mut self.reference_at);
                (ReferenceSi::Torque(x), x)
            }
        };
        if self.stopped {
            command = ReferenceSi::Stop;
        }
        if let Some(position) = self.plant.encoder() {
            self.drive.set_encoder(position);
        }
        for _ in 0..self.calls() {
            let out = if self.scenario.cycle_stamps {
                self.drive.step_at(self.period as u16, &self.sample, &command)
            } else {
                Some(self.drive.step(&self.sample, &command))
            };
            if let Some(out) = out {
                (self.duty, self.gates_on) = out;
                self.pulses = self.drive.pulses();
                self.book_drift();
            }
        }
        if self.period.is_multiple_of(u64::from(self.scenario.record_every)) {
            self.write_row(t, reference);
        }
        let load = self.scenario.load.at(t, &mut self.load_at);
        self.plant.set_chopper(self.drive.chopper(self.sample.u_dc));
        self.sample = match &self.pulses {
            None => self.plant.step(self.duty, self.gates_on, load),
            Some(pulses) => self.plant.step_pulses(pulses, self.gates_on, load),
        };
        self.period += 1;
    }

    /// How often the control is called this period.
    fn calls(&mut self) -> u32 {
        let Calls { missed, doubled } = self.scenario.plant.calls;
        if missed + doubled == 0.0 {
            return 1;
        }
        match self.chance.uniform() {
            x if x < missed => 0,
            x if x < missed + doubled => 2,
            _ => 1,
        }
    }

    /// `∫ û_i dt - ψ_s` since the drive runs: its slope is the offset voltage the drive really has to find.
    fn book_drift(&mut self) {
        let Some(u_i) = self.drive.induced_voltage() else { return };
        let t_s = 1.0 / self.scenario.inverter.f_c();
        self.psi_begin.get_or_insert(self.plant.truth().psi_s);
        for k in 0..2 {
            self.u_i_integral[k] += u_i[k] * t_s;
        }
    }

    fn moment(&self, reference: f64) -> Moment<'_> {
        let psi = self.plant.truth().psi_s;
        let begin = self.psi_begin.unwrap_or(psi);
        Moment {
            plant: &self.plant,
            estimate: self.drive.estimate(),
            drive: &self.drive,
            measured: AlphaBeta::from_phases(self.sample.i_abc).into(),
            u_dc: self.sample.u_dc,
            reference,
            drift: [0, 1].map(|k| self.u_i_integral[k] - (psi[k] - begin[k])),
        }
    }

    fn write_row(&mut self, t: f64, reference: f64) {
        let moment = self.moment(reference);
        let values: Vec<Value> = self.getters.iter().map(|get| get(&moment)).collect();
        self.record.t.push(t);
        for (column, value) in self.record.columns.iter_mut().zip(values) {
            match value {
                Value::Real(x) => column.data.push(x),
                Value::Complex(v) => column.data.extend_from_slice(&v),
            }
        }
    }
}
