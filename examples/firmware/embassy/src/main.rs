//! A drive on an STM32G431 with embassy: the control interrupt stays one, of the highest priority; everything else is a
//! task. TIM1, TIM3, ADC1 and ADC2 are the board's, all other peripherals embassy's.
#![no_std]
#![no_main]

use board::{Rounds, flash, watchdog};
use core::cell::RefCell;
use critical_section::Mutex;
use embassy_executor::Spawner;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::pac::interrupt;
use embassy_stm32::rcc::{Pll, PllMul, PllPreDiv, PllRDiv, PllSource, Sysclk};
use embassy_time::{Duration, Ticker};
use stillflux::interrupt::CountsDrive;

/// The drive; it blocks the bridge until the parameters are read.
static DRIVE: Mutex<RefCell<CountsDrive<f32>>> = Mutex::new(RefCell::new(CountsDrive::empty()));

#[interrupt]
fn ADC1_2() {
    critical_section::with(|cs| {
        // Never taken twice; a check that fails would panic.
        if let Ok(mut drive) = DRIVE.borrow(cs).try_borrow_mut() {
            board::control(&mut drive);
        }
    });
}

/// Access to the drive, for tasks.
fn drive<T>(f: impl FnOnce(&mut CountsDrive<f32>) -> T) -> T {
    critical_section::with(|cs| f(&mut DRIVE.borrow_ref_mut(cs)))
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let mut config = embassy_stm32::Config::default();
    config.rcc.hsi = true;
    config.rcc.pll = Some(Pll {
        source: PllSource::HSI,
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL85,
        divp: None,
        divq: None,
        divr: Some(PllRDiv::DIV2),
    });
    config.rcc.sys = Sysclk::PLL1_R;
    config.rcc.boost = true;
    let _peripherals = embassy_stm32::init(config);

    let loaded = flash::load().map_or(CountsDrive::empty(), |parameters| CountsDrive::new(&parameters));
    if board::start(&loaded).is_err() {
        // Without parameters, or without the right timing, the bridge stays blocked.
        return;
    }
    drive(|d| *d = loaded);
    // Nothing comes before the control interrupt, the time of embassy neither.
    embassy_stm32::interrupt::TIM2.set_priority(Priority::P6);
    embassy_stm32::interrupt::ADC1_2.set_priority(Priority::P0);
    // SAFETY: all that the interrupt uses is there; no mask is relied on.
    unsafe { embassy_stm32::interrupt::ADC1_2.enable() };
    watchdog::start();
    if let Ok(task) = supervise() {
        spawner.spawn(task);
    }
}

/// Watchdog, telemetry, resets, and after a run what is to be kept over a loss of supply.
#[embassy_executor::task]
async fn supervise() {
    let (mut rounds, mut ticker) = (Rounds::new(), Ticker::every(Duration::from_millis(5)));
    loop {
        ticker.next().await;
        let telemetry = drive(|d| {
            board::reset(d);
            d.telemetry()
        });
        if rounds.round(telemetry) {
            let memory = drive(|d| d.drive().map(|d| d.memory()));
            // One that fails leaves the other slot: the next start has older values.
            let _ = memory.map(|memory| flash::store(&memory));
        }
    }
}
