//! Admissible range of each setting.

use super::clocks::{slow_periods, speed_periods};
use super::defaults::{
    FASTEST_PLL, SLACK, SPEED_BANDWIDTH, SUPERVISED, WEAKENED, WINDOW_MAX, encoder_deviation, fastest_field,
};
use super::derived::LEAST_BUILD_UP;
use super::direct_flux::{DirectFlux, FLUX_GAIN};
use super::scheme::Scheme;
use super::types::{DriveParams, EncoderMode};
use crate::base::Base;
use crate::error::refuse;
use crate::params::{Inverter, Machine, ParamError, check};

/// Least trip level in units of the largest current: at 11 kW a start to rated speed with all of it reaches 1.1 times.
const TRIP_LEAST: f64 = 1.15;

/// Least bandwidth of the speed estimator in units of that of speed control: with 1.5 times the speed swings by 0.002
/// pu at 5 Hz and less at 9 Hz, with 1.1 times by 0.02, and with once at 5 Hz control is lost (2.2 and 11 kW).
const PLL_LEAST: f64 = 1.5;

/// Largest bandwidth of current control relative to the control's frequency: 32° of phase by 1.5 periods of delay.
const FASTEST_CURRENT: f64 = 0.06;

/// The same with overmodulation. The six edges of the hexagon are a ripple of six times the frequency in field
/// coordinates. Behind 1.5 periods of delay and the leakage inductance current control answers it in phase at a sixth
/// of the control's rate, which is 36 periods a turn; 45 keep the ripple a fifth below. Current control oscillates with
/// 40, not with 50.
const PERIODS_OVERMODULATED: f64 = 45.0;

/// Least number of an encoder's lines for each pole pair: one count is 0.1 rad of the field, and its ripple some
/// hundredths of rated speed.
const LINES_A_POLE_PAIR: f64 = 16.0;

/// What a rated torque has to fit where the setting that follows from it is out of range.
const SLIP: &str = "with R_R, U_N, f_N and n_p it gives the rated slip, which encoder_deviation follows from and \
    which must stay below 13 pu";

impl DriveParams {
    /// Checks every field against its admissible range.
    ///
    /// # Errors
    /// The first field found outside its range, or changed although it belongs to the scheme that does not run.
    pub fn validate(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let i_n = machine.I_N * core::f64::consts::SQRT_2;
        let f_s = inverter.f_c();
        let tau_r = machine.L_M / machine.R_R;
        check("psi_ref", self.psi_ref, 0.3, 1.2, "p.u.")?;
        let i_0 = self.psi_ref * Base::new(machine).psi / machine.L_s();
        check("i_max", self.i_max, 1.1 * i_0, 5.0 * i_n, "A")?;
        check("torque_max", self.torque_max, 0.05 * machine.T_N, 5.0 * machine.T_N, "N m")?;
        let omega_n = machine.omega_sR() / f64::from(machine.n_p);
        let fastest = fastest_field(inverter) / f64::from(machine.n_p);
        check("omega_max", self.omega_max, 0.01 * omega_n, (3.0 * omega_n).min(fastest), "rad/s")
            .map_err(|e| e.with_note("at most 3 pu, and 30 control periods in one turn of the field"))?;
        let turns = f_s * core::f64::consts::TAU / (self.omega_max * f64::from(machine.n_p));
        let most = f64::from(u8::from(turns >= PERIODS_OVERMODULATED));
        check("overmodulation", f64::from(u8::from(self.overmodulation)), 0.0, most, "")
            .map_err(|e| e.with_note("at least 45 control periods in one turn of the field at omega_max"))?;
        check("i_trip", self.i_trip, TRIP_LEAST * self.i_max, 8.0 * i_n, "A")
            .map_err(|e| e.with_note("1.15 times i_max or more: current control exceeds it in steps"))?;
        check("i_range", self.i_range, self.i_trip, 20.0 * i_n, "A")?;
        // The link at its rated voltage, with ripple, sag under load and noise of the reading, is no fault.
        check("u_dc_min", self.u_dc_min, 0.0, 0.95 * inverter.u_dc, "V")?;
        check("u_dc_max", self.u_dc_max, 1.05 * inverter.u_dc, 3.0 * inverter.u_dc, "V")
            .map_err(|e| e.with_note("1.05 to 3 times the rated voltage of the dc link"))?;
        check("current_bandwidth", self.current_bandwidth, 10.0, FASTEST_CURRENT * f_s, "Hz")?;
        let fastest = FLUX_GAIN.1 * DirectFlux::new(machine, inverter, self.current_bandwidth).fastest_filtered();
        check("flux_bandwidth", self.flux_bandwidth, 0.1, fastest.min(30.0), "Hz")
            .map_err(|e| e.with_note("by way of the leakage its current acts on the flux at once"))?;
        check("speed_bandwidth", self.speed_bandwidth, SPEED_BANDWIDTH.0, SPEED_BANDWIDTH.1, "Hz")?;
        check("set_point_weight", self.set_point_weight, 0.0, 1.0, "")?;
        // A fifteenth of the rate at which the loop runs.
        let least = (PLL_LEAST * self.speed_bandwidth).max(2.0);
        check("pll_bandwidth", self.pll_bandwidth, least, (FASTEST_PLL.0 * f_s).min(FASTEST_PLL.1), "Hz").map_err(
            |e| {
                e.with_note(
                    "2 Hz and 1.5 times speed_bandwidth or more: the speed that is controlled is the estimated one",
                )
            },
        )?;
        check("offset_time", self.offset_time, 10.0 / f_s, 10.0, "s")?;
        let modes = cfg!(feature = "modes");
        self.validate_sensors(inverter)?;
        check("half_periods", f64::from(inverter.half_periods), if modes { 1.0 } else { 2.0 }, 16.0, "")
            .map_err(needs_modes)?;
        check("magnetise_time", self.magnetise_time, LEAST_BUILD_UP * tau_r, 60.0, "s")?;
        check("fresh_time", self.fresh_time, 0.0, 3600.0, "s")?;
        if self.stall_time != 0.0 {
            check("stall_time", self.stall_time, 0.1, 60.0, "s")?;
        }
        for (field, value) in [
            ("supervision", f64::from(u8::from(self.supervision))),
            ("stall_time", self.stall_time),
            ("realignment", f64::from(u8::from(self.realignment))),
            ("reduce_gain", f64::from(u8::from(self.reduce_gain))),
        ] {
            if value != 0.0 && !SUPERVISED {
                return Err(refuse(field, value, "", "needs the feature `supervision`"));
            }
        }
        if self.field_weakening && !WEAKENED {
            return Err(refuse("field_weakening", 1.0, "", "needs the feature `weakening`"));
        }
        if let Some(part) = self.discontinuous_above {
            check("discontinuous_above", part, 0.3, if cfg!(feature = "modes") { 1.0 } else { 0.0 }, "")
                .map_err(needs_modes)?;
        }
        self.validate_limits(machine, inverter)?;
        self.validate_link(inverter)?;
        self.validate_encoder(machine, inverter)?;
        self.paper.validate()?;
        self.enhanced.validate(machine)?;
        match self.scheme {
            Scheme::Paper => self.enhanced.refuse_changes(machine),
            Scheme::Enhanced => self.paper.refuse_changes(),
        }
    }

    /// Number of current sensors, and what a single shunt asks of the pulses.
    fn validate_sensors(&self, inverter: &Inverter) -> Result<(), ParamError> {
        let least = if cfg!(feature = "shunt") {
            1.0
        } else if cfg!(feature = "modes") {
            2.0
        } else {
            3.0
        };
        check("current_sensors", f64::from(self.current_sensors), least, 3.0, "").map_err(|e| {
            if cfg!(feature = "shunt") { e } else { e.with_note("2 needs the feature `modes`, 1 the feature `shunt`") }
        })?;
        let longest = WINDOW_MAX / inverter.f_s;
        if self.shunt_window != 0.0 {
            check("shunt_window", self.shunt_window, inverter.dead_time.min(longest), longest, "s")
                .map_err(|e| e.with_note("dead time, settling and sampling, at most 15 % of the carrier period"))?;
        }
        check("shunt_settling", self.shunt_settling, 0.0, 0.25 * longest, "s")?;
        if self.current_sensors > 1 {
            return Ok(());
        }
        const SHUNT: &str =
            "with a single shunt the pulses are continuous, updated once, and leave room for its window";
        let off =
            |field, chosen| check(field, f64::from(u8::from(chosen)), 0.0, 0.0, "").map_err(|e| e.with_note(SHUNT));
        off("discontinuous_above", self.discontinuous_above.is_some())?;
        off("overmodulation", self.overmodulation)?;
        check("half_periods", f64::from(inverter.half_periods), 2.0, 16.0, "").map_err(|e| e.with_note(SHUNT))
    }

    /// Ramp, limits by direction, derating.
    fn validate_limits(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        let omega_n = machine.omega_sR() / f64::from(machine.n_p);
        for (field, value, unit) in [("acceleration", self.acceleration, "rad/s²"), ("jerk", self.jerk, "rad/s³")] {
            if let (Some(value), false) = (value, cfg!(feature = "ramp")) {
                return Err(refuse(field, value, unit, "needs the feature `ramp`"));
            }
        }
        if let Some(a) = self.acceleration {
            check("acceleration", a, 1e-3 * omega_n, 1000.0 * omega_n, "rad/s²")?;
        }
        if let Some(j) = self.jerk {
            if self.acceleration.is_none() {
                return Err(refuse("jerk", j, "rad/s³", "it needs an acceleration"));
            }
            check("jerk", j, 1e-2 * omega_n, 1e5 * omega_n, "rad/s³")?;
        }
        if let Some((negative, positive)) = self.torque_limits {
            check("torque_limits[0]", negative, -self.torque_max, 0.0, "N m")?;
            check("torque_limits[1]", positive, 0.0, self.torque_max, "N m")?;
        }
        if let Some((negative, positive)) = self.speed_limits {
            check("speed_limits[0]", negative, -self.omega_max, 0.0, "rad/s")?;
            check("speed_limits[1]", positive, 0.0, self.omega_max, "rad/s")?;
        }
        let root = core::f64::consts::SQRT_2;
        let least = 1.1 * self.psi_ref * Base::new(machine).psi / machine.L_s() / root;
        for (fields, body) in [
            (["machine_overload[0]", "machine_overload[1]"], self.machine_overload),
            (["bridge_overload[0]", "bridge_overload[1]"], self.bridge_overload),
        ] {
            if let Some((current, time)) = body {
                if !cfg!(feature = "derating") {
                    return Err(refuse(fields[0], current, "A", "needs the feature `derating`"));
                }
                check(fields[0], current, least, self.i_max / root, "A")?;
                // Longer than the interval in which it is computed, short enough for fixed point.
                check(fields[1], time, 1e4 / inverter.f_c(), 3600.0, "s")?;
            }
        }
        Ok(())
    }

    /// Encoder and its counter.
    fn validate_encoder(&self, machine: &Machine, inverter: &Inverter) -> Result<(), ParamError> {
        const BUILT: bool = cfg!(feature = "encoder");
        let note = match (BUILT, self.encoder_lines) {
            (false, _) => "needs the feature `encoder`",
            (true, 0) => "encoder_mode and encoder_fault need an encoder",
            (true, _) => "at least 16 lines a pole pair; 0 is no encoder",
        };
        let (lines, omega_n) = (f64::from(self.encoder_lines), machine.omega_sR() / f64::from(machine.n_p));
        let used = self.encoder_lines > 0 || self.encoder_fault || self.encoder_mode != EncoderMode::Compare;
        let (least, most) = match (used, BUILT) {
            (false, _) => (0.0, 65_536.0),
            (true, true) => (LINES_A_POLE_PAIR * f64::from(machine.n_p), 65_536.0),
            (true, false) => (0.0, 0.0),
        };
        check("encoder_lines", if used && !BUILT { lines.max(1.0) } else { lines }, least, most, "")
            .map_err(|e| e.with_note(note))?;
        let turns = f64::from(speed_periods(self.scheme, slow_periods(inverter))) / inverter.f_c() * self.omega_max
            / core::f64::consts::TAU;
        check(
            "encoder_states",
            f64::from(self.encoder_states),
            16.0 * (4.0 * lines * turns),
            f64::from(1_u32 << 31),
            "",
        )
        .map_err(|e| {
            e.with_note("at least 16 times the counts between two runs of the speed estimator at omega_max")
        })?;
        let (least, most) = (0.005 * omega_n, 10.0 * omega_n);
        check("encoder_deviation", self.encoder_deviation, least, most, "rad/s").map_err(|e| {
            let derived = encoder_deviation(machine);
            if self.encoder_deviation.to_bits() != derived.to_bits() {
                return e.with_note("0.005 to 10 times the speed of f_N and n_p");
            }
            // Nobody gave it: it follows from the rated slip, which is in proportion to the torque.
            let of_slip = |deviation: f64| machine.T_N * (deviation - SLACK * omega_n) / (derived - SLACK * omega_n);
            ParamError {
                field: "T_N",
                value: machine.T_N,
                min: of_slip(least).max(0.0),
                max: of_slip(most),
                unit: "N m",
                note: SLIP,
            }
        })
    }

    /// Voltages of the link's control.
    fn validate_link(&self, inverter: &Inverter) -> Result<(), ParamError> {
        #[cfg(feature = "dclink")]
        use crate::control::dclink::WIDTH;
        #[cfg(not(feature = "dclink"))]
        const WIDTH: f64 = 0.0;
        let built = cfg!(feature = "dclink");
        let check = |field, value, min: f64, max: f64| {
            if built {
                check(field, value, min, max, "V")
            } else {
                Err(refuse(field, value, "V", "needs the feature `dclink`"))
            }
        };
        // Braking torque falls within a width below its voltage, driving torque within one above the buffering voltage;
        // within one below that the machine comes to feed the link, before the drive ends with an under-voltage.
        if let Some(u) = self.u_dc_brake {
            check("u_dc_brake", u, 1.1 * inverter.u_dc, self.u_dc_max)?;
        }
        if let Some(u) = self.u_dc_buffer {
            check("u_dc_buffer", u, self.u_dc_min + WIDTH * inverter.u_dc, 0.9 * inverter.u_dc)?;
        }
        if let Some((on, full)) = self.u_dc_chopper {
            check("u_dc_chopper[0]", on, 1.02 * inverter.u_dc, self.u_dc_max)?;
            check("u_dc_chopper[1]", full, on + 0.005 * inverter.u_dc, self.u_dc_max)?;
        }
        Ok(())
    }
}

/// What an error says of a setting that is left out of the build.
fn needs_modes(e: ParamError) -> ParamError {
    if cfg!(feature = "modes") { e } else { e.with_note("needs the feature `modes`") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rated_torque_that_no_slip_fits_is_named_in_place_of_what_follows_from_it() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let refused = |machine: &Machine, change: fn(&mut DriveParams)| {
            let mut params = DriveParams::new(machine, &inverter);
            change(&mut params);
            params.validate_encoder(machine, &inverter).unwrap_err()
        };
        let wrong = Machine { T_N: 1000.0 * machine.T_N, ..machine };
        let error = refused(&wrong, |_| {});
        assert_eq!((error.field, error.value, error.min), ("T_N", wrong.T_N, 0.0));
        assert!(error.note.contains("encoder_deviation"), "{error}");
        // The range is that of the torque itself.
        for (part, fits) in [(0.999, true), (1.001, false)] {
            let machine = Machine { T_N: part * error.max, ..machine };
            assert_eq!(DriveParams::new(&machine, &inverter).validate_encoder(&machine, &inverter).is_ok(), fits);
        }
        // What was given is named itself.
        let error = refused(&machine, |params| params.encoder_deviation = 1e5);
        assert_eq!((error.field, error.value), ("encoder_deviation", 1e5));
        assert!(error.note.contains("f_N and n_p"), "{error}");
    }
}
