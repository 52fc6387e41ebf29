//! Node capacitance of the legs against the law of its mean, energy balance, an independent bridge and its limit.

use super::*;
use crate::rig::Largest;
use std::f64::consts::TAU;
use stillflux::params::{Inverter, Machine, Rating, TModel};
use stillflux_sim::{Mechanics, Mode, Plant, PlantParams};

/// Pseudo-random numbers in 0…1.
fn random(mut seed: u64) -> impl FnMut() -> f64 {
    move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// From 0.25 kW to 200 kW, and one on 48 V: machine, its inverter without capacitance.
fn machines() -> [(Machine, Inverter); 4] {
    let t = |R_s, R_r, L_ls, L_m, r: Rating| Machine::from_t_model(TModel { R_s, R_r, L_ls, L_lr: L_ls, L_m }, r);
    let on_grid = Inverter::preset_2k2();
    [
        (
            t(24.0, 19.0, 0.06, 1.1, Rating { n_p: 2, J: 6e-4, U_N: 400.0, I_N: 0.8, f_N: 50.0, T_N: 1.7 }),
            Inverter { f_s: 16e3, dead_time: 1e-6, r_d: 0.5, ..on_grid },
        ),
        (Machine::preset_2k2(), on_grid),
        (
            t(8e-3, 7e-3, 1.0e-4, 5.5e-3, Rating { n_p: 2, J: 3.0, U_N: 400.0, I_N: 350.0, f_N: 50.0, T_N: 1280.0 }),
            Inverter { f_s: 3e3, dead_time: 4e-6, r_d: 2e-3, u_th: 1.2, ..on_grid },
        ),
        (
            t(8e-3, 7e-3, 2e-5, 5e-4, Rating { n_p: 2, J: 0.02, U_N: 30.0, I_N: 150.0, f_N: 100.0, T_N: 16.0 }),
            Inverter { u_dc: 48.0, u_th: 0.0, dead_time: 0.5e-6, r_d: 2e-3, f_s: 20e3, ..on_grid },
        ),
    ]
}

#[test]
fn energy_is_conserved_through_every_ramp_and_charge() {
    for (k, (m, inv)) in machines().into_iter().enumerate() {
        // A stray inductance of 0.2 mH rings with 1 pF at 11 MHz while the gates are blocked: slow to follow.
        let least = if k < 2 { 1e-12 } else { 100e-12 };
        for c_out in [0.0, least, 1e-9, 10e-9] {
            for u_th in [0.0, inv.u_th.max(0.5)] {
                let mut p = ideal_sensors(m, Inverter { c_out, u_th, ..inv });
                p.mechanics = Mechanics { coulomb: 0.02 * m.T_N, stribeck: 0.02 * m.T_N, ..p.mechanics };
                let mut plant = plant(p);
                let stored = |plant: &Plant| plant.magnetic_energy() + plant.node_energy();
                let mut next = random(k as u64 + 7);
                plant.track_energy(true);
                let begin = stored(&plant);
                for _ in 0..30 {
                    let (wild, on, load) = (next() < 0.2, next() < 0.8, m.T_N * (0.6 * next() - 0.3));
                    for _ in 0..(1.0 + 30.0 * next()) as u32 {
                        let spread = if wild { 1.4 } else { 0.03 };
                        plant.step([0; 3].map(|_| 0.5 + spread * (next() - 0.5)), on, load);
                    }
                }
                let e = *plant.energy().unwrap();
                let scale = e.copper_s + e.charging;
                let machine = e.input - e.copper_s - e.copper_r - e.shaft - plant.magnetic_energy();
                let all =
                    e.link - e.conduction - e.charging - e.copper_s - e.copper_r - e.shaft - (stored(&plant) - begin);
                assert!(machine.abs() < 1e-6 * scale, "machine {k}, {c_out:e} F, {u_th} V: {machine:e} {e:?}");
                assert!(all.abs() < 1e-6 * scale, "machine {k}, {c_out:e} F, {u_th} V: {all:e} {e:?}");
            }
        }
    }
}

/// Volt-seconds that a leg loses to the dead time, relative to `u_dc T_d`, at constant current in units of `I_k`.
fn law(i: f64) -> f64 {
    i.signum() * if i.abs() < 1.0 { 0.5 * i.abs() } else { 1.0 - 0.5 / i.abs() }
}

/// A machine whose currents hardly change within a dead time, held at `omega` with the given flux and current.
fn stiff(L_sigma: f64, inverter: Inverter, i_s: [f64; 2], psi_r: [f64; 2], omega: f64) -> Plant {
    let m = Machine { R_R: 1e-5, L_sigma, L_M: 3.0 * L_sigma, saturation: None, ..Machine::preset_2k2() };
    let mut plant = plant(held(ideal_sensors(m, inverter), omega));
    // Gates on and duties in the preload register before the state is set.
    plant.step([0.5; 3], true, 0.0);
    plant.set_state([0, 1].map(|x| psi_r[x] + L_sigma * i_s[x]), psi_r, omega).unwrap();
    plant
}

/// Mean terminal voltage of one period less that of the duties and the drop at `r_d`, V.
fn lost(plant: &mut Plant, duty: [f64; 3]) -> [f64; 2] {
    let (before, inv) = (*plant.truth(), plant.params().inverter);
    plant.step(duty, true, 0.0);
    let t = *plant.truth();
    let u = vector(duty.map(|d| d * inv.u_dc));
    [0, 1].map(|x| u[x] - t.u_s[x] - 0.5 * inv.r_d * (t.i_s[x] + before.i_s[x]))
}

#[test]
fn lost_volt_seconds_follow_the_law_of_a_constant_current() {
    for c_out in [0.1e-9, 1e-9, 10e-9] {
        let inv = Inverter { c_out, u_th: 0.0, f_clk: 0.0, ..Inverter::preset_2k2() };
        let knee = c_out * inv.u_dc / inv.dead_time;
        for i in [0.1, 0.2, 0.5, 0.9, 1.1, 2.0, 5.0, 10.0, 30.0, -0.3, -3.0] {
            let mut plant = stiff(10.0, inv, [i * knee, 0.0], [0.0; 2], 0.0);
            let got = lost(&mut plant, [0.5; 3]);
            let want = vector([i, -0.5 * i, -0.5 * i].map(law)).map(|u| u * inv.u_dc * inv.dead_time / T_S);
            let e = distance(got, want) / (inv.u_dc * inv.dead_time / T_S);
            // Remainder: what the current of the smallest case, 3 mA, changes by within the dead time.
            assert!(e < 1e-3, "{c_out:e} F, {i} I_k: {got:?} {want:?} {e:e}");
        }
    }
}

#[test]
fn current_ripple_doubles_the_slope_of_the_error_at_current_zero() {
    // Phase a in the direction of the induced voltage, its current around zero and rippling.
    let (L, U, x) = (0.2, 100.0, 100.0 / 540.0);
    // A dead time so short that the ripple does not go on within it.
    let inv = Inverter { c_out: 2.5e-12, dead_time: 0.1e-6, u_th: 0.0, f_clk: 0.0, ..Inverter::preset_2k2() };
    let (knee, unit) = (inv.c_out * inv.u_dc / inv.dead_time, inv.u_dc * inv.dead_time / T_S);
    let duty = [0.5 + x, 0.5 - 0.5 * x, 0.5 - 0.5 * x];
    // From the carrier peak to the edge of phase a, and on to that of the others.
    let (t_a, t_b) = (0.5 * (1.0 - duty[0]) * T_S, 0.5 * (1.0 - duty[1]) * T_S);
    let (ripple_a, ripple_b) = (-U / L * t_a, -U / L * t_a + (2.0 / 3.0 * 540.0 - U) / L * (t_b - t_a));
    assert!(ripple_a < -0.5 * knee, "{ripple_a} {knee}");
    for n in -12..=12 {
        let i = 0.2 * f64::from(n) * ripple_a.abs();
        let mut plant = stiff(L, inv, [i, 0.0], [0.0, -0.8], 0.5 * U / 0.8);
        plant.step(duty, true, 0.0);
        plant.set_state([L * i, -0.8], [0.0, -0.8], 0.5 * U / 0.8).unwrap();
        let got = lost(&mut plant, duty);
        let leg = |rise: f64, fall: f64| law(fall / knee).max(0.0) + law(rise / knee).min(0.0);
        let a = leg(i + ripple_a, i - ripple_a);
        let b = leg(-0.5 * (i + ripple_b), -0.5 * (i - ripple_b));
        let want = 2.0 / 3.0 * (a - b) * unit;
        // The dead time is 0.6 % of the time over which the ripple rises.
        assert!((got[0] - want).abs() < 0.01 * unit, "{} I_k: {} {}", i / knee, got[0] / unit, want / unit);
    }
}

/// The capacitive bridge once more, without modes and events: 1-ns steps, a node that its current charges and
/// whatever conducts clips.
fn brute_force(p: &PlantParams, x0: [f64; 4], omega: f64, run: &[([f64; 3], bool)]) -> Vec<[f64; 2]> {
    let (inv, circuit) = (p.inverter, Circuit::new(&p.machine));
    let (mut since, mut level, mut v) = ([1.0; 3], [false; 3], [0.5 * inv.u_dc; 3]);
    let (mut x, mut out, n, R) = (x0, vec![], 100_000, p.machine.R_s + inv.r_d);
    let dt = T_S / n as f64;
    for (duty, on) in run {
        for k in 0..n {
            let t = (k as f64 + 0.5) * dt;
            let i = circuit.current(&x);
            for leg in 0..3 {
                let high = (t - 0.5 * T_S).abs() < 0.5 * T_S * duty[leg];
                since[leg] = if high != level[leg] { 0.0 } else { since[leg] + dt };
                level[leg] = high;
                let (mut lo, mut hi) = (-inv.u_th, inv.u_dc + inv.u_th);
                if *on && since[leg] >= inv.dead_time {
                    (lo, hi) = if high { (inv.u_dc - inv.u_th, hi) } else { (lo, inv.u_th) };
                }
                let i_leg = AXIS[leg][0] * i[0] + AXIS[leg][1] * i[1];
                v[leg] = (v[leg] - dt / inv.c_out * i_leg).clamp(lo, hi);
            }
            let u = vector(v);
            x = circuit.step(&x, omega, R, dt, |_| u);
        }
        out.push(circuit.current(&x));
    }
    out
}

/// Machine, speed, voltage and its frequency, and whether the gates are blocked for a while.
fn cases(c_out: f64) -> [(PlantParams, f64, f64, f64, bool); 4] {
    let base = capacitive(c_out);
    let linear = PlantParams { machine: Machine { saturation: None, ..base.machine }, ..base };
    [
        // Slow turning with currents around zero, uncompensated.
        (linear, 3.0, 8.0, 8.0, false),
        // Fast, so that phase currents cross within the active vectors.
        (base, 100.0, 200.0, 210.0, false),
        // Gates dropped while currents flow: the nodes ring; rectifying at high speed.
        (base, 120.0, 230.0, 245.0, true),
        (linear, 230.0, 260.0, 460.0, true),
    ]
}

/// Currents at the end of each period of a case, and its state at the start as the Γ circuit has it.
fn run_case((p, omega, u, w, blocked): (PlantParams, f64, f64, f64, bool), slow: bool) -> CaseRun {
    let g = p.machine.to_gamma();
    let mut plant = plant(held(p, omega));
    let psi = [0.85, -0.2];
    let psi_R = if slow { [0.844, -0.195] } else { [0.80, -0.18] };
    plant.step([0.5; 3], true, 0.0);
    plant.step([0.5; 3], true, 0.0);
    plant.set_state(psi, psi_R, omega).unwrap();
    let t = *plant.truth();
    let L = p.machine.saturation.map_or(g.L_s, |s| s.L_u / (1.0 + (s.a * psi[0].hypot(psi[1])).powf(s.S)));
    let psi_r = [0, 1].map(|x| psi[x] + g.L_l * (psi[x] / L - t.i_s[x]));
    let run: Vec<_> = (0..60)
        .map(|k| (duties(polar(u, w * T_S * k as f64 + 1.3), 540.0), !(blocked && (25..50).contains(&k))))
        .collect();
    let i = run
        .iter()
        .map(|r| {
            plant.step(r.0, r.1, 0.0);
            plant.truth().i_s
        })
        .collect();
    // The preload register: duties act one period later.
    let acting = std::iter::once([0.5; 3]).chain(run.iter().map(|r| r.0)).zip(&run).map(|(d, r)| (d, r.1)).collect();
    CaseRun { start: [psi[0], psi[1], psi_r[0], psi_r[1]], acting, i }
}

struct CaseRun {
    start: [f64; 4],
    acting: Vec<([f64; 3], bool)>,
    i: Vec<[f64; 2]>,
}

#[test]
#[ignore = "slow: make test-slow"]
fn brute_force_bridge_agrees_driven_and_blocked_with_small_nodes() {
    agrees_with_brute_force(&[0.1e-9]);
}

#[test]
fn brute_force_bridge_agrees_driven_and_blocked_with_nodes_of_motor_cables() {
    agrees_with_brute_force(&[1e-9, 10e-9]);
}

fn agrees_with_brute_force(capacitances: &[f64]) {
    for &c_out in capacitances {
        for (k, case) in cases(c_out).into_iter().enumerate() {
            let run = run_case(case, k == 0);
            let want = brute_force(&case.0, run.start, case.1, &run.acting);
            let worst = run.i.iter().zip(&want).map(|(a, b)| distance(*a, *b)).largest();
            // Edges of the reference lie on a 1-ns grid: up to 540 V · 1 ns / 21 mH = 0.03 mA each.
            assert!(worst < 1.5e-3, "{c_out:e} F, case {k}: {worst:e}");
        }
    }
}

#[test]
fn vanishing_capacitance_is_clamping() {
    for k in 0..4 {
        let clamped = run_case(cases(0.0)[k], k == 0).i;
        let mut last = f64::INFINITY;
        for c_out in [100e-12, 10e-12, 1e-12, 0.1e-12] {
            let i = run_case(cases(c_out)[k], k == 0).i;
            let apart = i.iter().zip(&clamped).map(|(a, b)| distance(*a, *b)).largest();
            assert!(apart < last, "case {k}, {c_out:e} F: {apart:e} after {last:e}");
            last = apart;
        }
        assert!(last < 1e-3, "case {k}: {last:e}");
    }
}

#[test]
fn averaged_bridge_follows_the_switched_one() {
    // A slowly turning voltage too small for the dead time without capacitance.
    let run = |mode, c_out| {
        let mut plant = plant(held(PlantParams { mode, ..capacitive(c_out) }, 0.0));
        let mut i = vec![];
        for k in 0..10_000 {
            plant.step(duties(polar(12.0, TAU * 1.5 * k as f64 * T_S), 540.0), true, 0.0);
            i.push(plant.truth().i_s);
        }
        i.split_off(3000)
    };
    let mean =
        |a: &[[f64; 2]], b: &[[f64; 2]]| a.iter().zip(b).map(|(a, b)| distance(*a, *b)).sum::<f64>() / a.len() as f64;
    for c_out in [0.3e-9, 1e-9, 3e-9] {
        let (a, s) = (run(Mode::Averaged, c_out), run(Mode::Switching, c_out));
        let clamped = run(Mode::Switching, 0.0);
        let (error, effect) = (mean(&a, &s), mean(&clamped, &s));
        assert!(error < 0.05 * effect, "{c_out:e} F: {error} A, capacitance does {effect} A");
    }
}

#[test]
fn bad_capacitance_is_named() {
    for c_out in [-1e-12, 10.1e-9, f64::NAN] {
        assert_eq!(Plant::new(capacitive(c_out)).unwrap_err().field, "c_out");
    }
}

#[test]
fn nodes_stay_between_the_diodes_whatever_happens() {
    let mut next = random(99);
    let mut plant = plant(capacitive(0.3e-9));
    for k in 0..2000 {
        if k % 100 == 50 {
            plant.set_u_dc(300.0 + 300.0 * next());
        }
        if k % 300 == 299 {
            plant.set_state([next() - 0.5, next() - 0.5], [next() - 0.5, next() - 0.5], 100.0 * next()).unwrap();
        }
        plant.step([0; 3].map(|_| next()), k / 50 % 3 > 0, 0.0);
        let (u_dc, v) = (plant.truth().u_dc, plant.node_potentials().unwrap());
        assert!(v.iter().all(|v| (-1.0 - 1e-4..=u_dc + 1.0 + 1e-4).contains(v)), "{k}: {v:?} of {u_dc} V");
        let i = plant.phase_currents();
        assert!(i.iter().all(|i| i.abs() < 300.0) && (i[0] + i[1] + i[2]).abs() < 1e-9, "{i:?}");
    }
}

#[test]
fn nodes_of_a_long_blocked_bridge_follow_the_induced_voltage() {
    for c_out in [0.1e-9, 1e-9, 10e-9] {
        let mut p = held(capacitive(c_out), 60.0);
        p.machine.saturation = None;
        let mut plant = plant(p);
        plant.set_state([0.95, 0.25], [0.9, 0.1], 60.0).unwrap();
        plant.track_energy(true);
        let begin = plant.magnetic_energy();
        plant.step([0.5; 3], true, 0.0);
        let nodes = |plant: &Plant| plant.node_potentials().unwrap();
        let mut rate = 0.0;
        for k in 0..8000 {
            plant.step([0.5; 3], false, 0.0);
            let t = *plant.truth();
            if k == 6000 {
                rate = t.psi_r[0].hypot(t.psi_r[1]);
            }
            if k > 6000 {
                assert!((t.omega_s - 120.0).abs() < 1e-6, "{c_out:e} F, {k}: {}", t.omega_s);
                // psi_s turns with the rotor: e = j 120 psi_s but for the decay.
                let e = vector(nodes(&plant));
                let want = [-120.0 * t.psi_s[1], 120.0 * t.psi_s[0]];
                assert!(distance(e, want) < 0.1 * want[0].hypot(want[1]), "{e:?} {want:?}");
            }
        }
        let t = plant.truth();
        let decay = (t.psi_r[0].hypot(t.psi_r[1]) / rate).ln() / (1999.0 * T_S);
        assert!((decay * 0.224 / 2.1 + 1.0).abs() < 1e-6, "open circuit: tau_r, {decay}");
        // And on again: the balance closes over all of it.
        for _ in 0..20 {
            plant.step([0.5; 3], true, 0.0);
        }
        let e = *plant.energy().unwrap();
        let all = e.link
            - e.conduction
            - e.charging
            - e.copper_s
            - e.copper_r
            - e.shaft
            - plant.magnetic_energy()
            - plant.node_energy()
            + begin;
        assert!((all - 3.0 * 0.5 * c_out * 1.0).abs() < 1e-6 * e.copper_r, "{all:e} {e:?}");
    }
}
