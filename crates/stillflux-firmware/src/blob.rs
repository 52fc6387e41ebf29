//! Parameters and what a drive remembers in SI, as they lie in a page of flash: magic, length, values, CRC-32.
//!
//! A firmware writes such a page after commissioning and after every stop (`Drive::memory`). It is read
//! once at power-up; an image whose page is erased, torn or of another layout does not start the bridge.
//! The image reads one only with the feature `si-page`; else it has [`stillflux::page`], which needs less flash.
//! Values are SI in double precision: the page does not depend on the arithmetic of the image.

#![allow(non_snake_case)]

use stillflux::config::{DriveParams, Scheme};
use stillflux::page::{Ready, crc};
use stillflux::params::{Inverter, Machine, ParamError, Saturation};
use stillflux::scalar::Real;
use stillflux::si::MemorySi;

/// `sfx2`: changes with the layout.
const MAGIC: u32 = 0x3278_6673;
/// Values in a page.
const VALUES: usize = 29;
/// Magic, length, values as two words each, CRC.
const WORDS: usize = 2 + 2 * VALUES + 1;

/// What an image needs to know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// The machine.
    pub machine: Machine,
    /// The inverter.
    pub inverter: Inverter,
    /// Full scale of the current channels, A.
    pub i_full: f64,
    /// Full scale of the dc-link channel, V.
    pub u_full: f64,
    /// Stored offset voltage, V, α and β.
    pub u_off: [f64; 2],
    /// Stored stator resistance with the inverter's `r_d`, Ω.
    pub r_s: f64,
    /// Stored offsets of the current channels, A.
    pub i_off: [f64; 3],
    /// Scheme of the estimators.
    pub scheme: Scheme,
}

impl Parameters {
    /// The 2.2-kW machine on its inverter, with 12-bit channels and an offset found in an earlier run.
    pub const fn preset(scheme: Scheme) -> Self {
        Self {
            machine: Machine::preset_2k2(),
            inverter: Inverter::preset_2k2(),
            i_full: 17.7,
            u_full: 810.0,
            u_off: [0.05, -0.03],
            r_s: 3.9,
            i_off: [0.0; 3],
            scheme,
        }
    }

    /// The same per unit.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn ready<R: Real>(&self) -> Result<Ready<R>, ParamError> {
        let Self { ref machine, ref inverter, i_full, u_full, u_off, r_s: R_s, i_off, scheme } = *self;
        let mut params = DriveParams { scheme, ..DriveParams::new(machine, inverter) };
        if scheme == Scheme::Enhanced {
            // So that a host with the features `legs` and `dither` computes what an image without them does.
            params.enhanced.identify_legs = false;
            params.enhanced.dither = 0.0;
        }
        let memory = MemorySi { u_off, R_s, i_off, ..MemorySi::of(machine, inverter) };
        Ready::new(machine, inverter, &params, (i_full, u_full), &memory)
    }
}

/// A page as it lies in flash.
#[repr(C)]
pub struct Blob([u32; WORDS]);

impl Blob {
    /// The page that holds `p`. `const`: a linker places it, no code runs.
    pub const fn seal(p: &Parameters) -> Self {
        let (m, inv) = (&p.machine, &p.inverter);
        // No saturation curve: zeros.
        let Saturation { L_u, a, S } = match m.saturation {
            Some(s) => s,
            None => Saturation { L_u: 0.0, a: 0.0, S: 0.0 },
        };
        let values: [f64; VALUES] = [
            m.R_s,
            m.R_R,
            m.L_sigma,
            m.L_M,
            m.n_p as f64,
            m.J,
            m.U_N,
            m.I_N,
            m.f_N,
            m.T_N,
            inv.u_dc,
            inv.f_s,
            inv.u_th,
            inv.r_d,
            inv.dead_time,
            inv.f_clk,
            inv.c_out,
            p.i_full,
            p.u_full,
            p.u_off[0],
            p.u_off[1],
            p.r_s,
            p.i_off[0],
            p.i_off[1],
            p.i_off[2],
            p.scheme as u32 as f64,
            L_u,
            a,
            S,
        ];
        let mut words = [0; WORDS];
        words[0] = MAGIC;
        words[1] = WORDS as u32;
        let mut k = 0;
        while k < VALUES {
            let bits = values[k].to_bits();
            words[2 + 2 * k] = bits as u32;
            words[3 + 2 * k] = (bits >> 32) as u32;
            k += 1;
        }
        words[WORDS - 1] = crc(&words);
        Self(words)
    }

    /// The parameters, if the page is whole.
    pub fn open(&self) -> Option<Parameters> {
        let words = &self.0;
        if words[0] != MAGIC || words[1] != WORDS as u32 || words[WORDS - 1] != crc(words) {
            return None;
        }
        let v: [f64; VALUES] =
            core::array::from_fn(|k| f64::from_bits(u64::from(words[3 + 2 * k]) << 32 | u64::from(words[2 + 2 * k])));
        #[rustfmt::skip]
        let [R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N, u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out,
             i_full, u_full, u_alpha, u_beta, r_s, i_a, i_b, i_c, scheme, L_u, a, S] = v;
        let saturation = (L_u != 0.0).then_some(Saturation { L_u, a, S });
        Some(Parameters {
            machine: Machine { R_s, R_R, L_sigma, L_M, n_p: n_p as u32, J, U_N, I_N, f_N, T_N, saturation },
            inverter: Inverter {
                u_dc,
                f_s,
                u_th,
                r_d,
                dead_time,
                f_clk,
                c_out,
                half_periods: 2,
                leg_delay: [[0.0; 2]; 3],
            },
            i_full,
            u_full,
            u_off: [u_alpha, u_beta],
            r_s,
            i_off: [i_a, i_b, i_c],
            scheme: if scheme == Scheme::Paper as u32 as f64 { Scheme::Paper } else { Scheme::Enhanced },
        })
    }
}
