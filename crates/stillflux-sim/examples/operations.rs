//! The arithmetic that each block cannot do without, as one line of JSON: additions, multiplications, limits
//! and comparisons, roots and divisions of one undisturbed call, counted by an arithmetic that books them; of
//! flux estimator and drive step, where not every period does the same, their mean.
//!
//! An integration counts as one multiplication and one addition; the compensation of its rounding, loads,
//! stores, flags and calls are the overhead that the instruction counts of the firmware show beside it.

use std::cell::Cell;
use std::ops::{Add, AddAssign, Mul, MulAssign, Neg, Sub, SubAssign};

use stillflux::config::{DriveConfig, DriveParams, Scheme};
use stillflux::control::current::CurrentController;
use stillflux::control::flux::{FluxController, Range};
use stillflux::control::modulator::{applied, modulate};
use stillflux::control::speed::SpeedController;
use stillflux::drive::{Drive, Measurement, Reference, Status};
use stillflux::estimate::balance::Balance;
use stillflux::estimate::confidence::Confidence;
use stillflux::estimate::flux::FluxEstimator;
use stillflux::estimate::kalman::{Filter, Input};
use stillflux::estimate::resistance::ResistanceEstimator;
use stillflux::estimate::speed::SpeedEstimator;
use stillflux::params::{Inverter, Machine};
use stillflux::scalar::{Real, Sum, Timer};
use stillflux::space::{AlphaBeta, Dq};
use stillflux::words::Words;

thread_local! {
    static COUNT: Cell<u32> = const { Cell::new(0) };
}

fn book(n: u32) {
    COUNT.with(|c| c.set(c.get() + n));
}

/// `f64` that counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counted(f64);

impl PartialOrd for Counted {
    fn partial_cmp(&self, o: &Self) -> Option<std::cmp::Ordering> {
        book(1);
        self.0.partial_cmp(&o.0)
    }
}

macro_rules! operator {
    ($($trait:ident $method:ident $assign_trait:ident $assign:ident $op:tt;)*) => {$(
        impl $trait for Counted {
            type Output = Self;
            fn $method(self, o: Self) -> Self {
                book(1);
                Self(self.0 $op o.0)
            }
        }
        impl $assign_trait for Counted {
            fn $assign(&mut self, o: Self) {
                *self = *self $op o;
            }
        }
    )*};
}
operator! {
    Add add AddAssign add_assign +;
    Sub sub SubAssign sub_assign -;
    Mul mul MulAssign mul_assign *;
}

impl Neg for Counted {
    type Output = Self;
    /// Folds into the addition or the comparison that follows.
    fn neg(self) -> Self {
        Self(-self.0)
    }
}
impl num_traits::Zero for Counted {
    fn zero() -> Self {
        Self(0.0)
    }
    fn is_zero(&self) -> bool {
        self.0 == 0.0
    }
}
impl num_traits::One for Counted {
    fn one() -> Self {
        Self(1.0)
    }
}

impl Words for Counted {
    const LEN: usize = 2;
    const BLANK: Self = Self(0.0);
    fn put(&self, out: &mut impl FnMut(u32)) {
        self.0.put(out);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        self.0.fill(from);
    }
}

impl Real for Counted {
    type Sum = f64;
    type Quick = f64;

    const FLOATING: bool = false;

    const ZERO: Self = Self(0.0);
    const HALF: Self = Self(0.5);
    const ONE: Self = Self(1.0);
    const TWO: Self = Self(2.0);
    const NAME: &'static str = "counted";
    const LARGEST: f64 = f64::LARGEST;
    const LEAST_GAIN: f64 = f64::LEAST_GAIN;

    fn from_f64(x: f64) -> Self {
        Self(x)
    }
    fn to_f64(self) -> f64 {
        self.0
    }
    fn from_f32(x: f32) -> Self {
        Self(x.into())
    }
    fn to_f32(self) -> f32 {
        self.0 as f32
    }
    fn is_finite(self) -> bool {
        self.0.is_finite()
    }
    fn recip(self) -> Self {
        book(1);
        Self(self.0.recip())
    }
    fn dividend(self) -> Self {
        self
    }
    fn over_64(self, y: Self) -> Self {
        book(1);
        Self(self.0 / (64.0 * y.0))
    }
    fn over_64_of_negative(self, y: Self) -> Self {
        self.over_64(y)
    }
    fn rsqrt(self) -> Self {
        book(1);
        Self(self.0.max(1e-24).sqrt().recip())
    }
    fn rsqrt_next(self, _: Self) -> Option<Self> {
        Some(self.rsqrt())
    }
    fn recip_next(self, _: Self) -> Option<Self> {
        Some(self.recip())
    }
    fn half(self) -> Self {
        book(1);
        Self(0.5 * self.0)
    }
    fn quarter(self) -> Self {
        book(1);
        Self(0.25 * self.0)
    }
    fn abs(self) -> Self {
        book(1);
        Self(self.0.abs())
    }
    fn limit(self, bound: Self) -> Self {
        book(1);
        Self(self.0.clamp(-bound.0, bound.0))
    }
    fn clamp(self, lo: Self, hi: Self) -> Self {
        book(2);
        Self(self.0.clamp(lo.0, hi.0))
    }
    fn periods(self, n: u32) -> Self {
        Self(self.0 * f64::from(n) / 64.0)
    }
    fn fraction(n: i16) -> Self {
        Self(f64::from(n) / 32_768.0)
    }
    fn quantise(self, timer: &Timer) -> (u32, Self) {
        // Scaled, rounded, scaled back.
        book(3);
        let n = (self.0 * f64::from(timer.full())).round();
        (n as u32, Self(n / f64::from(timer.full())))
    }
    fn within(self, bound: Self) -> bool {
        book(1);
        self.0.abs() <= bound.0
    }
}

impl Sum<Counted> for f64 {
    fn of(x: Counted) -> Self {
        x.0
    }
    fn accumulate(&mut self, gain: Counted, x: Counted) {
        book(2);
        *self += gain.0 * x.0;
    }
    fn value(self) -> Counted {
        Counted(self)
    }
}

type R = Counted;

/// Control periods in a block of the filter at 10 kHz.
const BLOCK: u32 = 20;

/// Operations of the second of two calls: the first one settles what the state remembers.
fn operations<T>(call: impl FnMut() -> T) -> u32 {
    mean(1, call)
}

/// Mean of the second `n` calls.
fn mean<T>(n: u32, mut call: impl FnMut() -> T) -> u32 {
    for _ in 0..n {
        call();
    }
    COUNT.with(|c| c.set(0));
    for _ in 0..n {
        call();
    }
    COUNT.with(Cell::get).div_ceil(n)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let of = |scheme| {
        let params = DriveParams { scheme, ..DriveParams::new(&machine, &inverter) };
        DriveConfig::<R>::new(&machine, &inverter, &params)
    };
    let (config, enhanced) = (of(Scheme::Paper)?, of(Scheme::Enhanced)?);
    let (filter_config, slow_periods) = (enhanced.filter_config(), enhanced.slow_periods());
    let r = Counted;
    let v = |x: f64, y: f64| AlphaBeta::new(r(x), r(y));
    let (psi, i, u) = (v(0.7, 0.7), v(0.5, 0.6), v(0.04, 0.05));
    let i_dq = Dq::new(r(0.7), r(0.3));

    let mut flux = FluxEstimator::default();
    flux.start(psi, i);
    let mut speed = SpeedEstimator::default();
    speed.start(&psi, r(0.1));
    let mut resistance = ResistanceEstimator::default();
    resistance.start(r(0.08));
    let mut confidence = Confidence::default();
    let mut speed_control = SpeedController::default();
    let mut flux_control = FluxController::default();
    let mut current_control = CurrentController::default();
    let mut drive = running(config);
    let mut filter = Filter::new(filter_config);
    filter.start(filter_config, &i);
    filter.settle(filter_config, r(1.0));
    let loss = config.inverter_model().distortion(config.inverter_model().nominal(), &i, r(1.65), r(1.0));
    let seen = Input { u_s: u, loss: &loss, i_m: i, i_ref: &i_dq, omega_s: r(0.05) };
    let mut balance = Balance::default();
    let mut enhanced_drive = running(enhanced);
    let half = r(0.3);
    let measured = Measurement { i_abc: [r(0.6), -half, -half], u_dc: r(1.65) };
    let resistance_config = *config.resistance_config().ok_or("no adaptation")?;
    let mut calls = 0_u32;
    let table = [
        (
            "flux_estimator",
            mean(config.speed_periods(), || {
                calls += 1;
                if calls.is_multiple_of(config.speed_periods()) {
                    flux.set_stator_frequency(config.flux_config(), r(0.05));
                }
                flux.step(config.flux_config(), (&u, &i), r(0.08), r(1.0), calls);
            }),
        ),
        ("speed_estimator", operations(|| speed.step(config.speed_config(), &psi, &i))),
        ("resistance_adaptation", operations(|| resistance.step(&resistance_config, r(1.0), &i_dq, r(0.05), r(0.04)))),
        ("confidence", operations(|| confidence.step(config.confidence_config(), r(0.05), r(0.001), Some(r(1e-4))))),
        (
            "speed_control",
            operations(|| {
                speed_control.step(config.speed_control_config(), r(0.001), r(0.0), (r(1.0), r(1.0)), (r(-1.0), r(1.0)))
            }),
        ),
        (
            "flux_control",
            operations(|| {
                flux_control.step(
                    config.flux_control_config(),
                    (r(1.0), r(1.0), None),
                    r(0.99),
                    r(0.3),
                    r(0.05),
                    Range::Low,
                )
            }),
        ),
        (
            "current_control",
            operations(|| {
                let feedforward = Dq::new(r(0.05), r(0.05));
                current_control.step(config.current_config(), &i_dq, &i_dq, &feedforward, r(0.9))
            }),
        ),
        (
            "inverter_model",
            operations(|| {
                config.inverter_model().distortion(config.inverter_model().nominal(), &i, r(1.65), r(1.0)).phases
            }),
        ),
        ("modulator", operations(|| applied(&modulate([r(0.1), r(-0.3), r(0.2)], r(0.6), config.timer())))),
        ("drive_step", mean(slow_periods, || drive.step(&measured, &Reference::Speed(r(0.0))))),
        ("filter", mean(BLOCK, || filter.step(filter_config, &seen, false))),
        ("balance", operations(|| balance.remove(&i))),
        ("balance_fit", operations(|| balance.fit(enhanced.balance_config(), &i, r(0.0)))),
        (
            "drive_step_enhanced",
            mean(slow_periods * BLOCK, || enhanced_drive.step(&measured, &Reference::Speed(r(0.0)))),
        ),
    ];
    let fields: Vec<_> = table.iter().map(|(name, n)| format!("\"{name}\": {n}")).collect();
    println!("{{{}}}", fields.join(", "));
    Ok(())
}

/// A drive that runs, with the current that magnetisation asks for handed back to it.
fn running(config: DriveConfig<R>) -> Drive<R> {
    let mut drive = Drive::new(config);
    while drive.status() != Status::Running {
        let i = if drive.status() == Status::Magnetising { drive.estimate().i_dq_ref.re().0 } else { 0.0 };
        let i_abc = [i, -0.5 * i, -0.5 * i].map(Counted);
        drive.step(&Measurement { i_abc, u_dc: Counted(1.65) }, &Reference::Speed(Counted(0.0)));
    }
    drive
}
