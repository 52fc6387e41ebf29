//! What the drive is to do, and what it does, for whoever talks to the outside: a field bus, a serial line, a debugger
//! that finds `MAILBOX` by its name.

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};
use cortex_m::interrupt::Mutex;
use stillflux::telemetry::{SetPoint, Telemetry};

/// The mailbox.
#[repr(C)]
pub struct Mailbox {
    /// 0 stop, 1 speed, 2 torque. Written after the value.
    pub kind: AtomicU32,
    /// Mechanical speed in rad/s or torque in N m, the bits of an `f32`.
    pub value: AtomicU32,
    /// Not 0: leave a fault or a trip of the hardware. Taken back when it has been done.
    pub reset: AtomicU32,
    /// State and estimates, every 10 ms.
    telemetry: Mutex<Cell<Telemetry>>,
}

/// Used from outside, whatever the image itself does with it.
#[used]
#[unsafe(no_mangle)]
pub static MAILBOX: Mailbox = Mailbox {
    kind: AtomicU32::new(0),
    value: AtomicU32::new(0),
    reset: AtomicU32::new(0),
    telemetry: Mutex::new(Cell::new(Telemetry::ZERO)),
};

impl Mailbox {
    /// What the drive is to do.
    #[inline(always)]
    pub fn set_point(&self) -> SetPoint {
        let kind = self.kind.load(Relaxed);
        let value = f32::from_bits(self.value.load(Relaxed));
        match kind {
            1 => SetPoint::Speed(value),
            2 => SetPoint::Torque(value),
            _ => SetPoint::Stop,
        }
    }

    /// Publishes what the drive does.
    pub fn publish(&self, telemetry: Telemetry) {
        cortex_m::interrupt::free(|cs| self.telemetry.borrow(cs).set(telemetry));
    }

    /// What was published last.
    pub fn telemetry(&self) -> Telemetry {
        cortex_m::interrupt::free(|cs| self.telemetry.borrow(cs).get())
    }

    /// Whether a reset is asked for; it is taken back, and the set point is a stop then.
    pub fn take_reset(&self) -> bool {
        let asked = self.reset.load(Relaxed) != 0;
        if asked {
            self.kind.store(0, Relaxed);
            self.reset.store(0, Relaxed);
        }
        asked
    }
}
