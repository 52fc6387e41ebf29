//! The plant against closed forms, balances and independent integrations: one block a module.
#![allow(non_snake_case)]

mod branches;
mod bridge;
mod nodes;
mod shunt;
mod slots;

use stillflux::params::{Gamma, Inverter, Machine, Saturation};
use stillflux_sim::{Energy, Plant, PlantParams};

/// Control period of every run here, s.
const T_S: f64 = 1e-4;
/// Axes of the phases in the stator's plane.
const AXIS: [[f64; 2]; 3] = [[1.0, 0.0], [-0.5, 0.866_025_403_784_438_6], [-0.5, -0.866_025_403_784_438_6]];

/// Exact sensors and timers, so that nothing but the equations under test is left.
fn ideal_sensors(machine: Machine, inverter: Inverter) -> PlantParams {
    let mut p = PlantParams::new(machine, Inverter { f_clk: 0.0, ..inverter });
    (p.adc.bits, p.adc.u_dc_bits) = (0, 0);
    p
}

/// The 2.2-kW preset with node capacitance `c_out`, F.
fn capacitive(c_out: f64) -> PlantParams {
    ideal_sensors(Machine::preset_2k2(), Inverter { c_out, ..Inverter::preset_2k2() })
}

fn held(mut p: PlantParams, omega: f64) -> PlantParams {
    p.mechanics.speed = Some(omega);
    p
}

fn plant(p: PlantParams) -> Plant {
    Plant::new(p).unwrap()
}

fn vector(v: [f64; 3]) -> [f64; 2] {
    [0, 1].map(|x| 2.0 / 3.0 * (0..3).map(|k| AXIS[k][x] * v[k]).sum::<f64>())
}

fn duties(u: [f64; 2], u_dc: f64) -> [f64; 3] {
    AXIS.map(|e| 0.5 + (e[0] * u[0] + e[1] * u[1]) / u_dc)
}

fn polar(r: f64, a: f64) -> [f64; 2] {
    [r * a.cos(), r * a.sin()]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The Γ circuit once more, independent of the plant: state is stator flux and rotor flux.
struct Circuit {
    g: Gamma,
    saturation: Option<Saturation>,
    n_p: f64,
}

impl Circuit {
    fn new(m: &Machine) -> Self {
        Self { g: m.to_gamma(), saturation: m.saturation, n_p: f64::from(m.n_p) }
    }

    fn current(&self, x: &[f64; 4]) -> [f64; 2] {
        let (g, psi) = (&self.g, x[0].hypot(x[1]));
        let b = self.saturation.map_or(1.0 / g.L_s, |s| (1.0 + (s.a * psi).powf(s.S)) / s.L_u) + 1.0 / g.L_l;
        [b * x[0] - x[2] / g.L_l, b * x[1] - x[3] / g.L_l]
    }

    /// A step of Heun's method: `dt` s at mechanical speed `omega` and stator resistance `R`, with the voltage that
    /// `u` gives for the currents.
    fn step(&self, x: &[f64; 4], omega: f64, R: f64, dt: f64, u: impl Fn([f64; 2]) -> [f64; 2]) -> [f64; 4] {
        let (w, k) = (self.n_p * omega, self.g.R_r / self.g.L_l);
        let f = |x: &[f64; 4]| {
            let i = self.current(x);
            let u = u(i);
            [u[0] - R * i[0], u[1] - R * i[1], k * (x[0] - x[2]) - w * x[3], k * (x[1] - x[3]) + w * x[2]]
        };
        let a = f(x);
        let y: [f64; 4] = std::array::from_fn(|j| x[j] + dt * a[j]);
        let b = f(&y);
        std::array::from_fn(|j| x[j] + 0.5 * dt * (a[j] + b[j]))
    }
}

/// The plain circuit's run-up against the one with options `with`, whose amplitudes vanish or which are another form
/// of the same circuit: currents, speed and rotor flux agree.
fn runs_up_alike(with: impl Fn(PlantParams) -> PlantParams) {
    for (c_out, saturation) in [(0.0, true), (1e-9, true), (1e-9, false)] {
        let one = PlantParams { saturation, ..capacitive(c_out) };
        let (mut a, mut b) = (plant(one), plant(with(one)));
        let mut worst = 0.0f64;
        for k in 0..8000 {
            let t = k as f64 * T_S;
            let d = duties(polar(25.0 + 120.0 * t, std::f64::consts::TAU * 12.0 * t * t), 540.0);
            let on = k % 1000 < 950;
            a.step(d, on, 1.0);
            b.step(d, on, 1.0);
            worst = worst.max(distance(a.truth().i_s, b.truth().i_s));
        }
        let (a, b) = (a.truth(), b.truth());
        assert!(worst < 1e-5, "{worst:e} A");
        assert!((a.omega_m - b.omega_m).abs() < 1e-6 && a.omega_m > 5.0, "{} {}", a.omega_m, b.omega_m);
        assert!(distance(a.psi_r, b.psi_r) < 1e-7);
    }
}

/// A run-up with coulomb friction and pauses of the gates: the plant after it, its energies, and what is missing in the
/// balance of the machine and in that of everything, over the input.
fn energies(mut p: PlantParams) -> (Plant, Energy, f64, f64) {
    p.mechanics.coulomb = 0.3;
    let mut plant = plant(p);
    plant.track_energy(true);
    let begin = plant.node_energy();
    for k in 0..6000 {
        let t = k as f64 * T_S;
        plant.step(duties(polar(25.0 + 200.0 * t, std::f64::consts::TAU * 20.0 * t * t), 540.0), k % 700 < 650, 1.0);
    }
    let e = *plant.energy().unwrap();
    let lost = e.copper_s + e.copper_r + e.iron + e.shaft;
    let machine = e.input - lost - plant.magnetic_energy();
    let all = e.link - e.conduction - e.charging - lost - plant.magnetic_energy() - plant.node_energy() + begin;
    (plant, e, machine / e.input, all / e.input)
}
