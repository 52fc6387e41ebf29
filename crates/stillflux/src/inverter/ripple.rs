//! What the ripple of the currents adds to the loss of a leg near its current zero (**Ripple** in [`super`]).

use super::{Distortion, InverterModel, Knee};
use crate::base::PerUnit;
use crate::scalar::Real;

/// Half width of the range in which both edges of a leg are told apart, relative to that of the linear part.
const NEAR: f64 = 3.0;
/// Part `δ` of the dead time for a ramp of the node that takes all of it, and by what it is less for one that takes none:
/// the first by integration, the second fitted to the integrated period.
const SLOW_RAMP: f64 = 1.0 / 3.0;
const FAST_RAMP: f64 = 0.27;

/// Control periods until it is a leg's turn again: three legs, one in every fourth period ([`crate::drive`]).
const TURN_PERIODS: f64 = 12.0;
/// Largest angle, rad, by which the current turns meanwhile, and largest voltage, per unit, with which the ripple is
/// computed. Allowance: near its zero a current is for 15° (2.2 kW, 10 kHz). What is kept for longer is the loss of another
/// current: with 23 to 27°, 4 kHz and 87 to 100 Hz rated, the estimated flux of an unloaded motor swings until control is lost.
const TURN: f64 = 0.094;
const VOLTAGE_MOST: f64 = 0.25;

/// Largest voltage with which the ripple is computed, per unit, as large as the speed that belongs to it.
fn largest_voltage(pu: &PerUnit) -> f64 {
    (TURN / (TURN_PERIODS * pu.t_s)).min(VOLTAGE_MOST)
}

/// Its square.
pub(super) fn largest_voltage_sq(pu: &PerUnit) -> f64 {
    let voltage = largest_voltage(pu);
    voltage * voltage
}

impl<R: Real> Knee<R> {
    /// Whether both edges of a leg with this current are told apart.
    #[inline(always)]
    pub(crate) fn is_near_zero(&self, i: R) -> bool {
        i.within(self.width * R::from_f64(NEAR))
    }
}

impl<R: Real> InverterModel<R> {
    /// Square of the largest voltage with which the ripple is computed.
    #[inline(always)]
    pub fn ripple_within_sq(&self) -> R {
        self.parameters.ripple_within_sq
    }

    /// What the loss `first` of [`InverterModel::distortion`] lacks in leg `k` (0 to 2) near its current zero, in a period in
    /// which the machine is to have the phase currents `phases` and voltages `u`.
    #[inline(never)]
    pub fn ripple(&self, knee: &Knee<R>, k: usize, (phases, u): (&[R; 3], &[R; 3]), first: &Distortion<R>) -> R {
        let (literal, g) = (R::from_f64, self.parameters.ripple);
        let i = phases[k % 3];
        let dead = first.full - first.least;
        let swing = self.parameters.shift + self.parameters.shift;
        let start = if i.within(knee.width) { i - self.parameters.shift } else { i };
        let part = knee.part_of(start.abs());
        // `s δ` and `s (1 - δ)`.
        let before = swing * (literal(SLOW_RAMP) - literal(FAST_RAMP) * part);
        let after = swing - before;
        let own = g * u[k % 3] * literal(1.5);
        let (mut rising, mut falling) = (i - own, i + own - after - after);
        let v = u[k % 3] + first.phases[k % 3];
        // Remainders: the compiler sees that they are indices of three.
        for x in [(k + 1) % 3, (k + 2) % 3] {
            let lead = g * (u[x] + first.phases[x] - v);
            let (at_rise, at_fall) =
                if phases[x] > R::ZERO { (lead - after, lead - before) } else { (lead + before, lead + after) };
            rising -= at_rise.max(R::ZERO);
            falling += at_fall.max(R::ZERO);
        }
        let earlier = g * dead * literal(4.0);
        let (part, mut both) = if start < R::ZERO { (-part, R::ZERO) } else { (part, part) };
        for _ in 0..2 {
            both = knee.part_of((falling + earlier * both).max(R::ZERO));
        }
        if rising < R::ZERO {
            both -= knee.part_of(-rising);
        }
        dead * (both - part)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Base;
    use crate::control::modulator::modulate;
    use crate::params::{Inverter, Machine};
    use crate::space::AlphaBeta;

    /// Mean voltages of the three nodes over a period that begins in the lower zero vector with currents `i`, by steps
    /// of 10 ns; legs with the capacitance of `inv`, currents through the leakage, which the machine's `u` holds.
    fn integrated(inv: &Inverter, l: f64, duty: [f64; 3], i: [f64; 3], u: [f64; 3]) -> [f64; 3] {
        let (dt, t_d) = (1e-8, inv.dead_time);
        let period = 1.0 / inv.f_s;
        let (mut i, mut node, mut sum) = (i, [0.0f64; 3], [0.0; 3]);
        for step in 0..(period / dt) as u32 {
            let t = f64::from(step) * dt;
            for k in 0..3 {
                let (rise, fall) = (0.5 * period * (1.0 - duty[k]), 0.5 * period * (1.0 + duty[k]));
                node[k] = if t < rise || t >= fall + t_d {
                    0.0
                } else if t >= rise + t_d && t < fall {
                    inv.u_dc
                } else {
                    (node[k] - i[k] * dt / inv.c_out).clamp(0.0, inv.u_dc)
                };
            }
            let star = (node[0] + node[1] + node[2]) / 3.0;
            for k in 0..3 {
                i[k] += (node[k] - star - u[k]) * dt / l;
                sum[k] += node[k] * dt;
            }
        }
        sum.map(|x| x / period)
    }

    #[test]
    fn the_ripple_of_a_leg_is_kept_while_the_field_turns_by_a_few_degrees() {
        let largest = |rated: f64, f_s: f64| {
            let machine = Machine { f_N: rated, ..Machine::preset_2k2() };
            let pu = PerUnit::new(&machine, &Inverter { f_s, ..Inverter::preset_2k2() }).unwrap();
            let degrees = (largest_voltage(&pu) * TURN_PERIODS * pu.t_s).to_degrees();
            assert!(degrees < 5.41, "{rated} Hz, {f_s} Hz: {degrees}");
            largest_voltage(&pu)
        };
        assert!((largest(50.0, 10e3) - 0.25).abs() < 1e-3, "most at 10 kHz, where that was chosen");
        assert_eq!(largest(50.0, 16e3), 0.25);
        assert!((largest(87.0, 4e3) - 0.0575).abs() < 1e-3);
    }

    /// Deviation of the model from it, V rms, over currents of leg c within three times the knee while the other two
    /// carry rated current; `induced` beside the resistive drop in leg c. With the first approximation alone, and with
    /// both edges.
    fn deviation(dead_time: f64, c_out: f64, induced: f64) -> [f64; 2] {
        let machine = Machine::preset_2k2();
        let inv = Inverter { dead_time, c_out, u_th: 0.0, ..Inverter::preset_2k2() };
        let pu = PerUnit::new(&machine, &inv).unwrap();
        let (b, model) = (Base::new(&machine), InverterModel::<f64>::new(&pu));
        let (knee, n) = (model.knee(1.0), 40);
        let squares = (0..=n).map(|j| {
            let i_c = 2.99 * knee.width * (2.0 * f64::from(j) / f64::from(n) - 1.0);
            let i = [0.8 - 0.5 * i_c, -0.8 - 0.5 * i_c, i_c];
            let u = [-0.5, -0.5, 1.0].map(|x| x * induced / b.u);
            let u = [0, 1, 2].map(|k| u[k] + pu.r_s * i[k]);
            let i_s = AlphaBeta::from_phases(i);
            let loss = model.distortion(&knee, &i_s, pu.u_dc, 1.0);
            let first = loss.phases;
            let phases = i_s.to_phases();
            let ripple = |k: usize| {
                if knee.is_near_zero(phases[k]) { model.ripple(&knee, k, (&phases, &u), &loss) } else { 0.0 }
            };
            let both = [0, 1, 2].map(|k| first[k] + ripple(k));
            [first, both].map(|loss| {
                let phases = [0, 1, 2].map(|k| u[k] + loss[k]);
                let duty = modulate(phases, 1.0 / pu.u_dc, None);
                // The machine's voltage is what arrives: so the period repeats itself.
                let mut arrives = u.map(|x| x * b.u);
                for _ in 0..3 {
                    let v = integrated(&inv, machine.L_sigma, duty, i.map(|x| x * b.i), arrives);
                    arrives = v.map(|x| x - (v[0] + v[1] + v[2]) / 3.0);
                }
                (arrives[2] - u[2] * b.u).powi(2) / f64::from(n + 1)
            })
        });
        squares.fold([0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]).map(f64::sqrt)
    }

    #[test]
    fn the_loss_near_current_zero_is_that_of_an_integrated_period() {
        for (dead_time, c_out, induced, bound) in
            [(2e-6, 1e-9, 0.0, 0.04), (2e-6, 1e-9, 30.0, 0.06), (4e-6, 1e-9, 0.0, 0.06), (4e-6, 2e-9, -8.0, 0.06)]
        {
            let [first, both] = deviation(dead_time, c_out, induced);
            assert!(both < bound && both < 0.35 * first, "{dead_time} {c_out} {induced}: {first} V, {both} V");
        }
    }
}
