//! A converter as the recorded loops have it.

/// A 12-bit reading, left-aligned in 16 bits.
#[allow(clippy::cast_possible_truncation)]
pub fn left_aligned(part: f64) -> i16 {
    let n = (part * 2048.0).round().clamp(-2048.0, 2047.0);
    (n as i16) * 16
}
