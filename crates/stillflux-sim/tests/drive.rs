//! Closed loops of drive and switching-level plant, judged on the plant's truth.

use crate::rig::{Largest, Rig};
use std::borrow::Cow;

use stillflux::base::Base;
use stillflux::config::Scheme;
use stillflux::drive::{Fault, Status};
use stillflux::params::{Inverter, Machine, Rating, Saturation, TModel};
use stillflux::si::{Arithmetic, SiDrive};
use stillflux_sim::simulate::{Change, Profile, Record, ReferenceProfile, Run, Scenario};
use stillflux_sim::{Mode, PlantParams};

struct Bench {
    scenario: Scenario,
    base: Base,
}

struct Outcome {
    record: Record,
    drive: SiDrive,
    base: Base,
}

impl Bench {
    fn new(machine: Machine, inverter: Inverter, duration: f64) -> Self {
        Self { scenario: Scenario::new(machine, inverter, duration), base: Base::new(&machine) }
    }

    /// The published scheme on the bridge of the paper, whose legs are clamped at current zero; the enhanced one on the
    /// presets, whose nodes have capacitance.
    fn of(scheme: Scheme, duration: f64) -> [Self; 2] {
        [(Machine::preset_2k2(), Inverter::preset_2k2()), (Machine::preset_11k(), Inverter::preset_11k())].map(
            |(machine, inverter)| {
                let c_out = if scheme == Scheme::Paper { 0.0 } else { inverter.c_out };
                Self::new(machine, Inverter { c_out, ..inverter }, duration).with(|s| s.drive.scheme = scheme)
            },
        )
    }

    /// Both machines under both schemes.
    fn all(duration: f64) -> [Self; 4] {
        let ([a, b], [c, d]) = (Self::of(Scheme::Paper, duration), Self::of(Scheme::Enhanced, duration));
        [a, b, c, d]
    }

    /// Speed reference in per unit.
    fn speed(mut self, points: &[(f64, f64)]) -> Self {
        self.scenario.reference = ReferenceProfile::Speed(scaled(points, self.base.omega_m));
        self
    }

    /// Load in units of rated torque.
    fn load(mut self, points: &[(f64, f64)]) -> Self {
        self.scenario.load = scaled(points, self.scenario.machine.T_N);
        self
    }

    fn with(mut self, change: impl FnOnce(&mut Scenario)) -> Self {
        change(&mut self.scenario);
        self
    }

    fn run(self) -> Outcome {
        let mut run = Run::new(Cow::Owned(self.scenario)).unwrap();
        while run.advance(u64::MAX) {}
        let (record, drive) = run.into_parts();
        Outcome { record, drive, base: self.base }
    }
}

fn scaled(points: &[(f64, f64)], base: f64) -> Profile {
    Profile::new(points.iter().map(|&(t, x)| (t, x * base)).collect()).unwrap()
}

impl Outcome {
    fn rows(&self, t0: f64, t1: f64) -> std::ops::Range<usize> {
        let at = |t: f64| self.record.t.partition_point(|&x| x < t);
        at(t0)..at(t1)
    }

    fn data(&self, name: &str) -> &[f64] {
        &self.record.columns.iter().find(|c| c.name == name).unwrap().data
    }

    fn worst(&self, name: &str, t0: f64, t1: f64, map: impl Fn(f64) -> f64) -> f64 {
        self.data(name)[self.rows(t0, t1)].iter().map(|&x| map(x).abs()).largest()
    }

    /// Largest field angle error between two times, degrees.
    fn angle(&self, t0: f64, t1: f64) -> f64 {
        self.worst("angle_error", t0, t1, f64::to_degrees)
    }

    /// Largest deviation of the true speed from a reference, per unit.
    fn speed_error(&self, t0: f64, t1: f64, reference: f64) -> f64 {
        self.worst("omega_m", t0, t1, |w| w / self.base.omega_m - reference)
    }

    fn assert_running(&self) {
        assert_eq!(self.drive.status(), Status::Running);
    }
}

/// Phase offsets that make the same error on the α and the β axis.
fn offset(i: f64) -> [f64; 3] {
    let h = 0.5 * 3f64.sqrt();
    [i, (h - 0.5) * i, (-h - 0.5) * i]
}

#[test]
fn starts_from_rest_by_itself_and_holds_speed_under_load() {
    for bench in Bench::all(6.0) {
        let o = bench.speed(&[(0.0, 0.0), (1.6, 0.0), (2.6, 0.1)]).load(&[(0.0, 0.0), (4.0, 0.0), (4.0, 1.0)]).run();
        o.assert_running();
        assert!(o.angle(1.6, 6.0) < 1.0, "{}", o.angle(1.6, 6.0));
        assert!(o.speed_error(3.5, 4.0, 0.1) < 0.002);
        assert!(o.speed_error(5.0, 6.0, 0.1) < 0.002, "{}", o.speed_error(5.0, 6.0, 0.1));
    }
}

#[test]
fn without_the_inverter_model_the_published_scheme_loses_a_load_step_at_low_speed() {
    for bench in Bench::of(Scheme::Paper, 6.0) {
        let o = bench
            .with(|s| s.drive.inverter_model = false)
            .speed(&[(0.0, 0.0), (1.6, 0.0), (1.8, 0.02)])
            .load(&[(0.0, 0.0), (4.0, 0.0), (4.0, 1.0)])
            .run();
        let faulted =
            matches!(o.drive.status(), Status::Faulted { cause: Fault::EstimateLost | Fault::OverCurrent, .. });
        assert!(faulted || o.speed_error(5.0, 6.0, 0.02) > 0.02, "{:?}", o.drive.status());
    }
}

#[test]
fn torque_mode_gives_the_torque_asked_for_at_any_imposed_speed() {
    for speed in [-0.1, 0.02, 0.5] {
        for bench in Bench::all(4.0) {
            let w = speed * bench.base.omega_m;
            let t_n = bench.scenario.machine.T_N;
            let o = bench
                .with(|s| {
                    // The dynamometer takes the shaft up once the machine is magnetised.
                    s.changes = (0..=100)
                        .map(|k| (1.6 + 0.01 * f64::from(k), Change::Speed(Some(w * f64::from(k) / 100.0))))
                        .collect();
                    s.plant.mechanics.speed = Some(0.0);
                    s.reference = ReferenceProfile::Torque(scaled(&[(0.0, 0.0), (3.0, 0.0), (3.0, 1.0)], t_n));
                })
                .run();
            o.assert_running();
            let deviation = o.worst("torque", 3.1, 4.0, |t| t / t_n - 1.0);
            assert!(deviation < 0.03, "{speed} pu: {deviation}");
            // Rated torque within 5 ms.
            let after_5_ms = o.worst("torque", 3.005, 3.006, |t| t / t_n - 1.0);
            assert!(after_5_ms < 0.1, "{speed} pu: {after_5_ms}");
        }
    }
}

/// Largest field angle error under control and deviation of rated torque in motoring, in parts of it, of a drive that is
/// started while a dynamometer holds the speed.
fn started_on_a_dynamometer(bench: Bench, speed: f64, find: bool) -> (f64, f64) {
    let (w, t_n) = (speed * bench.base.omega_m, bench.scenario.machine.T_N.copysign(speed));
    let o = bench
        .with(|s| {
            s.plant.mechanics.speed = Some(w);
            s.drive.enhanced.find_slow_rotation = find;
            s.reference = ReferenceProfile::Torque(scaled(&[(0.0, 0.0), (2.5, 0.0), (2.7, 1.0)], t_n));
        })
        .run();
    let running = o.data("status").iter().zip(o.data("angle_error")).filter(|(status, _)| **status == 3.0);
    let angle = running.map(|(_, error)| error.to_degrees().abs()).largest();
    (angle, o.worst("torque", 3.0, 4.0, |t| t / t_n - 1.0))
}

#[test]
fn a_drive_that_is_started_while_a_dynamometer_turns_the_shaft_slowly_knows_its_field() {
    for speed in [-0.04, 0.025, -0.012, 0.008, 0.004] {
        for (k, bench) in Bench::of(Scheme::Enhanced, 4.0).into_iter().enumerate() {
            let (angle, torque) = started_on_a_dynamometer(bench, speed, true);
            // At 0.004 pu the flux of the small machine is turned by just less than the 7° from which on a rotation is found:
            // 0.3 s after the load came, a third of the torque error of this angle is left.
            let most = if speed == 0.004 { 0.04 } else { 0.03 };
            assert!(angle < 15.0 && torque < most, "machine {k}, {speed} pu: {angle}° {torque}");
        }
    }
    // The negative control: 30° and more at the end of the start.
    for bench in Bench::of(Scheme::Enhanced, 4.0) {
        let (angle, _) = started_on_a_dynamometer(bench, 0.025, false);
        assert!(angle > 30.0, "taken to stand: {angle}°");
    }
}

#[test]
fn field_weakening_reaches_beyond_rated_speed_and_comes_back() {
    for bench in Bench::all(12.0) {
        let o = bench.speed(&[(0.0, 0.0), (1.6, 0.0), (4.6, 1.6), (7.0, 1.6), (10.0, 0.0)]).run();
        o.assert_running();
        assert!(o.speed_error(6.0, 7.0, 1.6) < 0.01, "{}", o.speed_error(6.0, 7.0, 1.6));
        // Back at rest half a second after the ramp; what a field that stands still without load does later is another
        // matter.
        assert!(o.speed_error(10.5, 11.0, 0.0) < 0.002, "{}", o.speed_error(10.5, 11.0, 0.0));
        assert!(o.angle(1.6, 12.0) < 6.0, "{}", o.angle(1.6, 12.0));
    }
}

/// Motors of 0.8 and 9 kW whose current at rated flux is 1.7 and 1.8 times what it would be without saturation. With an allowance for the
/// curve that does not fall with its slope (`estimate/kalman/direct.rs`) their flux is off by 11 and 6 % after the start.
#[test]
fn a_start_finds_the_flux_of_a_motor_that_saturates_steeply() {
    let small = Machine {
        R_s: 8.55,
        R_R: 5.76,
        L_sigma: 89.3e-3,
        L_M: 0.5305,
        n_p: 2,
        J: 3.15e-3,
        U_N: 400.0,
        I_N: 1.9,
        f_N: 50.0,
        T_N: 5.45,
        saturation: Some(Saturation { L_u: 1.0528, a: 0.921, S: 8.26 }),
    };
    let low = Machine {
        R_s: 2.38e-3,
        R_R: 1.26e-3,
        L_sigma: 27.9e-6,
        L_M: 223.5e-6,
        J: 34.6e-3,
        U_N: 34.0,
        I_N: 242.0,
        f_N: 100.0,
        T_N: 33.7,
        saturation: Some(Saturation { L_u: 450.9e-6, a: 22.02, S: 8.51 }),
        n_p: 2,
    };
    let bridge = Inverter::preset_2k2();
    let of_small = Inverter { u_th: 0.98, r_d: 0.3, dead_time: 2.23e-6, c_out: 0.63e-9, ..bridge };
    let of_low =
        Inverter { u_dc: 56.0, f_s: 16e3, u_th: 0.025, r_d: 0.37e-3, dead_time: 0.84e-6, c_out: 0.28e-9, ..bridge };
    for (machine, inverter) in [(small, of_small), (low, of_low)] {
        let mut rig = Rig::new(machine, inverter, |_| {});
        let standstill = rig.speed(0.0);
        let seconds = rig.run(5.0, standstill, 0.0, |drive| drive.status() == Status::Running);
        assert!(seconds < 4.0, "{seconds}");
        let [real, found] = [rig.plant.truth().psi_s, rig.drive.estimate().psi_s].map(|x| x[0].hypot(x[1]));
        let off = found / real - 1.0;
        println!("{off:.4}");
        assert!(off.abs() < 0.035, "{}: {off}", machine.I_N);
    }
}

#[test]
fn a_stored_offset_makes_the_next_start_clean() {
    for (k, bench) in Bench::all(14.0).into_iter().enumerate() {
        let base = bench.base;
        let again = || Bench::all(5.0).into_iter().nth(k).unwrap();
        // The smaller one the start of the enhanced scheme takes without a memory as well.
        let part = if k < 2 { 0.00625 } else { 0.0125 };
        let with_offset = |s: &mut Scenario| {
            s.plant.adc.offset = offset(part * base.i);
            s.drive.calibrate_offset = false;
        };
        let first = bench.with(with_offset).speed(&[(0.0, 0.0), (1.6, 0.02)]).run();
        let memory = first.drive.memory();
        let second =
            again().with(with_offset).with(|s| s.memory = Some(memory)).speed(&[(0.0, 0.0), (1.6, 0.005)]).run();
        second.assert_running();
        assert!(second.angle(1.6, 5.0) < 5.0, "stored: {}", second.angle(1.6, 5.0));
        let without = again().with(with_offset).speed(&[(0.0, 0.0), (1.6, 0.005)]).run();
        let (without, second) = (without.angle(1.6, 5.0), second.angle(1.6, 5.0));
        assert!(without > 2.0 * second, "machine {k}: not stored {without}, stored {second}");
    }
}

#[test]
fn offset_reading_at_rest_removes_the_offset_before_the_first_torque() {
    for bench in Bench::all(4.0) {
        let i = 0.00625 * bench.base.i;
        let o = bench.with(|s| s.plant.adc.offset = offset(i)).speed(&[(0.0, 0.0), (1.6, 0.02)]).run();
        o.assert_running();
        let lsb = 2.5 * o.base.i / 2048.0;
        for (found, put) in o.drive.memory().i_off.iter().zip(offset(i)) {
            assert!((found - put).abs() < lsb, "{found} {put}");
        }
        assert!(o.angle(1.6, 4.0) < 2.0, "{}", o.angle(1.6, 4.0));
    }
}

/// Field angle error and speed of each arithmetic over a minute at zero stator frequency (offset found at low
/// speed before), each against the truth of its own plant, compared with double precision. The paths of the three runs part (nothing ties
/// the absolute angle of a field at standstill), their errors must not.
#[test]
fn f32_and_fixed_point_stay_with_f64_over_a_minute_at_zero_frequency() {
    for k in 0..2 {
        let run = |arithmetic| {
            let [a, b] = Bench::of(Scheme::Paper, 80.0);
            let bench = if k == 0 { a } else { b };
            bench
                .with(|s| {
                    s.arithmetic = arithmetic;
                    s.plant.adc.offset = offset(0.00625 * Base::new(&s.machine).i);
                    s.drive.calibrate_offset = false;
                    s.signals = Some(["angle_error", "omega_m"].map(String::from).to_vec());
                })
                .speed(&[(0.0, 0.0), (1.6, 0.0), (1.8, 0.02), (17.0, 0.02), (18.0, 0.0)])
                .run()
        };
        let reference = run(Arithmetic::F64);
        reference.assert_running();
        assert!(reference.angle(19.0, 80.0) < 5.0);
        for arithmetic in [Arithmetic::F32, Arithmetic::Q] {
            let other = run(arithmetic);
            other.assert_running();
            let rows = reference.rows(19.0, 80.0);
            let difference = |name: &str| {
                let (x, y) = (&reference.data(name)[rows.clone()], &other.data(name)[rows.clone()]);
                x.iter().zip(y).map(|(x, y)| (x - y).abs()).largest()
            };
            let angle = difference("angle_error").to_degrees();
            let speed = difference("omega_m") / reference.base.omega_m;
            assert!(angle < 0.5, "{arithmetic:?}: {angle}°");
            assert!(speed < 0.002, "{arithmetic:?}: {speed}");
        }
    }
}

/// Machines, switching frequencies, dead times and dc links that nothing was tuned for: the defaults derive from the
/// machine's data.
fn others() -> [(Machine, Inverter); 8] {
    let rating = |n_p, j, u, i, f, t| Rating { n_p, J: j, U_N: u, I_N: i, f_N: f, T_N: t };
    let t_model = |r_s, r_r, l_l, l_m| TModel { R_s: r_s, R_r: r_r, L_ls: l_l, L_lr: l_l, L_m: l_m };
    let inverter = |u_dc, f_s, u_th, r_d, dead_time| Inverter {
        u_dc,
        f_s,
        u_th,
        r_d,
        dead_time,
        c_out: 3e-9,
        ..Inverter::preset_2k2()
    };
    let traction =
        Machine::from_t_model(t_model(0.013, 0.01, 60e-6, 1.5e-3), rating(2, 0.02, 34.0, 120.0, 100.0, 16.0));
    let large = Machine::from_t_model(t_model(0.03, 0.018, 0.26e-3, 14e-3), rating(2, 0.9, 400.0, 135.0, 50.0, 480.0));
    let (small, preset) = (Machine::preset_2k2(), Inverter::preset_2k2());
    [
        (traction, inverter(56.0, 16e3, 0.05, 0.002, 0.8e-6)),
        (large, inverter(560.0, 5e3, 1.2, 0.008, 3e-6)),
        (small, Inverter { f_s: 4e3, ..preset }),
        (small, Inverter { f_s: 20e3, ..preset }),
        // With 1 nF and more this one is lost where ω_s would be zero: the ripple of the dead time is half of the knee.
        (small, Inverter { dead_time: 4e-6, c_out: 0.5e-9, ..preset }),
        (small, Inverter { dead_time: 0.0, f_clk: 0.0, ..preset }),
        (small, Inverter { u_dc: 320.0, ..preset }),
        (Machine { J: 5.0 * small.J, ..small }, preset),
    ]
}

#[test]
fn defaults_serve_other_machines_frequencies_and_dead_times() {
    for (machine, inverter) in others() {
        let o = Bench::new(machine, inverter, 12.0)
            .with(|s| s.plant.adc.noise = 0.004 * machine.I_N)
            .speed(&[(0.0, 0.0), (2.0, 0.0), (2.5, 0.02), (5.0, 0.02), (6.0, 0.0)])
            .load(&[(0.0, 0.0), (8.0, 0.0), (8.0, 1.0)])
            .run();
        o.assert_running();
        assert!(o.angle(2.0, 12.0) < 15.0, "{}", o.angle(2.0, 12.0));
        assert!(o.speed_error(9.5, 12.0, 0.0) < 0.002, "{}", o.speed_error(9.5, 12.0, 0.0));
    }
}

#[test]
fn other_machines_hold_torque_at_low_speed_in_every_quadrant() {
    hold_torque_in_every_quadrant(&others());
}

#[test]
#[ignore = "slow: make test-slow"]
fn other_machines_hold_torque_at_low_speed_in_every_quadrant_on_legs_without_capacitance() {
    hold_torque_in_every_quadrant(&others().map(|(m, i)| (m, Inverter { c_out: 0.0, ..i })));
}

/// In motoring, in regeneration, and where the stator frequency would be zero.
fn hold_torque_in_every_quadrant(drives: &[(Machine, Inverter)]) {
    for &(machine, inverter) in drives {
        // On nodes with capacitance a slow field turns by some degrees at each zero of a phase current, and that is speed.
        let speed_max = if inverter.c_out > 0.0 { 0.008 } else { 0.003 };
        // What the inverter model leaves of the voltage lost at current zero turns the field in proportion to that loss.
        let angle_max = 1.0 + 60.0 * inverter.dead_time * inverter.f_s;
        let base = Base::new(&machine);
        let torque = machine.T_N / base.torque;
        let slip = torque * (machine.R_R / base.z) * (machine.L_s() / machine.L_M).powi(2);
        for (omega, load) in [(0.05, 1.0), (0.05, -1.0), (0.0, 0.8), (-slip, 1.0), (slip, -1.0)] {
            let o = Bench::new(machine, inverter, 12.0)
                .with(|s| s.plant.adc.noise = 0.004 * machine.I_N)
                .speed(&[(0.0, 0.0), (2.0, 0.0), (3.5, omega)])
                .load(&[(0.0, 0.0), (4.0, 0.0), (5.0, load)])
                .run();
            o.assert_running();
            assert!(o.angle(7.0, 12.0) < angle_max, "{omega}, {load}: {}", o.angle(7.0, 12.0));
            assert!(
                o.speed_error(7.0, 12.0, omega) < speed_max,
                "{omega}, {load}: {}",
                o.speed_error(7.0, 12.0, omega)
            );
        }
    }
}

/// Leakage and magnetising inductance, of the parameters, and the speed error after minutes of rated load in one point;
/// no speed error where the field is lost on the way.
fn after_minutes_of_load(omega: f64, seed: u64, hold: bool) -> ([f64; 2], Option<f64>) {
    const END: f64 = 200.0;
    let machine = Machine::preset_2k2();
    let o = Bench::new(machine, Inverter::preset_2k2(), END)
        .with(|s| {
            s.plant.seed = seed;
            s.plant.adc.noise = 0.004 * machine.I_N;
            s.plant.adc.offset = [0.01, -0.006, -0.004].map(|part| part * machine.I_N);
            s.drive.enhanced.hold_inductances = hold;
        })
        .speed(&[(0.0, 0.0), (2.0, 0.0), (4.0, omega)])
        .load(&[(0.0, 0.0), (4.0, 0.0), (6.0, 1.0)])
        .run();
    let memory = o.drive.memory();
    let error = (o.drive.status() == Status::Running).then(|| o.speed_error(END - 50.0, END, omega));
    ([memory.L_sigma / machine.L_sigma, memory.L_M / machine.L_M], error)
}

#[test]
fn minutes_of_steady_load_leave_the_inductances_where_they_are() {
    for (omega, seed) in [(0.01, 3), (-0.06, 4)] {
        let (inductances, error) = after_minutes_of_load(omega, seed, true);
        assert!(inductances.iter().all(|x| (x - 1.0).abs() < 0.05), "{omega}: {inductances:?}");
        assert!(error.is_some_and(|error| error < 0.001), "{omega}: {error:?}");
    }
}

/// The negative control of the test above: by how much the leakage walks off, and whether the field is lost with it, differs
/// by realisation.
#[test]
#[ignore = "slow: make test-slow"]
fn minutes_of_steady_load_carry_the_leakage_away_where_it_is_corrected_always() {
    let ([leakage, _], error) = after_minutes_of_load(-0.06, 3, false);
    assert!((leakage - 1.0).abs() > 0.25, "corrected always: {leakage}");
    assert!(error.is_none_or(|error| error > 0.002), "corrected always: {error:?}");
}

/// Largest angle error of a drive that stands beside `ω_s = 0` under rated load in regeneration for 18 s, with dead times of
/// the legs that are some nanoseconds longer and shorter than told; 180 if it is lost.
fn beside_the_line(delay: [f64; 3], seed: u64, omega_s_min: Option<f64>) -> f64 {
    let inverter = Inverter { leg_delay: delay.map(|t| [t, -t]), ..Inverter::preset_2k2() };
    let o = Bench::new(Machine::preset_2k2(), Inverter::preset_2k2(), 22.0)
        .with(|s| {
            s.plant = PlantParams::new(s.machine, inverter);
            s.plant.seed = seed;
            s.plant.adc.noise = 0.004 * s.machine.I_N;
            s.drive.enhanced.identify_legs = false;
            if let Some(a) = omega_s_min {
                s.drive.enhanced.omega_s_min = a * s.machine.omega_sR();
            }
            s.signals = Some(vec!["angle_error".into()]);
        })
        .speed(&[(0.0, 0.0), (1.6, 0.0), (3.0, 0.04)])
        .load(&[(0.0, 0.0), (3.5, 0.0), (4.5, -1.0)])
        .run();
    if o.drive.status() == Status::Running { o.angle(1.6, 22.0) } else { 180.0 }
}

#[test]
fn the_flux_shift_holds_the_line_with_legs_that_differ_by_some_nanoseconds() {
    let legs = [[-5e-9, 5e-9, 0.0], [5e-9, 0.0, -5e-9]];
    for (delay, seed) in legs.into_iter().zip(1..) {
        let kept = beside_the_line(delay, seed, None);
        assert!(kept < 4.0, "{delay:?}: {kept}");
        // The negative control: a field that turns half as fast. What a constant voltage turns it by is inverse to that; of 48
        // realisations 44 are lost, the others leave the bound by more than twice.
        let slow = beside_the_line(delay, seed, Some(0.006));
        assert!(slow > 8.0, "{delay:?}: {slow}");
    }
}

/// What moves the flux while the load comes through the range of the flux shift loses every one of these runs: its low-pass
/// is tested there ([`stillflux::control::shift`]), a shaft that runs away is seen here.
#[test]
fn a_load_that_comes_as_the_offsets_step_is_held_at_rest() {
    let mut kept = 0;
    for torque in [-0.4, -0.6, -0.8] {
        for seed in 1..4 {
            let bench = Bench::new(Machine::preset_2k2(), Inverter::preset_2k2(), 5.0);
            // 1 % of rated peak current.
            let step = offset(0.01 * bench.base.i / 2f64.sqrt());
            let o = bench
                .with(|s| {
                    s.plant.seed = seed;
                    s.plant.adc.noise = 0.004 * s.machine.I_N;
                    s.changes = vec![(1.6, Change::CurrentOffset(step))];
                })
                .speed(&[(0.0, 0.0)])
                .load(&[(0.0, 0.0), (1.6, 0.0), (2.6, torque)])
                .run();
            kept += u32::from(
                o.drive.status() == Status::Running && o.worst("omega_m", 1.6, 5.0, |w| w / o.base.omega_m) < 0.2,
            );
        }
    }
    assert!(kept >= 8, "{kept} of 9");
}

#[test]
fn averaged_mode_runs_the_same_drive() {
    for bench in Bench::all(6.0) {
        let o = bench
            .with(|s| s.plant = PlantParams { mode: Mode::Averaged, ..s.plant })
            .speed(&[(0.0, 0.0), (1.6, 0.0), (2.0, 0.05)])
            .load(&[(0.0, 0.0), (4.0, 0.0), (4.0, 1.0)])
            .run();
        o.assert_running();
        assert!(o.angle(1.6, 6.0) < 2.0, "{}", o.angle(1.6, 6.0));
    }
}

#[test]
fn confidence_falls_where_nothing_is_observed_and_an_unknown_offset_remains() {
    let [bench, _] = Bench::of(Scheme::Paper, 60.0);
    let o = bench.with(|s| s.drive.paper.offset_estimator = false).run();
    let confidence = o.data("estimate.confidence");
    let (early, late) = (o.rows(2.0, 2.1).start, o.rows(59.0, 60.0).start);
    assert!(confidence[early] > 0.7 && confidence[late] < 0.5, "{} {}", confidence[early], confidence[late]);
}

#[test]
fn an_unknown_signal_and_a_descending_profile_are_refused() {
    let [bench, ..] = Bench::all(1.0);
    let s = bench.with(|s| s.signals = Some(vec!["nonsense".into()])).scenario;
    let error = Run::new(Cow::Owned(s)).err().unwrap();
    assert_eq!(error.field(), "signals");
    assert!(error.to_string().starts_with("signals: \"nonsense\" is not one of psi_s, "), "{error}");
    assert!(Profile::new(vec![(1.0, 0.0), (0.5, 0.0)]).is_err());
}
