//! Whatever the ADC delivers: duties stay in range, numbers stay finite, faults latch with their cause.

use proptest::prelude::*;
use proptest::sample::select;
use stillflux::config::{DriveConfig, DriveParams, Scheme};
use stillflux::drive::{Drive, Fault, Measurement, Memory, Reference, Status};
#[cfg(feature = "legs")]
use stillflux::inverter::Legs;
use stillflux::params::{Inverter, Machine};
use stillflux::scalar::{Q, Real};
use stillflux::space::AlphaBeta;

const SCHEMES: &[Scheme] = Scheme::ALL;

fn drive<R: Real>(scheme: Scheme) -> Drive<R> {
    limited(scheme, 2.2)
}

/// A drive with a largest speed, per unit.
fn limited<R: Real>(scheme: Scheme, omega_max: f64) -> Drive<R> {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    // A short start-up reaches every stage within a test.
    let params = DriveParams {
        scheme,
        offset_time: 0.002,
        magnetise_time: 0.4,
        u_dc_min: 1.0,
        omega_max: omega_max * machine.omega_sR() / f64::from(machine.n_p),
        ..DriveParams::new(&machine, &inverter)
    };
    Drive::new(DriveConfig::new(&machine, &inverter, &params).unwrap())
}

fn healthy<R: Real>() -> Measurement<R> {
    Measurement { i_abc: [R::ZERO; 3], u_dc: R::from_f64(1.65) }
}

/// Steps until the drive runs; the currents that magnetisation would see are handed to it.
fn running<R: Real>(scheme: Scheme) -> Drive<R> {
    started(drive(scheme))
}

fn started<R: Real>(mut d: Drive<R>) -> Drive<R> {
    while d.status() != Status::Running {
        let i = if d.status() == Status::Magnetising { d.estimate().i_dq_ref.re() } else { R::ZERO };
        let half = i * R::HALF;
        d.step(&Measurement { i_abc: [i, -half, -half], u_dc: R::from_f64(1.65) }, &Reference::Speed(R::ZERO));
        assert!(!matches!(d.status(), Status::Faulted { .. }), "{:?}", d.status());
    }
    d
}

fn check<R: Real>(d: &mut Drive<R>, m: &Measurement<R>, reference: &Reference<R>) {
    let out = d.step(m, reference);
    assert!(!(out.gates_on && matches!(d.status(), Status::Faulted { .. })), "{:?}", d.status());
    for duty in out.duty {
        assert!(duty >= R::ZERO && duty <= R::ONE, "{duty:?}");
    }
    let e = d.estimate();
    for x in [
        e.speed.omega_m,
        e.speed.omega_s,
        e.torque,
        e.r_s,
        e.r_r,
        e.confidence,
        e.flux.magnitude,
        e.epsilon,
        e.innovation,
        e.nis,
        e.angle_deviation,
    ] {
        assert!(x.is_finite(), "{e:?}");
    }
    assert!(e.flux.psi_s.is_finite() && e.u_off.is_finite() && e.i_dq_ref.is_finite());
    assert!(e.confidence >= R::ZERO && e.confidence <= R::ONE);
    assert!(e.nis >= R::ZERO && e.angle_deviation >= R::ZERO);
}

fn any_f32() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -2.2f32..2.2, 1 => any::<f32>(), 1 => Just(f32::NAN), 1 => Just(f32::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn f32_survives_any_measurement(
        samples in prop::collection::vec((any_f32(), any_f32(), any_f32(), any_f32(), any_f32()), 1..200),
        reset in any::<bool>(), scheme in select(SCHEMES.to_vec()),
    ) {
        let mut d = running::<f32>(scheme);
        for (a, b, c, u, w) in samples {
            check(&mut d, &Measurement { i_abc: [a, b, c], u_dc: u }, &Reference::Speed(w));
            if reset { d.reset(); }
        }
    }

    #[test]
    fn currents_within_range_never_make_f32_or_q_leave_their_numbers(
        samples in prop::collection::vec((-1.2f64..1.2, -1.2f64..1.2, 1.2f64..2.2, -3.0f64..3.0), 400),
        scheme in select(SCHEMES.to_vec()),
    ) {
        let (mut f, mut q) = (running::<f32>(scheme), running::<Q>(scheme));
        for (a, b, u, w) in samples {
            let i = [a, b, -a - b];
            check(&mut f, &Measurement { i_abc: i.map(Real::from_f64), u_dc: u as f32 }, &Reference::Speed(w as f32));
            let r = Reference::Torque(Q::from_f64(w));
            check(&mut q, &Measurement { i_abc: i.map(Real::from_f64), u_dc: Q::from_f64(u) }, &r);
        }
    }

    #[test]
    fn q_survives_any_bits(
        samples in prop::collection::vec(any::<[i32; 5]>(), 1..200), scheme in select(SCHEMES.to_vec()),
    ) {
        let mut d = running::<Q>(scheme);
        for [a, b, c, u, w] in samples {
            let m = Measurement { i_abc: [a, b, c].map(Q::from_bits), u_dc: Q::from_bits(u) };
            check(&mut d, &m, &Reference::Speed(Q::from_bits(w)));
            d.reset();
        }
    }
}

#[test]
fn each_bad_measurement_gives_its_fault_blocks_the_gates_and_latches() {
    let ok = healthy::<f32>();
    let cases = [
        (Measurement { i_abc: [2.4, -1.2, -1.2], ..ok }, Fault::OverCurrent),
        (Measurement { i_abc: [2.6, -1.3, -1.3], ..ok }, Fault::Measurement),
        (Measurement { i_abc: [f32::NAN, 0.0, 0.0], ..ok }, Fault::Measurement),
        (Measurement { u_dc: f32::NAN, ..ok }, Fault::Measurement),
        (Measurement { u_dc: f32::INFINITY, ..ok }, Fault::Measurement),
        (Measurement { u_dc: 0.0, ..ok }, Fault::UnderVoltage),
        (Measurement { u_dc: 2.6, ..ok }, Fault::OverVoltage),
    ];
    for ((bad, cause), scheme) in cases.into_iter().flat_map(|case| SCHEMES.iter().map(move |&scheme| (case, scheme))) {
        let mut d = running::<f32>(scheme);
        let out = d.step(&bad, &Reference::Speed(0.0));
        assert!(out.gates_on && d.status() == Status::Running, "a single one is bridged: {bad:?}");
        let period = d.period() + 1;
        let out = d.step(&bad, &Reference::Speed(0.0));
        assert_eq!(d.status(), Status::Faulted { cause, period }, "{bad:?}");
        assert!(!out.gates_on && out.duty == [0.5; 3]);
        let out = d.step(&ok, &Reference::Speed(0.0));
        assert_eq!(d.status(), Status::Faulted { cause, period }, "latched");
        assert!(!out.gates_on);
        d.reset();
        assert_eq!(d.status(), Status::Stopped);
        d.step(&ok, &Reference::Speed(0.0));
        // A supply that failed leaves everything learned as it was.
        let supply = matches!(cause, Fault::UnderVoltage | Fault::OverVoltage);
        let begins = if supply { Status::Magnetising } else { Status::ReadingOffset };
        assert_eq!(d.status(), begins, "starts again after the reset");
    }
}

#[test]
fn a_stopped_drive_waits_for_its_link_and_a_start_without_it_is_a_fault() {
    let empty = Measurement { u_dc: 0.0, ..healthy::<f32>() };
    for &scheme in SCHEMES {
        let mut d = drive::<f32>(scheme);
        for _ in 0..1000 {
            assert!(!d.step(&empty, &Reference::Stop).gates_on && d.status() == Status::Stopped, "{:?}", d.status());
        }
        d.step(&healthy(), &Reference::Speed(0.0));
        assert_eq!(d.status(), Status::ReadingOffset, "starts once it is charged");
        d.step(&healthy(), &Reference::Stop);
        d.step(&empty, &Reference::Speed(0.0));
        assert!(matches!(d.status(), Status::Faulted { cause: Fault::UnderVoltage, .. }), "{:?}", d.status());
        d.reset();
        let beyond = Measurement { u_dc: 2.6, ..empty };
        for _ in 0..2 {
            d.step(&beyond, &Reference::Stop);
        }
        assert!(matches!(d.status(), Status::Faulted { cause: Fault::OverVoltage, .. }), "{:?}", d.status());
    }
}

#[test]
fn a_reference_that_is_not_finite_is_a_fault_of_its_own() {
    for &scheme in SCHEMES {
        let mut d = running::<f32>(scheme);
        d.step(&healthy(), &Reference::Torque(f32::NAN));
        assert!(matches!(d.status(), Status::Faulted { cause: Fault::Reference, .. }));
    }
}

#[test]
fn an_offset_at_rest_beyond_a_healthy_sensor_is_a_fault() {
    for &scheme in SCHEMES {
        let mut d = drive::<f64>(scheme);
        let biased = Measurement { i_abc: [0.3, 0.0, 0.0], ..healthy() };
        for _ in 0..30 {
            d.step(&biased, &Reference::Speed(0.0));
        }
        assert!(matches!(d.status(), Status::Faulted { cause: Fault::CurrentOffset, .. }));
    }
}

#[test]
fn readings_beyond_any_square_of_fixed_point_are_a_fault() {
    let bits = [i32::MIN, i32::MAX, i32::MIN + 1].map(Q::from_bits);
    for &scheme in SCHEMES {
        for i_abc in (0..27).map(|k| [bits[k / 9], bits[k / 3 % 3], bits[k % 3]]) {
            let mut d = running::<Q>(scheme);
            let wild = Measurement { i_abc, ..healthy() };
            d.step(&wild, &Reference::Speed(Q::ZERO));
            let out = d.step(&wild, &Reference::Speed(Q::ZERO));
            assert!(!out.gates_on && matches!(d.status(), Status::Faulted { .. }), "{i_abc:?}: {:?}", d.status());
        }
    }
}

#[cfg(feature = "supervision")]
#[test]
fn a_stamp_that_stands_still_keeps_no_gate_on() {
    let (ok, hold) = (healthy::<f32>(), Reference::Speed(0.0));
    for &scheme in SCHEMES {
        let begin = || {
            let mut d = running::<f32>(scheme);
            assert!(d.step_at(7, &ok, &hold).is_some_and(|out| out.gates_on));
            assert!(d.step_at(7, &ok, &hold).is_none(), "its duties stay");
            d
        };
        // A stop, and a reference that is no number, do not wait for the counter.
        for (reference, status) in [(Reference::Stop, None), (Reference::Torque(f32::NAN), Some(Fault::Reference))] {
            let mut d = begin();
            assert!(d.step_at(7, &ok, &reference).is_some_and(|out| !out.gates_on));
            match (d.status(), status) {
                (Status::Stopped, None) => {}
                (Status::Faulted { cause, .. }, Some(of)) => assert_eq!(cause, of),
                other => panic!("{other:?}"),
            }
        }
        // The fault of the calls blocks in its own call, and in all that follow.
        let mut d = begin();
        let first = (0..20).find_map(|_| d.step_at(7, &ok, &hold)).expect("no fault");
        assert!(!first.gates_on && matches!(d.status(), Status::Faulted { cause: Fault::Timing, .. }));
        for _ in 0..20 {
            assert!(d.step_at(7, &ok, &hold).is_some_and(|out| !out.gates_on));
        }
        d.reset();
        assert!(d.step_at(7, &ok, &Reference::Stop).is_some_and(|out| !out.gates_on));
    }
}

#[test]
fn a_bridge_that_is_blocked_makes_no_torque_voltage_or_current_in_the_estimate() {
    for &scheme in SCHEMES {
        let mut d = running::<f32>(scheme);
        for _ in 0..40 {
            let e = d.estimate();
            let i_abc = e.flux.field.to_stator(&e.i_dq_ref).to_phases();
            d.step(&Measurement { i_abc, ..healthy() }, &Reference::Torque(0.5));
        }
        assert!(d.estimate().torque > 0.1 && d.estimate().u_s.norm_sq() > 0.0);
        d.step(&healthy(), &Reference::Stop);
        let e = d.estimate();
        assert_eq!((e.torque, e.u_s.norm_sq(), e.i_dq.norm_sq(), e.i_dq_ref.norm_sq()), (0.0, 0.0, 0.0, 0.0));
    }
}

#[test]
fn a_start_that_fails_with_what_is_remembered_is_not_repeated_with_it() {
    for &scheme in SCHEMES {
        let (ok, hold) = (healthy::<f32>(), Reference::Speed(0.0));
        let mut d = running::<f32>(scheme);
        d.step(&ok, &Reference::Stop);
        d.step(&ok, &hold);
        assert_eq!(d.status(), Status::Magnetising, "fresh");
        for _ in 0..2 {
            d.step(&Measurement { i_abc: [f32::NAN; 3], ..ok }, &hold);
        }
        assert!(matches!(d.status(), Status::Faulted { cause: Fault::Measurement, .. }));
        d.reset();
        d.step(&ok, &hold);
        assert_eq!(d.status(), Status::ReadingOffset);
    }
}

#[test]
fn a_memory_is_taken_while_the_bridge_is_blocked_only() {
    for &scheme in SCHEMES {
        let mut d = running::<f32>(scheme);
        // Another resistance than the one it has found, within the admissible range.
        let told = drive::<f32>(scheme).memory().r_s;
        let r_s = if d.memory().r_s > 0.8 * told { 0.5 * told } else { told };
        let memory = Memory { r_s, ..d.memory() };
        let is_taken = |d: &Drive<f32>| (d.memory().r_s / r_s - 1.0).abs() < 0.2;
        assert!(!d.restore(&memory) && !is_taken(&d));
        d.step(&healthy(), &Reference::Stop);
        assert!(d.restore(&memory) && is_taken(&d));
    }
}

#[test]
fn a_sample_that_is_bridged_is_the_current_with_its_offset() {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    for &scheme in SCHEMES {
        let params = DriveParams {
            scheme,
            calibrate_offset: false,
            magnetise_time: 0.4,
            ..DriveParams::new(&machine, &inverter)
        };
        let mut d = Drive::<f64>::new(DriveConfig::new(&machine, &inverter, &params).unwrap());
        let r_s = d.memory().r_s;
        // An offset of 0.05 pu along the a-axis, known from an earlier run.
        d.restore(&Memory { u_off: AlphaBeta::new(-0.05 * r_s, 0.0), ..d.memory() });
        let mut d = started(d);
        let i_abc = [0.5, -0.25, -0.25];
        let step = |d: &mut Drive<f64>, i_abc| {
            d.step(&Measurement { i_abc, ..healthy() }, &Reference::Speed(0.0));
            d.estimate().i_s
        };
        let before = step(&mut d, i_abc);
        // What the start has made of it: the currents that are handed to it are those of no machine.
        let known = d.memory();
        let offset = -known.u_off.re() / known.r_s;
        assert!(offset.abs() > 0.02, "{scheme:?}: {offset}");
        assert!((before.re() - (0.5 - offset)).abs() < 1e-3, "{scheme:?}: {before:?}, {offset}");
        let bridged = step(&mut d, [f64::NAN; 3]);
        assert!((bridged - before).norm_sq().sqrt() < 1e-3, "{scheme:?}: {before:?} {bridged:?}");
    }
}

#[test]
fn a_stop_blocks_the_gates_at_once() {
    for &scheme in SCHEMES {
        let mut d = running::<f32>(scheme);
        let out = d.step(&healthy(), &Reference::Stop);
        assert!(!out.gates_on && d.status() == Status::Stopped);
    }
}

/// What a drive holds after it was handed `x` for everything that a memory stores.
fn restored<R: Real>(scheme: Scheme, x: R) -> Vec<f64> {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let params = DriveParams { scheme, calibrate_offset: false, ..DriveParams::new(&machine, &inverter) };
    let mut d = Drive::<R>::new(DriveConfig::new(&machine, &inverter, &params).unwrap());
    let r_s = d.memory().r_s.to_f64();
    d.restore(&Memory {
        u_off: AlphaBeta::new(x, -x),
        r_s: x,
        i_off: [x; 3],
        loss_error: x,
        knee: x,
        leakage: x,
        inv_l_m: x,
        #[cfg(feature = "legs")]
        legs: Legs { even: AlphaBeta::new(x, -x), odd: AlphaBeta::new(-x, x) },
    });
    let m = d.memory();
    let found = [
        m.u_off.re(),
        m.u_off.im(),
        m.r_s * R::from_f64(1.0 / r_s),
        m.i_off[0],
        m.loss_error,
        m.leakage,
        m.inv_l_m,
        #[cfg(feature = "legs")]
        m.legs.even.re(),
        #[cfg(feature = "legs")]
        m.legs.odd.re(),
    ];
    found.into_iter().map(R::to_f64).collect()
}

fn assert_limited<R: Real>(scheme: Scheme, x: R) {
    // An offset voltage of 5 % is that of a sensor offset beyond any healthy one; r_s relative to the parameter.
    let limits = [
        (-0.05, 0.05),
        (-0.05, 0.05),
        (0.4, 2.0),
        (-0.15, 0.15),
        (-0.8, 0.8),
        (0.5, 2.0),
        (0.6, 1.6),
        (-0.01, 0.01),
        (-0.01, 0.01),
    ];
    let found = restored(scheme, x);
    for (k, (value, (lo, hi))) in found.iter().zip(limits).enumerate() {
        assert!((lo - 1e-6..=hi + 1e-6).contains(value), "{scheme:?} {}: {x:?} became {value} at {k}", R::NAME);
    }
}

#[test]
fn whatever_a_memory_holds_a_drive_takes_no_more_than_its_limits() {
    for &scheme in SCHEMES {
        for x in [0.06, -0.06, 1.0, -1.0, 100.0, -100.0] {
            assert_limited(scheme, x as f32);
            assert_limited(scheme, x);
            assert_limited(scheme, Q::from_f64(x));
        }
        for x in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_limited(scheme, x);
        }
    }
}

/// Supervision finds its faults after the duties of the period are known.
#[test]
fn the_period_of_a_fault_has_its_gates_off_whatever_the_cause() {
    let ok = healthy::<f32>();
    for &scheme in SCHEMES {
        // Currents as asked for whatever the voltage: the estimate leaves its range without any measurement being wrong.
        let mut d = started(limited::<f32>(scheme, 0.3));
        let mut periods = 0;
        let last = loop {
            let e = d.estimate();
            let i_abc = e.flux.field.to_stator(&e.i_dq_ref).to_phases();
            let out = d.step(&Measurement { i_abc, ..ok }, &Reference::Torque(0.5));
            periods += 1;
            assert!(periods < 100_000, "{scheme:?}: no fault");
            if matches!(d.status(), Status::Faulted { .. }) {
                break out;
            }
            assert!(out.gates_on);
        };
        assert!(
            matches!(d.status(), Status::Faulted { cause: Fault::EstimateLost | Fault::OverSpeed, .. }),
            "{:?}",
            d.status()
        );
        assert!(!last.gates_on && last.duty == [0.5; 3], "{scheme:?}");
    }
}
