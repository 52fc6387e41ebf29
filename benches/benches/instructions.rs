//! Instructions of [`PERIODS`] calls of every block and of the drive step, in each arithmetic, on the host.
//!
//! Counted by callgrind: exact, and the same on every run, where times are not. A call of a block includes the
//! indirect call and the barriers of the benchmark, some ten instructions. Needs valgrind and the runner of
//! gungraun (`make bench-tools`); without them it says so and does nothing.

#![allow(missing_docs, reason = "the macros of gungraun generate items without")]

use std::hint::black_box;
use std::process::{Command, Stdio};

use gungraun::{library_benchmark, library_benchmark_group};
use stillflux::config::Scheme;
use stillflux::drive::{Drive, Measurement, Reference};
use stillflux::scalar::{Q, Real};
use stillflux_benches::{Call, OMEGA, blocks, running};

/// Calls of a benchmark: divide what it prints by this.
const PERIODS: usize = 1000;

/// A block whose state has settled.
fn block<R: Real>(name: &str) -> Call {
    let (_, mut call) = blocks::<R>().into_iter().find(|b| b.0 == name).expect("a block of this name");
    (0..100).for_each(|_| call());
    call
}

fn replay<R: Real>((mut drive, samples): (Drive<R>, Vec<Measurement<R>>)) -> Drive<R> {
    let reference = Reference::Speed(R::from_f64(OMEGA));
    for measured in &samples {
        black_box(drive.step(measured, &reference));
    }
    drive
}

macro_rules! arithmetic {
    ($group:ident, $blocks:ident, $drive:ident: $real:ty) => {
        #[library_benchmark(setup = block::<$real>)]
        #[bench::flux_estimator("flux estimator")]
        #[bench::speed("speed")]
        #[bench::resistance("resistance")]
        #[bench::confidence("confidence")]
        #[bench::current_control("current control")]
        #[bench::flux_control("flux control")]
        #[bench::speed_control("speed control")]
        #[bench::inverter_model("inverter model")]
        #[bench::modulator("modulator")]
        #[bench::filter("filter")]
        #[bench::balance("balance")]
        fn $blocks(mut call: Call) -> Call {
            for _ in 0..PERIODS {
                call();
            }
            call
        }

        #[library_benchmark]
        #[bench::recorded(running(Scheme::Paper, PERIODS))]
        #[bench::enhanced(running(Scheme::Enhanced, PERIODS))]
        fn $drive(recorded: (Drive<$real>, Vec<Measurement<$real>>)) -> Drive<$real> {
            replay(recorded)
        }

        library_benchmark_group!(name = $group, benchmarks = [$blocks, $drive]);
    };
}

arithmetic!(all_f32, block_f32, drive_step_f32: f32);
arithmetic!(all_f64, block_f64, drive_step_f64: f64);
arithmetic!(all_q, block_q, drive_step_q: Q);

mod counting {
    use super::{all_f32, all_f64, all_q};
    use gungraun::main;

    main!(library_benchmark_groups = [all_f32, all_f64, all_q]);

    /// Under the runner, or as one of the benchmarks that it starts.
    pub(super) fn run() {
        main();
    }
}

fn main() {
    // Valgrind starts this program again, with the benchmark to run as an argument.
    let child = std::env::args().any(|a| a == "--gungraun-run");
    let runner = std::env::var("GUNGRAUN_RUNNER").unwrap_or_else(|_| "gungraun-runner".into());
    if !child && let Some(tool) = ["valgrind", &runner].into_iter().find(|tool| !runs(tool)) {
        println!("{tool} not found: no instructions are counted (see `make bench-tools`)");
        return;
    }
    counting::run();
}

fn runs(tool: &str) -> bool {
    Command::new(tool).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}
