//! The plant against closed forms, balances and an independent brute-force bridge.

use super::*;
use std::f64::consts::TAU;
use stillflux::params::{Inverter, Machine};
use stillflux_sim::{GateDelays, Mechanics, Mode, Plant, PlantParams, Thermal, Truth};

/// A bridge whose nodes have no capacitance: a leg without current is clamped.
fn clamped(inverter: Inverter) -> Inverter {
    Inverter { c_out: 0.0, ..inverter }
}

fn linear() -> PlantParams {
    let m = Machine { saturation: None, ..Machine::preset_2k2() };
    let mut p = PlantParams::new(m, Inverter { f_clk: 0.0, ..clamped(Inverter::preset_2k2()) });
    (p.adc.bits, p.adc.u_dc_bits) = (0, 0);
    p
}

fn saturated() -> PlantParams {
    PlantParams { machine: Machine::preset_2k2(), ..linear() }
}

fn ideal_bridge(mut p: PlantParams) -> PlantParams {
    p.inverter = Inverter { u_th: 0.0, r_d: 0.0, dead_time: 0.0, f_clk: 0.0, ..p.inverter };
    p
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Largest relative difference of the states of two runs.
fn apart(a: &Truth, b: &Truth) -> f64 {
    let flux = distance(a.psi_s, b.psi_s).max(distance(a.psi_r, b.psi_r)) / b.psi_s[0].hypot(b.psi_s[1]);
    flux.max((a.omega_m - b.omega_m).abs() / b.omega_m.abs().max(1.0))
}

/// Turns `v` back by the angle `a`.
fn back(v: [f64; 2], a: f64) -> [f64; 2] {
    [v[0] * a.cos() + v[1] * a.sin(), v[1] * a.cos() - v[0] * a.sin()]
}

#[test]
fn steady_state_is_that_of_the_inverse_gamma_phasors() {
    let p = held(linear(), 20.0);
    let (m, mut plant) = (p.machine, plant(p));
    let (w, dt, U) = (TAU * 8.0, 5e-6, 60.0);
    let n = 400_000;
    for k in 0..n {
        plant.step_voltage(polar(U, w * (k as f64 + 0.5) * dt), dt, 0.0);
    }
    // psi_R = L_M i/(1 + j w_r L_M/R_R); the staircase's fundamental is sinc(w dt/2), 1 - 3e-9.
    let q = (w - 2.0 * 20.0) * m.L_M / m.R_R;
    let (re, im) = (m.L_M / (1.0 + q * q), -m.L_M * q / (1.0 + q * q));
    let (zr, zi) = (m.R_s - w * im, w * (m.L_sigma + re));
    let i = [U * zr / (zr * zr + zi * zi), -U * zi / (zr * zr + zi * zi)];
    let psi_r = [re * i[0] - im * i[1], re * i[1] + im * i[0]];
    let t = plant.truth();
    assert!(distance(back(t.i_s, w * t.t), i) < 2e-6 * i[0].hypot(i[1]));
    assert!(distance(back(t.psi_r, w * t.t), psi_r) < 2e-6 * psi_r[0].hypot(psi_r[1]));
    assert!((t.torque / (1.5 * 2.0 * cross(t.psi_r, t.i_s)) - 1.0).abs() < 1e-12);
    assert!((t.omega_s / w - 1.0).abs() < 1e-5);
    for k in 0..2 {
        assert!((t.psi_r[k] - t.psi_s[k] + m.L_sigma * t.i_s[k]).abs() < 1e-14, "definition of psi_r");
    }
}

#[test]
fn direct_current_settles_at_u_over_r() {
    let mut plant = plant(held(saturated(), 0.0));
    for _ in 0..40_000 {
        plant.step_voltage([15.0, -8.0], T_S, 0.0);
    }
    let t = plant.truth();
    assert!(distance(t.i_s, [15.0 / 3.7, -8.0 / 3.7]) < 1e-9);
    assert!((t.u_s[0] - 15.0).abs() < 1e-9 && (t.u_s[1] + 8.0).abs() < 1e-9, "mean voltage is the applied one");
}

#[test]
fn one_second_of_run_up_agrees_with_hundredfold_finer_steps() {
    for p in [linear(), saturated()] {
        let mut p = p;
        p.mechanics = Mechanics { viscous: 2e-3, coulomb: 0.2, stribeck: 0.4, stribeck_speed: 2.0, ..p.mechanics };
        let (mut coarse, mut fine) = (plant(p), plant(p));
        for k in 0..10_000 {
            let u = polar(5.0 + 120.0 * (k as f64 * T_S), TAU * 10.0 * (k as f64 * T_S).powi(2));
            coarse.step_voltage(u, T_S, 1.0);
            for _ in 0..200 {
                fine.step_voltage(u, T_S / 200.0, 1.0);
            }
        }
        let e = apart(coarse.truth(), fine.truth());
        assert!(coarse.truth().omega_m > 20.0 && e < 1e-7, "{e:e} at {} rad/s", coarse.truth().omega_m);
    }
}

#[test]
fn energy_is_conserved_through_every_switching() {
    for p in [linear(), saturated(), PlantParams { mode: Mode::Averaged, ..saturated() }] {
        let mut p = p;
        p.mechanics = Mechanics { viscous: 1e-3, ..p.mechanics };
        let mut plant = plant(p);
        plant.track_energy(true);
        for k in 0..10_000 {
            let t = k as f64 * T_S;
            plant.step(duties(polar(25.0 + 100.0 * t, TAU * 12.0 * t * t), 540.0), true, 0.5);
        }
        let e = *plant.energy().unwrap();
        let balance = e.input - e.copper_s - e.copper_r - e.shaft - plant.magnetic_energy();
        assert!(balance.abs() < 1e-7 * e.input, "{e:?} {balance:e}");
        assert!(
            e.shaft > 0.5 * p.machine.J * plant.truth().omega_m.powi(2),
            "kinetic energy, load and friction come from it"
        );
    }
}

/// Currents far from zero, standing flux, so that signs stay: a plant and its phase current signs.
fn loaded(p: PlantParams, i: [f64; 2]) -> (Plant, [f64; 3]) {
    let (L, mut plant) = (p.machine.L_sigma, plant(held(p, 0.0)));
    let psi_R = [0.224 * i[0], 0.224 * i[1]];
    plant.set_state([psi_R[0] + L * i[0], psi_R[1] + L * i[1]], psi_R, 0.0).unwrap();
    (plant, AXIS.map(|e| (e[0] * i[0] + e[1] * i[1]).signum()))
}

#[test]
fn bridge_loses_dead_time_threshold_and_resistance() {
    let inv = linear().inverter;
    let d = [0.53, 0.48, 0.50];
    for (u_th, r_d, dead_time) in [(0.0, 0.0, 2e-6), (1.0, 0.0, 0.0), (1.0, 0.2, 2e-6)] {
        for angle in [0.3, 1.2, 2.5, 4.0, 5.8] {
            let mut p = linear();
            p.inverter = Inverter { u_th, r_d, dead_time, ..inv };
            let (mut plant, sign) = loaded(p, polar(4.0, angle));
            plant.step(d, true, 0.0);
            let before = *plant.truth();
            plant.step(d, true, 0.0);
            let t = plant.truth();
            // The stator equation over the period gives the mean current.
            let i = [0, 1].map(|x| (t.u_s[x] - (t.psi_s[x] - before.psi_s[x]) / T_S) / 3.7);
            let middle = [0, 1].map(|x| 0.5 * (t.i_s[x] + before.i_s[x]));
            assert!(distance(i, middle) < 2e-3, "symmetric ripple: {i:?} {middle:?}");
            let want = vector([0, 1, 2].map(|k| 540.0 * d[k] - sign[k] * (u_th + dead_time / T_S * 540.0)));
            let want = [want[0] - r_d * i[0], want[1] - r_d * i[1]];
            assert!(distance(t.u_s, want) < 1e-9, "{:?} {want:?}", t.u_s);
        }
    }
}

#[test]
fn delays_of_the_switches_add_their_volt_seconds() {
    let delays = GateDelays {
        on: [[0.10e-6, 0.25e-6], [0.05e-6, 0.0], [0.3e-6, 0.2e-6]],
        off: [[0.40e-6, 0.15e-6], [0.5e-6, 0.45e-6], [0.0, 0.35e-6]],
    };
    let d = [0.53, 0.48, 0.50];
    for mode in [Mode::Switching, Mode::Averaged] {
        for angle in [0.3, 1.2, 2.5, 4.0, 5.8] {
            let lossless = PlantParams { inverter: Inverter { r_d: 0.0, ..linear().inverter }, ..linear() };
            let run = |gate_delays| {
                let (mut plant, sign) = loaded(PlantParams { mode, gate_delays, ..lossless }, polar(4.0, angle));
                plant.step(d, true, 0.0);
                plant.step(d, true, 0.0);
                (*plant.truth(), sign)
            };
            let ((late, sign), (ideal, _)) = (run(delays), run(GateDelays::default()));
            let gain = vector([0, 1, 2].map(|k| {
                let (on, off) = (delays.on[k], delays.off[k]);
                540.0 / T_S * if sign[k] > 0.0 { off[0] - on[0] } else { on[1] - off[1] }
            }));
            let want = [0, 1].map(|x| ideal.u_s[x] + gain[x]);
            assert!(distance(late.u_s, want) < 1e-9, "{mode:?} {angle}: {:?} {want:?}", late.u_s);
            // As a property of the inverter, what each pulse is longer.
            let leg_delay = [0, 1, 2].map(|k| [delays.off[k][0] - delays.on[k][0], delays.on[k][1] - delays.off[k][1]]);
            let inverter = Inverter { leg_delay, ..lossless.inverter };
            let (mut plant, _) = loaded(PlantParams { mode, inverter, ..lossless }, polar(4.0, angle));
            plant.step(d, true, 0.0);
            plant.step(d, true, 0.0);
            let u_s = plant.truth().u_s;
            assert!(distance(u_s, want) < 1e-9, "{mode:?} {angle}: {u_s:?} {want:?}");
        }
    }
    let bad = GateDelays { off: [[0.0, 2.2e-6], [0.0; 2], [0.0; 2]], ..GateDelays::default() };
    assert_eq!(Plant::new(PlantParams { gate_delays: bad, ..linear() }).unwrap_err().field, "turn_off_delay");
}

#[test]
fn duties_act_one_period_later_and_gates_at_once() {
    let mut plant = plant(held(ideal_bridge(linear()), 0.0));
    let d = duties([30.0, 10.0], 540.0);
    plant.step(d, true, 0.0);
    assert!(distance(plant.truth().u_s, [0.0; 2]) < 1e-9);
    plant.step([0.5; 3], true, 0.0);
    assert!(distance(plant.truth().u_s, [30.0, 10.0]) < 1e-9);
    plant.step([0.5; 3], true, 0.0);
    assert!(distance(plant.truth().u_s, [0.0; 2]) < 1e-9);
    assert!(plant.phase_currents()[0] > 0.0);
    plant.step(d, false, 0.0);
    assert!(plant.truth().u_s[0] < -1.0, "diodes oppose the current");
}

#[test]
fn duties_are_multiples_of_the_timer_clock_and_full_ones_do_not_switch() {
    let mut p = ideal_bridge(linear());
    p.inverter.f_clk = 10e6;
    let mut a = plant(held(p, 0.0));
    for d in [[0.5013, 0.4, 0.6], [1.0, 0.0, 0.0], [f64::NAN, 2.0, -1.0], [0.5; 3]] {
        a.step(d, true, 0.0);
        let want = vector(d.map(|d| (if d > 0.0 { d.min(1.0) } else { 0.0 } * 500.0).round() / 500.0 * 540.0));
        let mut b = a.clone();
        b.step([0.5; 3], true, 0.0);
        assert!(distance(b.truth().u_s, want) < 1e-8, "{d:?}");
    }
    // With dead time: a leg that stays high or low loses the threshold alone.
    let (mut plant, sign) = loaded(linear(), [4.0, 2.0]);
    for _ in 0..3 {
        plant.step([1.0, 0.0, 0.5], true, 0.0);
    }
    let psi = plant.truth().psi_s;
    plant.step([1.0, 0.0, 0.5], true, 0.0);
    let t = plant.truth();
    let i = [0, 1].map(|x| (t.u_s[x] - (t.psi_s[x] - psi[x]) / T_S) / 3.7);
    let want = vector([540.0 - sign[0], -sign[1], 270.0 - sign[2] * 11.8]);
    assert!(distance(t.u_s, [want[0] - 0.2 * i[0], want[1] - 0.2 * i[1]]) < 1e-9);
}

#[test]
fn blocked_bridge_lets_the_current_die_and_then_shows_the_emf() {
    for p in [linear(), saturated()] {
        let mut plant = plant(held(p, 60.0));
        let psi_R = [0.9, 0.1];
        plant.set_state([0.95, 0.25], psi_R, 60.0).unwrap();
        let mut periods = 0;
        while plant.sample().i_abc != [0.0; 3] {
            plant.step([0.5; 3], false, 0.0);
            periods += 1;
            assert!(periods < 20);
        }
        assert!(periods > 3);
        for _ in 0..500 {
            let before = *plant.truth();
            assert_eq!(plant.step([0.5; 3], false, 0.0).i_abc, [0.0; 3]);
            let t = plant.truth();
            assert_eq!(t.i_s, [0.0; 2]);
            assert!((t.omega_s - 120.0).abs() < 1e-6 && distance(t.u_s, [0.0; 2]) > 50.0);
            let decay = t.psi_r[0].hypot(t.psi_r[1]) / before.psi_r[0].hypot(before.psi_r[1]);
            if p.machine.saturation.is_none() {
                assert!((decay - (-T_S * 2.1 / 0.224f64).exp()).abs() < 1e-10, "open circuit: tau_r");
            }
        }
    }
}

#[test]
fn emf_above_the_link_voltage_rectifies() {
    // Line-to-line peak √3 · 314 · 1.0 = 544 V at 314 rad/s.
    for (u_dc, conducts) in [(560.0, false), (500.0, true)] {
        let mut p = held(linear(), 157.0);
        p.inverter.u_dc = u_dc;
        let mut plant = plant(p);
        plant.set_state([1.0, 0.0], [1.0, 0.0], 157.0).unwrap();
        let mut seen = false;
        plant.track_energy(true);
        for _ in 0..50 {
            plant.step([0.5; 3], false, 0.0);
            seen |= plant.phase_currents() != [0.0; 3];
        }
        assert_eq!(seen, conducts);
        assert!(!conducts || plant.energy().unwrap().shaft < -0.1, "and brakes");
    }
}

#[test]
fn leg_without_current_stays_clamped() {
    let p = held(linear(), 0.0);
    let mut plant = plant(p);
    // Flux and current along the beta axis, all legs switching together: nothing pushes phase a.
    plant.set_state([0.0, 0.721], [0.0, 0.7], 0.0).unwrap();
    for _ in 0..12 {
        let i = plant.step([0.5; 3], true, 0.0).i_abc;
        assert!(i[0] == 0.0 && i[1] > 0.01, "{i:?}");
    }
    // The other two die as well and then stay.
    for _ in 0..2000 {
        plant.step([0.5; 3], true, 0.0);
    }
    for _ in 0..50 {
        assert_eq!(plant.step([0.5; 3], true, 0.0).i_abc, [0.0; 3]);
    }
}

/// No current runs backwards through a diode or against a switch's threshold, however short: near the zero of an
/// induced voltage a phase current can come down to zero and rise again while no gate switches. All lower switches
/// are on, so that segments are as long as they get; a plant with a tenth of the period and of the segments cannot step far over it.
#[test]
fn a_current_that_only_touches_zero_between_two_events_stops_there() {
    let at = |f_s: f64, psi_b: f64, i_a: f64| {
        let mut p = held(linear(), 157.0);
        p.inverter = Inverter { f_s, u_th: 5.0, dead_time: 0.0, f_clk: 0.0, ..p.inverter };
        let mut plant = plant(p);
        for _ in 0..2 {
            plant.step([0.0; 3], true, 0.0);
        }
        let (psi_r, i) = ([0.9, psi_b], [i_a, 3.0]);
        plant.set_state([0, 1].map(|x| psi_r[x] + p.machine.L_sigma * i[x]), psi_r, 157.0).unwrap();
        let mut touched = false;
        for _ in 0..(T_S * f_s).round() as u32 {
            plant.step([0.0; 3], true, 0.0);
            touched |= plant.phase_currents()[0] == 0.0;
        }
        (plant.phase_currents(), touched)
    };
    let mut seen = 0;
    for k in 0..200 {
        // The zero of phase a's voltage a little later from case to case, its current just above zero.
        let (psi_b, i_a) = (-0.02 - 0.0005 * f64::from(k / 10), 2e-4 * f64::from(1 + k % 10));
        let (want, touched) = at(1e5, psi_b, i_a);
        let (i, _) = at(1.0 / T_S, psi_b, i_a);
        for (i, want) in i.iter().zip(want) {
            assert!((i - want).abs() < 1e-7, "{psi_b} {i_a}: {i} instead of {want} A");
        }
        seen += u32::from(touched && want[0] > 0.0);
    }
    assert!(seen >= 10, "cases in which the current stops at zero and rises again: {seen}");
}

/// The bridge once more, by brute force: 4-ns Heun steps, a leg without current as a steep conductance.
fn brute_force(p: &PlantParams, x0: [f64; 4], omega: f64, run: &[([f64; 3], bool)]) -> Vec<[f64; 2]> {
    let (inv, circuit) = (p.inverter, Circuit::new(&p.machine));
    // Time since the last command edge, level, per leg.
    let (mut since, mut level) = ([1.0; 3], [false; 3]);
    let (mut x, mut out, n, R) = (x0, vec![], 25_000, p.machine.R_s + inv.r_d);
    let dt = T_S / n as f64;
    for (duty, on) in run {
        for k in 0..n {
            let t = (k as f64 + 0.5) * dt;
            let (mut lo, mut hi) = ([-inv.u_th; 3], [inv.u_dc + inv.u_th; 3]);
            for leg in 0..3 {
                let high = (t - 0.5 * T_S).abs() < 0.5 * T_S * duty[leg];
                since[leg] = if high != level[leg] { 0.0 } else { since[leg] + dt };
                level[leg] = high;
                if *on && since[leg] >= inv.dead_time {
                    if high {
                        lo[leg] = inv.u_dc - inv.u_th;
                    } else {
                        hi[leg] = inv.u_th;
                    }
                }
            }
            x = circuit.step(&x, omega, R, dt, |i| {
                vector([0, 1, 2].map(|leg| {
                    let i_leg = AXIS[leg][0] * i[0] + AXIS[leg][1] * i[1];
                    (0.5 * inv.u_dc - 1.5e6 * i_leg).clamp(lo[leg], hi[leg])
                }))
            });
        }
        out.push(circuit.current(&x));
    }
    out
}

#[test]
fn brute_force_bridge_agrees_at_small_currents_and_blocked() {
    let base = saturated();
    for (case, (p, omega, u, w, blocked)) in [
        // Slow turning with currents around zero, uncompensated: plateaus.
        (linear(), 3.0, 8.0, 8.0, false),
        // Fast, so that phase currents cross within the active vectors.
        (base, 100.0, 200.0, 210.0, false),
        // Gates dropped while currents flow; rectifying at high speed.
        (base, 120.0, 230.0, 245.0, true),
        (linear(), 230.0, 260.0, 460.0, true),
    ]
    .into_iter()
    .enumerate()
    {
        let g = p.machine.to_gamma();
        let mut plant = plant(held(p, omega));
        let psi = [0.85, -0.2];
        let psi_R = if case == 0 { [0.844, -0.195] } else { [0.80, -0.18] };
        plant.set_state(psi, psi_R, omega).unwrap();
        // Γ rotor flux of the same state, from i_s and the Γ equations.
        let t = *plant.truth();
        let L = p.machine.saturation.map_or(g.L_s, |s| s.L_u / (1.0 + (s.a * psi[0].hypot(psi[1])).powf(s.S)));
        let psi_r = [0, 1].map(|x| psi[x] + g.L_l * (psi[x] / L - t.i_s[x]));
        let run: Vec<_> = (0..60)
            .map(|k| (duties(polar(u, w * T_S * k as f64 + 1.3), 540.0), !(blocked && (25..50).contains(&k))))
            .collect();
        // The plant's preload register: one period ahead.
        let first = ([0.5; 3], true);
        let shifted: Vec<_> =
            std::iter::once(first).chain(run.iter().copied()).take(60).zip(&run).map(|((d, _), r)| (d, r.1)).collect();
        let want = brute_force(&p, [psi[0], psi[1], psi_r[0], psi_r[1]], omega, &shifted);
        let mut zeros = 0;
        for (k, (r, want)) in run.iter().zip(&want).enumerate() {
            plant.step(r.0, r.1, 0.0);
            let i = plant.truth().i_s;
            zeros += plant.phase_currents().iter().filter(|i| **i == 0.0).count();
            // Edges of the reference lie on a 4-ns grid, up to 540 V · 4 ns / 21 mH = 0.1 mA each; its clamp is
            // 0.36 mA wide. A lost gate change costs 10 mA and more.
            assert!(distance(i, *want) < 5e-4, "case {case}, period {k}: {i:?} {want:?}");
        }
        assert!(zeros > 0 || !blocked, "case {case} never clamped at a sample");
    }
}

#[test]
fn any_duties_and_blockings_keep_the_balance() {
    // A multiplicative congruential generator suffices to shake the event logic.
    let mut seed = 12345u64;
    let mut random = move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 11) as f64 / (1u64 << 53) as f64
    };
    for (u_th, dead_time, sat) in
        [(1.0, 2e-6, true), (0.0, 2e-6, false), (1.0, 0.0, false), (0.0, 0.0, true), (5.0, 9e-6, true)]
    {
        let mut p = if sat { saturated() } else { linear() };
        (p.inverter.u_th, p.inverter.dead_time) = (u_th, dead_time);
        if dead_time > 5e-6 {
            p.gate_delays = GateDelays { on: [[1e-6, 4e-6]; 3], off: [[3e-6, 0.5e-6], [2e-6, 4e-6], [0.0, 5e-6]] };
        }
        p.mechanics = Mechanics { coulomb: 0.3, stribeck: 0.3, ..p.mechanics };
        let mut plant = plant(p);
        plant.track_energy(true);
        for _ in 0..400 {
            let (wild, on, load) = (random() < 0.3, random() < 0.8, 10.0 * random() - 5.0);
            for _ in 0..(1.0 + 30.0 * random()) as u32 {
                let spread = if wild { 1.4 } else { 0.03 };
                plant.step([0; 3].map(|_| 0.5 + spread * (random() - 0.5)), on, load);
                let i = plant.phase_currents();
                assert!(i.iter().all(|i| i.abs() < 300.0) && (i[0] + i[1] + i[2]).abs() < 1e-9, "{i:?}");
            }
        }
        let e = *plant.energy().unwrap();
        let balance = e.input - e.copper_s - e.copper_r - e.shaft - plant.magnetic_energy();
        assert!(balance.abs() < 1e-6 * e.copper_s, "{e:?} {balance:e}");
    }
}

#[test]
fn averaged_bridge_follows_the_switched_one() {
    let run = |mode| {
        let mut plant = plant(PlantParams { mode, ..saturated() });
        for k in 0..15_000 {
            let t = k as f64 * T_S;
            plant.step(duties(polar(40.0, TAU * 3.0 * t.min(1.0) * t), 540.0), true, 2.0);
        }
        *plant.truth()
    };
    let (a, s) = (run(Mode::Averaged), run(Mode::Switching));
    assert!(distance(a.psi_s, s.psi_s) < 0.02 && (a.omega_m - s.omega_m).abs() < 0.3, "{a:?}\n{s:?}");
}

#[test]
fn shaft_sticks_slides_and_stops() {
    let mut p = linear();
    p.mechanics = Mechanics { coulomb: 1.0, stribeck: 0.5, stribeck_speed: 2.0, ..p.mechanics };
    let mut a = plant(p);
    for load in [0.0, 1.0, -1.4, 1.49] {
        a.step([0.5; 3], false, load);
        assert_eq!((a.truth().omega_m, a.truth().theta_m), (0.0, 0.0), "below breakaway");
    }
    a.step([0.5; 3], false, 1.51);
    assert!(a.truth().omega_m < 0.0, "above");
    // Coasting: Coulomb alone stops within J w/T exactly, and stays.
    p.mechanics.stribeck = 0.0;
    let mut b = plant(p);
    b.set_state([0.0; 2], [0.0; 2], 10.0).unwrap();
    for _ in 0..1499 {
        b.step([0.5; 3], false, 0.0);
    }
    assert!((b.truth().omega_m - 10.0 / 1500.0).abs() < 1e-9);
    b.step([0.5; 3], false, 0.0);
    for _ in 0..10 {
        b.step([0.5; 3], false, 0.0);
        assert_eq!(b.truth().omega_m, 0.0);
    }
    assert!((b.truth().theta_m - 0.5 * 10.0 * 0.15).abs() < 1e-6);
    // An active load pulls it through standstill: decelerates with T + T_c, goes on with T - T_c.
    b.set_state([0.0; 2], [0.0; 2], 1.0).unwrap();
    for _ in 0..100 {
        b.step([0.5; 3], false, 4.0);
    }
    let through = 1.0 * 0.015 / 5.0;
    assert!((b.truth().omega_m + (0.01 - through) * 3.0 / 0.015).abs() < 1e-9, "{}", b.truth().omega_m);
}

#[test]
fn winding_warms_to_its_rise() {
    let mut p = held(linear(), 0.0);
    p.thermal = Some(Thermal { time_constant: 0.05, rise: 80.0, alpha: 0.0039, alpha_R: 0.0 });
    let mut plant = plant(p);
    let mut R_s = 3.7;
    for _ in 0..20_000 {
        plant.step_voltage([5.0 * R_s, 5.0 * R_s], T_S, 0.0);
        R_s = plant.truth().R_s;
    }
    // |i|² = 2 I_N²: rated; the loss itself grows with the resistance: T = 80 (1 + alpha T).
    let kelvin = 80.0 / (1.0 - 0.0039 * 80.0);
    assert!((R_s / (3.7 * (1.0 + 0.0039 * kelvin)) - 1.0).abs() < 1e-6, "{R_s}");
    plant.set_R_s(4.0);
    assert!((plant.truth().R_s / R_s - 4.0 / 3.7).abs() < 1e-12);
}

#[test]
fn a_winding_warms_by_the_square_of_its_current_however_a_stretch_is_divided() {
    // A current that swings about zero: the square of its mean over a long stretch would be none of the heat.
    let heat = |parts: u32| {
        let mut p = held(linear(), 300.0);
        p.thermal = Some(Thermal { time_constant: 1e3, rise: 80.0, alpha: 0.0039, alpha_R: 0.0 });
        let mut plant = plant(p);
        plant.set_state([0.5, 0.0], [0.5, 0.0], 300.0).unwrap();
        for _ in 0..parts {
            plant.step_voltage([0.0; 2], 0.2 / f64::from(parts), 0.0);
        }
        plant.truth().R_s / 3.7 - 1.0
    };
    let (one, many) = (heat(1), heat(2000));
    assert!(one > 1e-6 && (one / many - 1.0).abs() < 2e-3, "{one:e} {many:e}");
}

#[test]
fn a_state_that_steps_cannot_follow_is_refused() {
    let mut plant = plant(capacitive(0.0));
    let refused = |plant: &mut Plant, psi: f64, omega: f64| {
        let before = *plant.truth();
        let error = plant.set_state([psi, 0.0], [psi, 0.0], omega).unwrap_err();
        assert_eq!(*plant.truth(), before);
        error.field
    };
    assert_eq!(refused(&mut plant, 1e9, 0.0), "rate of currents at psi_s and psi_r");
    assert_eq!(refused(&mut plant, f64::NAN, 0.0), "rate of currents at psi_s and psi_r");
    assert_eq!(refused(&mut plant, 1.0, 1e9), "omega_m");
    plant.set_speed(Some(10.0));
    assert_eq!(refused(&mut plant, 1.0, 11.0), "omega_m");
    let mut p = capacitive(0.0);
    p.mechanics.viscous = 1.01e4 * p.machine.J;
    assert_eq!(Plant::new(p).unwrap_err().field, "viscous");
}

#[test]
fn a_state_that_is_no_number_stays_one_without_a_panic() {
    for (mode, c_out) in [(Mode::Averaged, 1e-9), (Mode::Switching, 1e-9), (Mode::Switching, 0.0)] {
        let mut plant = plant(PlantParams { mode, ..capacitive(c_out) });
        plant.step([0.6, 0.5, 0.4], true, 0.0);
        plant.step_voltage([f64::NAN, 0.0], 1e-4, 0.0);
        for gates_on in [true, false] {
            plant.step([0.6, 0.5, 0.4], gates_on, 0.0);
        }
        assert!(plant.truth().i_s[0].is_nan(), "{mode:?} {c_out}");
    }
}

#[test]
fn the_fastest_shaft_and_the_strongest_friction_are_followed() {
    // Constant voltage: the steady state of the equations in closed form, j w_s = 0 in the stator.
    for speed in [1e3, 1e5] {
        let p = held(linear(), speed);
        let mut plant = plant(p);
        for _ in 0..40 {
            plant.step_voltage([3.7, 0.0], 5e-3, 0.0);
        }
        let i = plant.truth().i_s;
        assert!((i[0] - 1.0).abs() < 1e-3 && i[1].abs() < 1e-2, "{speed}: {i:?}");
    }
    let mut p = capacitive(0.0);
    p.mechanics.viscous = 1e4 * p.machine.J;
    let mut plant = plant(p);
    for _ in 0..20 {
        plant.step([0.5; 3], false, -10.0);
    }
    assert!((plant.truth().omega_m * p.mechanics.viscous / 10.0 - 1.0).abs() < 1e-3, "{}", plant.truth().omega_m);
}

#[test]
fn channels_are_sampled_at_their_own_instants() {
    for (mode, c_out) in [(Mode::Switching, 0.0), (Mode::Switching, 1e-9), (Mode::Averaged, 0.0)] {
        // Standing flux that stays, at the end of the period no voltage: the current decays with L_sigma/R.
        let mut p = ideal_bridge(PlantParams { mode, ..linear() });
        (p.machine.R_R, p.inverter.c_out, p.adc.skew) = (1e-5, c_out, [0.0, 2e-6, 5e-6]);
        let (mut plant, _) = loaded(p, [3.0, 1.0]);
        let d = duties([0.0; 2], 540.0);
        for _ in 0..5 {
            let seen = plant.step(d, true, 0.0).i_abc;
            let now = plant.phase_currents();
            for k in 0..3 {
                let want = now[k] * (p.adc.skew[k] * 3.7 / 0.021).exp();
                assert!((seen[k] - want).abs() < 1e-7, "{mode:?} {k}: {seen:?} {now:?} {want}");
            }
        }
        assert_eq!(plant.sample().i_abc, plant.phase_currents(), "a reading between periods is of that instant");
    }
    let mut p = linear();
    p.adc.skew[1] = 60e-6;
    assert_eq!(Plant::new(p).unwrap_err().field, "adc_skew");
}

#[test]
fn same_seed_same_run() {
    let mut p = saturated();
    p.adc.bits = 12;
    p.adc.noise = 0.02;
    let (mut a, mut b) = (plant(p), plant(p));
    for k in 0..2000 {
        let d = duties(polar(30.0, k as f64 * 0.01), 540.0);
        assert_eq!(a.step(d, true, 0.0), b.step(d, true, 0.0));
    }
    assert_eq!(a.truth(), b.truth());
}

#[test]
fn bad_parameters_are_named() {
    let mut p = linear();
    p.mechanics.viscous = -1.0;
    assert_eq!(Plant::new(p).unwrap_err().field, "viscous");
    let mut p = linear();
    p.adc.range = 0.0;
    assert_eq!(Plant::new(p).unwrap_err().field, "adc_range");
    let mut p = linear();
    p.inverter.f_s = f64::NAN;
    assert_eq!(Plant::new(p).unwrap_err().field, "f_s");
}

#[test]
fn a_bridge_that_is_changed_is_as_one_made_so() {
    let made = |dead_time, c_out| {
        let inverter = Inverter { dead_time, c_out, ..Inverter::preset_2k2() };
        plant(PlantParams::new(Machine::preset_2k2(), inverter))
    };
    let mut other = made(1e-6, 0.5e-9);
    let voltage = |p: &mut Plant| {
        (0..300).for_each(|k| {
            p.step(duties(polar(20.0, 0.03 * f64::from(k)), 540.0), true, 0.0);
        });
        *p.truth()
    };
    let unchanged = voltage(&mut other.clone());
    for (dead_time, c_out) in [(3e-6, 0.5e-9), (1e-6, 2e-9), (2e-6, 0.0), (0.0, 1e-9)] {
        other.set_dead_time(dead_time);
        other.set_node_capacitance(c_out);
        let changed = voltage(&mut other.clone());
        assert_eq!(changed, voltage(&mut made(dead_time, c_out)), "{dead_time} {c_out}");
        assert_ne!(changed.psi_s, unchanged.psi_s, "{dead_time} {c_out}");
    }
}
