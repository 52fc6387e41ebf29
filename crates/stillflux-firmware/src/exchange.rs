//! Format of the processor-in-the-loop exchange: little-endian words, the same source on host and target.
//!
//! To the target, 16 bytes a period: four converter readings, kind of the set point, its value (`f32`, SI). Back,
//! 17 words a period: duties, compare values, state, and the main estimates as the arithmetic holds them.

use stillflux::counts::Counts;
use stillflux::drive::Status;
use stillflux::interrupt::{Command, CountsDrive};
use stillflux::scalar::{Q, Real};
use stillflux::telemetry::SetPoint;

/// Bytes of a frame to the target.
pub const FRAME: usize = 16;
/// Bytes of an answer.
pub const ANSWER: usize = 68;

/// An arithmetic whose values are one machine word.
pub trait Word: Real {
    /// The representation.
    fn to_word(self) -> u32;
}

impl Word for f32 {
    fn to_word(self) -> u32 {
        self.to_bits()
    }
}

impl Word for Q {
    fn to_word(self) -> u32 {
        self.to_bits() as u32
    }
}

/// One period's input.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Readings.
    pub counts: Counts,
    /// Set point.
    pub set_point: SetPoint,
}

impl Frame {
    /// As it travels.
    pub fn to_bytes(self) -> [u8; FRAME] {
        let (kind, value) = match self.set_point {
            SetPoint::Stop => (0_u32, 0.0),
            SetPoint::Speed(x) => (1, x),
            SetPoint::Torque(x) => (2, x),
        };
        let [a, b, c] = self.counts.i_abc.map(i16::to_le_bytes);
        let u = self.counts.u_dc.to_le_bytes();
        let (k, v) = (kind.to_le_bytes(), value.to_le_bytes());
        #[rustfmt::skip]
        let bytes = [
            a[0], a[1], b[0], b[1], c[0], c[1], u[0], u[1],
            k[0], k[1], k[2], k[3], v[0], v[1], v[2], v[3],
        ];
        bytes
    }

    /// As it arrives; an unknown kind is a stop.
    pub fn from_bytes(b: &[u8; FRAME]) -> Self {
        let half = |k: usize| i16::from_le_bytes([b[k], b[k + 1]]);
        let value = f32::from_le_bytes([b[12], b[13], b[14], b[15]]);
        let set_point = match b[8] {
            1 => SetPoint::Speed(value),
            2 => SetPoint::Torque(value),
            _ => SetPoint::Stop,
        };
        Self { counts: Counts { i_abc: [half(0), half(2), half(4)], u_dc: half(6) }, set_point }
    }
}

/// What a period gave, as it travels; zeros without a drive.
pub fn answer<R: Word>(control: &CountsDrive<R>, command: &Command) -> [u8; ANSWER] {
    let Some(drive) = control.drive() else { return [0; ANSWER] };
    let (e, status) = (drive.estimate(), drive.status());
    let fault = match status {
        Status::Faulted { cause, .. } => cause.code(),
        _ => 0,
    };
    let words = [
        command.compare[0],
        command.compare[1],
        command.compare[2],
        status.code() | fault << 8 | u32::from(command.gates_on) << 31,
        e.flux.psi_s.re().to_word(),
        e.flux.psi_s.im().to_word(),
        e.speed.omega_m.to_word(),
        e.speed.omega_s.to_word(),
        e.torque.to_word(),
        e.u_off.re().to_word(),
        e.u_off.im().to_word(),
        e.r_s.to_word(),
        e.i_dq_ref.re().to_word(),
        e.i_dq_ref.im().to_word(),
        e.epsilon.to_word(),
        e.innovation.to_word(),
        e.confidence.to_word(),
    ];
    let mut bytes = [0; ANSWER];
    for (to, word) in bytes.chunks_exact_mut(4).zip(words) {
        to.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}
