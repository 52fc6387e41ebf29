//! An incremental encoder on the shaft and the quadrature counter behind it, with what fails in them.
//!
//! ```text
//! q = floor(4 lines θ/2π)        quarter of a line;    A = 1 for q mod 4 in {1, 2},   B = 1 for q mod 4 in {2, 3}
//! ```
//!
//! The counter counts every edge, up where A leads B: healthy, it advances by the change of `q`. A channel that is lost
//! stands: the edges of the other one count up and down in turn, and the content swings by one count.

use stillflux::params::{ParamError, check};

/// An incremental encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoder {
    /// Lines a turn.
    pub lines: u32,
}

impl Encoder {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("plant encoder_lines", f64::from(self.lines), 1.0, 1e6, "")
    }
}

/// What fails in an encoder or on the way to its counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncoderFault {
    /// No edges: supply or both channels are lost.
    Broken,
    /// Channel B is lost.
    Channel,
    /// The channels are exchanged: the counter counts backwards.
    Swapped,
    /// The counter is not read.
    Silent,
}

/// State of the counter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Counter {
    per_radian: f64,
    quarter: i64,
    count: i64,
    pub fault: Option<EncoderFault>,
}

/// Quarter of a line at so many of them.
#[allow(clippy::cast_possible_truncation)]
fn floor(x: f64) -> i64 {
    let towards_zero = x as i64;
    if towards_zero as f64 > x { towards_zero - 1 } else { towards_zero }
}

/// Level of channel A in a quarter.
fn level(quarter: i64) -> i64 {
    i64::from((quarter + 1) & 2 != 0)
}

impl Counter {
    pub fn new(encoder: Encoder) -> Self {
        let per_radian = 4.0 * f64::from(encoder.lines) / std::f64::consts::TAU;
        Self { per_radian, quarter: 0, count: 0, fault: None }
    }

    /// The shaft has come to `theta`, mechanical rad.
    pub fn advance(&mut self, theta: f64) {
        let quarter = floor(theta * self.per_radian);
        let turned = quarter - self.quarter;
        self.count += match self.fault {
            None | Some(EncoderFault::Silent) => turned,
            Some(EncoderFault::Swapped) => -turned,
            Some(EncoderFault::Channel) => level(quarter) - level(self.quarter),
            Some(EncoderFault::Broken) => 0,
        };
        self.quarter = quarter;
    }

    /// What is read.
    pub fn content(&self) -> Option<i64> {
        (self.fault != Some(EncoderFault::Silent)).then_some(self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Contents over a turn forward and back, 7 instants a line.
    fn contents(fault: Option<EncoderFault>) -> Vec<i64> {
        let mut counter = Counter { fault, ..Counter::new(Encoder { lines: 100 }) };
        let steps: Vec<i32> = (0..=700).chain((-700..700).rev()).collect();
        let angle = |k: i32| f64::from(k) * std::f64::consts::TAU / 700.0 + 1e-6;
        let read = |k| {
            counter.advance(angle(k));
            counter.content().unwrap_or(i64::MAX)
        };
        steps.into_iter().map(read).collect()
    }

    #[test]
    fn counts_four_edges_a_line_in_both_directions() {
        let counts = contents(None);
        assert_eq!((counts[0], counts[700], *counts.last().unwrap()), (0, 400, -400));
        assert!(counts.windows(2).all(|w| (w[1] - w[0]).abs() <= 1), "no edge is lost");
    }

    #[test]
    fn each_fault_counts_as_its_wires_do() {
        assert!(contents(Some(EncoderFault::Broken)).iter().all(|n| *n == 0));
        assert!(contents(Some(EncoderFault::Silent)).iter().all(|n| *n == i64::MAX));
        let (good, swapped) = (contents(None), contents(Some(EncoderFault::Swapped)));
        assert!(good.iter().zip(swapped).all(|(a, b)| *a == -b));
        let lost = contents(Some(EncoderFault::Channel));
        assert!(lost.iter().all(|n| *n == 0 || *n == 1) && lost.contains(&1));
    }
}
