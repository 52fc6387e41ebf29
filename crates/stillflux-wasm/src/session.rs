//! A closed loop whose set points and installation change while it runs.
//!
//! The drive keeps the parameters of the machine's data sheet; what is [`set`](Session::set) of resistance, dead time,
//! capacitance and sensor offset is the real installation. A brake holds the shaft and no load acts until the drive runs,
//! and again once it has stopped with a fault.

use std::borrow::Cow;

use stillflux::config::{DriveParams, Scheme};
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine, ParamError, check};
use stillflux_sim::simulate::{Profile, Record, ReferenceProfile, Run, Scenario, ScenarioError};

/// What is recorded: names of [`stillflux_sim::simulate::SIGNALS`].
pub const SIGNALS: [&str; 18] = [
    "psi_s",
    "estimate.psi_s",
    "i_s",
    "omega_m",
    "estimate.omega_m",
    "reference",
    "omega_s",
    "estimate.omega_s",
    "torque",
    "estimate.torque",
    "load_torque",
    "R_s",
    "estimate.R_s",
    "estimate.u_off",
    "angle_error",
    "estimate.angle_deviation",
    "estimate.confidence",
    "status",
];

/// Longest run, s.
const DURATION: f64 = 1e5;
/// Time in which the speed reference changes by the rated speed, s.
const RAMP: f64 = 1.0;
/// Noise of the current channels, part of the rated current.
const NOISE: f64 = 0.004;
/// Speed at which the overspeed trip of the installation stops the run, in units of the synchronous speed.
const OVERSPEED: f64 = 2.5;

/// A machine with its inverter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Installation {
    /// Name for the page.
    pub name: &'static str,
    /// The machine, as its data sheet has it.
    pub machine: Machine,
    /// The bridge, likewise.
    pub inverter: Inverter,
}

impl Installation {
    /// Those the page offers.
    #[must_use]
    pub fn all() -> [Self; 2] {
        [
            Self { name: "2.2 kW", machine: Machine::preset_2k2(), inverter: Inverter::preset_2k2() },
            Self { name: "11 kW", machine: Machine::preset_11k(), inverter: Inverter::preset_11k() },
        ]
    }

    /// Synchronous mechanical speed, rad/s.
    #[must_use]
    pub fn rated_speed(&self) -> f64 {
        self.machine.omega_sR() / f64::from(self.machine.n_p)
    }
}

/// What can be set while the drive runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// Reference of the mechanical speed, rad/s.
    Speed,
    /// Load torque, N·m; acts once the drive runs.
    Load,
    /// Offset of the current channel of phase a, A.
    Offset,
    /// Resistance of the stator winding, Ω.
    StatorResistance,
    /// Dead time of the bridge, s.
    DeadTime,
    /// Capacitance of a leg's node, F.
    Capacitance,
}

/// Range of a setting, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// Value at the start: what the drive assumes.
    pub default: f64,
}

impl Setting {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 6] =
        [Self::Speed, Self::Load, Self::Offset, Self::StatorResistance, Self::DeadTime, Self::Capacitance];

    /// Name as it is said in errors, and unit.
    #[must_use]
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Speed => ("speed", "rad/s"),
            Self::Load => ("load", "N m"),
            Self::Offset => ("offset", "A"),
            Self::StatorResistance => ("R_s", "ohm"),
            Self::DeadTime => ("dead_time", "s"),
            Self::Capacitance => ("c_out", "F"),
        }
    }

    /// Range for an installation.
    #[must_use]
    pub fn range(self, of: &Installation) -> Range {
        let (m, inv) = (&of.machine, &of.inverter);
        let symmetric = |max: f64| Range { min: -max, max, default: 0.0 };
        match self {
            Self::Speed => symmetric(0.2 * of.rated_speed()),
            Self::Load => symmetric(1.2 * m.T_N),
            Self::Offset => symmetric(0.05 * std::f64::consts::SQRT_2 * m.I_N),
            Self::StatorResistance => Range { min: 0.5 * m.R_s, max: 2.0 * m.R_s, default: m.R_s },
            Self::DeadTime => Range { min: 0.0, max: 5e-6, default: inv.dead_time },
            Self::Capacitance => Range { min: 0.0, max: 5e-9, default: inv.c_out },
        }
    }
}

/// Choices that need a new start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Machine and inverter.
    pub installation: Installation,
    /// Estimators of the drive.
    pub scheme: Scheme,
    /// Whether the drive estimates the offset.
    pub offset_estimator: bool,
    /// Seed of the measurement noise.
    pub seed: u64,
    /// Control periods from one row of the record to the next.
    pub record_every: u32,
}

impl Choice {
    /// The default for an installation: enhanced scheme with everything on, a row every 2 ms at 10 kHz.
    #[must_use]
    pub fn of(installation: Installation) -> Self {
        Self { installation, scheme: Scheme::Enhanced, offset_estimator: true, seed: 1, record_every: 20 }
    }
}

/// A closed loop in progress.
pub struct Session {
    choice: Choice,
    run: Run<'static>,
    load: f64,
    released: bool,
    overspeed: bool,
}

impl Session {
    /// A drive that is about to start, on an installation as its data sheet has it: speed reference and load zero.
    ///
    /// # Errors
    /// A parameter outside its admissible range.
    pub fn new(choice: Choice) -> Result<Self, ScenarioError> {
        let Installation { machine, inverter, .. } = choice.installation;
        let mut s = Scenario::new(machine, inverter, DURATION);
        s.record_every = choice.record_every;
        s.signals = Some(SIGNALS.map(String::from).to_vec());
        s.plant.adc.noise = NOISE * machine.I_N;
        s.plant.seed = choice.seed;
        s.plant.mechanics.speed = Some(0.0);
        s.drive = DriveParams {
            scheme: choice.scheme,
            acceleration: Some(choice.installation.rated_speed() / RAMP),
            ..DriveParams::new(&machine, &inverter)
        };
        match choice.scheme {
            Scheme::Paper => s.drive.paper.offset_estimator = choice.offset_estimator,
            Scheme::Enhanced => s.drive.enhanced.identify_offset = choice.offset_estimator,
        }
        let run = Run::new(Cow::Owned(s))?;
        Ok(Self { choice, run, load: 0.0, released: false, overspeed: false })
    }

    /// Sets one thing from now on.
    ///
    /// # Errors
    /// A value outside the range of the setting.
    pub fn set(&mut self, setting: Setting, value: f64) -> Result<(), ParamError> {
        let Range { min, max, .. } = setting.range(&self.choice.installation);
        let (name, unit) = setting.name();
        // A slider's end is its range's but for the rounding of its display.
        let slack = 1e-9 * (max - min);
        check(name, value, min - slack, max + slack, unit)?;
        match setting {
            Setting::Speed => self.run.set_reference(ReferenceProfile::Speed(Profile::constant(value))),
            Setting::Load => {
                self.load = value;
                self.apply_load();
            }
            Setting::Offset => self.run.plant_mut().set_offset([value, 0.0, 0.0]),
            Setting::StatorResistance => self.run.plant_mut().set_R_s(value),
            Setting::DeadTime => self.run.plant_mut().set_dead_time(value.max(0.0)),
            Setting::Capacitance => self.run.plant_mut().set_node_capacitance(value.max(0.0)),
        }
        Ok(())
    }

    /// Runs so many control periods, fewer if the run ends, and takes the record of them.
    pub fn advance(&mut self, periods: u32) -> Record {
        for _ in 0..periods {
            if self.overspeed || !self.run.advance(1) {
                break;
            }
            self.brake();
        }
        self.run.take_record()
    }

    /// The fault that has stopped the drive, or that the shaft has run away, which ends the run; empty: neither.
    #[must_use]
    pub fn fault(&self) -> &'static str {
        if self.overspeed {
            return "the shaft has run away";
        }
        self.run.drive().fault().map_or("", |fault| fault.cause.text())
    }

    /// The brake opens when the drive begins to run, and closes when it no longer does.
    fn brake(&mut self) {
        let running = self.run.drive().status() == Status::Running;
        if running != self.released {
            self.released = running;
            self.run.plant_mut().set_speed(if running { None } else { Some(0.0) });
            self.apply_load();
        }
        let speed = self.run.plant().truth().omega_m.abs();
        self.overspeed = speed > OVERSPEED * self.choice.installation.rated_speed();
    }

    fn apply_load(&mut self) {
        self.run.set_load(Profile::constant(if self.released { self.load } else { 0.0 }));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session(scheme: Scheme, offset_estimator: bool) -> Session {
        Session::new(Choice { scheme, offset_estimator, ..Choice::of(Installation::all()[0]) }).unwrap()
    }

    fn column<'r>(record: &'r Record, name: &str) -> &'r [f64] {
        &record.columns.iter().find(|c| c.name == name).unwrap().data
    }

    fn seconds(s: &mut Session, t: f64) -> Record {
        s.advance((t * s.choice.installation.inverter.f_s) as u32)
    }

    #[test]
    fn the_load_waits_for_the_drive_and_the_speed_follows_its_reference() {
        let mut s = session(Scheme::Enhanced, true);
        s.set(Setting::Load, 10.0).unwrap();
        s.set(Setting::Speed, 6.0).unwrap();
        let start = seconds(&mut s, 1.0);
        assert!(column(&start, "load_torque").iter().chain(column(&start, "omega_m")).all(|x| *x == 0.0));
        let end = seconds(&mut s, 3.0);
        assert_eq!(column(&end, "load_torque").last(), Some(&10.0));
        assert!((column(&end, "omega_m").last().unwrap() - 6.0).abs() < 0.3);
        assert_eq!(s.fault(), "");
    }

    #[test]
    fn settings_reach_the_installation_and_are_checked() {
        let mut s = session(Scheme::Enhanced, true);
        for setting in Setting::ALL {
            let Range { min, max, default } = setting.range(&Installation::all()[0]);
            assert!((min..=max).contains(&default));
            s.set(setting, max).unwrap();
            let name = setting.name().0;
            for bad in [2.0 * max, min - max, f64::NAN] {
                assert_eq!(s.set(setting, bad).unwrap_err().field, name);
            }
        }
        let inverter = s.run.plant().params().inverter;
        assert_eq!((inverter.dead_time, inverter.c_out), (5e-6, 5e-9));
        let record = seconds(&mut s, 0.01);
        assert_eq!(column(&record, "R_s").last(), Some(&7.4));
    }

    #[test]
    fn pieces_of_a_run_are_the_run() {
        let (mut whole, mut pieces) = (session(Scheme::Paper, true), session(Scheme::Paper, true));
        let all = whole.advance(3000);
        let parts: Vec<_> = (0..30).map(|_| pieces.advance(100)).collect();
        assert_eq!(all.t, parts.iter().flat_map(|r| r.t.clone()).collect::<Vec<_>>());
        for (k, c) in all.columns.iter().enumerate() {
            assert_eq!(c.data, parts.iter().flat_map(|r| r.columns[k].data.clone()).collect::<Vec<_>>(), "{}", c.name);
        }
    }
}
