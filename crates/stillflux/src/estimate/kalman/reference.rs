//! Reference for the tests: the same filter without a schedule, `P⁻ = F P Fᵀ + Q`, `K = P⁻ Hᵀ/S`, `P = (I - K H) P⁻`
//! with dense `f64` matrices of nalgebra, built from [`super::model`] and [`super::noise`], at the end of each block.
//! The scheduled filter must agree with it, and the derivatives in the model with central differences of its equations.

use super::covariance::N;
use super::intermediate::{Gain, Intermediate};
use super::load::Load;
use super::model::{
    B, BlockMeans, C, C_MAX, GAMMA, KNEE, LEAKAGE, M, Model, OMEGA_HELD, OperatingPoint, PSI, ROTOR, RS, SCALE_B,
    SCALE_C, SCALE_GAMMA, SCALE_K, SCALE_LEAKAGE, SCALE_PSI, SCALE_R, SCALE_ROTOR, SCALE_V, TRANSIENT, V,
};
use super::schedule::OMEGA_LEAKAGE_HELD;
use super::{
    B_MAX, Filter, FilterConfig, GAMMA_RANGE, Identified, Input, KNEE_RANGE, LEAKAGE_RANGE, NIS_THRESHOLD, R_S_RANGE,
    SIGMA_LOST, V_MAX, noise,
};
use crate::base::{Base, PerUnit};
use crate::inverter::Distortion;
use crate::params::{Inverter, Machine, Saturation};
use crate::space::{AlphaBeta, Dq, Rotator};
use nalgebra::{SMatrix, SVector, Vector2};

type State = SVector<f64, N>;
type Matrix = SMatrix<f64, N, N>;

fn config(machine: &Machine, inverter: &Inverter) -> (FilterConfig<f64>, PerUnit) {
    let pu = PerUnit::new(machine, inverter).unwrap();
    let identified = Identified { offset: true, resistance: true, flux: true };
    (FilterConfig::new(machine, inverter, &pu, 1.0, true, identified), pu)
}

fn vector(v: &AlphaBeta<f64>) -> Vector2<f64> {
    Vector2::new(v.re(), v.im())
}

/// Sizes of the scaled states.
fn scale(model: &Model<f64>) -> State {
    State::from([
        SCALE_PSI,
        SCALE_PSI,
        SCALE_PSI,
        SCALE_B,
        SCALE_B,
        SCALE_R * model.r_s,
        SCALE_V,
        SCALE_K,
        SCALE_LEAKAGE,
        SCALE_GAMMA,
        SCALE_C,
    ])
}

/// `ψ_R = χ - l̂ i_m`, `m` and `b` of a state whose first components are `χ`. The present estimate `l̂` of the leakage is
/// that of the parameters.
fn parts(model: &Model<f64>, x: &State, i_m: Vector2<f64>) -> (Vector2<f64>, f64, Vector2<f64>) {
    (Vector2::new(x[PSI], x[PSI + 1]) - i_m * model.sigma_l_s, x[M], Vector2::new(x[B], x[B + 1]))
}

/// Inputs of a block: measured current and its change, voltage, and the inverter model's loss.
struct Block {
    i_m: Vector2<f64>,
    d_i: Vector2<f64>,
    u_s: Vector2<f64>,
    loss: Distortion<f64>,
}

/// `f` of the model: a state after a block. `V`, `KNEE` and `LEAKAGE` hold the logarithmic errors.
fn f(model: &Model<f64>, x: &State, &Block { i_m, d_i, u_s, ref loss }: &Block) -> State {
    let (u_l, u_k) = (vector(&loss.vector()), -vector(&AlphaBeta::from_phases(loss.by_knee())));
    let (psi_r, m, b) = parts(model, x, i_m);
    let (i, n) = (i_m - b, psi_r.normalize());
    let leakage = model.sigma_l_s * x[LEAKAGE].exp();
    let mut next = *x;
    let psi_s = psi_r + i * leakage;
    let psi_next = psi_s + (u_s - u_l * x[V] - u_k * x[KNEE] - i * x[RS]) * model.delta;
    let psi_r_next = psi_next - (i + d_i) * leakage;
    let chi = psi_r_next + (i_m + d_i) * model.sigma_l_s;
    (next[PSI], next[PSI + 1]) = (chi.x, chi.y);
    next[M] = m + model.r_r_block * i.dot(&n) - model.decay * x[GAMMA] * model.curve(m, x[C]).m_g;
    next
}

/// `h` of the model.
fn h(model: &Model<f64>, x: &State, i_m: Vector2<f64>) -> f64 {
    let (psi_r, m, _) = parts(model, x, i_m);
    psi_r.norm() - m
}

/// The operating point of a state.
fn point(model: &Model<f64>, x: &State, block: &Block, omega_s: f64) -> OperatingPoint<f64> {
    let (psi_r, m, b) = parts(model, x, block.i_m);
    let i = block.i_m - b;
    let n = psi_r.normalize();
    let means = BlockMeans {
        n: Rotator { cos: n.x, sin: n.y },
        inv_psi_r: 1.0 / psi_r.norm(),
        i_d: i.dot(&n),
        i_q: n.x * i.y - n.y * i.x,
        i_s: AlphaBeta::new(i.x, i.y),
        d_leakage_flux: AlphaBeta::new(block.d_i.x, block.d_i.y) * model.sigma_l_s,
        loss: block.loss,
        omega_s,
        steady: false,
    };
    model.operating_point(&means, model.magnetisation(m, x[GAMMA], x[C]), x[GAMMA], 1.0).0
}

/// `F` of the scaled states, row by row from the model.
fn transition(model: &Model<f64>, at: &OperatingPoint<f64>, r_s: f64, gamma: f64) -> Matrix {
    let mut big_f = Matrix::identity();
    big_f[(M, M)] = model.rotor_own(at, 1.0);
    for (j, x) in model.rotor_row(at, gamma, 1.0) {
        big_f[(M, j)] = x;
    }
    let held = at.omega_s.abs() > OMEGA_HELD;
    for k in 0..2 {
        let seen = if held { 0.0 } else { 1.0 };
        let (u_l, u_k) = (vector(&at.loss.vector()), -vector(&AlphaBeta::from_phases(at.loss.by_knee())));
        let row = model.flux_row(
            vector(&at.i_s)[k] * seen,
            u_l[k] * seen,
            u_k[k] * seen,
            vector(&at.d_leakage_flux)[k] * seen,
            r_s,
        );
        for (j, x) in [B + k, RS, V, KNEE, LEAKAGE].into_iter().zip(row) {
            big_f[(PSI + k, j)] = x;
        }
    }
    big_f
}

/// `H` of the scaled states.
fn measurement(at: &OperatingPoint<f64>) -> SMatrix<f64, 1, N> {
    let mut row = SMatrix::zeros();
    for (j, x) in Model::measurement_row(at) {
        row[j] = x;
    }
    row
}

/// Central differences of `g` over the scaled states.
fn differences<const K: usize>(x: &State, scale: &State, g: impl Fn(&State) -> SVector<f64, K>) -> SMatrix<f64, K, N> {
    SMatrix::from_columns(&core::array::from_fn::<_, N, _>(|j| {
        let step = 1e-4 * scale[j];
        let (mut up, mut down) = (*x, *x);
        up[j] += step;
        down[j] -= step;
        (g(&up) - g(&down)) / (2.0 * step / scale[j])
    }))
}

/// A repeatable sequence of numbers in (-1, 1).
fn noise_source() -> impl FnMut() -> f64 {
    let mut seed = 0x9e37_79b9_u32;
    move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(seed >> 8) / f64::from(1_u32 << 23) - 1.0
    }
}

fn machines() -> [(Machine, Inverter); 4] {
    let saturated = Machine { saturation: Some(Saturation { L_u: 0.085, a: 0.758, S: 5.0 }), ..Machine::preset_11k() };
    let bridge = Inverter { c_out: 1e-9, ..Inverter::preset_2k2() };
    [
        (Machine::preset_2k2(), bridge),
        (Machine::preset_11k(), Inverter { c_out: 2e-9, ..Inverter::preset_11k() }),
        (saturated, Inverter { c_out: 0.0, ..Inverter::preset_11k() }),
        // Slots of one period.
        (Machine::preset_11k(), Inverter { f_s: 5e3, ..Inverter::preset_11k() }),
    ]
}

#[test]
fn transition_and_measurement_rows_are_the_derivatives_of_the_model() {
    let mut r = noise_source();
    for (machine, inverter) in machines() {
        let (c, _) = config(&machine, &inverter);
        let (model, scale) = (&c.model, scale(&c.model));
        for _ in 0..200 {
            let block = Block {
                i_m: Vector2::new(r(), r()),
                d_i: Vector2::new(r(), r()) * 0.1,
                u_s: Vector2::new(r(), r()) * 0.1,
                loss: Distortion {
                    phases: [r() * 0.03, r() * 0.03, r() * 0.03],
                    #[cfg(feature = "legs")]
                    legs: [0.0; 3],
                    least: 0.003,
                    full: 0.033,
                },
            };
            let mut x = State::zeros();
            (x[PSI], x[PSI + 1]) = (0.8 + 0.2 * r(), 0.6 + 0.2 * r());
            (x[M], x[B], x[B + 1]) = (0.9 + 0.2 * r(), 0.01 * r(), 0.01 * r());
            (x[RS], x[V], x[KNEE]) = (model.r_s * (1.0 + 0.2 * r()), 0.1 * r(), 0.2 * r());
            (x[GAMMA], x[C]) = (1.0 + 0.1 * r(), 0.2 + 0.1 * r());
            let at = point(model, &x, &block, 0.05);

            let exact = transition(model, &at, x[RS], x[GAMMA]);
            let numeric = differences(&x, &scale, |x| f(model, x, &block).component_div(&scale));
            assert!((exact - numeric).amax() < 1e-6, "F is off by {}", exact - numeric);

            let exact = measurement(&at);
            let numeric = differences(&x, &scale, |x| SVector::from([h(model, x, block.i_m) / SCALE_PSI]));
            assert!((exact - numeric).amax() < 1e-6, "H is off by {}", exact - numeric);
        }
    }
}

/// The dense filter.
struct Reference {
    c: FilterConfig<f64>,
    /// With the factors `1 + v̂`, `k̂` and `l̂` instead of their logarithmic errors.
    x: State,
    p: Matrix,
    /// `P Hᵀ/S`, of the scaled states; zero where the block corrects nothing.
    gain: State,
    /// Parameters after the correction, which takes effect one slot late.
    pending: Option<State>,
    inv_s: f64,
    /// Deviation of the angle, rad.
    sigma: f64,
    sigma_of_late: f64,
    /// Direction of the rotor flux when the gain was computed.
    n: Vector2<f64>,
    i_s: Vector2<f64>,
    /// Current reference at the end of the last block.
    i_ref: Vector2<f64>,
    load: Load<f64>,
    sum: Vector2<f64>,
    period: u32,
    signed_nis: f64,
    hold_off: u32,
    /// Reciprocal magnitudes of `ψ_s` and `ψ_R` for [`Rotator::near`], whose Newton step is part of the filter.
    inv_psi: [f64; 2],
}

impl Reference {
    /// A copy of a scheduled filter, all of whose work of a block is done.
    fn of(c: &FilterConfig<f64>, filter: &Filter<f64>) -> Self {
        let b = filter.b();
        let chi = filter.value() + b * filter.sigma_l_s(c);
        let value = |x: &crate::scalar::Integrator<f64>| x.value();
        Self {
            c: *c,
            x: State::from([
                chi.re(),
                chi.im(),
                value(&filter.m),
                b.re(),
                b.im(),
                filter.r_s(),
                1.0 + filter.v(),
                filter.knee(),
                filter.leakage(),
                value(&filter.gamma),
                value(&filter.c),
            ]),
            p: dense(filter),
            gain: match filter.intermediate {
                Intermediate::Gain(Gain { ph }) => State::from(ph) * filter.inv_s,
                _ => State::zeros(),
            },
            pending: None,
            inv_s: filter.inv_s,
            sigma: filter.sigma,
            sigma_of_late: filter.sigma_of_late,
            n: Vector2::new(filter.point.n.cos, filter.point.n.sin),
            i_s: vector(&filter.i_s),
            i_ref: vector(&filter.point.i_s),
            load: filter.load,
            sum: Vector2::new(filter.sum.re(), filter.sum.im()),
            period: filter.period.into(),
            signed_nis: filter.signed_nis,
            hold_off: filter.hold_off.into(),
            inv_psi: [1.0 / filter.magnitude(), filter.point.inv_psi_r],
        }
    }

    /// Direction and magnitude of a flux, `k`: 0 of the stator, 1 of the rotor.
    fn polar(&mut self, k: usize, psi: Vector2<f64>) -> (Vector2<f64>, f64) {
        let (n, magnitude, inv) = Rotator::near(&AlphaBeta::new(psi.x, psi.y), self.inv_psi[k]);
        self.inv_psi[k] = inv;
        (Vector2::new(n.cos, n.sin), magnitude)
    }

    fn step(&mut self, input: &Input<'_, f64>) {
        let (model, t_s) = (self.c.model, self.c.t_s);
        let b = Vector2::new(self.x[B], self.x[B + 1]);
        let leakage = model.sigma_l_s * self.x[LEAKAGE];
        let i_s = vector(&input.i_m) - b;
        let psi = Vector2::new(self.x[PSI], self.x[PSI + 1]) - b * leakage;
        let psi = psi + (vector(&input.u_s) - (self.i_s + i_s) * (0.5 * self.x[RS])) * t_s;
        let chi = psi + b * leakage;
        (self.x[PSI], self.x[PSI + 1], self.i_s) = (chi.x, chi.y, i_s);
        let (d, psi_s) = self.polar(0, psi);
        self.sum += Vector2::new(d.dot(&i_s), d.x * i_s.y - d.y * i_s.x);
        if self.period + 1 == 1 << self.c.slot_bits
            && let Some(corrected) = self.pending.take()
        {
            self.x.rows_mut(RS, N - RS).copy_from(&corrected.rows(RS, N - RS));
        }
        self.period += 1;
        if self.period < u32::from(self.c.block) {
            return;
        }
        self.period = 0;
        let i_dq = self.sum / f64::from(self.c.block);
        self.sum = Vector2::zeros();

        let psi_r = psi - i_s * leakage;
        let (n, magnitude) = self.polar(1, psi_r);
        let inv = self.inv_psi[1];
        // ψ_R·i and ψ_R×i of the mean current, which is given in coordinates of the stator flux.
        let along = psi_s * i_dq.x - leakage * i_dq.norm_squared();
        let across = psi_s * i_dq.y;
        let gamma = self.x[GAMMA];
        let i_ref = Rotator { cos: d.x, sin: d.y }.to_stator(input.i_ref);
        let d_i = vector(&i_ref) - self.i_ref;
        self.i_ref = vector(&i_ref);
        self.load.remember(model.load(input.i_ref.im(), inv), self.c.noise.load_remembered);
        let means = BlockMeans {
            n: Rotator { cos: n.x, sin: n.y },
            inv_psi_r: inv,
            i_d: along * inv,
            i_q: across * inv,
            i_s: i_ref,
            d_leakage_flux: AlphaBeta::new(d_i.x, d_i.y) * leakage,
            loss: *input.loss,
            omega_s: input.omega_s,
            steady: self.load.is_steady(self.c.load_corner, input.i_ref.im(), input.omega_s),
        };
        let (at, increment) =
            model.operating_point(&means, model.magnetisation(self.x[M], gamma, self.x[C]), gamma, 1.0);
        self.x[M] += increment;
        let z = (self.x[M] - magnitude) / SCALE_PSI;
        if self.hold_off == 0 {
            let nis = (z * z * self.inv_s * self.c.noise.part).min(9.0);
            self.signed_nis += self.c.noise.nis_corner * (nis * z.signum() - self.signed_nis);
        } else {
            self.hold_off -= 1;
        }
        if at.omega_s.abs() > OMEGA_HELD {
            let (cos, sin) = (self.n.dot(&n), self.n.x * n.y - self.n.y * n.x);
            let (x, y) = (self.gain[PSI], self.gain[PSI + 1]);
            (self.gain[PSI], self.gain[PSI + 1]) = (cos * x - sin * y, sin * x + cos * y);
        }
        self.n = n;
        let mut by = (self.gain * z).component_mul(&scale(&model));
        let psi =
            psi + Vector2::new(by[PSI], by[PSI + 1]) + (i_s * by[LEAKAGE] - Vector2::new(by[B], by[B + 1])) * leakage;
        for factor in [V, KNEE, LEAKAGE] {
            by[factor] *= self.x[factor];
        }
        let mut x = self.x + by;
        let r_s = model.r_s;
        for (k, (low, high)) in [
            (M, (0.0, 3.0)),
            (B, (-B_MAX, B_MAX)),
            (B + 1, (-B_MAX, B_MAX)),
            (RS, (R_S_RANGE.0 * r_s, R_S_RANGE.1 * r_s)),
            (V, (1.0 - V_MAX, 1.0 + V_MAX)),
            (KNEE, KNEE_RANGE),
            (LEAKAGE, LEAKAGE_RANGE),
            (GAMMA, GAMMA_RANGE),
            (C, (0.0, C_MAX)),
        ] {
            x[k] = x[k].clamp(low, high);
        }
        let chi = psi + Vector2::new(x[B], x[B + 1]) * (model.sigma_l_s * x[LEAKAGE]);
        (x[PSI], x[PSI + 1]) = (chi.x, chi.y);
        self.x.rows_mut(0, RS).copy_from(&x.rows(0, RS));
        self.x[LEAKAGE] = x[LEAKAGE];
        self.pending = Some(x);
        self.update_covariance(&at, x[RS], x[GAMMA]);
    }

    /// Prediction with noise, gain, update.
    fn update_covariance(&mut self, at: &OperatingPoint<f64>, r_s: f64, gamma: f64) {
        let model = &self.c.model;
        let big_f = transition(model, at, r_s, gamma);
        let mut p = big_f * self.p * big_f.transpose();

        let omega = at.omega_s.abs();
        let held = omega > OMEGA_HELD;
        let excess = if held { 0.0 } else { (self.signed_nis.abs() - NIS_THRESHOLD).max(0.0) };
        let mut q = Matrix::from_diagonal(&State::from(self.c.noise.walk(excess)));
        let room = (noise::WARMED - p[(RS, RS)]).max(0.0);
        let inductances_held = !held && at.steady;
        let leakage_held = held || inductances_held || omega <= OMEGA_LEAKAGE_HELD;
        if leakage_held {
            q[(LEAKAGE, LEAKAGE)] = 0.0;
            let own = p[(LEAKAGE, LEAKAGE)];
            p.row_mut(LEAKAGE).scale_mut(self.c.noise.remembered);
            p.column_mut(LEAKAGE).scale_mut(self.c.noise.remembered);
            p[(LEAKAGE, LEAKAGE)] = own;
        }
        let isolated = [(RS, held), (V, held), (KNEE, held), (LEAKAGE, held || inductances_held)];
        for (k, isolated) in isolated.into_iter().chain([(GAMMA, inductances_held), (C, held || inductances_held)]) {
            if isolated {
                match k {
                    RS => q[(k, k)] = q[(k, k)].min(room),
                    GAMMA => {}
                    C if !held => {}
                    _ => q[(k, k)] = 0.0,
                }
                let own = p[(k, k)];
                p.row_mut(k).fill(0.0);
                p.column_mut(k).fill(0.0);
                p[(k, k)] = own;
            }
        }
        q[(M, M)] += self.c.noise.lag(model.decay, at.transient);
        q[(M, M)] += self.c.noise.by_turn(at.turn, self.x[M], self.sigma, omega);
        q[(M, M)] += self.c.noise.by_curvature(model.decay, self.x[M], self.sigma_of_late, omega);
        for k in 0..2 {
            q[(PSI + k, PSI + k)] += self.c.noise.induced(omega);
        }
        // A phase near its current zero: noise along its axis.
        for axis in [0.0, 120.0, -120.0_f64] {
            let e = Vector2::new(axis.to_radians().cos(), axis.to_radians().sin());
            if self.c.noise.near_zero(e.dot(&vector(&at.i_s))) {
                let mut view = q.fixed_view_mut::<2, 2>(PSI, PSI);
                view += e * e.transpose() * self.c.noise.zero(omega, self.load.of_late());
            }
        }
        p += q;

        let row = measurement(at);
        let n = Vector2::new(at.n.cos, at.n.sin);
        let across = Vector2::new(-n.y, n.x);
        let turned = (across.transpose() * p.fixed_view::<2, 2>(PSI, PSI) * across)[0];
        let mut of_angle = turned;
        if inductances_held {
            // What the errors of inductances that are held turn the field by.
            let i_s = vector(&at.i_s);
            let (i_d, i_q) = (n.dot(&i_s), across.dot(&i_s));
            let by_leakage = i_q * model.sigma_l_s * self.x[LEAKAGE] * SCALE_LEAKAGE / SCALE_PSI;
            let by_gamma = self.x[M] * (0.5 * i_d * i_q.recip()).clamp(-2.0, 2.0) * SCALE_GAMMA / SCALE_PSI;
            of_angle += by_leakage.powi(2) * p[(LEAKAGE, LEAKAGE)] + by_gamma.powi(2) * p[(GAMMA, GAMMA)];
        }
        self.sigma = of_angle.sqrt() * SCALE_PSI * at.inv_psi_r;
        self.sigma_of_late = (self.sigma_of_late * self.c.noise.sigma_remembered).max(self.sigma);
        // The second-order term of |ψ_R|: twice the square of σ² |ψ_R|, both in units of the scale.
        let second = turned * SCALE_PSI * at.inv_psi_r;
        let further = noise::MEASUREMENT + at.transient * at.transient + 2.0 * second * second;
        let s = (row * p * row.transpose())[0] + further * self.c.noise.part;
        self.inv_s = 1.0 / s;
        self.gain = p * row.transpose() / s;
        let of_leakage = p[(LEAKAGE, LEAKAGE)];
        p -= self.gain * (row * p);
        if leakage_held {
            // Schmidt's update: the state and its variance stay.
            p[(LEAKAGE, LEAKAGE)] = of_leakage;
            self.gain[LEAKAGE] = 0.0;
        }
        for k in 0..N {
            p[(k, k)] = p[(k, k)].max(noise::FLOOR);
        }
        self.p = p;
    }
}

/// The covariance of a scheduled filter.
fn dense(filter: &Filter<f64>) -> Matrix {
    Matrix::from_fn(|i, j| filter.p.get(i, j))
}

/// A machine whose current is impressed in the *estimated* field, so that errors of the filter act back on its inputs.
/// Exact in every period but for the rotor flux, integrated in ten steps.
pub(super) struct ClosedLoop {
    pub c: FilterConfig<f64>,
    pub filter: Filter<f64>,
    psi_r: Vector2<f64>,
    i: Vector2<f64>,
    r_r: f64,
    inv_tau_r: f64,
    i_d: f64,
    /// Loss of the inverter model, and the current reference.
    loss: Distortion<f64>,
    i_ref: Dq<f64>,
    /// Resistance and leakage inductance of the winding, relative to the parameters.
    pub r_s: f64,
    leakage: f64,
    offset: Vector2<f64>,
}

/// Loss of the inverter model, per unit, and its relative error.
const LOSS: f64 = 0.03;
const LOSS_ERROR: f64 = 0.1;

impl ClosedLoop {
    pub fn new(machine: &Machine, inverter: &Inverter) -> Self {
        Self::identifying(machine, inverter, Identified { offset: true, resistance: true, flux: true })
    }

    /// With a filter that identifies some effects alone.
    pub fn identifying(machine: &Machine, inverter: &Inverter, identified: Identified) -> Self {
        let pu = PerUnit::new(machine, inverter).unwrap();
        let c = FilterConfig::new(machine, inverter, &pu, 1.0, true, identified);
        let b = Base::new(machine);
        let psi = 0.95;
        let i_d = psi / (machine.L_M / b.l);
        let mut filter = Filter::new(&c);
        let i = Vector2::new(i_d, 0.0);
        filter.start(&c, &AlphaBeta::new(i.x, i.y));
        filter.settle(&c, psi + i_d * pu.sigma_l_s);
        Self {
            filter,
            psi_r: Vector2::new(psi, 0.0),
            i,
            r_r: pu.r_r,
            inv_tau_r: 1.0 / pu.tau_r,
            i_d,
            loss: Distortion::default(),
            i_ref: Dq::default(),
            r_s: 1.05,
            leakage: 1.1,
            offset: Vector2::new(3e-4, -2e-4),
            c,
        }
    }

    /// One period at a speed and a torque current; returns the inputs of the filter.
    pub fn step(&mut self, omega: f64, i_q: f64) -> Input<'_, f64> {
        let (c, t_s) = (&self.c, self.c.t_s);
        let i_ref = Dq::new(self.i_d, i_q);
        let next = vector(&self.filter.field().to_stator(&i_ref));
        let sigma = c.model.sigma_l_s * self.leakage;
        let before = self.psi_r + self.i * sigma;
        for k in 0..10 {
            let i = self.i + (next - self.i) * ((f64::from(k) + 0.5) / 10.0);
            let turn = Vector2::new(-self.psi_r.y, self.psi_r.x) * omega;
            self.psi_r += (i * self.r_r - self.psi_r * self.inv_tau_r + turn) * (t_s / 10.0);
        }
        let mean = (self.i + next) * 0.5;
        let after = self.psi_r + next * sigma;
        // The inverter model takes a third of LOSS per phase, by the sign of its current.
        let phases = AlphaBeta::new(mean.x, mean.y).to_phases();
        let loss = Distortion {
            phases: phases.map(|i| LOSS * (i * 20.0).clamp(-1.0, 1.0)),
            #[cfg(feature = "legs")]
            legs: [0.0; 3],
            least: 0.0,
            full: LOSS,
        };
        let u = (after - before) / t_s + mean * (c.model.r_s * self.r_s) + vector(&loss.vector()) * LOSS_ERROR;
        self.i = next;
        let i_m = next + self.offset;
        let omega_s = omega + self.r_r * i_q / self.psi_r.norm();
        (self.loss, self.i_ref) = (loss, i_ref);
        let (loss, i_ref) = (&self.loss, &self.i_ref);
        let input = Input { u_s: AlphaBeta::new(u.x, u.y), loss, i_m: AlphaBeta::new(i_m.x, i_m.y), i_ref, omega_s };
        self.filter.step(&self.c, &input, false);
        input
    }

    fn angle(&self) -> f64 {
        let psi = vector(&self.filter.value());
        let truth = self.psi_r + self.i * (self.c.model.sigma_l_s * self.leakage);
        (truth.x * psi.y - truth.y * psi.x).atan2(truth.dot(&psi)).to_degrees()
    }
}

/// Speed and torque current of the closed loops: light load, load, fast (resistance held), then slow through the
/// zeros of the phase currents, where the winding's resistance also steps, until the load is steady (inductances held).
fn profile(t: f64) -> (f64, f64) {
    match t {
        t if t < 0.5 => (0.03, 0.0),
        t if t < 2.0 => (0.03, 0.5),
        t if t < 2.5 => (0.03 + (t - 2.0) * 0.64, 0.5),
        t if t < 3.5 => (0.35, 0.3),
        t if t < 4.0 => (0.35 - (t - 3.5) * 0.74, 0.5),
        _ => (-0.02, 0.5),
    }
}

#[test]
fn the_scheduled_filter_is_the_dense_one_over_a_closed_loop() {
    for (machine, inverter) in machines() {
        let mut rig = ClosedLoop::new(&machine, &inverter);
        while rig.filter.period != rig.c.block - 1 {
            rig.step(0.03, 0.0);
        }
        let mut reference = Reference::of(&rig.c, &rig.filter);
        let (mut held, mut steady, mut stepped, mut near_zero, mut angle) = (false, false, false, false, 0.0);
        let scale = scale(&rig.c.model);
        for k in 0..90_000 {
            let t = f64::from(k) * 1e-4;
            if k == 50_000 {
                rig.r_s *= 1.4;
            }
            let (omega, i_q) = profile(t);
            let input = rig.step(omega, i_q);
            reference.step(&input);
            let f = &rig.filter;
            angle += rig.angle().abs() / 90_000.0;
            held |= f.point.omega_s > OMEGA_HELD;
            steady |= f.point.inductances_held(&rig.c.model);
            stepped |= f.nis() > NIS_THRESHOLD;
            near_zero |=
                f.point.omega_s.abs() < 0.05 && f.point.i_s.to_phases().iter().any(|i| rig.c.noise.near_zero(*i));
            if f.period == rig.c.block - 1 {
                let p = dense(f);
                // In units of the deviations.
                let sigma = reference.p.diagonal().map(f64::sqrt);
                let apart = (p - reference.p).component_div(&(sigma * sigma.transpose())).amax();
                assert!(apart < 1e-8, "{t} s: P is apart by {apart}: {}", p - reference.p);
                let x = Reference::of(&rig.c, f).x;
                let apart = (x - reference.x).component_div(&scale).amax();
                assert!(apart < 1e-8, "{t} s: the states are apart by {apart}");
                // Twice a second it begins anew: near zero stator frequency nothing reduces what rounding leaves.
                if k % 5000 < u32::from(rig.c.block) {
                    reference = Reference::of(&rig.c, f);
                }
            }
        }
        let branches = [held, steady, stepped, near_zero];
        assert_eq!(branches, [true; 4], "the loop passes through every branch");
        assert!(rig.angle().abs() < 15.0, "not lost: {}° at the end", rig.angle());
        assert!(angle < 15.0, "not lost: {angle}° in the mean");
    }
}

#[test]
fn a_direct_current_adds_the_derivative_by_the_rotor_resistance() {
    for (machine, inverter) in machines() {
        let mut rig = ClosedLoop::new(&machine, &inverter);
        rig.filter.begin_direct(&rig.c);
        for _ in 0..500 {
            rig.step(0.0, 0.0);
        }
        let (c, filter) = (rig.c, &mut rig.filter);
        // Away from the steady state.
        filter.point.transient = 0.4;
        let (at, gamma, rotor) = (filter.point, filter.gamma.value(), filter.rotor_by_current(&c));
        let mut big_f = Matrix::identity();
        big_f[(M, M)] = c.model.rotor_own(&at, rotor);
        for (j, x) in c.model.rotor_row(&at, gamma, rotor) {
            big_f[(M, j)] = x;
        }
        big_f[(M, ROTOR)] = c.model.by_rotor(&at, rotor);
        let before = dense(filter);
        filter.rotor(&c);
        let off = dense(filter) - big_f * before * big_f.transpose();
        assert!(off.amax() < 1e-9 * before.amax(), "{}", off.amax());
        // The increment of `m` is proportional to the resistance.
        let increment =
            rotor * c.model.delta * (0.4 * SCALE_PSI / TRANSIENT) * c.model.r_r_block / (c.model.delta * c.model.l_m);
        assert!((big_f[(M, ROTOR)] * SCALE_PSI / SCALE_ROTOR / increment - 1.0).abs() < 1e-9);
    }
}

#[test]
fn the_covariance_stays_positive_after_a_new_beginning_in_any_slot() {
    let [(machine, inverter), ..] = machines();
    let mut rig = ClosedLoop::new(&machine, &inverter);
    // As a loss leaves it: offsets that were never read, nothing corrected, until the angle is unknown.
    let correct = rig.c;
    let identified = Identified { offset: true, resistance: true, flux: false };
    let pu = PerUnit::new(&machine, &inverter).unwrap();
    rig.c = FilterConfig::new(&machine, &inverter, &pu, 1.0, false, identified);
    rig.filter = Filter::new(&rig.c);
    rig.filter.start(&rig.c, &AlphaBeta::new(rig.i.x, rig.i.y));
    rig.filter.settle(&rig.c, 1.0);
    while rig.filter.sigma() < SIGMA_LOST {
        rig.step(0.03, 0.5);
    }
    rig.c = correct;
    while rig.filter.period != 0 {
        rig.step(0.03, 0.5);
    }
    for period in 0..rig.c.block {
        let c = rig.c;
        let mut again = ClosedLoop { filter: rig.filter, c, ..rig };
        for _ in 0..period {
            again.step(0.03, 0.5);
        }
        again.filter.forget(&c);
        for k in 0..3 * rig.c.block {
            let least = dense(&again.filter).symmetric_eigenvalues().min();
            assert!(least > 0.0, "anew after period {period}, {k} periods on: smallest eigenvalue {least}");
            again.step(0.03, 0.5);
        }
    }
}

#[test]
fn nothing_computed_before_a_new_beginning_acts_after_it() {
    let [(machine, inverter), ..] = machines();
    let mut rig = ClosedLoop::new(&machine, &inverter);
    for _ in 0..3000 {
        rig.step(0.03, 0.5);
    }
    while rig.filter.period != 0 {
        rig.step(0.03, 0.5);
    }
    for slot in 0..10 {
        // Two filters that differ in their covariance alone, until it begins anew in both.
        let [one, other] = [1.0, 4.0].map(|factor| {
            let c = rig.c;
            let mut again = ClosedLoop { filter: rig.filter, c, ..rig };
            for i in 0..N {
                for j in 0..=i {
                    let x = again.filter.p.get(i, j);
                    again.filter.p.add_at(i, j, (factor - 1.0) * x);
                }
            }
            for _ in 0..slot {
                again.step(0.03, 0.5);
            }
            again.filter.forget(&c);
            for _ in 0..40 {
                again.step(0.03, 0.5);
            }
            (Reference::of(&c, &again.filter).x, dense(&again.filter))
        });
        assert_eq!(one, other, "anew after slot {slot}");
    }
}

#[test]
fn held_states_are_decorrelated_and_stay_and_the_winding_becomes_unknown() {
    let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
    let mut rig = ClosedLoop::new(&machine, &inverter);
    for _ in 0..10_000 {
        rig.step(0.03, 0.5);
    }
    assert!(rig.filter.p.get(PSI, RS).abs() + rig.filter.p.get(PSI + 1, RS).abs() > 1e-3, "correlated while seen");
    for _ in 0..40 {
        rig.step(0.3, 0.5);
    }
    let state = |f: &Filter<f64>| [f.r_s(), f.v(), f.leakage()];
    let variance = |f: &Filter<f64>| [V, KNEE, LEAKAGE].map(|k| f.p.get(k, k));
    let (held, variances, of_r_s) = (state(&rig.filter), variance(&rig.filter), rig.filter.p.get(RS, RS));
    // The winding warms where it cannot be seen.
    rig.r_s *= 1.3;
    for _ in 0..10_000 {
        rig.step(0.3, 0.5);
    }
    assert_eq!(state(&rig.filter), held);
    assert_eq!(variance(&rig.filter), variances);
    for k in [RS, V, KNEE, LEAKAGE] {
        assert!((0..N).all(|j| j == k || rig.filter.p.get(k, j) == 0.0));
    }
    // Its random walk of 3e-3 per √s over a second.
    let grown = ((rig.filter.p.get(RS, RS) - of_r_s).sqrt() * SCALE_R) / 3e-3;
    assert!((grown - 1.0).abs() < 0.02, "{grown}");
    rig.filter.p.add_at(RS, RS, noise::WARMED);
    let most = rig.filter.p.get(RS, RS);
    for _ in 0..100 {
        rig.step(0.3, 0.5);
    }
    assert_eq!(rig.filter.p.get(RS, RS), most, "not beyond that of a winding of unknown temperature");
}

#[test]
fn the_saturation_is_that_of_the_machines_own_curve() {
    for (machine, inverter) in machines() {
        let Some(s) = machine.saturation else { continue };
        let (c, _) = config(&machine, &inverter);
        let b = Base::new(&machine);
        let rated = machine.L_M / machine.L_s();
        for k in 0..=10 {
            // Γ form: i = ψ_s/L_s(ψ_s) at no load, where ψ_R = ψ_s - L_σ i.
            let psi = b.psi * (0.4 + 0.065 * f64::from(k));
            let i = psi * (1.0 + (s.a * psi).powf(s.S)) / s.L_u / b.i;
            let m = psi / b.psi - c.model.sigma_l_s * i;
            let by_model = c.model.curve(m, c.saturation).m_g / c.model.l_m;
            let rated_i = rated / c.model.l_m;
            assert!((by_model - i).abs() < 0.03 * rated_i, "S = {}: {by_model} for {i} at ψ = {m}", s.S);
        }
    }
}
