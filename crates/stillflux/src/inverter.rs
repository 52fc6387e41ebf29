//! Nonlinear inverter model: equations (4)-(7) of the paper, dead time, and node capacitance of the legs. Per unit.
//!
//! ```text
//! u_th(i_s) = 4/3 u_th sec(i_s),   sec(i_s) = 1/2 (sign i_a + a sign i_b + a² sign i_c)     (5), (6)
//! u_s = u*_inv - u_th(i_s) - r_d i_s                                                         (7)
//! ```
//!
//! A leg that commutates with dead time `T_d` also loses `U = T_d/T_s u_dc` of its average voltage in the direction of
//! its current. The term `r_d i_s` is *not* compensated: it is in series with the winding and `r̂_s` identifies the sum
//! (Section III-E).
//!
//! **Near current zero** the node of a leg has a capacitance `C` (switches, cable, motor), and in the dead time the
//! phase current has to move its charge. When the switch that carries `i` turns off, the node ramps with `i/C` and
//! reaches the other rail after `C u_dc/|i|`; until then the leg applies part of the old voltage. Per period, with
//! `I_k = C u_dc/T_d`,
//!
//! ```text
//! e(i)/U = 1 - I_k/(2|i|)     |i| ≥ I_k     the ramp ends within the dead time
//!        = |i|/(2 I_k)        |i| < I_k     the other switch ends it
//! ```
//!
//! in the direction of the current. `I_k` is the *knee*; at ten times the knee 5 % of the loss are still missing. The
//! threshold does not follow this curve: outside the dead time a device conducts, however small the current is.
//!
//! **Ripple.** `e` depends on the current at the edges, and that is not the sampled one. While the nodes of the other legs
//! are at different rails the current of a leg moves with `u_dc/(3 L_σ)`, while its own node is high with
//! `2 u_dc/(3 L_σ)`, and all the time with the voltage `u` that the machine has in that phase. With the voltages `v` that the
//! legs are commanded, `u` and the loss, and the current `i` sampled in the middle of the lower zero vector,
//!
//! ```text
//! e(i) = max(e(i_f), 0) + min(e(i_r), 0)                                       the falling edge, the rising one
//! i_r = i - 3/2 g u - Σ_x (g (v_x - v) - s ([i_x > 0] - δ))⁺                    g = T/(6 L_σ),  s = u_dc T_d/(3 L_σ)
//! i_f = i + 3/2 g u + Σ_x (g (v_x - v) + s ([i_x < 0] - δ))⁺ - 2 s (1 - δ) + 4 g max(e(i_f), 0)
//! ```
//!
//! over the other two legs `x`, `T` the period of the carrier. The last term is the earlier fall of the own node. `δ` is the
//! part of the dead time after which the current has its mean, weighted by the charge that it still moves: a third for a
//! ramp that takes all of the dead time, less for a shorter one; 1/3 - 0.27 |e|/U, fitted, is taken. The start is the
//! first approximation `e(i - s/2)`, in which `s/2 = u_dc T_d/(6 L_σ)` is the mean of both differences for a small current
//! without `u`; two steps follow.
//!
//! Against the integration of one period in which a leg passes zero while the others carry rated current (2.2 kW, within
//! three times the knee) the first approximation alone is off by 0.11 V rms with 2 µs and 1 nF, by 0.22 V if the machine
//! has 30 V in that phase, and by 0.32 V with 4 µs; with both edges 0.02, 0.04 and 0.04 V are left. Beyond three times
//! the knee, and in the first approximation beyond the knee, `e(i)` is taken. The difference of both is computed for one leg
//! in every fourth period, up to the voltage at whose speed the currents turn by 5° until it is the leg's turn again, at most
//! 0.25 pu: where it counts, near zero stator frequency, they move slowly. (Sampled in the upper zero vector the signs change.)
//!
//! **Double update.** In a half period of the carrier each leg has one edge, a rising one in the half that begins in the
//! lower zero vector, a falling one in the other. The rising edge loses all of the dead time for `i > 0` and what the node
//! ramps for `i < 0`, the falling one the reverse with the other sign. Per half period, relative to its length and with
//! the dead-time part `e_d` of `e`,
//!
//! ```text
//! rising: e - |e_d| + 2U        falling: e + |e_d| - 2U
//! ```
//!
//! `2U` is common to the legs and no voltage of the machine. The loss of both is `e`, and it is `e` of a current that is
//! the mean of both samples, so that the mean of their differences from the current at the edges cancels; the ripple is
//! left out.
//!
//! Without capacitance a small current reaches zero within the dead time and stays there (both switches are open),
//! so the error passes from one sign to the other over a band of at most `(2/3) u_dc T_d/L_σ`, and narrower where the
//! legs commutate together (on the plant half of it at 2.2 kW, a tenth at 11 kW, both at standstill). With a modelled
//! band wider than the real one the angles at which a phase current is zero are stable equilibria of a field at rest,
//! and the voltage is most uncertain there; with a narrower one they are unstable. The model takes a tenth of that
//! band, for the threshold and, unless the knee is larger, for the dead time.
//!
//! **Unequal legs.** Switches turn on and off later than they are told, drivers and optocouplers delay one edge more than
//! the other. With the delays `t_on`, `t_off` of the upper (u) and of the lower (l) switch the pulse of a leg is longer
//! than commanded by
//!
//! ```text
//! a = t_off,u - t_on,u   for i > 0,        b = t_on,l - t_off,l   for i < 0
//! e → e - u_dc/T_s ((a + b)/2 + (a - b)/2 sign i)
//! ```
//!
//! What is common to the legs is no voltage of the machine, or one of the dead time. The difference of the even parts
//! `(a + b)/2` is a constant voltage, that of the odd parts `(a - b)/2` are unequal dead times: 50 ns are 0.27 V at
//! 540 V and 10 kHz ([`Legs`]). Below the knee the odd part falls with the current as the loss itself; the even one
//! is taken as constant there too, where it depends on the turn-on delays alone.
//!
//! **Validity.** One constant capacitance, equal in all legs. Where the node and the leakage oscillate within the dead
//! time, `T_d² > 3 L_σ C`, the edges are no longer told apart as above. Delays do not depend on the current. The knee is limited to 1 pu, the band to 2e-4 … 0.05 pu, the differences of the legs to
//! [`LEGS_MAX`].

#[cfg(feature = "ripple")]
mod ripple;

use crate::base::{PerUnit, rounded};
use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;
use crate::words::{Words, words};

/// Least half width of the linear part, relative to the band of current-zero clamping.
const BAND: f64 = 0.1;
/// Keeps reciprocals of small currents within the fixed-point range.
const SCALE: f64 = 64.0;
/// Largest knee, per unit.
const KNEE_MAX: f64 = 1.0;
/// Largest component of [`Legs`]: 1 µs at 10 kHz.
pub const LEGS_MAX: f64 = 0.01;

/// What the pulses of the legs are longer than commanded, as part of the period; the space vectors of the three legs, so
/// that what is common to them is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Legs<R: Real> {
    /// `(a + b)/2`, a constant voltage.
    pub even: AlphaBeta<R>,
    /// `(a - b)/2`, in the direction of the current: unequal dead times.
    pub odd: AlphaBeta<R>,
}
words!(Legs: even, odd);

impl<R: Real> Legs<R> {
    /// Of the three legs, by what their pulses are longer as part of the period, for a positive and for a negative current.
    #[must_use]
    pub fn new(of_period: &[[f64; 2]; 3]) -> Self {
        let part = |sign: f64| {
            let of = AlphaBeta::<f64>::from_phases(of_period.map(|[plus, minus]| 0.5 * (plus + sign * minus)));
            AlphaBeta::new(rounded(of.re()), rounded(of.im()))
        };
        Self { even: part(1.0), odd: part(-1.0) }
    }

    /// The same of the three legs, less what is common to them.
    #[must_use]
    pub fn of_period(&self) -> [[f64; 2]; 3] {
        let (even, odd) = (self.even.to_phases().map(R::to_f64), self.odd.to_phases().map(R::to_f64));
        [0, 1, 2].map(|k| [even[k] + odd[k], even[k] - odd[k]])
    }

    /// Each component within its limit.
    #[cold]
    #[inline(never)]
    pub fn limited(&self) -> Self {
        let bound = R::from_f64(LEGS_MAX);
        Self { even: self.even.limit_components(bound), odd: self.odd.limit_components(bound) }
    }

    /// Loss of each leg for a positive and for a negative current, at a dc link.
    #[cfg(feature = "legs")]
    #[inline(never)]
    fn loss(&self, u_dc: R) -> [[R; 2]; 3] {
        let (even, odd) = ((self.even * u_dc).to_phases(), (self.odd * u_dc).to_phases());
        [0, 1, 2].map(|k| [-even[k] - odd[k], odd[k] - even[k]])
    }
}

/// Parameters of the inverter model, per unit, and the curve that follows from them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct InverterModel<R: Real> {
    parameters: Parameters<R>,
    /// The curve for their knee and legs.
    nominal: Knee<R>,
}

/// What determines an [`InverterModel`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Parameters<R: Real> {
    /// Threshold voltage.
    u_th: R,
    /// Dead time as part of the period.
    dead_time: R,
    /// Least half width of the linear part, and its reciprocal over `SCALE`.
    band: R,
    inv_band: R,
    /// The knee `I_k`.
    knee: R,
    /// Sampled current less that at the edges, near current zero: `u_dc T_d/(6 L_σ)`, and `T/(6 L_σ)`.
    shift: R,
    #[cfg(feature = "ripple")]
    ripple: R,
    /// Square of the largest voltage with which the ripple of the currents is computed.
    #[cfg(feature = "ripple")]
    ripple_within_sq: R,
    /// Differences of the legs, and the rated dc link.
    #[cfg(feature = "legs")]
    legs: Legs<R>,
    #[cfg(feature = "legs")]
    u_dc: R,
}
words!(Parameters: u_th, dead_time, band, inv_band, knee, shift,
    #[cfg(feature = "ripple")] ripple, #[cfg(feature = "ripple")] ripple_within_sq,
    #[cfg(feature = "legs")] legs, #[cfg(feature = "legs")] u_dc);

/// The curve follows from the parameters and is not stored.
impl<R: Real> Words for InverterModel<R> {
    const LEN: usize = Parameters::<R>::LEN;
    const LAYOUT: u32 = Parameters::<R>::LAYOUT;
    const BLANK: Self = Self { parameters: Parameters::BLANK, nominal: Knee::BLANK };
    fn is_representable(&self) -> bool {
        self.parameters.is_representable()
    }
    fn put(&self, out: &mut impl FnMut(u32)) {
        self.parameters.put(out);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        self.parameters.fill(from);
        *self = self.parameters.model();
    }
}

impl<R: Real> Parameters<R> {
    fn model(self) -> InverterModel<R> {
        let mut nominal = Knee::default();
        nominal.set(self.knee, self.band);
        #[cfg(feature = "legs")]
        nominal.set_legs(&self.legs, self.u_dc);
        InverterModel { parameters: self, nominal }
    }
}

/// Curve of a leg's loss over its current, for one knee. Constant between two updates of the estimated knee.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Knee<R: Real> {
    /// Half width of the linear part.
    width: R,
    /// Its slope, over `SCALE`.
    slope: R,
    /// [`Real::dividend`] of `SCALE I_k/2`.
    tail: R,
    /// `1/(SCALE width)`.
    inv_width: R,
    /// Loss of each leg by its delays, for a positive and for a negative current.
    #[cfg(feature = "legs")]
    legs: [[R; 2]; 3],
}

impl<R: Real> Knee<R> {
    /// To be set.
    const BLANK: Self = Self {
        width: R::ZERO,
        slope: R::ZERO,
        tail: R::ZERO,
        inv_width: R::ZERO,
        #[cfg(feature = "legs")]
        legs: [[R::ZERO; 2]; 3],
    };

    /// The curve for another knee and a least half width of the linear part; the legs stay.
    #[inline(always)]
    fn set(&mut self, knee: R, band: R) {
        let scale = R::from_f64(SCALE);
        self.width = knee.max(band);
        // Where the tail begins the loss is 1 - I_k/(2 width) of the whole.
        let inv_width = (self.width * scale).recip();
        let tail = knee.half() * scale;
        // Here, and not in every period: the dividend of a product is that of one factor times the other.
        self.tail = tail.dividend();
        self.inv_width = inv_width;
        self.slope = inv_width * (R::ONE - tail * inv_width);
    }

    /// Loss of a leg by its delays, for a positive (0) and for a negative current (1). Without the feature a negative zero,
    /// whose addition the compiler omits.
    #[inline(always)]
    #[cfg_attr(not(feature = "legs"), allow(clippy::unused_self))]
    fn delay(&self, leg: usize, sign: usize) -> R {
        #[cfg(feature = "legs")]
        return self.legs[leg][sign];
        #[cfg(not(feature = "legs"))]
        {
            let _ = (leg, sign);
            -R::ZERO
        }
    }

    /// Loss of a leg by its delays near current zero.
    #[inline(never)]
    fn delays_near_zero(&self, i: R, leg: usize) -> R {
        let (plus, minus) = (self.delay(leg, 0), self.delay(leg, 1));
        let (even, odd) = ((plus + minus).half(), (plus - minus).half());
        even + odd * (i * self.inv_width * R::from_f64(SCALE)).limit(R::ONE)
    }

    /// Loss of a leg by its dead time, relative to that far from current zero.
    #[inline(always)]
    fn part(&self, i: R) -> R {
        let part = self.part_of(i.abs());
        if i < R::ZERO { -part } else { part }
    }

    /// The same for a positive current.
    #[inline(always)]
    fn part_of(&self, i: R) -> R {
        if i > self.width { R::ONE - self.tail.over_64(i) } else { i * self.slope * R::from_f64(SCALE) }
    }

    /// Other differences of the legs, at a dc link.
    #[cfg(feature = "legs")]
    #[inline(always)]
    pub fn set_legs(&mut self, legs: &Legs<R>, u_dc: R) {
        self.legs = legs.loss(u_dc);
    }
}

/// Voltage lost in each phase, and its limits, per unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Distortion<R: Real> {
    /// Loss of each phase: add it to the reference to compensate.
    pub phases: [R; 3],
    /// Its part by the delays of the leg.
    #[cfg(feature = "legs")]
    pub legs: [R; 3],
    /// Its part without the dead time, `u_th`.
    pub least: R,
    /// The whole of it far from current zero, `u_th + U`.
    pub full: R,
}

impl<R: Real> Distortion<R> {
    /// The loss as a space vector.
    #[inline(always)]
    pub fn vector(&self) -> AlphaBeta<R> {
        AlphaBeta::from_phases(self.phases)
    }

    /// Loss of each phase without its part by the delays of the leg.
    #[cfg(feature = "shunt")]
    #[inline(always)]
    pub(crate) fn without_delays(&self) -> [R; 3] {
        #[cfg(feature = "legs")]
        return [0, 1, 2].map(|k| self.phases[k] - self.legs[k]);
        #[cfg(not(feature = "legs"))]
        self.phases
    }

    /// The loss without the dead time of a leg that does not switch.
    #[inline(never)]
    pub fn without_edges(mut self, leg: usize) -> Self {
        self.phases[leg] = self.phases[leg].limit(self.least);
        self
    }

    /// Loss of each phase in a half period of the carrier with the rising edges, or with the falling ones, less what is
    /// common to the phases.
    #[inline(never)]
    pub fn of_half(&self, rising: bool, clamped: Option<usize>) -> [R; 3] {
        let mut phases = self.phases.map(|e| {
            let dead = (e.abs() - self.least).max(R::ZERO);
            if rising { e - dead } else { e + dead }
        });
        if let Some(leg) = clamped {
            // It lacks what is common to the others.
            let common = (self.full - self.least) * R::TWO;
            phases[leg] += if rising { -common } else { common };
        }
        phases
    }

    #[inline(never)]
    fn leg_by_knee(&self, e: R) -> R {
        let magnitude = (e.abs() - self.least).min(self.full - e.abs()).max(R::ZERO);
        if e < R::ZERO { -magnitude } else { magnitude }
    }

    /// Decrease of the loss of each phase per relative increase of the knee,
    /// `-∂e/∂ln I_k = min(e, U - e)` for a positive current.
    #[inline(always)]
    pub fn by_knee(&self) -> [R; 3] {
        let [a, b, c] = self.phases;
        #[cfg(feature = "legs")]
        let [a, b, c] = [a - self.legs[0], b - self.legs[1], c - self.legs[2]];
        [self.leg_by_knee(a), self.leg_by_knee(b), self.leg_by_knee(c)]
    }
}

impl<R: Real> InverterModel<R> {
    /// Model of an inverter that feeds a machine.
    #[must_use]
    pub fn new(pu: &PerUnit) -> Self {
        let width = (BAND * pu.dead_time_swing).clamp(2e-4, 0.05);
        let r = R::from_f64;
        let (band, knee) = (r(width), r(pu.knee.min(KNEE_MAX)));
        let edges = pu.knee > 0.0 && !pu.double_update;
        Parameters {
            u_th: r(pu.u_th),
            dead_time: r(pu.dead_time),
            band,
            inv_band: r(1.0 / (SCALE * width)),
            knee,
            shift: r(if edges { 0.25 * pu.dead_time_swing } else { 0.0 }),
            #[cfg(feature = "ripple")]
            ripple: r(if edges { 0.25 * pu.dead_time_swing / (pu.dead_time * pu.u_dc) } else { 0.0 }),
            #[cfg(feature = "ripple")]
            ripple_within_sq: r(ripple::largest_voltage_sq(pu)),
            #[cfg(feature = "legs")]
            legs: Legs::new(&pu.legs),
            #[cfg(feature = "legs")]
            u_dc: r(pu.u_dc),
        }
        .model()
    }

    /// A model of an ideal inverter: no compensation.
    #[must_use]
    pub fn ideal() -> Self {
        let (knee, band, inv_band) = (R::ZERO, R::ONE, R::from_f64(1.0 / SCALE));
        Parameters {
            u_th: R::ZERO,
            dead_time: R::ZERO,
            band,
            inv_band,
            knee,
            shift: R::ZERO,
            #[cfg(feature = "ripple")]
            ripple: R::ZERO,
            #[cfg(feature = "ripple")]
            ripple_within_sq: R::ZERO,
            #[cfg(feature = "legs")]
            legs: Legs::default(),
            #[cfg(feature = "legs")]
            u_dc: R::ZERO,
        }
        .model()
    }

    /// The curve for a knee `relative` times that of the parameters.
    pub fn knee(&self, relative: R) -> Knee<R> {
        let mut knee = self.nominal;
        self.follow(&mut knee, relative);
        knee
    }

    /// Moves a curve to the knee `relative` times that of the parameters; its legs stay.
    #[inline(never)]
    pub fn follow(&self, knee: &mut Knee<R>, relative: R) {
        knee.set((self.parameters.knee * relative).min(R::from_f64(KNEE_MAX)), self.parameters.band);
    }

    /// Differences of the legs of the parameters.
    #[cfg(feature = "legs")]
    #[inline(always)]
    pub fn legs(&self) -> &Legs<R> {
        &self.parameters.legs
    }

    /// The curve for the knee of the parameters.
    #[inline(always)]
    pub fn nominal(&self) -> &Knee<R> {
        &self.nominal
    }

    /// Voltage lost in each phase at the phase currents of `i_s`: add it to the reference to compensate. `gain`
    /// is the estimated factor of threshold and dead time, `1 + v̂`; one is the parameters'. The ripple is in it by the
    /// first approximation alone ([`InverterModel::ripple`]).
    // Inlined in floating point. In fixed point it would take the integer registers that the rest of the period needs: a drive
    // step with it inlined takes 20 instructions more than with a call.
    #[inline(always)]
    pub fn distortion(&self, knee: &Knee<R>, i_s: &AlphaBeta<R>, u_dc: R, gain: R) -> Distortion<R> {
        if R::FLOATING { self.loss(knee, i_s, u_dc, gain) } else { self.loss_by_call(knee, i_s, u_dc, gain) }
    }

    #[inline(never)]
    fn loss_by_call(&self, knee: &Knee<R>, i_s: &AlphaBeta<R>, u_dc: R, gain: R) -> Distortion<R> {
        self.loss(knee, i_s, u_dc, gain)
    }

    #[inline(always)]
    fn loss(&self, knee: &Knee<R>, i_s: &AlphaBeta<R>, u_dc: R, gain: R) -> Distortion<R> {
        let (least, dead) = (self.parameters.u_th * gain, self.parameters.dead_time * u_dc * gain);
        let full = least + dead;
        let tail = dead * knee.tail;
        // A branch for each sign costs less than magnitude and sign apart.
        let (negative_width, negative_full) = (-knee.width, -full);
        let leg = |i: R, k: usize| {
            if likely(i > knee.width) {
                let own = knee.delay(k, 0);
                (full - tail.over_64(i) + own, own)
            } else if likely(i < negative_width) {
                let own = knee.delay(k, 1);
                (negative_full - tail.over_64_of_negative(i) + own, own)
            } else {
                let own = if cfg!(feature = "legs") { knee.delays_near_zero(i, k) } else { -R::ZERO };
                (self.near_zero(knee, i - self.parameters.shift, least, dead) + own, own)
            }
        };
        let [a, b, c] = i_s.to_phases();
        let [a, b, c] = [leg(a, 0), leg(b, 1), leg(c, 2)];
        Distortion {
            phases: [a.0, b.0, c.0],
            #[cfg(feature = "legs")]
            legs: [a.1, b.1, c.1],
            least,
            full,
        }
    }

    /// Loss of a leg in the linear part of its curve.
    #[inline(never)]
    fn near_zero(&self, knee: &Knee<R>, i: R, least: R, dead: R) -> R {
        let e = least * (i.abs() * self.parameters.inv_band * R::from_f64(SCALE)).min(R::ONE);
        dead * knee.part(i) + if i < R::ZERO { -e } else { e }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Inverter, Machine};

    fn model() -> (InverterModel<f64>, PerUnit) {
        let (m, inv) = (Machine::preset_2k2(), Inverter { dead_time: 0.0, c_out: 0.0, ..Inverter::preset_2k2() });
        let pu = PerUnit::new(&m, &inv).unwrap();
        (InverterModel::new(&pu), pu)
    }

    #[test]
    fn threshold_vector_has_six_positions_of_four_thirds_u_th() {
        let (model, pu) = model();
        for k in 0..360 {
            let (s, c) = (f64::from(k) + 0.5).to_radians().sin_cos();
            let u = model.distortion(&model.knee(1.0), &AlphaBeta::new(c, s), pu.u_dc, 1.0).vector();
            assert!((u.norm_sq().sqrt() - 4.0 / 3.0 * pu.u_th).abs() < 1e-12);
            let angle = u.im().atan2(u.re()).to_degrees().rem_euclid(60.0);
            assert!(!(1e-6..=59.999_999).contains(&angle), "sector indicator points to multiples of 60°");
        }
    }

    #[test]
    fn around_current_zero_the_model_is_linear() {
        let (model, pu) = model();
        let at = |i: f64| model.distortion(&model.knee(1.0), &AlphaBeta::new(i, 0.0), pu.u_dc, 1.0).phases[0];
        assert_eq!(at(0.0), 0.0);
        assert!((at(1e-4) - 0.5 * pu.u_th).abs() < 1e-12);
        assert!((at(1.0) - pu.u_th).abs() < 1e-12);
        assert_eq!(at(-0.3), -at(0.3));
    }

    /// A bridge with capacitance, and the current of its knee.
    fn capacitive() -> (InverterModel<f64>, f64, f64) {
        let (m, inv) = (Machine::preset_2k2(), Inverter { c_out: 1e-9, ..Inverter::preset_2k2() });
        let pu = PerUnit::new(&m, &inv).unwrap();
        (InverterModel::new(&pu), pu.u_dc, 0.27 / pu.base.i)
    }

    #[test]
    fn with_double_update_the_loss_has_no_shift_of_the_sampled_current() {
        let at = |half_periods: u32, i: f64| {
            let inverter = Inverter { c_out: 1e-9, half_periods, ..Inverter::preset_2k2() };
            let pu = PerUnit::new(&Machine::preset_2k2(), &inverter).unwrap();
            let model = InverterModel::<f64>::new(&pu);
            model.distortion(model.nominal(), &AlphaBeta::new(i, 0.0), pu.u_dc, 1.0).phases[0]
        };
        let i = 0.02;
        assert!((at(1, i) + at(1, -i)).abs() < 1e-12 && at(1, i) > 1e-3);
        assert!((at(2, i) + at(2, -i)).abs() > 1e-3, "with one update a period it has");
    }

    /// The sampled current at which that at the edges is `x` times the knee, by the first approximation.
    fn sampled(model: &InverterModel<f64>, i_k: f64, x: f64) -> AlphaBeta<f64> {
        AlphaBeta::new(x * i_k + if x.abs() < 1.0 { model.parameters.shift } else { 0.0 }, 0.0)
    }

    #[test]
    fn with_capacitance_the_loss_is_the_charge_that_the_current_moves_in_the_dead_time() {
        let (model, u_dc, i_k) = capacitive();
        let knee = model.knee(1.0);
        let full = u_dc * model.parameters.dead_time;
        for x in [0.02, 0.3, 0.9, 1.001, 1.5, 3.0, 10.0, 20.0] {
            let i = sampled(&model, i_k, x);
            let e = (model.distortion(&knee, &i, u_dc, 1.0).phases[0] - model.parameters.u_th) / full;
            let law = if x < 1.0 { 0.5 * x } else { 1.0 - 0.5 / x };
            assert!((e - law).abs() < 1e-9, "{x}: {e}, not {law}");
        }
    }

    #[test]
    fn the_loss_is_that_of_the_current_at_the_edges() {
        let (model, u_dc, _) = capacitive();
        let (m, inv) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let below = inv.u_dc * inv.dead_time / (6.0 * m.L_sigma) / PerUnit::new(&m, &inv).unwrap().base.i;
        let at = |i: f64| model.distortion(model.nominal(), &AlphaBeta::new(i, 0.0), u_dc, 1.0).phases[0];
        assert!(at(below).abs() < 1e-12);
        assert!((at(0.01 + below) + at(below - 0.01)).abs() < 1e-12, "odd about that current");
    }

    /// Edge by edge: at the rising one a positive current waits for the other switch, a negative one ramps the node.
    #[test]
    fn halves_of_a_period_lose_what_their_edges_do() {
        let (model, u_dc, i_k) = capacitive();
        let full = u_dc * model.parameters.dead_time;
        for x in [0.3_f64, 0.9, 1.5, 10.0, -0.5, -4.0] {
            let i = sampled(&model, i_k, x);
            let loss = model.distortion(&model.knee(1.0), &i, u_dc, 1.0);
            // What the ramp takes of the dead time, in a half period, where twice as much is lost as on average.
            let ramp = if x.abs() < 1.0 { 1.0 - 0.5 * x.abs() } else { 0.5 / x.abs() };
            let (waits, ramps) = (2.0 * full, 2.0 * full * ramp);
            let (rising, falling) = if x > 0.0 { (waits, -ramps) } else { (ramps, -waits) };
            let th = if x > 0.0 { model.parameters.u_th } else { -model.parameters.u_th };
            let got = [loss.of_half(true, None)[0] + 2.0 * full, loss.of_half(false, None)[0] - 2.0 * full];
            assert!((got[0] - th - rising).abs() < 1e-9 && (got[1] - th - falling).abs() < 1e-9, "{x}: {got:?}");
            // A leg without edges has the threshold alone, and lacks what is common to the others.
            let still = loss.without_edges(0);
            assert_eq!(still.phases[0], th);
            assert!((still.of_half(true, Some(0))[0] + 2.0 * full - th).abs() < 1e-12);
            assert!((still.of_half(false, Some(0))[0] - 2.0 * full - th).abs() < 1e-12);
        }
    }

    #[cfg(feature = "legs")]
    #[test]
    fn unequal_legs_add_their_delays_by_the_sign_of_the_current() {
        let (m, f_s) = (Machine::preset_2k2(), 10e3);
        let leg_delay = [[80e-9, 20e-9], [-50e-9, 10e-9], [-30e-9, -30e-9]];
        let pu = |leg_delay| PerUnit::new(&m, &Inverter { leg_delay, ..Inverter::preset_2k2() }).unwrap();
        let (equal, pu) = (InverterModel::<f64>::new(&pu([[0.0; 2]; 3])), pu(leg_delay));
        let model = InverterModel::<f64>::new(&pu);
        let at = |model: &InverterModel<f64>, i: &AlphaBeta<f64>| model.distortion(model.nominal(), i, pu.u_dc, 1.0);
        for k in 0..24 {
            let (s, c) = (0.2618 * f64::from(k) + 0.1).sin_cos();
            let i = AlphaBeta::new(0.7 * c, 0.7 * s);
            if i.to_phases().iter().any(|i| i.abs() < 0.1) {
                continue;
            }
            let (got, without) = (at(&model, &i), at(&equal, &i));
            let added = got.vector() - without.vector();
            let longer = [0, 1, 2].map(|k| leg_delay[k][usize::from(i.to_phases()[k] < 0.0)] * f_s * pu.u_dc);
            // What is common to the legs, and odd in the current, is a dead time.
            let common = leg_delay.iter().map(|[a, b]| 0.5 * (a - b)).sum::<f64>() / 3.0 * f_s * pu.u_dc;
            let common = i.to_phases().map(|i| common * i.signum());
            let want = -AlphaBeta::from_phases(longer) + AlphaBeta::from_phases(common);
            assert!((added - want).norm_sq() < 1e-20, "{k}: {added:?}, not {want:?}");
            assert!(
                (AlphaBeta::from_phases(got.by_knee()) - AlphaBeta::from_phases(without.by_knee())).norm_sq() < 1e-20
            );
        }
        // Continuous at the knee, and through zero.
        for i in [
            model.nominal.width + model.parameters.shift,
            model.parameters.shift,
            model.parameters.shift - model.nominal.width,
        ] {
            let u = |i: f64| at(&model, &AlphaBeta::new(i, 0.0)).phases[0];
            assert!((u(i + 1e-9) - u(i - 1e-9)).abs() < 1e-6);
        }
        let back = model.legs().of_period();
        for part in [1.0, -1.0] {
            let of = |x: [[f64; 2]; 3]| AlphaBeta::<f64>::from_phases(x.map(|[a, b]| a + part * b));
            assert!((of(back) - of(pu.legs)).norm_sq() < 1e-24);
        }
    }

    #[test]
    fn the_loss_falls_with_the_knee_as_its_derivative_says() {
        let (model, u_dc, i_k) = capacitive();
        for k in 0..360 {
            let (s, c) = (f64::from(k) * 1.7).to_radians().sin_cos();
            let i = AlphaBeta::new(c, s) * (2.5 * i_k);
            let at = |relative: f64| model.distortion(&model.knee(relative), &i, u_dc, 0.9);
            let (down, up) = (at(1.3 * (1.0 - 1e-6)), at(1.3 * (1.0 + 1e-6)));
            let phases = i.to_phases();
            for j in 0..3 {
                // Within its narrow linear part the threshold is taken for a part of the loss that has no knee.
                if (phases[j] - model.parameters.shift).abs() < model.parameters.band {
                    continue;
                }
                let numeric = (down.phases[j] - up.phases[j]) / 2e-6;
                let exact = at(1.3).by_knee()[j];
                assert!((numeric - exact).abs() < 1e-4 * at(1.0).full, "{numeric}, not {exact} at {}", phases[j]);
            }
        }
    }

    #[test]
    fn dead_time_is_lost_as_a_threshold_and_both_scale_with_what_was_found() {
        let (m, inv) = (Machine::preset_2k2(), Inverter { c_out: 0.0, ..Inverter::preset_2k2() });
        let pu = PerUnit::new(&m, &inv).unwrap();
        let model = InverterModel::<f64>::new(&pu);
        // 1 V and 2 µs of 100 µs at 540 V, of 326.6 V.
        let lost = |gain| model.distortion(model.nominal(), &AlphaBeta::new(0.7, 0.0), pu.u_dc, gain).phases;
        let volts = (1.0 + 0.02 * 540.0) / pu.base.u;
        for gain in [1.0, 1.3, 0.0] {
            for (u, sign) in lost(gain).iter().zip([1.0, -1.0, -1.0]) {
                assert!((u - sign * gain * volts).abs() < 1e-12, "{u}");
            }
        }
    }

    #[test]
    fn the_band_is_a_tenth_of_what_the_current_changes_by_in_a_dead_time() {
        let (m, inv) = (Machine::preset_11k(), Inverter { c_out: 0.0, ..Inverter::preset_11k() });
        let pu = PerUnit::new(&m, &inv).unwrap();
        let model = InverterModel::<f64>::new(&pu);
        let band = 0.1 * 2.0 / 3.0 * inv.u_dc * inv.dead_time / m.L_sigma / pu.base.i;
        let full = model.distortion(model.nominal(), &AlphaBeta::new(1.0, 0.0), pu.u_dc, 1.0).phases[0];
        for (i, part) in [(0.5, 0.5), (0.9, 0.9), (1.01, 1.0), (-0.5, -0.5)] {
            let u = model.distortion(model.nominal(), &AlphaBeta::new(i * band, 0.0), pu.u_dc, 1.0).phases[0];
            assert!((u / full - part).abs() < 1e-9, "{i} of the band: {}", u / full);
        }
    }
}
