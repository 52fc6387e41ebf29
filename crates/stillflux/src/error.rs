//! Bad input: which parameter, what was given, what is admitted.

use core::fmt;

/// A parameter outside its admissible range: which, what was given, what is admitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParamError {
    /// Name of the field as the user writes it.
    pub field: &'static str,
    /// The value given.
    pub value: f64,
    /// Smallest admissible value; above [`Self::max`] where no value is admissible, and [`Self::note`] says what is missing.
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
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, min, max, unit, note } = self;
        let sep = if unit.is_empty() { "" } else { " " };
        if min > max {
            write!(f, "{field} = {value}{sep}{unit} is not admissible")?;
        } else {
            write!(f, "{field} = {value}{sep}{unit} is outside the admissible range {min} to {max}{sep}{unit}")?;
        }
        if note.is_empty() { Ok(()) } else { write!(f, ": {note}") }
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
        assert!(check("R_s", f64::NAN, 1e-6, 1e3, "Ω").is_err());
    }

    #[test]
    fn an_error_without_a_range_says_what_the_value_needs() {
        let error = refuse("jerk", 3.0, "rad/s³", "it needs an acceleration");
        assert_eq!(error.to_string(), "jerk = 3 rad/s³ is not admissible: it needs an acceleration");
    }
}
