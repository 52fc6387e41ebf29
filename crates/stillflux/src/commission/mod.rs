//! Self-commissioning: from the nameplate to the parameters of a drive, through the drive's own bridge, at standstill.
//!
//! [`nameplate`] gives a first machine with the deviation of each value. [`Commissioning::step`] then runs one
//! procedure after the other, each in a file of its own:
//!
//! ```text
//! wiring → legs → bridge → leakage → magnetising     every current along one axis at a time: no torque, the shaft stays
//! inertia                                             with a free shaft, by the drive that was found ([`si`] joins both)
//! ```
//!
//! **Timing** is that of [`crate::drive::Drive::step`]: currents sampled at the start of period *k* give the duties of
//! period *k + 1*. A period only excites and sums; every fit is done by [`Commissioning::result`], in double precision
//! and outside the control interrupt, from the means that were kept. So nothing that was found is lost when a later
//! procedure fails or the run is stopped: the result holds what the completed ones say, and the nameplate's
//! value with its deviation elsewhere.
//!
//! **Limits.** The current stays below [`TRIP`], 1.45 times the rated one; beyond it, and on any implausible measurement,
//! the gates are blocked and the cause latched. The wiring is checked with a tenth of the rated current before any larger
//! one flows.

mod bridge;
mod excitation;
pub mod inertia;
mod leakage;
#[cfg(feature = "legs")]
mod legs;
mod magnetising;
pub mod nameplate;
mod result;
pub mod si;
mod status;
mod wiring;

pub use bridge::{BridgeCurve, LEVELS as BRIDGE_LEVELS};
pub use leakage::RAMP;
pub use magnetising::{LEVELS as MAGNETISING_LEVELS, MagnetisingCurve, WINDOWS, levels as magnetising_levels};
pub use nameplate::{Deviation, Nameplate};
pub use result::{Found, Warnings, priors};
pub use status::{Cause, Stage, Status};

use crate::base::{PerUnit, rounded};
use crate::control::modulator::zero_duty;
use crate::drive::{Measurement, Output};
use crate::error::check;
use crate::inverter::InverterModel;
use crate::params::{Inverter, Machine, ParamError};
use crate::scalar::{Real, Timer};
use bridge::{Bridge, BridgeConfig};
use excitation::{Command, Excitation, ExcitationConfig, Sample};
use leakage::Leakage;
#[cfg(feature = "legs")]
use legs::{Comparison, ComparisonConfig};
use magnetising::{Magnetising, MagnetisingConfig};
use wiring::{Wiring, WiringConfig};

/// Current beyond which the gates are blocked, per unit.
pub const TRIP: f64 = 1.45;
/// dc-link voltage relative to the rated one.
const U_DC: (f64, f64) = (0.6, 1.45);
/// Bandwidth of current control relative to the switching frequency, for the nameplate's leakage inductance.
const BANDWIDTH: f64 = 0.03;
/// Part of its gains while a square voltage shows the leakage inductance: it is not to answer to that, and the current is not
/// at its reference then.
const ASIDE: f64 = 0.4;
/// Periods in which the current goes from one value to the next.
const RISE: u32 = 50;
/// Periods from a command to the sample that shows it.
#[cfg(feature = "legs")]
const DELAY: u32 = 2;
/// Time for which a current settles, in rotor time constants of the nameplate.
const SETTLE: f64 = 0.2;
/// Periods for which the voltage may be at its limit.
const LIMITED: u32 = 400;
/// Periods for which the current may be off its reference: a channel that is at the end of its range, which its reading does not
/// show, would let the voltage drive it to many times that.
const OFF: u32 = 8;
/// Duration of a level of the magnetising curve in rotor time constants of the nameplate, and its limit, s.
const LEVEL: f64 = 5.0;
const LEVEL_MAX: f64 = 6.5;

/// Constants of a commissioning: what the nameplate and the inverter's data sheet say.
#[derive(Clone, Copy, Debug)]
pub struct CommissioningConfig<R: Real> {
    machine: Machine,
    deviation: Deviation,
    sheet: Inverter,
    pu: PerUnit,
    excitation: ExcitationConfig<R>,
    wiring: WiringConfig<R>,
    magnetising: MagnetisingConfig<R>,
    /// Periods for which a current settles.
    settle: u32,
    bridge: BridgeConfig<R>,
    #[cfg(feature = "legs")]
    legs: ComparisonConfig<R>,
    leakage_weight: R,
    /// Amplitude of the square voltage for the nameplate's leakage inductance, and its limit.
    u_square: R,
    u_square_max: R,
    u_dc: (R, R),
    trip: R,
    /// Phase c has a sensor.
    third: bool,
    /// Whether each stage after the wiring is run.
    runs: [bool; 4],
}

impl<R: Real> CommissioningConfig<R> {
    /// From a nameplate and what is known of the inverter.
    ///
    /// # Errors
    /// The first value of either outside its admissible range.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn new(plate: &Nameplate, sheet: &Inverter) -> Result<Self, ParamError> {
        let (machine, deviation) = plate.machine()?;
        let pu = PerUnit::new(&machine, sheet)?;
        let r = rounded::<R>;
        let f_s = sheet.f_c();
        let u_max = 0.95 * pu.u_dc / libm::sqrt(3.0);
        let omega_c = pu.hz(BANDWIDTH * f_s);
        let k_p = omega_c * pu.sigma_l_s;
        // Pulses of a quarter of rated voltage give the response that the wiring's check wants.
        let volt_seconds = wiring::RESPONSE * pu.sigma_l_s;
        let pulse = ((volt_seconds / (0.25 * pu.t_s) + 0.5) as u32).clamp(1, 50);
        let tau_r = machine.L_M / machine.R_R;
        // Short against the rotor time constant, so that the flux stays small; long enough for the control, two time constants beyond
        // the rise. With twice as many periods the flux of a motor whose time constant is 200 of them came to its saturation, which the fit of
        // the bridge took for a dead time twice that of the bridge.
        let settle = (SETTLE * tau_r * f_s).clamp(60.0, (0.02 * f_s).max(200.0)) as u32;
        let window = ((LEVEL * tau_r).min(LEVEL_MAX) * f_s / WINDOWS as f64).max(1.0) as u32;
        let offset_periods = (0.1 * f_s) as u32;
        Ok(Self {
            excitation: ExcitationConfig {
                inverter: InverterModel::new(&pu),
                timer: sheet.timer()?,
                k_p: r(k_p),
                k_i: r(k_p * pu.t_s * omega_c / 3.0),
                r: r(pu.r_s + pu.r_r),
                l: r(pu.sigma_l_s / pu.t_s),
                u_max: r(u_max),
                inv_rise: r(1.0 / f64::from(RISE)),
            },
            wiring: WiringConfig {
                offset_periods,
                inv_offset_periods: r(1.0 / f64::from(offset_periods)),
                pulse,
                u: r(0.25 * volt_seconds / (f64::from(pulse) * pu.t_s)),
                u_max: r(u_max),
                loss: r(pu.u_th + 0.5 * pu.dead_time * pu.u_dc),
                per_volt: r(f64::from(pulse) * pu.t_s / pu.sigma_l_s),
            },
            magnetising: MagnetisingConfig {
                levels: magnetising_levels(1.0 / pu.l_s).map(r),
                settle,
                window,
                inv_settle: r(1.0 / f64::from(settle)),
                inv_window: r(1.0 / f64::from(window)),
            },
            settle,
            bridge: BridgeConfig::new(&machine, sheet, &pu, settle)?,
            #[cfg(feature = "legs")]
            legs: ComparisonConfig::new(&pu, (0.1 * tau_r * f_s).min(200.0) as u32, RISE / 2 + DELAY),
            leakage_weight: Leakage::weight(settle),
            u_square: r(leakage::SWING * pu.sigma_l_s / (f64::from(RAMP) * pu.t_s)),
            u_square_max: r(0.3 * u_max),
            u_dc: (r(U_DC.0 * pu.u_dc), r(U_DC.1 * pu.u_dc)),
            trip: r(TRIP),
            third: true,
            runs: [cfg!(feature = "legs"), true, true, true],
            machine,
            deviation,
            sheet: *sheet,
            pu,
        })
    }

    /// With 3 current sensors, or with 2, in phases a and b: every impedance has the gain of phase a then, and of the
    /// differences of the legs only the part is found that does not change its sign with the current.
    ///
    /// # Errors
    /// Another number: a single shunt wants shifted pulses, which a commissioning does not make.
    pub fn current_sensors(self, number: u32) -> Result<Self, ParamError> {
        check("current_sensors", f64::from(number), 2.0, 3.0, "")
            .map_err(|e| e.with_note("a commissioning reads the phase currents"))?;
        let third = number == 3;
        Ok(Self {
            third,
            #[cfg(feature = "legs")]
            legs: self.legs.with_odd(third),
            ..self
        })
    }

    /// One procedure alone, after the check of the wiring: the values of the others are those of nameplate and data sheet.
    /// [`Stage::Wiring`] and [`Stage::Complete`]: nothing but that check.
    #[must_use]
    pub fn only(self, stage: Stage) -> Self {
        let mut runs = Stage::PROCEDURES.map(|of| of == stage);
        runs[0] &= cfg!(feature = "legs");
        Self { runs, ..self }
    }

    /// The stage after one.
    fn after(&self, stage: Stage) -> Stage {
        let later = Stage::PROCEDURES.into_iter().zip(self.runs).find(|(of, runs)| *of > stage && *runs);
        later.map_or(Stage::Complete, |(of, _)| of)
    }

    /// Whether a procedure is complete in a stage.
    fn completed(&self, procedure: Stage, stage: Stage) -> bool {
        stage > procedure && Stage::PROCEDURES.into_iter().zip(self.runs).any(|(of, runs)| of == procedure && runs)
    }

    /// The machine by its nameplate: what per-unit quantities refer to.
    #[must_use]
    pub fn machine(&self) -> &Machine {
        &self.machine
    }

    /// Resolution of the PWM timer, if duties are multiples of its counts.
    #[must_use]
    pub fn timer(&self) -> Option<&Timer> {
        self.excitation.timer.as_ref()
    }

    /// Periods of all procedures that are run, roughly.
    #[must_use]
    pub fn duration(&self) -> u32 {
        #[cfg(feature = "legs")]
        let legs = self.legs.duration();
        #[cfg(not(feature = "legs"))]
        let legs = 0;
        let (bridge, leakage) = (bridge::duration(self.settle), leakage::duration(self.settle));
        let each = [legs, bridge, leakage, self.magnetising.duration()];
        let run = each.into_iter().zip(self.runs).filter_map(|(periods, runs)| runs.then_some(periods));
        self.wiring.offset_periods + run.sum::<u32>()
    }
}

/// Self-commissioning at standstill.
#[derive(Clone, Copy, Debug)]
pub struct Commissioning<R: Real> {
    config: CommissioningConfig<R>,
    state: State<R>,
}

/// What a step changes: below 2 KiB in every arithmetic.
#[derive(Clone, Copy, Debug)]
struct State<R: Real> {
    status: Status,
    stage: Stage,
    period: u32,
    excitation: Excitation<R>,
    wiring: Wiring<R>,
    bridge: Bridge<R>,
    #[cfg(feature = "legs")]
    legs: Comparison<R>,
    leakage: Leakage<R>,
    magnetising: Magnetising<R>,
}

impl<R: Real> Commissioning<R> {
    /// Before its first period, gates off.
    #[must_use]
    pub fn new(config: CommissioningConfig<R>) -> Self {
        let state = State {
            status: Status::Running,
            stage: Stage::Wiring,
            period: 0,
            excitation: Excitation::new(&config.excitation),
            wiring: Wiring::new(&config.wiring),
            bridge: Bridge::new(),
            #[cfg(feature = "legs")]
            legs: Comparison::new(),
            leakage: Leakage::new(),
            magnetising: Magnetising::new(),
        };
        Self { config, state }
    }

    /// Constants.
    pub fn config(&self) -> &CommissioningConfig<R> {
        &self.config
    }

    /// State.
    pub fn status(&self) -> Status {
        self.state.status
    }

    /// Procedure under way, or the one in which it was stopped.
    pub fn stage(&self) -> Stage {
        self.state.stage
    }

    /// Part of the time that has passed, 0 to 1.
    pub fn progress(&self) -> f64 {
        match self.state.status {
            Status::Done => 1.0,
            _ => (f64::from(self.state.period) / f64::from(self.config.duration())).min(0.999),
        }
    }

    /// Periods since the beginning.
    pub fn period(&self) -> u32 {
        self.state.period
    }

    /// Blocks the gates for good; what has been found stays.
    pub fn abort(&mut self) {
        self.state.fault(Cause::Aborted);
    }

    /// One control period.
    pub fn step(&mut self, measured: &Measurement<R>) -> Output<R> {
        let Self { config: c, state } = self;
        if state.status == Status::Running {
            state.period = state.period.wrapping_add(1);
            match state.procedure(c, measured) {
                Ok((Command::Blocked, _)) => {}
                Ok((command, x)) => {
                    let aside = state.stage == Stage::Leakage;
                    let mut gain = if state.stage > Stage::Wiring { state.wiring.leakage } else { R::ONE };
                    if aside {
                        gain *= R::from_f64(ASIDE);
                    }
                    let duty = state.excitation.duties(&c.excitation, gain, &command, &x);
                    if state.excitation.off() >= OFF && !aside {
                        state.fault(Cause::CurrentControl);
                    } else if state.excitation.limited() >= LIMITED {
                        state.fault(Cause::WrongMotor);
                    } else {
                        return Output { duty, gates_on: true };
                    }
                }
                Err(cause) => state.fault(cause),
            }
        }
        Output { duty: zero_duty(), gates_on: false }
    }
}

impl<R: Real> State<R> {
    #[cold]
    #[inline(never)]
    fn fault(&mut self, cause: Cause) {
        if self.status == Status::Running {
            self.status = Status::Faulted { cause, period: self.period };
        }
    }

    /// Checks the measurement and runs the procedure of the stage: its command and the sample.
    fn procedure(&mut self, c: &CommissioningConfig<R>, m: &Measurement<R>) -> Result<(Command<R>, Sample<R>), Cause> {
        let mut i_abc = m.i_abc;
        if !c.third {
            i_abc[2] = -i_abc[0] - i_abc[1];
        }
        // Written so that NaN fails the comparisons.
        if !i_abc.iter().all(|i| i.within(R::from_f64(4.0))) || !m.u_dc.within(R::from_f64(100.0)) {
            return Err(Cause::Measurement);
        }
        if !(m.u_dc >= c.u_dc.0 && m.u_dc <= c.u_dc.1) {
            return Err(Cause::DcLink);
        }
        if self.stage > Stage::Wiring {
            for (i, o) in i_abc.iter_mut().zip(self.wiring.offset()) {
                *i -= o;
            }
            if !i_abc.iter().all(|i| i.within(c.trip)) {
                return Err(Cause::OverCurrent);
            }
        }
        let x = self.excitation.sample(i_abc, m.u_dc);
        // A procedure that is complete hands over to the next one; none is complete in its first period.
        let zero = Command::Current(R::ZERO, R::ZERO);
        let command = match self.stage {
            Stage::Wiring => self.wiring.step(&c.wiring, &x)?,
            Stage::Bridge => self.bridge.step(&c.bridge, self.wiring.leakage, &x)?,
            #[cfg(feature = "legs")]
            Stage::Legs => {
                let (next, complete) = self.legs.step(&c.legs, &x);
                if complete {
                    self.excitation.knee.set_legs(&self.legs.legs, x.u_dc);
                }
                next
            }
            #[cfg(not(feature = "legs"))]
            Stage::Legs => None,
            Stage::Leakage => {
                let u = (c.u_square * self.wiring.leakage).min(c.u_square_max);
                self.leakage.step(c.settle, c.leakage_weight, u, &x)
            }
            Stage::Magnetising => self.magnetising.step(&c.magnetising, &x),
            Stage::Complete => None,
        };
        if command.is_none() {
            self.stage = c.after(self.stage);
            if self.stage == Stage::Complete {
                self.status = Status::Done;
                return Ok((Command::Blocked, x));
            }
        }
        Ok((command.unwrap_or(zero), x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;
    use proptest::prelude::*;

    const PLATE: Nameplate =
        Nameplate { P_N: 4000.0, U_N: 400.0, I_N: 8.2, f_N: 50.0, n_N: 1435.0, cos_phi: 0.82, T_max: None, J: None };

    /// At every stage, whatever is measured: duties within their range, gates off after a fault, and a result.
    fn survives<R: Real>(skip: usize, readings: &[(f64, f64, f64, f64)]) {
        let sheet = Inverter { f_clk: 0.0, ..Inverter::preset_2k2() };
        let mut x = Commissioning::new(CommissioningConfig::<R>::new(&PLATE, &sheet).unwrap());
        x.state.stage = [Stage::Wiring, Stage::Legs, Stage::Bridge, Stage::Leakage, Stage::Magnetising][skip];
        for &(a, b, c, u) in readings {
            let out = x.step(&Measurement { i_abc: [a, b, c].map(R::from_f64), u_dc: R::from_f64(u) });
            assert!(out.duty.iter().all(|d| *d >= R::ZERO && *d <= R::ONE));
            assert!(!out.gates_on || x.status() == Status::Running);
        }
        if let Ok(found) = x.result() {
            found.machine.validate().unwrap();
            found.inverter.validate().unwrap();
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_measurement_makes_a_step_panic_or_a_duty_leave_its_range(
            skip in 0..5usize,
            readings in proptest::collection::vec(
                prop_oneof![
                    4 => (-1.4..1.4, -1.4..1.4, -1.4..1.4, 1.0..2.3),
                    1 => (any::<f64>(), any::<f64>(), any::<f64>(), any::<f64>()),
                ],
                1..300,
            ),
        ) {
            survives::<f32>(skip, &readings);
            survives::<f64>(skip, &readings);
            survives::<Q>(skip, &readings);
        }
    }

    #[test]
    fn an_abort_blocks_the_gates_in_the_same_period_and_stays() {
        let mut x = Commissioning::<f32>::new(CommissioningConfig::new(&PLATE, &Inverter::preset_2k2()).unwrap());
        let measured = Measurement { i_abc: [0.0; 3], u_dc: 1.65 };
        for _ in 0..1500 {
            x.step(&measured);
        }
        x.abort();
        for _ in 0..3 {
            assert!(!x.step(&measured).gates_on);
        }
        assert!(matches!(x.status(), Status::Faulted { cause: Cause::Aborted | Cause::NoMotor, .. }));
    }
}
