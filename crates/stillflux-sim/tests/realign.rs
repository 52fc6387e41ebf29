//! The way out of a false equilibrium: a flux along the current, which makes no torque, and which the estimate does not see.

use crate::rig::{Rig, machines};
use stillflux::config::Scheme;
use stillflux::drive::Status;

/// Largest angle error, °, of the fifth of a second that begins one second after the rotor flux of a machine at rest, at the
/// torque limit of a speed reference for `held` s, was put along the current; and the speed at its end relative to the
/// reference. 180 after a fault.
fn afterwards(scheme: Scheme, omega: f64, load: f64, (noise, held): (u32, f64), realignment: bool) -> (f64, f64) {
    let (machine, inverter) = machines()[0];
    let mut rig = Rig::new(machine, inverter, |p| {
        (p.scheme, p.realignment, p.supervision, p.stall_time) = (scheme, realignment, false, 0.0);
    });
    let (at_rest, at, load) = (rig.speed(0.0), rig.speed(omega), load * machine.T_N);
    rig.run(3.0, at_rest, 0.0, |drive| drive.status() == Status::Running);
    // Another part of the same noise.
    rig.run(1.2 + 0.01 * f64::from(noise), at_rest, 0.0, |_| false);
    rig.plant.set_speed(Some(0.0));
    rig.run(held, at, load, |_| false);
    let t = *rig.plant.truth();
    let along = |length: f64| t.i_s.map(|i| i * length / t.i_s[0].hypot(t.i_s[1]));
    let psi_r = along(t.psi_r[0].hypot(t.psi_r[1]));
    rig.plant.set_state([0, 1].map(|k| psi_r[k] + machine.L_sigma * t.i_s[k]), psi_r, 0.0).unwrap();
    rig.plant.set_speed(None);
    rig.run(1.0, at, load, |_| false);
    rig.angle = 0.0;
    rig.run(0.2, at, load, |_| false);
    let angle = if rig.drive.status() == Status::Running { rig.angle } else { 180.0 };
    (angle, rig.plant.truth().omega_m / (rig.base.omega_m * omega))
}

/// Of these speeds and loads and twelve directions in which the field stops, each with another part of the noise: how many the drive has
/// come right in after a second.
fn come_right(scheme: Scheme, speeds: &[f64], loads: &[f64], realignment: bool) -> usize {
    let runs = speeds.iter().flat_map(|omega| loads.iter().map(move |load| (*omega, *load)));
    let begins = || (0..12).map(|k| (k, 0.2 + 0.02 * f64::from(k)));
    runs.flat_map(|(omega, load)| begins().map(move |begin| afterwards(scheme, omega, load, begin, realignment)))
        .filter(|&(angle, speed)| angle < 15.0 && (speed - 1.0).abs() < 0.1)
        .count()
}

#[test]
fn a_drive_whose_flux_lies_along_its_current_finds_it_and_reaches_its_speed() {
    let [with, without] = [true, false].map(|on| come_right(Scheme::Enhanced, &[0.1, 0.2], &[0.15, 0.3, 0.5], on));
    println!("{with} of 72, without realignment {without}");
    // Where the field wanders with the load through the test it counts as a shaft that turns. An equilibrium is left by
    // chance where nothing looks for it, in a third of the runs.
    assert!(with >= 57 && without <= 30, "{with} of 72, without realignment {without}");
}

/// With more load the published scheme is lost before it is suspected.
#[test]
#[ignore = "slow: make test-slow"]
fn so_does_the_published_scheme_under_little_load() {
    let [with, without] = [true, false].map(|on| come_right(Scheme::Paper, &[0.1, 0.2], &[0.15, 0.3], on));
    println!("{with} of 48, without realignment {without}");
    assert!(with >= 38 && without <= 26, "{with} of 48, without realignment {without}");
}
