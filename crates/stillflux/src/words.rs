//! A configuration as 32-bit words, for a page of flash.
//!
//! [`crate::config::DriveConfig::new`] computes in double precision, which a microcontroller without such an
//! FPU does in software: 15 kB of code for a hundred numbers. A host can compute them once and store them as
//! they are; [`Words::take`] reads them back without double precision. [`Words::LAYOUT`] identifies names and order of
//! all fields; it and the check of the content belong to the page around the words ([`crate::page`]).

use core::marker::PhantomData;

/// A value that is stored as a fixed sequence of words.
pub trait Words: Sized {
    /// Number of words.
    const LEN: usize = 1;
    /// Hash of the layout: a field renamed, moved, added or removed changes it, at whatever depth.
    const LAYOUT: u32 = layout(Self::LEN as u32, "word");
    /// Hands the words to `out`, one after the other.
    fn put(&self, out: &mut impl FnMut(u32));
    /// A value to take words into.
    const BLANK: Self;
    /// Takes the words back in the same order, each to its place in the value: a value that is returned would
    /// need a second copy on the stack, and twice the code.
    fn fill(&mut self, from: &mut impl FnMut() -> u32);
    /// Takes them back as a value of its own.
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        let mut x = Self::BLANK;
        x.fill(from);
        x
    }
    /// Whether no per-unit number lies at or beyond the end of its arithmetic's range: a constant that does was limited
    /// to that range, and is not what it stands for.
    fn is_representable(&self) -> bool {
        true
    }
}

/// Continues the hash of a layout with a name (FNV-1a).
#[must_use]
pub const fn layout(hash: u32, name: &str) -> u32 {
    let (name, mut hash, mut k) = (name.as_bytes(), hash ^ 0x811C_9DC5, 0);
    while k < name.len() {
        hash = (hash ^ name[k] as u32).wrapping_mul(0x0100_0193);
        k += 1;
    }
    hash
}

/// [`Words::LEN`] and [`Words::LAYOUT`] of a field, by a function that reads it: its type need not be written down.
#[doc(hidden)]
#[must_use]
pub const fn of_field<S, T: Words>(_: fn(&S) -> &T) -> (usize, u32) {
    (T::LEN, T::LAYOUT)
}

impl Words for u32 {
    const BLANK: Self = 0;
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = from();
    }
}

macro_rules! short_words {
    ($($short:ty),*) => {
        $(impl Words for $short {
            const BLANK: Self = 0;
            fn put(&self, out: &mut impl FnMut(u32)) {
                out(u32::from(*self));
            }
            #[allow(clippy::cast_possible_truncation)]
            fn fill(&mut self, from: &mut impl FnMut() -> u32) {
                *self = from() as Self;
            }
        })*
    };
}
short_words!(u8, u16);

impl Words for bool {
    const BLANK: Self = false;
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(u32::from(*self));
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = from() != 0;
    }
}

impl Words for f32 {
    const BLANK: Self = 0.0;
    fn is_representable(&self) -> bool {
        self.is_finite() && self.abs() < f32::MAX
    }
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(self.to_bits());
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        *self = Self::from_bits(from());
    }
}

impl Words for f64 {
    const LEN: usize = 2;
    const BLANK: Self = 0.0;
    fn is_representable(&self) -> bool {
        self.is_finite() && self.abs() < f64::MAX
    }
    #[allow(clippy::cast_possible_truncation)]
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(self.to_bits() as u32);
        out((self.to_bits() >> 32) as u32);
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        let low = u64::from(from());
        *self = Self::from_bits(low | u64::from(from()) << 32);
    }
}

/// A feature that is left out: no words.
impl<T> Words for PhantomData<T> {
    const LEN: usize = 0;
    const BLANK: Self = Self;
    fn put(&self, _: &mut impl FnMut(u32)) {}
    fn fill(&mut self, _: &mut impl FnMut() -> u32) {}
}

impl<T: Words, const N: usize> Words for [T; N] {
    const LEN: usize = N * T::LEN;
    const LAYOUT: u32 = layout(T::LAYOUT ^ N as u32, "array");
    const BLANK: Self = [T::BLANK; N];
    fn is_representable(&self) -> bool {
        self.iter().all(T::is_representable)
    }
    fn put(&self, out: &mut impl FnMut(u32)) {
        for x in self {
            x.put(out);
        }
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        for x in self {
            x.fill(from);
        }
    }
}

impl<T: Words> Words for Option<T> {
    const LEN: usize = 1 + T::LEN;
    const LAYOUT: u32 = layout(T::LAYOUT, "option");
    const BLANK: Self = None;
    fn is_representable(&self) -> bool {
        self.as_ref().is_none_or(T::is_representable)
    }
    /// As long without a value as with one: every word has its place, so that reading takes no arithmetic.
    fn put(&self, out: &mut impl FnMut(u32)) {
        self.is_some().put(out);
        match self {
            Some(x) => x.put(out),
            None => T::take(&mut || 0).put(out),
        }
    }
    fn fill(&mut self, from: &mut impl FnMut() -> u32) {
        let is_some = bool::take(from);
        self.insert(T::BLANK).fill(from);
        if !is_some {
            *self = None;
        }
    }
}

/// [`Words`] of a struct over an arithmetic, or of one that has none (`struct`), field by field; a field that is forgotten does
/// not compile.
macro_rules! words {
    (struct $name:ident: $($fields:tt)*) => {
        $crate::words::words!(@ [] [$name] $name: $($fields)*);
    };
    ($name:ident: $($fields:tt)*) => {
        $crate::words::words!(@ [R: $crate::scalar::Real] [$name<R>] $name: $($fields)*);
    };
    (@ [$($arithmetic:tt)*] [$of:ty] $name:ident: $($(#[$built:meta])* $field:ident),* $(,)?) => {
        impl<$($arithmetic)*> $crate::words::Words for $of {
            const LEN: usize = {
                let mut n = 0;
                $($(#[$built])* { n += $crate::words::of_field(|x: &Self| &x.$field).0; })*
                n
            };
            const LAYOUT: u32 = {
                let mut hash = $crate::words::layout(0, stringify!($name));
                $($(#[$built])* {
                    hash = $crate::words::layout(hash, stringify!($field));
                    hash ^= $crate::words::of_field(|x: &Self| &x.$field).1;
                })*
                hash
            };
            const BLANK: Self = Self { $($(#[$built])* $field: $crate::words::Words::BLANK),* };
            fn is_representable(&self) -> bool {
                let Self { $($(#[$built])* $field),* } = self;
                $($(#[$built])* if !$crate::words::Words::is_representable($field) { return false; })*
                true
            }
            fn put(&self, out: &mut impl FnMut(u32)) {
                let Self { $($(#[$built])* $field),* } = self;
                $($(#[$built])* $crate::words::Words::put($field, out);)*
            }
            fn fill(&mut self, from: &mut impl FnMut() -> u32) {
                let Self { $($(#[$built])* $field),* } = self;
                $($(#[$built])* $crate::words::Words::fill($field, from);)*
            }
        }
    };
}
pub(crate) use words;

#[cfg(test)]
mod tests {
    use super::Words;
    use crate::config::{DriveConfig, DriveParams, PaperParams, Scheme};
    use crate::params::{Inverter, Machine};
    use crate::scalar::{Q, Real};

    fn round_trip<R: Real>(params: impl Fn(DriveParams) -> DriveParams) {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let config =
            DriveConfig::<R>::new(&machine, &inverter, &params(DriveParams::new(&machine, &inverter))).unwrap();
        let mut words = [0; 600];
        let mut n = 0;
        assert!(config.is_representable());
        config.put(&mut |w| {
            words[n] = w;
            n += 1;
        });
        assert_eq!(n, DriveConfig::<R>::LEN);
        let mut back = words[..n].iter();
        assert_eq!(DriveConfig::<R>::take(&mut || *back.next().unwrap()), config);
        assert!(back.next().is_none());
    }

    #[test]
    fn a_configuration_survives_in_every_arithmetic_and_with_blocks_off() {
        for &scheme in Scheme::ALL {
            round_trip::<f32>(|p| DriveParams { scheme, ..p });
            round_trip::<f64>(|p| DriveParams { scheme, ..p });
            round_trip::<Q>(|p| DriveParams { scheme, inverter_model: false, ..p });
        }
        if Scheme::ALL.contains(&Scheme::Paper) {
            let paper = PaperParams { resistance_adaptation: false, offset_estimator: false, ..PaperParams::default() };
            round_trip::<Q>(|p| DriveParams { scheme: Scheme::Paper, paper, ..p });
        }
    }

    #[derive(Debug, PartialEq)]
    struct Pair<R> {
        first: R,
        second: R,
    }
    words!(Pair: first, second);

    mod other {
        pub struct Pair<R> {
            pub first: R,
            pub second: R,
        }
        words!(Pair: second, first);
    }

    mod renamed {
        pub struct Pair<R> {
            pub first: R,
            pub third: R,
        }
        words!(Pair: first, third);
    }

    #[test]
    fn fields_in_another_order_or_under_another_name_are_another_layout() {
        let layouts = [
            Pair::<f32>::LAYOUT,
            other::Pair::<f32>::LAYOUT,
            renamed::Pair::<f32>::LAYOUT,
            <[Pair<f32>; 2]>::LAYOUT,
            Option::<Pair<f32>>::LAYOUT,
        ];
        for (k, a) in layouts.iter().enumerate() {
            assert!(layouts[k + 1..].iter().all(|b| a != b), "{layouts:x?}");
        }
        assert_eq!(Pair::<f32>::LAYOUT, Pair::<Q>::LAYOUT, "the arithmetic is a word of its own in the page");
        assert_eq!((Pair::<f64>::LEN, Option::<Pair<f32>>::LEN), (4, 3));
    }

    #[test]
    fn a_number_that_was_limited_to_the_range_of_its_arithmetic_is_noticed() {
        assert!(Pair { first: Q::from_f64(127.9), second: -Q::from_f64(127.9) }.is_representable());
        assert!(!Pair { first: Q::ONE, second: Q::from_f64(128.0) }.is_representable());
        assert!(!Pair { first: Q::from_f64(-129.0), second: Q::ONE }.is_representable());
        assert!(!Pair { first: 1.0, second: f32::from_f64(1e39) }.is_representable());
        assert!(!Some(f32::NAN).is_representable());
    }
}
