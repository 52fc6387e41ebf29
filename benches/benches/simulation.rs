//! Simulated seconds per wall second of drive and plant together, at 10 kHz on one core.

use std::borrow::Cow;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use stillflux::si::Arithmetic;
use stillflux_benches::scenario;
use stillflux_sim::Mode;
use stillflux_sim::simulate::Run;

const SECONDS: u64 = 5;

fn simulation(c: &mut Criterion) {
    let mut group = c.benchmark_group("simulation");
    group.sampling_mode(SamplingMode::Flat).sample_size(10).measurement_time(Duration::from_secs(3));
    // Throughput in "elements" per second reads as simulated seconds per wall second.
    group.throughput(Throughput::Elements(SECONDS));
    for (name, mode, capacitance) in [
        ("switching", Mode::Switching, true),
        ("hard edges", Mode::Switching, false),
        ("averaged", Mode::Averaged, true),
    ] {
        for arithmetic in [Arithmetic::F32, Arithmetic::F64, Arithmetic::Q] {
            let mut s = scenario(SECONDS as f64);
            s.arithmetic = arithmetic;
            s.plant.mode = mode;
            if !capacitance {
                (s.inverter.c_out, s.plant.inverter.c_out) = (0.0, 0.0);
            }
            group.bench_function(BenchmarkId::new(name, format!("{arithmetic:?}")), |b| {
                b.iter(|| {
                    let mut run = Run::new(Cow::Borrowed(&s)).unwrap();
                    while run.advance(u64::MAX) {}
                    run.into_parts()
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, simulation);
criterion_main!(benches);
