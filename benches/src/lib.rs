//! What the benchmarks share: a recorded closed loop to feed the blocks with, in any arithmetic.
//!
//! `cargo bench` prints the time of every block and of the drive step (`control`) and how many simulated
//! seconds a wall second makes (`simulation`).

use stillflux::base::Base;
use stillflux::config::{DriveConfig, DriveParams};
use stillflux::drive::{Drive, Measurement, Reference, Status};
use stillflux::params::{Inverter, Machine};
use stillflux::scalar::Real;
use stillflux_sim::simulate::{Profile, ReferenceProfile, Scenario};
use stillflux_sim::{Plant, PlantParams};

/// The machine all benchmarks run.
#[must_use]
pub fn machine() -> (Machine, Inverter) {
    (Machine::preset_2k2(), Inverter::preset_2k2())
}

/// Speed of the benchmarks, per unit.
pub const OMEGA: f64 = 0.03;

/// Start, low speed, rated load: the scenario behind the simulation figures.
#[must_use]
pub fn scenario(duration: f64) -> Scenario {
    let (machine, inverter) = machine();
    let base = Base::new(&machine);
    let profile = |points: Vec<(f64, f64)>| Profile::new(points).expect("ascending");
    let mut s = Scenario::new(machine, inverter, duration);
    s.reference = ReferenceProfile::Speed(profile(vec![(0.0, 0.0), (1.6, 0.0), (1.8, OMEGA * base.omega_m)]));
    s.load = profile(vec![(0.0, 0.0), (2.5, 0.0), (2.5, machine.T_N)]);
    s
}

/// A drive that runs, and the measurements of its next periods.
#[must_use]
pub fn running<R: Real>(samples: usize) -> (Drive<R>, Vec<Measurement<R>>) {
    let (machine, inverter) = machine();
    let base = Base::new(&machine);
    let params = DriveParams::new(&machine, &inverter);
    let mut drive = Drive::new(DriveConfig::new(&machine, &inverter, &params).expect("valid parameters"));
    let mut plant = Plant::new(PlantParams::new(machine, inverter)).expect("valid parameters");
    let mut sample = plant.sample();
    let mut step = |drive: &mut Drive<R>, omega: f64, load: f64| {
        let i_abc = sample.i_abc.map(|i| R::from_f64(i / base.i));
        let measured = Measurement { i_abc, u_dc: R::from_f64(sample.u_dc / base.u) };
        let out = drive.step(&measured, &Reference::Speed(R::from_f64(omega)));
        sample = plant.step(out.duty.map(R::to_f64), out.gates_on, load);
        measured
    };
    while drive.status() != Status::Running {
        step(&mut drive, 0.0, 0.0);
    }
    for _ in 0..10_000 {
        step(&mut drive, OMEGA, machine.T_N);
    }
    let mut ahead = drive;
    (drive, (0..samples).map(|_| step(&mut ahead, OMEGA, machine.T_N)).collect())
}
