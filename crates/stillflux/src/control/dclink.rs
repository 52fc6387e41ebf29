//! Control of the dc link by the torque, and the brake chopper, per unit.
//!
//! The link's capacitor takes what the machine does not: `C u du/dt = P_supply - T ω - losses`. Where braking power has
//! nowhere to go, or the supply fails, the torque keeps the voltage. Torque in the direction of the speed is multiplied
//! by `d`, torque against it by `b`,
//!
//! ```text
//! b = min(1, (u_brake - u)/w) ≥ 0                 regeneration: none is left at u_brake
//! d = min(1, (u - u_buffer)/w) ≥ -1               supply fails: at u_buffer none, below it the machine generates
//! δ = (u - u_on)/(u_full - u_on), 0 to 1          duty of the brake chopper
//! ```
//!
//! with `w` = 5 % of the rated link. Both are proportional controls of the link's energy: the voltage settles where the
//! power that comes back covers the losses, between `u_brake - w` and `u_brake`, or below `u_buffer` for as long as there
//! is kinetic energy, whatever the capacitance. Their rate `P_max/(C u w)` must stay below that of the torque.
//!
//! **Validity.** Below a speed of 0.05 pu there is nothing left to generate: `d` ≥ 0 there.

use crate::scalar::{Real, likely};
use crate::words::words;

/// Width of the proportional range, in units of the rated link.
pub const WIDTH: f64 = 0.05;
/// Voltage of what is not set, per unit: beyond what is ever measured.
pub const NEVER: f64 = 100.0;
/// Speed, per unit, below which the machine cannot feed the link.
const OMEGA_MIN: f64 = 0.05;

/// Settings of the control of the link.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct DcLinkConfig<R: Real> {
    /// Voltage at which no braking torque is left.
    pub u_brake: R,
    /// Voltage below which the machine feeds the link.
    pub u_buffer: R,
    /// `1/w`.
    pub inv_width: R,
    /// Voltage from which on the chopper takes current.
    pub u_on: R,
    /// `1/(u_full - u_on)`.
    pub inv_span: R,
}
words!(DcLinkConfig: u_brake, u_buffer, inv_width, u_on, inv_span);

impl<R: Real> DcLinkConfig<R> {
    /// Limits of the torque, `lo < 0 < hi`, as far as the link allows it at a speed.
    #[inline(always)]
    pub fn limit(&self, u_dc: R, omega_m: R, (lo, hi): (R, R)) -> (R, R) {
        let [brake, drive] = self.parts(u_dc);
        if likely(brake >= R::ONE && drive >= R::ONE) { (lo, hi) } else { weigh((lo, hi), omega_m, brake, drive) }
    }

    /// Whether it limits the torque.
    #[inline]
    pub fn is_limiting(&self, u_dc: R) -> bool {
        self.parts(u_dc).into_iter().any(|part| part < R::ONE)
    }

    /// Parts of the braking and of the driving torque that are left, beyond one where nothing is limited.
    #[inline(always)]
    fn parts(&self, u_dc: R) -> [R; 2] {
        [self.u_brake - u_dc, u_dc - self.u_buffer].map(|room| room * self.inv_width)
    }

    /// The torque current by which field weakening may choose its flux: none that brakes, where the link may end it within
    /// milliseconds. A braking current takes `r' i_q` less voltage; the flux that this allows would leave none to control the
    /// torque current when the braking ends, and the machine would go on braking until the flux has decayed.
    #[inline(always)]
    pub fn lasting(&self, i_q: R, omega: R) -> R {
        let brakes = (i_q < R::ZERO) != (omega < R::ZERO);
        if self.u_brake < R::from_f64(NEVER) && brakes { R::ZERO } else { i_q }
    }

    /// Duty of the brake chopper.
    #[inline]
    pub fn chopper(&self, u_dc: R) -> R {
        ((u_dc - self.u_on) * self.inv_span).clamp(R::ZERO, R::ONE)
    }
}

#[cold]
#[inline(never)]
fn weigh<R: Real>((lo, hi): (R, R), omega_m: R, brake: R, drive: R) -> (R, R) {
    let brake = brake.clamp(R::ZERO, R::ONE);
    let least = if omega_m.within(R::from_f64(OMEGA_MIN)) { R::ZERO } else { -R::ONE };
    let drive = drive.clamp(least, R::ONE);
    // A negative factor asks for torque against the speed, of which there is as much as the limit there.
    let with = |most: R, against: R| if drive < R::ZERO { -against * drive } else { most * drive };
    if omega_m < R::ZERO {
        let lo = with(lo, hi);
        (lo, (hi * brake).max(lo))
    } else {
        let hi = with(hi, lo);
        ((lo * brake).min(hi), hi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const C: DcLinkConfig<f64> =
        DcLinkConfig { u_brake: 2.1, u_buffer: 1.2, inv_width: 10.0, u_on: 2.2, inv_span: 10.0 };

    #[test]
    fn the_chopper_is_fully_on_at_its_upper_voltage_or_the_pair_is_refused() {
        use crate::config::{DriveConfig, DriveParams};
        use crate::params::{Inverter, Machine};
        use crate::scalar::Q;
        let (machine, inverter) = (Machine::preset_2k2(), Inverter { u_dc: 200.0, ..Inverter::preset_2k2() });
        let (on, full) = (210.0, 211.1);
        let params =
            DriveParams { u_dc_chopper: Some((on, full)), u_dc_max: 300.0, ..DriveParams::new(&machine, &inverter) };
        let base = crate::base::Base::new(&machine).u;
        let config = DriveConfig::<f32>::new(&machine, &inverter, &params).unwrap();
        assert!((config.dclink.chopper((full / base) as f32) - 1.0).abs() < 1e-3);
        let e = DriveConfig::<Q>::new(&machine, &inverter, &params).unwrap_err();
        assert!(e.field == "u_dc_chopper[1]" && e.min > full && e.min < full + 2.0, "{e}");
    }

    #[test]
    fn where_the_link_may_end_it_a_braking_current_does_not_count_for_the_flux() {
        for (i_q, omega, lasts) in [(0.8, 1.5, 0.8), (-0.8, 1.5, 0.0), (0.8, -1.5, 0.0), (-0.8, -1.5, -0.8)] {
            assert_eq!(C.lasting(i_q, omega), lasts);
            assert_eq!(DcLinkConfig { u_brake: NEVER, ..C }.lasting(i_q, omega), i_q);
        }
    }

    #[test]
    fn within_its_range_the_link_limits_nothing() {
        for (u, omega) in [(1.3, 1.0), (1.65, -1.0), (2.0, 0.0)] {
            assert_eq!(C.limit(u, omega, (-1.0, 1.5)), (-1.0, 1.5));
        }
    }

    #[test]
    fn braking_torque_falls_to_nothing_and_driving_torque_stays() {
        for (u, part) in [(2.05, 0.5), (2.1, 0.0), (2.5, 0.0)] {
            let near = |(a, b): (f64, f64), (c, d): (f64, f64)| (a - c).abs() < 1e-9 && (b - d).abs() < 1e-9;
            assert!(near(C.limit(u, 0.5, (-1.0, 1.5)), (-part, 1.5)));
            assert!(near(C.limit(u, -0.5, (-1.0, 1.5)), (-1.0, 1.5 * part)));
        }
    }

    #[test]
    fn with_the_supply_gone_the_machine_generates_while_it_turns() {
        let (lo, hi) = C.limit(1.15, 0.5, (-1.0, 1.5));
        assert!((hi + 0.5).abs() < 1e-9 && lo == -1.0, "half of the torque against the speed at least: {lo} {hi}");
        let (lo, hi) = C.limit(1.15, -0.5, (-1.0, 1.5));
        assert!((lo - 0.75).abs() < 1e-9 && hi == 1.5, "{lo} {hi}");
        let (lo, hi) = C.limit(1.0, 0.5, (-1.0, 1.5));
        assert!(lo == -1.0 && hi == -1.0, "{lo} {hi}");
        assert_eq!(C.limit(1.0, 0.04, (-1.0, 1.5)), (-1.0, 0.0), "at rest there is nothing to take");
    }

    #[test]
    fn the_chopper_takes_current_in_proportion_from_its_voltage_on() {
        for (u, duty) in [(1.65, 0.0), (2.2, 0.0), (2.25, 0.5), (2.3, 1.0), (9.0, 1.0)] {
            assert!((C.chopper(u) - duty).abs() < 1e-9);
        }
    }
}
