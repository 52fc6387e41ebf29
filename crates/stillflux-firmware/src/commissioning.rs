//! Commissioning of the processor in the loop: nameplate and data sheet of the motor on the bench, and the format of
//! what comes back, the same source on host and target.
//!
//! To the target travel the frames of [`crate::exchange`], of which only the readings count. Back, 4 words a period:
//! compare values and state. At the end the parameter page with what was found ([`stillflux::page`]).

use stillflux::commission::{Nameplate, Stage, Status};
use stillflux::interrupt::{Command, CountsCommissioning};
use stillflux::page::Page;
use stillflux::params::{Inverter, Machine, ParamError};
use stillflux::scalar::Real;

/// Bytes of an answer.
pub const ANSWER: usize = 16;

/// The 2.2-kW machine: its plate is that of its parameters.
///
/// # Errors
/// None: the preset is a machine.
pub fn plate() -> Result<Nameplate, ParamError> {
    Nameplate::of(&Machine::preset_2k2())
}

/// A commissioning of it, with 12-bit channels.
///
/// # Errors
/// None: plate and data sheet are within their ranges.
pub fn begin<R: Real>() -> Result<CountsCommissioning<R>, ParamError> {
    CountsCommissioning::new(&plate()?, &Inverter::preset_2k2(), (20.0, 810.0))
}

/// What a period gave, as it travels.
pub fn answer<R: Real>(control: &CountsCommissioning<R>, command: &Command) -> [u8; ANSWER] {
    let c = control.commissioning();
    let status = match c.status() {
        Status::Running => 0,
        Status::Done => 1,
        Status::Faulted { cause, .. } => 2 | cause.code() << 8,
    };
    let stage = match c.stage() {
        Stage::Wiring => 0,
        Stage::Legs => 1,
        Stage::Bridge => 2,
        Stage::Leakage => 3,
        Stage::Magnetising => 4,
        Stage::Complete => 5,
    };
    let [a, b, e] = command.compare;
    let words = [a, b, e, status | stage << 16 | u32::from(command.gates_on) << 31];
    let mut bytes = [0; ANSWER];
    for (to, word) in bytes.chunks_exact_mut(4).zip(words) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// The parameter page with what was found.
///
/// # Errors
/// A value found that no drive accepts.
pub fn page<R: Real>(control: &CountsCommissioning<R>) -> Result<Page, ParamError> {
    control.found().map(|(_, ready)| Page::seal(&ready))
}
