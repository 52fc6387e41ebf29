//! A drive on an STM32G431 with registers, one interrupt and a main loop.
//!
//! The interrupt of the converters runs the drive; the main loop feeds the watchdog, publishes telemetry, and stores what
//! the drive has learned after a stop. Whatever talks to the outside writes and reads [`board::MAILBOX`].
#![no_std]
#![no_main]

use core::cell::RefCell;

use board::handlers::stay_blocked;
use board::{Rounds, clock, flash, watchdog};
use critical_section::Mutex;
use stillflux::interrupt::CountsDrive;
use stm32_metapac::{Interrupt, interrupt};

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

#[cortex_m_rt::entry]
fn main() -> ! {
    clock::init();
    let Some(parameters) = flash::load() else { stay_blocked() };
    let drive = CountsDrive::new(&parameters);
    if board::start(&drive).is_err() {
        stay_blocked();
    }
    critical_section::with(|cs| *DRIVE.borrow_ref_mut(cs) = drive);
    // SAFETY: all that the interrupt uses is there; no mask is relied on.
    unsafe { cortex_m::peripheral::NVIC::unmask(Interrupt::ADC1_2) };
    watchdog::start();

    let mut rounds = Rounds::new();
    loop {
        cortex_m::asm::wfi();
        let telemetry = critical_section::with(|cs| {
            let mut drive = DRIVE.borrow_ref_mut(cs);
            board::reset(&mut drive);
            drive.telemetry()
        });
        if rounds.round(telemetry) {
            let memory = critical_section::with(|cs| DRIVE.borrow_ref(cs).drive().map(|d| d.memory()));
            // One that fails leaves the other slot: the next start has older values.
            let _ = memory.map(|memory| flash::store(&memory));
        }
    }
}
