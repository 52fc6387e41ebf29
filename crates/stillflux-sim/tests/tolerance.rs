//! Installations with several parameters off at once, as the tolerance campaign draws them: each lost the drive for one
//! reason.

use crate::rig::Largest;
use std::borrow::Cow;

use stillflux::base::Base;
use stillflux::config::DriveParams;
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine, Rating, TModel};
use stillflux_sim::simulate::{Change, Profile, Record, ReferenceProfile, Run, Scenario};
use stillflux_sim::{Adc, DeepBar, GateDelays, PlantParams, SlotRipple, Thermal};

/// Factors of the plant's parameters.
#[derive(Clone, Copy)]
struct Factors {
    r_s: f64,
    r_r: f64,
    l_sigma: f64,
    l_m: f64,
    u_th: f64,
    dead_time: f64,
    j: f64,
}

const EXACT: Factors = Factors { r_s: 1.0, r_r: 1.0, l_sigma: 1.0, l_m: 1.0, u_th: 1.0, dead_time: 1.0, j: 1.0 };

fn machine(
    [r_s, r_r, leakage, l_m]: [f64; 4],
    (j, u, i, f, torque): (f64, f64, f64, f64, f64),
    inverter: Inverter,
) -> (Machine, Inverter) {
    let rating = Rating { n_p: 2, J: j, U_N: u, I_N: i, f_N: f, T_N: torque };
    (Machine::from_t_model(TModel { R_s: r_s, R_r: r_r, L_ls: leakage, L_lr: leakage, L_m: l_m }, rating), inverter)
}

fn of_160_kw() -> (Machine, Inverter) {
    let bridge = Inverter { f_s: 4e3, u_th: 1.3, r_d: 0.004, dead_time: 3e-6, c_out: 10e-9, ..Inverter::preset_2k2() };
    machine([0.0105, 0.0067, 0.27e-3, 8.4e-3], (2.9, 400.0, 275.0, 50.0, 1030.0), bridge)
}

fn of_15_kw() -> (Machine, Inverter) {
    let bridge =
        Inverter { f_s: 8e3, u_th: 1.1, r_d: 0.03, dead_time: 2.5e-6, c_out: 2.5e-9, ..Inverter::preset_2k2() };
    machine([0.26, 0.17, 2.2e-3, 57e-3], (0.11, 400.0, 28.5, 50.0, 98.0), bridge)
}

/// 48 V; its pull-out torque is twice its rated torque.
fn of_48_v() -> (Machine, Inverter) {
    let bridge = Inverter {
        u_dc: 56.0,
        f_s: 16e3,
        u_th: 0.05,
        r_d: 0.002,
        dead_time: 0.8e-6,
        c_out: 8e-9,
        ..Inverter::preset_2k2()
    };
    machine([0.013, 0.01, 44e-6, 1.5e-3], (0.02, 34.0, 120.0, 100.0, 16.0), bridge)
}

/// 0.4 kW and eight poles at 100 Hz: a rotor time constant of 23 ms.
fn of_0_4_kw() -> (Machine, Inverter) {
    let bridge = Inverter { u_dc: 563.0, f_s: 16e3, u_th: 1.0, r_d: 2.9, dead_time: 1.8e-6, ..Inverter::preset_2k2() };
    let machine = Machine {
        R_s: 18.8,
        R_R: 15.6,
        L_sigma: 46.5e-3,
        L_M: 0.36,
        n_p: 4,
        J: 1.1e-3,
        U_N: 400.0,
        I_N: 0.98,
        f_N: 100.0,
        T_N: 2.8,
        saturation: None,
    };
    (machine, bridge)
}

/// A slow motor of a fan.
fn fan() -> (Machine, Inverter) {
    let bridge = Inverter { u_th: 1.0, r_d: 0.06, dead_time: 2e-6, c_out: 1.75e-9, ..Inverter::preset_2k2() };
    let machine = Machine {
        R_s: 0.9,
        R_R: 0.6198,
        L_sigma: 11.4545e-3,
        L_M: 54.545e-3,
        n_p: 4,
        J: 1.0,
        U_N: 400.0,
        I_N: 13.5,
        f_N: 50.0,
        T_N: 73.0,
        saturation: None,
    };
    (machine, bridge)
}

/// Values over the time.
type Points = [(f64, f64)];

struct Outcome {
    record: Record,
    status: Status,
    base: Base,
    begin: f64,
}

/// Runs points of speed, per unit, and load, of rated torque, over the time since the end of the start-up.
fn run(installation: (Machine, Inverter), x: Factors, seed: u64, course: (&Points, &Points)) -> Outcome {
    run_with(installation, x, seed, course, |_| {})
}

/// The same with something else in the scenario.
fn run_with(
    (m, inverter): (Machine, Inverter),
    x: Factors,
    seed: u64,
    (speed, load): (&Points, &Points),
    set: impl Fn(&mut Scenario),
) -> Outcome {
    let real = Machine {
        R_s: x.r_s * m.R_s,
        R_R: x.r_r * m.R_R,
        L_sigma: x.l_sigma * m.L_sigma,
        L_M: x.l_m * m.L_M,
        J: x.j * m.J,
        ..m
    };
    let bridge = Inverter { u_th: x.u_th * inverter.u_th, dead_time: x.dead_time * inverter.dead_time, ..inverter };
    let base = Base::new(&m);
    let settings = DriveParams::new(&m, &inverter);
    let begin = settings.offset_time + settings.magnetise_time + 0.05;
    let end = begin + speed.last().unwrap().0.max(load.last().unwrap().0);
    let mut s = Scenario::new(m, inverter, end);
    s.plant = PlantParams::new(real, bridge);
    s.plant.seed = seed;
    let peak = m.I_N * 2f64.sqrt();
    s.plant.adc = Adc { noise: 0.004 * m.I_N, ..Adc::new(&m, &inverter) };
    s.plant.adc.offset = [-0.006, -0.004, 0.002].map(|part| part * peak);
    s.plant.adc.gain = [1.0025, 1.008, 1.0015];
    let after = |points: &Points, scale: f64| {
        Profile::new(points.iter().map(|&(t, v)| (t + begin, v * scale)).collect()).unwrap()
    };
    s.reference = ReferenceProfile::Speed(after(speed, base.omega_m));
    s.load = after(load, m.T_N);
    set(&mut s);
    s.signals = Some(["angle_error", "omega_m", "status", "psi_s", "estimate.R_s"].map(String::from).to_vec());
    let mut run = Run::new(Cow::Owned(s)).unwrap();
    while run.advance(u64::MAX) {}
    let (record, drive) = run.into_parts();
    Outcome { record, status: drive.status(), base, begin }
}

impl Outcome {
    fn data(&self, name: &str) -> &[f64] {
        &self.record.columns.iter().find(|c| c.name == name).unwrap().data
    }

    /// Largest angle error under control, °.
    fn angle(&self) -> f64 {
        let running = self.data("status").iter().map(|&x| x == 3.0);
        self.data("angle_error").iter().zip(running).filter(|x| x.1).map(|x| x.0.to_degrees().abs()).largest()
    }

    /// When control begins, s after the planned end of the start-up.
    fn first(&self) -> f64 {
        let k = self.data("status").iter().position(|&x| x == 3.0).unwrap();
        self.record.t[k] - self.begin
    }

    fn last_speed(&self) -> f64 {
        self.data("omega_m").last().unwrap() / self.base.omega_m
    }

    fn assert_held(&self, angle: f64, omega: f64) {
        assert_eq!(self.status, Status::Running);
        assert!(self.angle() < angle, "{}°", self.angle());
        assert!((self.last_speed() - omega).abs() < 0.02, "{}", self.last_speed());
    }
}

/// With a bridge that loses less than the drive is told, the estimated flux of a large machine lies near zero or points
/// backwards while it builds up.
#[test]
fn a_large_machine_at_rest_is_not_taken_for_a_rotating_one() {
    let x = Factors { r_s: 1.044, r_r: 0.98, l_sigma: 0.976, l_m: 0.965, u_th: 0.6, dead_time: 0.945, ..EXACT };
    let installation = of_160_kw();
    // Without capacitance the bridge applies no voltage until the current begins, and nothing of what was commanded.
    let clamped = (installation.0, Inverter { c_out: 0.0, ..installation.1 });
    let still = [(0.0, 0.0), (0.5, 0.0)];
    for (installation, x, seed) in [
        (installation, x, 2),
        (installation, x, 3),
        (installation, x, 4),
        (clamped, EXACT, 4),
        (clamped, EXACT, 5),
        (clamped, EXACT, 9),
    ] {
        let o = run(installation, x, seed, (&still, &still));
        o.assert_held(5.0, 0.0);
        assert!(o.first() > -0.06, "{seed}: under control {} s too early", -o.first());
    }
}

/// The load turns the rotor flux by the error of the leakage, at a stator frequency at which that is not corrected.
#[test]
fn a_large_machine_with_a_wrong_leakage_takes_load_steps_at_standstill() {
    let x = Factors { r_s: 1.01, r_r: 1.14, l_sigma: 1.18, l_m: 1.04, u_th: 0.88, dead_time: 0.918, j: 1.9 };
    let steps = [(0.5, 1.0), (1.5, 0.0), (2.5, -1.0), (3.5, 0.0), (4.5, 1.0), (5.5, -1.0)];
    let mut load = vec![(0.0, 0.0)];
    for (t, torque) in steps {
        load.extend([(t, load.last().unwrap().1), (t, torque)]);
    }
    for seed in [1, 2] {
        run(of_160_kw(), x, seed, (&[(0.0, 0.0), (6.5, 0.0)], &load)).assert_held(12.0, 0.0);
    }
}

/// The magnetising current of the nameplate's leakage is too small for rated torque: with it in the feedforward one or two of
/// eight realisations of the noise ended in a stall, with the field held.
#[test]
fn a_machine_near_pull_out_keeps_its_flux_in_regeneration_with_a_larger_leakage() {
    let x = Factors { r_s: 0.917, r_r: 1.07, l_sigma: 1.2, l_m: 1.047, u_th: 0.96, dead_time: 0.8, j: 1.38 };
    let generating = 0.0694;
    let speed = [(0.0, 0.0), (0.3, 0.0), (0.8, 0.02), (3.0, 0.02), (3.5, generating), (5.5, generating)];
    let load = [(0.0, 0.0), (0.8, 0.0), (1.3, 1.0), (3.0, 1.0), (3.5, -1.0)];
    for seed in 1..=8 {
        run(of_48_v(), x, seed, (&speed, &load)).assert_held(8.0, generating);
    }
}

/// 134 kW at the current limit, with a leakage three tenths above the data and a rotor time constant of 1.5 s: from field weakening the
/// voltage would allow rated flux while half of it is there, which is no lost estimate, and near pull-out all the current would go into
/// keeping that half: it collapsed in 8 of 8.
#[test]
fn a_flux_that_takes_long_from_field_weakening_to_rated_is_no_lost_estimate_and_gets_its_current() {
    let bridge = Inverter {
        u_dc: 575.0,
        f_s: 3e3,
        u_th: 1.15,
        r_d: 0.007,
        dead_time: 2.4e-6,
        c_out: 5e-9,
        ..Inverter::preset_2k2()
    };
    let machine = Machine {
        R_s: 9.34e-3,
        R_R: 8.53e-3,
        L_sigma: 0.517e-3,
        L_M: 12.46e-3,
        n_p: 2,
        J: 1.48,
        U_N: 400.0,
        I_N: 228.0,
        f_N: 50.0,
        T_N: 854.0,
        saturation: None,
    };
    let x = Factors { r_s: 0.87, r_r: 0.79, l_sigma: 1.3, l_m: 1.03, u_th: 0.41, dead_time: 0.97, j: 0.91 };
    let speed = [(0.0, 0.0), (0.3, 0.0), (0.3, 1.9), (2.5, 1.9), (2.5, -1.9), (4.3, -1.9)];
    for seed in 1..=8 {
        let o = run((machine, bridge), x, seed, (&speed, &[(0.0, 0.0), (1.0, 0.0)]));
        o.assert_held(15.0, -1.9);
        // At 0.8 of rated speed the voltage is enough for rated flux.
        let (psi, omega) = (o.data("psi_s"), o.data("omega_m"));
        let at = (0..omega.len()).find(|&k| o.record.t[k] > o.begin + 2.6 && omega[k] < 0.8 * o.base.omega_m).unwrap();
        let flux = psi[2 * at].hypot(psi[2 * at + 1]) / o.base.psi;
        assert!((0.55..0.7).contains(&flux), "{seed}: {flux}");
    }
}

/// A slow fan motor whose leakage at slip frequency is nearly twice that of the data, by deep bars. Its rotor flux collapses in the reversal from
/// twice rated speed at a torque that the stator flux alone, of which a part is leakage, would allow; and speed control may not
/// answer what an estimated speed contains of the torque current.
#[test]
fn a_fan_motor_with_deep_bars_reverses_from_twice_rated_speed() {
    let x = Factors { r_s: 0.91, r_r: 0.91, l_sigma: 1.163, l_m: 1.05, u_th: 0.69, dead_time: 0.95, j: 1.27 };
    let speed = [(0.0, 0.0), (0.3, 0.0), (0.3, 1.9), (10.0, 1.9), (10.0, -1.9), (20.0, -1.9)];
    for seed in 1..=3 {
        let o = run_with(fan(), x, seed, (&speed, &[(0.0, 0.0), (1.0, 0.0)]), |s| {
            s.plant.deep_bar = Some(DeepBar { conductance: 0.0542, leakage: 0.4 });
            s.plant.slot_ripple = Some(SlotRipple { slots: 68, permeance: 0.0089, leakage: 0.012 });
        });
        o.assert_held(25.0, -1.9);
    }
}

/// What a run at rest shows of resistance, inductance and saturation is what they make together. A filter that goes on with each of
/// them as if it were known by itself lets its flux run away under the direct current of the restart, in every realisation.
#[test]
fn a_restart_at_rest_holds_with_what_a_run_at_rest_has_shown_of_a_machine_off_its_parameters() {
    let small = Inverter { u_th: 1.0, r_d: 0.4, dead_time: 2e-6, c_out: 0.2e-9, ..Inverter::preset_2k2() };
    let m = machine([11.5, 8.0, 34e-3, 0.63], (0.0021, 400.0, 1.9, 50.0, 5.1), small);
    let x = Factors { r_s: 1.15, l_m: 1.15, ..EXACT };
    let still = [(0.0, 0.0), (4.0, 0.0)];
    for seed in 1..=4 {
        for pause in [0.3, 1.0] {
            let o = run_with(m, x, seed, (&still, &still), |s| {
                let stop = s.drive.offset_time + s.drive.magnetise_time + 0.5;
                s.changes = vec![(stop, Change::Stop(true)), (stop + pause, Change::Stop(false))];
            });
            o.assert_held(15.0, 0.0);
        }
    }
    // And where the machine is magnetised anew: a fan motor with a larger inductance.
    for seed in 1..=3 {
        let still = [(0.0, 0.0), (6.0, 0.0)];
        let o = run_with(fan(), Factors { l_m: 1.15, ..EXACT }, seed, (&still, &still), |s| {
            s.drive.fresh_time = 0.0;
            let stop = s.drive.offset_time + s.drive.magnetise_time + 0.5;
            s.changes = vec![(stop, Change::Stop(true)), (stop + 1.0, Change::Stop(false))];
        });
        o.assert_held(15.0, 0.0);
    }
}

/// Fast, the resistance is held, and a winding that warms is an error of the voltage, which the saturation would take for its own: with the
/// weaker flux of braking near zero stator frequency the field was lost, though the resistance was right again by then.
#[test]
fn a_winding_that_warms_at_speed_leaves_a_field_that_brakes_near_zero_stator_frequency() {
    let speed =
        [(0.0, 0.0), (0.5, 0.0), (1.5, 0.8), (30.0, 0.8), (32.0, 0.03), (34.0, 0.03), (37.0, -0.03), (46.0, -0.03)];
    let load = [(0.0, 0.0), (0.5, 0.0), (1.0, 0.9)];
    for seed in 1..=3 {
        let m = (Machine::preset_2k2(), Inverter::preset_2k2());
        let o = run_with(m, EXACT, seed, (&speed, &load), |s| {
            s.plant.thermal = Some(Thermal { time_constant: 20.0, rise: 80.0, alpha: 0.0039, alpha_R: 0.0039 });
            s.record_every = 20;
        });
        o.assert_held(10.0, -0.03);
    }
}

/// Everything at once at 15 kW: the rotor time constant 43 % shorter than told.
#[test]
fn a_load_that_comes_in_at_standstill_is_held_with_every_parameter_wrong() {
    let x = Factors { r_s: 1.116, r_r: 1.22, l_sigma: 1.166, l_m: 0.852, u_th: 1.138, dead_time: 0.913, j: 2.71 };
    for seed in [1, 2] {
        let load = [(0.0, 0.0), (0.3, 0.0), (0.8, 1.0)];
        run(of_15_kw(), x, seed, (&[(0.0, 0.0), (4.0, 0.0)], &load)).assert_held(12.0, 0.0);
    }
}

/// Values for rotor resistances of 0.8 and 1.25 times that of the parameters, mean of three realisations of the noise.
fn by_rotor(of_seed: impl Fn(f64, u64) -> f64) -> [f64; 2] {
    [0.8, 1.25].map(|r_r| (1..=3).map(|seed| of_seed(r_r, seed)).sum::<f64>() / 3.0)
}

/// The transients of the direct currents of a start depend on the rotor resistance, which it finds by them.
#[test]
fn a_start_takes_little_of_a_wrong_rotor_resistance_for_one_of_the_stator() {
    let still = [(0.0, 0.0), (0.05, 0.0)];
    for (machine, inverter) in [(Machine::preset_11k(), Inverter::preset_11k()), of_15_kw()] {
        let [less, more] = by_rotor(|r_r, seed| {
            let o = run_with((machine, inverter), Factors { r_r, ..EXACT }, seed, (&still, &still), |_| ());
            o.data("estimate.R_s").last().unwrap() / (machine.R_s + inverter.r_d)
        });
        let part = (more - less) / 0.45;
        assert!(part.abs() < 0.1, "{part}");
    }
}

/// Speed error under rated load, of the slip, with the resistances `r_s` and `r_r` of the parameters.
fn of_slip(
    (machine, inverter): (Machine, Inverter),
    r_s: f64,
    r_r: f64,
    seed: u64,
    set: impl Fn(&mut Scenario),
) -> f64 {
    const SPEED: f64 = 0.1;
    let speed = [(0.0, 0.0), (0.4, SPEED), (2.5, SPEED)];
    let load = [(0.0, 0.0), (0.5, 0.0), (0.8, 1.0)];
    // ω_r = R_R T/(3/2 n_p ψ_R²), per unit.
    let base = Base::new(&machine);
    let psi_r = base.psi * machine.L_M / machine.L_s();
    let slip = machine.R_R * machine.T_N / (1.5 * f64::from(machine.n_p) * psi_r * psi_r) / base.omega;
    let o = run_with((machine, inverter), Factors { r_s, r_r, ..EXACT }, seed, (&speed, &load), set);
    (SPEED - o.last_speed()) / slip
}

/// With the rotor resistance the speed is wrong by as much of the slip, unless the start finds it.
#[test]
fn a_start_finds_the_rotor_resistance_by_which_the_speed_under_load_is_right() {
    for installation in
        [(Machine::preset_11k(), Inverter::preset_11k()), (Machine::preset_2k2(), Inverter::preset_2k2()), of_15_kw()]
    {
        let errors = |prior: f64| {
            by_rotor(|r_r, seed| of_slip(installation, 1.0, r_r, seed, |s| s.drive.enhanced.prior_R_R = prior))
        };
        let (found, told) = (errors(0.2), errors(0.002));
        assert!(found.iter().all(|x| x.abs() < 0.05), "of the slip {found:?}");
        assert!(told[0] < -0.12 && told[1] > 0.12, "where it is told to be known {told:?}");
    }
}

/// The resistance of the rotor that the start finds is that of its temperature, which that of the stator shows as well: it counts
/// once.
#[test]
fn a_start_with_a_hot_machine_whose_temperature_is_followed_has_its_slip_right() {
    let hot = |s: &mut Scenario| s.drive.enhanced.winding_temperature = Some(20.0);
    for seed in 1..=3 {
        let error = of_slip((Machine::preset_11k(), Inverter::preset_11k()), 1.3, 1.3, seed, hot);
        assert!(error.abs() < 0.06, "{seed}: {error}");
    }
}

/// Legs whose pulses are 100 ns apart. Without the comparison of the legs their constant voltage turns the flux that the start has built
/// up, in twenty rotor time constants by more than 20°. In one of the twelve realisations of the noise the boosted current in which
/// the flux recovers takes the resistance and the loss of the bridge off, and the load is lost (`docs/limits.md`).
#[test]
fn a_machine_whose_flux_builds_up_within_some_hundredths_of_a_second_has_its_legs_compared() {
    let delays = GateDelays { on: [[75e-9; 2], [50e-9; 2], [100e-9; 2]], off: [[75e-9; 2], [100e-9; 2], [50e-9; 2]] };
    let x = Factors { r_r: 0.87, l_m: 1.08, dead_time: 1.1, ..EXACT };
    let load = [(0.0, 0.0), (0.3, 0.0), (0.8, 1.0)];
    let held = |compared: bool, seed| {
        run_with(of_0_4_kw(), x, seed, (&[(0.0, 0.0), (2.0, 0.0)], &load), |s| {
            s.plant.gate_delays = delays;
            s.drive.enhanced.identify_legs = compared;
        })
    };
    let within = |compared: bool, angle: f64| (1..=12).filter(|&seed| held(compared, seed).angle() < angle).count();
    assert!(within(true, 6.0) >= 11, "{}", within(true, 6.0));
    assert_eq!(within(false, 20.0), 0);
}
