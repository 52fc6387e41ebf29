//! Phases of a start-up of the enhanced scheme, and the periods in them.
//!
//! ```text
//!         nothing known, no flux             at rest
//! Catch ------------------------->  Legs  -------------->  BuildUp ----> control
//!  ^ |                                |                     ^ |  ^ |
//!  | +--------------------------------|---------------------+ |  +-+ back to the first periods: a slow rotation was found;
//!  |        a flux, or nothing to compare                     |      to a quarter: another difference of the gains was
//!  +----------------------------------+-----------------------+
//!        turns: from its beginning          a flux may hide a rotation: waits
//! ```
//!
//! What each of them does is in [`super::start_up`].

/// A phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) enum Phase {
    /// A flux that the machine has is looked for.
    Catch,
    /// The legs of the bridge are compared.
    #[cfg(feature = "legs")]
    Legs,
    /// The speed is looked for, and the flux is built up.
    BuildUp,
}

/// Where a start-up is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Phases {
    phase: Phase,
    /// Its present period, counted from one; zero: it begins with the next one.
    period: u32,
    /// Last period of the catch, as far as it is known.
    catch_until: u32,
    /// The legs have been compared.
    #[cfg(feature = "legs")]
    compared: bool,
    /// The build-up has gone back after a difference of two current sensors was found.
    #[cfg(feature = "modes")]
    repeated: bool,
}

impl Phases {
    /// Before a start-up, with a catch of so many periods.
    pub const fn new(catch: u32) -> Self {
        Self {
            phase: Phase::Catch,
            period: 0,
            catch_until: catch,
            #[cfg(feature = "legs")]
            compared: false,
            #[cfg(feature = "modes")]
            repeated: false,
        }
    }

    /// The next period, with its number in its phase.
    #[inline(always)]
    pub fn advance(&mut self) -> (Phase, u32) {
        if self.phase == Phase::Catch && self.period == self.catch_until {
            (self.phase, self.period) = (Phase::BuildUp, 0);
        }
        self.period += 1;
        self.now()
    }

    /// The present period.
    #[inline(always)]
    pub fn now(&self) -> (Phase, u32) {
        (self.phase, self.period)
    }

    /// Whether this is the last period of the catch, as far as it is known.
    #[inline(always)]
    pub fn ends_catch(&self) -> bool {
        self.period == self.catch_until
    }

    /// The catch takes so many periods more.
    pub fn extend_catch(&mut self, periods: u32) {
        self.catch_until += periods;
    }

    /// The catch takes so many periods in all.
    pub fn catch_until(&mut self, period: u32) {
        self.catch_until = period;
    }

    /// After the catch the legs are compared, once in a start-up.
    #[cfg(feature = "legs")]
    pub fn compare_legs(&mut self) {
        if !self.compared {
            (self.phase, self.period, self.compared) = (Phase::Legs, 0, true);
        }
    }

    /// Whether the legs have been compared.
    #[cfg(feature = "legs")]
    pub fn have_compared(&self) -> bool {
        self.compared
    }

    /// The start-up begins anew, with a catch of so many periods.
    #[cfg(feature = "legs")]
    pub fn begin_anew(&mut self, catch: u32) {
        (self.phase, self.period, self.catch_until) = (Phase::Catch, 0, catch);
    }

    /// From the build-up back to the end of the catch, for so many periods without current.
    #[cfg(feature = "legs")]
    pub fn wait(&mut self, periods: u32) {
        (self.phase, self.period) = (Phase::Catch, self.catch_until);
        self.catch_until += periods;
    }

    /// The build-up begins, or goes back, after so many of its periods.
    #[cfg(any(feature = "legs", feature = "restart", feature = "modes"))]
    pub fn build_up_after(&mut self, periods: u32) {
        (self.phase, self.period) = (Phase::BuildUp, periods);
    }

    /// The same, once in a start-up.
    #[cfg(feature = "modes")]
    pub fn repeat_after(&mut self, periods: u32) {
        self.build_up_after(periods);
        self.repeated = true;
    }

    /// Whether the build-up has gone back.
    #[cfg(feature = "modes")]
    pub fn has_repeated(&self) -> bool {
        self.repeated
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The last of the next so many periods.
    fn next(phases: &mut Phases, periods: u32) -> (Phase, u32) {
        (0..periods).fold(phases.now(), |_, _| phases.advance())
    }

    #[test]
    fn the_build_up_follows_a_catch_that_takes_as_long_as_it_has_to() {
        let mut phases = Phases::new(8);
        assert_eq!(next(&mut phases, 1), (Phase::Catch, 1));
        assert_eq!(next(&mut phases, 7), (Phase::Catch, 8));
        assert!(phases.ends_catch());
        phases.extend_catch(2);
        assert_eq!(next(&mut phases, 2), (Phase::Catch, 10));
        assert_eq!(next(&mut phases, 1), (Phase::BuildUp, 1));
        assert_eq!(next(&mut phases, 4), (Phase::BuildUp, 5));
    }

    #[cfg(feature = "legs")]
    #[test]
    fn the_legs_are_compared_once_and_a_machine_that_turns_is_caught_anew() {
        let mut phases = Phases::new(8);
        next(&mut phases, 8);
        phases.compare_legs();
        assert_eq!(next(&mut phases, 3), (Phase::Legs, 3));
        phases.begin_anew(8);
        assert_eq!(next(&mut phases, 8), (Phase::Catch, 8));
        phases.compare_legs();
        assert_eq!(next(&mut phases, 1), (Phase::BuildUp, 1));
        phases.wait(4);
        assert_eq!(next(&mut phases, 4), (Phase::Catch, 12));
        assert!(phases.ends_catch());
        assert_eq!(next(&mut phases, 1), (Phase::BuildUp, 1));
    }

    #[cfg(feature = "modes")]
    #[test]
    fn the_build_up_is_repeated_from_where_it_goes_back_to() {
        let mut phases = Phases::new(1);
        assert_eq!(next(&mut phases, 9), (Phase::BuildUp, 8));
        phases.repeat_after(2);
        assert!(phases.has_repeated());
        assert_eq!(next(&mut phases, 1), (Phase::BuildUp, 3));
    }
}
