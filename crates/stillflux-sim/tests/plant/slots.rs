//! Saturating leakage and slots: limits, the small-signal leakage, harmonics, energy balance.

use super::*;
use std::f64::consts::TAU;
use stillflux::params::Machine;
use stillflux_sim::{DeepBar, IronLoss, LeakageSaturation, Mode, Plant, PlantParams, SlotRipple};

const SLOTS: SlotRipple = SlotRipple { slots: 28, permeance: 0.01, leakage: 0.05 };
const KNEE: LeakageSaturation = LeakageSaturation { share: 0.25, current: 10.0 };

#[test]
fn vanishing_amplitudes_are_the_plain_circuit() {
    runs_up_alike(|one| PlantParams {
        leakage_saturation: Some(LeakageSaturation { share: 1e-12, current: 10.0 }),
        slot_ripple: Some(SlotRipple { slots: 28, permeance: 1e-12, leakage: 1e-12 }),
        ..one
    });
}

#[test]
fn energy_is_conserved_while_slots_pass_and_leakage_saturates() {
    for (c_out, branches, mode) in [
        (0.0, false, Mode::Switching),
        (1e-9, false, Mode::Switching),
        (1e-9, true, Mode::Switching),
        (0.0, false, Mode::Averaged),
    ] {
        let mut p = PlantParams { mode, leakage_saturation: Some(KNEE), slot_ripple: Some(SLOTS), ..capacitive(c_out) };
        if branches {
            p.iron_loss = Some(IronLoss { R_fe: 900.0, time_constant: 150e-6 });
            p.deep_bar = Some(DeepBar { conductance: 0.3, leakage: 0.6 });
        }
        let (plant, e, machine, all) = energies(p);
        assert!(plant.truth().theta_m > TAU, "{}", plant.truth().theta_m);
        assert!(machine.abs() < 1e-6, "{c_out:e} {branches} {mode:?}: {machine:e} {e:?}");
        if mode == Mode::Switching {
            assert!(all.abs() < 1e-6, "{c_out:e} {branches}: {all:e} {e:?}");
        }
    }
}

/// `u dt/di` of a short voltage pulse along `axis`, without flux in the gap, from the leakage flux `L_l current` along it;
/// `1/L_l` times `chord` is the leakage's inverse inductance there.
fn pulse(p: PlantParams, current: f64, chord: f64, axis: f64) -> f64 {
    let g = p.machine.to_gamma();
    let mut plant = plant(p);
    // psi_R = psi_s - L_sigma i_s with psi_s = 0 and i_s = psi_l chord/L_l.
    let psi_R = g.L_l * current * chord / (chord + g.L_l / g.L_s);
    plant.set_state([0.0; 2], polar(-psi_R, axis), 0.0).unwrap();
    let before = plant.truth().i_s;
    assert!((before[0].hypot(before[1]) - current * chord).abs() < 1e-9);
    plant.step_voltage(polar(500.0, axis), 1e-7, 0.0);
    500.0 * 1e-7 / distance(plant.truth().i_s, before)
}

#[test]
fn a_pulse_sees_the_differential_leakage() {
    let base = PlantParams { saturation: false, ..capacitive(0.0) };
    let mut p = PlantParams { leakage_saturation: Some(KNEE), ..base };
    p.mechanics.speed = Some(0.0);
    let g = p.machine.to_gamma();
    // i = (1 + k psi²) psi/L_l with a quarter of the inductance lost at 10 A.
    let k = (1.0 / 0.75 - 1.0) / (0.75 * g.L_l * 10.0).powi(2);
    let mut last = f64::INFINITY;
    for current in [0.5, 3.0, 6.0] {
        let x = k * (g.L_l * current).powi(2);
        let got = pulse(p, current, 1.0 + x, 0.3);
        // di/dpsi = (1 + 3 k psi²)/L_l, and 1/L_s beside it. The drop at the resistance is 2 % of the pulse at 6 A.
        let drop = (p.machine.R_s + 2.0 * g.R_r) * current * (1.0 + x) / 500.0;
        let want = 1.0 / (1.0 / g.L_s + (1.0 + 3.0 * x) / g.L_l);
        assert!((got / want - 1.0).abs() < 1e-3 + drop, "{current} A: {got} {want}");
        assert!((pulse(base, current, 1.0, 0.3) * (1.0 / g.L_s + 1.0 / g.L_l) - 1.0).abs() < 1e-3 + drop);
        assert!(got < last);
        last = got;
    }
}

#[test]
fn a_pulse_sees_the_saliency_of_the_slots() {
    let mut p = PlantParams { saturation: false, slot_ripple: Some(SLOTS), ..capacitive(0.0) };
    p.mechanics.speed = Some(0.0);
    let g = p.machine.to_gamma();
    // Along the slots (angle zero) the inverse leakage is larger by 5 %, across smaller, in the gap larger by 1 %.
    for (axis, sign) in [(0.0, 1.0), (TAU / 4.0, -1.0)] {
        let want = 1.0 / (1.01 / g.L_s + (1.0 + 0.05 * sign) / g.L_l);
        let got = pulse(p, 0.0, 1.0, axis);
        assert!((got / want - 1.0).abs() < 1e-3, "{axis}: {got} {want}");
    }
}

/// Amplitude of the current's component at `w`, from samples at `dt` over whole periods.
fn line(i: &[[f64; 2]], w: f64, dt: f64) -> f64 {
    let sum = i.iter().enumerate().fold([0.0; 2], |s, (k, i)| {
        let (sin, cos) = (w * dt * k as f64).sin_cos();
        [s[0] + i[0] * cos + i[1] * sin, s[1] + i[1] * cos - i[0] * sin]
    });
    sum[0].hypot(sum[1]) / i.len() as f64
}

#[test]
fn slots_show_at_their_frequencies_and_nowhere_else() {
    // 25 Hz of the field, the shaft at 11 turns a second with 28 slots: 308 Hz; two pole pairs, slip 3 Hz.
    let (f, f_m, Z, dt, U) = (25.0, 11.0, 28.0, 20e-6, 165.0);
    let run = |slot_ripple| {
        let mut p = PlantParams { saturation: false, slot_ripple, ..capacitive(0.0) };
        p.mechanics.speed = Some(TAU * f_m);
        let mut plant = plant(p);
        let mut i = vec![];
        for k in 0..100_000 {
            plant.step_voltage(polar(U, TAU * f * (k as f64 + 0.5) * dt), dt, 0.0);
            if k >= 50_000 {
                i.push(plant.truth().i_s);
            }
        }
        i
    };
    let at = |i: &[[f64; 2]], f: f64| line(i, TAU * f, dt);
    let plain = run(None);
    let gap = run(Some(SlotRipple { leakage: 0.0, ..SLOTS }));
    let leakage = run(Some(SlotRipple { permeance: 0.0, ..SLOTS }));
    let (up, down) = (Z * f_m + f, f - Z * f_m);
    // The gap's permeance drives p/(2 L_s) |psi_s| in each side band, less what the rotor shields.
    let psi = 165.0 / (TAU * f);
    let drive = 0.5 * 0.01 / Machine::preset_2k2().to_gamma().L_s * psi;
    for side in [up, down] {
        assert!(at(&plain, side) < 1e-4 * drive, "{side}: {} without slots", at(&plain, side));
        let got = at(&gap, side);
        assert!((0.7..1.01).contains(&(got / drive)), "{side}: {got} of {drive}");
    }
    // The leakage's saliency turns the mirrored leakage current: one side band alone, e^{j Z theta} psi_l*.
    let (one, other) = (at(&leakage, Z * f_m - f), at(&leakage, up));
    assert!(one > 0.01 && other < 0.05 * one, "{one} {other}");
}

#[test]
fn cogging_is_that_of_the_fields_energy() {
    // Standstill, flux in the gap, no leakage flux: T = 3/4 Z p/L_u |psi|² sin(Z theta).
    let mut p = PlantParams { saturation: false, slot_ripple: Some(SLOTS), ..capacitive(0.0) };
    p.mechanics.speed = Some(1.0);
    let g = p.machine.to_gamma();
    let mut plant = plant(p);
    for _ in 0..40 {
        plant.step([0.5; 3], false, 0.0);
        let k = g.L_s / (g.L_s + g.L_l);
        plant.set_state([0.9, 0.0], [0.9 * k, 0.0], 1.0).unwrap();
        let t = plant.truth();
        let (cos, sin) = ((28.0 * t.theta_m).cos(), (28.0 * t.theta_m).sin());
        // psi_R = psi_s - L_sigma i_s; what the slots add to the current leaves some leakage flux.
        let want = 0.75 * 28.0 * 0.01 / g.L_s * 0.81 * sin;
        assert!((t.torque - want).abs() < 0.03 * 0.75 * 28.0 * 0.01 / g.L_s * 0.81, "{} {want} {cos}", t.torque);
    }
}

#[test]
fn bad_slots_are_named() {
    let field = |leakage_saturation, slot_ripple| match Plant::new(PlantParams {
        leakage_saturation,
        slot_ripple,
        ..capacitive(0.0)
    }) {
        Err(e) => e.field,
        Ok(_) => "",
    };
    assert_eq!(field(Some(LeakageSaturation { share: 0.7, ..KNEE }), None), "leakage_saturation share");
    assert_eq!(field(Some(LeakageSaturation { current: 0.0, ..KNEE }), None), "leakage_saturation current");
    assert_eq!(field(None, Some(SlotRipple { slots: 0, ..SLOTS })), "slot_ripple slots");
    assert_eq!(field(None, Some(SlotRipple { leakage: 0.4, ..SLOTS })), "slot_ripple leakage");
    assert_eq!(field(Some(KNEE), Some(SLOTS)), "");
}

#[test]
fn a_state_is_found_again_however_far_leakage_saturates() {
    let mut seed = 1u32;
    let mut next = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(seed) / f64::from(u32::MAX) * 3.0 - 1.5
    };
    let mut found = 0;
    for k in 0..200 {
        let mut p = PlantParams {
            leakage_saturation: Some(LeakageSaturation { share: 0.6, current: 4.0 }),
            slot_ripple: Some(SLOTS),
            saturation: k % 2 == 0,
            ..capacitive(0.0)
        };
        if k % 3 == 0 {
            p.iron_loss = Some(IronLoss { R_fe: 900.0, time_constant: 150e-6 });
            p.deep_bar = Some(DeepBar { conductance: 0.3, leakage: 0.6 });
        }
        let mut plant = plant(p);
        let psi_s = [0.6 * next(), 0.6 * next()];
        let psi_R = psi_s.map(|x| x + 0.15 * next());
        if plant.set_state(psi_s, psi_R, 0.0).is_ok() {
            found += 1;
            let t = plant.truth();
            assert!(
                distance(t.psi_s, psi_s) == 0.0 && distance(t.psi_r, psi_R) < 1e-12,
                "{k}: {t:?}, wanted {psi_R:?}"
            );
        }
    }
    assert!(found > 100, "{found}");
}

/// A coasting machine is simulated for as long as one likes: the flux decays below what its fourth power can be computed of.
#[test]
fn a_flux_that_has_all_but_vanished_stays_a_number() {
    for saturation in [None, Machine::preset_2k2().saturation] {
        for (deep_bar, leakage_saturation, slot_ripple) in [
            (None, None, None),
            (Some(DeepBar { conductance: 0.3, leakage: 0.6 }), None, None),
            (None, Some(KNEE), None),
            (None, None, Some(SLOTS)),
            (Some(DeepBar { conductance: 0.3, leakage: 0.6 }), Some(KNEE), Some(SLOTS)),
        ] {
            for (psi, mode) in [1e-60, 1e-78, 1e-110, 1e-160, 1e-300]
                .into_iter()
                .flat_map(|psi| [Mode::Switching, Mode::Averaged].map(|mode| (psi, mode)))
            {
                let mut p = PlantParams { mode, deep_bar, leakage_saturation, slot_ripple, ..capacitive(1e-9) };
                p.machine.saturation = saturation;
                let mut plant = plant(held(p, 60.0));
                plant.set_state([psi, 0.0], [0.9 * psi, 0.0], 60.0).unwrap();
                for _ in 0..20 {
                    plant.step([0.5; 3], false, 0.0);
                }
                let t = plant.truth();
                let all = [t.psi_s, t.psi_r, t.i_s, t.u_s].concat();
                assert!(all.iter().all(|x| x.abs() < 1e-50), "{psi:e}, {mode:?}: {all:?}");
            }
        }
    }
}
