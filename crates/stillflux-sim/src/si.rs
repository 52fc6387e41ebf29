//! The SI boundary: a drive of any arithmetic behind one type, volts and amperes outside, per unit inside.

use stillflux::base::Base;
use stillflux::config::{DriveConfig, DriveParams};
use stillflux::drive::{Drive, Measurement, Memory, Reference, Status};
use stillflux::params::{Inverter, Machine, ParamError};
use stillflux::scalar::{Q, Real};
use stillflux::space::{AlphaBeta, Space};

use crate::adc::Sample;

/// Arithmetic a drive computes in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arithmetic {
    /// Single precision.
    #[default]
    F32,
    /// Double precision.
    F64,
    /// Fixed point Q7.24.
    Q,
}

/// A space vector, real and imaginary part.
pub type Vector = [f64; 2];

/// What the drive is to do, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Gates off.
    Stop,
    /// Mechanical speed, rad/s.
    Speed(f64),
    /// Torque, N·m.
    Torque(f64),
}

/// Everything a drive estimates, SI; stator coordinates unless named `dq`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[allow(non_snake_case)]
pub struct EstimateSi {
    /// Stator flux linkage, V·s.
    pub psi_s: Vector,
    /// Rotor flux linkage (inverse-Γ), V·s.
    pub psi_r: Vector,
    /// Flux of the parallel path, V·s.
    pub psi_1: Vector,
    /// Stator current, A.
    pub i_s: Vector,
    /// Voltage applied between the last two samples, V.
    pub u_s: Vector,
    /// Induced voltage, V.
    pub u_i: Vector,
    /// Offset voltage, V.
    pub u_off: Vector,
    /// Output of the noise compensator, V.
    pub u_hf: Vector,
    /// Current in field coordinates, A.
    pub i_dq: Vector,
    /// Its reference, A.
    pub i_dq_ref: Vector,
    /// Flux reference, V·s.
    pub psi_ref: f64,
    /// Mechanical speed, rad/s.
    pub omega_m: f64,
    /// Stator frequency, electrical rad/s.
    pub omega_s: f64,
    /// Slip frequency, electrical rad/s.
    pub omega_r: f64,
    /// Torque, N·m.
    pub torque: f64,
    /// Stator resistance with `r_d`, Ω.
    pub R_s: f64,
    /// Residual of (15), per unit.
    pub epsilon: f64,
    /// Confidence, 0 to 1.
    pub confidence: f64,
}

/// What a drive stores at a stop, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(non_snake_case)]
pub struct MemorySi {
    /// Offset voltage, V.
    pub u_off: Vector,
    /// Stator resistance with `r_d`, Ω.
    pub R_s: f64,
    /// Offsets of the current channels, A.
    pub i_off: [f64; 3],
    /// Error of the inverter model's voltage, relative; 0 in the published scheme.
    pub loss_error: f64,
    /// Main inductance, H; the parameter in the published scheme.
    pub L_M: f64,
}

#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)]
enum Inner {
    F32(Drive<f32>),
    F64(Drive<f64>),
    Q(Drive<Q>),
}

/// Runs `$body` with `$d` bound to the drive, whatever its arithmetic.
macro_rules! with {
    ($inner:expr, $d:ident => $body:expr) => {
        match $inner {
            Inner::F32($d) => $body,
            Inner::F64($d) => $body,
            Inner::Q($d) => $body,
        }
    };
}

/// A drive with SI inputs and outputs.
#[derive(Clone, Debug)]
pub struct SiDrive {
    base: Base,
    /// The parameter `L_M`, H.
    l_m: f64,
    inner: Inner,
}

impl SiDrive {
    /// A stopped drive.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        params: &DriveParams,
        arithmetic: Arithmetic,
    ) -> Result<Self, ParamError> {
        let inner = match arithmetic {
            Arithmetic::F32 => Inner::F32(Drive::new(DriveConfig::new(machine, inverter, params)?)),
            Arithmetic::F64 => Inner::F64(Drive::new(DriveConfig::new(machine, inverter, params)?)),
            Arithmetic::Q => Inner::Q(Drive::new(DriveConfig::new(machine, inverter, params)?)),
        };
        Ok(Self { base: Base::new(machine), l_m: machine.L_M, inner })
    }

    /// Base quantities.
    #[must_use]
    pub fn base(&self) -> &Base {
        &self.base
    }

    /// One control period: sample in, duties and gate signal out.
    pub fn step(&mut self, sample: &Sample, command: &Command) -> ([f64; 3], bool) {
        let b = &self.base;
        with!(&mut self.inner, d => step(d, b, sample, command))
    }

    /// State of the sequence.
    #[must_use]
    pub fn status(&self) -> Status {
        with!(&self.inner, d => d.status())
    }

    /// Control periods since power-up.
    #[must_use]
    pub fn period(&self) -> u32 {
        with!(&self.inner, d => d.period())
    }

    /// Leaves a fault.
    pub fn reset(&mut self) {
        with!(&mut self.inner, d => d.reset());
    }

    /// Estimates of the latest period.
    #[must_use]
    pub fn estimate(&self) -> EstimateSi {
        with!(&self.inner, d => estimate(d, &self.base))
    }

    /// Induced voltage of the latest period, V, and whether the drive is running: for the record's books.
    pub(crate) fn induced_voltage(&self) -> Option<Vector> {
        with!(&self.inner, d => (d.status() == Status::Running).then(|| si(&d.estimate().flux.u_i, self.base.u)))
    }

    /// Data worth keeping.
    #[must_use]
    pub fn memory(&self) -> MemorySi {
        let b = &self.base;
        with!(&self.inner, d => {
            let m = d.memory();
            MemorySi {
                u_off: si(&m.u_off, b.u),
                R_s: m.r_s.to_f64() * b.z,
                i_off: m.i_off.map(|i| i.to_f64() * b.i),
                loss_error: m.loss_error.to_f64(),
                L_M: self.l_m / m.inv_l_m.to_f64(),
            }
        })
    }

    /// Takes back what an earlier run stored.
    pub fn restore(&mut self, m: &MemorySi) {
        let b = &self.base;
        let l_m = self.l_m;
        with!(&mut self.inner, d => d.restore(&memory(m, b, l_m)));
    }
}

fn step<R: Real>(d: &mut Drive<R>, b: &Base, sample: &Sample, command: &Command) -> ([f64; 3], bool) {
    // NaN has no fixed-point counterpart: full scale makes it the measurement fault that it is.
    let r = |x: f64| if x.is_nan() { R::from_f64(f64::MAX) } else { R::from_f64(x) };
    let measured = Measurement { i_abc: sample.i_abc.map(|i| r(i / b.i)), u_dc: r(sample.u_dc / b.u) };
    let reference = match *command {
        Command::Stop => Reference::Stop,
        Command::Speed(w) => Reference::Speed(R::from_f64(w / b.omega_m)),
        Command::Torque(t) => Reference::Torque(R::from_f64(t / b.torque)),
    };
    let out = d.step(&measured, &reference);
    (out.duty.map(Real::to_f64), out.gates_on)
}

fn si<R: Real, F>(v: &Space<R, F>, base: f64) -> Vector {
    [v.re().to_f64() * base, v.im().to_f64() * base]
}

fn memory<R: Real>(m: &MemorySi, b: &Base, l_m: f64) -> Memory<R> {
    Memory {
        u_off: AlphaBeta::new(R::from_f64(m.u_off[0] / b.u), R::from_f64(m.u_off[1] / b.u)),
        r_s: R::from_f64(m.R_s / b.z),
        i_off: m.i_off.map(|i| R::from_f64(i / b.i)),
        loss_error: R::from_f64(m.loss_error),
        inv_l_m: R::from_f64(l_m / m.L_M),
    }
}

fn estimate<R: Real>(d: &Drive<R>, b: &Base) -> EstimateSi {
    let e = d.estimate();
    EstimateSi {
        psi_s: si(&e.flux.psi_s, b.psi),
        psi_r: si(&e.speed.psi_r, b.psi),
        psi_1: si(&e.psi_1, b.psi),
        i_s: si(&e.i_s, b.i),
        u_s: si(&e.u_s, b.u),
        u_i: si(&e.flux.u_i, b.u),
        u_off: si(&e.u_off, b.u),
        u_hf: si(&e.flux.u_hf, b.u),
        i_dq: si(&e.i_dq, b.i),
        i_dq_ref: si(&e.i_dq_ref, b.i),
        psi_ref: e.psi_ref.to_f64() * b.psi,
        omega_m: e.speed.omega_m.to_f64() * b.omega_m,
        omega_s: e.speed.omega_s.to_f64() * b.omega,
        omega_r: e.speed.omega_r.to_f64() * b.omega,
        torque: e.torque.to_f64() * b.torque,
        R_s: e.r_s.to_f64() * b.z,
        epsilon: e.epsilon.to_f64(),
        confidence: e.confidence.to_f64(),
    }
}
