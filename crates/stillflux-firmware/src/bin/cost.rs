//! Instructions per call of every block and of the whole step, over a recorded closed-loop trace.
//!
//! A call is timed from the edge of a SysTick tick (40 instructions); after it, the instructions to the next
//! edge are counted by a loop of known length. What remains is an error of a few instructions a call, whose
//! mean is removed with the call of an empty function. The blocks run beside the drive on what the drive
//! gave them in this period, from copies of its state that start with it; that they return the drive's own
//! numbers is checked in every period. The enhanced scheme has a trace of its own, with its filter and balance
//! beside the drive: each period of the filter's block separately, as its work is spread over them.
#![no_std]
#![no_main]

use core::hint::black_box;
use cortex_m_rt::entry;
use stillflux::config::{DriveConfig, SLOW_PERIODS, SPEED_PERIODS, Scheme};
use stillflux::control::current::CurrentController;
use stillflux::control::flux::FluxController;
use stillflux::control::modulator::{Duty, applied, modulate};
use stillflux::control::speed::SpeedController;
use stillflux::drive::{Drive, Estimate, Measurement, Output, Reference, Status};
use stillflux::estimate::balance::{Balance, BalanceConfig};
use stillflux::estimate::confidence::Confidence;
use stillflux::estimate::filter::{self, Filter, FilterConfig};
use stillflux::estimate::flux::FluxEstimator;
use stillflux::estimate::resistance::ResistanceEstimator;
use stillflux::estimate::speed::{SpeedEstimate, SpeedEstimator};
use stillflux::scalar::Q;
use stillflux::space::{AlphaBeta, Dq};
use stillflux_firmware::blob::Parameters;
use stillflux_firmware::board::{self, Clock, File, print};
use stillflux_firmware::control::Control;
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
        let begin = Clock::edge();
        let result = f();
        let (end, rest) = Clock::until_edge();
        let ticks = begin.wrapping_sub(end) & 0x00FF_FFFF;
        let n = (ticks * Clock::TICK).saturating_sub(rest);
        self.calls += 1;
        self.sum += u64::from(n);
        self.worst = self.worst.max(n);
        result
    }
}

/// What is measured, in the order of the table.
#[derive(Clone, Copy, Default)]
struct Costs {
    empty: Cost,
    flux_estimator: Cost,
    speed_estimator: Cost,
    resistance_adaptation: Cost,
    confidence: Cost,
    speed_control: Cost,
    flux_control: Cost,
    current_control: Cost,
    inverter_model: Cost,
    modulator: Cost,
    drive_step: Cost,
    drive_step_enhanced: Cost,
    filter: Cost,
    /// The same by period of a block.
    filter_part: [Cost; BLOCK],
    balance: Cost,
}

/// Control periods in a block of the filter at the preset's 10 kHz.
const BLOCK: usize = 10;

/// Copies of the drive's blocks.
struct Blocks<R: Word> {
    flux: FluxEstimator<R>,
    speed: SpeedEstimator<R>,
    resistance: ResistanceEstimator<R>,
    confidence: Confidence<R>,
    speed_control: SpeedController<R>,
    flux_control: FluxController<R>,
    current_control: CurrentController<R>,
    /// Stator frequency of this period, if the flux estimator has not been told it yet.
    follow: Option<R>,
    /// Periods in which a block and the drive disagreed: flux, speed, resistance, confidence, flux control.
    different: [u32; 5],
}

impl<R: Word> Blocks<R> {
    /// As the drive starts them at the end of the magnetisation.
    fn start(config: &DriveConfig<R>, e: &Estimate<R>, drive: &Drive<R>, i_s: AlphaBeta<R>) -> Self {
        let psi = AlphaBeta::new(config.flux_control_config().psi_rated, R::ZERO);
        let mut blocks = Self {
            flux: FluxEstimator::default(),
            speed: SpeedEstimator::default(),
            resistance: ResistanceEstimator::default(),
            confidence: Confidence::default(),
            speed_control: SpeedController::default(),
            flux_control: FluxController::default(),
            current_control: CurrentController::default(),
            follow: None,
            different: [0; 5],
        };
        blocks.flux.offset.restore(e.u_off);
        blocks.flux.start(psi, i_s);
        blocks.flux.follow(config.flux_config(), R::ZERO);
        blocks.speed.start(&psi, R::ZERO);
        blocks.resistance.start(drive.memory().r_s);
        blocks
    }

    /// One period on the drive's own inputs; `before` are its estimates of the period before.
    fn period(
        &mut self,
        costs: &mut Costs,
        drive: &Drive<R>,
        before: &Estimate<R>,
        i_s: &AlphaBeta<R>,
        input: &Input<R>,
    ) {
        let c = drive.config();
        let e = drive.estimate();
        // Speed estimator and slow blocks run when the drive runs them.
        let turn = drive.period() % SLOW_PERIODS;
        let flux_input = FluxInput {
            u_s: e.u_s,
            i_s: *i_s,
            r_s: self.resistance.r_s(),
            psi_ref: before.psi_ref,
            omega_s: self.follow.take(),
        };
        costs.flux_estimator.call(|| flux_estimator(&mut self.flux, c, &flux_input));
        let flux = self.flux.estimate();
        let mut speed = e.speed;
        if turn % SPEED_PERIODS == 1 {
            speed = costs.speed_estimator.call(|| speed_estimator(&mut self.speed, c, &flux.psi_s, &e.i_s));
            self.follow = Some(speed.omega_s);
        }
        if turn == 2 {
            if let Some(config) = c.resistance_config() {
                costs
                    .resistance_adaptation
                    .call(|| resistance_adaptation(&mut self.resistance, config, flux.magnitude, &e.i_dq, &speed));
            }
            let u_hf = self.flux.effort();
            let corrected = (self.flux.offset.updates() > 0).then(|| self.flux.offset.last_correction());
            costs.confidence.call(|| confidence(&mut self.confidence, c, speed.omega_s, u_hf, corrected));
        }
        let mut i_d = e.i_dq_ref.re();
        if turn == 0 {
            let i_q = e.i_dq_ref.im();
            if let Reference::Speed(omega) = input.reference {
                costs.speed_control.call(|| speed_control(&mut self.speed_control, c, omega, speed.omega_m));
            }
            i_d = costs
                .flux_control
                .call(|| flux_control(&mut self.flux_control, c, &[e.psi_ref, flux.magnitude, i_q, speed.omega_s]));
        }
        let i_ref = before.i_dq_ref;
        let feedforward = i_ref * before.r_s + Dq::new(R::ZERO, before.speed.omega_s * flux.magnitude);
        let u_max = input.measured.u_dc * R::from_f64(0.98 / 1.732_050_807_568_877_2);
        let u = costs
            .current_control
            .call(|| current_control(&mut self.current_control, c, &i_ref, &e.i_dq, &feedforward, u_max));
        let loss = costs.inverter_model.call(|| inverter_model(c, &e.i_s, input.measured.u_dc));
        let u = flux.field.to_stator(&u).to_phases();
        let phases = [u[0] + loss[0], u[1] + loss[1], u[2] + loss[2]];
        let inv_u_dc = input.measured.u_dc.recip();
        black_box(costs.modulator.call(|| modulator(c, &phases, inv_u_dc)));
        for (k, same) in [
            flux == e.flux,
            speed == e.speed,
            self.resistance.r_s() == e.r_s,
            self.confidence.value() == e.confidence,
            i_d == e.i_dq_ref.re(),
        ]
        .into_iter()
        .enumerate()
        {
            self.different[k] += u32::from(!same);
        }
    }
}

/// Copies of the enhanced scheme's blocks.
struct EnhancedBlocks<R: Word> {
    filter: Filter<R>,
    balance: Balance<R>,
    /// Period within the filter's block.
    part: usize,
    /// Periods in which the copy's flux and the drive's were apart.
    different: u32,
}

impl<R: Word> EnhancedBlocks<R> {
    /// As the drive starts them in a machine at rest.
    fn start(f: &FilterConfig<R>, drive: &Drive<R>, e: &Estimate<R>) -> Self {
        let mut filter = Filter::new(f);
        filter.start(f, &e.i_s);
        filter.settle(f, drive.config().flux_control_config().psi_rated);
        Self { filter, balance: Balance::default(), part: 0, different: 0 }
    }

    /// One period on the drive's own inputs, but for the voltage of the inverter model, which stays within the
    /// drive: the one at the present current serves.
    fn period(
        &mut self,
        costs: &mut Costs,
        drive: &Drive<R>,
        before: &Estimate<R>,
        i_s: &AlphaBeta<R>,
        input: &Input<R>,
    ) {
        let (c, e) = (drive.config(), drive.estimate());
        let Some(f) = c.filter_config() else { return };
        let i = input.measured.i_abc;
        let sum = i[0] + i[1] + i[2];
        let i_m = costs.balance.call(|| balance(&mut self.balance, c.balance_config(), i_s, sum));
        let u_l = AlphaBeta::from_phases(c.inverter_model().distortion(&e.i_s, input.measured.u_dc, R::ONE));
        let x = filter::Input { u_s: e.u_s, u_l, i_m, i_ref: before.i_dq_ref, omega_s: before.speed.omega_s };
        let n = costs.filter.sum;
        costs.filter.call(|| predict(&mut self.filter, f, &x));
        let n = costs.filter.sum - n;
        self.part = (self.part + 1) % BLOCK;
        let part = &mut costs.filter_part[self.part];
        part.calls += 1;
        part.sum += n;
        part.worst = part.worst.max(n as u32);
        let apart = self.filter.value() - e.flux.psi_s;
        self.different += u32::from(!apart.norm_sq().within(R::from_f64(0.01)));
    }
}

/// Inputs of one period of the drive.
struct Input<R: Word> {
    measured: Measurement<R>,
    reference: Reference<R>,
}

/// Inputs of the flux estimator.
struct FluxInput<R: Word> {
    u_s: AlphaBeta<R>,
    i_s: AlphaBeta<R>,
    r_s: R,
    psi_ref: R,
    /// A stator frequency to follow, every second period.
    omega_s: Option<R>,
}

// Calls that the optimiser leaves where they are.

#[inline(never)]
fn empty(state: &mut u32) {
    *state = black_box(*state);
}
#[inline(never)]
fn flux_estimator<R: Word>(s: &mut FluxEstimator<R>, c: &DriveConfig<R>, x: &FluxInput<R>) {
    if let Some(omega_s) = x.omega_s {
        s.follow(c.flux_config(), omega_s);
    }
    s.step(c.flux_config(), &x.u_s, &x.i_s, x.r_s, x.psi_ref);
}
#[inline(never)]
fn speed_estimator<R: Word>(
    s: &mut SpeedEstimator<R>,
    c: &DriveConfig<R>,
    psi_s: &AlphaBeta<R>,
    i_s: &AlphaBeta<R>,
) -> SpeedEstimate<R> {
    s.step(c.speed_config(), psi_s, i_s)
}
#[inline(never)]
fn resistance_adaptation<R: Word>(
    s: &mut ResistanceEstimator<R>,
    c: &stillflux::estimate::resistance::ResistanceConfig<R>,
    psi_s: R,
    i: &Dq<R>,
    speed: &SpeedEstimate<R>,
) -> R {
    s.step(c, psi_s, i, speed.omega_s, speed.omega_m)
}
#[inline(never)]
fn confidence<R: Word>(s: &mut Confidence<R>, c: &DriveConfig<R>, omega_s: R, u_hf: R, corrected: Option<R>) -> R {
    s.step(c.confidence_config(), omega_s, u_hf, corrected)
}
#[inline(never)]
fn speed_control<R: Word>(s: &mut SpeedController<R>, c: &DriveConfig<R>, omega_ref: R, omega_m: R) -> R {
    s.step(c.speed_control_config(), omega_ref, omega_m, R::ONE)
}
#[inline(never)]
fn flux_control<R: Word>(s: &mut FluxController<R>, c: &DriveConfig<R>, x: &[R; 4]) -> R {
    s.step(c.flux_control_config(), x[0], x[1], x[2], x[3])
}
#[inline(never)]
fn current_control<R: Word>(
    s: &mut CurrentController<R>,
    c: &DriveConfig<R>,
    i_ref: &Dq<R>,
    i: &Dq<R>,
    u_ff: &Dq<R>,
    u_max: R,
) -> Dq<R> {
    s.step(c.current_config(), i_ref, i, u_ff, u_max)
}
#[inline(never)]
fn predict<R: Word>(s: &mut Filter<R>, c: &FilterConfig<R>, x: &filter::Input<R>) {
    s.step(c, x, false);
}
#[inline(never)]
fn balance<R: Word>(s: &mut Balance<R>, c: &BalanceConfig<R>, i: &AlphaBeta<R>, sum: R) -> AlphaBeta<R> {
    s.step(c, i, sum)
}
#[inline(never)]
fn inverter_model<R: Word>(c: &DriveConfig<R>, i_s: &AlphaBeta<R>, u_dc: R) -> [R; 3] {
    c.inverter_model().distortion(i_s, u_dc, R::ONE)
}
#[inline(never)]
fn modulator<R: Word>(c: &DriveConfig<R>, u: &[R; 3], inv_u_dc: R) -> (Duty<R>, AlphaBeta<R>) {
    let duty = modulate(*u, inv_u_dc, c.timer());
    (duty, applied(&duty))
}
#[inline(never)]
fn drive_step<R: Word>(drive: &mut Drive<R>, input: &Input<R>) -> Output<R> {
    drive.step(&input.measured, &input.reference)
}

/// Runs a recorded trace and prints what it cost; `false` if it cannot be read or the blocks disagree.
#[inline(never)]
fn trace<R: Word>(path: &str, scheme: Scheme) -> bool {
    let (Some(mut file), Ok(mut control)) = (File::open(path, false), Control::<R>::new(&Parameters::preset(scheme)))
    else {
        print(format_args!("cannot run {path}"));
        return false;
    };
    let mut costs = Costs::default();
    let mut blocks: Option<Blocks<R>> = None;
    let mut enhanced: Option<EnhancedBlocks<R>> = None;
    let mut buffer = [0_u8; 256 * FRAME];
    loop {
        let n = file.read(&mut buffer) / FRAME;
        if n == 0 {
            break;
        }
        for bytes in &buffer.as_chunks::<FRAME>().0[..n] {
            let frame = Frame::<R>::from_bytes(bytes);
            let input = Input { measured: control.scale().measurement(&frame.counts), reference: frame.reference };
            let before = control.drive.estimate();
            let was_running = control.drive.status() == Status::Running;
            costs.empty.call(|| empty(&mut 0));
            if was_running {
                let cost = if scheme == Scheme::Paper { &mut costs.drive_step } else { &mut costs.drive_step_enhanced };
                black_box(cost.call(|| drive_step(&mut control.drive, &input)));
            } else {
                black_box(drive_step(&mut control.drive, &input));
            }
            let drive = &control.drive;
            let i = input.measured.i_abc;
            let i_off = drive.memory().i_off;
            let i_s = AlphaBeta::from_phases([i[0] - i_off[0], i[1] - i_off[1], i[2] - i_off[2]]);
            let runs = drive.status() == Status::Running;
            if let Some(f) = drive.config().filter_config() {
                match (&mut enhanced, was_running, runs) {
                    (Some(b), true, true) => b.period(&mut costs, drive, &before, &i_s, &input),
                    (b @ None, false, true) => *b = Some(EnhancedBlocks::start(f, drive, &drive.estimate())),
                    _ => {}
                }
                continue;
            }
            match (&mut blocks, was_running, runs) {
                (Some(b), true, true) => b.period(&mut costs, drive, &before, &i_s, &input),
                (b @ None, false, true) => *b = Some(Blocks::start(drive.config(), &drive.estimate(), drive, i_s)),
                _ => {}
            }
        }
    }
    report::<R>(&costs);
    if let Some(b) = enhanced {
        print(format_args!("{{\"arithmetic\": \"{}\", \"filter_apart\": {}}}", R::NAME, b.different));
        return b.different == 0;
    }
    let different = blocks.map_or([u32::MAX; 5], |b| b.different);
    print(format_args!("{{\"arithmetic\": \"{}\", \"periods_different\": {different:?}}}", R::NAME));
    different == [0; 5]
}

/// One line of JSON a block, less the cost of the empty call.
fn report<R: Word>(costs: &Costs) {
    let overhead = mean(&costs.empty, 0);
    for (name, c) in [
        ("empty", &costs.empty),
        ("flux_estimator", &costs.flux_estimator),
        ("speed_estimator", &costs.speed_estimator),
        ("resistance_adaptation", &costs.resistance_adaptation),
        ("confidence", &costs.confidence),
        ("speed_control", &costs.speed_control),
        ("flux_control", &costs.flux_control),
        ("current_control", &costs.current_control),
        ("inverter_model", &costs.inverter_model),
        ("modulator", &costs.modulator),
        ("drive_step", &costs.drive_step),
        ("drive_step_enhanced", &costs.drive_step_enhanced),
        ("filter", &costs.filter),
        ("filter_close", &costs.filter_part[0]),
        ("filter_1", &costs.filter_part[1]),
        ("filter_2", &costs.filter_part[2]),
        ("filter_3", &costs.filter_part[3]),
        ("filter_4", &costs.filter_part[4]),
        ("filter_5", &costs.filter_part[5]),
        ("filter_6", &costs.filter_part[6]),
        ("filter_7", &costs.filter_part[7]),
        ("filter_8", &costs.filter_part[8]),
        ("filter_9", &costs.filter_part[9]),
        ("balance", &costs.balance),
    ] {
        if c.calls == 0 {
            continue;
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
    let (paper_f32, paper_q, enhanced_f32, enhanced_q) = (next(), next(), next(), next());
    let ok = trace::<f32>(paper_f32, Scheme::Paper)
        & trace::<Q>(paper_q, Scheme::Paper)
        & trace::<f32>(enhanced_f32, Scheme::Enhanced)
        & trace::<Q>(enhanced_q, Scheme::Enhanced);
    board::exit(ok)
}
