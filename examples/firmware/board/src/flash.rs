//! Two slots of flash for parameter pages, written in turn: a loss of supply while one is written leaves the other whole
//! (RM0440, chapter 3; pages of 2 KiB, double words of 64 bits).

use stillflux::drive::Memory;
use stillflux::page::{Page, Ready, WORDS};
use stm32_metapac::FLASH;

/// A page, then the number of its writing, which is written last: erased, it is `u32::MAX` and the slot is not valid.
#[repr(C, align(8))]
struct Slot {
    page: Page,
    number: u32,
    _end: u32,
}

/// Begin of the flash, and its pages.
const FLASH_BASE: usize = 0x0800_0000;
const PAGE_BYTES: usize = 2048;
/// As `memory.x` has it.
const SLOTS: [usize; 2] = [0x0801_F000, 0x0801_F800];

/// The page that comes with the image.
#[unsafe(link_section = ".parameters")]
#[used]
static PRESET: Slot =
    Slot { page: Page::new(include!(concat!(env!("OUT_DIR"), "/page.rs"))), number: 0, _end: u32::MAX };

fn slot(k: usize) -> &'static Slot {
    // SAFETY: flash that is always there; it changes in `store` only, while no reference to it lives.
    unsafe { &*(SLOTS[k] as *const Slot) }
}

/// The slot that was written last among those that are whole, and what it holds.
fn latest() -> Option<(usize, Ready<f32>)> {
    let of = |k: usize| {
        let s = slot(k);
        if s.number == u32::MAX { None } else { s.page.open::<f32>().map(|ready| (k, s.number, ready)) }
    };
    match (of(0), of(1)) {
        (Some(a), Some(b)) => Some(if b.1 > a.1 { b } else { a }),
        (a, b) => a.or(b),
    }
    .map(|(k, _, ready)| (k, ready))
}

/// Parameters and memory of the drive; nothing if no slot is whole and of this build.
pub fn load() -> Option<Ready<f32>> {
    latest().map(|(_, ready)| ready)
}

/// Writes what a drive has learned into the other slot. After a stop only: the processor stands for some 20 ms.
///
/// # Errors
/// Nothing to start from, or flash that cannot be written.
pub fn store(memory: &Memory<f32>) -> Result<(), &'static str> {
    let (from, _) = latest().ok_or("no parameters")?;
    let page = slot(from).page.with_memory(memory).ok_or("no parameters")?;
    let number = slot(from).number.wrapping_add(1);
    let to = SLOTS[1 - from];
    while FLASH.sr().read().bsy() {}
    FLASH.keyr().write_value(0x4567_0123);
    FLASH.keyr().write_value(0xCDEF_89AB);
    let done = cortex_m::interrupt::free(|_| {
        erase(to);
        let words: &[u32; WORDS] = page.words();
        words.as_chunks::<2>().0.iter().enumerate().for_each(|(k, pair)| program(to + 8 * k, *pair));
        program(to + 4 * WORDS, [number, u32::MAX]);
        !failed()
    });
    FLASH.cr().modify(|w| w.set_lock(true));
    // What was read from there before is in the data cache.
    FLASH.acr().modify(|w| w.set_dcen(false));
    FLASH.acr().modify(|w| w.set_dcrst(true));
    FLASH.acr().modify(|w| w.set_dcrst(false));
    FLASH.acr().modify(|w| w.set_dcen(true));
    if done && slot(1 - from).number == number && slot(1 - from).page == page { Ok(()) } else { Err("flash") }
}

/// Clears the flags of earlier errors and erases a page.
fn erase(address: usize) {
    FLASH.sr().write(|w| w.0 = ERRORS);
    FLASH.cr().modify(|w| {
        w.set_per(true);
        w.set_pnb(((address - FLASH_BASE) / PAGE_BYTES) as u8);
    });
    FLASH.cr().modify(|w| w.set_strt(true));
    while FLASH.sr().read().bsy() {}
    FLASH.cr().modify(|w| w.set_per(false));
}

/// Writes a double word, lower half first.
fn program(address: usize, [low, high]: [u32; 2]) {
    if failed() {
        return;
    }
    FLASH.cr().modify(|w| w.set_pg(true));
    // SAFETY: an erased double word of a slot, and `PG` is set.
    unsafe {
        (address as *mut u32).write_volatile(low);
        cortex_m::asm::isb();
        ((address + 4) as *mut u32).write_volatile(high);
    }
    while FLASH.sr().read().bsy() {}
    FLASH.cr().modify(|w| w.set_pg(false));
}

/// `OPERR`, `PROGERR`, `WRPERR`, `PGAERR`, `SIZERR`, `PGSERR`, `MISERR`, `FASTERR`.
const ERRORS: u32 = 0x3FA;

fn failed() -> bool {
    FLASH.sr().read().0 & ERRORS != 0
}

/// For the handler of the non-maskable interrupt: a double word that a loss of supply left half written reads with two
/// wrong bits. Whether that was its cause; the page's check refuses what was read.
pub fn acknowledge_torn() -> bool {
    let torn = FLASH.eccr().read().eccd();
    if torn {
        FLASH.eccr().modify(|w| w.set_eccd(true));
    }
    torn
}
