//! What separates an event from rounding.

/// Tolerances below which a violated condition is rounding, not an event.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tolerance {
    pub(super) current: f64,
    pub(super) voltage: f64,
    pub(super) speed: f64,
    pub(super) torque: f64,
    pub(super) time: f64,
    /// A current below this is looked at for a zero inside the segment that its end does not show.
    pub(super) near: f64,
}
