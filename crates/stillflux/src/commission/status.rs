//! Progress of a commissioning, and why it may end early.

use core::fmt;

/// Why a commissioning has been stopped. The numbers are stable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Cause {
    /// [`Commissioning::abort`] was called.
    Aborted = 1,
    /// A measurement is not finite or beyond full scale.
    Measurement = 2,
    /// dc-link voltage outside 0.6 to 1.45 times the rated one.
    DcLink = 3,
    /// Current above its limit.
    OverCurrent = 4,
    /// Offset of a current channel beyond what a healthy sensor shows.
    CurrentOffset = 5,
    /// A short pulse at a fraction of the expected voltage makes a large current.
    ShortCircuit = 6,
    /// No current in any channel.
    NoMotor = 7,
    /// One phase carries no current.
    OpenPhase = 8,
    /// One channel does not answer, although its phase carries current.
    DeadChannel = 9,
    /// Current channels belong to other legs.
    SwappedChannels = 10,
    /// A current channel has the wrong sign.
    InvertedChannel = 11,
    /// The gain of a channel (or the impedance of a phase) is further from the mean of the three than 15 %.
    ChannelGain = 12,
    /// The machine is far from its nameplate.
    WrongMotor = 13,
    /// A current does not come to its reference: a channel at the end of its range, or a gain that is far off.
    CurrentControl = 14,
}

impl Cause {
    /// All causes.
    pub const ALL: [Self; 14] = [
        Self::Aborted,
        Self::Measurement,
        Self::DcLink,
        Self::OverCurrent,
        Self::CurrentOffset,
        Self::ShortCircuit,
        Self::NoMotor,
        Self::OpenPhase,
        Self::DeadChannel,
        Self::SwappedChannels,
        Self::InvertedChannel,
        Self::ChannelGain,
        Self::WrongMotor,
        Self::CurrentControl,
    ];

    /// Its number, 1 to 14.
    #[must_use]
    pub fn code(self) -> u32 {
        self as u32
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Aborted => "aborted",
            Self::Measurement => "measurement",
            Self::DcLink => "dc-link voltage",
            Self::OverCurrent => "over-current",
            Self::CurrentOffset => "current offset",
            Self::ShortCircuit => "short circuit",
            Self::NoMotor => "no motor connected",
            Self::OpenPhase => "open phase",
            Self::DeadChannel => "dead current channel",
            Self::SwappedChannels => "swapped current channels",
            Self::InvertedChannel => "inverted current channel",
            Self::ChannelGain => "gains of the current channels",
            Self::WrongMotor => "motor far from its nameplate",
            Self::CurrentControl => "current off its reference",
        })
    }
}

/// Procedure under way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stage {
    /// Offsets, sensors and wiring.
    Wiring,
    /// Differences between the legs of the bridge; needs the feature `legs`.
    Legs,
    /// Curve of the bridge.
    Bridge,
    /// Leakage inductance.
    Leakage,
    /// Magnetising curve and resistances.
    Magnetising,
    /// All done.
    Complete,
}

impl Stage {
    /// The procedures after the check of the wiring.
    pub(super) const PROCEDURES: [Self; 4] = [Self::Legs, Self::Bridge, Self::Leakage, Self::Magnetising];
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Wiring => "wiring",
            Self::Legs => "legs",
            Self::Bridge => "bridge",
            Self::Leakage => "leakage",
            Self::Magnetising => "magnetising",
            Self::Complete => "complete",
        })
    }
}

/// State of a commissioning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Status {
    /// Under way.
    Running,
    /// All procedures are done.
    Done,
    /// Stopped in a period, counted from the start.
    Faulted {
        /// Why.
        cause: Cause,
        /// When.
        period: u32,
    },
}
