//! The parameter page: a drive's configuration, the scaling of its converters and what it remembers, as they lie in
//! flash, ready to use.
//!
//! | word | content |
//! |---|---|
//! | 0 | magic `sfr3` |
//! | 1 | arithmetic |
//! | 2 | schemes and features of the build ([`Scheme::FEATURES`]) |
//! | 3 | hash of the layout ([`Words::LAYOUT`]) |
//! | 4 | number of words in use, with these five |
//! | 5 … | configuration, scale, units, memory as [`Words`] |
//! | 383 | CRC-32 (IEEE 802.3) of all before it |
//!
//! A host computes a page ([`Ready::new`], [`Page::seal`]): validated, in double precision. [`Page::open`] on the
//! target computes the inverter's curve from its constants, no more, and refuses a page that is torn, of another
//! arithmetic, of other schemes or features, or of another version of this crate whose fields lie differently.
//! [`Page::with_memory`] is what a target stores after a stop.

use crate::config::{DriveConfig, DriveParams, Scheme};
use crate::counts::Scale;
use crate::drive::Memory;
use crate::params::{Inverter, Machine, ParamError};
use crate::scalar::Real;
use crate::si::{MemorySi, SiUnits};
use crate::telemetry::Units;
use crate::words::{Words, words};

/// `sfr3`.
const MAGIC: u32 = 0x3372_6673;
/// Words before the content.
const HEAD: usize = 5;
/// Words of a page, 1.5 KiB: enough for every feature, and with the number of its writing within a flash page of 2 KiB.
pub const WORDS: usize = 384;

/// What an image needs to know, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ready<R: Real> {
    /// Of the drive.
    pub config: DriveConfig<R>,
    /// Of the converters.
    pub scale: Scale<R>,
    /// For set points and telemetry.
    pub units: Units,
    /// What the drive takes back.
    pub memory: Memory<R>,
}
words!(Ready: config, scale, units, memory);

impl<R: Real> Ready<R> {
    /// From SI values. `full`: full scale of the current channels in A and of the dc-link channel in V.
    ///
    /// # Errors
    /// The first parameter or stored value outside its admissible range.
    pub fn new(
        machine: &Machine,
        inverter: &Inverter,
        params: &DriveParams,
        full: (f64, f64),
        memory: &MemorySi,
    ) -> Result<Self, ParamError> {
        let config = DriveConfig::new(machine, inverter, params)?;
        memory.validate(machine, inverter)?;
        Ok(Self {
            config,
            scale: Scale::new(machine, params, full.0, full.1)?,
            units: Units::new(machine),
            memory: SiUnits::new(machine, inverter).memory_per_unit(memory),
        })
    }

    /// What the words hold.
    fn from_words(words: &[u32; WORDS]) -> Self {
        let mut ready = Self::BLANK;
        ready.read(words);
        ready
    }

    // Not inlined: each word is then copied once, to where it is kept. Of a value of its own the compiler would first
    // gather all of them.
    #[inline(never)]
    fn read(&mut self, words: &[u32; WORDS]) {
        let mut n = HEAD;
        self.fill(&mut || {
            let word = words.get(n).copied().unwrap_or(0);
            n += 1;
            word
        });
    }
}

/// A page as it lies in flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Page([u32; WORDS]);

impl Page {
    /// The words of a page, as a linker places them.
    #[must_use]
    pub const fn new(words: [u32; WORDS]) -> Self {
        Self(words)
    }

    /// The words.
    #[must_use]
    pub const fn words(&self) -> &[u32; WORDS] {
        &self.0
    }

    /// First words of a page for this arithmetic and build.
    const fn head<R: Real>() -> [u32; HEAD] {
        const {
            assert!(
                HEAD + Ready::<R>::LEN < WORDS,
                "a configuration is too long for a page, which holds those of f32 and Q"
            )
        };
        [MAGIC, arithmetic::<R>(), Scheme::FEATURES, Ready::<R>::LAYOUT, (HEAD + Ready::<R>::LEN) as u32]
    }

    /// The page that holds `ready`, of `f32` or `Q`: a configuration in `f64` is too long, which the compiler says.
    #[must_use]
    pub fn seal<R: Real>(ready: &Ready<R>) -> Self {
        let mut words = [0; WORDS];
        let (head, rest) = words.split_at_mut(HEAD);
        head.copy_from_slice(&Self::head::<R>());
        let mut rest = rest.iter_mut();
        ready.put(&mut |word| {
            if let Some(to) = rest.next() {
                *to = word;
            }
        });
        words[WORDS - 1] = crc(&words);
        Self(words)
    }

    /// The same parameters with what a drive has learned, if the page is whole and of this build.
    #[must_use]
    pub fn with_memory<R: Real>(&self, memory: &Memory<R>) -> Option<Self> {
        self.open::<R>().map(|ready| Self::seal(&Ready { memory: *memory, ..ready }))
    }

    /// What it holds, if it is whole and of this build.
    #[must_use]
    pub fn open<R: Real>(&self) -> Option<Ready<R>> {
        let words = &self.0;
        let fits = words.iter().zip(Self::head::<R>()).all(|(word, head)| *word == head);
        (fits && words[WORDS - 1] == crc(words)).then(|| Ready::from_words(words))
    }
}

/// First letters of the arithmetic's name.
const fn arithmetic<R: Real>() -> u32 {
    let (name, mut word, mut k) = (R::NAME.as_bytes(), 0, 0);
    while k < name.len() && k < 4 {
        word = word << 8 | name[k] as u32;
        k += 1;
    }
    word
}

/// CRC-32 (IEEE 802.3) of all words but the last.
#[must_use]
pub const fn crc(words: &[u32]) -> u32 {
    let mut crc = u32::MAX;
    let mut k = 0;
    while k + 1 < words.len() {
        crc ^= words[k];
        let mut bit = 0;
        while bit < 32 {
            // Opaque: a compiler that sees what this is makes a table of 1 KiB of it.
            crc = core::hint::black_box(crc);
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
            bit += 1;
        }
        k += 1;
    }
    !crc
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Q;

    fn ready<R: Real>(scheme: Scheme) -> Ready<R> {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let params = DriveParams { scheme, ..DriveParams::new(&machine, &inverter) };
        let memory = MemorySi { u_off: [0.05, -0.03], ..MemorySi::of(&machine, &inverter) };
        Ready::new(&machine, &inverter, &params, (20.0, 810.0), &memory).unwrap()
    }

    /// The page with one word changed and its check made right again.
    fn changed(page: &Page, at: usize, to: impl Fn(u32) -> u32) -> Page {
        let mut words = page.0;
        words[at] = to(words[at]);
        words[WORDS - 1] = crc(&words);
        Page(words)
    }

    fn comes_back<R: Real>() {
        for &scheme in Scheme::ALL {
            let ready = ready::<R>(scheme);
            assert_eq!(Page::seal(&ready).open::<R>(), Some(ready));
        }
    }

    #[test]
    fn a_page_comes_back_as_it_was_sealed() {
        comes_back::<f32>();
        comes_back::<Q>();
    }

    #[test]
    fn a_memory_that_no_drive_has_is_refused_by_its_value() {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let (params, right) = (DriveParams::new(&machine, &inverter), MemorySi::of(&machine, &inverter));
        let blank = MemorySi {
            u_off: [0.0; 2],
            R_s: 0.0,
            i_off: [0.0; 3],
            loss_error: 0.0,
            knee: 0.0,
            L_sigma: 0.0,
            L_M: 0.0,
            leg_delay: [[0.0; 2]; 3],
        };
        for (memory, field) in [
            (blank, "memory R_s"),
            (MemorySi { knee: 0.0, ..right }, "memory knee"),
            (MemorySi { i_off: [0.0, f64::NAN, 0.0], ..right }, "memory i_off"),
            (MemorySi { L_M: -0.2, ..right }, "memory L_M"),
            (MemorySi::of(&Machine::preset_11k(), &Inverter::preset_11k()), "memory R_s"),
            (MemorySi { R_s: 2.01 * right.R_s, ..right }, "memory R_s"),
            (MemorySi { L_sigma: 0.49 * right.L_sigma, ..right }, "memory L_sigma"),
            (MemorySi { L_M: 1.68 * right.L_M, ..right }, "memory L_M"),
        ] {
            let error = Ready::<f32>::new(&machine, &inverter, &params, (20.0, 810.0), &memory).unwrap_err();
            assert_eq!(error.field, field);
        }
    }

    #[test]
    fn what_a_drive_has_learned_replaces_the_memory_alone() {
        let was = ready::<f32>(Scheme::default());
        let memory = Memory { r_s: 0.07, ..was.memory };
        let page = Page::seal(&was).with_memory(&memory).unwrap();
        assert_eq!(page.open::<f32>(), Some(Ready { memory, ..was }));
        assert_ne!(memory, was.memory);
        assert!(Page([0; WORDS]).with_memory(&memory).is_none(), "torn");
    }

    #[test]
    fn a_page_of_another_image_is_refused() {
        let page = Page::seal(&ready::<f32>(Scheme::default()));
        assert!(page.open::<Q>().is_none(), "arithmetic");
        for bit in 0..u32::BITS {
            let other = changed(&page, 2, |built| built ^ 1 << bit);
            assert!(other.open::<f32>().is_none(), "features, bit {bit}");
        }
        assert!(changed(&page, 2, |built| built).open::<f32>().is_some());
        assert!(changed(&page, 0, |w| w ^ 1).open::<f32>().is_none(), "magic");
        assert!(changed(&page, 3, |w| w ^ 1).open::<f32>().is_none(), "layout");
        assert!(changed(&page, 4, |n| n - 1).open::<f32>().is_none(), "length");
        assert!(changed(&page, 4, |n| n).open::<f32>().is_some());
    }

    #[test]
    fn a_page_with_any_one_bit_wrong_is_refused() {
        let page = Page::seal(&ready::<f32>(Scheme::default()));
        for at in 0..WORDS {
            for bit in [0, 7, 31] {
                let mut torn = page.0;
                torn[at] ^= 1 << bit;
                assert!(Page(torn).open::<f32>().is_none(), "{at} {bit}");
            }
        }
        assert!(Page([0; WORDS]).open::<f32>().is_none() && Page([u32::MAX; WORDS]).open::<f32>().is_none());
    }
}
