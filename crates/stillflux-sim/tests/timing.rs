//! Updates of the duties at both extremes of the carrier and in every n-th of its periods: the drive knows the voltage that
//! the bridge applies.

use crate::rig::Largest;
use std::borrow::Cow;

use stillflux::base::Base;
use stillflux::config::Scheme;
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine};
use stillflux_sim::simulate::{Profile, ReferenceProfile, Run, Scenario};

/// Largest error of the field angle, °, and mean error of the voltage, V, at a speed, per unit, under a load in units of
/// rated torque.
fn held(
    (machine, told, real): (Machine, Inverter, Inverter),
    scheme: Scheme,
    (omega, load): (f64, f64),
    discontinuous_above: Option<f64>,
) -> (f64, f64) {
    let mut s = Scenario::new(machine, told, 8.0);
    let w = omega * Base::new(&machine).omega_m;
    s.plant.inverter = real;
    s.drive.discontinuous_above = discontinuous_above;
    s.drive.scheme = scheme;
    s.reference = ReferenceProfile::Speed(Profile::new(vec![(0.0, 0.0), (1.6, 0.0), (2.0 + omega.abs(), w)]).unwrap());
    s.load = Profile::new(vec![(0.0, 0.0), (3.0, 0.0), (3.2, load * machine.T_N)]).unwrap();
    s.plant.adc.noise = 0.004 * machine.I_N;
    s.plant.adc.offset = [0.01 * machine.I_N, -0.01 * machine.I_N, 0.0];
    s.record_every = 1;
    s.signals = Some(["angle_error", "u_s", "estimate.u_s", "i_s"].map(String::from).to_vec());
    let mut run = Run::new(Cow::Owned(s)).unwrap();
    while run.advance(u64::MAX) {}
    assert_eq!(run.drive().status(), Status::Running, "{omega} {load}: {:?}", run.drive().fault());
    let r = run.record();
    let of = |name: &str| &r.columns.iter().find(|c| c.name == name).unwrap().data;
    let (angle, u, estimate, i) = (of("angle_error"), of("u_s"), of("estimate.u_s"), of("i_s"));
    let late: Vec<usize> = (0..r.t.len()).filter(|&k| r.t[k] > 4.0).collect();
    let worst = late.iter().map(|&k| angle[k].to_degrees().abs()).largest();
    // Along the current: what would be taken for a resistance. The voltage of the terminals of the plant is that of the
    // period which ends with the row; the drive's has its loss in r_d left in.
    let along = |k: usize| {
        let size = i[2 * k].hypot(i[2 * k + 1]);
        let error = [0, 1].map(|j| estimate[2 * k + j] - real.r_d * i[2 * k + j] - u[2 * k + j]);
        (error[0] * i[2 * k] + error[1] * i[2 * k + 1]) / size
    };
    #[allow(clippy::cast_precision_loss)]
    let mean = late.iter().map(|&k| along(k)).sum::<f64>() / late.len() as f64;
    (worst, mean)
}

fn machines() -> [(Machine, Inverter); 2] {
    [(Machine::preset_2k2(), Inverter::preset_2k2()), (Machine::preset_11k(), Inverter::preset_11k())]
}

#[test]
fn every_rate_of_the_control_holds_low_speed_under_load() {
    for (machine, inverter) in machines() {
        for (half_periods, f_s) in [(1, 10e3), (4, 10e3), (6, 16e3)] {
            let inverter = Inverter { half_periods, f_s, ..inverter };
            for (point, scheme) in [((-0.02, 0.6), Scheme::Enhanced), ((0.1, 0.5), Scheme::Paper)] {
                let (angle, volts) = held((machine, inverter, inverter), scheme, point, None);
                println!("{half_periods} {f_s} {point:?} {scheme:?}: {angle:.2}°, {volts:.3} V");
                assert!(angle < 3.0 && volts.abs() < 0.35, "{half_periods} {f_s} {point:?}: {angle}°, {volts} V");
            }
        }
    }
}

/// The negative control: a drive that is told a single update on a plant with a double one is refused.
#[test]
fn a_plant_with_other_updates_than_the_drive_is_refused_by_name() {
    let (machine, inverter) = machines()[0];
    let mut s = Scenario::new(machine, inverter, 1.0);
    s.plant.inverter.half_periods = 1;
    assert!(Run::new(Cow::Owned(s)).err().is_some_and(|e| e.field() == "plant inverter.half_periods"));
    for half_periods in [0, 3, 5, 18] {
        let e = Inverter { half_periods, ..inverter }.validate().unwrap_err();
        assert_eq!(e.field, "half_periods");
    }
}

#[test]
fn discontinuous_modulation_applies_the_voltage_that_the_estimator_takes() {
    for (machine, inverter) in machines() {
        for (half_periods, point) in [(2, (0.7, 0.5)), (2, (-0.9, 0.8)), (1, (0.7, -0.8))] {
            let inverter = Inverter { half_periods, ..inverter };
            let run = |above| held((machine, inverter, inverter), Scheme::Enhanced, point, above);
            let (continuous, discontinuous) = (run(None), run(Some(0.4)));
            println!("{half_periods} {point:?}: {continuous:.3?} {discontinuous:.3?}");
            assert!(discontinuous.0 < continuous.0 + 0.5, "{half_periods} {point:?}: {discontinuous:?}");
            assert!((discontinuous.1 - continuous.1).abs() < 0.6, "{half_periods} {point:?}: {discontinuous:?}");
        }
    }
}
