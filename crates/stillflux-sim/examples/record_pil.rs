//! Records a closed loop for the processor in the loop: frames to the target, and the host's own answers.
//!
//! `record_pil f32|q enhanced|paper FRAMES ANSWERS TELEMETRY`; the format is that of `stillflux-firmware/src/exchange.rs`, the
//! telemetry that of `stillflux-c/examples/drive.c`. Host and target compile the same source.

#[path = "../../stillflux-firmware/src/blob.rs"]
#[allow(dead_code)]
mod blob;
#[path = "../../stillflux-firmware/src/exchange.rs"]
#[allow(dead_code)]
mod exchange;
#[path = "shared/reading.rs"]
mod reading;

use std::error::Error;

use blob::Parameters;
use exchange::{Frame, Word, answer};
use reading::left_aligned;
use stillflux::base::Base;
use stillflux::config::Scheme;
use stillflux::counts::Counts;
use stillflux::drive::Status;
use stillflux::interrupt::{Command, CountsDrive};
use stillflux::scalar::Q;
use stillflux::telemetry::{SetPoint, Telemetry};
use stillflux_sim::{Plant, PlantParams};

/// Reference speed (per unit) and load (of rated torque) from a time on: start-up, low speed, load step,
/// regeneration held at zero stator frequency (the speed is minus the slip of rated torque), reversal, fast
/// with field weakening (without it as fast as the voltage allows), torque control.
const PROFILE: [(f64, Set, f64); 9] = [
    (0.0, Set::Speed(0.0), 0.0),
    (1.7, Set::Speed(0.05), 0.0),
    (2.6, Set::Speed(0.05), 1.0),
    (3.6, Set::Speed(-0.0364), 1.0),
    (7.0, Set::Speed(-0.3), 0.3),
    (8.5, Set::Speed(if cfg!(feature = "weakening") { 1.5 } else { 0.85 }), 0.1),
    (11.5, Set::Speed(0.05), 0.5),
    (13.5, Set::Torque(0.5), 0.45),
    (14.0, Set::Stop, 0.0),
];
const DURATION: f64 = 14.2;

#[derive(Clone, Copy)]
enum Set {
    Stop,
    Speed(f64),
    Torque(f64),
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match args.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["f32", scheme, ref to @ ..] if to.len() == 3 => record::<f32>(scheme_of(scheme)?, to),
        ["q", scheme, ref to @ ..] if to.len() == 3 => record::<Q>(scheme_of(scheme)?, to),
        _ => Err("usage: record_pil f32|q enhanced|paper FRAMES ANSWERS TELEMETRY".into()),
    }
}

fn scheme_of(name: &str) -> Result<Scheme, String> {
    match name {
        "enhanced" => Ok(Scheme::Enhanced),
        "paper" => Ok(Scheme::Paper),
        _ => Err(format!("no scheme {name}")),
    }
}

#[allow(clippy::cast_possible_truncation)]
fn record<R: Word>(scheme: Scheme, to: &[&str]) -> Result<(), Box<dyn Error>> {
    let p = Parameters::preset(scheme);
    let base = Base::new(&p.machine);
    let mut plant = Plant::new(PlantParams::new(p.machine, p.inverter))?;
    let mut control = CountsDrive::<R>::new(&p.ready()?);
    let full = f64::from(control.timer().ok_or("no timer")?.full());
    let mut sample = plant.sample();
    let (mut frames, mut answers, mut telemetry) = (Vec::new(), Vec::new(), Vec::new());
    let mut speed = 0.0_f64;
    for k in 0..(DURATION * p.inverter.f_s) as u32 {
        let t = f64::from(k) / p.inverter.f_s;
        let &(_, set, load) = PROFILE.iter().rev().find(|x| x.0 <= t).unwrap_or(&PROFILE[0]);
        let set_point = match set {
            Set::Stop => SetPoint::Stop,
            Set::Speed(x) => {
                // One rated speed a second.
                speed += (x - speed).clamp(-1.0 / p.inverter.f_s, 1.0 / p.inverter.f_s);
                SetPoint::Speed((speed * base.omega_m) as f32)
            }
            Set::Torque(x) => SetPoint::Torque((x * p.machine.T_N) as f32),
        };
        let counts = Counts {
            i_abc: sample.i_abc.map(|i| left_aligned(i / p.i_full)),
            u_dc: left_aligned(sample.u_dc / p.u_full),
        };
        let command = control.period(&counts, &set_point);
        frames.extend(Frame { counts, set_point }.to_bytes());
        answers.extend(answer(&control, &command));
        telemetry.extend(read(&command, &control.telemetry()).into_iter().flat_map(u32::to_le_bytes));
        let duty = command.compare.map(|n| f64::from(n) / full);
        sample = plant.step(duty, command.gates_on, load * p.machine.T_N);
        if matches!(control.status(), Status::Faulted { .. }) {
            return Err(format!("{:?} at {t} s", control.status()).into());
        }
    }
    std::fs::write(to[0], &frames)?;
    std::fs::write(to[1], &answers)?;
    std::fs::write(to[2], &telemetry)?;
    Ok(())
}

/// Words of a command and of a telemetry.
const COMMAND: usize = 4;
const TELEMETRY: usize = size_of::<Telemetry>() / 4;

/// Command and telemetry as they lie in memory in C.
#[allow(non_snake_case)]
fn read(command: &Command, t: &Telemetry) -> [u32; COMMAND + TELEMETRY] {
    let [a, b, c] = command.compare;
    let Telemetry {
        status,
        fault,
        period,
        omega_m,
        omega_s,
        torque,
        psi_s,
        i_d,
        i_q,
        R_s,
        angle_deviation,
        confidence,
        speed_gain,
        ..
    } = *t;
    let [omega_m, omega_s, torque, psi_s, i_d, i_q, R_s, angle_deviation, confidence, speed_gain] =
        [omega_m, omega_s, torque, psi_s, i_d, i_q, R_s, angle_deviation, confidence, speed_gain].map(f32::to_bits);
    let gates_on = u32::from(command.gates_on);
    [
        a,
        b,
        c,
        gates_on,
        status,
        fault,
        period,
        omega_m,
        omega_s,
        torque,
        psi_s,
        i_d,
        i_q,
        R_s,
        angle_deviation,
        confidence,
        speed_gain,
    ]
}
