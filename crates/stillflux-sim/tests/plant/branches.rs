//! Iron loss and deep bar: limits in which they are something known, steady states, energy balance.

use super::*;
use std::f64::consts::TAU;
use stillflux_sim::{DeepBar, IronLoss, Plant, PlantParams};

#[test]
fn two_branches_of_one_time_constant_are_one() {
    runs_up_alike(|one| PlantParams { deep_bar: Some(DeepBar { conductance: 0.3, leakage: 0.3 }), ..one });
}

#[test]
fn energy_is_conserved_with_every_branch() {
    for c_out in [0.0, 1e-9] {
        let mut p = capacitive(c_out);
        p.iron_loss = Some(IronLoss { R_fe: 900.0, time_constant: 150e-6 });
        p.deep_bar = Some(DeepBar { conductance: 0.3, leakage: 0.6 });
        let (_, e, machine, all) = energies(p);
        assert!(e.iron > 0.01 * e.input, "{e:?}");
        assert!(machine.abs() < 1e-6 && all.abs() < 1e-6, "{machine:e} {all:e} {e:?}");
    }
}

#[test]
fn steady_state_is_that_of_the_branches_impedances() {
    // Complex numbers as pairs.
    let mul = |a: [f64; 2], b: [f64; 2]| [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]];
    let inv = |a: [f64; 2]| {
        let n = a[0] * a[0] + a[1] * a[1];
        [a[0] / n, -a[1] / n]
    };
    let mut p = PlantParams { saturation: false, ..capacitive(0.0) };
    let (iron, bar) = (IronLoss { R_fe: 700.0, time_constant: 200e-6 }, DeepBar { conductance: 0.25, leakage: 0.6 });
    (p.iron_loss, p.deep_bar, p.mechanics.speed) = (Some(iron), Some(bar), Some(50.0));
    let (m, g) = (p.machine, p.machine.to_gamma());
    let (w, dt, U) = (TAU * 40.0, 2e-6, 200.0);
    let mut plant = plant(p);
    plant.track_energy(true);
    let (n, mut half) = (500_000, 0.0);
    for k in 0..n {
        plant.step_voltage(polar(U, w * (k as f64 + 0.5) * dt), dt, 0.0);
        if k + 1 == n / 2 {
            half = plant.energy().unwrap().iron;
        }
    }
    // A winding with R/L and the flux psi_s = 1 across turns w_x slower: its current is (1 - psi_x/psi_s)/L.
    let branch = |R: f64, L: f64, slip: f64| mul([0.0, slip / L], inv([R / L, slip]));
    let slip = w - 2.0 * 50.0;
    let L_fe = iron.R_fe * iron.time_constant;
    let parts = [
        [1.0 / g.L_s, 0.0],
        branch(g.R_r / 0.75, g.L_l / 0.4, slip),
        branch(g.R_r / 0.25, g.L_l / 0.6, slip),
        branch(iron.R_fe, L_fe, w),
    ];
    let y = parts.iter().fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
    // U = (R_s y + j w) psi_s
    let psi = mul([U, 0.0], inv([m.R_s * y[0], m.R_s * y[1] + w]));
    let i = mul(y, psi);
    let t = plant.truth();
    let back = |v: [f64; 2]| mul(v, polar(1.0, -w * t.t));
    assert!(distance(back(t.psi_s), psi) < 1e-5 * psi[0].hypot(psi[1]), "{:?} {psi:?}", back(t.psi_s));
    assert!(distance(back(t.i_s), i) < 1e-5 * i[0].hypot(i[1]), "{:?} {i:?}", back(t.i_s));
    // Loss of the iron, 3/2 |w psi_s|²/R_fe but for the sheets' time constant.
    let psi2 = psi[0] * psi[0] + psi[1] * psi[1];
    let power = 1.5 * w * w * psi2 / iron.R_fe / (1.0 + (w * iron.time_constant).powi(2));
    let got = (plant.energy().unwrap().iron - half) / (0.5 * n as f64 * dt);
    assert!((got / power - 1.0).abs() < 1e-4, "{got} {power}");
    // The cage alone makes torque.
    let torque = 1.5 * 2.0 * psi2 * (parts[1][1] + parts[2][1]);
    assert!((t.torque / torque - 1.0).abs() < 1e-4, "{} {torque}", t.torque);
}

#[test]
fn bad_branches_are_named() {
    let field =
        |iron_loss, deep_bar| Plant::new(PlantParams { iron_loss, deep_bar, ..capacitive(0.0) }).unwrap_err().field;
    assert_eq!(field(Some(IronLoss { R_fe: 0.0, time_constant: 1e-3 }), None), "iron_loss R_fe");
    assert_eq!(field(Some(IronLoss { R_fe: 700.0, time_constant: 1e-6 }), None), "iron_loss time constant");
    assert_eq!(field(None, Some(DeepBar { conductance: 0.95, leakage: 0.5 })), "deep_bar conductance");
}
