//! **Yours to change:** machine, bridge, settings and full scales. The build computes the parameter page from them, and
//! stops with name and range of what it does not admit.

use stillflux::config::DriveParams;
use stillflux::params::{Inverter, Machine};

/// Clock of TIM1, Hz.
pub const F_CLK: f64 = 170e6;
/// Switching frequency, Hz. `F_CLK / (2 F_S)` is the reload value: a whole number.
pub const F_S: f64 = 10e3;
/// Dead time, s, at least; the drive is told what the register makes of it.
pub const DEAD_TIME: f64 = 2e-6;
/// Current that a channel reads half of its range above zero, A, and voltage at which the divider reads all ones, V.
pub const FULL_SCALE: (f64, f64) = (20.0, 810.0);

/// Machine, bridge and settings.
pub fn parameters() -> (Machine, Inverter, DriveParams) {
    let machine = Machine {
        R_s: 3.7,       // Ω, of one phase in star
        R_R: 2.1,       // Ω
        L_sigma: 0.021, // H
        L_M: 0.224,     // H
        n_p: 2,
        J: 0.015,   // kg m², of the whole shaft
        U_N: 400.0, // V rms, line to line
        I_N: 5.0,   // A rms
        f_N: 50.0,  // Hz
        T_N: 14.6,  // N m
        saturation: None,
    };
    let (_, counts) = dead_time(DEAD_TIME * F_CLK);
    let inverter = Inverter {
        u_dc: 540.0, // V, rated
        f_s: F_S,
        u_th: 1.0, // V, threshold of the switches
        r_d: 0.2,  // Ω, their differential resistance
        dead_time: f64::from(counts) / F_CLK,
        f_clk: F_CLK,
        c_out: 1e-9, // F, of a leg's node with cable and motor: never 0 for a real bridge
        ..Inverter::preset_2k2()
    };
    let params = DriveParams::new(&machine, &inverter);
    (machine, inverter, params)
}

/// `DTG` for at least so many timer clocks (`CKD` = 0), and the clocks that it makes: steps of 1, 2, 8 and 16, at most
/// 1008.
pub const fn dead_time(clocks: f64) -> (u8, u32) {
    let whole = clocks as u32;
    // A product of 340 clocks may be computed as 340 and a bit.
    let n = if clocks - whole as f64 > 1e-6 { whole + 1 } else { whole };
    if n <= 127 {
        (n as u8, n)
    } else if n <= 2 * 127 {
        let k = n.div_ceil(2);
        (0x80 | (k - 64) as u8, 2 * k)
    } else if n <= 8 * 63 {
        let k = n.div_ceil(8);
        (0xC0 | (k - 32) as u8, 8 * k)
    } else if n <= 16 * 63 {
        let k = n.div_ceil(16);
        (0xE0 | (k - 32) as u8, 16 * k)
    } else {
        panic!("a dead time of more than 1008 timer clocks")
    }
}
