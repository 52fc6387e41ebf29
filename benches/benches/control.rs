//! Time per control period of every block and of the drive step, in each arithmetic.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use stillflux::base::PerUnit;
use stillflux::config::{DriveConfig, DriveParams};
use stillflux::control::current::CurrentController;
use stillflux::control::flux::FluxController;
use stillflux::control::modulator::modulate;
use stillflux::control::speed::SpeedController;
use stillflux::drive::{Reference, Status};
use stillflux::estimate::confidence::Confidence;
use stillflux::estimate::flux::FluxEstimator;
use stillflux::estimate::resistance::ResistanceEstimator;
use stillflux::estimate::speed::SpeedEstimator;
use stillflux::inverter::InverterModel;
use stillflux::scalar::{Q, Real, Timer};
use stillflux::space::{AlphaBeta, Dq};
use stillflux_benches::{OMEGA, machine, running};

fn blocks<R: Real>(c: &mut Criterion) {
    let r = R::from_f64;
    let (machine, inverter) = machine();
    let config = DriveConfig::<R>::new(&machine, &inverter, &DriveParams::new(&machine, &inverter)).unwrap();
    let pu = PerUnit::<R>::new(&machine, &inverter).unwrap();
    let model = InverterModel::new(&machine, &inverter, &pu);
    let timer = Timer::new(8500);
    let (u, i) = (AlphaBeta::new(r(0.05), r(0.03)), AlphaBeta::new(r(0.6), r(0.4)));
    let (i_dq, i_ref) = (Dq::new(r(0.6), r(0.4)), Dq::new(r(0.61), r(0.42)));
    let psi = AlphaBeta::new(r(0.9), r(0.4));
    let mut group = c.benchmark_group("block");
    let mut bench = |name: &str, f: &mut dyn FnMut()| {
        group.bench_function(BenchmarkId::new(name, R::NAME), |b| b.iter(&mut *f));
    };

    let mut flux = FluxEstimator::default();
    flux.start(psi, i);
    bench("flux estimator", &mut || {
        flux.step(config.flux_config(), black_box(&u), &i, r(0.08), R::ONE);
    });
    let mut speed = SpeedEstimator::default();
    speed.start(&psi, R::ZERO);
    bench("speed", &mut || {
        black_box(speed.step(config.speed_config(), black_box(&psi), &i));
    });
    let mut resistance = ResistanceEstimator::default();
    resistance.start(r(0.08));
    bench("resistance", &mut || {
        let c = config.resistance_config().expect("on by default");
        black_box(resistance.step(c, R::ONE, black_box(&i_dq), r(0.03), r(0.02)));
    });
    let mut confidence = Confidence::default();
    bench("confidence", &mut || {
        black_box(confidence.step(config.confidence_config(), black_box(r(0.03)), r(1e-4), None));
    });
    let mut current = CurrentController::default();
    bench("current control", &mut || {
        black_box(current.step(config.current_config(), black_box(&i_ref), &i_dq, &i_dq, R::ONE));
    });
    let mut flux_control = FluxController::default();
    bench("flux control", &mut || {
        black_box(flux_control.step(config.flux_control_config(), R::ONE, black_box(R::ONE), r(0.4), r(0.03)));
    });
    let mut speed_control = SpeedController::default();
    bench("speed control", &mut || {
        black_box(speed_control.step(config.speed_control_config(), black_box(r(0.03)), r(0.02), R::ONE));
    });
    bench("inverter model", &mut || {
        black_box(model.distortion(black_box(&i), r(1.65)));
    });
    bench("modulator", &mut || {
        black_box(modulate(black_box([r(0.1), r(-0.2), r(0.1)]), r(0.6), Some(&timer)));
    });
    group.finish();
}

/// Replays a recorded stretch of a closed loop, over and over from its beginning.
fn drive<R: Real>(c: &mut Criterion) {
    let (begin, samples) = running::<R>(2000);
    let reference = Reference::Speed(R::from_f64(OMEGA));
    let (mut drive, mut at) = (begin, 0);
    c.bench_function(&format!("drive step/{}", R::NAME), |b| {
        b.iter(|| {
            if at == samples.len() {
                (drive, at) = (begin, 0);
            }
            at += 1;
            black_box(drive.step(&samples[at - 1], &reference))
        });
    });
    assert_eq!(drive.status(), Status::Running);
}

fn all(c: &mut Criterion) {
    blocks::<f32>(c);
    blocks::<f64>(c);
    blocks::<Q>(c);
    drive::<f32>(c);
    drive::<f64>(c);
    drive::<Q>(c);
}

criterion_group! {
    name = benches;
    // Blocks of ten nanoseconds settle quickly; thirty of them should not take five minutes.
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = all
}
criterion_main!(benches);
