//! A single shunt in the dc link with its amplifier.
//!
//! The link carries the currents of the legs at the upper rail, a leg between the rails half of its own to each of them
//! (its capacitance lies against both). The amplifier follows with a time constant `τ`; in a segment of length `h` in which
//! the current goes from `x_0` to `x_1`, with the slope `s`,
//!
//! ```text
//! y_1 = x_1 - s τ + (y_0 - x_0 + s τ) e^(-h/τ)
//! ```

use crate::bridge::Bridge;
use stillflux::params::{ParamError, check};

/// A shunt in the dc link in place of the sensors in the phases. Its offset, gain and noise are those of channel a
/// ([`crate::Adc`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shunt {
    /// Time constant of the amplifier, s; 0: none.
    pub settling: f64,
}

impl Shunt {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("shunt", self.settling, 0.0, 1e-4, "s")
    }
}

/// State of the shunt's amplifier, and what it showed at the instants of the present period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Amplifier {
    tau: f64,
    pub y: f64,
    pub instants: [f64; 2],
    pub seen: [f64; 2],
}

impl Amplifier {
    pub fn new(shunt: Shunt) -> Self {
        Self { tau: shunt.settling, y: 0.0, instants: [f64::INFINITY; 2], seen: [0.0; 2] }
    }

    /// Parts of the legs' currents that the link carries.
    pub fn parts(bridge: &Bridge) -> [f64; 3] {
        [0, 1, 2].map(|k| match bridge.sign[k] {
            s if s > 0.0 => f64::from(bridge.legs[k].gate & 1),
            s if s < 0.0 => f64::from(bridge.legs[k].gate >> 1),
            _ => 0.5,
        })
    }

    /// A segment in which the phase currents went from `from` to `to`.
    pub fn advance(&mut self, parts: &[f64; 3], from: [f64; 3], to: [f64; 3], h: f64) {
        let link = |i: [f64; 3]| parts[0] * i[0] + parts[1] * i[1] + parts[2] * i[2];
        let (x_0, x_1) = (link(from), link(to));
        self.y = if self.tau > 0.0 && h > 0.0 {
            let lag = (x_1 - x_0) / h * self.tau;
            x_1 - lag + (self.y - x_0 + lag) * libm::exp(-h / self.tau)
        } else if self.tau > 0.0 {
            self.y
        } else {
            x_1
        };
    }
}
