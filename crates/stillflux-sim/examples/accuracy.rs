//! Field angle and speed error of each arithmetic over a minute at zero stator frequency in the published scheme, as
//! one line of JSON.
//!
//! Each drive runs on its own plant (switching model, current offsets, 12-bit converters) and is judged by
//! that plant's truth: nothing ties the absolute angle of a field at standstill, so the three paths part.
//!
//! The bridge is the one of the paper's figures, whose nodes have no capacitance, and there is no noise: the angle keeps
//! within 0.1°, so that a difference between arithmetics shows. With the 1 nF of the preset the legs' edges at current
//! zero leave a voltage that the offset estimator found at 1 Hz and that is another one at rest: 6.6° rms and 7.8° at the
//! end of the minute, in each arithmetic.

use std::borrow::Cow;
use std::error::Error;

use stillflux::base::Base;
use stillflux::config::Scheme;
use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine};
use stillflux::si::Arithmetic;
use stillflux_sim::simulate::{Profile, ReferenceProfile, Run, Scenario};

/// The minute that counts, s.
const FROM: f64 = 19.0;
const TO: f64 = 79.0;

fn main() -> Result<(), Box<dyn Error>> {
    let results = [("f64", Arithmetic::F64), ("f32", Arithmetic::F32), ("q", Arithmetic::Q)]
        .map(|(name, arithmetic)| run(arithmetic).map(|r| (name, r)));
    let mut fields = Vec::new();
    for result in results {
        let (name, (angle_rms, angle_worst, speed_rms)) = result?;
        fields.push(format!(
            "\"{name}\": {{\"angle_rms_deg\": {angle_rms:.4}, \"angle_worst_deg\": {angle_worst:.4}, \
             \"speed_rms_pu\": {speed_rms:.3e}}}"
        ));
    }
    println!("{{{}}}", fields.join(", "));
    Ok(())
}

/// rms and worst angle error in degrees, rms speed error (estimate against truth) per unit.
fn run(arithmetic: Arithmetic) -> Result<(f64, f64, f64), Box<dyn Error>> {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter { c_out: 0.0, ..Inverter::preset_2k2() });
    let base = Base::new(&machine);
    let mut s = Scenario::new(machine, inverter, TO);
    s.arithmetic = arithmetic;
    s.drive.scheme = Scheme::Paper;
    s.drive.calibrate_offset = false;
    let i = 0.00625 * base.i;
    s.plant.adc.offset = [i, 0.366 * i, -1.366 * i];
    // Low speed, where the offset voltage is found; then rest, with no load: stator frequency zero.
    let profile = [(0.0, 0.0), (1.6, 0.0), (1.8, 0.02), (17.0, 0.02), (18.0, 0.0)];
    s.reference = ReferenceProfile::Speed(Profile::new(profile.iter().map(|&(t, w)| (t, w * base.omega_m)).collect())?);
    s.signals = Some(["angle_error", "omega_m", "estimate.omega_m"].map(String::from).to_vec());
    let mut run = Run::new(Cow::Owned(s))?;
    while run.advance(u64::MAX) {}
    let (record, drive) = run.into_parts();
    if drive.status() != Status::Running {
        return Err(format!("{arithmetic:?}: {:?}", drive.status()).into());
    }
    let from = record.t.partition_point(|&t| t < FROM);
    let [angle, truth, estimate] = [0, 1, 2].map(|k| &record.columns[k].data[from..]);
    let rms = |x: &mut dyn Iterator<Item = f64>| (x.map(|e| e * e).sum::<f64>() / angle.len() as f64).sqrt();
    let angle_rms = rms(&mut angle.iter().copied()).to_degrees();
    let worst = angle.iter().fold(0.0_f64, |m, e| m.max(e.abs())).to_degrees();
    let speed = rms(&mut truth.iter().zip(estimate).map(|(a, b)| (a - b) / base.omega_m));
    Ok((angle_rms, worst, speed))
}
