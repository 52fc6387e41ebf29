//! Instructions per call of every block and of the whole step, over a recorded closed-loop trace.
//!
//! A call is timed from the edge of a SysTick tick (40 instructions); after it, the instructions to the next
//! edge are counted by a loop of known length. What remains is an error of a few instructions a call, whose
//! mean is removed with the call of an empty function. The blocks run beside the drive on what the drive
//! gave them in this period, from copies of its state that start with it; that they return the drive's own
//! numbers is checked in every period. The image holds one scheme, as a product does.
#![no_std]
#![no_main]

#[cfg(feature = "enhanced")]
#[path = "enhanced.rs"]
mod blocks;
#[cfg(not(feature = "enhanced"))]
#[path = "published.rs"]
mod blocks;

use blocks::{Blocks, Costs, INTERRUPT, STEP};
use core::hint::black_box;
use cortex_m_rt::entry;
use stillflux::config::Scheme;
use stillflux::drive::{Drive, Measurement, Output, Reference, Status};
use stillflux::interrupt::{Command, CountsDrive};
use stillflux::scalar::Q;
use stillflux::space::AlphaBeta;
use stillflux::trace::Trace;
use stillflux_firmware::blob::Parameters;
use stillflux_firmware::board::{self, Clock, File, print};
use stillflux_firmware::exchange::{FRAME, Frame, Word};

/// Calls, their instructions, the worst one.
#[derive(Clone, Copy, Default)]
struct Cost {
    calls: u32,
    sum: u64,
    worst: u32,
}

impl Cost {
    /// Times one call.
    #[inline(never)]
    fn call<T>(&mut self, f: impl FnOnce() -> T) -> T {
        let begin = Clock::now();
        let result = f();
        self.add(Clock::now().since(begin));
        result
    }

    /// Counts a call of so many instructions.
    fn add(&mut self, n: u32) {
        self.calls += 1;
        self.sum += u64::from(n);
        self.worst = self.worst.max(n);
    }
}

/// Inputs of one period of the drive.
struct Input<R: Word> {
    measured: Measurement<R>,
    reference: Reference<R>,
}

// Calls that the optimiser leaves where they are.

#[inline(never)]
fn empty(state: &mut u32) {
    *state = black_box(*state);
}
#[inline(never)]
fn drive_step<R: Word>(drive: &mut Drive<R>, input: &Input<R>) -> Output<R> {
    drive.step(&input.measured, &input.reference)
}

#[inline(never)]
fn period<R: Word>(control: &mut CountsDrive<R>, frame: &Frame) -> Command {
    control.period(&frame.counts, &frame.set_point)
}
#[inline(never)]
fn record(trace: &mut Trace<[u32; 4], 64>, sample: [u32; 4], fault: bool) {
    trace.record(sample, fault);
}

/// Runs a recorded trace and prints what it cost; `false` if it cannot be read or the blocks disagree.
#[inline(never)]
fn trace<R: Word>(path: &str) -> bool {
    let parameters = Parameters::preset(Scheme::default());
    let (Some(mut file), Ok(ready)) = (File::open(path, false), parameters.ready::<R>()) else {
        print(format_args!("cannot run {path}"));
        return false;
    };
    // The interrupt's whole content, and the drive alone beside it.
    let mut control = CountsDrive::new(&ready);
    let Some(mut drive) = control.drive().copied() else { return false };
    let (mut nothing, mut step, mut costs) = (Cost::default(), Cost::default(), Costs::default());
    let (mut interrupt, mut traced, mut trace) = (Cost::default(), Cost::default(), Trace::new([0; 4]));
    let mut blocks: Option<Blocks<R>> = None;
    let mut buffer = [0_u8; 256 * FRAME];
    loop {
        let n = file.read(&mut buffer) / FRAME;
        if n == 0 {
            break;
        }
        for bytes in &buffer.as_chunks::<FRAME>().0[..n] {
            let frame = Frame::from_bytes(bytes);
            let Some((measured, reference)) = control.inputs(&frame.counts, &frame.set_point) else { return false };
            let input = Input { measured, reference };
            let before = drive.estimate();
            let was_running = drive.status() == Status::Running;
            nothing.call(|| empty(&mut 0));
            if was_running {
                black_box(step.call(|| drive_step(&mut drive, &input)));
                let command = interrupt.call(|| period(&mut control, &frame));
                let sample = [command.compare[0], command.compare[1], command.compare[2], 0];
                traced.call(|| record(&mut trace, sample, !command.gates_on));
            } else {
                black_box(drive_step(&mut drive, &input));
                black_box(period(&mut control, &frame));
            }
            let drive = &drive;
            let i = input.measured.i_abc;
            let i_off = drive.memory().i_off;
            let i_s = AlphaBeta::from_phases([i[0] - i_off[0], i[1] - i_off[1], i[2] - i_off[2]]);
            match (&mut blocks, was_running, drive.status() == Status::Running) {
                (Some(b), true, true) => b.period(&mut costs, drive, &before, &i_s, &input),
                (b @ None, false, true) => *b = Some(Blocks::start(drive, i_s)),
                _ => {}
            }
        }
    }
    let overhead = mean(&nothing, 0);
    report::<R>(STEP, &step, overhead);
    report::<R>(INTERRUPT, &interrupt, overhead);
    report::<R>("trace", &traced, overhead);
    costs.each(|name, cost| report::<R>(name, cost, overhead));
    let apart = blocks.map_or(u32::MAX, |b| b.apart());
    print(format_args!("{{\"arithmetic\": \"{}\", \"periods_apart\": {apart}}}", R::NAME));
    // What a copy identifies of the inverter does not act on the voltage, which is the drive's: it may leave the drive for a
    // moment. It must not have another thing to do than the drive.
    apart.saturating_mul(20) < interrupt.calls
}

/// A block's line of JSON, less the cost of the empty call.
fn report<R: Word>(name: &str, c: &Cost, overhead: u32) {
    if c.calls == 0 {
        return;
    }
    let tenths = mean(c, overhead);
    print(format_args!(
        "{{\"arithmetic\": \"{}\", \"block\": \"{name}\", \"calls\": {}, \"mean\": {}.{}, \"worst\": {}}}",
        R::NAME,
        c.calls,
        tenths / 10,
        tenths % 10,
        c.worst.saturating_sub((overhead + 5) / 10)
    ));
}

/// Mean in tenths of an instruction, less `overhead`.
fn mean(c: &Cost, overhead: u32) -> u32 {
    let tenths = (c.sum * 10).checked_div(u64::from(c.calls)).unwrap_or(0);
    (tenths as u32).saturating_sub(overhead)
}

#[entry]
fn main() -> ! {
    let mut buffer = [0; 512];
    let mut arguments = board::arguments(&mut buffer).split_whitespace().skip(1);
    if let Some(mut peripherals) = cortex_m::Peripherals::take() {
        Clock::start(&mut peripherals.SYST);
    }
    let mut next = || arguments.next().unwrap_or("");
    let (f32_frames, q_frames) = (next(), next());
    // A processor without FPU runs fixed point alone.
    let ok = (f32_frames == "-" || trace::<f32>(f32_frames)) & (q_frames == "-" || trace::<Q>(q_frames));
    board::exit(ok)
}
