//! Default of each setting.

use super::derived::legs_time;
use super::direct_flux::{DirectFlux, FLUX_GAIN};
use super::enhanced::EnhancedParams;
use super::paper::PaperParams;
use super::scheme::Scheme;
use super::types::{DriveParams, EncoderMode, LowConfidence};
use crate::base::Base;
use crate::params::{Inverter, Machine};

/// Whether the monitors of the supervision are built.
pub(super) const SUPERVISED: bool = cfg!(feature = "supervision");

/// Whether this build has field weakening, which is on by default.
pub(super) const WEAKENED: bool = cfg!(feature = "weakening");

/// Default bandwidth of current control relative to the carrier's frequency, not to that of the control: it is the
/// bridge that disturbs the current, with each of its edges, and where the current stays near zero for longer its error
/// is not known. With 0.03 of the control's frequency, control in every second carrier period of 10 kHz loses 16 of 128
/// draws of the 0.37- and 0.75-kW drives, with that of the carrier none.
const CURRENT_BANDWIDTH: f64 = 0.03;

/// Largest default bandwidth of current control relative to the control's frequency. The overshoot of a reversal in
/// field weakening, from the largest current to the one of the other sign, passes the trip with 0.05 and 0.06 at 11 kW
/// and 10 kHz, control in every second carrier period, and stays below it with 0.04.
const FASTEST_DEFAULT_CURRENT: f64 = 0.04;

/// Range of the bandwidth of speed control, Hz.
pub(super) const SPEED_BANDWIDTH: (f64, f64) = (0.05, 20.0);

/// Control periods in one turn of the field that the loops need: current control is lost with 25, not with 30.
const PERIODS_A_TURN: f64 = 30.0;

/// Longest window of a single shunt, in parts of the carrier period.
pub(super) const WINDOW_MAX: f64 = 0.15;

/// Part of `encoder_deviation` that does not follow from the slip, per unit.
pub(super) const SLACK: f64 = 0.01;

/// Part of itself by which the leakage inductance may be off, and the largest gain with which the torque may act on
/// itself through that error ([`leakage_feedback`]). Simulated drives of 45 and 160 kW oscillated with a gain of 2.1,
/// one of 15 kW with 1.7 did not.
const LEAKAGE_ERROR: f64 = 0.2;
const LEAKAGE_GAIN: f64 = 1.6;

/// Largest bandwidth of the speed estimator, relative to the frequency of the control, and in Hz.
pub(super) const FASTEST_PLL: (f64, f64) = (0.03, 100.0);

/// Least default bandwidth of the phase-locked loop that estimates the speed, Hz, and the largest one relative to the frequency
/// of the control, a little below what is admissible ([`FASTEST_PLL`]).
const PLL_BANDWIDTH: f64 = 25.0;
const FASTEST_DEFAULT_PLL: f64 = 0.029;

/// Default torque limit, in rated torques.
const TORQUE_MAX: f64 = 1.5;

impl DriveParams {
    /// Defaults for a machine on an inverter.
    #[must_use]
    pub fn new(machine: &Machine, inverter: &Inverter) -> Self {
        let i_n = machine.I_N * core::f64::consts::SQRT_2;
        let tau_r = machine.L_M / machine.R_R;
        let current_bandwidth = (CURRENT_BANDWIDTH * inverter.f_s).min(FASTEST_DEFAULT_CURRENT * inverter.f_c());
        let direct = DirectFlux::new(machine, inverter, current_bandwidth);
        let pll_bandwidth = pll_bandwidth(machine, inverter);
        Self {
            scheme: Scheme::default(),
            psi_ref: 1.0,
            i_max: 1.8 * i_n,
            torque_max: TORQUE_MAX * machine.T_N,
            omega_max: (2.2 * machine.omega_sR()).min(fastest_field(inverter)) / f64::from(machine.n_p),
            i_trip: 2.3 * i_n,
            i_range: 2.5 * i_n,
            u_dc_min: 0.6 * inverter.u_dc,
            u_dc_max: 1.45 * inverter.u_dc,
            current_bandwidth,
            flux_bandwidth: (FLUX_GAIN.0 * direct.fastest_filtered()).min(5.0),
            speed_bandwidth: speed_bandwidth(machine, pll_bandwidth),
            set_point_weight: 0.3,
            pll_bandwidth,
            inverter_model: true,
            calibrate_offset: true,
            offset_time: 0.1,
            current_sensors: 3,
            shunt_settling: 0.0,
            shunt_window: (inverter.dead_time + 2.5e-6).min(WINDOW_MAX / inverter.f_s),
            magnetise_time: (4.0 * tau_r + legs_time(tau_r, current_bandwidth)).max(1.4),
            low_confidence: LowConfidence::Keep,
            fresh_time: 10.0,
            supervision: SUPERVISED,
            stall_time: if SUPERVISED { 0.35 } else { 0.0 },
            realignment: SUPERVISED,
            reduce_gain: SUPERVISED,
            discontinuous_above: None,
            field_weakening: WEAKENED,
            overmodulation: false,
            acceleration: None,
            jerk: None,
            torque_limits: None,
            speed_limits: None,
            machine_overload: None,
            bridge_overload: None,
            u_dc_brake: None,
            u_dc_buffer: None,
            u_dc_chopper: None,
            encoder_lines: 0,
            encoder_states: 1 << 16,
            encoder_mode: EncoderMode::Compare,
            encoder_deviation: encoder_deviation(machine),
            encoder_fault: false,
            paper: PaperParams::default(),
            enhanced: EnhancedParams::new(machine),
        }
    }
}

/// Largest stator frequency that the loops carry, rad/s.
pub(super) fn fastest_field(inverter: &Inverter) -> f64 {
    core::f64::consts::TAU * inverter.f_c() / PERIODS_A_TURN
}

/// Difference of measured and estimated speed that an estimate may have: three quarters of the rated slip, for a rotor
/// resistance that is wrong by half at one and a half times rated torque, and 0.01 pu for the rest.
pub(super) fn encoder_deviation(machine: &Machine) -> f64 {
    0.75 * rated_slip(machine) + SLACK * Base::new(machine).omega_m
}

/// Slip at rated torque with the base flux in the rotor, mechanical rad/s. The rotor's own flux is `L_M/L_s` of that
/// without load, and the slip more.
fn rated_slip(machine: &Machine) -> f64 {
    let n_p = f64::from(machine.n_p);
    let psi = Base::new(machine).psi;
    machine.R_R * machine.T_N / (1.5 * n_p * psi * psi) / n_p
}

/// Default bandwidth of speed control, Hz: 9, less where the proportional gain would ask for more than twice the rated
/// torque when the speed is off by the rated slip `Δ`, or where the torque acts on itself through the leakage.
///
/// `R_R` above the real one by a part `ε` of it leaves `ω̂ = ω - ε Δ T/T_N`: with `T = k_p (ω* - ω̂)` the torque acts
/// on itself with the gain `ε k_p Δ/T_N`, at once. From 1 on a positive one runs away, and behind the delays of speed
/// estimator and current control a negative one oscillates. `k_p = J ω_c` and `ω_c ≤ 2 T_N/(J Δ)` leave a gain of `2ε`.
///
/// An error `ΔL` of the leakage turns the estimated rotor flux by `ΔL i_q/ψ`, which the phase-locked loop that follows
/// it, of the natural frequency `ω_n`, takes for the speed `2 ω_n ΔL i_q/(ψ n_p)` while the torque changes faster than
/// it settles: with `T = 1.5 n_p ψ i_q` a gain of `2 J ω_c ω_n ΔL/(1.5 n_p² ψ²)`, that oscillates at 17 to 26 Hz.
///
/// At the drives of the evidence 9 Hz are below both; they count where a large inertia is driven.
fn speed_bandwidth(machine: &Machine, pll_bandwidth: f64) -> f64 {
    let tau = core::f64::consts::TAU;
    let by_slip = 2.0 * machine.T_N / (machine.J * rated_slip(machine));
    let by_leakage = LEAKAGE_GAIN / leakage_feedback(machine, pll_bandwidth);
    (by_slip.min(by_leakage) / tau).clamp(SPEED_BANDWIDTH.0, 9.0)
}

/// Gain with which the torque acts on itself through a leakage that is [`LEAKAGE_ERROR`] off, per rad/s of speed
/// control's bandwidth.
fn leakage_feedback(machine: &Machine, pll_bandwidth: f64) -> f64 {
    let flux = f64::from(machine.n_p) * Base::new(machine).psi;
    let omega_n = core::f64::consts::TAU * pll_bandwidth;
    2.0 * machine.J * omega_n * LEAKAGE_ERROR * machine.L_sigma / (1.5 * flux * flux)
}

/// Default bandwidth of the phase-locked loop, Hz: 25, more where the shaft is light.
///
/// The loop turns with the angle of the rotor flux by the sine of their difference `ε`: its speed changes by `ω_n² sin ε`, and
/// where the shaft accelerates by more than `ω_n²` it slips turns. The largest torque accelerates by `α = T n_p/J`;
/// `ω_n = √(2α)` leaves `ε` at 30°.
fn pll_bandwidth(machine: &Machine, inverter: &Inverter) -> f64 {
    let acceleration = TORQUE_MAX * machine.T_N * f64::from(machine.n_p) / machine.J;
    let fastest = (FASTEST_DEFAULT_PLL * inverter.f_c()).min(FASTEST_PLL.1);
    (libm::sqrt(2.0 * acceleration) / core::f64::consts::TAU).min(fastest).max(PLL_BANDWIDTH)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speed_control_asks_for_twice_the_rated_torque_at_most_where_the_speed_is_off_by_the_rated_slip() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        for factor in [0.1, 1.0, 5.0, 10.0, 100.0, 1000.0] {
            let machine = Machine { J: factor * machine.J, ..machine };
            let bandwidth = DriveParams::new(&machine, &inverter).speed_bandwidth;
            let torque = machine.J * core::f64::consts::TAU * bandwidth * rated_slip(&machine);
            assert!(bandwidth == 9.0 || (torque / machine.T_N - 2.0).abs() < 1e-12, "{factor}: {bandwidth} Hz");
            assert_eq!(bandwidth == 9.0, factor <= 5.0, "{factor}: {bandwidth} Hz");
        }
        let immovable = Machine { J: 1e5, ..machine };
        assert_eq!(DriveParams::new(&immovable, &inverter).speed_bandwidth, SPEED_BANDWIDTH.0, "admissible");
    }

    #[test]
    fn speed_control_of_a_large_inertia_leaves_the_torque_little_to_act_on_itself_through_the_leakage() {
        let (machine, inverter) = (Machine::preset_11k(), Inverter::preset_11k());
        // The leakage of a larger machine counts where its slip, small as it is, does not.
        let large = Machine { R_R: machine.R_R / 4.0, ..machine };
        for factor in [1.0, 10.0, 100.0] {
            let machine = Machine { J: factor * large.J, ..large };
            let bandwidth = DriveParams::new(&machine, &inverter).speed_bandwidth;
            let gain = leakage_feedback(&machine, PLL_BANDWIDTH) * core::f64::consts::TAU * bandwidth;
            assert_eq!(bandwidth == 9.0, factor <= 10.0, "{factor}: {bandwidth} Hz");
            assert!(bandwidth == 9.0 && gain < LEAKAGE_GAIN || (gain - LEAKAGE_GAIN).abs() < 1e-9, "{factor}: {gain}");
        }
    }

    #[test]
    fn the_speed_estimator_follows_a_light_shaft_at_the_largest_torque() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        for factor in [1.0, 0.3, 0.1, 0.03, 0.01] {
            let machine = Machine { J: factor * machine.J, ..machine };
            let p = DriveParams::new(&machine, &inverter);
            let omega_n = core::f64::consts::TAU * p.pll_bandwidth;
            let part = p.torque_max * f64::from(machine.n_p) / machine.J / (omega_n * omega_n);
            assert!(part < 0.5 + 1e-9 || p.pll_bandwidth == FASTEST_PLL.1, "{factor}: {part}");
            assert!(p.pll_bandwidth == PLL_BANDWIDTH || part > 0.5 - 1e-9, "{factor}: {part}");
            p.validate(&machine, &inverter).expect("defaults are admissible");
        }
    }
}
