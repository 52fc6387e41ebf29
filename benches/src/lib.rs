//! What the benchmarks share: every block on an operating point, and a recorded closed loop for the drive, in
//! any arithmetic.
//!
//! `cargo bench` prints time (`control`) and instructions (`instructions`, under valgrind) of every block and of
//! the drive step, and how many simulated seconds a wall second makes (`simulation`).

use std::hint::black_box;

use stillflux::base::{Base, PerUnit};
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
use stillflux::inverter::Distortion;
use stillflux::inverter::InverterModel;
use stillflux::params::{Inverter, Machine};
use stillflux::scalar::{Real, Timer};
use stillflux::si::SiUnits;
use stillflux::space::{AlphaBeta, Dq};
use stillflux_sim::simulate::{Profile, ReferenceProfile, Scenario};
use stillflux_sim::{Plant, PlantParams};

/// The machine all benchmarks run.
#[must_use]
pub fn machine() -> (Machine, Inverter) {
    (Machine::preset_2k2(), Inverter::preset_2k2())
}

/// Speed of the benchmarks, per unit.
pub const OMEGA: f64 = 0.03;

/// Start, low speed, rated load: the scenario behind the simulation figures.
#[must_use]
pub fn scenario(duration: f64) -> Scenario {
    let (machine, inverter) = machine();
    let base = Base::new(&machine);
    let profile = |points: Vec<(f64, f64)>| Profile::new(points).expect("ascending");
    let mut s = Scenario::new(machine, inverter, duration);
    s.reference = ReferenceProfile::Speed(profile(vec![(0.0, 0.0), (1.6, 0.0), (1.8, OMEGA * base.omega_m)]));
    s.load = profile(vec![(0.0, 0.0), (2.5, 0.0), (2.5, machine.T_N)]);
    s
}

/// A configuration of that machine.
fn configuration<R: Real>(scheme: Scheme) -> DriveConfig<R> {
    let (machine, inverter) = machine();
    let params = DriveParams { scheme, ..DriveParams::new(&machine, &inverter) };
    DriveConfig::new(&machine, &inverter, &params).expect("valid parameters")
}

/// A drive that runs, and the measurements of its next periods.
#[must_use]
pub fn running<R: Real>(scheme: Scheme, samples: usize) -> (Drive<R>, Vec<Measurement<R>>) {
    let (machine, inverter) = machine();
    let units = SiUnits::new(&machine, &inverter);
    let mut drive = Drive::new(configuration(scheme));
    let mut plant = Plant::new(PlantParams::new(machine, inverter)).expect("valid parameters");
    let mut sample = plant.sample();
    let mut step = |drive: &mut Drive<R>, omega: f64, load: f64| {
        let measured = units.measurement(&sample);
        let out = drive.step(&measured, &Reference::Speed(R::from_f64(omega)));
        sample = plant.step(out.duty.map(R::to_f64), out.gates_on, load);
        measured
    };
    while drive.status() != Status::Running {
        step(&mut drive, 0.0, 0.0);
    }
    for _ in 0..10_000 {
        step(&mut drive, OMEGA, machine.T_N);
    }
    let mut ahead = drive;
    (drive, (0..samples).map(|_| step(&mut ahead, OMEGA, machine.T_N)).collect())
}

/// Names of the [`blocks`].
pub const BLOCKS: [&str; 11] = [
    "flux estimator",
    "speed",
    "resistance",
    "confidence",
    "current control",
    "flux control",
    "speed control",
    "inverter model",
    "modulator",
    "filter",
    "balance",
];

/// A block with its state and inputs, ready for a call.
pub type Call = Box<dyn FnMut()>;

/// One call of each block in an undisturbed period; of the filter, a slot of a block's work.
#[must_use]
pub fn blocks<R: Real>() -> [(&'static str, Call); 11] {
    let r = R::from_f64;
    let (machine, inverter) = machine();
    let config: &'static DriveConfig<R> = Box::leak(Box::new(configuration(Scheme::Paper)));
    let enhanced: &'static DriveConfig<R> = Box::leak(Box::new(configuration(Scheme::Enhanced)));
    let filter_config = enhanced.filter_config();
    let model = InverterModel::<R>::new(&PerUnit::new(&machine, &inverter).expect("valid"));
    let timer = Timer::new(8500).expect("within its range");
    let (u, i) = (AlphaBeta::new(r(0.05), r(0.03)), AlphaBeta::new(r(0.6), r(0.4)));
    let (i_dq, i_ref) = (Dq::new(r(0.6), r(0.4)), Dq::new(r(0.61), r(0.42)));
    let psi = AlphaBeta::new(r(0.9), r(0.4));
    let resistance_config = config.resistance_config().expect("on by default");

    let mut flux = FluxEstimator::default();
    flux.start(psi, i);
    let mut period = 0;
    let mut speed = SpeedEstimator::default();
    speed.start(&psi, R::ZERO);
    let mut resistance = ResistanceEstimator::default();
    resistance.start(r(0.08));
    let mut confidence = Confidence::default();
    let mut current = CurrentController::default();
    let mut flux_control = FluxController::default();
    let mut speed_control = SpeedController::default();
    let mut filter = Filter::new(filter_config);
    filter.start(filter_config, &i);
    filter.settle(filter_config, R::ONE);
    let mut balance = Balance::default();
    let calls: [Call; 11] = [
        Box::new(move || {
            period += 1;
            if period % config.speed_periods() == 0 {
                flux.set_stator_frequency(config.flux_config(), black_box(r(0.03)));
            }
            flux.step(config.flux_config(), (black_box(&u), &i), r(0.08), R::ONE, period);
            black_box(flux.magnitude());
        }),
        Box::new(move || {
            black_box(speed.step(config.speed_config(), black_box(&psi), &i));
        }),
        Box::new(move || {
            black_box(resistance.step(resistance_config, R::ONE, black_box(&i_dq), r(0.03), r(0.02)));
        }),
        Box::new(move || {
            black_box(confidence.step(config.confidence_config(), black_box(r(0.03)), r(1e-4), None));
        }),
        Box::new(move || {
            black_box(current.step(config.current_config(), black_box(&i_ref), &i_dq, &i_dq, R::ONE));
        }),
        Box::new(move || {
            black_box(flux_control.step(
                config.flux_control_config(),
                (R::ONE, R::ONE, None),
                black_box(R::ONE),
                r(0.4),
                r(0.03),
                Range::Low,
            ));
        }),
        Box::new(move || {
            black_box(speed_control.step(
                config.speed_control_config(),
                black_box(r(0.01)),
                R::ZERO,
                (R::ONE, R::ONE),
                (-R::ONE, R::ONE),
            ));
        }),
        Box::new(move || {
            black_box(model.distortion(model.nominal(), black_box(&i), r(1.65), R::ONE));
        }),
        Box::new(move || {
            black_box(applied(&modulate(black_box([r(0.1), r(-0.2), r(0.1)]), r(0.6), Some(&timer))));
        }),
        Box::new(move || {
            let phases = [r(0.03), r(-0.02), r(-0.01)];
            let loss = Distortion { phases, full: r(0.03), ..Distortion::default() };
            let seen = Input { u_s: black_box(u), loss: &loss, i_m: i, i_ref: &i_ref, omega_s: r(0.03) };
            filter.step(filter_config, &seen, false);
            black_box(filter.magnitude());
        }),
        Box::new(move || {
            balance.fit(enhanced.balance_config(), black_box(&i), R::ZERO);
            black_box(balance.remove(black_box(&i)));
        }),
    ];
    let mut names = BLOCKS.into_iter();
    calls.map(|call| (names.next().expect("a name for each"), call))
}
