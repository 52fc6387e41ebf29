//! A machine from its nameplate: the rated point fixes what the plate can tell, and every value comes with its
//! relative standard deviation.
//!
//! ```text
//! n_p = ⌊60 f_N/n_N⌋    s = 1 - n_p n_N/(60 f_N)    T_N = P_N/Ω_N    P_in = √3 U_N I_N cos φ    P_δ = P_N/(1 - s)
//! 3 R_s I_N² = (1 - κ)(P_in - P_δ)               κ: share of iron, friction and stray loss
//! ψ_R = (U - R_s I)/jω - L_σ I                   phasors of the rated point, inverse-Γ circuit
//! L_M = |ψ_R|/i_d      R_R = s ω |ψ_R|/i_q       i_d, i_q: rated current along and across ψ_R
//! ```
//!
//! Given `R_s` and `L_σ` the last line is exact: at rated slip the rotor current is in quadrature with its flux.
//! What the plate does not tell is assumed, and enters the deviations of all values:
//!
//! | quantity | assumed | standard deviation | source |
//! |---|---|---|---|
//! | `L_σ` | 0.17 pu, or that of the pull-out torque | 30 %, 12 % | induction machines of 0.25 to 200 kW |
//! | `κ` | 0.2 | 0.2 | loss segregation of such machines |
//! | `R_s` | maximum likelihood of the power balance (normal error) and of 0.075 pu `(P_N/kW)^-0.33` (log-normal error) | 40 % of the second | the same |
//! | `J` | 0.25 g·m² `(T_N/Nm)^1.35` | 50 % | the machine alone, without load |
//! | slip, loss, `1 - cos φ` | the plate's | 10 %, 7 %, 8 % | half the tolerances of IEC 60034-1 |
//!
//! **Validity.** Three-phase cage machines at sinusoidal rated voltage, the plate's connection. `L_M` is that of rated
//! flux, without a saturation curve. Double precision: for hosts and start-up code, not for the control period.
#![allow(non_snake_case)]

use crate::base::Base;
use crate::params::{Machine, ParamError, check};

/// Leakage inductance `σL_s`, per unit, and its relative standard deviation without and with a pull-out torque.
const L_SIGMA: f64 = 0.17;
const DEVIATION_L_SIGMA: (f64, f64) = (0.3, 0.12);
/// Share of the loss besides the copper's in what is neither output nor slip loss, and its deviation.
const OTHER_LOSS: f64 = 0.2;
const DEVIATION_OTHER_LOSS: f64 = 0.2;
/// Stator resistance by size, per unit at 1 kW, its exponent and relative deviation.
const R_S_1KW: f64 = 0.075;
const R_S_EXPONENT: f64 = -0.33;
const DEVIATION_R_S: f64 = 0.4;
/// Inertia by rated torque, kg·m² at 1 N·m, its exponent and relative deviation.
const J_1NM: f64 = 2.5e-4;
const J_EXPONENT: f64 = 1.35;
const DEVIATION_J: f64 = 0.5;
/// Relative deviations of slip, of the loss, of `1 - cos φ`, and of the current.
const DEVIATION_SLIP: f64 = 0.1;
const DEVIATION_LOSS: f64 = 0.07;
const DEVIATION_REACTIVE: f64 = 0.08;
const DEVIATION_CURRENT: f64 = 0.01;
/// Further relative deviation of the magnetising inductance: it is that of one flux on a bent curve.
const DEVIATION_CURVE: f64 = 0.05;
/// Error of the input power that the rounding of the plate's values makes.
const DEVIATION_ROUNDING: f64 = 0.003;
/// Largest excess of the output over what the rounded values of a plate leave of the input.
const ROUNDING: f64 = 0.01;
/// Largest rated slip.
const SLIP_MAX: f64 = 0.2;

/// What a nameplate says.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Nameplate {
    /// Rated power at the shaft, W.
    pub P_N: f64,
    /// Rated line-to-line voltage, V rms.
    pub U_N: f64,
    /// Rated phase current, A rms.
    pub I_N: f64,
    /// Rated frequency, Hz.
    pub f_N: f64,
    /// Rated speed, r/min.
    pub n_N: f64,
    /// Rated power factor.
    pub cos_phi: f64,
    /// Pull-out torque, N·m, where the catalogue gives it.
    pub T_max: Option<f64>,
    /// Inertia of the whole shaft, kg·m², where it is known.
    pub J: Option<f64>,
}

/// Relative standard deviations of a machine's parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Deviation {
    /// Of the stator resistance.
    pub R_s: f64,
    /// Of the rotor resistance.
    pub R_R: f64,
    /// Of the leakage inductance.
    pub L_sigma: f64,
    /// Of the magnetising inductance at rated flux.
    pub L_M: f64,
    /// Of the inertia.
    pub J: f64,
}

/// What is varied for the deviations: relative changes, and a change of `κ`.
#[derive(Clone, Copy, Default)]
struct Change {
    slip: f64,
    loss: f64,
    reactive: f64,
    current: f64,
    leakage: f64,
    other_loss: f64,
    typical: f64,
}

/// The four parameters of the inverse-Γ circuit.
type Circuit = [f64; 4];

impl Nameplate {
    /// The plate of a machine: its rated point at rated voltage, frequency and torque, without iron and friction loss.
    ///
    /// # Errors
    /// A machine outside its admissible range, or one whose pull-out torque at rated voltage is below the rated torque.
    pub fn of(machine: &Machine) -> Result<Self, ParamError> {
        machine.validate()?;
        let m = machine;
        let omega = m.omega_sR();
        let u = libm::sqrt(2.0 / 3.0) * m.U_N;
        // Z = R_s + jωL_σ + jωL_M ∥ R_R/s: impedance, squared current of the rotor and torque at a slip.
        let at = |slip: f64| {
            let (r, x) = (m.R_R / slip, omega * m.L_M);
            let d = r * r + x * x;
            let (re, im) = (m.R_s + r * x * x / d, omega * m.L_sigma + r * r * x / d);
            let z = libm::sqrt(re * re + im * im);
            (re, z, 1.5 * r * (u / z) * (u / z) * x * x / d)
        };
        let power = |torque: f64| torque * omega / f64::from(m.n_p);
        let (mut low, mut high) = (1e-5, SLIP_MAX);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if at(middle).2 < power(m.T_N) { low = middle } else { high = middle }
        }
        let (slip, (re, z, P_delta)) = (high, at(high));
        check("T_N", m.T_N, 0.0, 1.001 * P_delta / power(1.0), "N m")
            .map_err(|e| e.with_note("more than the machine develops at rated voltage up to 20 % slip"))?;
        Ok(Self {
            P_N: P_delta * (1.0 - slip),
            U_N: m.U_N,
            I_N: u / z / core::f64::consts::SQRT_2,
            f_N: m.f_N,
            n_N: (1.0 - slip) * 60.0 * m.f_N / f64::from(m.n_p),
            cos_phi: re / z,
            T_max: None,
            J: None,
        })
    }

    /// Pole pairs: those of the synchronous speed next above the rated one.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn n_p(&self) -> u32 {
        ((60.0 * self.f_N / self.n_N) as u32).max(1)
    }

    /// Rated slip.
    #[must_use]
    pub fn slip(&self) -> f64 {
        1.0 - f64::from(self.n_p()) * self.n_N / (60.0 * self.f_N)
    }

    /// Rated torque, N·m.
    #[must_use]
    pub fn T_N(&self) -> f64 {
        self.P_N / (core::f64::consts::TAU / 60.0 * self.n_N)
    }

    /// Rated electrical input, W.
    fn P_in(&self) -> f64 {
        libm::sqrt(3.0) * self.U_N * self.I_N * self.cos_phi
    }

    /// Checks every value, and the values against each other.
    ///
    /// # Errors
    /// The first one that no induction machine can have, with the range that the others leave for it.
    pub fn validate(&self) -> Result<(), ParamError> {
        check("P_N", self.P_N, 1.0, 1e7, "W")?;
        check("U_N", self.U_N, 1.0, 20e3, "V")?;
        check("I_N", self.I_N, 0.01, 10e3, "A")?;
        check("f_N", self.f_N, 1.0, 2000.0, "Hz")?;
        check("cos_phi", self.cos_phi, 0.2, 0.99, "")?;
        let synchronous = 60.0 * self.f_N;
        check("n_N", self.n_N, synchronous / 60.0 * (1.0 - SLIP_MAX), 0.9995 * synchronous, "r/min")?;
        let synchronous = synchronous / f64::from(self.n_p());
        check("n_N", self.n_N, (1.0 - SLIP_MAX) * synchronous, 0.9995 * synchronous, "r/min")
            .map_err(|e| e.with_note("rated slip must be between 0.05 and 20 % of the synchronous speed"))?;
        let P_in = self.P_in();
        check("P_N", self.P_N, 0.1 * P_in, (1.0 + ROUNDING) * (1.0 - self.slip()) * P_in, "W")
            .map_err(|e| e.with_note("the input sqrt(3) U_N I_N cos_phi less the slip loss is the upper bound"))?;
        if let Some(T_max) = self.T_max {
            check("T_max", T_max, 1.2 * self.T_N(), 8.0 * self.T_N(), "N m")?;
        }
        self.J.map_or(Ok(()), |J| check("J", J, 1e-7, 1e5, "kg m^2"))
    }

    /// The machine of the rated point and the deviation of each of its values.
    ///
    /// # Errors
    /// As [`Nameplate::validate`]; or the machine that would have this plate is outside the admissible range.
    pub fn machine(&self) -> Result<(Machine, Deviation), ParamError> {
        self.validate()?;
        let rated = self.assemble([1.0; 4]);
        let x_sigma = self.leakage(Base::new(&rated).l);
        let at = |change: Change| self.circuit(x_sigma, change);
        let circuit = at(Change::default())?;
        let machine = self.assemble(circuit);
        machine.validate().map_err(|e| e.with_note("no induction machine has this nameplate"))?;
        let leakage = if self.T_max.is_some() { DEVIATION_L_SIGMA.1 } else { DEVIATION_L_SIGMA.0 };
        let mut variance = [0.0; 4];
        for change in [
            Change { slip: DEVIATION_SLIP, ..Change::default() },
            Change { loss: DEVIATION_LOSS, ..Change::default() },
            Change { reactive: DEVIATION_REACTIVE, ..Change::default() },
            Change { current: DEVIATION_CURRENT, ..Change::default() },
            Change { leakage, ..Change::default() },
            Change { other_loss: DEVIATION_OTHER_LOSS, ..Change::default() },
            Change { typical: DEVIATION_R_S, ..Change::default() },
        ] {
            let varied = at(change).unwrap_or(circuit);
            for k in 0..4 {
                let d = varied[k] / circuit[k] - 1.0;
                variance[k] += d * d;
            }
        }
        // A balance that is limited to zero changes towards larger values only, which understates the deviation.
        let (_, of_likelihood) = self.resistance(&Change::default());
        variance[0] = variance[0].max(of_likelihood * of_likelihood);
        let [R_s, R_R, L_sigma, L_M] = variance.map(libm::sqrt);
        let L_M = libm::sqrt(L_M * L_M + DEVIATION_CURVE * DEVIATION_CURVE);
        let J = if self.J.is_some() { 0.02 } else { DEVIATION_J };
        Ok((machine, Deviation { R_s, R_R, L_sigma, L_M, J }))
    }

    fn assemble(&self, [R_s, R_R, L_sigma, L_M]: Circuit) -> Machine {
        let T_N = self.T_N();
        let J = self.J.unwrap_or_else(|| J_1NM * libm::pow(T_N, J_EXPONENT));
        let (U_N, I_N, f_N) = (self.U_N, self.I_N, self.f_N);
        Machine { R_s, R_R, L_sigma, L_M, n_p: self.n_p(), J, U_N, I_N, f_N, T_N, saturation: None }
    }

    /// Leakage inductance, H: the typical one, or by bisection that of the pull-out torque, which falls with it.
    fn leakage(&self, l_b: f64) -> f64 {
        let Some(T_max) = self.T_max else { return L_SIGMA * l_b };
        let (mut low, mut high) = (0.02 * l_b, 0.6 * l_b);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            let torque = self.circuit(middle, Change::default()).map_or(0.0, |c| self.pull_out(c));
            if torque > T_max { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Pull-out torque of a circuit at rated voltage and frequency, N·m: the rotor branch takes the most power if its
    /// resistance is the magnitude of the source impedance.
    fn pull_out(&self, [R_s, _, L_sigma, L_M]: Circuit) -> f64 {
        let omega = core::f64::consts::TAU * self.f_N;
        let (x_m, x) = (omega * L_M, omega * (L_M + L_sigma));
        let d = R_s * R_s + x * x;
        let u_sq = 2.0 / 3.0 * self.U_N * self.U_N * x_m * x_m / d;
        // jx_m (R_s + jx_σ)/(R_s + jx)
        let (re, im) = (R_s * x_m * x_m / d, x_m * (R_s * R_s + omega * L_sigma * x) / d);
        let z = libm::sqrt(re * re + im * im);
        0.75 * u_sq / (z + re) * f64::from(self.n_p()) / omega
    }

    /// The circuit of the rated point with a leakage inductance in H.
    fn circuit(&self, L_sigma: f64, change: Change) -> Result<Circuit, ParamError> {
        self.rated_point(self.resistance(&change).0, L_sigma * (1.0 + change.leakage), &change)
    }

    /// Stator resistance, Ω, and its relative standard deviation, by maximum likelihood of two sources: the power balance at the rated point, `B`
    /// with a normal error of standard deviation `b`, and the size, `T` with a log-normal error `σ`,
    ///
    /// ```text
    /// ln(R/T)/σ² + R (R - B)/b² = 0        between T and B
    /// deviation = 1/√(1/σ² + R (2R - B)/b²)      curvature of the log-likelihood in ln R
    /// ```
    ///
    /// Where the tolerances of slip and power factor leave no loss for the winding, `B = 0`, the size keeps `R` from zero. In plates of 600
    /// drawn motors with errors of cos φ up to 0.02 and of slip up to 20 % (uniform) `ln R` is off by 0.23 (rms; 0.98 at most); a mean of the two
    /// weighted by variances is off by 0.32 (1.57). Of exact plates both are off by 0.15.
    fn resistance(&self, change: &Change) -> (f64, f64) {
        let (P_in, slip, i) = (self.P_in(), self.slip(), self.I_N);
        let rest = |loss: f64, slip: f64| (P_in + (P_in - self.P_N) * loss - self.P_N / (1.0 - slip)).max(0.0);
        let per_ohm = 3.0 * i * i;
        let moved = rest(change.loss, slip * (1.0 + change.slip)) / (1.0 + change.current);
        let balance = (1.0 - OTHER_LOSS - change.other_loss) * moved / per_ohm;
        let typical = R_S_1KW * libm::pow(self.P_N * 1e-3, R_S_EXPONENT) * self.U_N / (libm::sqrt(3.0) * i);
        let of_balance = (DEVIATION_OTHER_LOSS * rest(0.0, slip)
            + DEVIATION_LOSS * (P_in - self.P_N)
            + DEVIATION_SLIP * slip * self.P_N
            + DEVIATION_ROUNDING * P_in)
            / per_ohm;
        let typical = typical * (1.0 + change.typical);
        let (sigma_sq, b_sq) = (DEVIATION_R_S * DEVIATION_R_S, of_balance * of_balance);
        let slope = |r: f64| libm::log(r / typical) / sigma_sq + r * (r - balance) / b_sq;
        let (mut low, mut high) = (balance.min(typical).max(1e-3 * typical), balance.max(typical));
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if slope(middle) < 0.0 { low = middle } else { high = middle }
        }
        let r = 0.5 * (low + high);
        let curvature = 1.0 / sigma_sq + r * (2.0 * r - balance) / b_sq;
        (r, libm::sqrt(1.0 / curvature.max(1.0)))
    }

    /// The circuit of the rated point with stator resistance and leakage inductance.
    fn rated_point(&self, R_s: f64, L_sigma: f64, change: &Change) -> Result<Circuit, ParamError> {
        let omega = core::f64::consts::TAU * self.f_N;
        let u = libm::sqrt(2.0 / 3.0) * self.U_N;
        let i = core::f64::consts::SQRT_2 * self.I_N * (1.0 + change.current);
        let slip = self.slip() * (1.0 + change.slip);
        let cos = 1.0 - (1.0 - self.cos_phi) * (1.0 + change.reactive);
        // ψ_R with the voltage as real axis: (U - R_s I)/jω - L_σ I.
        let (i_re, i_im) = (i * cos, -i * libm::sqrt((1.0 - cos * cos).max(0.0)));
        let (e_re, e_im) = (u - R_s * i_re, -R_s * i_im);
        let (re, im) = (e_im / omega - L_sigma * i_re, -e_re / omega - L_sigma * i_im);
        let psi = libm::sqrt(re * re + im * im);
        let i_d = (re * i_re + im * i_im) / psi;
        let i_q = (re * i_im - im * i_re) / psi;
        let part = |x: f64, least: f64| check("cos_phi", x / i, least, 1.0, "");
        part(i_d, 0.02).and_then(|()| part(i_q, 0.05)).map_err(|e| {
            ParamError { value: self.cos_phi, min: 0.2, max: 0.99, ..e }
                .with_note("with this power factor the rated current holds no magnetising current or no torque")
        })?;
        Ok([R_s, slip * omega * psi / i_q, L_sigma, psi / i_d])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{Rating, TModel};

    /// Ten machines of 0.37 to 160 kW at mains voltage, 48 V, four pole pairs.
    fn machines() -> [Machine; 10] {
        let m = |R_s, R_r, L_l, L_m, n_p, U_N, f_N, T_N| {
            let t = TModel { R_s, R_r, L_ls: L_l, L_lr: L_l, L_m };
            Machine::from_t_model(t, Rating { n_p, J: 0.01, U_N, I_N: 1.0, f_N, T_N })
        };
        [
            Machine::preset_2k2(),
            Machine::preset_11k(),
            m(24.0, 17.0, 0.055, 1.0, 2, 400.0, 50.0, 2.6),
            m(11.5, 8.0, 0.034, 0.63, 2, 400.0, 50.0, 5.1),
            m(1.4, 1.1, 7.5e-3, 0.16, 2, 400.0, 50.0, 26.6),
            m(0.26, 0.17, 2.2e-3, 57e-3, 2, 400.0, 50.0, 98.0),
            m(0.06, 0.036, 0.8e-3, 24e-3, 2, 400.0, 50.0, 291.0),
            m(0.0105, 0.0067, 0.27e-3, 8.4e-3, 2, 400.0, 50.0, 1030.0),
            m(0.013, 0.01, 36e-6, 1.5e-3, 2, 34.0, 100.0, 16.0),
            m(0.9, 0.75, 6e-3, 60e-3, 4, 400.0, 50.0, 73.0),
        ]
    }

    #[test]
    fn the_rated_point_gives_the_machine_back_within_its_deviations() {
        for m in machines() {
            let (got, d) = Nameplate::of(&m).unwrap().machine().unwrap();
            assert_eq!(got.n_p, m.n_p);
            for (name, got, want, d) in
                [("R_s", got.R_s, m.R_s, d.R_s), ("R_R", got.R_R, m.R_R, d.R_R), ("L_M", got.L_M, m.L_M, d.L_M)]
            {
                let e = got / want - 1.0;
                assert!(e.abs() < 2.5 * d, "{name} of {:.4} ohm: {e:.3} at a deviation of {d:.3}", m.R_s);
                assert!((0.02..0.5).contains(&d), "{name}: deviation {d}");
            }
        }
    }

    /// A plate of 160 kW whose rounded values, within their tolerances, leave no loss for the winding. A mean weighted by variances is a third of the
    /// resistance of its size.
    #[test]
    fn a_plate_that_leaves_no_loss_for_the_winding_keeps_half_of_the_resistance_of_its_size() {
        let plate = Nameplate {
            P_N: 160e3,
            U_N: 400.0,
            I_N: 272.0,
            f_N: 50.0,
            n_N: 1489.0,
            cos_phi: 0.855,
            T_max: None,
            J: None,
        };
        assert!(plate.P_N / (1.0 - plate.slip()) > 0.995 * plate.P_in());
        let (machine, deviation) = plate.machine().unwrap();
        let of_size = R_S_1KW * libm::pow(160.0, R_S_EXPONENT) * 400.0 / (libm::sqrt(3.0) * 272.0);
        let part = machine.R_s / of_size;
        assert!((0.4..0.7).contains(&part), "{part}");
        assert!((0.2..0.8).contains(&deviation.R_s), "{}", deviation.R_s);
    }

    #[test]
    fn with_the_true_resistance_and_leakage_the_rated_point_is_exact() {
        for m in machines() {
            let [_, R_R, _, L_M] =
                Nameplate::of(&m).unwrap().rated_point(m.R_s, m.L_sigma, &Change::default()).unwrap();
            assert!((R_R / m.R_R - 1.0).abs() < 1e-9 && (L_M / m.L_M - 1.0).abs() < 1e-9, "{R_R} {L_M}");
        }
    }

    #[test]
    fn a_pull_out_torque_replaces_the_typical_leakage() {
        for m in machines() {
            let p = Nameplate::of(&m).unwrap();
            let T_max = p.pull_out([m.R_s, m.R_R, m.L_sigma, m.L_M]);
            let (got, d) = Nameplate { T_max: Some(T_max), ..p }.machine().unwrap();
            let e = got.L_sigma / m.L_sigma - 1.0;
            assert!(e.abs() < 2.0 * d.L_sigma, "{e} at {}", m.R_s);
        }
    }

    #[test]
    fn an_impossible_plate_names_the_value_and_the_range_that_the_others_leave() {
        let good = Nameplate {
            P_N: 4000.0,
            U_N: 400.0,
            I_N: 8.2,
            f_N: 50.0,
            n_N: 1435.0,
            cos_phi: 0.82,
            T_max: None,
            J: None,
        };
        let (m, _) = good.machine().unwrap();
        assert!((m.T_N - 26.62).abs() < 0.01 && m.n_p == 2);
        for (bad, field) in [
            (Nameplate { n_N: 1500.0, ..good }, "n_N"),
            (Nameplate { n_N: 1100.0, ..good }, "n_N"),
            (Nameplate { P_N: 5500.0, ..good }, "P_N"),
            (Nameplate { I_N: 82.0, ..good }, "P_N"),
            (Nameplate { U_N: f64::NAN, ..good }, "U_N"),
            (Nameplate { cos_phi: 1.2, ..good }, "cos_phi"),
            (Nameplate { T_max: Some(20.0), ..good }, "T_max"),
            (Nameplate { J: Some(-1.0), ..good }, "J"),
        ] {
            assert_eq!(bad.machine().unwrap_err().field, field, "{bad:?}");
        }
    }
}
