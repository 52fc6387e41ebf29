//! Current control and phases: the current follows its reference, and every phase carries its share. Per unit.
//!
//! ```text
//! |i* - i|² > 0.2² |i*|² + 0.05²         violated
//! Σ|i_x| < 0.15 Σ|i_x*|                  phase x is open; sums over the violated calls
//! |i* - i|² > 0.06² |i*|² + 0.02²        with (i_x* - i_x)² > |i* - i|²/4, also with i_x* low-passed in field coordinates
//!                                        and with the same sign, and |ω̂_s| > 0.03, for 4 ms and 0.1 rad of ω̂_s τ, which
//!                                        counts half where |i_x* - i_x| < 0.15 |i*|,
//!                                        and in every call from the first to the last of them |i_x| < 0.03 |i|:
//!                                        phase x is open
//! ```
//!
//! An open phase confines the current vector to a line. A rotating reference leaves that line in every turn, and the
//! sums over the violated calls tell the phase; a direct current deviates unless the phase happens to carry none. At
//! low frequency the estimated field may follow the current that is left, and the reference with it: then a phase whose
//! current stays at its zero under a small deviation, although the field turns, is open: a healthy one has passed the
//! zero after 2 · 0.03 rad. What such a phase lacks lies along its axis: a deviation along the line of the other two is
//! none of it, as while a speed controller takes the torque current back as fast as the field turns, and the dead time
//! holds at zero a phase that is to carry next to nothing (the published scheme before its first offset). Nor is a
//! deviation by which the current is where its reference was lately, the reference's low-pass with the time constant `3/ω_c` (`ω_c`: bandwidth of current control, whose lag behind a
//! ramp was 2.7/`ω_c`): it follows one that
//! moves, after a load that is taken away, or, at 4 kHz, while a torque reverses at the end of a fast change of the speed. Not while a violation is remembered: after a step of the reference the current comes up to it from beside, by as much as the
//! field turns, and a healthy phase may stay at its zero for some ms. The longest stay that was seen beside
//! these is 14 ms: while a load reversed the
//! reference turned back in the field as fast as that turned, and a long dead time (3.5 µs at 4 kHz) held the current of the phase at
//! zero, a tenth of the current vector short of its reference. Up to 0.15 the turned angle therefore counts half.
//!
//! An open phase is a fault after 4 ms at the zero of its current, or after 4 ms and 24 periods of violation (leaky, [`super::leaky`]). Both
//! times grow up to `11/ω_c` with the tracking error of current control under a load that reverses (`Conversion::tracking_error`): a small
//! machine is accelerated faster than a slow control follows, and a healthy phase stays at its zero meanwhile. Under control any deviation is a fault after
//! 0.25 s (leaky): channels that are swapped or inverted, or a voltage that does not suffice. In a start-up the direction of the current may be searched for.
//!
//! In a start-up nothing but a phase that is open keeps a direct current off its reference, however small it is (0.13
//! pu in the comparison of the legs of a machine with a small magnetising current): there the deviation that is
//! admissible, and the reference with which a phase counts, shrink with the reference,
//!
//! ```text
//! |i* - i|² > (0.2² + 0.15²) |i*|²,      |i_x*| > 0.4 |i*|
//! ```
//!
//! as far as they are below the values above, and from 0.05 on: at no current there is no phase to carry it. Along the
//! axis of a phase the other two carry half of the current each, and the line of a phase that is open is 30° or 90°
//! away: the deviation is at least half of the reference.
//!
//! A reference of the start-up that steps to a larger one begins the count anew: deviations from a small one, or from zero while
//! the flux of a turning machine is caught, would make the first calls of the step those of an open phase.
//!
//! Validity: the deviation of a healthy drive is over within some ms, in the voltage limit within tens of ms.

use super::fault::{Fault, Trip};
use super::leaky::LeakyCounter;
use crate::scalar::{Real, likely};
use crate::space::{Dq, Rotator};
use crate::words::words;

/// Largest deviation relative to the reference, and one that a healthy drive has in transients only.
const DEVIATION: f64 = 0.2;
const SMALL: f64 = 0.06;
/// Deviation beside each of these that is admissible at any reference, per unit.
pub(crate) const FLOOR: f64 = 0.05;
pub(crate) const SMALL_FLOOR: f64 = 0.02;
/// Time of a deviation under control that is a fault whatever its cause, s: that of a healthy drive is over within tens
/// of ms.
pub(crate) const CONTROL_TIME: f64 = 0.25;
/// Time constant of the reference's low-pass in units of `1/ω_c`: the current follows a ramp with 2.7 of them.
pub(crate) const LAG: f64 = 3.0;
/// Smallest current of a phase relative to the current vector: a healthy phase has passed it after `2 · ZERO` rad.
const ZERO: f64 = 0.03;
/// Part of the deviation's square that lies along the axis of a phase that is open: half of the deviation.
const AIMED: f64 = 0.25;
/// Angle by which the field turns while an open phase stays there, rad.
const PASSED: f64 = 0.1;
/// Missing current of a phase at its zero, relative to the reference, up to which the turned angle counts half: half more than was
/// seen at a healthy phase that dead time holds there (0.1).
const MISSING_LITTLE: f64 = 0.15;
/// Reference of a start-up, relative to that of the deviation before, at which the count begins anew.
const RISEN: f64 = 1.2;
/// Current of an open phase relative to its reference, mean magnitudes: noise, and samples that still deviated
/// otherwise.
const OPEN: f64 = 0.15;
/// Least mean reference, per unit, with which a phase counts, and in a start-up relative to the current vector.
const CARRIES: f64 = 0.1;
const CARRIES_PART: f64 = 0.4;
/// Deviation beside [`DEVIATION`] that is admissible in a start-up, relative to the reference.
const FLOOR_PART: f64 = 0.15;
/// Least stator frequency at which the angle counts: below it the estimate of a frequency is noise to a good part.
const TURNS: f64 = 0.03;
/// Part of a current that one call adds to the sums: keeps them within the range of fixed point.
const SCALE: f64 = 1.0 / 64.0;

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct PhaseConfig<R: Real> {
    /// Square of the deviation that is always admissible, and of the one that transients exceed.
    pub floor_sq: R,
    /// See `floor_sq`.
    pub small_floor_sq: R,
    /// Calls of violation after which phases are compared, and after which any deviation is a fault.
    pub calls_open: u32,
    /// See `calls_open`.
    pub calls_control: u32,
    /// Calls at the zero of its current after which a phase is open, if the field has turned meanwhile.
    pub calls_zero: u32,
    /// Normalised time between two calls.
    pub t_s: R,
    /// Part of the way to the reference that its low-pass goes in a call.
    pub lag: R,
}
words!(PhaseConfig: floor_sq, small_floor_sq, calls_open, calls_control, calls_zero, t_s, lag);

/// State.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Phases<R: Real> {
    counter: LeakyCounter,
    /// Calls for which each phase has been at the zero of its current, and by what the field has turned in them, rad.
    zero: [(u32, R); 3],
    /// The latest call had a deviation, or a phase is at the zero of its current.
    watching: bool,
    /// Reference of the latest call with a deviation.
    i_ref: Dq<R>,
    /// Low-pass of the reference since there is a deviation.
    lagged: Dq<R>,
    /// Sums of `|i_x|` and of `|i_x*|` over the violated calls, scaled.
    measured: [R; 3],
    wanted: [R; 3],
}

impl<R: Real> Default for Phases<R> {
    fn default() -> Self {
        Self {
            counter: LeakyCounter::default(),
            zero: [(0, R::ZERO); 3],
            watching: false,
            i_ref: Dq::default(),
            lagged: Dq::default(),
            measured: [R::ZERO; 3],
            wanted: [R::ZERO; 3],
        }
    }
}

impl<R: Real> Phases<R> {
    /// One call with the current in field coordinates, its reference, the field's direction, and under control the stator
    /// frequency.
    #[inline(always)]
    pub fn step(
        &mut self,
        c: &PhaseConfig<R>,
        i: &Dq<R>,
        i_ref: &Dq<R>,
        field: &Rotator<R>,
        omega_s: Option<R>,
    ) -> Option<Trip<R>> {
        let deviation = (*i_ref - *i).norm_sq();
        if likely(deviation <= i_ref.norm_sq() * R::from_f64(SMALL * SMALL) + c.small_floor_sq) {
            if !likely(self.counter.is_empty() && !self.watching) {
                self.follows(c, i, i_ref, field);
            }
            return None;
        }
        self.compare(c, i, i_ref, (field, omega_s), deviation)
    }

    /// A call without a deviation, after some with one.
    #[cold]
    #[inline(never)]
    fn follows(&mut self, c: &PhaseConfig<R>, i: &Dq<R>, i_ref: &Dq<R>, field: &Rotator<R>) {
        self.counter.step(false, 0);
        self.lagged += (*i_ref - self.lagged) * c.lag;
        let nothing = i.norm_sq() * R::from_f64(ZERO * ZERO);
        self.watching = false;
        for (zero, i_x) in self.zero.iter_mut().zip(field.to_stator(i).to_phases()) {
            // It has left its zero, which an open phase does not.
            if i_x * i_x >= nothing {
                *zero = (0, R::ZERO);
            }
            self.watching |= zero.0 > 0;
        }
    }

    /// A call with a deviation.
    #[cold]
    #[inline(never)]
    fn compare(
        &mut self,
        c: &PhaseConfig<R>,
        i: &Dq<R>,
        i_ref: &Dq<R>,
        (field, omega_s): (&Rotator<R>, Option<R>),
        deviation: R,
    ) -> Option<Trip<R>> {
        let r = R::from_f64;
        if self.counter.is_empty() && !self.watching {
            self.lagged = *i_ref;
        }
        self.watching = true;
        self.lagged += (*i_ref - self.lagged) * c.lag;
        let open = |phase: f64| Some(Trip::new(Fault::OpenPhase, r(phase), R::ZERO));
        let [measured, wanted, lately] = [i, i_ref, &self.lagged].map(|i| field.to_stator(i).to_phases());
        let n2 = i_ref.norm_sq();
        if omega_s.is_none() && n2 > self.i_ref.norm_sq() * r(RISEN * RISEN) + c.floor_sq {
            self.counter = LeakyCounter::default();
        }
        self.i_ref = *i_ref;
        let omega_s = omega_s.map(R::abs);
        let turned = omega_s.filter(|omega_s| *omega_s > r(TURNS)).map(|omega_s| omega_s * c.t_s);
        let settled = turned.is_some() && self.counter.is_empty();
        let nothing = if settled { i.norm_sq() * r(ZERO * ZERO) } else { R::ZERO };
        for (k, number) in [1.0, 2.0, 3.0].into_iter().enumerate() {
            let (calls, angle) = self.zero[k];
            let (missing, missed) = (wanted[k] - measured[k], lately[k] - measured[k]);
            let aimed = |missing: R| missing * missing > deviation * r(AIMED);
            let lasts = aimed(missing) && aimed(missed) && (missing < R::ZERO) == (missed < R::ZERO);
            self.zero[k] = match turned {
                Some(turned) if measured[k] * measured[k] < nothing => {
                    if lasts {
                        let little = missing * missing < n2 * r(MISSING_LITTLE * MISSING_LITTLE);
                        (calls.saturating_add(1), (angle + if little { turned.half() } else { turned }).min(R::ONE))
                    } else {
                        (calls, angle)
                    }
                }
                _ => (0, R::ZERO),
            };
            let (calls, angle) = self.zero[k];
            if calls > c.calls_zero && angle > r(PASSED) {
                return open(number);
            }
        }
        if self.counter.is_empty() {
            (self.measured, self.wanted) = ([R::ZERO; 3], [R::ZERO; 3]);
        }
        let (mut floor_sq, mut carries) = (c.floor_sq, r(CARRIES));
        if omega_s.is_none() && n2 > floor_sq {
            floor_sq = floor_sq.min(n2 * r(FLOOR_PART * FLOOR_PART));
            carries = carries.min(n2.sqrt() * r(CARRIES_PART));
        }
        let admissible = n2 * r(DEVIATION * DEVIATION) + floor_sq;
        let violated = deviation > admissible;
        let lasting = self.counter.step(violated, c.calls_control);
        if omega_s.is_none() {
            // What lasts in a start-up is no fault of the current control that follows.
            self.counter.limit(c.calls_open.saturating_add(1));
        }
        if !violated {
            return None;
        }
        for k in 0..3 {
            self.measured[k] = (self.measured[k] + measured[k].abs() * r(SCALE)).min(r(100.0));
            self.wanted[k] = (self.wanted[k] + wanted[k].abs() * r(SCALE)).min(r(100.0));
        }
        if self.counter.calls() < c.calls_open {
            return None;
        }
        let least = (carries * r(SCALE)).periods(self.counter.calls()) * r(64.0);
        let missing = |k: usize| self.measured[k] < self.wanted[k] * r(OPEN) && self.wanted[k] > least;
        let phase = match (missing(0), missing(1), missing(2)) {
            (true, false, false) => Some(1.0),
            (false, true, false) => Some(2.0),
            (false, false, true) => Some(3.0),
            (false, false, false) => None,
            // An open phase a stops the other two as well while the current is along its axis.
            _ => Some(0.0),
        };
        if let Some(phase) = phase {
            return open(phase);
        }
        (lasting && omega_s.is_some()).then(|| Trip::new(Fault::CurrentControl, deviation.sqrt(), admissible.sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::AlphaBeta;

    const CALLS: u32 = 16;
    const CONFIG: PhaseConfig<f64> = PhaseConfig {
        floor_sq: 0.05 * 0.05,
        small_floor_sq: 0.02 * 0.02,
        calls_open: CALLS,
        calls_control: 1000,
        calls_zero: CALLS,
        t_s: 0.08,
        lag: 0.25,
    };

    /// Call in which phase b is found to be open while a direct current along the axis of phase a is asked for.
    fn found(i_ref: f64, omega_s: Option<f64>) -> Option<u32> {
        let mut phases = Phases::default();
        let (i_ref, field) = (Dq::new(i_ref, 0.0), Rotator::default());
        // What is left of it along the line of the other two phases.
        let line = Dq::new(0.75_f64.sqrt(), 0.5);
        let i = line * (i_ref.re() * line.re());
        (0..10 * CALLS).find(|_| match phases.step(&CONFIG, &i, &i_ref, &field, omega_s) {
            Some(trip) => trip == Trip::new(Fault::OpenPhase, 2.0, 0.0),
            None => false,
        })
    }

    #[test]
    fn in_a_start_up_an_open_phase_is_found_at_any_current() {
        for i_ref in [0.09, 0.13, 0.3, 0.9] {
            assert!(found(i_ref, None).is_some_and(|call| call <= CALLS), "{i_ref}: {:?}", found(i_ref, None));
        }
        // Without a current, and under control with a small one, a deviation says nothing.
        assert_eq!(found(0.04, None), None);
        assert_eq!(found(0.13, Some(0.0)), None);
        assert!(found(0.3, Some(0.0)).is_some_and(|call| call <= CALLS));
    }

    #[test]
    fn a_larger_reference_of_a_start_up_begins_the_count_anew() {
        let (mut phases, field) = (Phases::default(), Rotator::default());
        let mut step = |i: Dq<f64>, i_ref: f64| phases.step(&CONFIG, &i, &Dq::new(i_ref, 0.0), &field, None);
        // A flux is caught, with some current where there is to be none; then the largest current is asked for.
        assert!((0..3 * CALLS).all(|_| step(Dq::new(0.07, 0.0), 0.0).is_none()));
        assert!((0..CALLS - 1).all(|_| step(Dq::new(0.07, 0.01), 1.8).is_none()));
        assert!((0..2).any(|_| step(Dq::new(0.07, 0.01), 1.8).is_some_and(|trip| trip.cause == Fault::OpenPhase)));
    }

    #[test]
    fn a_deviation_that_lasts_in_a_start_up_is_forgotten_by_the_control_that_follows() {
        let (mut phases, c) = (Phases::default(), PhaseConfig { calls_control: 100, ..CONFIG });
        let (i_ref, field) = (Dq::new(0.5, 0.5), Rotator { cos: 0.8, sin: 0.6 });
        let mut step = |omega_s| phases.step(&c, &(i_ref * 1.5), &i_ref, &field, omega_s);
        assert!((0..1000).all(|_| step(None).is_none()));
        assert!((0..100 - CALLS - 1).all(|_| step(Some(0.5)).is_none()));
        assert!((0..2).any(|_| step(Some(0.5)).is_some_and(|trip| trip.cause == Fault::CurrentControl)));
    }

    #[test]
    fn a_deviation_now_and_then_is_none_and_one_that_lasts_is_the_current_controls() {
        let found = |every: u32| {
            let mut phases = Phases::default();
            let c = PhaseConfig { calls_control: 100, ..CONFIG };
            let (i_ref, field) = (Dq::new(0.5, 0.5), Rotator { cos: 0.8, sin: 0.6 });
            (0..20_000).find_map(|k| {
                let i = if k % every == 0 { i_ref * 1.5 } else { i_ref };
                phases.step(&c, &i, &i_ref, &field, Some(0.0)).map(|trip| (k, trip.cause))
            })
        };
        assert_eq!(found(1), Some((100, Fault::CurrentControl)));
        assert_eq!(found(10), None);
    }

    /// Phase that is found to be open within some turns at `ω_s` = 0.05, if the current deviates by a tenth wherever phase a
    /// is at the zero of its current, and follows its reference elsewhere; `open`: that phase carries none.
    fn turning(open: bool) -> Option<f64> {
        let (mut phases, i_ref, omega_s) = (Phases::default(), Dq::new(0.8, 0.0), 0.05);
        let c = PhaseConfig { calls_control: u32::MAX, ..CONFIG };
        (0..10_000).find_map(|k| {
            let (sin, cos) = (f64::from(k) * omega_s * c.t_s).sin_cos();
            let field = Rotator { cos, sin };
            let phase_a = field.to_stator(&i_ref).re();
            let (i, i_ref) = if open {
                // The reference lies near the line that is left: the deviation comes and goes.
                let of_phase = if k % 4 == 0 { 0.01 } else { 0.08 };
                (AlphaBeta::new(0.0, 0.8), AlphaBeta::new(of_phase, 0.8))
            } else if phase_a.abs() < 0.03 * 0.8 {
                (field.to_stator(&Dq::new(0.72, 0.0)), field.to_stator(&i_ref))
            } else {
                (field.to_stator(&i_ref), field.to_stator(&i_ref))
            };
            let (i, i_ref) = (field.to_field(&i), field.to_field(&i_ref));
            phases.step(&c, &i, &i_ref, &field, Some(omega_s)).map(|trip| trip.value)
        })
    }

    #[test]
    fn a_phase_at_its_zero_while_the_current_deviates_along_the_line_of_the_others_is_not_open() {
        // Phase a is at its zero and stays there, by a reference that turns back in the field as fast as that turns.
        let found = |part: f64, of_phase: f64| {
            let (mut phases, omega_s) = (Phases::default(), 0.1);
            let line = AlphaBeta::new(0.0, 0.8);
            (0..100).find_map(|k| {
                let (sin, cos) = (f64::from(k) * omega_s * CONFIG.t_s).sin_cos();
                let field = Rotator { cos, sin };
                let (i, i_ref) = (line * part, AlphaBeta::new(of_phase, line.im()));
                let trip = phases.step(&CONFIG, &field.to_field(&i), &field.to_field(&i_ref), &field, Some(omega_s));
                trip.map(|trip| trip.value)
            })
        };
        assert_eq!(found(0.9, 0.0), None);
        assert_eq!(found(1.0, 0.08), Some(1.0));
    }

    #[test]
    fn a_phase_at_its_zero_whose_current_follows_a_moving_reference_by_a_call_is_not_open() {
        // Phase a is at its zero and stays there; the field turns by 0.08 rad in a call, and the reference back in it.
        let found = |calls: f64| {
            let mut phases = Phases::default();
            (0..100).find_map(|k| {
                let at = |k: f64| Rotator { cos: (0.08 * k).cos(), sin: (0.08 * k).sin() };
                let line = AlphaBeta::new(0.0, 0.8);
                let (i, i_ref) = (at(f64::from(k)).to_field(&line), at(f64::from(k) + calls).to_field(&line));
                phases.step(&CONFIG, &i, &i_ref, &at(f64::from(k)), Some(1.0)).map(|trip| trip.value)
            })
        };
        assert_eq!(found(1.0), None);
        // It has not reached where the reference was two calls before.
        assert_eq!(found(3.0), Some(1.0));
    }

    #[test]
    fn a_phase_that_lacks_little_at_its_zero_is_open_after_twice_the_angle() {
        let calls = |lacks: f64| {
            let (mut phases, omega_s) = (Phases::default(), 0.05);
            let (i, i_ref) = (AlphaBeta::new(0.0, 0.8), AlphaBeta::new(lacks * 0.8, 0.8));
            (1..200).find(|k| {
                let (sin, cos) = (f64::from(*k) * omega_s * CONFIG.t_s).sin_cos();
                let field = Rotator { cos, sin };
                let [i, i_ref] = [i, i_ref].map(|x| field.to_field(&x));
                phases.step(&CONFIG, &i, &i_ref, &field, Some(omega_s)).is_some_and(|trip| trip.value == 1.0)
            })
        };
        let angle = |calls: u32| f64::from(calls - 1) * 0.05 * CONFIG.t_s;
        assert!((angle(calls(0.16).unwrap_or(1)) - PASSED).abs() < 0.01);
        assert!((angle(calls(0.1).unwrap_or(1)) - 2.0 * PASSED).abs() < 0.01);
    }

    #[test]
    fn a_phase_that_deviates_at_its_zero_alone_is_not_open_and_one_that_stays_there_is() {
        assert_eq!(turning(false), None);
        assert_eq!(turning(true), Some(1.0));
    }
}
