//! The independent watchdog: 0.1 s, longer than the erasure of a page of flash.

use stm32_metapac::IWDG;
use stm32_metapac::iwdg::vals::Pr;

/// 32 kHz / 16 = 2 kHz.
const RELOAD: u16 = 200;

/// Cannot be stopped any more.
pub fn start() {
    IWDG.kr().write(|w| w.0 = 0xCCCC);
    IWDG.kr().write(|w| w.0 = 0x5555);
    IWDG.pr().write(|w| w.set_pr(Pr::DIVIDE_BY16));
    IWDG.rlr().write(|w| w.set_rl(RELOAD));
    while IWDG.sr().read().0 != 0 {}
    feed();
}

/// From the main loop alone, and only when the control interrupt has run.
pub fn feed() {
    IWDG.kr().write(|w| w.0 = 0xAAAA);
}
