//! A drive's configuration, scaling and memory as they lie in a page of flash, ready to use: magic,
//! arithmetic, schemes of the build, length, per-unit words, CRC-32.
//!
//! A host writes such a page ([`Page::seal`]; the build of this crate does it for the preset), validated, with
//! all its divisions done. Reading it takes no arithmetic at all; the alternative, SI values that the target
//! converts ([`crate::blob`]), takes software double precision.

use crate::blob::{Parameters, crc};
use stillflux::config::{DriveConfig, DriveParams, Scheme};
use stillflux::counts::Scale;
use stillflux::drive::Memory;
use stillflux::params::ParamError;
use stillflux::scalar::Real;
use stillflux::words::Words;

/// `sfr2`: changes with the layout, which is that of the core's configuration.
const MAGIC: u32 = 0x3272_6673;
/// Magic, arithmetic, schemes of the build, number of words.
const HEAD: usize = 4;
/// Words of a page; 1 KiB.
pub const WORDS: usize = 256;

/// What an image needs to know, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ready<R: Real> {
    /// Of the drive.
    pub config: DriveConfig<R>,
    /// Of the converters.
    pub scale: Scale<R>,
    /// What the drive takes back.
    pub memory: Memory<R>,
}

impl<R: Real> Ready<R> {
    /// From SI values.
    ///
    /// # Errors
    /// The first parameter outside its admissible range.
    pub fn new(p: &Parameters) -> Result<Self, ParamError> {
        Ok(Self {
            config: DriveConfig::new(
                &p.machine,
                &p.inverter,
                &DriveParams { scheme: p.scheme, ..DriveParams::new(&p.machine, &p.inverter) },
            )?,
            scale: Scale::new(&p.machine, p.i_full, p.u_full),
            memory: p.memory(),
        })
    }
}

impl<R: Real + Words> Ready<R> {
    /// What the words hold, and how many they are.
    // Not inlined: so each word is copied once, to where it is kept.
    #[inline(never)]
    fn take(words: &[u32; WORDS]) -> (Self, usize) {
        let mut n = HEAD;
        let mut take = || {
            let word = words.get(n).copied().unwrap_or(0);
            n += 1;
            word
        };
        let (config, scale) = (DriveConfig::take(&mut take), Scale::take(&mut take));
        let memory = Memory::take(&mut take);
        (Self { config, scale, memory }, n)
    }
}

/// A page as it lies in flash.
#[repr(C)]
pub struct Page([u32; WORDS]);

impl Page {
    /// The words of a page, as a linker places them.
    pub const fn new(words: [u32; WORDS]) -> Self {
        Self(words)
    }

    /// The words.
    pub const fn words(&self) -> &[u32; WORDS] {
        &self.0
    }

    /// The page that holds `ready`; none if it is too long for one.
    #[allow(dead_code, reason = "for the host")]
    pub fn seal<R: Real + Words>(ready: &Ready<R>) -> Option<Self> {
        let mut words = [0; WORDS];
        let mut n = HEAD;
        let mut put = |w| {
            if let Some(to) = words.get_mut(n) {
                *to = w;
            }
            n += 1;
        };
        ready.config.put(&mut put);
        ready.scale.put(&mut put);
        ready.memory.put(&mut put);
        (words[0], words[1], words[2], words[3]) = (MAGIC, arithmetic::<R>(), Scheme::BUILT, n as u32);
        words[WORDS - 1] = crc(&words);
        (n < WORDS).then_some(Self(words))
    }

    /// What it holds, if it is whole, of this arithmetic and of a build with the same schemes.
    pub fn open<R: Real + Words>(&self) -> Option<Ready<R>> {
        let words = &self.0;
        let fits = words[0] == MAGIC && words[1] == arithmetic::<R>() && words[2] == Scheme::BUILT;
        if !fits || words[WORDS - 1] != crc(words) {
            return None;
        }
        // Another length is another layout.
        let (ready, n) = Ready::take(words);
        (n as u32 == words[3]).then_some(ready)
    }
}

/// First letters of the arithmetic's name.
fn arithmetic<R: Real>() -> u32 {
    R::NAME.bytes().take(4).fold(0, |word, letter| word << 8 | u32::from(letter))
}
