//! Steps of a start-up of the enhanced scheme, and the periods in them.
//!
//! | from | to | where |
//! |---|---|---|
//! | `Catch` | `Legs` | nothing is known of the machine, and no flux was found; once in a start-up |
//! | `Catch` | `BuildUp` | else |
//! | `Legs` | `BuildUp` | the machine is at rest |
//! | `Legs` | `Catch`, from its beginning | it turns |
//! | `BuildUp` | `Catch`, at its end | what is left of a flux may hide a rotation: waits until that has decayed |
//! | `BuildUp` | `BuildUp`, its first periods | a slow rotation was found |
//! | `BuildUp` | `BuildUp`, a quarter of it | a difference of the gains of two current sensors was found; once in a start-up |
//! | `BuildUp` | control | the flux is built up |
//!
//! What each of them does is in [`super::start_up`].

/// A step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) enum Step {
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
pub(super) struct Progress {
    step: Step,
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

impl Progress {
    /// Before a start-up, with a catch of so many periods.
    pub const fn new(catch: u32) -> Self {
        Self {
            step: Step::Catch,
            period: 0,
            catch_until: catch,
            #[cfg(feature = "legs")]
            compared: false,
            #[cfg(feature = "modes")]
            repeated: false,
        }
    }

    /// The next period, with its number in its step.
    #[inline(always)]
    pub fn advance(&mut self) -> (Step, u32) {
        if self.step == Step::Catch && self.period == self.catch_until {
            (self.step, self.period) = (Step::BuildUp, 0);
        }
        self.period += 1;
        self.now()
    }

    /// The present period.
    #[inline(always)]
    pub fn now(&self) -> (Step, u32) {
        (self.step, self.period)
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
            (self.step, self.period, self.compared) = (Step::Legs, 0, true);
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
        (self.step, self.period, self.catch_until) = (Step::Catch, 0, catch);
    }

    /// From the build-up back to the end of the catch, for so many periods without current.
    #[cfg(feature = "legs")]
    pub fn wait(&mut self, periods: u32) {
        (self.step, self.period) = (Step::Catch, self.catch_until);
        self.catch_until += periods;
    }

    /// The build-up begins, or goes back, after so many of its periods.
    #[cfg(any(feature = "legs", feature = "restart", feature = "modes"))]
    pub fn build_up_after(&mut self, periods: u32) {
        (self.step, self.period) = (Step::BuildUp, periods);
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
    fn next(progress: &mut Progress, periods: u32) -> (Step, u32) {
        (0..periods).fold(progress.now(), |_, _| progress.advance())
    }

    #[test]
    fn the_build_up_follows_a_catch_that_takes_as_long_as_it_has_to() {
        let mut progress = Progress::new(8);
        assert_eq!(next(&mut progress, 1), (Step::Catch, 1));
        assert_eq!(next(&mut progress, 7), (Step::Catch, 8));
        assert!(progress.ends_catch());
        progress.extend_catch(2);
        assert_eq!(next(&mut progress, 2), (Step::Catch, 10));
        assert_eq!(next(&mut progress, 1), (Step::BuildUp, 1));
        assert_eq!(next(&mut progress, 4), (Step::BuildUp, 5));
    }

    #[cfg(feature = "legs")]
    #[test]
    fn the_legs_are_compared_once_and_a_machine_that_turns_is_caught_anew() {
        let mut progress = Progress::new(8);
        next(&mut progress, 8);
        progress.compare_legs();
        assert_eq!(next(&mut progress, 3), (Step::Legs, 3));
        progress.begin_anew(8);
        assert_eq!(next(&mut progress, 8), (Step::Catch, 8));
        progress.compare_legs();
        assert_eq!(next(&mut progress, 1), (Step::BuildUp, 1));
        progress.wait(4);
        assert_eq!(next(&mut progress, 4), (Step::Catch, 12));
        assert!(progress.ends_catch());
        assert_eq!(next(&mut progress, 1), (Step::BuildUp, 1));
    }

    #[cfg(feature = "modes")]
    #[test]
    fn the_build_up_is_repeated_from_where_it_goes_back_to() {
        let mut progress = Progress::new(1);
        assert_eq!(next(&mut progress, 9), (Step::BuildUp, 8));
        progress.repeat_after(2);
        assert!(progress.has_repeated());
        assert_eq!(next(&mut progress, 1), (Step::BuildUp, 3));
    }
}
