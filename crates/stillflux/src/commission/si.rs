//! A commissioning of any arithmetic with SI inputs and outputs, for hosts: the procedures at standstill, and with a free
//! shaft a run of the drive that they have found parameters for.

use super::inertia::{Inertia, InertiaConfig};
use super::{Cause, Commissioning, CommissioningConfig, Found, Nameplate, Stage, Status};
use crate::base::PerUnit;
use crate::config::DriveParams;
use crate::drive;
use crate::params::{Inverter, Machine, ParamError};
use crate::scalar::{Q, Real};
use crate::si::{Arithmetic, MeasurementSi, ReferenceSi, SiDrive, SiUnits};

/// Standard deviation of the inertia by the error of the estimated torque: what drawn machines show.
const TORQUE_ERROR: f64 = 0.06;

/// Whether the shaft may turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shaft {
    /// Standstill procedures only.
    #[default]
    Locked,
    /// Then a run to three tenths of rated speed.
    Free,
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)]
enum Standstill {
    F32(Commissioning<f32>),
    F64(Commissioning<f64>),
    Q(Commissioning<Q>),
}

/// Runs `$body` with `$x` bound to the commissioning, whatever its arithmetic.
macro_rules! with {
    ($standstill:expr, $x:ident => $body:expr) => {
        match $standstill {
            Standstill::F32($x) => $body,
            Standstill::F64($x) => $body,
            Standstill::Q($x) => $body,
        }
    };
}

/// The run with a free shaft.
#[derive(Clone, Debug)]
struct FreeRun {
    drive: SiDrive,
    config: InertiaConfig<f64>,
    inertia: Inertia<f64>,
    /// `ω_m` and torque of one per unit, and the bases' inertia.
    bases: [f64; 3],
    /// Periods of the run.
    periods: u32,
    over: bool,
    /// Over since the user ended it.
    aborted: bool,
}

/// A commissioning with SI inputs and outputs.
#[derive(Clone, Debug)]
pub struct SiCommissioning {
    units: SiUnits,
    arithmetic: Arithmetic,
    shaft: Shaft,
    sensors: u32,
    standstill: Standstill,
    run: Option<FreeRun>,
    /// The run could not be begun: what was found is no machine that a drive accepts.
    refused: bool,
}

impl SiCommissioning {
    /// Before its first period.
    ///
    /// # Errors
    /// The first value of nameplate or inverter outside its admissible range.
    pub fn new(
        plate: &Nameplate,
        inverter: &Inverter,
        shaft: Shaft,
        arithmetic: Arithmetic,
    ) -> Result<Self, ParamError> {
        let standstill = match arithmetic {
            Arithmetic::F32 => Standstill::F32(Commissioning::new(CommissioningConfig::new(plate, inverter)?)),
            Arithmetic::F64 => Standstill::F64(Commissioning::new(CommissioningConfig::new(plate, inverter)?)),
            Arithmetic::Q => Standstill::Q(Commissioning::new(CommissioningConfig::new(plate, inverter)?)),
        };
        let units = with!(&standstill, x => SiUnits::new(&x.config().machine, &x.config().sheet));
        Ok(Self { units, arithmetic, shaft, sensors: 3, standstill, run: None, refused: false })
    }

    /// Number of current sensors ([`CommissioningConfig::current_sensors`]), before its first period.
    ///
    /// # Errors
    /// A number other than 2 and 3.
    pub fn current_sensors(mut self, sensors: u32) -> Result<Self, ParamError> {
        with!(&mut self.standstill, x => *x = Commissioning::new(x.config().current_sensors(sensors)?));
        Ok(Self { sensors, ..self })
    }

    /// One procedure alone ([`CommissioningConfig::only`]), before its first period; [`Stage::Complete`]: that of the free
    /// shaft, by a drive that is told nameplate and data sheet.
    #[must_use]
    pub fn only(mut self, stage: Stage) -> Self {
        with!(&mut self.standstill, x => *x = Commissioning::new(x.config().only(stage)));
        let shaft = if stage == Stage::Complete { self.shaft } else { Shaft::Locked };
        Self { shaft, ..self }
    }

    /// The machine by its nameplate.
    #[must_use]
    pub fn machine(&self) -> &Machine {
        with!(&self.standstill, x => x.config().machine())
    }

    /// One control period: measurement in, duties and gate signal out. The timing is that of [`SiDrive::step`].
    pub fn step(&mut self, measured: &MeasurementSi) -> ([f64; 3], bool) {
        if let Some(run) = &mut self.run {
            return run.step(measured);
        }
        let units = &self.units;
        let (out, status) = with!(&mut self.standstill, x => {
            let out = x.step(&units.measurement(measured));
            ((out.duty.map(Real::to_f64), out.gates_on), x.status())
        });
        if status == Status::Done && self.shaft == Shaft::Free && !self.refused {
            self.run = self.begin();
            self.refused = self.run.is_none();
        }
        out
    }

    /// The drive for the run, with what was found at standstill.
    fn begin(&self) -> Option<FreeRun> {
        let found = self.at_standstill().ok()?;
        let (m, inv) = (&found.machine, &found.inverter);
        let pu = PerUnit::new(m, inv).ok()?;
        let params = DriveParams { current_sensors: self.sensors, ..DriveParams::new(m, inv) };
        let drive = SiDrive::new(m, inv, &params, self.arithmetic).ok()?;
        let b = pu.base;
        Some(FreeRun {
            drive,
            config: InertiaConfig::new(pu.torque_rated, pu.t_s, inv.f_c()),
            inertia: Inertia::new(),
            bases: [b.omega_m, b.torque, b.torque / (b.omega_m * b.omega)],
            periods: 0,
            over: false,
            aborted: false,
        })
    }

    /// Blocks the gates for good; what has been found stays.
    pub fn abort(&mut self) {
        match &mut self.run {
            // What ended before is not ended by this.
            Some(run) => {
                run.aborted |= !run.over;
                run.over = true;
            }
            None => with!(&mut self.standstill, x => x.abort()),
        }
    }

    /// State of the whole.
    #[must_use]
    pub fn status(&self) -> Status {
        let standstill = with!(&self.standstill, x => x.status());
        match (&self.run, standstill) {
            (Some(run), Status::Done) if !run.over => Status::Running,
            (Some(FreeRun { aborted: true, periods, .. }), _) => {
                let before = with!(&self.standstill, x => x.period());
                Status::Faulted { cause: Cause::Aborted, period: before.saturating_add(*periods) }
            }
            _ => standstill,
        }
    }

    /// Cause of the fault, if there is one.
    #[must_use]
    pub fn cause(&self) -> Option<Cause> {
        match self.status() {
            Status::Faulted { cause, .. } => Some(cause),
            _ => None,
        }
    }

    /// Name of the procedure under way.
    #[must_use]
    pub fn stage(&self) -> &'static str {
        match with!(&self.standstill, x => x.stage()) {
            Stage::Wiring => "wiring",
            Stage::Bridge => "bridge",
            Stage::Legs => "legs",
            Stage::Leakage => "leakage",
            Stage::Magnetising => "magnetising",
            Stage::Complete if self.status() == Status::Running => "inertia",
            Stage::Complete => "complete",
        }
    }

    /// Part that is over, 0 to 1.
    #[must_use]
    pub fn progress(&self) -> f64 {
        let standstill = with!(&self.standstill, x => x.progress());
        match (self.shaft, &self.run) {
            (Shaft::Locked, _) => standstill,
            (Shaft::Free, None) => 0.8 * standstill,
            (Shaft::Free, Some(run)) => 0.8 + 0.2 * if run.over { 1.0 } else { run.inertia.progress() },
        }
    }

    fn at_standstill(&self) -> Result<Found, ParamError> {
        with!(&self.standstill, x => x.result())
    }

    /// Voltage and current of the levels of the bridge that were read, and the voltage of the fit: V, A, V.
    #[must_use]
    pub fn bridge_readings(&self) -> [Option<[f64; 3]>; super::BRIDGE_LEVELS.len()] {
        let b = self.units.base();
        with!(&self.standstill, x => x.bridge_readings().map(|r| r.map(|[u, i, f]| [u * b.u, i * b.i, f * b.u])))
    }

    /// What has been found so far, with the inertia of the run.
    ///
    /// # Errors
    /// A value found that no machine or inverter can have.
    pub fn result(&self) -> Result<Found, ParamError> {
        let mut found = self.at_standstill()?;
        if let Some(run) = &self.run {
            match run.inertia.found(&run.config) {
                Some(x) => {
                    found.machine.J = x.j * run.bases[2];
                    found.friction = Some(x.friction * run.bases[1]);
                    found.deviation.J = libm::hypot(TORQUE_ERROR, found.deviation.L_M);
                    found.machine.validate()?;
                }
                None => found.warnings.no_inertia = run.over,
            }
        }
        found.warnings.no_inertia |= self.refused;
        Ok(found)
    }
}

impl FreeRun {
    fn step(&mut self, measured: &MeasurementSi) -> ([f64; 3], bool) {
        let [omega, torque, _] = self.bases;
        let reference = if self.over {
            ReferenceSi::Stop
        } else if self.drive.status() == drive::Status::Running {
            let e = self.drive.estimate();
            match self.inertia.step(&self.config, e.omega_m / omega, e.torque / torque) {
                drive::Reference::Torque(t) => ReferenceSi::Torque(t * torque),
                _ => ReferenceSi::Stop,
            }
        } else {
            ReferenceSi::Torque(0.0)
        };
        let out = self.drive.step(measured, &reference);
        let faulted = matches!(self.drive.status(), drive::Status::Faulted { .. });
        self.periods = self.periods.saturating_add(1);
        self.over |= faulted || self.inertia.is_over();
        if self.over { ([0.5; 3], false) } else { out }
    }
}
