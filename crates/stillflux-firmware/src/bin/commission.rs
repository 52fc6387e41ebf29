//! Self-commissioning on a Cortex-M4F: finds the parameters of the motor on its bridge, and writes the page that the
//! drive's image starts from.
//!
//! `control_isr` is what a product runs before it has parameters: readings in, one period of the commissioning, compare
//! values out. The fits are made once, at the end, in the main loop and in double precision. As in `drive.rs` the main
//! loop plays the sampling instants from a file on the host; the page goes to another file, in a product to flash.
//! Without arguments the commissioning reads the offsets of idle channels, and the image reports its sizes.
#![no_std]
#![no_main]

use cortex_m_rt::{entry, exception};
use stillflux::commission::{Commissioning, Status};
use stillflux::counts::Counts;
use stillflux::interrupt::{Command, CountsCommissioning};
use stillflux::scalar::Real;
use stillflux::telemetry::SetPoint;
use stillflux_firmware::board::{self, File, Interrupt, print};
use stillflux_firmware::commissioning::{ANSWER, answer, begin, page};
use stillflux_firmware::exchange::Frame;

#[cfg(feature = "q")]
type Arithmetic = stillflux::scalar::Q;
#[cfg(not(feature = "q"))]
type Arithmetic = f32;

/// The commissioning; nothing until it is set up: the bridge is blocked.
static INTERRUPT: Interrupt<Option<CountsCommissioning<Arithmetic>>> = Interrupt::new(None);

#[exception]
fn SysTick() {
    control_isr();
}

/// The control interrupt.
#[unsafe(no_mangle)]
#[inline(never)]
fn control_isr() {
    // SAFETY: this is the control interrupt.
    unsafe { INTERRUPT.run(|control, frame| control.as_mut().map_or(Command::BLOCKED, |c| c.period(&frame.counts))) }
}

#[entry]
fn main() -> ! {
    match begin() {
        // SAFETY: this is the main loop.
        Ok(control) => unsafe { INTERRUPT.between(|c| *c = Some(control)) },
        Err(why) => {
            print(format_args!("{}: the bridge stays blocked", why.field));
            board::exit(false)
        }
    }
    let mut buffer = [0; 512];
    let mut arguments = board::arguments(&mut buffer).split_whitespace().skip(1);
    match (arguments.next(), arguments.next(), arguments.next()) {
        (Some(from), Some(to), Some(found)) => board::exit(board::replay(from, to, period) && store(found)),
        _ => board::exit(idle()),
    }
}

/// Writes the page with what was found.
fn store(to: &str) -> bool {
    // SAFETY: this is the main loop.
    let Some(page) = (unsafe { INTERRUPT.between(|c| c.as_ref().and_then(|c| page(c).ok())) }) else {
        print(format_args!("nothing that a drive accepts was found"));
        return false;
    };
    let Some(mut file) = File::open(to, true) else { return false };
    page.words().iter().all(|word| file.write(&word.to_le_bytes()))
}

/// One sampling instant and what it gave.
fn period(frame: Frame) -> [u8; ANSWER] {
    let command = INTERRUPT.sample(frame);
    // SAFETY: this is the main loop.
    unsafe { INTERRUPT.between(|c| c.as_ref().map_or([0; ANSWER], |c| answer(c, &command))) }
}

/// A commissioning on idle readings at its rated dc link: reads the offsets and begins with the pulses.
fn idle() -> bool {
    let counts = Counts { i_abc: [0; 3], u_dc: 21_845 };
    for _ in 0..1100 {
        period(Frame { counts, set_point: SetPoint::Stop });
    }
    // SAFETY: this is the main loop.
    let status = unsafe { INTERRUPT.between(|c| c.as_ref().map(|c| c.commissioning().status())) };
    let running = status == Some(Status::Running);
    let bytes = size_of::<Commissioning<Arithmetic>>();
    print(format_args!(
        "{{\"arithmetic\": \"{}\", \"running\": {running}, \"commissioning_bytes\": {bytes}}}",
        Arithmetic::NAME
    ));
    running
}
