//! One violation each of what `tests/test_firmware.py` proves of the control interrupt, planted by a feature:
//! a proof that does not notice them proves nothing. Without a feature this is empty.

use stillflux::interrupt::Command;

/// What the optimiser must not see through.
#[allow(unused)]
fn opaque(command: &Command) -> u32 {
    core::hint::black_box(command.compare[0])
}

/// Does what the image's features ask for.
#[inline(always)]
#[allow(unused_variables)]
pub fn planted(command: &Command) {
    #[cfg(feature = "plant-violation-panic")]
    core::hint::black_box(command.compare[opaque(command) as usize]);
    #[cfg(feature = "plant-violation-double")]
    core::hint::black_box(f64::from(opaque(command)) * 0.1);
    #[cfg(feature = "plant-violation-soft-float")]
    core::hint::black_box(core::hint::black_box(1.0_f32 / 3.0) as i64);
    #[cfg(feature = "plant-violation-division")]
    core::hint::black_box(u64::MAX / (u64::from(opaque(command)) + 1));
    #[cfg(feature = "plant-violation-recursion")]
    core::hint::black_box(recurse(opaque(command)));
    #[cfg(feature = "plant-violation-indirect")]
    core::hint::black_box(core::hint::black_box(opaque as fn(&Command) -> u32)(command));
    #[cfg(feature = "plant-violation-allocation")]
    core::hint::black_box(__rust_alloc(opaque(command)));
    #[cfg(feature = "plant-violation-stack")]
    core::hint::black_box([opaque(command); 256]);
}

/// Named as an allocator's entry is.
#[cfg(feature = "plant-violation-allocation")]
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn __rust_alloc(size: u32) -> u32 {
    core::hint::black_box(size)
}

/// Unbounded stack.
#[cfg(feature = "plant-violation-recursion")]
#[inline(never)]
fn recurse(n: u32) -> u32 {
    let kept = core::hint::black_box([n; 8]);
    if n == 0 { 0 } else { recurse(n - 1) + core::hint::black_box(kept)[3] }
}
