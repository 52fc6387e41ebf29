//! One shunt in the dc link in place of current sensors in the phases.
//!
//! The current of the dc link is that of the legs at the upper rail. In the half of the carrier period with the falling
//! edges the legs leave it one after the other, the one with the smallest duty first:
//!
//! ```text
//! legs at the upper rail        all → largest and middle → largest → none
//! current of the shunt            0         -i_min            i_max     0        i_mid = -(i_max + i_min)
//! ```
//!
//! **Pulses.** Each of the two states has to last for a *window*: the dead time, in which the current still belongs to the
//! state before, and what amplifier and converter need. At low speed the duties are nearly equal and no state lasts as
//! long. The falling edges are moved apart then, and the rising edges of the same pulses by as much, so that every duty and
//! with it the mean voltage stays. With the half widths `r` (rising) and `f` (falling) in parts of the half period,
//! `d = (r + f)/2`, and the window `m`:
//!
//! ```text
//! f_mid = d_mid within m … 1 - m,   f_max = max(d_max, f_mid + m),   f_min = min(d_min, f_mid - m),   r = 2d - f
//! ```
//!
//! All of them lie in 0 … 1 for `m/2 ≤ d_mid ≤ 1 - m/2`, `d_max ≥ m` and `d_min ≤ 1 - m`, to which duties are limited. Each
//! sample is taken at the end of its state, on the falling edge that ends it.
//!
//! **Ripple.** The two samples belong to different instants, none of which is that of the period's mean. In between the
//! currents follow the voltages of the legs less the mean voltage `w` of the period, with `K = u_dc T/(2 σl_s)`, the time
//! `g` by which dead time delays a falling edge, and `T` the period of the carrier. To the end of the period
//!
//! ```text
//! i_max += K (2/3 g_max - w_max (1 - f_max))
//! i_min += K (-1/3 (f_max - f_mid + g_max + g_mid) - w_min (1 - f_mid))
//! ```
//!
//! An amplifier with the time constant `τ` shows the current of a moment `τ` earlier, while it rises with `2/3 u_dc/σl_s` in
//! either state: `i_max` is read too small by `2/3 K 2τ/T` and `i_min` by as much too large.
//!
//! From the end of the period to its mean, of which pulses out of the centre hold the current off,
//!
//! ```text
//! i_k -= K (p_k - (p_a + p_b + p_c)/3),    p = d (f - r)/2 = d (f - d)
//! ```
//!
//! which at zero voltage is half of the swing `K m` that the shifted pulses make: 90 mA at 2.2 kW and 0.9 A at 11 kW with
//! 4.5 µs, systematic and in the direction of the voltage. The change of the currents' mean over the last quarter of the
//! period is left out: at 50 Hz and 10 kHz that is 0.5° of the current.
//!
//! **Swing.** What the current really swings by in a state is not known from the leakage at rated flux alone: where the
//! main flux saturates, the inductance to so short a pulse is less along the flux, by a seventh at 2.2 kW, and an error of a
//! fifth makes 5 to 10° of field angle at light load beside zero stator frequency. It is measured. In every eighth period,
//! while the windows are what sets the pulses apart, the falling edges come in the reverse order, and the readings show the
//! smallest and the largest leg with the errors of their corrections exchanged. At the end of the period, in the zero
//! vector, the currents go on as they did: with `q = i_max - i_min` there, `S` for what of it is corrected, and the factor
//! `s` of all corrections,
//!
//! ```text
//! e = q(k) - (q(k - 1) + q(k + 1))/2 = (s - s_true) D,   D = S(k) - (S(k - 1) + S(k + 1))/2 ≈ -2/3 K m,   s -= g D e
//! ```
//!
//! with `g` for a time constant of 512 such periods at rated voltage. `s` stays over a stop, within 0.5 … 2.
//!
//! **Voltage.** The mean voltage of ideal legs is kept. The currents at the edges are those of the ripple, in the outer legs
//! `±K m/2` from the mean, which makes the loss of the dead time steeper there ([`crate::inverter`]); a model of it left
//! the angle as it was, since the filter identifies loss and knee.
//!
//! **Offset.** With an offset `o` of the one amplifier the largest phase reads `i + o`, the smallest `i - o`, the middle
//! one is right: an error `2/√3 o` in the direction of the middle of the present sector of the voltage. It turns with the
//! voltage in six steps, and on average over a turn it is `2√3/π o = 1.10 o` in phase with it: a wrong resistance rather
//! than an offset, and no constant that an estimator of offsets would find. But in the zero vector the shunt carries no
//! current: a third sample there, at the end of the period, shows the offset itself. It is followed with [`RATE`].
//!
//! **Validity.** Continuous modulation with one update of the duties per carrier period or fewer; the largest voltage
//! falls by the factor `1 - m`. While the bridge is blocked nothing is seen; no current is taken to flow then.

use crate::control::modulator::{Duty, applied};
use crate::inverter::Distortion;
use crate::scalar::{Integrator, Real};
use crate::space::AlphaBeta;
use crate::words::words;

/// Part of the deviation from the offset that is taken over in every period: 26 ms at 10 kHz. With noise of 0.4 % of rated
/// current and a drift of 0.7 % of it in a second the lag behind the drift and the noise that is taken over are equal.
pub(crate) const RATE: f64 = 1.0 / 256.0;

/// Part of the deviation that the swing's factor takes over in every period with the reverse order.
const RATE_SWING: f64 = 1.0 / 512.0;
/// Periods from one with the reverse order to the next.
const PROBE_PERIODS: u32 = 8;

/// Settings of the single shunt, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ShuntConfig<R: Real> {
    /// Window in parts of half of the carrier period, a whole and even number of timer counts; 0: pulses stay centred.
    pub(crate) window: R,
    /// `T/(2 σl_s)`.
    pub(crate) gain: R,
    /// Time constant of the amplifier in half periods of the carrier.
    pub(crate) lag: R,
    /// Gain `g` of the swing's factor.
    pub(crate) rate: R,
}
words!(ShuntConfig: window, gain, lag, rate);

impl<R: Real> ShuntConfig<R> {
    /// For a window and an amplifier's time constant in half periods of the carrier, and `T/(2 σl_s)`, at a dc link of
    /// `u_dc`.
    pub(crate) fn new((window, lag): (f64, f64), gain: f64, u_dc: f64) -> Self {
        let swing = 2.0 / 3.0 * gain * u_dc * window;
        let rate = if window > 0.0 { (RATE_SWING / (swing * swing)).min(100.0) } else { 0.0 };
        let r = R::from_f64;
        Self { window: r(window), gain: r(gain), lag: r(lag), rate: r(rate) }
    }
}

/// Pulses of the three legs that need not be centred, and the instants at which the shunt is sampled.
///
/// A leg's pulse begins `rising` half periods of the carrier before the middle of its period and ends `falling` half
/// periods after it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Pulses<R: Real> {
    /// Half width before the middle, in [0, 1]: of the half period with the rising edges.
    pub rising: Duty<R>,
    /// Half width after the middle, in [0, 1].
    pub falling: Duty<R>,
    /// Instants after the middle at which the conversions of the shunt hold their values, ascending, in [0, 1]. A third one
    /// does at the end of the period.
    pub sample: [R; 2],
}

/// Legs in the reverse order of their falling edges: by their duties, the largest first, or in a period that measures the
/// swing the smallest first.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Order([u8; 3]);

impl Order {
    fn of<R: Real>(d: &Duty<R>) -> Self {
        let (a, b) = if d[0] >= d[1] { (0, 1) } else { (1, 0) };
        let (of_a, of_b) = if a == 0 { (d[0], d[1]) } else { (d[1], d[0]) };
        Self(if d[2] > of_a {
            [2, a, b]
        } else if d[2] > of_b {
            [a, 2, b]
        } else {
            [a, b, 2]
        })
    }

    /// The other way round.
    fn reversed(self) -> Self {
        let Self([last, middle, first]) = self;
        Self([first, middle, last])
    }

    /// Values of the largest, the middle and the smallest leg. Without an index that the compiler would have to check.
    fn ranked<R: Real>(self, x: &[R; 3]) -> [R; 3] {
        self.0.map(|leg| match leg {
            0 => x[0],
            1 => x[1],
            _ => x[2],
        })
    }

    /// Values of legs a, b, c: the reverse.
    fn legs<R: Real>(self, [max, mid, min]: [R; 3]) -> [R; 3] {
        let Self(order) = self;
        [0, 1, 2].map(|leg| {
            if order[0] == leg {
                max
            } else if order[1] == leg {
                mid
            } else {
                min
            }
        })
    }
}

impl<R: Real> Pulses<R> {
    /// Duties of the pulses.
    #[must_use]
    pub fn duty(&self) -> Duty<R> {
        [0, 1, 2].map(|k| (self.rising[k] + self.falling[k]).half())
    }
}

/// What the samples of one period show.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Visible<R: Real> {
    order: Order,
    /// Correction of the current of the last and of the first leg to fall, to the end of the period.
    at_end: [R; 2],
    /// And from there to the mean of the period.
    mean: [R; 2],
    /// The falling edges come in the reverse order.
    reversed: bool,
    /// The zero vector at the end lasts as long as a window.
    zero: bool,
}

/// Phase currents at the end of a period, and what of them is corrected.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct AtEnd<R: Real> {
    i: [R; 3],
    corrected: [R; 3],
}

/// Pulses of the latest period, and what the samples of the last two show.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(crate) struct Shunt<R: Real> {
    /// By the lowest bit of the period's number.
    visible: [Option<Visible<R>>; 2],
    pulses: Option<Pulses<R>>,
    /// Factor of all corrections.
    swing: Integrator<R>,
    /// Currents at the end of the period before the last, and of the last one if its order was the reverse.
    before: Option<AtEnd<R>>,
    probe: Option<(Order, AtEnd<R>)>,
}

impl<R: Real> Default for Shunt<R> {
    fn default() -> Self {
        Self { visible: [None; 2], pulses: None, swing: Integrator::new(R::ONE), before: None, probe: None }
    }
}

impl<R: Real> Shunt<R> {
    /// The bridge is blocked.
    pub fn block(&mut self) {
        (self.visible, self.pulses, self.before, self.probe) = ([None; 2], None, None, None);
    }

    /// What the samples of the period that ends now show; `None` if the bridge was blocked in it.
    fn visible(&self, period: u32) -> Option<&Visible<R>> {
        let [even, odd] = &self.visible;
        if period & 1 == 0 { even.as_ref() } else { odd.as_ref() }
    }

    /// Pulses of the next period; `None` while the bridge is blocked.
    pub fn pulses(&self) -> Option<Pulses<R>> {
        self.pulses
    }

    /// The reading in the zero vector at the end of the period, if that is long enough to show the offset.
    pub fn zero(&self, period: u32, [.., zero]: &[R; 3]) -> Option<R> {
        self.visible(period).filter(|v| v.zero).map(|_| *zero)
    }

    /// Phase currents, mean of the period, of the readings in the order of their instants and the offset in them; `None` if
    /// the bridge was blocked.
    #[inline(never)]
    pub fn currents(&mut self, c: &ShuntConfig<R>, period: u32, readings: &[R; 3], offset: R) -> Option<[R; 3]> {
        let v = *self.visible(period)?;
        let s = self.swing.value();
        let [two_legs, one_leg, _] = *readings;
        let (last, first) = (one_leg - offset + s * v.at_end[0], offset - two_legs + s * v.at_end[1]);
        let by_sum = |last: R, first: R| v.order.legs([last, -(last + first), first]);
        let now = AtEnd { i: by_sum(last, first), corrected: by_sum(v.at_end[0], v.at_end[1]) };
        if let Some((order, probe)) = self.probe.take() {
            self.adapt(c, order, (&probe, &now));
        }
        if v.reversed {
            self.probe = Some((v.order, now));
        } else {
            self.before = Some(now);
        }
        Some(by_sum(last + s * v.mean[0], first + s * v.mean[1]))
    }

    /// Factor of the corrections by the currents at the ends of three periods, of which the middle one had the reverse order.
    fn adapt(&mut self, c: &ShuntConfig<R>, order: Order, (probe, after): (&AtEnd<R>, &AtEnd<R>)) {
        let difference = |x: [&[R; 3]; 3]| {
            let [before, probe, after] = x.map(|x| {
                let [last, _, first] = order.ranked(x);
                first - last
            });
            probe - (before + after).half()
        };
        let Some(before) = &self.before else { return };
        let e = difference([&before.i, &probe.i, &after.i]);
        let d = difference([&before.corrected, &probe.corrected, &after.corrected]);
        self.swing.add_clamped(-(d * c.rate), e, R::HALF, R::TWO);
    }

    /// Pulses for the duties, which may be limited for them, and what the samples in them will show.
    #[cold]
    #[inline(never)]
    pub fn shape(&mut self, c: &ShuntConfig<R>, period: u32, duty: &mut Duty<R>, loss: &Distortion<R>, u_dc: R) {
        let reverse = period.is_multiple_of(PROBE_PERIODS);
        let (pulses, order, reversed) = arrange(c, duty, reverse);
        let u = applied(duty) * u_dc - loss.vector();
        let visible = Visible::of(c, (&pulses, order, reversed), duty, loss, (&u, u_dc));
        let [even, odd] = &mut self.visible;
        *(if period & 1 == 0 { even } else { odd }) = Some(visible);
        self.pulses = Some(pulses);
    }
}

/// Pulses in which both states last for a window, and the order of the legs; whether it is the reverse one, if that is asked
/// for. The duties are limited to what the window needs.
#[inline(never)]
fn arrange<R: Real>(c: &ShuntConfig<R>, duty: &mut Duty<R>, reverse: bool) -> (Pulses<R>, Order, bool) {
    let order = Order::of(duty);
    let [max, mid, min] = order.ranked(duty);
    let m = c.window;
    if m == R::ZERO {
        return (Pulses { rising: *duty, falling: *duty, sample: [mid, max] }, order, false);
    }
    let d = [max.clamp(m, R::ONE), mid.clamp(m.half(), R::ONE - m.half()), min.clamp(R::ZERO, R::ONE - m)];
    *duty = order.legs(d);
    let f_mid = d[1].clamp(m, R::ONE - m);
    // Half widths before the middle of the reverse order: within 0 … 1 only at low voltage. Beyond it there is hardly a shift.
    let (widest, narrowest) = (d[0] + (d[0] - f_mid) + m, d[2] + (d[2] - f_mid) - m);
    let reversed = reverse && d[0] - d[2] < m * R::TWO && widest <= R::ONE && narrowest >= R::ZERO;
    let f = if reversed {
        [f_mid - m, f_mid, f_mid + m]
    } else {
        [d[0].max(f_mid + m).min(R::ONE), f_mid, d[2].min(f_mid - m).max(R::ZERO)]
    };
    // Within 0 … 1 but for the rounding of the arithmetic.
    let r = [0, 1, 2].map(|k| (d[k] + (d[k] - f[k])).clamp(R::ZERO, R::ONE));
    let pulses = Pulses { rising: order.legs(r), falling: order.legs(f), sample: [f_mid, f[0].max(f[2])] };
    (pulses, if reversed { order.reversed() } else { order }, reversed)
}

impl<R: Real> Visible<R> {
    /// For pulses with their duties, the loss of the inverter model and the mean voltage `u` in their period.
    #[inline(never)]
    fn of(
        c: &ShuntConfig<R>,
        (pulses, order, reversed): (&Pulses<R>, Order, bool),
        duty: &Duty<R>,
        loss: &Distortion<R>,
        (u, u_dc): (&AlphaBeta<R>, R),
    ) -> Self {
        let (f, d, u) = (order.ranked(&pulses.falling), order.ranked(duty), order.ranked(&u.to_phases()));
        let third = R::from_f64(1.0 / 3.0);
        // A falling edge waits for the dead time where the current is negative. As a voltage over half a period.
        let late = order.ranked(&loss.without_delays());
        let late = late.map(|e| (loss.full - loss.least - (e - loss.least).max(R::ZERO)) * R::TWO);
        let lag = c.lag * u_dc * (third + third);
        let at_end = [
            (late[0] + late[0]) * third - u[0] * (R::ONE - f[0]) + lag,
            -((f[0] - f[1]) * u_dc + late[0] + late[1]) * third - u[2] * (R::ONE - f[1]) - lag,
        ];
        let moment = [0, 1, 2].map(|k| d[k] * (f[k] - d[k]));
        let common = (moment[0] + moment[1] + moment[2]) * third;
        let mean = [(common - moment[0]) * u_dc, (common - moment[2]) * u_dc];
        let zero = R::ONE - f[0] >= c.window;
        Self { order, at_end: at_end.map(|x| x * c.gain), mean: mean.map(|x| x * c.gain), reversed, zero }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;
    use proptest::prelude::*;

    /// A bridge of 1 pu with a dead time, on a leakage: everything in half periods of the carrier.
    const LEAKAGE: f64 = 3.0;
    const DEAD: f64 = 0.04;

    /// Currents of ideal legs with a dead time over one period, of which the induced voltage takes the mean: at so many
    /// instants, and their mean. Edge by edge, as the plant of `stillflux-sim` does it with all of its events.
    struct Course {
        edges: std::vec::Vec<(f64, usize, bool)>,
        drift: [f64; 3],
        begin: [f64; 3],
    }

    impl Course {
        fn new(pulses: &Pulses<f64>, signs: [f64; 3], begin: [f64; 3]) -> Self {
            let mut edges = std::vec::Vec::new();
            for leg in 0..3 {
                let late = |edge: bool| if signs[leg] != 0.0 && (signs[leg] > 0.0) == edge { DEAD } else { 0.0 };
                edges.push((1.0 - pulses.rising[leg] + late(true), leg, true));
                edges.push((1.0 + pulses.falling[leg] + late(false), leg, false));
            }
            edges.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut course = Self { edges, drift: [0.0; 3], begin };
            let end = course.at(2.0).0;
            course.drift = [0, 1, 2].map(|k| (end[k] - begin[k]) / 2.0);
            course
        }

        /// Currents at an instant, their integral to there, and the current of the dc link just before it.
        fn at(&self, instant: f64) -> ([f64; 3], [f64; 3], f64) {
            let (mut i, mut sum, mut high, mut t) = (self.begin, [0.0; 3], [false; 3], 0.0);
            let end = (instant, 0, false);
            for &(edge, leg, level) in self.edges.iter().filter(|e| e.0 < instant).chain([&end]) {
                let h = edge - t;
                let common = high.iter().filter(|h| **h).count() as f64 / 3.0;
                for k in 0..3 {
                    let slope = (f64::from(u8::from(high[k])) - common) / LEAKAGE - self.drift[k];
                    sum[k] += i[k] * h + slope * h * h / 2.0;
                    i[k] += slope * h;
                }
                t = edge;
                if edge < instant {
                    high[leg] = level;
                }
            }
            let link = (0..3).filter(|k| high[*k]).map(|k| i[k]).sum();
            (i, sum, link)
        }
    }

    fn config<R: Real>() -> ShuntConfig<R> {
        // Of a period of two of these units: T/(2 σl_s).
        ShuntConfig::new((0.1, 0.0), 1.0 / LEAKAGE, 1.0)
    }

    /// The state of a shunt after these pulses, with a model of the loss that is right.
    fn shunt(
        c: &ShuntConfig<f64>,
        pulses: &(Pulses<f64>, Order, bool),
        duty: &Duty<f64>,
        signs: [f64; 3],
    ) -> Shunt<f64> {
        // The loss is relative to the whole period, of two units.
        let phases = signs.map(|s| DEAD / 2.0 * s);
        let loss = Distortion { phases, least: 0.0, full: DEAD / 2.0, ..Distortion::default() };
        let u = applied(duty) - loss.vector();
        let visible = Visible::of(c, (&pulses.0, pulses.1, pulses.2), duty, &loss, (&u, 1.0));
        Shunt { visible: [Some(visible); 2], ..Shunt::default() }
    }

    /// What the shunt reads in the pulses of duties is taken for, and the mean currents.
    fn seen(mut duty: [f64; 3], currents: [f64; 3], gain: f64, reverse: bool) -> ([f64; 3], [f64; 3], bool) {
        let c = ShuntConfig { gain, ..config() };
        let signs = currents.map(f64::signum);
        let pulses = arrange(&c, &mut duty, reverse);
        let course = Course::new(&pulses.0, signs, currents);
        let [first, second] = pulses.0.sample.map(|t| course.at(1.0 + t).2);
        let mean = course.at(2.0).1.map(|sum| sum / 2.0);
        let got = shunt(&c, &pulses, &duty, signs).currents(&c, 0, &[first, second, 0.0], 0.0);
        (got.unwrap(), mean, pulses.2)
    }

    proptest! {
        #[test]
        fn readings_of_any_duties_and_currents_are_the_mean_currents_of_the_period(
            a in 0.06..0.94f64, b in 0.06..0.94f64, c in 0.06..0.94f64, i_a in 0.3..3.0f64, share in 0.1..0.9f64, turn in 0..6usize,
            near in 0.0..1.0f64,
        ) {
            let mut i = [i_a, -share * i_a, -(1.0 - share) * i_a];
            i.rotate_right(turn % 3);
            let i = i.map(|x| if turn < 3 { x } else { -x });
            for reverse in [false, true] {
                let (got, want, _) = seen([a, b, c].map(|d| 0.5 + near * (d - 0.5)), i, config().gain, reverse);
                for k in 0..3 {
                    // Dead time moves the middle of every pulse by half of it, as with sensors in the phases.
                    prop_assert!((got[k] - want[k]).abs() < DEAD / 2.0 / LEAKAGE, "{reverse} {got:?} {want:?}");
                }
            }
        }

        #[test]
        fn both_states_last_for_the_window_and_the_duties_are_kept(
            d in proptest::array::uniform3(0.0..=1.0f64), near in 0.0..0.1f64, nearly in any::<bool>(), reverse in any::<bool>(),
        ) {
            let d = if nearly { d.map(|x| 0.5 + near * (x - 0.5)) } else { d };
            last::<f64>(d, reverse, 1e-12)?;
            last::<f32>(d, reverse, 1e-6)?;
            last::<Q>(d, reverse, 1e-6)?;
        }
    }

    fn last<R: Real>(d: [f64; 3], reverse: bool, tolerance: f64) -> Result<(), TestCaseError> {
        let m = config::<f64>().window;
        let asked = d.map(R::from_f64);
        let mut duty = asked;
        let (pulses, order, reversed) = arrange(&config::<R>(), &mut duty, reverse);
        let [max, mid, min] = order.ranked(&pulses.falling).map(R::to_f64);
        prop_assert!(max - mid > m - tolerance && mid - min > m - tolerance, "{max} {mid} {min}");
        prop_assert_eq!(pulses.sample.map(R::to_f64), [mid, max]);
        prop_assert!(!reversed || reverse);
        // At voltages near zero the reverse order is always possible.
        prop_assert!(reversed || !reverse || d.iter().any(|d| (d - 0.5).abs() > 0.049));
        for k in 0..3 {
            let (r, f) = (pulses.rising[k].to_f64(), pulses.falling[k].to_f64());
            prop_assert!((0.0..=1.0).contains(&r) && (0.0..=1.0).contains(&f));
            prop_assert!(((r + f) / 2.0 - duty[k].to_f64()).abs() < tolerance, "{r} {f} {:?}", duty[k]);
            let changed = (duty[k].to_f64() - asked[k].to_f64()).abs();
            prop_assert!(changed <= m + tolerance);
            if asked.iter().all(|d| d.to_f64() > m && d.to_f64() < 1.0 - m) {
                prop_assert!(changed < tolerance);
            }
        }
        Ok(())
    }

    /// Mean error, per unit of the current that the leakage gains in half a period, of the currents at voltages near zero.
    fn error_near_zero(gain: f64) -> f64 {
        let mut worst = 0.0_f64;
        for k in 0..36 {
            let (s, c) = (f64::from(k) * 10.0 + 5.0).to_radians().sin_cos();
            let (u, i) = (AlphaBeta::new(0.005 * c, 0.005 * s), AlphaBeta::new(s, -c));
            let (got, want, _) = seen(u.to_phases().map(|u| 0.5 + u), i.to_phases(), gain, false);
            worst = worst.max((0..3).map(|k| (got[k] - want[k]).abs()).fold(0.0, f64::max));
        }
        worst * LEAKAGE
    }

    /// The negative control of the corrections: half of the swing of a window, less what the duties differ by.
    #[test]
    fn without_the_correction_the_ripple_of_the_shifted_pulses_is_taken_for_current() {
        assert!(error_near_zero(config().gain) < DEAD / 4.0, "{}", error_near_zero(config().gain));
        assert!(error_near_zero(0.0) > 0.4 * config::<f64>().window, "{}", error_near_zero(0.0));
    }

    #[test]
    fn pulses_are_whole_counts_where_the_duties_and_the_window_are() {
        let (full, m) = (8500.0, 766.0);
        let c = ShuntConfig::new((m / full, 0.0), 0.1, 1.0);
        for (a, b) in [(4300, 4180), (4250, 4250), (8499, 8400), (120, 3), (8500, 0)] {
            let mut duty = [a, b, 4250].map(|n| (f64::from(n) / full) as f32);
            let (pulses, ..) = arrange(&c, &mut duty, false);
            for x in pulses.rising.into_iter().chain(pulses.falling).chain(pulses.sample) {
                let n = f64::from(x) * full;
                assert!((n - n.round()).abs() < 2e-3, "{n}");
            }
        }
    }

    /// Corrections that are wrong by a factor, in a machine that carries a current: found, whatever the voltage's direction.
    #[test]
    fn the_swing_is_measured_by_the_periods_with_the_reverse_order() {
        for (true_swing, degrees) in [(1.2, 10.0_f64), (0.8, 100.0), (1.0, 250.0)] {
            let c = ShuntConfig { gain: config::<f64>().gain / true_swing, ..config() };
            let c = ShuntConfig { rate: c.rate * true_swing * true_swing, ..c };
            let (s, co) = degrees.to_radians().sin_cos();
            let (u, i) = (AlphaBeta::new(0.02 * co, 0.02 * s), AlphaBeta::new(1.2 * co, 1.2 * s).to_phases());
            let mut state = Shunt::default();
            for period in 0..8 * 3000_u32 {
                let mut duty = u.to_phases().map(|u| 0.5 + u);
                let pulses = arrange(&c, &mut duty, period.is_multiple_of(PROBE_PERIODS));
                let signs = i.map(f64::signum);
                let course = Course::new(&pulses.0, signs, i);
                let [first, second] = pulses.0.sample.map(|t| course.at(1.0 + t).2);
                state.visible = shunt(&c, &pulses, &duty, signs).visible;
                state.currents(&c, period, &[first, second, 0.0], 0.0);
            }
            let found = state.swing.value();
            assert!((found / true_swing - 1.0).abs() < 0.02, "{found}, not {true_swing}");
        }
    }

    /// `2/√3 o` in each sector, `2√3/π o` in phase with the voltage over a turn, nothing at right angles.
    #[test]
    fn an_offset_of_the_shunt_is_a_current_in_phase_with_the_voltage() {
        let (offset, n) = (0.02, 3600);
        let (mut along, mut across) = (0.0, 0.0);
        for k in 0..n {
            let (s, c) = ((f64::from(k) + 0.5) * 360.0 / f64::from(n)).to_radians().sin_cos();
            let mut duty = AlphaBeta::new(0.2 * c, 0.2 * s).to_phases().map(|u| 0.5 + u);
            let pulses = arrange(&config(), &mut duty, false);
            let v = Visible::of(
                &config(),
                (&pulses.0, pulses.1, pulses.2),
                &duty,
                &Distortion::default(),
                (&AlphaBeta::default(), 0.0),
            );
            let mut shunt = Shunt { visible: [Some(v); 2], ..Shunt::default() };
            let error = AlphaBeta::<f64>::from_phases(shunt.currents(&config(), 0, &[offset; 3], 0.0).unwrap());
            assert!((error.norm_sq().sqrt() - 2.0 / 3f64.sqrt() * offset).abs() < 1e-12);
            assert_eq!(shunt.currents(&config(), 0, &[offset; 3], offset), Some([0.0; 3]));
            assert_eq!(shunt.zero(0, &[0.0, 0.0, offset]), Some(offset));
            along += (error.re() * c + error.im() * s) / f64::from(n);
            across += (error.im() * c - error.re() * s) / f64::from(n);
        }
        assert!((along / offset - 2.0 * 3f64.sqrt() / core::f64::consts::PI).abs() < 1e-5, "{along}");
        assert!(across.abs() < 1e-9, "{across}");
    }
}
