//! Wall time of one plant period and of a closed loop: `cargo run --release -p stillflux-sim --example plant_speed`.

use std::borrow::Cow;
use std::time::Instant;
use stillflux::params::{Inverter, Machine};
use stillflux_sim::simulate::{Profile, ReferenceProfile, Run, Scenario};
use stillflux_sim::{
    Calls, DcLink, DeepBar, Grid, IronLoss, LeakageSaturation, Mode, Plant, PlantParams, SlotRipple, Thermal,
};

fn main() {
    plants();
    println!(
        "simulated seconds per second with drive, f32 (best of 8): start, ramp, half the rated load; switching level"
    );
    for c_out in [0.0, 0.1e-9, 1e-9, 10e-9] {
        let best = (0..8).map(|_| closed_loop(|p| p.inverter.c_out = c_out)).fold(0.0, f64::max);
        println!("  {:.1} nF: {best:.0}", c_out * 1e9);
    }
    let options: [(&str, Change); 7] = [
        ("eddy currents and deep bar", |p| (p.iron_loss, p.deep_bar) = (Some(IRON), Some(BAR))),
        ("leakage saturation", |p| p.leakage_saturation = Some(KNEE)),
        ("slots", |p| p.slot_ripple = Some(SLOTS)),
        ("smooth link", |p| p.dc_link = Some(LINK)),
        ("rectifier", |p| (p.dc_link, p.grid) = (Some(LINK), Some(GRID))),
        ("skew and delays", skewed),
        ("everything", |p| {
            (p.iron_loss, p.deep_bar, p.leakage_saturation) = (Some(IRON), Some(BAR), Some(KNEE));
            (p.slot_ripple, p.dc_link, p.grid) = (Some(SLOTS), Some(LINK), Some(GRID));
            p.calls = Calls { missed: 1e-3, doubled: 1e-3 };
            p.adc.noise = 0.02;
            (p.mechanics.coulomb, p.mechanics.stribeck) = (0.2, 0.1);
            p.thermal = Some(Thermal { time_constant: 600.0, rise: 80.0, alpha: 0.0039, alpha_R: 0.0 });
            skewed(p);
        }),
    ];
    for (name, set) in options {
        let best = (0..8).map(|_| closed_loop(set)).fold(0.0, f64::max);
        println!("  1.0 nF, {name}: {best:.0}");
    }
}

type Change = fn(&mut PlantParams);

const IRON: IronLoss = IronLoss { R_fe: 1500.0, time_constant: 150e-6 };
const BAR: DeepBar = DeepBar { conductance: 0.2, leakage: 0.5 };
const KNEE: LeakageSaturation = LeakageSaturation { share: 0.2, current: 14.0 };
const SLOTS: SlotRipple = SlotRipple { slots: 28, permeance: 0.005, leakage: 0.05 };
const LINK: DcLink = DcLink { C: 0.4e-3, R_supply: 0.3, R_chopper: 20.0 };
const GRID: Grid = Grid { frequency: 50.0, inductance: 0.5e-3 };

fn skewed(p: &mut PlantParams) {
    p.adc.skew = [0.0, 1.5e-6, 3e-6];
    p.gate_delays.on = [[25e-9, 100e-9], [75e-9, 50e-9], [100e-9, 25e-9]];
    p.gate_delays.off = [[150e-9, 75e-9], [50e-9, 125e-9], [100e-9, 150e-9]];
}

/// Simulated seconds per second of wall time.
fn closed_loop(option: impl Fn(&mut PlantParams)) -> f64 {
    let duration = 4.0;
    let mut s = Scenario::new(Machine::preset_2k2(), Inverter::preset_2k2(), duration);
    option(&mut s.plant);
    s.reference = ReferenceProfile::Speed(Profile::new(vec![(1.6, 0.0), (1.8, 15.0)]).unwrap());
    s.load = Profile::new(vec![(2.0, 0.0), (2.0, 7.0)]).unwrap();
    let t = Instant::now();
    let mut run = Run::new(Cow::Owned(s)).unwrap();
    while run.advance(10_000) {}
    duration / t.elapsed().as_secs_f64()
}

fn plants() {
    println!("ns per period at 10 kHz (best of 5)      slow = 1 Hz, fast = 45 Hz, loaded; idle = 1 Hz, no load");
    let plain = [(Mode::Switching, false), (Mode::Switching, true), (Mode::Averaged, false), (Mode::Averaged, true)];
    for (mode, saturation, c_out) in plain
        .map(|(mode, saturation)| (mode, saturation, 0.0))
        .into_iter()
        .chain([0.1e-9, 1e-9, 10e-9].map(|c_out| (Mode::Switching, true, c_out)))
        .chain([(Mode::Averaged, true, 1e-9)])
    {
        print!("{mode:?}{}", if saturation { ", saturated" } else { "" });
        if c_out > 0.0 {
            print!(", {:.1} nF", c_out * 1e9);
        }
        for (name, f, load) in [("slow", 1.0, 10.0), ("fast", 45.0, 10.0), ("idle", 1.0, 0.0)] {
            let (m, inv) = (Machine::preset_2k2(), Inverter { c_out, ..Inverter::preset_2k2() });
            let mut params = PlantParams::new(m, inv);
            (params.mode, params.saturation) = (mode, saturation);
            let omega = std::f64::consts::TAU * f;
            params.mechanics.speed = Some((omega - load / 10.0 * 6.0) / 2.0);
            let mut plant = Plant::new(params).unwrap();
            let n = 20_000;
            // Stator flux of 0.95 V·s with its resistive drop; dead time and threshold compensated by the current's sign.
            let drop = inv.dead_time * inv.f_s + inv.u_th / inv.u_dc;
            let unit: Vec<_> = (0..n)
                .map(|k| [0.0, 1.0, 2.0].map(|p| (omega * k as f64 * 1e-4 - p * std::f64::consts::TAU / 3.0).cos()))
                .collect();
            let u = (0.95 * omega + 2.4 * load + 15.0 - load) / inv.u_dc;
            let mut i = [0.0; 3];
            let mut run = || {
                for e in &unit {
                    let d = [0, 1, 2].map(|k| 0.5 + u * e[k] + drop * (i[k] * 10.0f64).clamp(-1.0, 1.0));
                    i = plant.step(d, true, 0.0).i_abc;
                }
            };
            run();
            let best = (0..5)
                .map(|_| {
                    let t = Instant::now();
                    run();
                    t.elapsed().as_nanos() as f64 / n as f64
                })
                .fold(f64::MAX, f64::min);
            print!("   {name} {best:.0}");
        }
        println!();
    }
}
