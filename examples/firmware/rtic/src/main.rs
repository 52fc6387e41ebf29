//! A drive on an STM32G431 with RTIC: the control interrupt is a hardware task of the highest priority, the drive a
//! shared resource, which RTIC locks by priority.
#![no_std]
#![no_main]

#[rtic::app(device = stm32_metapac, peripherals = false)]
mod app {
    use board::{Rounds, clock, flash, watchdog};
    use stillflux::interrupt::CountsDrive;

    #[shared]
    struct Shared {
        drive: CountsDrive<f32>,
    }

    #[local]
    struct Local {
        rounds: Rounds,
    }

    #[init]
    fn init(_: init::Context) -> (Shared, Local) {
        clock::init();
        let mut drive = flash::load().map_or(CountsDrive::empty(), |parameters| CountsDrive::new(&parameters));
        if board::start(&drive).is_ok() {
            watchdog::start();
        } else {
            // Without parameters, or without the right timing, the bridge stays blocked.
            drive = CountsDrive::empty();
        }
        (Shared { drive }, Local { rounds: Rounds::new() })
    }

    /// The control interrupt.
    #[task(binds = ADC1_2, priority = 15, shared = [drive])]
    fn control(mut cx: control::Context) {
        cx.shared.drive.lock(board::control);
    }

    /// Wakes with each control interrupt.
    #[idle(shared = [drive], local = [rounds])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            cortex_m::asm::wfi();
            let telemetry = cx.shared.drive.lock(|drive| {
                board::reset(drive);
                drive.telemetry()
            });
            if cx.local.rounds.round(telemetry) {
                let memory = cx.shared.drive.lock(|drive| drive.drive().map(|d| d.memory()));
                // One that fails leaves the other slot: the next start has older values.
                let _ = memory.map(|memory| flash::store(&memory));
            }
        }
    }
}
