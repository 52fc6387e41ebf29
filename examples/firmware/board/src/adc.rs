//! ADC1 and ADC2, injected groups in dual mode (RM0440, chapter 21): phases a and b at the carrier's peak, phase c and
//! the dc link one conversion (0.6 µs) later.

use crate::clock::wait_us;
use stillflux::counts::{Converters, Counts, Layout, Resolution};
use stm32_metapac::adc::Adc;
use stm32_metapac::adc::regs::Jsqr;
use stm32_metapac::adc::vals::{Exten, SampleTime};
use stm32_metapac::adccommon::regs::Ccr;
use stm32_metapac::adccommon::vals::{Ckmode, Dual};
use stm32_metapac::gpio::vals::Moder;
use stm32_metapac::{ADC1, ADC2, ADC12_COMMON, GPIOA, RCC};

/// `ALIGN` = 0, no offset by hardware: the simplest choice. The drive reads what is left of the zero itself.
const CONVERTERS: Converters = Converters::new(Layout::Right(Resolution::Twelve));
/// `TIM1_TRGO2` in the table of injected triggers of ADC1 and ADC2.
const TIM1_TRGO2: u8 = 8;
/// Channels: of ADC1 PA0 and PA2, of ADC2 PA1 and PA4.
const FIRST: [u8; 2] = [1, 3];
const SECOND: [u8; 2] = [2, 17];

/// Waits for the triggers of the timer, with the interrupt at the end of each sequence.
pub fn init() {
    RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_adc12en(true);
    });
    let _ = RCC.ahb2enr().read();
    GPIOA.moder().modify(|w| [0, 1, 2, 4].into_iter().for_each(|pin| w.set_moder(pin, Moder::ANALOG)));
    ADC12_COMMON.ccr().write_value(common());
    for adc in [ADC1, ADC2] {
        power_up(adc);
        // 12.5 + 12.5 clocks of 42.5 MHz a conversion.
        adc.smpr().modify(|w| [1, 2, 3].into_iter().for_each(|n| w.set_smp(n, SampleTime::CYCLES12_5)));
        adc.smpr2().modify(|w| w.set_smp(17 - 10, SampleTime::CYCLES12_5));
    }
    ADC1.jsqr().write_value(sequence(FIRST, true));
    ADC2.jsqr().write_value(sequence(SECOND, false));
    ADC1.isr().write(|w| w.set_jeos(true));
    ADC1.ier().modify(|w| w.set_jeosie(true));
    ADC1.cr().modify(|w| w.set_jadstart(true));
}

/// Both from the bus clock by four; ADC2 follows ADC1 in the injected groups.
fn common() -> Ccr {
    let mut w = Ccr::default();
    w.set_ckmode(Ckmode::SYNC_DIV4);
    w.set_dual(Dual::DUAL_J);
    w
}

/// Two conversions. The slave of a pair has no trigger of its own.
fn sequence(channels: [u8; 2], master: bool) -> Jsqr {
    let mut w = Jsqr::default();
    w.set_jl(1);
    if master {
        w.set_jextsel(TIM1_TRGO2);
        w.set_jexten(Exten::RISING_EDGE);
    }
    for (n, channel) in channels.into_iter().enumerate() {
        w.set_jsq(n, channel);
    }
    w
}

/// Regulator, calibration, on.
fn power_up(adc: Adc) {
    adc.cr().modify(|w| w.set_deeppwd(false));
    adc.cr().modify(|w| w.set_advregen(true));
    wait_us(20);
    adc.cr().modify(|w| w.set_adcal(true));
    while adc.cr().read().adcal() {}
    // Four clocks of the converter between calibration and enable.
    wait_us(1);
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().modify(|w| w.set_aden(true));
    while !adc.isr().read().adrdy() {}
}

/// Clears the request of the interrupt.
#[inline(always)]
pub fn acknowledge() {
    ADC1.isr().write(|w| w.set_jeos(true));
}

/// What the sequence has read.
#[inline(always)]
pub fn read() -> Counts {
    let jdr = |adc: Adc, n| adc.jdr(n).read().jdata();
    Counts::from_raw([jdr(ADC1, 0), jdr(ADC2, 0), jdr(ADC1, 1)], jdr(ADC2, 1), &CONVERTERS)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions of the bits as the register maps of RM0440 have them.
    #[test]
    fn registers_hold_what_the_reference_manual_asks_for() {
        assert_eq!(common().0, 5 | 3 << 16, "DUAL = 5, CKMODE = 3");
        assert_eq!(sequence(FIRST, true).0, 1 | 8 << 2 | 1 << 7 | 1 << 9 | 3 << 15, "JL, JEXTSEL, JEXTEN, JSQ1, JSQ2");
        assert_eq!(sequence(SECOND, false).0, 1 | 2 << 9 | 17 << 15);
    }
}
