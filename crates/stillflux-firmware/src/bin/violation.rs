//! One violation each of what `tests/test_firmware.py` proves of the control interrupt: a proof that does not notice them
//! proves nothing. Each function is a root of its own, built with the options of the other images.
#![no_std]
#![no_main]

use core::hint::black_box;
use cortex_m_rt::entry;
use stillflux_firmware::board;

/// Bounds checked at run time.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_panic(index: u32) -> u32 {
    black_box([index; 3])[index as usize]
}

/// Double precision.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_double(x: u32) -> u32 {
    black_box(f64::from(x) * 0.1) as u32
}

/// A conversion that the FPU does not have.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_soft_float(x: u32) -> u32 {
    black_box(f32::from_bits(x) as i64) as u32
}

/// A quotient of 64 bits.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_division(x: u32) -> u32 {
    black_box(u64::MAX / (u64::from(x) + 1)) as u32
}

/// A call through a pointer.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_indirect(x: u32) -> u32 {
    black_box(leaf as fn(u32) -> u32)(x) + 1
}

/// Memory from an allocator.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_allocation(x: u32) -> u32 {
    __rust_alloc(x) + 1
}

/// Stack without a bound.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_recursion(n: u32) -> u32 {
    let kept = black_box([n; 8]);
    if n == 0 { 0 } else { plant_recursion(n - 1) + black_box(kept)[3] }
}

/// A kilobyte of stack.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_stack(x: u32) -> u32 {
    black_box([x; 256])[3]
}

/// Nothing of all that.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn plant_nothing(x: u32) -> u32 {
    leaf(x) + 2
}

#[inline(never)]
fn leaf(x: u32) -> u32 {
    black_box(x ^ 1)
}

/// Named as an allocator's entry is.
#[unsafe(no_mangle)]
#[inline(never)]
extern "C" fn __rust_alloc(size: u32) -> u32 {
    black_box(size)
}

#[entry]
fn main() -> ! {
    let all = [
        plant_panic,
        plant_double,
        plant_soft_float,
        plant_division,
        plant_indirect,
        plant_allocation,
        plant_recursion,
        plant_stack,
        plant_nothing,
    ];
    board::exit(all.iter().all(|plant| black_box(*plant)(1) < 2))
}
