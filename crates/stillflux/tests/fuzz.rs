//! Random machines, bridges, settings and measurements over all that the checks of the parameters admit: no panic and
//! no overflow, no number that is not finite, no duty outside [0, 1], no gate on in a period with a fault.
//!
//! Machines are drawn per unit within the ranges of `base.rs`, so that most of them are admitted, at random bases; the
//! settings within theirs. The currents follow their references with errors, so that the drives reach every state, and
//! at random instants anything may come: any bit pattern, a saturated channel, a reset, a restore, another reference.

use stillflux::base::PerUnit;
use stillflux::config::{DriveConfig, DriveParams, EncoderMode, EnhancedParams, LowConfidence, PaperParams, Scheme};
#[cfg(feature = "shunt")]
use stillflux::control::shunt::Pulses;
use stillflux::drive::{Drive, Measurement, Memory, Output, Reference, Status};
#[cfg(feature = "legs")]
use stillflux::inverter::Legs;
use stillflux::params::{Inverter, Machine, ParamError, Saturation};
use stillflux::scalar::{Q, Real};
use stillflux::space::{AlphaBeta, Dq};

/// SplitMix64.
struct Rng(u64);

impl Rng {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        x ^ (x >> 31)
    }
    /// 0 to 1.
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
    fn within(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }
    /// Evenly over the logarithm, the ends themselves in a tenth of the draws.
    fn ratio(&mut self, lo: f64, hi: f64) -> f64 {
        match self.bits() % 20 {
            0 => lo,
            1 => hi,
            _ => (lo.ln() + (hi / lo).ln() * self.unit()).exp().clamp(lo, hi),
        }
    }
    fn chance(&mut self, one_in: u64) -> bool {
        self.bits().is_multiple_of(one_in)
    }
}

/// An arithmetic that has bit patterns.
trait Bits: Real {
    fn from_pattern(bits: u32) -> Self;
}
impl Bits for f32 {
    fn from_pattern(bits: u32) -> Self {
        f32::from_bits(bits)
    }
}
impl Bits for Q {
    fn from_pattern(bits: u32) -> Self {
        Q::from_bits(bits as i32)
    }
}

/// A machine and its bridge.
fn hardware(rng: &mut Rng) -> (Machine, Inverter) {
    let (u_n, i_n, f_n) = (rng.ratio(1.0, 20e3), rng.ratio(0.01, 10e3), rng.ratio(1.0, 2000.0));
    let n_p = 1 + (rng.bits() % 60).min(rng.bits() % 8) as u32;
    let omega = std::f64::consts::TAU * f_n;
    let z = u_n / 3f64.sqrt() / i_n;
    let torque = 1.5 * f64::from(n_p) * (u_n * (2f64 / 3.0).sqrt() / omega) * i_n * 2f64.sqrt();
    let l_m = rng.ratio(0.3, 20.0);
    let saturation = (!rng.chance(3)).then(|| Saturation {
        L_u: rng.ratio(1.0, 3.0) * l_m * z / omega,
        a: rng.ratio(0.1, 3.0) * omega / u_n,
        S: rng.within(1.0, 20.0),
    });
    let f_s = rng.ratio(1e3, 100e3);
    let u_dc = rng.ratio(0.2, 8.0) * u_n * (2f64 / 3.0).sqrt();
    let machine = Machine {
        R_s: rng.ratio(5e-4, 0.5) * z,
        R_R: rng.ratio(5e-4, 0.5) * z,
        L_sigma: (rng.ratio(0.005, 0.5) * l_m).clamp(0.02, 0.8) * z / omega,
        L_M: l_m * z / omega,
        n_p,
        J: rng.ratio(0.1, 1e6) * torque * f64::from(n_p) / (omega * omega),
        U_N: u_n,
        I_N: i_n,
        f_N: f_n,
        T_N: rng.ratio(0.05, 2.0) * torque,
        saturation,
    };
    let inverter = Inverter {
        u_dc,
        f_s,
        u_th: rng.ratio(1e-6, 0.05) * u_dc,
        r_d: if rng.chance(2) { 0.0 } else { rng.ratio(1e-3, 1.0) * machine.R_s },
        dead_time: if rng.chance(5) { 0.0 } else { rng.ratio(1e-4, 0.1) / f_s },
        f_clk: if rng.chance(8) { 0.0 } else { rng.ratio(200.0, 8e6) * f_s },
        c_out: if rng.chance(3) { 0.0 } else { rng.ratio(1e-12, 10e-9) },
        leg_delay: [[0.0; 2]; 3].map(|x: [f64; 2]| x.map(|_| rng.within(-1.0, 1.0) * (0.005 / f_s).min(1e-6))),
        half_periods: [if cfg!(feature = "modes") { 1 } else { 2 }, 2, 2, 4, 6, 16][rng.bits() as usize % 6],
    };
    (machine, inverter)
}

/// Temperatures within their ranges, or none.
fn temperature(rng: &mut Rng, d: EnhancedParams) -> EnhancedParams {
    if rng.chance(2) {
        return d;
    }
    EnhancedParams {
        winding_temperature: Some(rng.within(-40.0, 120.0)),
        cage_constant: rng.within(200.0, 260.0),
        rotor_rise: rng.within(0.3, 2.0),
        winding_heat: rng.chance(2).then(|| (rng.within(5.0, 200.0), rng.ratio(1.0, 7200.0))),
        ..d
    }
}

/// Settings within their ranges.
fn settings(rng: &mut Rng, machine: &Machine, inverter: &Inverter) -> DriveParams {
    let d = DriveParams::new(machine, inverter);
    if rng.chance(4) {
        return DriveParams { offset_time: 12.0 / inverter.f_s, scheme: scheme(rng), ..d };
    }
    let i_n = machine.I_N * 2f64.sqrt();
    let omega_n = machine.omega_sR() / f64::from(machine.n_p);
    let psi_ref = rng.within(0.3, 1.2);
    let i_0 = psi_ref * machine.U_N * (2f64 / 3.0).sqrt() / machine.omega_sR() / machine.L_s();
    let i_max = rng.ratio(1.1 * i_0, (5.0 * i_n).max(1.1 * i_0));
    let i_trip = rng.ratio(i_max, (8.0 * i_n).max(i_max));
    let tau_r = machine.L_M / machine.R_R;
    let fastest = 0.7 * inverter.f_s / f64::from(machine.n_p);
    let scheme = scheme(rng);
    let calibrate_offset = !rng.chance(3);
    let current_sensors = if cfg!(feature = "shunt") {
        1 + rng.bits() as u32 % 3
    } else if cfg!(feature = "modes") {
        2 + rng.bits() as u32 % 2
    } else {
        3
    };
    let paper = PaperParams {
        offset_estimator: !rng.chance(4),
        noise_compensator: !rng.chance(4),
        resistance_adaptation: !rng.chance(4),
        ..d.paper
    };
    let enhanced = EnhancedParams {
        identify_offset: !rng.chance(4),
        identify_resistance: !rng.chance(4),
        identify_legs: !rng.chance(4) && cfg!(feature = "legs"),
        find_slow_rotation: !rng.chance(4) && cfg!(feature = "restart"),
        hold_inductances: !rng.chance(4),
        apply_innovation: !rng.chance(6),
        dither: if rng.chance(2) && cfg!(feature = "dither") { rng.within(0.0, 0.3) } else { 0.0 },
        omega_s_min: if rng.chance(4) { 0.0 } else { rng.within(0.001, 0.05) * machine.omega_sR() },
        prior_R_s: rng.ratio(0.002, 0.5),
        prior_loss: rng.ratio(0.002, 1.0),
        prior_c_out: rng.ratio(0.002, 1.0),
        prior_L_sigma: rng.ratio(0.002, 1.0),
        prior_R_R: rng.ratio(0.002, 0.5),
        prior_L_M: rng.ratio(0.002, 0.5),
        ..temperature(rng, d.enhanced)
    };
    let (torque_max, omega_max) = (
        rng.ratio(0.05, 5.0) * machine.T_N,
        rng.ratio(0.01 * omega_n, (3.0 * omega_n).min(fastest).max(0.01 * omega_n)),
    );
    let (u_dc_min, u_dc_max) = (rng.within(0.0, 1.0) * inverter.u_dc, rng.within(1.05, 3.0) * inverter.u_dc);
    let acceleration = rng.chance(2).then(|| rng.ratio(1e-3 * omega_n, 1e3 * omega_n));
    let body = |rng: &mut Rng| {
        let current = rng.ratio(1.1 * i_0, i_max.max(1.1 * i_0)) / 2f64.sqrt();
        rng.chance(3).then(|| (current, rng.ratio(1e4 / inverter.f_s, 3600.0)))
    };
    let encoder = cfg!(feature = "encoder") && !rng.chance(3);
    DriveParams {
        scheme,
        psi_ref,
        i_max,
        torque_max,
        omega_max,
        i_trip,
        i_range: rng.ratio(i_trip, (20.0 * i_n).max(i_trip)),
        u_dc_min,
        u_dc_max,
        current_bandwidth: rng.ratio(10.0, 0.06 * inverter.f_s),
        flux_bandwidth: rng.ratio(0.1, 30.0),
        speed_bandwidth: rng.ratio(0.05, 20.0),
        set_point_weight: rng.within(0.0, 1.0),
        pll_bandwidth: rng.ratio(2.0, (0.03 * inverter.f_s).min(100.0)),
        inverter_model: !rng.chance(5),
        calibrate_offset,
        current_sensors,
        shunt_settling: rng.within(0.0, 0.0375) / inverter.f_s,
        shunt_window: if rng.chance(5) {
            0.0
        } else {
            rng.within(inverter.dead_time * inverter.f_s, 0.15) / inverter.f_s
        },
        offset_time: 12.0 / inverter.f_s,
        magnetise_time: (3.0 * tau_r).max(1e-6),
        low_confidence: [LowConfidence::Keep, LowConfidence::LimitTorque, LowConfidence::Fault]
            [(rng.bits() % 3) as usize],
        fresh_time: rng.within(0.0, 3600.0),
        supervision: !rng.chance(4),
        discontinuous_above: (cfg!(feature = "modes") && rng.chance(3)).then(|| rng.within(0.3, 1.0)),
        field_weakening: !rng.chance(4),
        realignment: !rng.chance(4),
        reduce_gain: !rng.chance(4),
        overmodulation: rng.chance(4),
        acceleration,
        jerk: (acceleration.is_some() && rng.chance(2)).then(|| rng.ratio(1e-2 * omega_n, 1e5 * omega_n)),
        torque_limits: rng.chance(3).then(|| (-rng.within(0.0, torque_max), rng.within(0.0, torque_max))),
        speed_limits: rng.chance(3).then(|| (-rng.within(0.0, omega_max), rng.within(0.0, omega_max))),
        machine_overload: body(rng),
        bridge_overload: body(rng),
        u_dc_brake: rng.chance(3).then(|| rng.within(1.1 * inverter.u_dc, u_dc_max.max(1.1 * inverter.u_dc))),
        u_dc_buffer: rng.chance(3).then(|| rng.within(u_dc_min.min(0.9 * inverter.u_dc), 0.9 * inverter.u_dc)),
        u_dc_chopper: rng.chance(3).then(|| {
            let on = 1.02 * inverter.u_dc;
            (on, on + rng.within(0.005 * inverter.u_dc, (u_dc_max - on).max(0.005 * inverter.u_dc)))
        }),
        encoder_lines: if encoder { rng.ratio(16.0 * f64::from(machine.n_p), 65_536.0) as u32 } else { 0 },
        encoder_states: rng.ratio(65_536.0, f64::from(1_u32 << 31)) as u32,
        encoder_mode: if encoder && rng.chance(2) { EncoderMode::Control } else { EncoderMode::Compare },
        encoder_deviation: rng.ratio(0.005, 10.0) * omega_n,
        encoder_fault: encoder && rng.chance(3),
        stall_time: if rng.chance(4) { 0.0 } else { rng.ratio(0.1, 60.0) },
        paper: if scheme == Scheme::Paper { paper } else { d.paper },
        enhanced: if scheme == Scheme::Enhanced { enhanced } else { d.enhanced },
    }
}

fn scheme(rng: &mut Rng) -> Scheme {
    Scheme::ALL[rng.bits() as usize % Scheme::ALL.len()]
}

/// A configuration that is admitted, after so many that were not.
fn drawn<R: Real>(rng: &mut Rng, refused: &mut impl FnMut(&ParamError)) -> (DriveConfig<R>, PerUnit, DriveParams) {
    loop {
        let (machine, inverter) = hardware(rng);
        let params = settings(rng, &machine, &inverter);
        match DriveConfig::<R>::new(&machine, &inverter, &params) {
            Ok(config) => return (config, PerUnit::new(&machine, &inverter).unwrap(), params),
            Err(e) => refused(&e),
        }
    }
}

/// What a single shunt reads of the phase currents in the pulses of the call before the latest one.
#[cfg(feature = "shunt")]
fn of_shunt<R: Bits>(pulses: &mut [Option<Pulses<R>>; 2], drive: &Drive<R>, phases: [R; 3]) -> [R; 3] {
    let [active, latest] = *pulses;
    *pulses = [latest, drive.pulses()];
    let Some(p) = active else { return phases };
    let link = |at: R| (0..3).filter(|k| p.falling[*k] >= at).map(|k| phases[k]).fold(R::ZERO, |sum, i| sum + i);
    [link(p.sample[0]), link(p.sample[1]), R::ZERO]
}

/// Runs one drive for so many periods; whether it came to run.
fn fuzz<R: Bits>(rng: &mut Rng, periods: u32, seed: u64, refused: &mut impl FnMut(&ParamError)) -> bool {
    let (config, pu, params) = drawn::<R>(rng, refused);
    let mut drive = Drive::new(config);
    let r = |x: f64| R::from_f64(x);
    let mut reference = Reference::Speed(R::ZERO);
    let (mut u_dc, mut omega) = (pu.u_dc, 0.0_f64);
    let (noise, follows, wild) = (rng.ratio(1e-4, 0.3), rng.within(0.2, 1.0), 10_u64.pow((rng.bits() % 4) as u32 + 1));
    let mut i = Dq::new(R::ZERO, R::ZERO);
    let mut ran = false;
    #[cfg(feature = "shunt")]
    let mut pulses = [drive.pulses(); 2];
    #[cfg(feature = "encoder")]
    let mut shaft = rng.bits() as u32;
    #[cfg(feature = "supervision")]
    let (mut stamp, mut out) = (0_u16, Output { duty: [R::HALF; 3], gates_on: false });
    for k in 0..periods {
        let e = drive.estimate();
        let status = drive.status();
        ran |= status == Status::Running;
        // Currents that follow their references along the estimated field, or along the a-axis before there is one.
        let (re, im) = (e.flux.psi_s.re().to_f64(), e.flux.psi_s.im().to_f64());
        let psi = re.hypot(im);
        let (c, s) = if psi > 0.05 { (re / psi, im / psi) } else { (1.0, 0.0) };
        if status == Status::Magnetising || status == Status::Running {
            i += (e.i_dq_ref - i) * r(follows);
        } else {
            i = Dq::new(R::ZERO, R::ZERO);
        }
        let (d, q) = (i.re().to_f64(), i.im().to_f64());
        let phases = AlphaBeta::new(r(d * c - q * s), r(d * s + q * c)).to_phases();
        #[cfg(feature = "shunt")]
        let phases = of_shunt(&mut pulses, &drive, phases);
        let mut measured =
            Measurement { i_abc: phases.map(|x| x + r(noise * 0.1 * (rng.unit() - 0.5))), u_dc: r(u_dc) };
        if rng.chance(wild * 37) {
            match rng.bits() % 8 {
                0 if rng.chance(4) => measured.i_abc = [0; 3].map(|_| R::from_pattern(rng.bits() as u32)),
                0 => measured.i_abc[(rng.bits() % 3) as usize] = R::from_pattern(rng.bits() as u32),
                1 => measured.u_dc = R::from_pattern(rng.bits() as u32),
                2 => measured.i_abc[(rng.bits() % 3) as usize] = r(params.i_range / pu.base.i * rng.within(-1.1, 1.1)),
                3 => u_dc = rng.within(params.u_dc_min, params.u_dc_max) / pu.base.u,
                4 => omega = 2.0 * rng.within(-1.0, 1.0) * params.omega_max / pu.base.omega_m,
                5 => {
                    let mut any = || R::from_pattern(rng.bits() as u32);
                    let memory = Memory {
                        u_off: AlphaBeta::new(any(), any()),
                        r_s: any(),
                        i_off: [any(), any(), any()],
                        loss_error: any(),
                        knee: any(),
                        leakage: any(),
                        inv_l_m: any(),
                        #[cfg(feature = "legs")]
                        legs: Legs { even: AlphaBeta::new(any(), any()), odd: AlphaBeta::new(any(), any()) },
                    };
                    // It is taken while the bridge is blocked only.
                    if rng.chance(2) {
                        drive.step(&measured, &Reference::Stop);
                    }
                    drive.restore(&memory);
                }
                6 => reference = Reference::Torque(R::from_pattern(rng.bits() as u32)),
                _ => reference = Reference::Stop,
            }
        } else if rng.chance(50) {
            reference =
                if rng.chance(5) { Reference::Torque(r(rng.within(-1.5, 1.5))) } else { Reference::Speed(r(omega)) };
        }
        #[cfg(feature = "encoder")]
        {
            // Counts of any speed, and now and then of none: a silent counter, one that stands, one that jumps.
            shaft = if rng.chance(wild * 11) {
                rng.bits() as u32
            } else {
                shaft.wrapping_add((omega * 40.0) as i32 as u32)
            };
            if !rng.chance(wild) {
                drive.set_encoder(shaft % params.encoder_states);
            }
            if rng.chance(wild * 37) {
                drive.set_encoder(rng.bits() as u32);
            }
        }
        #[cfg(not(feature = "supervision"))]
        let out = drive.step(&measured, &reference);
        #[cfg(feature = "supervision")]
        let out = {
            // A counter that goes on, or does not, or jumps.
            stamp = if rng.chance(wild * 307) { rng.bits() as u16 } else { stamp.wrapping_add(1) };
            for _ in 0..if rng.chance(wild * 293) { 8 } else { 0 } {
                out = drive.step_at(stamp, &measured, &reference).unwrap_or(out);
                check(&drive, &out, seed, k);
            }
            out = drive.step_at(stamp, &measured, &reference).unwrap_or(out);
            out
        };
        check(&drive, &out, seed, k);
        if matches!(drive.status(), Status::Faulted { .. }) && rng.chance(20) {
            drive.reset();
        }
    }
    ran
}

fn check<R: Real>(drive: &Drive<R>, out: &Output<R>, seed: u64, k: u32) {
    let switches = matches!(drive.status(), Status::Magnetising | Status::Running);
    assert!(switches || !out.gates_on, "{} seed {seed} period {k}: {:?}", R::NAME, drive.status());
    for duty in out.duty {
        assert!(duty >= R::ZERO && duty <= R::ONE, "{} seed {seed} period {k}: duty {duty:?}", R::NAME);
    }
    #[cfg(feature = "shunt")]
    if let Some(p) = drive.pulses() {
        for x in p.rising.into_iter().chain(p.falling).chain(p.sample) {
            assert!(x >= R::ZERO && x <= R::ONE, "{} seed {seed} period {k}: {p:?}", R::NAME);
        }
    }
    #[cfg(feature = "encoder")]
    if let Some(e) = drive.encoder() {
        assert!(
            e.omega_m.abs() <= R::from_f64(4.0) && e.difference.is_finite(),
            "{} seed {seed} period {k}: {e:?}",
            R::NAME
        );
    }
    let (e, m) = (drive.estimate(), drive.memory());
    let numbers = [
        e.speed.omega_m,
        e.speed.omega_s,
        e.speed.omega_r,
        e.torque,
        e.r_s,
        e.confidence,
        e.speed_gain,
        e.flux.magnitude,
        e.flux.psi_s.re(),
        e.flux.psi_s.im(),
        e.psi_1.re(),
        e.psi_1.im(),
        e.u_off.re(),
        e.u_off.im(),
        e.u_s.re(),
        e.u_s.im(),
        e.i_dq.re(),
        e.i_dq.im(),
        e.i_dq_ref.re(),
        e.i_dq_ref.im(),
        e.psi_ref,
        e.r_r,
        e.epsilon,
        e.innovation,
        e.nis,
        e.angle_deviation,
        m.u_off.re(),
        m.u_off.im(),
        m.r_s,
        m.i_off[0],
        m.i_off[1],
        m.i_off[2],
        m.loss_error,
        m.knee,
        m.leakage,
        m.inv_l_m,
        #[cfg(feature = "legs")]
        m.legs.even.re(),
        #[cfg(feature = "legs")]
        m.legs.odd.im(),
    ];
    for (n, x) in numbers.iter().enumerate() {
        assert!(x.is_finite(), "{} seed {seed} period {k}: number {n} is {x:?}\n{e:?}\n{m:?}", R::NAME);
    }
    assert!(e.confidence >= R::ZERO && e.confidence <= R::ONE, "{} seed {seed} period {k}", R::NAME);
    assert!(e.speed_gain > R::ZERO && e.speed_gain <= R::ONE, "{} seed {seed} period {k}", R::NAME);
}

/// So many drives from `first` on, each for so many periods: how many came to run, and how often each field was
/// refused.
fn campaign<R: Bits>(first: u64, drives: u64, periods: u32) {
    let mut refusals: Vec<(&'static str, u32)> = Vec::new();
    let mut ran = 0;
    for seed in first..first + drives {
        let mut rng = Rng(seed.wrapping_mul(0xD134_2543_DE82_EF95));
        let mut refused = |e: &ParamError| {
            assert_ne!(
                e.field, "configuration",
                "seed {seed}: a constant out of range that no field is named for: {e}"
            );
            assert!(!(e.min..=e.max).contains(&e.value), "seed {seed}: {e}");
            match refusals.iter_mut().find(|x| x.0 == e.field) {
                Some(x) => x.1 += 1,
                None => refusals.push((e.field, 1)),
            }
        };
        ran += u64::from(fuzz::<R>(&mut rng, periods, seed, &mut refused));
    }
    println!("{}: {ran} of {drives} drives came to run; refused: {refusals:?}", R::NAME);
    assert!(ran * 4 > drives, "{ran} of {drives} drives came to run");
}

// A minute of one core together.

#[test]
fn whatever_is_admitted_keeps_its_numbers_in_floating_point() {
    campaign::<f32>(1, 1_800, 30_000);
}

#[test]
fn whatever_is_admitted_keeps_its_numbers_in_fixed_point() {
    campaign::<Q>(500_001, 1_800, 30_000);
}

// 10⁹ periods together.

#[test]
#[ignore = "slow: make test-slow"]
fn whatever_is_admitted_keeps_its_numbers_in_floating_point_for_half_a_billion_periods() {
    campaign::<f32>(1_000_001, 10_000, 50_000);
}

#[test]
#[ignore = "slow: make test-slow"]
fn whatever_is_admitted_keeps_its_numbers_in_fixed_point_for_half_a_billion_periods() {
    campaign::<Q>(2_000_001, 10_000, 50_000);
}
