//! The board: QEMU's mps2-an386 (Cortex-M4F). **The one file to replace for a port**, with `memory.x`.
//!
//! Here the peripherals are a mailbox that the main loop fills from a file on the host; the interrupt is
//! SysTick, pended by software once for each period. On an STM32G4 the interrupt is the converters' end of injected
//! sequence, and the peripherals are its converters and its timer: `examples/firmware`.

use crate::exchange::{FRAME, Frame};
use core::cell::UnsafeCell;
use core::fmt::{self, Write};
use core::panic::PanicInfo;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_semihosting::{debug, hio, nr, syscall};
use stillflux::counts::Counts;
use stillflux::interrupt::Command;
use stillflux::telemetry::SetPoint;

/// A static that the control interrupt and the main loop hand to each other: the main loop touches it only
/// while the interrupt cannot run.
pub struct Handover<T>(UnsafeCell<T>);

// SAFETY: one core; the contract of `with`.
unsafe impl<T> Sync for Handover<T> {}

impl<T> Handover<T> {
    /// Holds `value`.
    pub const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    /// Exclusive access.
    ///
    /// # Safety
    /// Not called again from within `f`, and from the main loop only while the control interrupt is not
    /// pended.
    #[inline(always)]
    pub unsafe fn with<U>(&self, f: impl FnOnce(&mut T) -> U) -> U {
        // SAFETY: no second reference lives, by the caller's promise.
        f(unsafe { &mut *self.0.get() })
    }
}

/// Peripheral registers of this board: readings and reference in, command out.
struct Mailbox {
    frame: Frame,
    command: Command,
}

/// The control interrupt's state `C` with the peripherals that it reads and writes.
pub struct Interrupt<C> {
    control: Handover<C>,
    mailbox: Handover<Mailbox>,
}

impl<C> Interrupt<C> {
    /// Before its first period, gates off.
    pub const fn new(control: C) -> Self {
        let frame = Frame { counts: Counts { i_abc: [0; 3], u_dc: 0 }, set_point: SetPoint::Stop };
        let mailbox = Mailbox { frame, command: Command::BLOCKED };
        Self { control: Handover::new(control), mailbox: Handover::new(mailbox) }
    }

    /// Content of the interrupt: what the converters have read and what the application wants in, what the timer takes
    /// out.
    ///
    /// # Safety
    /// Called from the control interrupt alone.
    #[inline(always)]
    pub unsafe fn run(&self, period: impl FnOnce(&mut C, &Frame) -> Command) {
        // SAFETY: the main loop touches both only while this interrupt is not pended.
        unsafe {
            self.control.with(|control| {
                self.mailbox.with(|mailbox| {
                    let frame = mailbox.frame;
                    mailbox.command = period(control, &frame);
                });
            });
        }
    }

    /// One sampling instant: runs the control interrupt on `frame`, returns what it commanded.
    pub fn sample(&self, frame: Frame) -> Command {
        // SAFETY: the interrupt is pended only between the two accesses.
        unsafe {
            self.mailbox.with(|m| m.frame = frame);
            SCB::set_pendst();
            cortex_m::asm::dsb();
            cortex_m::asm::isb();
            self.mailbox.with(|m| m.command)
        }
    }

    /// The state, for the main loop.
    ///
    /// # Safety
    /// Called from the main loop alone, and not again from within `f`.
    pub unsafe fn between<U>(&self, f: impl FnOnce(&mut C) -> U) -> U {
        // SAFETY: the interrupt is pended in `sample` only.
        unsafe { self.control.with(f) }
    }
}

/// Instructions by SysTick: with `-icount shift=0` one instruction is a nanosecond, a tick is 40.
///
/// A loop of 4 instructions sees the edge of a tick up to 3 too late; how late, three readings show, 37 to 39 instructions after it: they
/// see the next tick if it was 3, 2 or 1. So a time is exact to the instruction.
#[derive(Clone, Copy)]
pub struct Clock {
    /// The counter after the edge; it counts down.
    count: u32,
    /// Instructions after the edge at which it was seen.
    late: u32,
    /// Turns of the loop until then.
    turns: u32,
}

impl Clock {
    /// Instructions per tick.
    const TICK: u32 = 40;
    /// Bits of the counter.
    const MASK: u32 = 0x00FF_FFFF;
    /// SysTick's current value.
    const CURRENT: u32 = 0xE000_E018;

    /// Starts it, without its interrupt.
    pub fn start(syst: &mut SYST) {
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(Self::MASK);
        syst.clear_current();
        syst.enable_counter();
    }

    /// The time now: as `since` an earlier one when it begins, as that earlier one when it ends.
    #[inline(always)]
    pub fn now() -> Self {
        let (turns, count, a, b, c): (u32, u32, u32, u32, u32);
        // SAFETY: reads SysTick's current value. Clobbers memory: no call is moved across.
        unsafe {
            core::arch::asm!(
                "ldr {c}, [{at}]", "2:", "adds {turns}, #1", "ldr {count}, [{at}]", "cmp {count}, {c}", "beq 2b",
                ".rept 34", "nop", ".endr", "ldr {a}, [{at}]", "ldr {b}, [{at}]", "ldr {c}, [{at}]",
                at = in(reg) Self::CURRENT, turns = inout(reg) 0 => turns, count = out(reg) count,
                a = out(reg) a, b = out(reg) b, c = out(reg) c,
            );
        }
        let late = [a, b, c].into_iter().map(|x| count.wrapping_sub(x) & Self::MASK).sum();
        Self { count, late, turns }
    }

    /// Instructions since an earlier time, and a constant number more.
    pub fn since(self, earlier: Self) -> u32 {
        let ticks = earlier.count.wrapping_sub(self.count) & Self::MASK;
        (ticks * Self::TICK + self.late).wrapping_sub(earlier.late + 4 * self.turns)
    }
}

/// A file on the host.
pub struct File(usize);

impl File {
    /// Opens `path` (without trailing zero) for reading or writing.
    pub fn open(path: &str, write: bool) -> Option<Self> {
        let mut name = [0_u8; 256];
        name.get_mut(..path.len())?.copy_from_slice(path.as_bytes());
        let mode = if write { nr::open::RW_TRUNC_BINARY } else { nr::open::R_BINARY };
        // SAFETY: the name lives and ends in a zero.
        let handle = unsafe { syscall!(OPEN, name.as_ptr(), mode, path.len()) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Fills `buffer` as far as the file goes; the number of bytes read.
    pub fn read(&mut self, buffer: &mut [u8]) -> usize {
        // SAFETY: pointer and length are those of the buffer.
        let left = unsafe { syscall!(READ, self.0, buffer.as_mut_ptr(), buffer.len()) };
        buffer.len() - left.min(buffer.len())
    }

    /// Writes all of `buffer`; `false` if the host did not take it.
    pub fn write(&mut self, buffer: &[u8]) -> bool {
        // SAFETY: pointer and length are those of the buffer.
        unsafe { syscall!(WRITE, self.0, buffer.as_ptr(), buffer.len()) == 0 }
    }
}

/// Feeds the frames of one file to `period`, and writes its answers of `N` bytes to another.
pub fn replay<const N: usize>(from: &str, to: &str, mut period: impl FnMut(Frame) -> [u8; N]) -> bool {
    let (Some(mut frames), Some(mut answers)) = (File::open(from, false), File::open(to, true)) else {
        print(format_args!("cannot open {from} and {to}"));
        return false;
    };
    let mut buffer = [[0; FRAME]; 1024];
    let mut out = [[0; N]; 1024];
    loop {
        let n = frames.read(buffer.as_flattened_mut()) / FRAME;
        if n == 0 {
            return true;
        }
        for (bytes, to) in buffer[..n].iter().zip(&mut out) {
            *to = period(Frame::from_bytes(bytes));
        }
        if !answers.write(out[..n].as_flattened()) {
            print(format_args!("cannot write {to}"));
            return false;
        }
    }
}

/// The command line that the host gave: image name, then arguments.
pub fn arguments(buffer: &mut [u8; 512]) -> &str {
    let mut request = [buffer.as_mut_ptr() as usize, buffer.len()];
    // SAFETY: SYS_GET_CMDLINE fills the buffer that the request names and writes the length back.
    let failed = unsafe { cortex_m_semihosting::syscall1(nr::GET_CMDLINE, request.as_mut_ptr() as usize) };
    let length = if failed == 0 { request[1].min(buffer.len()) } else { 0 };
    core::str::from_utf8(&buffer[..length]).unwrap_or("").trim_end_matches('\0')
}

/// Prints a line on the host.
pub fn print(line: fmt::Arguments<'_>) {
    if let Ok(mut out) = hio::hstdout() {
        // A host that does not listen is no fault of the drive.
        let _ = writeln!(out, "{line}");
    }
}

/// Ends the emulation.
pub fn exit(success: bool) -> ! {
    debug::exit(if success { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}

/// Unreachable from the control interrupt, as `tests/test_firmware.py` proves. On hardware: main output
/// off, then wait for the watchdog.
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    print(format_args!("{info}"));
    exit(false)
}
