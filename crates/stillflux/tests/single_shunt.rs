//! A single shunt in the dc link: what its readings are taken for, and what is refused.

#![cfg(feature = "shunt")]

use stillflux::config::{DriveConfig, DriveParams, Scheme};
use stillflux::control::shunt::Pulses;
use stillflux::drive::{Drive, Fault, Measurement, Reference, Status};
use stillflux::params::{Inverter, Machine, ParamError};
use stillflux::scalar::{Q, Real};
use stillflux::space::AlphaBeta;

const SETUP: fn() -> (Machine, Inverter) = || (Machine::preset_2k2(), Inverter::preset_2k2());

fn drive<R: Real>(scheme: Scheme) -> Drive<R> {
    let (machine, inverter) = SETUP();
    let params = DriveParams {
        scheme,
        current_sensors: 1,
        offset_time: 0.002,
        magnetise_time: 0.4,
        ..DriveParams::new(&machine, &inverter)
    };
    Drive::new(DriveConfig::new(&machine, &inverter, &params).unwrap())
}

/// Readings of currents in these pulses, without ripple: legs leave the upper rail one after the other.
fn readings<R: Real>(pulses: &Pulses<R>, i: [f64; 3], offset: f64) -> [R; 3] {
    let link = |at: R| (0..3).filter(|k| pulses.falling[*k] >= at).map(|k| i[k]).sum::<f64>();
    [link(pulses.sample[0]), link(pulses.sample[1]), 0.0].map(|x| R::from_f64(x + offset))
}

/// Steps a drive with the readings of currents that follow their references.
fn run<R: Real>(d: &mut Drive<R>, periods: u32, offset: impl Fn(u32) -> f64) -> (u32, f64) {
    let mut before = [d.pulses().unwrap(); 2];
    let (mut on, mut worst) = (0, 0.0_f64);
    for k in 0..periods {
        let switching = matches!(d.status(), Status::Magnetising | Status::Running);
        let e = d.estimate();
        let psi = AlphaBeta::new(e.flux.psi_s.re().to_f64(), e.flux.psi_s.im().to_f64());
        let length = psi.norm_sq().sqrt();
        let (c, s) = if d.status() == Status::Running { (psi.re() / length, psi.im() / length) } else { (1.0, 0.0) };
        let (i_d, i_q) = (e.i_dq_ref.re().to_f64(), e.i_dq_ref.im().to_f64());
        let i = AlphaBeta::new(i_d * c - i_q * s, i_d * s + i_q * c).to_phases();
        let i = if switching && on > 2 { i } else { [0.0; 3] };
        let i_abc = readings(&before[0], i, offset(k));
        let out = d.step(&Measurement { i_abc, u_dc: R::from_f64(1.65) }, &Reference::Speed(R::from_f64(0.02)));
        before = [before[1], d.pulses().unwrap()];
        if out.gates_on {
            on += 1;
            for (leg, duty) in out.duty.iter().enumerate() {
                let pulse = before[1].duty()[leg];
                worst = worst.max((pulse.to_f64() - duty.to_f64()).abs());
            }
        }
    }
    (on, worst)
}

fn runs<R: Real>() {
    for &scheme in Scheme::ALL {
        let mut d = drive::<R>(scheme);
        run(&mut d, 60, |_| 0.03);
        let at_rest = d.memory().i_off;
        assert!(at_rest.iter().all(|o| (o.to_f64() - 0.03).abs() < 1e-5), "{} {scheme:?}: {at_rest:?}", R::NAME);
        let (on, worst) = run(&mut d, 560, |_| 0.04);
        assert!(matches!(d.status(), Status::Magnetising | Status::Running), "{} {scheme:?} {on}", R::NAME);
        assert!(on > 550 && worst < 1e-6, "duties are those of the pulses: {worst}");
        // A first order with 256 periods, of those whose zero vector lasts for a window.
        let most = 0.04 - 0.01 * (-560.0 / 256.0_f64).exp();
        for offset in d.memory().i_off.map(R::to_f64) {
            assert!(offset > 0.036 && offset < most + 3e-5, "{} {scheme:?}: {offset}, at most {most}", R::NAME);
        }
    }
}

#[test]
fn the_offset_is_read_at_rest_and_followed_in_the_zero_vector_in_every_arithmetic() {
    runs::<f32>();
    runs::<f64>();
    runs::<Q>();
}

#[test]
fn a_reading_out_of_range_is_bridged_once_and_then_a_fault() {
    for bad in [f32::NAN, f32::INFINITY, 10.0, -10.0] {
        for channel in 0..3 {
            let mut d = drive::<f32>(Scheme::default());
            run(&mut d, 500, |_| 0.0);
            assert!(matches!(d.status(), Status::Magnetising | Status::Running), "{:?}", d.status());
            let mut i_abc = [0.0; 3];
            i_abc[channel] = bad;
            let wrong = Measurement { i_abc, u_dc: 1.65 };
            assert!(d.step(&wrong, &Reference::Speed(0.0)).gates_on);
            assert!(!d.step(&wrong, &Reference::Speed(0.0)).gates_on);
            assert!(matches!(d.status(), Status::Faulted { cause: Fault::Measurement, .. }), "{:?}", d.status());
        }
    }
}

#[test]
fn with_sensors_in_the_phases_there_are_no_pulses() {
    let (machine, inverter) = SETUP();
    for current_sensors in [2, 3] {
        let params = DriveParams { current_sensors, ..DriveParams::new(&machine, &inverter) };
        let mut d = Drive::<f32>::new(DriveConfig::new(&machine, &inverter, &params).unwrap());
        d.step(&Measurement { i_abc: [0.0; 3], u_dc: 1.65 }, &Reference::Speed(0.0));
        assert_eq!(d.pulses(), None);
    }
}

fn refused(change: impl Fn(&mut Inverter, &mut DriveParams)) -> Option<ParamError> {
    let (machine, mut inverter) = SETUP();
    let mut params = DriveParams { current_sensors: 1, ..DriveParams::new(&machine, &inverter) };
    change(&mut inverter, &mut params);
    DriveConfig::<f32>::new(&machine, &inverter, &params).err()
}

#[test]
fn what_leaves_no_room_for_the_window_is_refused_by_name() {
    assert_eq!(refused(|_, _| {}), None);
    assert_eq!(refused(|_, p| p.shunt_window = 0.0), None);
    assert_eq!(refused(|i, _| i.half_periods = 4), None);
    for (field, e) in [
        ("shunt_window", refused(|_, p| p.shunt_window = 1.9e-6)),
        ("shunt_window", refused(|_, p| p.shunt_window = 15.1e-6)),
        ("shunt_window", refused(|_, p| p.shunt_window = f64::NAN)),
        // The window of 10 kHz in a period of 40 kHz.
        ("shunt_window", refused(|i, _| i.f_s = 40e3)),
        ("half_periods", refused(|i, _| i.half_periods = 1)),
        ("discontinuous_above", refused(|_, p| p.discontinuous_above = Some(0.5))),
        ("overmodulation", refused(|_, p| p.overmodulation = true)),
        ("current_sensors", refused(|_, p| p.current_sensors = 0)),
    ] {
        let e = e.unwrap();
        assert_eq!(e.field, field, "{e}");
    }
}
