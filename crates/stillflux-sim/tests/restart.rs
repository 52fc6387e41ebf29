//! Stops and restarts of a drive whose machine keeps its flux and its speed.

use crate::rig::{Largest, Rig, machines};
use stillflux::config::DriveParams;
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine, Rating, TModel};
use stillflux::si::{ReferenceSi, SiDrive};

/// What a restart showed.
#[derive(Debug)]
struct Restart {
    /// Time until the drive runs, s; infinite: it does not.
    time: f64,
    /// Largest current over the trip level.
    current: f64,
    /// Largest angle error over the second after it, °.
    angle: f64,
    /// Speed error at its end, per unit.
    error: f64,
}

impl Restart {
    /// Of a drive that has run for a second or two since a restart that took a `time`, at a speed in per unit.
    fn of(rig: &Rig, (machine, inverter): (Machine, Inverter), time: f64, omega: f64) -> Self {
        let running = rig.drive.status() == Status::Running;
        Self {
            time: if running { time } else { f64::INFINITY },
            current: rig.i_max / DriveParams::new(&machine, &inverter).i_trip,
            angle: rig.angle,
            error: (rig.plant.truth().omega_m / rig.base.omega_m - omega).abs(),
        }
    }
}

/// Runs at a speed and 0.3 of rated torque, stops for a pause, and restarts.
fn restart(m: (Machine, Inverter), omega: f64, pause: f64, change: impl FnOnce(&mut DriveParams)) -> Restart {
    restart_after(m, omega, (pause, 0.0), change)
}

/// The same with a load in the pause, in units of rated torque.
fn restart_after(
    m: (Machine, Inverter),
    omega: f64,
    (pause, braking): (f64, f64),
    change: impl FnOnce(&mut DriveParams),
) -> Restart {
    let mut rig = Rig::new(m.0, m.1, change);
    let load = 0.3 * m.0.T_N;
    let at = rig.speed(omega);
    rig.run(2.0, rig.speed(0.0), 0.0, |drive| drive.status() == Status::Running);
    rig.run(1.2, at, 0.0, |_| false);
    rig.run(0.5, at, load, |_| false);
    rig.run(pause, ReferenceSi::Stop, braking * m.0.T_N, |_| false);
    (rig.i_max, rig.angle) = (0.0, 0.0);
    let time = rig.run(3.0, at, 0.0, |drive| matches!(drive.status(), Status::Running | Status::Faulted { .. }));
    rig.run(1.0, at, load, |_| false);
    Restart::of(&rig, m, time, omega)
}

#[test]
fn a_restart_catches_the_flux_that_is_left_at_any_speed_and_after_any_pause() {
    for m in machines() {
        for omega in [0.0, 0.03, 0.24, -0.5, 1.0] {
            for pause in [0.001, 0.02, 0.3, 1.0] {
                let r = restart(m, omega, pause, |_| {});
                println!("{} N m, {omega}, {pause} s: {r:?}", m.0.T_N);
                // After a second nothing is left: the current has to build it up, at 11 kW in 95 ms and more.
                let most = if pause < 1.0 { 0.1 } else { 0.25 };
                assert!(r.time < most && r.current < 0.9, "{omega} after {pause} s: {r:?}");
                assert!(r.angle < 15.0 && r.error < 0.01, "{omega} after {pause} s: {r:?}");
            }
        }
    }
}

/// The flux that is left has turned by an unknown angle, and induces less than the error of the bridge without current. When
/// it had to decay first, these took up to 0.6 s.
#[test]
fn a_shaft_that_slows_down_in_the_pause_is_caught_with_its_flux() {
    for m in machines() {
        for (omega, pause, braking) in
            [(0.06, 0.06, 0.0), (0.1, 0.1, 0.3), (0.06, 0.1, 0.1), (0.06, 0.2, 0.1), (0.24, 0.3, 0.3)]
        {
            let r = restart_after(m, omega, (pause, braking), |_| {});
            println!("{} N m, {omega}, {pause} s under {braking}: {r:?}", m.0.T_N);
            assert!(r.time < 0.15 && r.current < 0.9, "{omega} after {pause} s under {braking}: {r:?}");
            assert!(r.angle < 30.0 && r.error < 0.01, "{omega} after {pause} s under {braking}: {r:?}");
        }
    }
}

/// Runs at rest, and with what comes in between once more, then under rated load: largest delay that was found between the
/// legs, which have none, s, and what the restart showed.
fn restart_at_rest(m: (Machine, Inverter), fresh_time: f64, between: impl FnOnce(&mut Rig)) -> (f64, Restart) {
    let mut rig = Rig::new(m.0, m.1, |p| p.fresh_time = fresh_time);
    let (rest, up) =
        (rig.speed(0.0), |drive: &SiDrive| matches!(drive.status(), Status::Running | Status::Faulted { .. }));
    rig.run(20.0, rest, 0.0, up);
    rig.run(0.2, rest, 0.0, |_| false);
    between(&mut rig);
    (rig.i_max, rig.angle) = (0.0, 0.0);
    let time = rig.run(20.0, rest, 0.0, up);
    let delays = rig.drive.memory().leg_delay;
    rig.run(2.0, rest, m.0.T_N, |_| false);
    (delays.iter().flatten().map(|x| x.abs()).largest(), Restart::of(&rig, m, time, 0.0))
}

/// What its data are worth after a fault is not known, nor where the flux is. The comparison of the legs took the voltage that
/// it induces for delays of 0.3 µs: under rated load the angle was off by 10° at 2.2 kW, at the others the field was lost.
#[test]
fn a_start_after_a_fault_waits_until_the_flux_that_it_left_has_decayed() {
    for m in machines().into_iter().chain(large_machines()) {
        let (delay, r) = restart_at_rest(m, 10.0, Rig::fail_and_reset);
        println!("{} N m: {:.1} ns, {r:?}", m.0.T_N, 1e9 * delay);
        assert!(delay < 10e-9, "{} N m: {:.1} ns", m.0.T_N, 1e9 * delay);
        let (magnetise, tau_r) = (DriveParams::new(&m.0, &m.1).magnetise_time, m.0.L_M / m.0.R_R);
        assert!(r.time > magnetise && r.time < magnetise + 8.0 * tau_r, "{r:?}");
        assert!(r.angle < 5.0 && r.error < 0.05, "{} N m: {r:?}", m.0.T_N);
    }
}

#[test]
fn a_machine_that_turns_after_a_fault_is_caught_with_its_flux_or_started_when_that_has_decayed() {
    for m in machines() {
        for omega in [0.02, -0.05, 0.1, -0.24, 0.6] {
            let mut rig = Rig::new(m.0, m.1, |_| {});
            let at = rig.speed(omega);
            rig.run(2.0, rig.speed(0.0), 0.0, |drive| drive.status() == Status::Running);
            rig.run(1.2, at, 0.0, |_| false);
            rig.fail_and_reset();
            rig.angle = 0.0;
            let time = rig.run(10.0, at, 0.0, |drive| drive.status() == Status::Running);
            rig.run(1.0, at, 0.5 * m.0.T_N, |_| false);
            let error = (rig.plant.truth().omega_m / rig.base.omega_m - omega).abs();
            println!("{} N m at {omega}: {time:.2} s, {:.1}°, {error:.4}", m.0.T_N, rig.angle);
            assert!(rig.angle < 15.0 && error < 0.01, "{} N m at {omega}: {}°, {error}", m.0.T_N, rig.angle);
        }
    }
}

/// The control: a drive at power-up does not know of the flux, and finds delays that there are not.
#[test]
fn a_flux_that_a_drive_at_power_up_cannot_know_of_is_found_as_delays_of_the_legs() {
    for m in machines() {
        let mut rig = Rig::new(m.0, m.1, |_| {});
        rig.plant.set_state([0.8 * rig.base.psi, 0.0], [0.8 * rig.base.psi, 0.0], 0.0).unwrap();
        let rest = rig.speed(0.0);
        rig.run(3.0, rest, 0.0, |drive| matches!(drive.status(), Status::Running | Status::Faulted { .. }));
        let delay = rig.drive.memory().leg_delay.iter().flatten().map(|x| x.abs()).largest();
        println!("{} N m: {:.0} ns", m.0.T_N, 1e9 * delay);
        assert!(delay > 50e-9, "{} N m: {:.0} ns", m.0.T_N, 1e9 * delay);
    }
}

/// The filter has no flux yet, whatever it had when the drive ran.
#[test]
fn a_start_after_one_that_was_stopped_waits_until_the_flux_that_it_built_up_has_decayed() {
    for m in machines() {
        let stopped = |rig: &mut Rig| {
            rig.run(2.0, ReferenceSi::Stop, 0.0, |_| false);
            rig.run(0.03, rig.speed(0.0), 0.0, |_| false);
            assert_eq!(rig.drive.status(), Status::Magnetising);
            rig.run(0.001, ReferenceSi::Stop, 0.0, |_| false);
        };
        let (delay, r) = restart_at_rest(m, 10.0, stopped);
        println!("{} N m: {:.1} ns, {r:?}", m.0.T_N, 1e9 * delay);
        assert!(delay < 10e-9 && r.angle < 5.0 && r.error < 0.05, "{} N m: {r:?}", m.0.T_N);
    }
}

#[test]
fn without_fresh_data_a_restart_reads_offsets_and_magnetises_anew() {
    for m in machines() {
        let (delay, r) = restart_at_rest(m, 0.0, |rig| {
            rig.run(0.02, ReferenceSi::Stop, 0.0, |_| false);
        });
        println!("{} N m: {:.1} ns, {r:?}", m.0.T_N, 1e9 * delay);
        assert!(r.time > 1.0 && delay < 10e-9 && r.angle < 5.0 && r.error < 0.05, "{} N m: {r:?}", m.0.T_N);
    }
}

/// A drive that knows nothing, on a machine that turns with a flux of its own.
#[test]
fn a_drive_at_power_up_catches_a_flux_that_it_did_not_build_up() {
    for m in machines() {
        for (omega, psi, angle) in [(0.4, 0.8, 0.3_f64), (-0.7, 0.5, 2.0), (1.0, 0.6, -1.0)] {
            let mut rig = Rig::new(m.0, m.1, |_| {});
            let psi_r = [angle.cos(), angle.sin()].map(|x| x * psi * rig.base.psi);
            rig.plant.set_state(psi_r, psi_r, omega * rig.base.omega_m).unwrap();
            let at = rig.speed(omega);
            let t = rig.run(3.0, at, 0.0, |drive| matches!(drive.status(), Status::Running | Status::Faulted { .. }));
            rig.run(0.5, at, 0.0, |_| false);
            assert_eq!(rig.drive.status(), Status::Running, "{omega}: {:?}", rig.drive.fault());
            let error = rig.plant.truth().omega_m / rig.base.omega_m - omega;
            println!("{omega}: {:.0} ms, {:.1}°, {error:.3}", 1e3 * t, rig.angle);
            assert!(t < 0.3 && rig.angle < 15.0 && error.abs() < 0.02, "{omega}: {t} s, {}°, {error}", rig.angle);
        }
    }
}

/// The comparison of the legs alternates the flux, and at these speeds it falls behind by as much as to look like a rotation
/// below its threshold, or none. A search that begins with the flux that is left was off by 40° and more.
#[test]
fn a_machine_in_which_the_comparison_of_the_legs_has_left_a_flux_is_started() {
    for omega in [0.26, -0.27] {
        let mut rig = Rig::new(Machine::preset_2k2(), Inverter::preset_2k2(), |_| {});
        rig.plant.set_speed(Some(omega * rig.base.omega_m));
        let no_torque = ReferenceSi::Torque(0.0);
        rig.run(3.0, no_torque, 0.0, |drive| matches!(drive.status(), Status::Running | Status::Faulted { .. }));
        rig.run(0.3, no_torque, 0.0, |_| false);
        assert_eq!(rig.drive.status(), Status::Running, "{omega}: {:?}", rig.drive.fault());
        println!("{omega}: {:.1}°", rig.angle);
        assert!(rig.angle < 15.0, "{omega}: {}°", rig.angle);
    }
}

/// A flux that was caught is off by some degrees: with a variance of none the filter took that for an error of the resistance,
/// and the angle was off by 25° a second later, in regeneration.
#[test]
fn a_small_machine_that_is_caught_leaves_no_error_behind() {
    let rating = Rating { n_p: 2, J: 0.0021, U_N: 400.0, I_N: 1.9, f_N: 50.0, T_N: 5.1 };
    let t = TModel { R_s: 11.5, R_r: 8.0, L_ls: 34e-3, L_lr: 34e-3, L_m: 0.63 };
    let inverter = Inverter { r_d: 0.4, ..Inverter::preset_2k2() };
    let r = restart(((Machine::from_t_model(t, rating)), inverter), -0.15, 0.001, |_| {});
    assert!(r.time < 0.05 && r.angle < 20.0 && r.error < 0.01, "{r:?}");
}

/// 160 and 45 kW at 4 and 5 kHz: large machines, whose bridge loses most per period and whose resistance damps least.
fn large_machines() -> [(Machine, Inverter); 2] {
    let of = |[r_s, r_r, leakage, l_m]: [f64; 4], (j, i, torque), (f_s, r_d, u_th)| {
        let rating = Rating { n_p: 2, J: j, U_N: 400.0, I_N: i, f_N: 50.0, T_N: torque };
        let t = TModel { R_s: r_s, R_r: r_r, L_ls: leakage, L_lr: leakage, L_m: l_m };
        let inverter = Inverter { f_s, u_th, r_d, dead_time: 3e-6, ..Inverter::preset_2k2() };
        (Machine::from_t_model(t, rating), inverter)
    };
    [
        of([0.0105, 0.0067, 0.27e-3, 8.4e-3], (2.9, 275.0, 1030.0), (4e3, 0.004, 1.3)),
        of([0.06, 0.036, 0.8e-3, 24e-3], (0.5, 81.0, 291.0), (5e3, 0.012, 1.2)),
    ]
}

/// Start in a machine without flux that turns at an imposed speed: largest angle error of its first 0.3 s under control, °,
/// and the largest current up to then over the trip level.
fn start_turning(m: (Machine, Inverter), omega: f64) -> (f64, f64) {
    let mut rig = Rig::new(m.0, m.1, |p| p.enhanced.identify_legs = false);
    rig.plant.set_speed(Some(omega * rig.base.omega_m));
    let no_torque = ReferenceSi::Torque(0.0);
    rig.run(3.0, no_torque, 0.0, |drive| matches!(drive.status(), Status::Running | Status::Faulted { .. }));
    rig.run(0.3, no_torque, 0.0, |_| false);
    assert_eq!(rig.drive.status(), Status::Running, "{omega}: {:?}", rig.drive.fault());
    (rig.angle, rig.i_max / DriveParams::new(&m.0, &m.1).i_trip)
}

/// With the loss of the bridge taken by the reference of the current, which an error of the flux turns against the current,
/// the flux was wrong by a third at the end, and current control a fault, from 0.45 to 0.8 pu at 160 kW.
#[test]
fn a_large_machine_that_turns_without_flux_is_started_at_any_speed() {
    for m in large_machines() {
        for omega in [0.5, -0.7] {
            let (angle, _) = start_turning(m, omega);
            println!("{} N m at {omega}: {angle:.1}°", m.0.T_N);
            assert!(angle < 15.0, "{} N m at {omega}: {angle}°", m.0.T_N);
        }
    }
}

/// Rated flux needs more voltage than there is: current control without voltage had an over-current.
#[test]
fn a_machine_that_turns_fast_is_started_with_the_flux_for_which_there_is_voltage() {
    for m in large_machines() {
        let (angle, current) = start_turning(m, 1.0);
        println!("{} N m: {angle:.1}°, {current:.2}", m.0.T_N);
        assert!(angle < 15.0 && current < 0.6, "{} N m: {angle}°, {current} of the trip level", m.0.T_N);
    }
}
