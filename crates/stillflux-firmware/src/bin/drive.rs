//! The complete drive on a Cortex-M4F.
//!
//! `control_isr` is what a product runs: readings in, one period of the drive, compare values out. Around
//! it, the main loop plays the sampling instants: it reads recorded frames from a file on the host, pends
//! the interrupt for each and writes what came back to a second file (processor in the loop). Without
//! arguments the drive starts on idle readings and the image reports its sizes.
#![no_std]
#![no_main]

use cortex_m_rt::{entry, exception};
#[cfg(feature = "si-page")]
use stillflux::config::Scheme;
use stillflux::counts::Counts;
use stillflux::interrupt::CountsDrive;
#[cfg(not(feature = "si-page"))]
use stillflux::page::{Page, WORDS};
use stillflux::scalar::Real;
use stillflux::telemetry::SetPoint;
#[cfg(feature = "si-page")]
use stillflux_firmware::blob::{Blob, Parameters};
use stillflux_firmware::board::{self, Interrupt, print};
use stillflux_firmware::exchange::{ANSWER, Frame, answer};

#[cfg(feature = "q")]
type Arithmetic = stillflux::scalar::Q;
#[cfg(not(feature = "q"))]
type Arithmetic = f32;

/// The page of flash that commissioning writes.
#[cfg(not(feature = "si-page"))]
#[unsafe(link_section = ".rodata.parameters")]
#[used]
static PAGE: Page = Page::new(PRESET);
#[cfg(not(any(feature = "si-page", feature = "q")))]
const PRESET: [u32; WORDS] = include!(concat!(env!("OUT_DIR"), "/page-f32.rs"));
#[cfg(all(not(feature = "si-page"), feature = "q"))]
const PRESET: [u32; WORDS] = include!(concat!(env!("OUT_DIR"), "/page-q.rs"));
/// The same in SI units, for the target to convert.
#[cfg(feature = "si-page")]
#[unsafe(link_section = ".rodata.parameters")]
#[used]
static PAGE: Blob = Blob::seal(&Parameters::preset(SCHEME));
/// As `Scheme::default` has it, for a constant.
#[cfg(feature = "si-page")]
const SCHEME: Scheme = if cfg!(feature = "enhanced") { Scheme::Enhanced } else { Scheme::Paper };

/// The one drive; it blocks the bridge until the page is read.
static INTERRUPT: Interrupt<CountsDrive<Arithmetic>> = Interrupt::new(CountsDrive::empty());

#[exception]
fn SysTick() {
    control_isr();
}

/// The control interrupt.
#[unsafe(no_mangle)]
#[inline(never)]
fn control_isr() {
    // SAFETY: this is the control interrupt.
    unsafe {
        INTERRUPT.run(|control, frame| control.period(&frame.counts, &frame.set_point));
    }
}

#[entry]
fn main() -> ! {
    match load() {
        // SAFETY: this is the main loop.
        Ok(control) => unsafe { INTERRUPT.between(|c| *c = control) },
        Err(why) => {
            print(format_args!("{why}: the bridge stays blocked"));
            board::exit(false)
        }
    }
    let mut buffer = [0; 512];
    let mut arguments = board::arguments(&mut buffer).split_whitespace().skip(1);
    match (arguments.next(), arguments.next()) {
        (Some(from), Some(to)) => board::exit(board::replay(from, to, period)),
        _ => board::exit(idle()),
    }
}

/// A drive from the page.
// Not inlined: its code has a size of its own in the report.
#[cfg(not(feature = "si-page"))]
#[inline(never)]
fn load() -> Result<CountsDrive<Arithmetic>, &'static str> {
    // Opaque: flash is written after the image is linked, its content must not be folded into the code.
    let page = core::hint::black_box(&PAGE).open().ok_or("parameter page is not valid")?;
    Ok(CountsDrive::new(&page))
}
#[cfg(feature = "si-page")]
#[inline(never)]
fn load() -> Result<CountsDrive<Arithmetic>, &'static str> {
    let parameters = core::hint::black_box(&PAGE).open().ok_or("parameter page is not valid")?;
    // The field alone: printing its value would bring in the formatting of floating-point numbers.
    parameters.ready().map(|ready| CountsDrive::new(&ready)).map_err(|e| e.field)
}

/// One sampling instant and what it gave.
fn period(frame: Frame) -> [u8; ANSWER] {
    let command = INTERRUPT.sample(frame);
    // SAFETY: this is the main loop.
    unsafe { INTERRUPT.between(|c| answer(c, &command)) }
}

/// A drive on idle readings at its rated dc link: reads its offsets and begins to magnetise.
fn idle() -> bool {
    let counts = Counts { i_abc: [0; 3], u_dc: 21_845 };
    for _ in 0..1100 {
        period(Frame { counts, set_point: SetPoint::Speed(0.0) });
    }
    // SAFETY: this is the main loop.
    let status = unsafe { INTERRUPT.between(|c| c.status()) };
    let (drive, config) =
        (size_of::<stillflux::drive::Drive<Arithmetic>>(), size_of::<stillflux::config::DriveConfig<Arithmetic>>());
    print(format_args!(
        "{{\"arithmetic\": \"{}\", \"status\": \"{status:?}\", \"drive_bytes\": {drive}, \"config_bytes\": {config}}}",
        Arithmetic::NAME
    ));
    status == stillflux::drive::Status::Magnetising
}
