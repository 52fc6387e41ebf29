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
//! and from there to the mean of the period, of which pulses out of the centre hold the current off,
//!
//! ```text
//! i_k -= K (p_k - (p_a + p_b + p_c)/3),    p = d (f - r)/2 = d (f - d)
//! ```
//!
//! which at zero voltage is half of the swing `K m` that the shifted pulses make: 90 mA at 2.2 kW and 0.9 A at 11 kW with
//! 4.5 µs, systematic and with a sign that changes with the order of the legs. It is therefore corrected with the leakage
//! inductance of the parameters. The change of the currents' mean over the last quarter of the period is left out: at
//! 50 Hz and 10 kHz that is 0.5° of the current.
//!
//! **Offset.** With an offset `o` of the one amplifier the largest phase reads `i + o`, the smallest `i - o`, the middle
//! one is right: an error `2/√3 o` in the direction of the middle of the present sector of the voltage. It turns with the
//! voltage in six steps, and on average over a turn it is `2√3/π o = 1.10 o` in phase with it: a wrong resistance rather
//! than an offset, and no constant that an estimator of offsets would find. But in the zero vector the shunt carries no
//! current: a third sample there, at the end of the period, shows the offset itself. It is followed with [`RATE`].
//!
//! **Validity.** Continuous modulation with one update of the duties per carrier period or fewer; the largest voltage
//! falls by the factor `1 - m`. While the bridge is blocked nothing is seen; no current is taken to flow then.

use crate::control::modulator::Duty;
use crate::inverter::Distortion;
use crate::scalar::Real;
use crate::space::AlphaBeta;
use crate::words::words;

/// Part of the deviation from the offset that is taken over in every period: a tenth of a second at 10 kHz.
pub(crate) const RATE: f64 = 1.0 / 1024.0;

/// Settings of the single shunt, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct ShuntConfig<R: Real> {
    /// Window in parts of half of the carrier period, a whole and even number of timer counts; 0: pulses stay centred.
    pub(crate) window: R,
    /// `T/(2 σl_s)`.
    pub(crate) gain: R,
}
words!(ShuntConfig: window, gain);

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

/// Legs by their duties, the largest first.
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
    /// Correction of the largest and of the smallest leg's current.
    correction: [R; 2],
    /// The zero vector at the end lasts as long as a window.
    zero: bool,
}

/// Pulses in which both states last for a window, and the order of the legs. The duties are limited to what that needs.
#[inline(never)]
pub(crate) fn arrange<R: Real>(c: &ShuntConfig<R>, duty: &mut Duty<R>) -> (Pulses<R>, Order) {
    let order = Order::of(duty);
    let [max, mid, min] = order.ranked(duty);
    let m = c.window;
    if m == R::ZERO {
        return (Pulses { rising: *duty, falling: *duty, sample: [mid, max] }, order);
    }
    let d = [max.clamp(m, R::ONE), mid.clamp(m.half(), R::ONE - m.half()), min.clamp(R::ZERO, R::ONE - m)];
    let f_mid = d[1].clamp(m, R::ONE - m);
    let f_max = d[0].max(f_mid + m).min(R::ONE);
    let f = [f_max, f_mid, d[2].min(f_mid - m).max(R::ZERO)];
    // Within 0 … 1 but for the rounding of the arithmetic.
    let r = [0, 1, 2].map(|k| (d[k] + (d[k] - f[k])).clamp(R::ZERO, R::ONE));
    *duty = order.legs(d);
    (Pulses { rising: order.legs(r), falling: order.legs(f), sample: [f_mid, f_max] }, order)
}

impl<R: Real> Visible<R> {
    /// For pulses with their duties, the loss of the inverter model and the mean voltage `u` in their period.
    #[inline(never)]
    pub fn of(
        c: &ShuntConfig<R>,
        (pulses, order): (&Pulses<R>, Order),
        duty: &Duty<R>,
        loss: &Distortion<R>,
        (u, u_dc): (&AlphaBeta<R>, R),
    ) -> Self {
        let (f, d, u) = (order.ranked(&pulses.falling), order.ranked(duty), order.ranked(&u.to_phases()));
        let third = R::from_f64(1.0 / 3.0);
        // A falling edge waits for the dead time where the current is negative. As a voltage over half a period.
        let late = order.ranked(&loss.phases);
        let late = late.map(|e| (loss.full - loss.least - (e - loss.least).max(R::ZERO)) * R::TWO);
        let at_end = [
            (late[0] + late[0]) * third - u[0] * (R::ONE - f[0]),
            -((f[0] - f[1]) * u_dc + late[0] + late[1]) * third - u[2] * (R::ONE - f[1]),
        ];
        let moment = [0, 1, 2].map(|k| d[k] * (f[k] - d[k]));
        let common = (moment[0] + moment[1] + moment[2]) * third;
        let correction =
            [(at_end[0] - (moment[0] - common) * u_dc) * c.gain, (at_end[1] - (moment[2] - common) * u_dc) * c.gain];
        Self { order, correction, zero: R::ONE - f[0] >= c.window }
    }

    /// Phase currents of the readings, in the order of their instants, and the offset in them.
    #[inline(never)]
    pub fn currents(&self, [two_legs, one_leg, _]: &[R; 3], offset: R) -> [R; 3] {
        let max = *one_leg - offset + self.correction[0];
        let min = offset - *two_legs + self.correction[1];
        self.order.legs([max, -(max + min), min])
    }

    /// The reading that shows the offset, if the zero vector is long enough.
    pub fn offset(&self, [.., zero]: &[R; 3]) -> Option<R> {
        self.zero.then_some(*zero)
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
                let late = |edge: bool| if (signs[leg] > 0.0) == edge { DEAD } else { 0.0 };
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
        ShuntConfig { window: R::from_f64(0.1), gain: R::from_f64(1.0 / LEAKAGE) }
    }

    /// What the shunt reads in the pulses of duties, and the currents that its readings are taken for.
    fn seen(duty: [f64; 3], currents: [f64; 3], gain: f64) -> ([f64; 3], [f64; 3]) {
        let c = ShuntConfig { gain, ..config() };
        let mut duty = duty;
        let (pulses, order) = arrange(&c, &mut duty);
        // The model's loss is relative to the whole period, of two units.
        let loss = Distortion { phases: currents.map(|i| DEAD / 2.0 * i.signum()), least: 0.0, full: DEAD / 2.0 };
        let u = crate::control::modulator::applied(&duty) - loss.vector();
        let course = Course::new(&pulses, currents.map(f64::signum), currents);
        let readings = [course.at(1.0 + pulses.sample[0]).2, course.at(1.0 + pulses.sample[1]).2, 0.0];
        let mean = course.at(2.0).1.map(|sum| sum / 2.0);
        (Visible::of(&c, (&pulses, order), &duty, &loss, (&u, 1.0)).currents(&readings, 0.0), mean)
    }

    proptest! {
        #[test]
        fn readings_of_any_duties_and_currents_are_the_mean_currents_of_the_period(
            a in 0.06..0.94f64, b in 0.06..0.94f64, c in 0.06..0.94f64, i_a in 0.3..3.0f64, share in 0.1..0.9f64, turn in 0..6usize,
        ) {
            let mut i = [i_a, -share * i_a, -(1.0 - share) * i_a];
            i.rotate_right(turn % 3);
            let i = i.map(|x| if turn < 3 { x } else { -x });
            let (got, want) = seen([a, b, c], i, config().gain);
            for k in 0..3 {
                // Dead time moves the middle of every pulse by half of it, as with sensors in the phases.
                prop_assert!((got[k] - want[k]).abs() < DEAD / 2.0 / LEAKAGE, "{got:?} {want:?}");
            }
        }

        #[test]
        fn both_states_last_for_the_window_and_the_duties_are_kept(
            d in proptest::array::uniform3(0.0..=1.0f64), near in 0.0..0.1f64, nearly in any::<bool>(),
        ) {
            let d = if nearly { d.map(|x| 0.5 + near * (x - 0.5)) } else { d };
            last::<f64>(d, 1e-12)?;
            last::<f32>(d, 1e-6)?;
            last::<Q>(d, 1e-6)?;
        }
    }

    fn last<R: Real>(d: [f64; 3], tolerance: f64) -> Result<(), TestCaseError> {
        let m = config::<f64>().window;
        let asked = d.map(R::from_f64);
        let mut duty = asked;
        let (pulses, order) = arrange(&config::<R>(), &mut duty);
        let [max, mid, min] = order.ranked(&pulses.falling).map(R::to_f64);
        prop_assert!(max - mid > m - tolerance && mid - min > m - tolerance, "{max} {mid} {min}");
        prop_assert_eq!(pulses.sample.map(R::to_f64), [mid, max]);
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
            let (got, want) = seen(u.to_phases().map(|u| 0.5 + u), i.to_phases(), gain);
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
        let c = ShuntConfig { window: (m / full) as f32, gain: 0.1 };
        for (a, b) in [(4300, 4180), (4250, 4250), (8499, 8400), (120, 3), (8500, 0)] {
            let mut duty = [a, b, 4250].map(|n| (f64::from(n) / full) as f32);
            let (pulses, _) = arrange(&c, &mut duty);
            for x in pulses.rising.into_iter().chain(pulses.falling).chain(pulses.sample) {
                let n = f64::from(x) * full;
                assert!((n - n.round()).abs() < 2e-3, "{n}");
            }
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
            let (pulses, order) = arrange(&config(), &mut duty);
            let loss = Distortion::default();
            let v = Visible::of(&config(), (&pulses, order), &duty, &loss, (&AlphaBeta::default(), 0.0));
            let error = AlphaBeta::<f64>::from_phases(v.currents(&[offset; 3], 0.0));
            assert!((error.norm_sq().sqrt() - 2.0 / 3f64.sqrt() * offset).abs() < 1e-12);
            assert_eq!(v.currents(&[offset; 3], offset), [0.0; 3]);
            assert_eq!(v.offset(&[0.0, 0.0, offset]), Some(offset));
            along += (error.re() * c + error.im() * s) / f64::from(n);
            across += (error.im() * c - error.re() * s) / f64::from(n);
        }
        assert!((along / offset - 2.0 * 3f64.sqrt() / core::f64::consts::PI).abs() < 1e-5, "{along}");
        assert!(across.abs() < 1e-9, "{across}");
    }
}
