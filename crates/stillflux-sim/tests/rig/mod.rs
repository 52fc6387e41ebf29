//! A drive and its machine in the hands of a test.

use stillflux::base::Base;
use stillflux::config::DriveParams;
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine};
use stillflux::si::{Arithmetic, MeasurementSi, ReferenceSi, SiDrive};
use stillflux_sim::{Plant, PlantParams};

/// A drive and its machine, step by step: what no scenario says can be done to either in between.
pub struct Rig {
    pub drive: SiDrive,
    pub plant: Plant,
    sample: MeasurementSi,
    pub base: Base,
    f_s: f64,
    /// Largest current since the last restart, A, and largest angle error while running, °.
    pub i_max: f64,
    pub angle: f64,
}

impl Rig {
    pub fn new(machine: Machine, inverter: Inverter, change: impl FnOnce(&mut DriveParams)) -> Self {
        let mut params = DriveParams::new(&machine, &inverter);
        change(&mut params);
        let mut p = PlantParams::new(machine, inverter);
        p.adc.noise = 0.004 * machine.I_N;
        p.adc.offset = [0.005 * machine.I_N, -0.004 * machine.I_N, 0.0];
        let mut plant = Plant::new(p).unwrap();
        let sample = plant.sample();
        let drive = SiDrive::new(&machine, &inverter, &params, Arithmetic::F32).unwrap();
        Self { drive, plant, sample, base: Base::new(&machine), f_s: inverter.f_s, i_max: 0.0, angle: 0.0 }
    }

    /// Runs for some seconds; `until` ends it earlier. Returns the seconds.
    pub fn run(&mut self, seconds: f64, reference: ReferenceSi, load: f64, until: impl Fn(&SiDrive) -> bool) -> f64 {
        let periods = (seconds * self.f_s).round() as u32;
        for k in 0..periods {
            let (duty, gates_on) = self.drive.step(&self.sample, &reference);
            if until(&self.drive) {
                return f64::from(k) / self.f_s;
            }
            self.sample = self.plant.step(duty, gates_on, load);
            let t = self.plant.truth();
            self.i_max = self.i_max.max(t.i_s[0].hypot(t.i_s[1]));
            if self.drive.status() == Status::Running {
                let (a, b) = (t.psi_s, self.drive.estimate().psi_s);
                let angle = (a[0] * b[1] - a[1] * b[0]).atan2(a[0] * b[0] + a[1] * b[1]).to_degrees();
                self.angle = [self.angle, angle.abs()].into_iter().largest();
            }
        }
        seconds
    }

    /// Readings that are not numbers, until that is a fault, and a reset.
    pub fn fail_and_reset(&mut self) {
        for _ in 0..10 {
            self.sample.i_abc = [f64::NAN; 3];
            self.run(1.0 / self.f_s, self.speed(0.0), 0.0, |_| false);
        }
        assert!(matches!(self.drive.status(), Status::Faulted { .. }), "{:?}", self.drive.status());
        self.drive.reset();
    }

    pub fn speed(&self, omega: f64) -> ReferenceSi {
        ReferenceSi::Speed(omega * self.base.omega_m)
    }
}

pub fn machines() -> [(Machine, Inverter); 2] {
    [(Machine::preset_2k2(), Inverter::preset_2k2()), (Machine::preset_11k(), Inverter::preset_11k())]
}

/// The largest of some magnitudes. There is at least one, and none is NaN: neither a run that ended before the rows that are
/// looked at nor an angle that is no number passes as a small error.
pub trait Largest: Iterator<Item = f64> + Sized {
    fn largest(self) -> f64 {
        self.map(|x| if x.is_nan() { panic!("not a number") } else { x }).reduce(f64::max).expect("no rows")
    }
}

impl<I: Iterator<Item = f64>> Largest for I {}
