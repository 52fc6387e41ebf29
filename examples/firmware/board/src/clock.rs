//! 170 MHz from the internal oscillator: 16 MHz / 4 × 85 / 2, range 1 boost (RM0440, 6.1.5 and 7.2).

use stm32_metapac::flash::vals::Latency;
use stm32_metapac::rcc::vals::{Hpre, Pllm, Plln, Pllr, Pllsrc, Sw};
use stm32_metapac::{FLASH, PWR, RCC};

/// Hz.
pub const HCLK: u32 = 170_000_000;

/// Out of reset.
pub fn init() {
    RCC.apb1enr1().modify(|w| w.set_pwren(true));
    // Boost before the higher frequency, and half of it for the first microsecond.
    PWR.cr5().modify(|w| w.set_r1mode(false));
    FLASH.acr().modify(|w| {
        w.set_latency(Latency::WS4);
        w.set_prften(true);
        w.set_icen(true);
        w.set_dcen(true);
    });
    while FLASH.acr().read().latency() != Latency::WS4 {}
    RCC.pllcfgr().modify(|w| {
        w.set_pllsrc(Pllsrc::HSI);
        w.set_pllm(Pllm::DIV4);
        w.set_plln(Plln::MUL85);
        w.set_pllr(Pllr::DIV2);
        w.set_pllren(true);
    });
    RCC.cr().modify(|w| w.set_pllon(true));
    while !RCC.cr().read().pllrdy() {}
    RCC.cfgr().modify(|w| {
        w.set_hpre(Hpre::DIV2);
        w.set_sw(Sw::PLL1_R);
    });
    while RCC.cfgr().read().sws() != Sw::PLL1_R {}
    wait_us(1);
    RCC.cfgr().modify(|w| w.set_hpre(Hpre::DIV1));
}

/// At least so long.
pub fn wait_us(time: u32) {
    cortex_m::asm::delay(time * (HCLK / 1_000_000));
}
