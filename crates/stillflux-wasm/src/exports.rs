//! The functions of the WebAssembly module: one [`Session`] at a time, numbers in, numbers out.
//!
//! A function that has something to say returns the length of a text in bytes, UTF-8, which then lies at
//! [`playground_text`]; zero: nothing to say. The texts are errors, except that of [`playground_describe`] and
//! [`playground_fault`]. Pointers are valid until the next call of any function.

use std::sync::{Mutex, MutexGuard, PoisonError};

use stillflux::config::Scheme;
use stillflux_sim::simulate::Record;

use crate::description;
use crate::session::{Choice, Installation, Session, Setting};

struct State {
    session: Option<Session>,
    columns: Vec<f64>,
    text: String,
}

static STATE: Mutex<State> = Mutex::new(State { session: None, columns: Vec::new(), text: String::new() });

fn state() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

impl State {
    fn say(&mut self, text: impl Into<String>) -> usize {
        self.text = text.into();
        self.text.len()
    }

    fn outcome<E: ToString>(&mut self, result: Result<(), E>) -> usize {
        self.say(result.err().map_or(String::new(), |e| e.to_string()))
    }
}

/// Describes installations and signals: the length of the text of [`description::json`].
#[unsafe(no_mangle)]
pub extern "C" fn playground_describe() -> usize {
    state().say(description::json().unwrap_or_else(|e| e.to_string()))
}

/// Starts anew: `installation` by its position in the description, `scheme` 0 published, 1 enhanced, `offset_estimator`
/// 0 or 1, `seed` of the measurement noise, `record_every` so many control periods.
#[unsafe(no_mangle)]
pub extern "C" fn playground_start(
    installation: u32,
    scheme: u32,
    offset_estimator: u32,
    seed: u32,
    record_every: u32,
) -> usize {
    let mut state = state();
    state.session = None;
    let Some(installation) = Installation::all().get(installation as usize).copied() else {
        return state.say("no such installation");
    };
    let choice = Choice {
        scheme: if scheme == 0 { Scheme::Paper } else { Scheme::Enhanced },
        offset_estimator: offset_estimator != 0,
        seed: u64::from(seed),
        record_every,
        ..Choice::of(installation)
    };
    let session = Session::new(choice).map(|session| state.session = Some(session));
    state.outcome(session)
}

/// Sets one thing, by its position in the description, to a value in SI units.
#[unsafe(no_mangle)]
pub extern "C" fn playground_set(setting: u32, value: f64) -> usize {
    let mut state = state();
    let Some(setting) = Setting::ALL.get(setting as usize) else {
        return state.say("no such setting");
    };
    let Some(session) = &mut state.session else {
        return state.say("not started");
    };
    let result = session.set(*setting, value);
    state.outcome(result)
}

/// Runs so many control periods and returns how many rows these have recorded: at [`playground_columns`] the times in s
/// of all rows, then the first signal of all rows, and so on.
#[unsafe(no_mangle)]
pub extern "C" fn playground_run(periods: u32) -> usize {
    let state = &mut *state();
    let record = state.session.as_mut().map_or_else(Record::default, |session| session.advance(periods));
    state.columns.clear();
    state.columns.extend_from_slice(&record.t);
    for column in &record.columns {
        state.columns.extend_from_slice(&column.data);
    }
    record.t.len()
}

/// Why the run has ended or the drive has stopped.
#[unsafe(no_mangle)]
pub extern "C" fn playground_fault() -> usize {
    let mut state = state();
    let fault = state.session.as_ref().map_or("", Session::fault);
    state.say(fault)
}

/// Address of the text.
#[unsafe(no_mangle)]
pub extern "C" fn playground_text() -> *const u8 {
    state().text.as_ptr()
}

/// Address of the columns.
#[unsafe(no_mangle)]
pub extern "C" fn playground_columns() -> *const f64 {
    state().columns.as_ptr()
}

/// What lies at [`playground_columns`], for a caller on the host.
#[must_use]
pub fn columns() -> Vec<f64> {
    state().columns.clone()
}

/// What lies at [`playground_text`], for a caller on the host.
#[must_use]
pub fn text() -> String {
    state().text.clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One test: the module has one session.
    #[test]
    fn a_page_can_start_set_and_run() {
        assert_eq!(playground_run(100), 0, "not started");
        assert!(playground_set(0, 1.0) > 0 && text() == "not started");
        let length = playground_describe();
        assert_eq!(length, text().len());
        assert!(text().contains(r#""name": "dead_time", "unit": "s", "min": 0e0, "max": 5e-6, "default": 2e-6"#));
        assert!(text().contains(r#"{"name": "psi_s", "unit": "V s", "complex": true}"#));
        assert_eq!(playground_start(0, 1, 1, 1, 20), 0);
        assert_eq!(playground_set(0, 1.0), 0);
        assert!(playground_set(0, 1e3) > 0 && text().contains("speed = 1000 rad/s is outside"));
        assert!(playground_set(99, 1.0) > 0 && playground_start(9, 1, 1, 1, 20) > 0);
        assert_eq!(playground_start(1, 0, 1, 1, 20), 0);
        assert_eq!(playground_run(200), 10);
        assert_eq!(columns().len() % 10, 0);
        assert_eq!(columns()[1], 0.002);
        assert_eq!(playground_fault(), 0);
    }
}
