//! Duties for a voltage reference, and the voltage that they apply, per unit.
//!
//! ```text
//! duties = modulate(u* + u_l(i*)),    u_s(k) = u_dc d(k - 2) - u_l(k - 2)
//! ```
//!
//! Currents sampled at the start of period *k* give the duties applied during period *k + 1*. At the call of period
//! *k* the voltage between the last two samples is therefore the one computed two calls earlier; a pipeline of two
//! entries keeps the estimators on the voltage that was applied: limited, quantised, at the measured dc link, less
//! the loss `u_l` of the inverter model. A dc link that changes within two periods is not resolved.

use super::ripple::Ripple;
use crate::config::DriveConfig;
use crate::control::modulator::{Duty, modulate_lines};
#[cfg(feature = "modes")]
use crate::control::modulator::{clamped_leg, modulate_clamped};
#[cfg(feature = "shunt")]
use crate::control::shunt::{Pulses, Shunt, ShuntConfig};
#[cfg(any(feature = "enhanced", feature = "modes"))]
use crate::inverter::Distortion;
use crate::inverter::Knee;
use crate::scalar::{Real, likely};
use crate::space::AlphaBeta;

/// Part of the squared voltage from which discontinuous modulation begins, at which it ends.
#[cfg(feature = "modes")]
const HYSTERESIS: f64 = 0.9;
/// A period's voltage: legs a and b less leg c, which is half of the way to the vector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
struct Commanded<R: Real> {
    /// Applied by ideal legs, per unit of dc link.
    ideal: [R; 2],
    /// Loss of the inverter model, which is not applied.
    loss: [R; 2],
}

/// Modulation with its delay.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Voltage<R: Real> {
    /// The last two periods, by the lowest bit of their number.
    commanded: [Commanded<R>; 2],
    /// Loss of the inverter model in the latest of them, for those who ask for more of it than what is in `commanded`.
    #[cfg(any(feature = "enhanced", feature = "modes"))]
    pub loss: Distortion<R>,
    /// What the ripple of the currents adds to it near current zero.
    ripple: Ripple<R>,
    /// `1/u_dc` of the latest period; 0 while the bridge is blocked.
    inv_u_dc: R,
    /// A leg was held at a rail in the latest period.
    #[cfg(feature = "modes")]
    discontinuous: bool,
    /// With an update at each extreme of the carrier: an odd number of calls was missed, so the number of a period no longer
    /// tells its half as at first.
    #[cfg(feature = "modes")]
    halves_swapped: bool,
    /// Pulses for a single shunt, and what it shows in them.
    #[cfg(feature = "shunt")]
    pub shunt: Shunt<R>,
    /// Voltage applied between the last two current samples.
    pub u_s: AlphaBeta<R>,
}

impl<R: Real> Voltage<R> {
    /// No voltage applied yet.
    pub fn new() -> Self {
        Self {
            commanded: [Commanded::default(); 2],
            #[cfg(any(feature = "enhanced", feature = "modes"))]
            loss: Distortion::default(),
            ripple: Ripple::new(),
            inv_u_dc: R::ZERO,
            #[cfg(feature = "modes")]
            discontinuous: false,
            #[cfg(feature = "modes")]
            halves_swapped: false,
            #[cfg(feature = "shunt")]
            shunt: Shunt::default(),
            u_s: AlphaBeta::default(),
        }
    }

    /// The bridge is blocked.
    pub fn block(&mut self) {
        self.commanded = [Commanded::default(); 2];
        self.inv_u_dc = R::ZERO;
        #[cfg(any(feature = "enhanced", feature = "modes"))]
        {
            self.loss = Distortion::default();
        }
        self.ripple.block();
        #[cfg(feature = "shunt")]
        self.shunt.block();
    }

    /// Pulses of the next period with a single shunt; `None` while the bridge is blocked.
    #[cfg(feature = "shunt")]
    pub fn pulses(&self) -> Option<Pulses<R>> {
        self.shunt.pulses()
    }

    /// Pulses for the single shunt, which may take from the largest duties, and what it will show in them.
    #[cfg(feature = "shunt")]
    #[cold]
    #[inline(never)]
    fn shape(&mut self, c: &ShuntConfig<R>, period: u32, duty: &mut Duty<R>, u_dc: R) {
        self.shunt.shape(c, period, duty, &self.loss, u_dc);
    }

    /// dc-link voltage of the latest period under voltage, if there was one.
    pub fn u_dc(&self) -> Option<R> {
        // No guess: it seldom runs.
        (self.inv_u_dc > R::ZERO).then(|| self.inv_u_dc.recip_near(R::ZERO))
    }

    /// Voltage applied between the last two samples.
    #[inline(always)]
    pub fn applied(&self, period: u32, u_dc: R) -> AlphaBeta<R> {
        // Commanded two calls ago; this call's command overwrites it.
        let last = &self.commanded[(period & 1) as usize];
        AlphaBeta::from_lines([0, 1].map(|k| last.ideal[k] * u_dc - last.loss[k]))
    }

    /// Leg that discontinuous modulation holds at a rail, if the voltage is large enough for it; it has no dead time then.
    #[cfg(feature = "modes")]
    #[cold]
    #[inline(never)]
    fn clamp(&mut self, c: &DriveConfig<R>, u_ref: &AlphaBeta<R>) -> Option<(usize, bool)> {
        let least = c.discontinuous_sq()?;
        let part = *u_ref * self.inv_u_dc;
        let least = if self.discontinuous { least * R::from_f64(HYSTERESIS) } else { least };
        self.discontinuous = part.norm_sq() >= least;
        self.discontinuous.then(|| {
            let leg = clamped_leg(&u_ref.to_phases());
            self.loss = self.loss.without_edges(leg.0);
            leg
        })
    }

    /// Duties, and loss of legs a and b less leg c, with an update at each extreme of the carrier or with discontinuous
    /// modulation.
    #[cfg(feature = "modes")]
    #[cold]
    #[inline(never)]
    fn command_in_mode(&mut self, c: &DriveConfig<R>, period: u32, u_ref: &AlphaBeta<R>) -> (Duty<R>, [R; 2]) {
        let clamped = self.clamp(c, u_ref);
        let e = if likely(!c.double_update()) {
            self.loss.phases
        } else {
            self.loss.of_half(self.is_rising(period), clamped.map(|(leg, _)| leg))
        };
        let loss = lines(&e);
        let duty = match clamped {
            None => self.modulate(c, u_ref, loss),
            Some(leg) => {
                let u = u_ref.to_phases();
                modulate_clamped([0, 1, 2].map(|k| u[k] + e[k]), leg, self.inv_u_dc, c.timer.as_ref())
            }
        };
        (duty, loss)
    }

    /// With an update at each extreme of the carrier: whether the duties of this call act in the half with the rising edges. The
    /// first call is in the lower zero vector, its duties act in the falling half.
    #[cfg(feature = "modes")]
    pub fn is_rising(&self, period: u32) -> bool {
        (period & 1 == 0) != self.halves_swapped
    }

    /// An odd number of calls was missed.
    #[cfg(all(feature = "modes", feature = "supervision"))]
    pub fn swap_halves(&mut self) {
        self.halves_swapped = !self.halves_swapped;
    }

    /// Duties of continuous modulation.
    #[inline(always)]
    fn modulate(&self, c: &DriveConfig<R>, u_ref: &AlphaBeta<R>, loss: [R; 2]) -> Duty<R> {
        let u = u_ref.to_lines();
        modulate_lines([u[0] + loss[0], u[1] + loss[1]], self.inv_u_dc, c.timer.as_ref())
    }

    /// Duties for a voltage reference. The inverter model takes the current reference in place of the current that
    /// will flow then: it is free from noise. From 8 kHz on its loss is computed in every second period, an even one, and
    /// holds for two: in one period a field of rated frequency turns by 2° at 10 kHz, and what is compensated is what the
    /// estimators take as lost. `gain` and `knee`: estimated factor and curve of the model; `ripple`: whether it is this
    /// period's turn to compute the ripple of a leg.
    #[inline(always)]
    pub fn command(
        &mut self,
        c: &DriveConfig<R>,
        (period, ripple): (u32, bool),
        u_ref: &AlphaBeta<R>,
        i_ref: impl FnOnce() -> AlphaBeta<R>,
        u_dc: R,
        (gain, knee): (R, &Knee<R>),
    ) -> Duty<R> {
        // Here and not with the voltage applied: until now it would take a register, or be loaded again.
        self.inv_u_dc = u_dc.recip_near(self.inv_u_dc);
        // A leg that is held at a rail changes the loss that is kept.
        let loss = if period & (c.slow_mask >> 2) == 0 || !likely(c.discontinuous_sq().is_none()) {
            let i_ref = i_ref();
            let mut loss = c.inverter.distortion(knee, &i_ref, u_dc, gain);
            if ripple {
                self.ripple.follow(&c.inverter, u_ref, &i_ref, knee, &loss);
            }
            self.ripple.add_to(&mut loss.phases);
            #[cfg(any(feature = "enhanced", feature = "modes"))]
            {
                self.loss = loss;
            }
            lines(&loss.phases)
        } else {
            // That of the period before, an even one.
            self.commanded[0].loss
        };
        #[cfg(feature = "modes")]
        let (duty, loss) = if likely(c.discontinuous_sq().is_none() && !c.double_update()) {
            (self.modulate(c, u_ref, loss), loss)
        } else {
            self.command_in_mode(c, period, u_ref)
        };
        #[cfg(not(feature = "modes"))]
        let duty = self.modulate(c, u_ref, loss);
        #[cfg(feature = "shunt")]
        let mut duty = duty;
        #[cfg(feature = "shunt")]
        if !likely(c.shunt.is_none())
            && let Some(shunt) = &c.shunt
        {
            self.shape(shunt, period, &mut duty, u_dc);
        }
        let next = &mut self.commanded[(period & 1) as usize];
        (next.ideal, next.loss) = (lines(&duty), loss);
        duty
    }
}

/// Values of legs a and b less that of leg c.
#[inline(always)]
fn lines<R: Real>([a, b, c]: &[R; 3]) -> [R; 2] {
    [*a - *c, *b - *c]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DriveParams;
    use crate::params::{Inverter, Machine};

    /// Currents that begin from zero at once: nothing of the ripple that was computed at zero current, one leg after the
    /// other, is a voltage of the machine, in no period after the step.
    #[test]
    fn a_step_of_the_current_leaves_no_ripple_of_before_behind() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let params = DriveParams::new(&machine, &inverter);
        let c = DriveConfig::<f64>::new(&machine, &inverter, &params).unwrap();
        let (knee, u_dc) = (c.inverter.knee(1.0), 1.65);
        for step in 24..36 {
            let mut voltage = Voltage::new();
            for period in 0..60 {
                let at = |period: u32| AlphaBeta::new(if period < step { 0.0 } else { 0.5 }, 0.0);
                let i_ref = at(period);
                voltage.command(&c, (period, period % 4 == 2), &AlphaBeta::default(), || i_ref, u_dc, (1.0, &knee));
                // The loss of an even period holds for two.
                let first = c.inverter.distortion(&knee, &at(period & !1), u_dc, 1.0);
                let loss = AlphaBeta::from_lines(voltage.commanded[(period & 1) as usize].loss);
                let added = (loss - first.vector()).norm_sq().sqrt();
                assert!(added < 1e-12 || period < 12, "step in {step}, period {period}: {added}");
                // At zero current it is the same in all legs, so that their differences do not show it.
                #[cfg(all(feature = "ripple", any(feature = "enhanced", feature = "modes")))]
                {
                    let there = voltage.loss.phases != first.phases;
                    assert!(there || period < 12 || period >= step, "none at zero current");
                }
            }
        }
    }

    #[test]
    fn a_bridge_that_is_blocked_leaves_no_voltage_of_its_link() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let c = DriveConfig::<f64>::new(&machine, &inverter, &DriveParams::new(&machine, &inverter)).unwrap();
        let mut v = Voltage::new();
        let knee = c.inverter.knee(1.0);
        v.command(&c, (0, false), &AlphaBeta::default(), AlphaBeta::default, 1.65, (1.0, &knee));
        assert!(v.u_dc().is_some_and(|u| (u - 1.65).abs() < 1e-9));
        v.block();
        assert_eq!(v.u_dc(), None);
    }
}
