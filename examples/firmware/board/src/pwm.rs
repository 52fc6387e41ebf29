//! TIM1: three complementary pairs with dead time and break input, centre-aligned, one update per carrier period, at the
//! peak (RM0440, chapter 29).
//!
//! PWM mode 1: a leg's upper switch is on while `CNT < CCR`, so the upper switches are on around the valley, the lower
//! ones around the peak. `CCR` = 0 is a duty of exactly 0, `CCR` = `ARR` of exactly 1.

use crate::machine;
use stillflux::interrupt::Command;
use stm32_metapac::gpio::Gpio;
use stm32_metapac::gpio::vals::{Moder, Ospeedr, Pupdr};
use stm32_metapac::timer::regs::{BdtrAdv, CcerAdv, CcmrOutputGp16, Cr1Gp16, Cr2Adv, SmcrGp16, SrAdv};
use stm32_metapac::timer::vals::{Bkp, Cms, Dir, FilterValue, Lock, Mms, Mms2, Ocm, Ossi, Ossr, Sms, Ts};
use stm32_metapac::{GPIOA, GPIOB, RCC, TIM1, TIM3};

const DEAD_TIME: u8 = machine::dead_time(machine::DEAD_TIME * machine::F_CLK).0;

/// Pins and timer, bridge blocked, counter at rest.
pub fn init(reload: u16) {
    RCC.ahb2enr().modify(|w| {
        w.set_gpioaen(true);
        w.set_gpioben(true);
    });
    RCC.apb2enr().modify(|w| w.set_tim1en(true));
    RCC.apb1enr1().modify(|w| w.set_tim3en(true));
    let _ = RCC.apb1enr1().read();

    TIM1.cr1().write_value(carrier());
    TIM1.psc().write_value(0);
    TIM1.arr().write(|w| w.set_arr(reload));
    TIM1.rcr().write(|w| w.set_rep(0));
    TIM1.ccmr_output(0).write_value(pair_of_channels());
    TIM1.ccmr_output(1).write_value(pair_of_channels());
    TIM1.ccer().write_value(outputs());
    TIM1.af1().write(|w| w.set_bkine(true));
    // The dead time and the break input are locked from here on, until a reset.
    TIM1.bdtr().write_value(protection(DEAD_TIME));
    TIM1.cr2().write_value(triggers());
    // TIM3 counts the updates of TIM1.
    TIM3.smcr().write_value(count_updates());
    TIM3.arr().write(|w| w.set_arr(u16::MAX));
    TIM3.cr1().modify(|w| w.set_cen(true));

    for pin in [8, 9, 10] {
        alternate(GPIOA, pin, 6);
    }
    alternate(GPIOB, 13, 6);
    alternate(GPIOB, 14, 6);
    alternate(GPIOB, 15, 4);
    // A wire that is broken blocks the bridge.
    GPIOB.pupdr().modify(|w| w.set_pupdr(12, Pupdr::PULL_DOWN));
    alternate(GPIOB, 12, 6);
}

fn alternate(port: Gpio, pin: usize, function: u8) {
    port.afr(pin / 8).modify(|w| w.set_afr(pin % 8, function));
    port.ospeedr().modify(|w| w.set_ospeedr(pin, Ospeedr::HIGH_SPEED));
    port.moder().modify(|w| w.set_moder(pin, Moder::ALTERNATE));
}

/// Centre-aligned, reload value preloaded.
fn carrier() -> Cr1Gp16 {
    let mut w = Cr1Gp16::default();
    w.set_cms(Cms::CENTER_ALIGNED1);
    w.set_arpe(true);
    w
}

/// PWM mode 1, compare values preloaded.
fn pair_of_channels() -> CcmrOutputGp16 {
    let mut w = CcmrOutputGp16::default();
    for n in 0..2 {
        w.set_ocm(n, Ocm::PWM_MODE1);
        w.set_ocpe(n, true);
    }
    w
}

/// Upper and lower switch of three legs, active high.
fn outputs() -> CcerAdv {
    let mut w = CcerAdv::default();
    for n in 0..3 {
        w.set_cce(n, true);
        w.set_ccne(n, true);
    }
    w
}

/// Off means driven low, not floating. The break input is active low, filtered over 8 clocks (47 ns), and does not end by
/// itself (`AOE` = 0).
fn protection(dead_time: u8) -> BdtrAdv {
    let mut w = BdtrAdv::default();
    w.set_dtg(dead_time);
    w.set_ossi(Ossi::IDLE_LEVEL);
    w.set_ossr(Ossr::IDLE_LEVEL);
    w.set_bke(0, true);
    w.set_bkp(0, Bkp::ACTIVE_LOW);
    w.set_bkf(0, FilterValue::FCK_INT_N8);
    w.set_lock(Lock::LEVEL1);
    w
}

/// The update event triggers the converters (`TRGO2`) and TIM3 (`TRGO`). Idle outputs are low.
fn triggers() -> Cr2Adv {
    let mut w = Cr2Adv::default();
    w.set_mms(Mms::UPDATE);
    w.set_mms2(Mms2::UPDATE);
    w
}

/// External clock mode 1 on `ITR0`, which is TIM1's `TRGO`.
fn count_updates() -> SmcrGp16 {
    let mut w = SmcrGp16::default();
    w.set_ts(Ts::ITR0);
    w.set_sms(Sms::EXT_CLOCK_MODE);
    w
}

/// Starts the carrier, bridge still blocked.
///
/// # Errors
/// The update does not come at the peak: currents would be sampled and duties changed at the wrong instant.
pub fn start() -> Result<(), &'static str> {
    // Which extreme an odd repetition counter updates at depends on when it is written. It counts down from what the
    // last update loaded: 0 until the first peak, 1 from there on.
    TIM1.egr().write(|w| w.set_ug(true));
    TIM1.sr().write_value(SrAdv(0));
    cortex_m::interrupt::free(|_| {
        TIM1.cr1().modify(|w| w.set_cen(true));
        TIM1.rcr().write(|w| w.set_rep(1));
    });
    // Beyond the peak the counter counts down. The second update shows that the repetition counter works.
    for _ in 0..2 {
        while !TIM1.sr().read().uif() {}
        if TIM1.cr1().read().dir() != Dir::DOWN {
            return Err("the carrier updates at its valley");
        }
        TIM1.sr().write_value(SrAdv(!1));
    }
    Ok(())
}

/// Number of the carrier period.
#[inline(always)]
pub fn stamp() -> u16 {
    TIM3.cnt().read().cnt()
}

/// Preloads the compare values; bridge on or off at once.
#[inline(always)]
pub fn command(command: &Command) {
    for (n, compare) in command.compare.into_iter().enumerate() {
        TIM1.ccr(n).write(|w| w.set_ccr(compare as u16));
    }
    let on = TIM1.bdtr().read().moe();
    if on != command.gates_on && !(command.gates_on && is_tripped()) {
        TIM1.bdtr().modify(|w| w.set_moe(command.gates_on));
    }
}

/// Whether hardware has blocked the bridge since [`acknowledge_trip`].
#[inline(always)]
pub fn is_tripped() -> bool {
    TIM1.sr().read().bif(0)
}

/// Lets the bridge be switched on again. For the application, after it has looked at the cause.
pub fn acknowledge_trip() {
    TIM1.sr().write_value(SrAdv(!(1 << 7)));
}

/// Bridge off, from any context: for the handlers of panics and faults.
pub fn block() {
    TIM1.bdtr().modify(|w| w.set_moe(false));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::dead_time;

    /// Positions of the bits as the register maps of RM0440 have them.
    #[test]
    fn registers_hold_what_the_reference_manual_asks_for() {
        assert_eq!(carrier().0, 1 << 5 | 1 << 7, "CMS = 1, ARPE");
        assert_eq!(pair_of_channels().0, 6 << 4 | 1 << 3 | 6 << 12 | 1 << 11, "OCxM = 6, OCxPE");
        assert_eq!(outputs().0, 0b0101_0101_0101, "CCxE, CCxNE");
        assert_eq!(protection(0xD5).0, 0xD5 | 1 << 8 | 3 << 10 | 1 << 12 | 3 << 16, "DTG, LOCK, OSSx, BKE, BKF");
        assert_eq!(triggers().0, 2 << 4 | 2 << 20, "MMS = MMS2 = update");
        assert_eq!(count_updates().0, 7, "SMS = 7, TS = ITR0");
    }

    /// `DTG[7:5]`: 0xx counts clocks, 10x pairs from 64 on, 110 eights and 111 sixteens from 32 on.
    #[test]
    fn a_dead_time_is_at_least_what_was_asked_for_and_less_than_a_step_more() {
        for n in 0..=1008_u32 {
            let (dtg, clocks) = dead_time(f64::from(n));
            let d = u32::from(dtg);
            let (made, step) = match d >> 5 {
                0..4 => (d, 1),
                4 | 5 => ((64 + (d & 63)) * 2, 2),
                6 => ((32 + (d & 31)) * 8, 8),
                _ => ((32 + (d & 31)) * 16, 16),
            };
            assert_eq!(made, clocks);
            assert!(clocks >= n && clocks < n + step, "{n}: {clocks}");
        }
        assert_eq!(dead_time(2e-6 * 170e6), (0xC0 | 11, 344));
    }
}
