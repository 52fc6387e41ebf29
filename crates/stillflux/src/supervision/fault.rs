//! Fault codes: cause, stable number, text, and what was measured when it happened.

use core::fmt;

use crate::scalar::Real;

/// What the value of a [`FaultReport`] is: its unit follows from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum Quantity {
    /// Nothing was measured.
    Nothing,
    /// A current; A.
    Current,
    /// A voltage; V.
    Voltage,
    /// A flux linkage; V s.
    Flux,
    /// A mechanical speed; rad/s.
    Speed,
    /// A pure number.
    Number,
    /// Number of a channel or phase: 1 to 3 for the phases a to c, 4 for the dc link, 0 for none of them alone.
    Channel,
}

impl Quantity {
    /// Unit in SI; empty for numbers.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Current => "A",
            Self::Voltage => "V",
            Self::Flux => "V s",
            Self::Speed => "rad/s",
            Self::Nothing | Self::Number | Self::Channel => "",
        }
    }
}

macro_rules! faults {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $text:literal, $quantity:ident;)*) => {
        /// Why a drive blocked its bridge. The numbers are stable: a log or a field bus may carry them.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
        #[repr(u8)]
        #[non_exhaustive]
        pub enum Fault {
            $($(#[$doc])* $name = $code,)*
        }

        impl Fault {
            /// All faults, ascending in their numbers.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// What the value and the limit of its report are.
            #[must_use]
            pub fn quantity(self) -> Quantity {
                match self {
                    $(Self::$name => Quantity::$quantity,)*
                }
            }

            /// Its text.
            #[must_use]
            pub fn text(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)*
                }
            }
        }
    };
}

faults! {
    /// Current vector above the trip level: at once where the voltage can have made it since the last sample, else in two
    /// samples within 10 ms. Without the feature `bridging` this and the next three are faults at the first sample.
    OverCurrent = 1, "over-current", Current;
    /// dc-link voltage below its range in two samples within 10 ms, or in the first sample of a start.
    UnderVoltage = 2, "under-voltage", Voltage;
    /// dc-link voltage above its range in two samples within 10 ms.
    OverVoltage = 3, "over-voltage", Voltage;
    /// A measurement is not finite, or at the end of what its sensor can read, in two samples within 10 ms; reports
    /// the channel.
    Measurement = 4, "measurement", Channel;
    /// The reference is not finite.
    Reference = 5, "reference", Nothing;
    /// Current offset at standstill beyond what a healthy sensor shows.
    CurrentOffset = 6, "current offset", Current;
    /// The flux estimate left its circle; reports `|ψ̂_s| - ψ*`.
    EstimateLost = 7, "estimate lost", Flux;
    /// The confidence in the field angle was below one half, and the drive is set to stop then
    /// ([`crate::config::LowConfidence::Fault`]).
    LowConfidence = 8, "low confidence", Number;
    /// The estimated speed is beyond what the drive may run at.
    OverSpeed = 9, "over-speed", Speed;
    /// The three phase currents do not add up to zero: a channel is stuck, saturated, inverted or of a wrong gain;
    /// reports the sum.
    CurrentSum = 10, "sum of currents", Current;
    /// A phase that should carry current does not; reports the phase, 0 if none of them does.
    OpenPhase = 11, "open phase", Channel;
    /// The current does not follow its reference: swapped or inverted channels, swapped phases on one side of the
    /// sensors, or no voltage left; reports the deviation.
    CurrentControl = 12, "current control", Current;
    /// The torque is at its limit at low speed, and the speed does not approach its reference; reports the deviation of
    /// the speed.
    Stall = 13, "stall", Speed;
    /// The field orientation is lost: the innovation of the filter contradicts its model; reports the normalised
    /// innovation squared.
    FieldLost = 14, "field lost", Number;
    /// Calls of the control were missed or came twice, by the cycle stamp of the measurement; reports how many.
    Timing = 15, "timing", Number;
    /// The encoder does not agree with the estimate, or is silent, and the drive is set to stop then
    /// ([`crate::config::DriveParams::encoder_fault`]); reports the measured less the estimated speed.
    EncoderApart = 16, "encoder apart", Speed;
}

impl Fault {
    /// Its number, from 1.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// The fault of a number.
    #[must_use]
    pub fn of(code: u32) -> Option<Self> {
        Self::ALL.iter().copied().find(|fault| fault.code() == code)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

/// A cause with what was measured, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct Trip<R: Real> {
    /// What happened.
    pub cause: Fault,
    /// What was measured, in the quantity of the cause ([`Fault::quantity`]).
    pub value: R,
    /// The limit that it violated.
    pub limit: R,
}

impl<R: Real> Trip<R> {
    /// Never holds a number that is not finite.
    pub(crate) fn new(cause: Fault, value: R, limit: R) -> Self {
        let finite = |x: R| if x.is_finite() { x } else { R::ZERO };
        Self { cause, value: finite(value), limit: finite(limit) }
    }
}

/// A latched fault: cause, when, and what was measured, per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub struct FaultReport<R: Real> {
    /// Cause, value and limit.
    pub trip: Trip<R>,
    /// Control period in which it happened, since power-up.
    pub period: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_numbered_from_one_without_a_gap_and_found_by_their_number() {
        assert!(
            Fault::ALL.iter().zip(1..).all(|(fault, code)| fault.code() == code && Fault::of(code) == Some(*fault))
        );
        assert_eq!(Fault::of(0), None);
    }

    #[test]
    fn no_two_faults_have_the_same_text() {
        for (k, a) in Fault::ALL.iter().enumerate() {
            assert!(Fault::ALL[..k].iter().all(|b| a.text() != b.text()));
        }
    }

    #[test]
    fn a_report_never_holds_a_number_that_is_not_finite() {
        assert_eq!(Trip::new(Fault::OverCurrent, f32::NAN, f32::INFINITY).value, 0.0);
    }
}
