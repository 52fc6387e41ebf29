//! A configuration as 32-bit words, for a page of flash.
//!
//! [`crate::config::DriveConfig::new`] computes in double precision, which a microcontroller without such an
//! FPU does in software: 15 kB of code for a hundred numbers. A host can compute them once and store them as
//! they are; [`Words::take`] reads them back without any arithmetic. The words carry neither layout nor check:
//! that belongs to the page around them.

/// A value that is stored as a fixed sequence of words.
pub trait Words: Sized {
    /// Hands the words to `out`, one after the other.
    fn put(&self, out: &mut impl FnMut(u32));
    /// Takes them back in the same order.
    fn take(from: &mut impl FnMut() -> u32) -> Self;
}

impl Words for u32 {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(*self);
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        from()
    }
}

impl Words for u8 {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(u32::from(*self));
    }
    #[allow(clippy::cast_possible_truncation)]
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        from() as Self
    }
}

impl Words for bool {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(u32::from(*self));
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        from() != 0
    }
}

impl Words for f32 {
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(self.to_bits());
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        Self::from_bits(from())
    }
}

impl Words for f64 {
    #[allow(clippy::cast_possible_truncation)]
    fn put(&self, out: &mut impl FnMut(u32)) {
        out(self.to_bits() as u32);
        out((self.to_bits() >> 32) as u32);
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        let low = u64::from(from());
        Self::from_bits(low | u64::from(from()) << 32)
    }
}

impl<T: Words, const N: usize> Words for [T; N] {
    fn put(&self, out: &mut impl FnMut(u32)) {
        for x in self {
            x.put(out);
        }
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        core::array::from_fn(|_| T::take(from))
    }
}

impl<T: Words> Words for Option<T> {
    /// As long without a value as with one: every word has its place, so that reading takes no arithmetic.
    fn put(&self, out: &mut impl FnMut(u32)) {
        self.is_some().put(out);
        match self {
            Some(x) => x.put(out),
            None => T::take(&mut || 0).put(out),
        }
    }
    fn take(from: &mut impl FnMut() -> u32) -> Self {
        let is_some = bool::take(from);
        let x = T::take(from);
        is_some.then_some(x)
    }
}

/// [`Words`] of a struct over an arithmetic, field by field; a field that is forgotten does not compile.
macro_rules! words {
    ($name:ident: $($(#[$built:meta])* $field:ident),* $(,)?) => {
        impl<R: $crate::scalar::Real + $crate::words::Words> $crate::words::Words for $name<R> {
            fn put(&self, out: &mut impl FnMut(u32)) {
                let Self { $($(#[$built])* $field),* } = self;
                $($(#[$built])* $crate::words::Words::put($field, out);)*
            }
            fn take(from: &mut impl FnMut() -> u32) -> Self {
                $($(#[$built])* let $field = $crate::words::Words::take(from);)*
                Self { $($(#[$built])* $field),* }
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

    fn round_trip<R: Real + Words>(params: impl Fn(DriveParams) -> DriveParams) {
        let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
        let config =
            DriveConfig::<R>::new(&machine, &inverter, &params(DriveParams::new(&machine, &inverter))).unwrap();
        let mut words = [0; 512];
        let mut n = 0;
        config.put(&mut |w| {
            words[n] = w;
            n += 1;
        });
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
}
