//! Rotor resistance, magnetising curve and stator resistance from the direct currents of a start.
//!
//! A direct current along the a-axis in a machine at standstill builds up a flux along it, and its voltage has two parts: that
//! of the current, which is the same whenever the current is, and that of the flux on its way to the steady state,
//!
//! ```text
//! u - r_s i - u_l = dψ_s/dτ = r_R (i - i_μ(m)),        i_μ(m) = γ m/l_M (1 - c + c (m/m_N)^S)
//! ```
//!
//! The amplitude after a step of the current tells `r_R`, the decay `r_R γ/l_M`, whatever the bridge does at this current. By
//! least squares with an unknown voltage for each current that is 1 to 3 % of `r_R` and 1.5 to 4 % of `l_M` (drawn
//! installations, 0.37 to 45 kW), which are known to some 20 and 7 % before.
//!
//! So the filter estimates `ε_r = ln (r_R/r̂_R)` then, in place of the leakage, which a direct current does not show
//! ([`ROTOR`]): with `∂m⁺/∂ε_r = r̂_R Δ (i·n - i_μ)`, and without the noise that stands for an error of `r_R` elsewhere. In the
//! end the place is that of the leakage again, with the variance and without the correlations of before.
//!
//! **Direction.** The flux has that of the current, `n` is the a-axis and `|ψ_R|` the component along it, of either sign: so
//! the filter begins at a flux of zero, at which an unknown flux has no direction. In large machines the error of the bridge's
//! voltage is more than what the flux induces, and the integral of both would go the wrong way before it is corrected. The
//! component across is not observed; once the flux has settled it is set to zero ([`Filter::forget_across`]).
//!
//! **Noise** in place of what is left out, of a block:
//!
//! | of | constant | added to |
//! |---|---|---|
//! | the leakage, where the current changes | its variance at the start | `ψ_s` |
//! | the shape of the bridge's curve near current zero | `CURVE` 0.5 of `u_k` | `ψ_s` |
//! | the curve of the magnetising current, which by model depends on `m`, in the machine on the flux of the stator as well | `SATURATED` 3 times its saturated part over `√s`, `LAG` of it | `m` |
//!
//! The last two are allowances for errors that last for many blocks: relative deviations of some per cent of the knee's voltage
//! and some tenths of the saturated part, times the root of their number. For the curve that is the number in which `m` follows the
//! current, and it falls with the slope `s = γ d(m g)/dm`: an error `δ` of the saturated part `i_c` moves the flux by `l_M δ i_c/s`, white noise of
//! standard deviation `q` a block by `q/√(2 r_R Δ s/l_M)`, so `q ∝ 1/√s`. With the same `q` at every slope the flux of a motor whose
//! curve is steep had no weight against the integral of the voltage, which was off by up to 13 % (drawn motors with 0.7 of the unsaturated
//! current in addition at rated flux) and with deep bars by more than twice the rated flux.

use super::covariance::Column;
use super::intermediate::Intermediate;
use super::model::{LEAKAGE, M, PSI, ROTOR, RS, SCALE_LEAKAGE, SCALE_PSI, SCALE_ROTOR, reciprocal};
use super::{Filter, FilterConfig, correct_state};
use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;

/// Component of the flux across the direct current.
const ACROSS: usize = PSI + 1;
/// Limits of `r_R`, relative to the parameter.
const R_R_RANGE: (f64, f64) = (0.5, 2.0);
/// Deviation of the bridge's voltage in a block, in units of its derivative by the logarithm of the knee.
const CURVE: f64 = 0.5;
/// Deviation of the saturated part of the magnetising current in a block, relative to it.
const SATURATED: f64 = 3.0;

impl<R: Real> Filter<R> {
    /// From now on a direct current along the a-axis flows in a machine at standstill. Not for a filter that corrects nothing:
    /// its flux of the start is that of [`Filter::settle`].
    #[cold]
    #[inline(never)]
    pub fn begin_direct(&mut self, c: &FilterConfig<R>) {
        self.end_direct(c);
        if c.correct {
            self.direct = true;
            self.rotor.set(self.rotor_cold * c.temperature.rotor(self.r_s()));
            self.reset_place(c.noise.rotor);
            // The winding may have any temperature, whatever a memory or the last run knows: 20 and 97 °C are 30 % apart.
            self.p.set(RS, RS, self.p.get(RS, RS).max(c.noise.prior()[RS]));
        }
    }

    /// It does no longer, or the machine turns.
    #[cold]
    #[inline(never)]
    pub fn end_direct(&mut self, c: &FilterConfig<R>) {
        if self.direct {
            self.direct = false;
            self.rotor_cold = self.rotor.value() * reciprocal(c.temperature.rotor(self.r_s()));
            self.reset_place(self.initial.of_leakage());
        }
    }

    /// Whether a direct current flows in a machine at standstill.
    #[inline]
    pub fn is_direct(&self) -> bool {
        self.direct
    }

    /// The flux across the direct current has decayed: what the errors of the voltage have integrated there is none.
    #[cold]
    #[inline(never)]
    pub fn forget_across(&mut self, c: &FilterConfig<R>) {
        self.psi_s.set(AlphaBeta::new(self.value().re(), R::ZERO));
        self.p.set(ACROSS, ACROSS, c.noise.prior()[ACROSS]);
        self.p.isolate::<ACROSS>();
        self.intermediate = Intermediate::Nothing;
    }

    /// Another state takes the place of [`ROTOR`] and [`LEAKAGE`].
    fn reset_place(&mut self, variance: R) {
        self.p.set(LEAKAGE, LEAKAGE, variance);
        self.p.isolate::<LEAKAGE>();
        self.intermediate = Intermediate::Nothing;
    }

    /// Rotor resistance in the rotor equation, relative to the parameter.
    #[inline(always)]
    pub(super) fn rotor_by_current(&self, c: &FilterConfig<R>) -> R {
        let rotor = self.rotor.value();
        if likely(!self.direct) { rotor } else { rotor * c.model.transient_saturation(self.point.magnetisation.slope) }
    }

    /// Correction of the rotor resistance, whose error is logarithmic.
    #[cold]
    #[inline(never)]
    pub(super) fn correct_rotor(&mut self, gain: R, z: R) {
        let r = R::from_f64;
        let z = z * r(SCALE_ROTOR) * self.rotor.value();
        correct_state(&mut self.rotor, gain, z, r(R_R_RANGE.0), r(R_R_RANGE.1));
    }

    /// Adds the derivative by the rotor resistance to the row of `m`, after the others.
    #[cold]
    #[inline(never)]
    pub(super) fn add_rotor(&mut self, c: &FilterConfig<R>, rotor: R) {
        self.p.advance_by::<M, ROTOR>(c.model.by_rotor(&self.point, rotor));
    }

    /// Process noise in addition to the random walks.
    #[cold]
    #[inline(never)]
    pub(super) fn add_direct_noise(&self, c: &FilterConfig<R>, walk: &mut Column<R>) {
        let (r, q) = (R::from_f64, &self.point);
        let inv_slope = reciprocal(q.magnetisation.slope);
        walk[ROTOR] = R::ZERO;
        let by_leakage = q.d_leakage_flux.re() * r(SCALE_LEAKAGE / SCALE_PSI);
        let u_k = AlphaBeta::from_phases(q.loss.by_knee()).re();
        let of_curve = u_k * c.model.delta * r(CURVE / SCALE_PSI);
        walk[PSI] += by_leakage * by_leakage * self.initial.of_leakage() + of_curve * of_curve * c.noise.part;
        // m g less its unsaturated part.
        let m = self.m.value();
        let saturated = q.magnetisation.m_g - m + m * self.c.value();
        let of_saturation = c.model.decay * saturated * r(SATURATED / SCALE_PSI);
        walk[M] += of_saturation * of_saturation * c.noise.part * inv_slope;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::PerUnit;
    use crate::estimate::kalman::{Identified, Input};
    use crate::estimate::priors::Priors;
    use crate::inverter::Distortion;
    use crate::params::{Inverter, Machine};
    use crate::scalar::Q;
    use crate::space::Dq;

    /// `r_R`, `L_M` and `r_s` that the filter ends with, relative to the real ones, and whether the place of the leakage is its
    /// own again: 11 kW, factors of the real parameters, currents of a start in a linear machine.
    fn start<R: Real>(priors: &Priors, [r_r, l_m, r_s]: [f64; 3]) -> ([f64; 3], bool) {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let identified = Identified { offset: true, resistance: true, flux: true };
        let c = FilterConfig::<R>::new(&machine, &inverter, &pu, 1.0, true, identified).with_priors(priors);
        let mut filter = Filter::new(&c);
        filter.start(&c, &AlphaBeta::default());
        filter.begin_direct(&c);
        let (mut psi, mut i, mut t) = (0.0, 0.0, 0.0);
        // Over the rotor time constant of the parameters.
        let levels = [(1.1, 1.5), (2.6, 1.0), (2.9, 0.7), (3.7, 0.4), (4.3, 1.5), (4.7, 1.0)];
        for (until, level) in levels {
            let next = level / pu.l_s;
            while t < until * pu.tau_r {
                t += pu.t_s;
                let before = psi + pu.sigma_l_s * i;
                // A step of the current takes some periods.
                let to = i + (next - i) * 0.2;
                psi += pu.t_s * r_r * pu.r_r * (0.5 * (i + to) - psi / (l_m * pu.l_m));
                let u = (psi + pu.sigma_l_s * to - before) / pu.t_s + r_s * pu.r_s * 0.5 * (i + to);
                i = to;
                let vector = |x: f64| AlphaBeta::new(R::from_f64(x), R::ZERO);
                let (loss, i_ref) = (Distortion::default(), Dq::new(R::from_f64(next), R::ZERO));
                let input = Input { u_s: vector(u), loss: &loss, i_m: vector(i), i_ref: &i_ref, omega_s: R::ZERO };
                filter.step(&c, &input, false);
            }
        }
        filter.end_direct(&c);
        let leakage = filter.p.get(LEAKAGE, LEAKAGE) == filter.initial.of_leakage()
            && filter.leakage() == R::ONE
            && (0..LEAKAGE).all(|k| filter.p.get(LEAKAGE, k) == R::ZERO);
        let found_l_m = filter.gamma.value().to_f64().recip();
        let found_r_s = filter.r_s().to_f64() / pu.r_s;
        ([filter.rotor.value().to_f64() / r_r, found_l_m / l_m, found_r_s / r_s], leakage)
    }

    fn finds<R: Real>(most: [f64; 3]) {
        for real in [[1.2, 0.93, 1.1], [0.85, 1.06, 0.92], [1.15, 1.05, 1.0]] {
            let (found, leakage) = start::<R>(&Priors::default(), real);
            assert!(leakage);
            for (x, most) in found.into_iter().zip(most) {
                assert!((x - 1.0).abs() < most, "{} {real:?}: {found:?}", R::NAME);
            }
        }
    }

    #[test]
    fn the_direct_currents_of_a_start_show_rotor_resistance_inductance_and_stator_resistance() {
        finds::<f64>([0.03, 0.05, 0.03]);
        finds::<f32>([0.03, 0.05, 0.03]);
        finds::<Q>([0.03, 0.05, 0.03]);
    }

    #[test]
    fn where_the_rotor_resistance_counts_as_known_its_error_stays_and_goes_into_the_inductance() {
        let known = Priors { r_r: 0.002, ..Priors::default() };
        let ([r_r, l_m, _], _) = start::<f64>(&known, [1.2, 0.93, 1.1]);
        assert!(r_r < 0.92 && (l_m - 1.0).abs() > 0.2, "{r_r} {l_m}");
    }
}
