//! Time per control period of every block and of the drive step, in each arithmetic.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use stillflux::config::Scheme;
use stillflux::drive::{Reference, Status};
use stillflux::scalar::{Q, Real};
use stillflux_benches::{OMEGA, running};

fn blocks<R: Real>(c: &mut Criterion) {
    let mut group = c.benchmark_group("block");
    for (name, mut call) in stillflux_benches::blocks::<R>() {
        group.bench_function(BenchmarkId::new(name, R::NAME), |b| b.iter(&mut *call));
    }
    group.finish();
}

/// Replays a recorded stretch of a closed loop, over and over from its beginning.
fn drive<R: Real>(c: &mut Criterion, name: &str, scheme: Scheme) {
    let (begin, samples) = running::<R>(scheme, 2000);
    let reference = Reference::Speed(R::from_f64(OMEGA));
    let (mut drive, mut at) = (begin, 0);
    c.bench_function(&format!("{name}/{}", R::NAME), |b| {
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
    for (name, scheme) in [("drive step", Scheme::Paper), ("drive step enhanced", Scheme::Enhanced)] {
        drive::<f32>(c, name, scheme);
        drive::<f64>(c, name, scheme);
        drive::<Q>(c, name, scheme);
    }
}

criterion_group! {
    name = benches;
    // Blocks of ten nanoseconds settle quickly; thirty of them should not take five minutes.
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = all
}
criterion_main!(benches);
