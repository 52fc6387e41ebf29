//! Limit of the gain of flux control: what its current does to the stator flux at once, through the leakage.

use super::clocks::slow_periods;
use super::types::DriveParams;
use crate::params::{Inverter, Machine};

/// Largest gain of flux control relative to that at which it oscillates, with the strongest low-pass filter: of the
/// default, and of what is admitted.
pub(super) const FLUX_GAIN: (f64, f64) = (0.5, 0.8);

/// Low-pass filters of flux control, the weakest first: the part `m` of its last correction that it keeps, and the gain
/// up to which it serves, relative to the one at which flux control oscillates with it by [`DirectFlux`]. The integral
/// part of current control, which is not counted there, makes that 0.86 times as large, and twice the leakage of the
/// parameters half of it (187 kW at 4 kHz).
const FLUX_MEMORY: [(f64, f64); 3] = [(0.0, 0.4), (0.5, 0.5), (0.8, 1.0)];

/// Control periods from the sample to the voltage that flux control has made of it, in the mean: one to the next
/// current control, one and a half to the middle of its pulses.
const FLUX_DELAY: f64 = 2.5;

/// How flux control acts on the stator flux through the leakage, at once.
///
/// `i_d` acts on the stator flux without delay, `ψ_s = σl_s i_d + ψ_R`. With the gain `k_p`, once in `T`, behind a
/// low-pass filter that keeps the part `m` of its last output, a delay `D` and current control, flux control is for
/// this part
///
/// ```text
/// i_d⁺ = a i_d + b_0 y + b_1 y⁻,    y = m y⁻ - (1 - m) g i_d
/// a = e^{-ω_c T},    b_0 = 1 - e^{-ω_c (T - D)},    b_1 = 1 - a - b_0,    g = k_p σl_s = ω_ψ τ_r L_σ/L_s
/// (z - a)(z - m) + (1 - m) g (b_0 z + b_1) = 0,    |z| < 1:
///     (1 - m) g < (1 - a m)/b_1,    (1 - m) g (b_0 - b_1) < (1 + a)(1 + m)
/// ```
///
/// Large machines have long rotor time constants. With a call in every fourth period of 4 kHz the delay is more than
/// half of `T`: a two-pole motor of 187 kW (τ_r 2.4 s) whose leakage is a fifth larger than told oscillates with 235 Hz
/// and `m` = 1/2, until the current does not follow.
pub(super) struct DirectFlux {
    a: f64,
    b: (f64, f64),
    /// Bandwidth of flux control over `g`, Hz.
    bandwidth: f64,
}

impl DirectFlux {
    pub fn new(machine: &Machine, inverter: &Inverter, current_bandwidth: f64) -> Self {
        let periods = f64::from(slow_periods(inverter));
        let left = |periods: f64| libm::exp(-core::f64::consts::TAU * current_bandwidth * periods / inverter.f_c());
        let (a, b_0) = (left(periods), 1.0 - left(periods - FLUX_DELAY));
        let rate = machine.L_s() * machine.R_R / (machine.L_sigma * machine.L_M);
        Self { a, b: (b_0, 1.0 - a - b_0), bandwidth: rate / core::f64::consts::TAU }
    }

    /// Bandwidth of flux control, Hz, at which it oscillates with a filter that keeps `memory`.
    fn fastest(&self, memory: f64) -> f64 {
        let Self { a, b: (b_0, b_1), bandwidth } = *self;
        let gain = (1.0 - a * memory) / b_1;
        let alternating = (1.0 + a) * (1.0 + memory) / (b_0 - b_1);
        let gain = if b_0 > b_1 { gain.min(alternating) } else { gain };
        gain / (1.0 - memory) * bandwidth
    }

    /// The same with the strongest filter.
    pub fn fastest_filtered(&self) -> f64 {
        self.fastest(FLUX_MEMORY[2].0)
    }

    /// `m` for a bandwidth of flux control, Hz.
    fn memory(&self, bandwidth: f64) -> f64 {
        let fits = |&(memory, part): &(f64, f64)| bandwidth <= part * self.fastest(memory);
        FLUX_MEMORY.into_iter().find(fits).unwrap_or(FLUX_MEMORY[2]).0
    }
}

impl DriveParams {
    /// Part of its last proportional correction that flux control keeps, [`DirectFlux`].
    pub(crate) fn flux_memory(&self, machine: &Machine, inverter: &Inverter) -> f64 {
        DirectFlux::new(machine, inverter, self.current_bandwidth).memory(self.flux_bandwidth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Part of a deviation of `i_d` that is left after a hundred runs of flux control, through a leakage of `factor`
    /// times that of the parameters: every control period, with the integral part of current control.
    fn oscillation_left(machine: &Machine, inverter: &Inverter, bandwidth: f64, memory: f64, factor: f64) -> f64 {
        let p = DriveParams::new(machine, inverter);
        let (periods, t_s) = (slow_periods(inverter), 1.0 / inverter.f_c());
        let omega_c = core::f64::consts::TAU * p.current_bandwidth;
        // k_p of docs/gains.md, in SI: i_d for a flux, and a voltage for a current.
        let k_psi = core::f64::consts::TAU * bandwidth * (machine.L_M / machine.R_R) / machine.L_s();
        let k_p = omega_c * machine.L_sigma;
        let (mut i_d, mut x, mut y, mut i_ref, mut u, mut last) = (1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0);
        for k in 0..100 * periods {
            // Sample, current control, then flux control: its reference is that of the next period, a voltage acts from
            // the next sample on.
            let i = i_d;
            i_d += u * t_s / (factor * machine.L_sigma);
            u = k_p * (i_ref - i) + x;
            x += t_s * k_p * omega_c / 5.0 * (i_ref - i);
            if k % periods == 0 {
                y = memory * y - (1.0 - memory) * k_psi * factor * machine.L_sigma * i;
                i_ref = y;
            }
            if k >= 90 * periods {
                last = i_d.abs().max(last);
            }
        }
        last
    }

    #[test]
    fn flux_control_does_not_oscillate_through_a_leakage_of_1_5_times_the_parameter() {
        let small = Machine::preset_2k2();
        let mut filters = [0; 3];
        for tau_r in [1.0, 5.0, 10.0, 20.0, 50.0] {
            let machine = Machine { R_R: small.R_R / tau_r, ..small };
            for f_s in [3e3, 4e3, 8e3, 16e3] {
                let inverter = Inverter { f_s, ..Inverter::preset_2k2() };
                let p = DriveParams::new(&machine, &inverter);
                let memory = p.flux_memory(&machine, &inverter);
                let left = |memory, factor| oscillation_left(&machine, &inverter, p.flux_bandwidth, memory, factor);
                let used = FLUX_MEMORY.iter().position(|x| x.0 == memory).unwrap();
                filters[used] += 1;
                assert!(left(memory, 1.0) < 1e-6, "{tau_r}, {f_s}: {}", left(memory, 1.0));
                assert!(left(memory, 1.5) < 1.0, "{tau_r}, {f_s}: {}", left(memory, 1.5));
                // The filter is needed where the gain is large.
                let weaker = left(FLUX_MEMORY[used.saturating_sub(1)].0, 1.5);
                assert!(tau_r < 20.0 || weaker > 1.0, "{tau_r}, {f_s}: {weaker}");
            }
        }
        assert!(filters.iter().all(|&drives| drives > 0), "{filters:?}");
    }
}
