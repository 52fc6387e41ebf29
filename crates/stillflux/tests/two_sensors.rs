//! Two current sensors: the channel of phase c is not read.

#![cfg(feature = "modes")]

use proptest::prelude::*;
use proptest::sample::select;
use stillflux::config::{DriveConfig, DriveParams, Scheme};
use stillflux::drive::{Drive, Fault, Measurement, Output, Reference, Status};
use stillflux::params::{Inverter, Machine};
use stillflux::scalar::{Q, Real};

fn drive<R: Real>(scheme: Scheme, current_sensors: u32) -> Drive<R> {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let params = DriveParams {
        scheme,
        current_sensors,
        offset_time: 0.002,
        magnetise_time: 0.4,
        ..DriveParams::new(&machine, &inverter)
    };
    Drive::new(DriveConfig::new(&machine, &inverter, &params).unwrap())
}

/// Steps a drive with currents that follow their references, offsets of its sensors, and whatever channel c holds.
fn run<R: Real>(mut d: Drive<R>, offset: [f64; 2], mut c: impl FnMut(u32) -> R) -> (Vec<Output<R>>, Drive<R>) {
    let outputs = (0..6000)
        .map(|k| {
            let i = d.estimate().i_dq_ref.re().to_f64();
            let wiggle = 0.003 * f64::from(k % 7) - 0.009;
            let on = !matches!(d.status(), Status::Stopped | Status::ReadingOffset);
            let (a, b) = if on { (i + wiggle, -0.5 * i + wiggle) } else { (0.0, 0.0) };
            let i_abc = [R::from_f64(a + offset[0]), R::from_f64(b + offset[1]), c(k)];
            d.step(&Measurement { i_abc, u_dc: R::from_f64(1.65) }, &Reference::Speed(R::from_f64(0.02)))
        })
        .collect();
    (outputs, d)
}

fn same<R: Real>(scheme: Scheme, held: &[f64]) {
    let zero = run(drive::<R>(scheme, 2), [0.01, -0.02], |_| R::ZERO);
    let other = run(drive::<R>(scheme, 2), [0.01, -0.02], |k| R::from_f64(held[k as usize % held.len()]));
    assert!(zero.0.iter().any(|o| o.gates_on), "{}: {:?}", R::NAME, zero.1.status());
    assert_eq!(zero.0, other.0);
    assert_eq!((zero.1.estimate(), zero.1.memory()), (other.1.estimate(), other.1.memory()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn whatever_channel_c_holds_has_no_effect(
        held in prop::collection::vec(
            prop_oneof![4 => -3.0f64..3.0, 1 => any::<f64>(), 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)], 1..50,
        ),
        scheme in select(Scheme::ALL.to_vec()),
    ) {
        same::<f32>(scheme, &held);
        same::<f64>(scheme, &held);
        same::<Q>(scheme, &held);
    }
}

#[test]
fn with_three_sensors_channel_c_is_read() {
    for &scheme in Scheme::ALL {
        let (_, d) = run(drive::<f32>(scheme, 3), [0.0; 2], |_| f32::NAN);
        assert!(matches!(d.status(), Status::Faulted { cause: Fault::Measurement, .. }), "{:?}", d.status());
    }
}

#[test]
fn offsets_of_both_channels_are_read_at_rest_and_none_of_a_third() {
    for &scheme in Scheme::ALL {
        let (_, d) = run(drive::<f64>(scheme, 2), [0.03, -0.02], |_| 0.1);
        let [a, b, c] = d.memory().i_off;
        assert!((a - 0.03).abs() < 1e-12 && (b + 0.02).abs() < 1e-12 && c == 0.0, "{a} {b} {c}");
    }
}

#[test]
fn a_number_of_sensors_that_does_not_exist_is_refused_by_name() {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let least = if cfg!(feature = "shunt") { 1 } else { 2 };
    for current_sensors in [0, least - 1, 4] {
        let params = DriveParams { current_sensors, ..DriveParams::new(&machine, &inverter) };
        let e = DriveConfig::<f32>::new(&machine, &inverter, &params).unwrap_err();
        assert!(e.field == "current_sensors" && (e.min, e.max) == (f64::from(least), 3.0), "{e}");
    }
}
