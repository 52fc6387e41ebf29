//! An inverter on an STM32G431, as the three images of this folder share it. Peripherals by their registers (names of
//! RM0440), whatever framework runs the interrupts:
//!
//! ```text
//! TIM1, peak of the carrier ─┬─ update: CCR1…3 take effect
//!                            ├─ TRGO2: ADC1 and ADC2 sample, simultaneously
//!                            └─ TRGO: TIM3 counts periods
//! ADC1, end of sequence ─ interrupt: [`control`]
//! PB12 low: TIM1 blocks the bridge, without software
//! ```
//!
//! | pin | what |
//! |---|---|
//! | PA8, PA9, PA10 | upper switches of legs a, b, c, active high |
//! | PB13, PB14, PB15 | lower switches |
//! | PB12 | over-current comparator, active low |
//! | PA0, PA1, PA2 | currents of phases a, b, c |
//! | PA4 | dc link |
#![no_std]

pub mod adc;
pub mod clock;
pub mod flash;
#[cfg(target_os = "none")]
pub mod handlers;
pub mod machine;
pub mod mailbox;
pub mod pwm;
pub mod watchdog;

use stillflux::drive::Status;
use stillflux::interrupt::CountsDrive;
use stillflux::telemetry::{SetPoint, Telemetry};

pub use mailbox::MAILBOX;

/// Content of the control interrupt: readings in, one period of the drive, compare values out.
#[inline(always)]
pub fn control(drive: &mut CountsDrive<f32>) {
    adc::acknowledge();
    let counts = adc::read();
    // Hardware has blocked the bridge: the drive has to know, or it would control a current that cannot flow.
    let set_point = if pwm::is_tripped() { SetPoint::Stop } else { MAILBOX.set_point() };
    if let Some(command) = drive.period_at(pwm::stamp(), &counts, &set_point) {
        pwm::command(&command);
    }
}

/// Converters and timer, with the bridge blocked and the interrupt of the converters requested but not yet unmasked.
///
/// # Errors
/// The timer does not update at the carrier's peak, or the drive is for another carrier: the bridge stays blocked.
pub fn start(drive: &CountsDrive<f32>) -> Result<(), &'static str> {
    let full = drive.timer().map_or(0, stillflux::scalar::Timer::full);
    let reload = u16::try_from(full).map_err(|_| "reload value beyond 16 bits")?;
    if reload == 0 {
        return Err("no parameters");
    }
    pwm::init(reload);
    adc::init();
    pwm::start()
}

/// Control periods between two rounds of the application: 10 ms.
pub const ROUND: u32 = 100;

/// Stator frequency, rad/s, from which on the field counts as rotating, and rounds in which it has to for what the drive has
/// learned to be stored: a second.
const ROTATES: f32 = 6.0;
const ENOUGH: u32 = 100;

/// The application's round, whatever calls it: watchdog, telemetry, resets.
#[derive(Default)]
pub struct Rounds {
    period: u32,
    /// Rounds of this run in which the field rotated.
    rotated: u32,
}

impl Rounds {
    /// Before the first round.
    pub const fn new() -> Self {
        Self { period: 0, rotated: 0 }
    }

    /// To be called as often as one likes with the telemetry of now. Whether a run has ended by a stop, and what the drive
    /// has learned in it should be stored: not after a fault, of which a wrong estimate may be the cause.
    pub fn round(&mut self, t: Telemetry) -> bool {
        if t.period.wrapping_sub(self.period) < ROUND {
            return false;
        }
        // The control interrupt has run as often as it should.
        self.period = t.period;
        watchdog::feed();
        MAILBOX.publish(t);
        let rotated = self.rotated;
        if t.status != Status::Running.code() {
            self.rotated = 0;
        } else if t.omega_s.abs() > ROTATES {
            self.rotated = rotated.saturating_add(1);
        }
        rotated >= ENOUGH && t.status == Status::Stopped.code()
    }
}

/// Does the reset that the application asks for. What may be reset, and when, is a decision of the application: after a
/// fault of a measurement not without a look at the sensors, see the table of faults.
pub fn reset(drive: &mut CountsDrive<f32>) {
    if MAILBOX.take_reset() {
        pwm::acknowledge_trip();
        drive.reset();
    }
}
