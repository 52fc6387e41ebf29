#![allow(non_snake_case)]
//! Elastic coupling with backlash between the machine's shaft and the inertia of the load.
//!
//! ```text
//! δ' = ω - ω_L,    J_L ω_L' = T_c - T_load,    T_c = c b(δ) + d (ω - ω_L) where b(δ) ≠ 0, else 0
//! b(δ) = δ - min(max(δ, -β/2), β/2)
//! ```
//!
//! The resonance is at `ω_0² = c (1/J + 1/J_L)`, the antiresonance seen from the machine at `ω_a² = c/J_L`. `T_c` takes the place
//! of the load torque at the machine's shaft and is constant within a control period `h`: that of the twist halfway through it
//! (leapfrog). The angular momentum is kept, the frequency of the resonance is too high by the part `(ω_0 h)²/24` of it, and
//! without damping the energy of an oscillation does not drift.
//!
//! Validity: `ω_0 h` up to 0.3. The damping acts up to the instant at which the flanks part, where it may pull.

use stillflux::params::{Machine, ParamError, check};

/// Largest `ω_0 h`: the frequency of the resonance is exact to 0.4 %.
const OMEGA_H_MOST: f64 = 0.3;

/// Stiffness, damping and backlash between the machine and `J_load`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    /// Stiffness `c`, N·m/rad.
    pub stiffness: f64,
    /// Damping `d` while it transmits torque, N·m·s/rad.
    pub damping: f64,
    /// Angle `β` between the flanks, rad.
    pub backlash: f64,
}

impl Coupling {
    /// Checks every field against its admissible range, for the inertia behind it and the control period in s.
    ///
    /// # Errors
    /// The first field found outside its range: the resonance is followed by one torque a control period, and is damped up to its
    /// aperiodic limit.
    pub fn validate(&self, machine: &Machine, J_load: f64, period: f64) -> Result<(), ParamError> {
        check("J_load", J_load, 1e-2 * machine.J, 1e6, "kg m^2")
            .map_err(|e| e.with_note("a coupling needs an inertia behind it"))?;
        let J = machine.J * J_load / (machine.J + J_load);
        let stiffest = J * (OMEGA_H_MOST / period) * (OMEGA_H_MOST / period);
        check("coupling stiffness", self.stiffness, 1e-6 * stiffest, stiffest, "N m/rad")?;
        check("coupling damping", self.damping, 0.0, 2.0 * (self.stiffness * J).sqrt(), "N m s/rad")?;
        check("coupling backlash", self.backlash, 0.0, 1.0, "rad")
    }
}

/// The inertia behind a coupling, and the state of both.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ElasticLoad {
    coupling: Coupling,
    J: f64,
    /// Angle by which the machine's shaft is ahead, mechanical rad.
    twist: f64,
    /// Speed of the load, mechanical rad/s.
    pub omega: f64,
    /// Torque of the coupling in the present period, N·m.
    torque: f64,
}

impl ElasticLoad {
    /// A load that turns with the machine, the coupling in the middle of its backlash.
    pub fn new(coupling: Coupling, J: f64, omega: f64) -> Self {
        Self { coupling, J, twist: 0.0, omega, torque: 0.0 }
    }

    /// Begins a period of length `h` with the machine's shaft at `omega`: the torque that it takes from it.
    pub fn begin(&mut self, omega: f64, h: f64) -> f64 {
        let Coupling { stiffness, damping, backlash } = self.coupling;
        self.twist += 0.5 * h * (omega - self.omega);
        let free = 0.5 * backlash;
        let deflection = self.twist - self.twist.clamp(-free, free);
        self.torque = if deflection == 0.0 { 0.0 } else { stiffness * deflection + damping * (omega - self.omega) };
        self.torque
    }

    /// Ends it with the shaft at `omega` under a load torque.
    pub fn finish(&mut self, omega: f64, load_torque: f64, h: f64) {
        self.omega += h / self.J * (self.torque - load_torque);
        self.twist += 0.5 * h * (omega - self.omega);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const J: f64 = 0.01;
    const J_L: f64 = 0.03;
    /// 20 Hz of both inertias.
    const STIFFNESS: f64 = TAU * TAU * 400.0 * J * J_L / (J + J_L);

    /// Lets a shaft without torque go with 10 rad/s before a load at rest. Time, speeds, twist at the end of every period.
    fn released(damping: f64, backlash: f64, h: f64, periods: usize) -> Vec<(f64, f64, f64, f64)> {
        let mut load = ElasticLoad::new(Coupling { stiffness: STIFFNESS, damping, backlash }, J_L, 0.0);
        let mut omega = 10.0;
        (1..=periods)
            .map(|k| {
                omega -= h / J * load.begin(omega, h);
                load.finish(omega, 0.0, h);
                (k as f64 * h, omega, load.omega, load.twist)
            })
            .collect()
    }

    #[test]
    fn both_inertias_oscillate_with_their_resonance() {
        // ω_0 h = 0.013 and 0.25.
        for h in [1e-4, 2e-3] {
            let run = released(0.0, 0.0, h, 100_000);
            let zeros: Vec<f64> = run.windows(2).filter(|w| w[0].3 < 0.0 && w[1].3 >= 0.0).map(|w| w[1].0).collect();
            let f = (zeros.len() - 1) as f64 / (zeros[zeros.len() - 1] - zeros[0]);
            let too_high = (TAU * 20.0 * h).powi(2) / 24.0;
            assert!((f / 20.0 - 1.0 - too_high).abs() < 5e-5, "{h}: {f}");
        }
    }

    #[test]
    fn an_oscillation_without_damping_keeps_momentum_and_energy() {
        let energy = 0.5 * J * 100.0;
        for (t, omega, omega_load, twist) in released(0.0, 0.0, 1e-4, 100_000) {
            assert!((J * omega + J_L * omega_load - J * 10.0).abs() < 1e-12, "{t}");
            let now = 0.5 * (J * omega * omega + J_L * omega_load * omega_load + STIFFNESS * twist * twist);
            assert!((now / energy - 1.0).abs() < 1e-3, "{t}: {now}");
        }
    }

    #[test]
    fn damping_ends_the_oscillation_at_the_common_speed() {
        let reduced = J * J_L / (J + J_L);
        let omega_0 = TAU * 20.0;
        let run = released(2.0 * 0.05 * omega_0 * reduced, 0.0, 1e-4, 20_000);
        // The amplitude of the difference falls with e^(-ζ ω_0 t).
        let late = run.iter().filter(|x| x.0 > 0.2 && x.0 < 0.25).fold(0.0, |most: f64, x| most.max((x.1 - x.2).abs()));
        assert!((late / (10.0 * (-0.05 * omega_0 * 0.2f64).exp()) - 1.0).abs() < 0.2, "{late}");
        let (_, omega, omega_load, _) = run[run.len() - 1];
        assert!((omega - 2.5).abs() < 1e-3 && (omega_load - 2.5).abs() < 1e-3);
    }

    #[test]
    fn within_its_backlash_a_shaft_runs_freely_and_bounces_between_the_flanks() {
        let run = released(0.0, 0.05, 1e-5, 100_000);
        // 10 rad/s through half of 0.05 rad.
        let first = run.iter().find(|x| x.2 > 0.0).unwrap().0;
        assert!((first - 0.0025).abs() < 2e-5, "{first}");
        // Elastic flanks: the speeds change places as two balls' do, 2.5 ∓ 7.5 rad/s by turns.
        let free: Vec<f64> = run.iter().filter(|x| x.3.abs() < 0.02).map(|x| x.1 - x.2).collect();
        assert!(free.iter().all(|d| (d.abs() - 10.0).abs() < 1e-2));
        assert!(free.iter().any(|d| *d < 0.0) && free.iter().any(|d| *d > 0.0));
    }

    #[test]
    fn a_coupling_that_one_torque_a_period_cannot_follow_is_refused() {
        let m = Machine { J, ..Machine::preset_2k2() };
        let coupling = |stiffness, damping, backlash| Coupling { stiffness, damping, backlash };
        assert!(coupling(STIFFNESS, 0.01, 0.02).validate(&m, J_L, 1e-4).is_ok());
        for (bad, J_load, field) in [
            (coupling(1e3 * STIFFNESS, 0.0, 0.0), J_L, "coupling stiffness"),
            (coupling(0.0, 0.0, 0.0), J_L, "coupling stiffness"),
            (coupling(STIFFNESS, 10.0, 0.0), J_L, "coupling damping"),
            (coupling(STIFFNESS, 0.0, -0.1), J_L, "coupling backlash"),
            (coupling(STIFFNESS, 0.0, 0.0), 0.0, "J_load"),
        ] {
            assert_eq!(bad.validate(&m, J_load, 1e-4).unwrap_err().field, field);
        }
    }
}
