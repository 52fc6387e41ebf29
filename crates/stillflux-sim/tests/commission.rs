//! Commissioning of the plant's machines by their nameplates: what is found, what is refused, what stays.

use stillflux::commission::si::{Shaft, SiCommissioning};
use stillflux::commission::{Cause, Found, Nameplate, Status};
use stillflux::params::{Inverter, Machine};
use stillflux::si::Arithmetic;
use stillflux_sim::PlantParams;
use stillflux_sim::commission::{CommissioningRun, Wiring};

/// Plate of the 2.2-kW preset at 1380 r/min.
const PLATE: Nameplate =
    Nameplate { P_N: 2110.0, U_N: 400.0, I_N: 4.9, f_N: 50.0, n_N: 1380.0, cos_phi: 0.8, T_max: None, J: None };

fn plant() -> PlantParams {
    let (m, inv) = (Machine::preset_2k2(), Inverter { dead_time: 2.1e-6, c_out: 0.6e-9, ..Inverter::preset_2k2() });
    let mut p = PlantParams::new(m, inv);
    p.adc.noise = 0.004 * m.I_N;
    p.adc.offset = [0.05, -0.06, 0.02];
    p.adc.gain = [1.006, 0.995, 1.002];
    p
}

fn run(shaft: Shaft, arithmetic: Arithmetic, wiring: Wiring) -> CommissioningRun {
    let mut run = CommissioningRun::new(&PLATE, &Inverter::preset_2k2(), shaft, arithmetic, plant(), wiring).unwrap();
    while run.advance(10_000) {}
    run
}

#[allow(non_snake_case)]
fn check(found: &Found) {
    let (m, inv) = (Machine::preset_2k2(), plant().inverter);
    let psi = (2.0f64 / 3.0).sqrt() * m.U_N / m.omega_sR();
    let L_M = m.saturation.map(|s| s.L_u / (1.0 + (s.a * psi).powf(s.S)) - m.L_sigma).unwrap();
    for (name, got, want, limit) in [
        ("R_s + r_d", found.machine.R_s + found.inverter.r_d, m.R_s + inv.r_d, 0.01),
        ("R_R", found.machine.R_R, m.R_R, 0.03),
        ("L_sigma", found.machine.L_sigma, m.L_sigma, 0.03),
        ("L_M", found.machine.L_M, L_M, 0.04),
        ("dead time", found.inverter.dead_time, inv.dead_time, 0.03),
        ("c_out", found.inverter.c_out, inv.c_out, 0.25),
    ] {
        assert!((got / want - 1.0).abs() < limit, "{name}: {got}, not {want}");
    }
}

#[test]
fn a_machine_is_found_at_standstill_in_every_arithmetic() {
    for arithmetic in [Arithmetic::F32, Arithmetic::F64, Arithmetic::Q] {
        let run = run(Shaft::Locked, arithmetic, Wiring::default());
        assert_eq!(run.commissioning().status(), Status::Done, "{arithmetic:?}");
        let (current, turned) = run.extremes();
        assert!(current < 1.5 && turned.to_degrees() < 1.0, "{current} {turned}");
        assert!(run.time() < 60.0);
        check(&run.commissioning().result().unwrap());
    }
}

#[test]
fn a_free_shaft_gives_the_inertia_and_stays_where_it_is_before() {
    let run = run(Shaft::Free, Arithmetic::F32, Wiring::default());
    let found = run.commissioning().result().unwrap();
    let (current, turned) = run.extremes();
    assert!(current < 1.5 && turned.to_degrees() < 1.0, "{current} {turned}");
    assert!((found.machine.J / Machine::preset_2k2().J - 1.0).abs() < 0.1, "{} {:?}", found.machine.J, found.warnings);
    assert!(!found.warnings.no_inertia);
    check(&found);
}

#[test]
fn wrong_wiring_is_named_before_any_large_current_flows() {
    let channels = |c| Wiring { channels: Some(c), gain: None };
    let gain = |g| Wiring { channels: None, gain: Some(g) };
    for (wiring, cause) in [
        (channels([1, 0, 2]), Cause::SwappedChannels),
        (channels([0, 2, 1]), Cause::SwappedChannels),
        (channels([1, 2, 0]), Cause::SwappedChannels),
        (gain([-1.0, 1.0, 1.0]), Cause::InvertedChannel),
        (gain([1.0, 1.0, -1.0]), Cause::InvertedChannel),
        (gain([-1.0, -1.0, -1.0]), Cause::InvertedChannel),
        (gain([1.0, 0.0, 1.0]), Cause::DeadChannel),
        (gain([1.0, 0.6, 1.0]), Cause::ChannelGain),
        (gain([0.0, 0.0, 0.0]), Cause::NoMotor),
    ] {
        let run = run(Shaft::Locked, Arithmetic::F32, wiring);
        assert_eq!(run.commissioning().cause(), Some(cause), "{wiring:?}");
        assert!(run.extremes().0 < 0.6, "{wiring:?}: {}", run.extremes().0);
        let found = run.commissioning().result().unwrap();
        assert!(found.warnings.incomplete && found.bridge.is_none(), "the nameplate's values stay");
    }
}

#[test]
fn another_machine_is_refused_before_any_large_current_flows() {
    let small = Nameplate { P_N: 250.0, I_N: 0.75, n_N: 1350.0, cos_phi: 0.7, ..PLATE };
    let large = Nameplate { P_N: 30e3, I_N: 56.0, n_N: 1465.0, cos_phi: 0.85, ..PLATE };
    for plate in [small, large] {
        let sheet = Inverter { f_clk: 0.0, ..Inverter::preset_2k2() };
        let mut run =
            CommissioningRun::new(&plate, &sheet, Shaft::Locked, Arithmetic::F32, plant(), Wiring::default()).unwrap();
        while run.advance(10_000) {}
        let cause = run.commissioning().cause();
        assert!(
            matches!(cause, Some(Cause::WrongMotor | Cause::ShortCircuit | Cause::NoMotor | Cause::CurrentOffset)),
            "{cause:?}"
        );
        assert!(run.extremes().0 * plate.I_N < 0.7 * 4.9, "{}", run.extremes().0);
    }
}

#[test]
fn what_was_found_survives_an_abort_at_any_time() {
    for periods in [500, 3000, 26_000, 30_000, 35_000] {
        let mut run = CommissioningRun::new(
            &PLATE,
            &Inverter::preset_2k2(),
            Shaft::Locked,
            Arithmetic::F32,
            plant(),
            Wiring::default(),
        )
        .unwrap();
        run.advance(periods);
        let stage = run.commissioning().stage();
        run.abort();
        assert!(!run.advance(10));
        assert_eq!(run.commissioning().cause(), Some(Cause::Aborted), "{stage} at {} s", run.time());
        let found = run.commissioning().result().unwrap();
        found.machine.validate().unwrap();
        assert!(found.warnings.incomplete);
        assert_eq!(found.bridge.is_some(), periods > 25_500, "{stage}");
    }
}

#[test]
fn whatever_the_converters_deliver_the_gates_block_and_nothing_panics() {
    use stillflux::si::MeasurementSi;
    for i in [f64::NAN, f64::INFINITY, 1e30, -1e30] {
        for u_dc in [540.0, f64::NAN, 0.0, -1e30] {
            let new = |a| SiCommissioning::new(&PLATE, &Inverter::preset_2k2(), Shaft::Free, a).unwrap();
            for arithmetic in [Arithmetic::F32, Arithmetic::F64, Arithmetic::Q] {
                let mut c = new(arithmetic);
                let (duty, gates_on) = c.step(&MeasurementSi { i_abc: [i, 0.0, 0.0], u_dc });
                assert!(!gates_on && duty == [0.5; 3]);
                assert!(c.cause().is_some());
            }
        }
    }
}
