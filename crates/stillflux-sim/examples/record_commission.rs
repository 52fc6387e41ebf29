//! Records a commissioning for the processor in the loop: frames to the target, the host's own answers, and the parameter
//! page that the host makes of what it has found.
//!
//! `record_commission f32|q FRAMES ANSWERS PAGE`; the formats are those of `stillflux-firmware/src/exchange.rs` and
//! `commissioning.rs`. Host and target compile the same source.

#[path = "../../stillflux-firmware/src/commissioning.rs"]
mod commissioning;
#[path = "../../stillflux-firmware/src/exchange.rs"]
#[allow(dead_code)]
mod exchange;
#[path = "shared/reading.rs"]
mod reading;

use std::error::Error;

use commissioning::{answer, begin, page};
use exchange::Frame;
use reading::left_aligned;
use stillflux::commission::Status;
use stillflux::counts::Counts;
use stillflux::params::{Inverter, Machine};
use stillflux::scalar::{Q, Real};
use stillflux::telemetry::SetPoint;
use stillflux_sim::{Plant, PlantParams};

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match args.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["f32", ref to @ ..] if to.len() == 3 => record::<f32>(to),
        ["q", ref to @ ..] if to.len() == 3 => record::<Q>(to),
        _ => Err("usage: record_commission f32|q FRAMES ANSWERS PAGE".into()),
    }
}

fn record<R: Real>(to: &[&str]) -> Result<(), Box<dyn Error>> {
    // What the plate and the data sheet do not say.
    let sheet = Inverter::preset_2k2();
    let inverter = Inverter { dead_time: 2.1e-6, c_out: 0.6e-9, u_th: 1.2, ..sheet };
    let mut plant = Plant::new(PlantParams::new(Machine::preset_2k2(), inverter))?;
    let mut control = begin::<R>()?;
    let full = f64::from(control.timer().full());
    let mut sample = plant.sample();
    let (mut frames, mut answers) = (Vec::new(), Vec::new());
    while control.commissioning().status() == Status::Running {
        let counts =
            Counts { i_abc: sample.i_abc.map(|i| left_aligned(i / 20.0)), u_dc: left_aligned(sample.u_dc / 810.0) };
        let command = control.period(&counts);
        frames.extend(Frame { counts, set_point: SetPoint::Stop }.to_bytes());
        answers.extend(answer(&control, &command));
        sample = plant.step(command.compare.map(|n| f64::from(n) / full), command.gates_on, 0.0);
    }
    if control.commissioning().status() != Status::Done {
        return Err(format!("{:?}", control.commissioning().status()).into());
    }
    let page: Vec<u8> = page(&control)?.words().iter().flat_map(|word| word.to_le_bytes()).collect();
    let (found, _) = control.found()?;
    println!(
        "R_s {} R_R {} L_sigma {} L_M {}",
        found.machine.R_s, found.machine.R_R, found.machine.L_sigma, found.machine.L_M
    );
    std::fs::write(to[0], &frames)?;
    std::fs::write(to[1], &answers)?;
    std::fs::write(to[2], &page)?;
    Ok(())
}
