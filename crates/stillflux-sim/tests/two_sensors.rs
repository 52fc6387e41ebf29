//! Closed loops with two current sensors: gains that differ, and what finds the difference.

use crate::rig::Largest;
use std::borrow::Cow;

use stillflux::base::Base;
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine};
use stillflux::si::Arithmetic;
use stillflux_sim::ChannelFault;
use stillflux_sim::simulate::{Change, Profile, ReferenceProfile, Run, Scenario};

/// Largest error of the field angle, °, at a speed, per unit, under a load in units of rated torque, from 7 s to 12 s; 180
/// if the drive does not run.
fn worst(
    (machine, inverter): (Machine, Inverter),
    (omega, load): (f64, f64),
    difference: f64,
    change: impl Fn(&mut Scenario),
) -> f64 {
    let mut s = Scenario::new(machine, inverter, 12.0);
    let w = omega * Base::new(&machine).omega_m;
    s.reference = ReferenceProfile::Speed(Profile::new(vec![(0.0, 0.0), (2.8, 0.0), (3.3, w)]).unwrap());
    s.load = Profile::new(vec![(0.0, 0.0), (3.4, 0.0), (3.8, load * machine.T_N)]).unwrap();
    s.plant.adc.noise = 0.004 * machine.I_N;
    s.plant.adc.offset = [0.01 * machine.I_N, -0.01 * machine.I_N, 0.3 * machine.I_N];
    s.plant.adc.gain = [1.0 + difference, 1.0, 1.7];
    s.drive.current_sensors = 2;
    s.signals = Some(vec!["angle_error".into()]);
    change(&mut s);
    let mut run = Run::new(Cow::Owned(s)).unwrap();
    while run.advance(u64::MAX) {}
    if run.drive().status() != Status::Running {
        return 180.0;
    }
    let record = run.record();
    let late = record.t.iter().zip(&record.columns[0].data).filter(|(t, _)| **t > 7.0);
    late.map(|(_, angle)| angle.to_degrees().abs()).largest()
}

const SMALL: fn() -> (Machine, Inverter) = || (Machine::preset_2k2(), Inverter::preset_2k2());

#[test]
fn gains_that_differ_are_found_at_the_start_and_the_plane_is_held() {
    for arithmetic in [Arithmetic::F32, Arithmetic::Q] {
        for (point, difference) in [((0.05, 0.4), 0.02), ((-0.05, -1.0), -0.02), ((0.1, 0.0), 0.02)] {
            let angle = worst(SMALL(), point, difference, |s| s.arithmetic = arithmetic);
            assert!(angle < 3.0, "{arithmetic:?} {point:?} {difference}: {angle}");
        }
    }
    let large = (Machine::preset_11k(), Inverter::preset_11k());
    let angle = worst(large, (0.05, 1.0), 0.02, |_| {});
    assert!(angle < 3.0, "{angle}");
}

/// The negative control: a difference that was not there at the start is not found.
#[test]
fn a_gain_that_changes_after_the_start_loses_the_angle() {
    let changed = Change::Channel(0, ChannelFault::Gain(1.02));
    let angle = worst(SMALL(), (0.02, 0.0), 0.0, |s| s.changes = vec![(3.0, changed)]);
    assert!(angle > 5.0, "{angle}");
}
