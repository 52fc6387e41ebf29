//! Speed, flux and current control of Fig. 3 on the quantities that a scheme estimates, per unit.
//!
//! ```text
//! ψ* = min(ψ_N κ, 0.88 u_max/|ω_s|),    i_q* = T*/ψ,    i_d* by (12) at ψ and i_q*, with the flux controller's correction
//! |T*| ≤ ψ min(0.8 i_q,pull-out(ψ_p), √(i_max² - i_0²))
//! ```
//!
//! `ψ` is the flux of [`Estimators::present_flux`], `ψ_p` that of [`Estimators::pull_out_flux`], `κ` that of the flux shift, `u_max = 0.98 u_dc/√3`. The limit keeps
//! 20 % of distance to pull-out.

use super::estimators::{Estimators, FieldQuantities};
use super::interface::Reference;
use super::voltage::Voltage;
use crate::config::{DriveConfig, LowConfidence};
use crate::control::current::CurrentController;
use crate::control::flux::FluxController;
use crate::control::modulator::Duty;
use crate::control::speed::SpeedController;
use crate::inverter::Knee;
use crate::scalar::Real;
use crate::space::Dq;

/// Part of the dc link that the voltage vector may use: inscribed circle of the hexagon, less a margin.
const U_UTILISATION: f64 = 0.98 / 1.732_050_807_568_877_2;
/// Part of the largest voltage that `ω_s ψ*` may take; the rest is for leakage and resistance under load.
const U_FLUX: f64 = 0.88;

/// Largest magnitude of the voltage vector.
#[inline(always)]
fn largest_voltage<R: Real>(u_dc: R) -> R {
    u_dc * R::from_f64(U_UTILISATION)
}

/// Controllers, their references, the current that they control, and the voltage that they command.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Control<R: Real> {
    current: CurrentController<R>,
    flux: FluxController<R>,
    speed: SpeedController<R>,
    pub i_dq: Dq<R>,
    pub i_dq_ref: Dq<R>,
    pub psi_ref: R,
    pub voltage: Voltage<R>,
}

impl<R: Real> Control<R> {
    /// Controllers at rest.
    pub fn new() -> Self {
        Self {
            current: CurrentController::default(),
            flux: FluxController::default(),
            speed: SpeedController::default(),
            i_dq: Dq::default(),
            i_dq_ref: Dq::default(),
            psi_ref: R::ZERO,
            voltage: Voltage::new(),
        }
    }

    /// A start-up begins: the current controller starts.
    pub fn begin(&mut self) {
        self.current.start();
    }

    /// The start-up is complete: flux and speed controllers start.
    pub fn start(&mut self, c: &DriveConfig<R>) {
        self.psi_ref = c.flux_control.psi_rated;
        self.flux.start();
        self.speed.start(R::ZERO);
    }

    /// Current control: duties for the next period. `inverter`: estimated factor and curve of the inverter model.
    #[inline(always)]
    pub fn duties(
        &mut self,
        c: &DriveConfig<R>,
        x: &FieldQuantities<R>,
        period: u32,
        u_dc: R,
        inverter: (R, &Knee<R>),
    ) -> Duty<R> {
        self.i_dq = x.i_dq;
        let i_ref = self.i_dq_ref;
        // The duties act from one to two periods after the sample: references are turned to the middle of that.
        let ahead = x.field.ahead(x.omega_s * c.t_ahead);
        let i_ahead = ahead.to_stator(&i_ref);
        let u_ff = Dq::new(i_ref.re() * x.r_s, i_ref.im() * x.r_s + x.omega_s * x.psi_s);
        let u = self.current.step(&c.current, &i_ref, &self.i_dq, &u_ff, largest_voltage(u_dc));
        self.voltage.command(c, period, &ahead.to_stator(&u), &i_ahead, u_dc, inverter)
    }

    /// References: flux, torque, i_q* within current limit and pull-out, i_d* of (12).
    #[inline(never)]
    pub fn set_references<E: Estimators<R>>(
        &mut self,
        c: &DriveConfig<R>,
        estimators: &mut E,
        reference: &Reference<R>,
        u_dc: R,
    ) {
        let (omega_s, omega_m) = (estimators.speed().omega_s, estimators.speed().omega_m);
        let factor = estimators.flux_factor(c, self.i_dq_ref.im() * self.psi_ref);
        let psi_ref = c.flux_control.reference(omega_s, largest_voltage(u_dc) * R::from_f64(U_FLUX));
        let psi_ref = psi_ref.min(c.flux_control.psi_rated * factor);
        self.psi_ref = psi_ref;
        // Torque, pull-out and feedforward by the estimated flux, with the weight that the scheme gives it.
        let (psi, weight) = estimators.present_flux(psi_ref);
        let i_q_max = (c.pull_out_use * estimators.pull_out_flux(psi)).min(c.i_q_max);
        let mut torque_max = i_q_max * psi;
        if c.low_confidence == LowConfidence::LimitTorque {
            let part = (estimators.confidence() * R::TWO).min(R::ONE);
            torque_max = torque_max.min(c.speed_control.torque_max) * part;
        }
        let torque_ref = match *reference {
            Reference::Speed(omega) => self.speed.step(&c.speed_control, omega.limit(c.omega_max), omega_m, torque_max),
            Reference::Torque(torque) => {
                let torque = torque.limit(torque_max.min(c.speed_control.torque_max));
                self.speed.start(torque);
                torque
            }
            Reference::Stop => R::ZERO,
        };
        let i_q = torque_ref * c.flux_control.reciprocal(psi);
        let i_d = self.flux.step(&c.flux_control, psi, psi_ref - estimators.psi_s(), i_q, weight);
        self.i_dq_ref = Dq::new(i_d, i_q);
    }
}
