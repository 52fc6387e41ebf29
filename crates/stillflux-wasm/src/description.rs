//! What a page has to know beforehand, as JSON: installations with the ranges of their settings, and signals in the order
//! of the columns.
//!
//! ```text
//! {"installations": [{"name", "T_N", "I_N", "U_N", "f_N", "n_p", "f_s", "r_d", "rated_speed",
//!                     "settings": [{"name", "unit", "min", "max", "default"}]}],
//!  "signals": [{"name", "unit", "complex"}]}
//! ```
//!
//! Values are SI; `complex`: real and imaginary part in turn.

use stillflux_sim::simulate::ScenarioError;

use crate::session::{Choice, Installation, Range, Session, Setting};

/// The description.
///
/// # Errors
/// A parameter of an installation outside its range.
pub fn json() -> Result<String, ScenarioError> {
    let installations = Installation::all();
    let record = Session::new(Choice::of(installations[0]))?.advance(0);
    let signals = record.columns.iter().map(|column| {
        format!(r#"{{"name": "{}", "unit": "{}", "complex": {}}}"#, column.name, column.unit, column.complex)
    });
    let installations = list(installations.iter().map(installation));
    Ok(format!(r#"{{"installations": {installations}, "signals": {}}}"#, list(signals)))
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}

fn installation(of: &Installation) -> String {
    let (m, inverter) = (&of.machine, &of.inverter);
    let numbers = [
        ("T_N", m.T_N),
        ("I_N", m.I_N),
        ("U_N", m.U_N),
        ("f_N", m.f_N),
        ("n_p", f64::from(m.n_p)),
        ("f_s", inverter.f_s),
        ("r_d", inverter.r_d),
        ("rated_speed", of.rated_speed()),
    ];
    let numbers: String = numbers.iter().map(|(name, x)| format!(r#""{name}": {x:e}, "#)).collect();
    let settings = list(Setting::ALL.iter().map(|setting| {
        let ((name, unit), Range { min, max, default }) = (setting.name(), setting.range(of));
        format!(r#"{{"name": "{name}", "unit": "{unit}", "min": {min:e}, "max": {max:e}, "default": {default:e}}}"#)
    }));
    format!(r#"{{"name": "{}", {numbers}"settings": {settings}}}"#, of.name)
}
