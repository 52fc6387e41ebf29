//! Symmetrical space-vector modulation, continuous or discontinuous.
//!
//! Phase references plus the common part `-(max + min)/2` centre the active vectors in the period; the
//! linear range ends at `|u| = u_dc/√3`. References that include the inverter compensation may exceed it;
//! duties are limited to [0, 1] always, and what the limited and quantised duties really apply is
//! returned to the flux estimator.
//!
//! **Discontinuous** (60° clamp, DPWM1): the common part holds the leg of the largest phase voltage at its rail, the upper
//! one for a positive voltage, so that it does not switch for two sixths of a turn: a third fewer edges. A clamped leg has
//! no dead time, so its loss is that of the threshold alone. The others keep a distance of at least `√3/2 |u|` from its
//! rail; with small voltages their pulses there would be shorter than the dead time, which is why the continuous one
//! is used below a settable voltage. The edge with which a leg enters or leaves its rail, one of 12 in a turn, is not in the
//! model.

use crate::scalar::{Real, Timer, clamp_seldom, likely};
use crate::space::AlphaBeta;

/// Duties of the three legs, in [0, 1].
pub type Duty<R> = [R; 3];

/// Duty at which the bridge applies no voltage.
pub fn zero_duty<R: Real>() -> Duty<R> {
    [R::HALF; 3]
}

/// Duties for phase voltages `u` (without regard to their common part) at a dc link of `1/inv_u_dc`, which is
/// at most 32.
#[inline(always)]
pub fn modulate<R: Real>(u: [R; 3], inv_u_dc: R, timer: Option<&Timer>) -> Duty<R> {
    modulate_lines([u[0] - u[2], u[1] - u[2]], inv_u_dc, timer)
}

/// [`modulate`] for the voltages of legs a and b less that of leg c.
#[inline(always)]
pub fn modulate_lines<R: Real>([a, b]: [R; 2], inv_u_dc: R, timer: Option<&Timer>) -> Duty<R> {
    // Largest and smallest of the three by magnitudes instead of comparisons, with the third one as zero:
    // max(x, 0) = (x + |x|)/2. So `hi + lo` and `hi - lo` take no branch.
    let (sum, distance) = (a + b, (a - b).abs());
    let larger = (sum + distance).half();
    let smaller = sum - larger;
    let (p, q) = (larger.abs(), smaller.abs());
    let span = distance + p + q;

    // The common part is (sum + p - q)/4, leg c has nothing else.
    let c = R::HALF - (sum + p - q) * inv_u_dc.quarter();
    let mut duty = [a * inv_u_dc + c, b * inv_u_dc + c, c];
    // The duties lie at half ± span/4: one comparison for all six limits.
    if !likely(span * inv_u_dc <= R::from_f64(1.9999)) {
        for d in &mut duty {
            *d = clamp_seldom(*d, R::ZERO, R::ONE);
        }
    }
    match timer {
        Some(t) => [duty[0].quantise(t).1, duty[1].quantise(t).1, duty[2].quantise(t).1],
        None => duty,
    }
}

/// Leg that discontinuous modulation holds at a rail: that of the largest phase voltage, and whether at the upper one.
#[inline(never)]
pub fn clamped_leg<R: Real>(u: &[R; 3]) -> (usize, bool) {
    let [a, b, c] = u.map(R::abs);
    let leg = if a >= b && a >= c {
        0
    } else if b >= c {
        1
    } else {
        2
    };
    (leg, u[leg] >= R::ZERO)
}

/// [`modulate`] with a leg held at the upper rail, or at the lower one.
#[inline(never)]
pub fn modulate_clamped<R: Real>(
    u: [R; 3],
    (leg, upper): (usize, bool),
    inv_u_dc: R,
    timer: Option<&Timer>,
) -> Duty<R> {
    let (at, rail) = (u[leg], if upper { R::ONE } else { R::ZERO });
    u.map(|x| {
        let duty = clamp_seldom(rail + (x - at) * inv_u_dc, R::ZERO, R::ONE);
        timer.map_or(duty, |t| duty.quantise(t).1)
    })
}

/// Voltage vector that ideal legs apply with these duties, per unit of dc link.
#[inline]
pub fn applied<R: Real>(duty: &Duty<R>) -> AlphaBeta<R> {
    AlphaBeta::from_phases(*duty)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;
    use proptest::prelude::*;

    #[test]
    fn linear_up_to_u_dc_over_root_three() {
        let u_dc = 1.65_f64;
        for k in 0..360 {
            let (s, c) = f64::from(k).to_radians().sin_cos();
            let a = u_dc / 3f64.sqrt() * 0.9999;
            let u = AlphaBeta::new(a * c, a * s);
            let duty = modulate(u.to_phases(), 1.0 / u_dc, None);
            assert!((applied(&duty) * u_dc - u).norm_sq() < 1e-24);
        }
    }

    #[test]
    fn a_clamped_leg_stays_at_its_rail_and_the_voltage_is_the_same() {
        let u_dc = 1.65_f64;
        let mut clamped = [0; 3];
        for k in 0..360 {
            let (s, c) = (f64::from(k) + 0.5).to_radians().sin_cos();
            let a = u_dc / 3f64.sqrt() * 0.9999;
            let u = AlphaBeta::new(a * c, a * s);
            let (leg, upper) = clamped_leg(&u.to_phases());
            let duty = modulate_clamped(u.to_phases(), (leg, upper), 1.0 / u_dc, None);
            assert!((applied(&duty) * u_dc - u).norm_sq() < 1e-24);
            assert_eq!(duty[leg], if upper { 1.0 } else { 0.0 });
            clamped[leg] += 1;
        }
        assert_eq!(clamped, [120; 3]);
    }

    #[test]
    fn quantised_duties_are_whole_counts() {
        fn nearest<R: Real>(rounding: f64) {
            let timer = Timer::new(8500).unwrap();
            for k in 0..1000 {
                let x = R::from_f64(f64::from(k) / 999.0);
                let (counts, duty) = x.quantise(&timer);
                assert!((f64::from(counts) - x.to_f64() * 8500.0).abs() < 0.5 + rounding, "{}: {counts}", x.to_f64());
                assert!((duty.to_f64() * 8500.0 - f64::from(counts)).abs() < rounding, "{counts}: {}", duty.to_f64());
            }
            assert_eq!(R::ONE.quantise(&timer), (8500, R::ONE));
        }
        nearest::<f64>(1e-9);
        nearest::<f32>(1e-3);
        nearest::<Q>(1e-3);
    }

    proptest! {
        #[test]
        fn duties_stay_between_zero_and_one(a: i32, b: i32, c: i32, v in 1i32 << 19..) {
            let u = [Q::from_bits(a), Q::from_bits(b), Q::from_bits(c)];
            for d in modulate(u, Q::from_bits(v), Some(&Timer::new(8500).unwrap())) {
                prop_assert!(d >= Q::ZERO && d <= Q::ONE);
            }
            for leg in 0..3 {
                for d in modulate_clamped(u, (leg, a < 0), Q::from_bits(v), Some(&Timer::new(8500).unwrap())) {
                    prop_assert!(d >= Q::ZERO && d <= Q::ONE);
                }
            }
            let f = u.map(|x| x.to_f64() as f32 * 1e30);
            for d in modulate(f, Q::from_bits(v).to_f64() as f32, None) {
                prop_assert!((0.0..=1.0).contains(&d));
            }
        }
    }
}
