//! What a device says of itself on request: the [`Board`] report and the result of a [`SelfTest`].
//!
//! A host asks with `HostMessage::Board` about once a second, and with `HostMessage::SelfTest` for a test. A figure is `None` if
//! the device does not have it.

use crate::array::MotorSet;
use core::ops::{BitOr, BitOrAssign};
use serde::{Deserialize, Serialize};

/// An output of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Output {
    /// The line of this motor.
    Line(u8),
    /// The trigger.
    Trigger,
    /// The enable of the drivers.
    Enable,
}

/// A set of outputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Outputs {
    /// The lines of these motors.
    pub lines: MotorSet,
    /// The trigger.
    pub trigger: bool,
    /// The enable of the drivers.
    pub enable: bool,
}

impl Outputs {
    /// No output.
    pub const NONE: Self = Self { lines: MotorSet::EMPTY, trigger: false, enable: false };

    /// Whether no output is in it.
    pub fn is_empty(&self) -> bool {
        *self == Self::NONE
    }

    /// The outputs, lines first.
    pub fn iter(self) -> impl Iterator<Item = Output> + use<> {
        let trigger = self.trigger.then_some(Output::Trigger);
        let enable = self.enable.then_some(Output::Enable);
        self.lines.iter().map(Output::Line).chain(trigger).chain(enable)
    }
}

impl BitOr for Outputs {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        let (trigger, enable) = (self.trigger | other.trigger, self.enable | other.enable);
        Self { lines: self.lines | other.lines, trigger, enable }
    }
}

impl BitOrAssign for Outputs {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

/// Why the device has started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Reset {
    /// The device does not know.
    #[default]
    Unknown,
    /// Power came on, or the supply broke down for a moment: an RP2040 cannot tell the two apart.
    Power,
    /// The RUN pin was low.
    RunPin,
    /// A debugger restarted it.
    Debugger,
    /// Its watchdog restarted a firmware that hung.
    Watchdog,
    /// The firmware stopped itself after a panic or a fault of its core.
    Panic,
    /// The program of a simulated device started.
    Program,
}

/// What the device counted since it started, and in the window that a request ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Board {
    /// The number of the request that it answers.
    pub window: u16,
    /// Why it has started.
    pub reset: Reset,
    /// Time since then, s.
    pub uptime_s: u32,
    /// Least time left to render while armed, ticks, from the request before to this one; `None`: the device rendered
    /// nothing, or does not measure it.
    pub slack: Option<u8>,
    /// The same since it started.
    pub slack_since_boot: Option<u8>,
    /// What it counted since it started.
    pub counts: Counts,
    /// Outputs that were high before anything drove them.
    pub high_at_boot: Option<Outputs>,
}

/// A value of [`Counts`]: of a counter that every device has, or that some do not have.
trait Count: Copy {
    const NONE: Self;
    const OPTIONAL: bool;
    fn value(self) -> Option<u32>;
    fn since(self, before: Self) -> Self;
}

impl Count for u32 {
    const NONE: Self = 0;
    const OPTIONAL: bool = false;
    fn value(self) -> Option<u32> {
        Some(self)
    }
    fn since(self, before: Self) -> Self {
        self.saturating_sub(before)
    }
}

impl Count for Option<u32> {
    const NONE: Self = None;
    const OPTIONAL: bool = true;
    fn value(self) -> Option<u32> {
        self
    }
    fn since(self, before: Self) -> Self {
        Some(self?.saturating_sub(before?))
    }
}

/// A counter of a device, as [`Counts`] declares it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counter {
    /// Its key in the host's status, receipts and metrics.
    pub name: &'static str,
    /// What was counted, for people.
    pub label: &'static str,
    /// Some devices do not have it.
    pub optional: bool,
}

macro_rules! counters {
    ($($(#[$doc:meta])* $name:ident: $count:ty = $label:literal,)*) => {
        /// The device's counters, in the order of the wire.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub struct Counts {
            $($(#[$doc])* pub $name: $count,)*
        }

        impl Counts {
            /// Nothing is counted.
            pub const NONE: Self = Self { $($name: <$count as Count>::NONE,)* };
            /// All counters.
            pub const ALL: &'static [Counter] = &[
                $(Counter { name: stringify!($name), label: $label, optional: <$count as Count>::OPTIONAL },)*
            ];

            /// Each counter with its value.
            pub fn iter(&self) -> impl Iterator<Item = (&'static Counter, Option<u32>)> + use<> {
                Self::ALL.iter().zip([$(self.$name.value(),)*])
            }

            /// What was counted since `before`.
            pub fn since(&self, before: &Self) -> Self {
                Self { $($name: self.$name.since(before.$name),)* }
            }
        }
    };
}

// A row declares a counter: the host passes it on by its name.
counters! {
    /// Times that its executor stood still for too long.
    stalls: Option<u32> = "stalls",
    /// Times that it set up a hung USB controller again.
    usb_recoveries: Option<u32> = "USB recoveries",
    /// Times that its outputs failed: lines ran out of rendered ticks, or PIO and DMA stopped following.
    output_faults: u32 = "output faults",
}

/// The figures of a [`Board`] report that the shell measures, not the controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Measures {
    /// As in [`Board`].
    pub reset: Reset,
    /// As in [`Board`], without the output faults: the controller counts these.
    pub counts: Counts,
    /// As in [`Board`].
    pub high_at_boot: Option<Outputs>,
}

impl Measures {
    /// The shell measures nothing.
    pub const NONE: Self = Self { reset: Reset::Unknown, counts: Counts::NONE, high_at_boot: None };
}

/// How far a self-test is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SelfTestState {
    /// The device refused it, because it is not disarmed.
    Refused,
    /// It is under way.
    Running,
    /// A command, an e-stop or a lost link ended it.
    Ended,
    /// It is over, with this result.
    Done(SelfTest),
}

/// What a self-test measured. The host judges it. `None`: the device does not have this check.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct SelfTest {
    /// The lines and the trigger, driven one by one with the drivers off.
    pub lines: Option<LineTest>,
    /// PIO and DMA against the system timer.
    pub wave: Option<WaveTest>,
    /// Patterns in free memory.
    pub ram: Option<RamTest>,
    /// Time to read the longest frame of [`crate::batch::longest_frame`], µs by the system timer: the longest of several tries.
    pub work_us: Option<u32>,
}

/// What each output did. The test only reads the driver enable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LineTest {
    /// High although nothing drove them high.
    pub stuck_high: Outputs,
    /// Low although they were driven high.
    pub stuck_low: Outputs,
    /// High or low together with another output.
    pub shorted: Outputs,
    /// The first such pair.
    pub pair: Option<(Output, Output)>,
}

/// How fast the waveform ran.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct WaveTest {
    /// Time by the system timer, µs.
    pub timer_us: u32,
    /// Ticks that the clock of the controller counted in that time.
    pub ticks: u32,
    /// Words that DMA and PIO took in that time; a tick has four.
    pub words: u32,
}

/// What the memory kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct RamTest {
    /// Bytes tested.
    pub bytes: u32,
    /// The first address that did not keep what was written.
    pub bad: Option<u32>,
}
