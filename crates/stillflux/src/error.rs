//! Bad input: which parameter, what was given, what is admitted.

use core::fmt::{self, Write};

/// A parameter outside its admissible range: which, what was given, what is admitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParamError {
    /// Name of the field as the user writes it.
    pub field: &'static str,
    /// The value given.
    pub value: f64,
    /// Smallest admissible value; above [`Self::max`] where no value is admissible, and [`Self::note`] says what is
    /// missing.
    pub min: f64,
    /// Largest admissible value.
    pub max: f64,
    /// Unit of all three.
    pub unit: &'static str,
    /// What else explains the range; may be empty.
    pub note: &'static str,
}

impl ParamError {
    /// The error with an explanation.
    #[must_use]
    pub fn with_note(self, note: &'static str) -> Self {
        Self { note, ..self }
    }
}

/// Refuses a value that no range would admit; `note`: what it needs.
pub(crate) const fn refuse(field: &'static str, value: f64, unit: &'static str, note: &'static str) -> ParamError {
    ParamError { field, value, min: 1.0, max: 0.0, unit, note }
}

impl fmt::Display for ParamError {
    /// Numbers with six significant digits, whole ones with all. Limits are rounded into the range and a value away
    /// from it: a limit that is taken from the text is admissible, and no value reads as its limit.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, min, max, unit, note } = *self;
        let sep = if unit.is_empty() { "" } else { " " };
        if min > max {
            let value = SixDigits(value, Rounding::Nearest);
            write!(f, "{field} = {value}{sep}{unit} is not admissible")?;
        } else {
            let value = SixDigits(value, if value > max { Rounding::Up } else { Rounding::Down });
            let (min, max) = (SixDigits(min, Rounding::Up), SixDigits(max, Rounding::Down));
            write!(f, "{field} = {value}{sep}{unit} is outside the admissible range {min} to {max}{sep}{unit}")?;
        }
        if note.is_empty() { Ok(()) } else { write!(f, ": {note}") }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Rounding {
    Nearest,
    /// Towards the smaller number.
    Down,
    Up,
}

/// A number with at most six significant digits, without an allocation; whole numbers below 1e15 with all of theirs.
struct SixDigits(f64, Rounding);

impl fmt::Display for SixDigits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(x, rounding) = *self;
        if !x.is_finite() || (x.abs() < 1e15 && libm::trunc(x) == x) {
            return write!(f, "{x}");
        }
        // The digits that tell this number from all others, as a whole number, and the power of ten of the last of
        // them.
        let mut shortest = Decimal::default();
        write!(shortest, "{x:e}")?;
        let (mut digits, mut power) = (shortest.digits, shortest.power - shortest.fraction);
        let mut dropped = 1;
        while digits / dropped >= 1_000_000 {
            dropped *= 10;
            power += 1;
        }
        let rest = digits % dropped;
        let away = match rounding {
            Rounding::Nearest => 2 * rest >= dropped,
            Rounding::Down => x < 0.0 && rest > 0,
            Rounding::Up => x > 0.0 && rest > 0,
        };
        digits = digits / dropped + u64::from(away);
        while digits % 10 == 0 {
            digits /= 10;
            power += 1;
        }
        if x < 0.0 {
            f.write_char('-')?;
        }
        // Digits behind the point, and the power of ten written, if any.
        let behind = if (1e-6..1e15).contains(&x.abs()) { -power } else { digits.ilog10() as i32 };
        let exponent = power + behind;
        let one = 10_u64.pow(behind.unsigned_abs());
        if behind > 0 {
            write!(f, "{}.{:02$}", digits / one, digits % one, behind as usize)?;
        } else {
            write!(f, "{}", digits * one)?;
        }
        if exponent == 0 { Ok(()) } else { write!(f, "e{exponent}") }
    }
}

/// Reads what `{:e}` writes.
#[derive(Default)]
struct Decimal {
    /// All digits as one number, and how many of them are behind the point.
    digits: u64,
    fraction: i32,
    /// The number behind the `e`.
    power: i32,
    behind: Behind,
    negative: bool,
}

#[derive(Clone, Copy, Default, PartialEq)]
enum Behind {
    #[default]
    Start,
    Point,
    Exponent,
}

impl Write for Decimal {
    fn write_str(&mut self, s: &str) -> fmt::Result {
        for letter in s.bytes() {
            match (letter, self.behind) {
                (b'.', _) => self.behind = Behind::Point,
                (b'e', _) => self.behind = Behind::Exponent,
                (b'-', Behind::Exponent) => self.negative = true,
                (b'0'..=b'9', Behind::Exponent) => {
                    let digit = i32::from(letter - b'0');
                    self.power = 10 * self.power + if self.negative { -digit } else { digit };
                }
                (b'0'..=b'9', behind) => {
                    self.digits = 10 * self.digits + u64::from(letter - b'0');
                    self.fraction += i32::from(behind == Behind::Point);
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl core::error::Error for ParamError {}

/// Checks `min <= value <= max` (and with it that the value is finite).
#[inline(never)]
pub const fn check(field: &'static str, value: f64, min: f64, max: f64, unit: &'static str) -> Result<(), ParamError> {
    if value >= min && value <= max { Ok(()) } else { Err(ParamError { field, value, min, max, unit, note: "" }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn an_error_names_field_value_unit_and_range() {
        let error = check("R_s", -1.0, 1e-6, 1e3, "Ω").unwrap_err();
        assert_eq!(error.to_string(), "R_s = -1 Ω is outside the admissible range 0.000001 to 1000 Ω");
        assert!(check("R_s", f64::NAN, 1e-6, 1e3, "Ω").unwrap_err().to_string().starts_with("R_s = NaN Ω is outside"));
    }

    #[test]
    fn numbers_have_six_digits() {
        for (x, nearest, down, up) in [
            (7.348_469_228_349_534_5, "7.34847", "7.34846", "7.34847"),
            (-7.348_469_228_349_534_5, "-7.34847", "-7.34847", "-7.34846"),
            (0.1, "0.1", "0.1", "0.1"),
            (-2.1e-6, "-0.0000021", "-0.0000021", "-0.0000021"),
            (0.1 + 0.2, "0.3", "0.3", "0.300001"),
            (0.000_999_999_96, "0.001", "0.000999999", "0.001"),
            (1.234_567_8e-9, "1.23457e-9", "1.23456e-9", "1.23457e-9"),
            (5e-7, "5e-7", "5e-7", "5e-7"),
            (5e-324, "5e-324", "5e-324", "5e-324"),
            (999_999.5, "1000000", "999999", "1000000"),
            (12_345_678.5, "12345700", "12345600", "12345700"),
            (2_147_483_648.0, "2147483648", "2147483648", "2147483648"),
            (f64::MAX, "1.79769e308", "1.79769e308", "1.7977e308"),
            (f64::INFINITY, "inf", "inf", "inf"),
            (-0.0, "-0", "-0", "-0"),
        ] {
            for (rounding, text) in [(Rounding::Nearest, nearest), (Rounding::Down, down), (Rounding::Up, up)] {
                assert_eq!(SixDigits(x, rounding).to_string(), text);
            }
        }
    }

    #[test]
    fn a_limit_in_a_text_is_admissible_and_no_value_reads_as_its_limit() {
        let (min, max) = (7.0 / 3.0, 22.0 / 3.0);
        let text = |value: f64| check("i_max", value, min, max, "A").unwrap_err().to_string();
        assert_eq!(text(7.333_334), "i_max = 7.33334 A is outside the admissible range 2.33334 to 7.33333 A");
        assert_eq!(text(2.333_333), "i_max = 2.33333 A is outside the admissible range 2.33334 to 7.33333 A");
        assert!(
            text(2.333_333_1).starts_with("i_max = 2.33333 A") && text(7.333_333_9).starts_with("i_max = 7.33334 A")
        );
        for limit in [2.33334, 7.33333] {
            assert!(check("i_max", limit, min, max, "A").is_ok());
        }
    }

    #[test]
    fn an_error_without_a_range_says_what_the_value_needs() {
        let error = refuse("jerk", 3.0, "rad/s³", "it needs an acceleration");
        assert_eq!(error.to_string(), "jerk = 3 rad/s³ is not admissible: it needs an acceleration");
    }
}
