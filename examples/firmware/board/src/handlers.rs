//! What ends the program: bridge off, then the watchdog.

use crate::{flash, pwm};
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};

/// Bridge off for good: without parameters, without the right timing, after an error of the program.
pub fn stay_blocked() -> ! {
    loop {
        pwm::block();
        cortex_m::asm::wfi();
    }
}

/// A double word of the parameters that is torn reads so: their check refuses it. All else is an end.
#[exception]
unsafe fn NonMaskableInt() {
    if !flash::acknowledge_torn() {
        stay_blocked();
    }
}

#[exception]
unsafe fn HardFault(_: &ExceptionFrame) -> ! {
    stay_blocked()
}

/// Nothing of the control interrupt can get here.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    stay_blocked()
}
