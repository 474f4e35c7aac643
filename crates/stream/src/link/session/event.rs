//! What a session reports: its [`Event`]s, the [`Verdict`] on each stroke, and why a session ends.

use crate::link::session::contradiction::Contradiction;
use crate::time::HostInstant;
use firmware_protocol::array::{ArrayId, MotorSet};
use firmware_protocol::board::{Board, SelfTestState};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Counters, Cut, DeviceHello, Status};
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::Step;
use std::borrow::Cow;
use std::fmt::{Display, Formatter};

/// What the device decided about a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Queued in the device.
    Accepted,
    /// Dropped: it begins before `rendered`, the device's first free tick.
    Late {
        /// The first free tick.
        rendered: Tick,
        /// When the host first sent its frame.
        sent: HostInstant,
        /// Whether the host had to retransmit the frame.
        retransmitted: bool,
    },
    /// Refused for this reason.
    Refused(Refusal),
    /// Not taken, because the device keeps the strokes that it should have replaced.
    Superseded,
}

/// Why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LostReason {
    /// The device no longer answers pings.
    NoAnswer,
    /// Nothing answered the handshake.
    NoBoard,
    /// The device has forgotten the session.
    Restarted,
    /// The device speaks another protocol version.
    Version,
    /// The device is built for another array.
    WrongArray(AnotherArray),
    /// The line damages too many of the device's frames.
    Noisy {
        /// The share damaged, percent.
        percent: u8,
    },
    /// The device contradicts itself, last in this.
    Contradicts(Contradiction),
}

/// The array that a device is built for, which is not that of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnotherArray {
    /// The device's.
    pub device: ArrayId,
    /// The host's.
    pub array: ArrayId,
}

impl Display for AnotherArray {
    /// Names the first key that differs, and both values.
    fn fmt(&self, out: &mut Formatter<'_>) -> std::fmt::Result {
        let Self { device, array } = self;
        let share = |thousandths: u16| f64::from(thousandths) / 1e3;
        let (key, found, own) = if device.name != array.name {
            return write!(
                out,
                "the device is built for another array: its name is {}, this array is {}",
                device.name, array.name
            );
        } else if device.motors != array.motors {
            ("motors", device.motors.to_string(), array.motors.to_string())
        } else if device.tick_hz != array.tick_hz {
            ("tick_hz", device.tick_hz.to_string(), array.tick_hz.to_string())
        } else if device.duty_up != array.duty_up {
            ("duty.up", share(device.duty_up).to_string(), share(array.duty_up).to_string())
        } else if device.duty_down != array.duty_down {
            ("duty.down", share(device.duty_down).to_string(), share(array.duty_down).to_string())
        } else {
            ("the hash of its description", format!("{:016x}", device.hash), format!("{:016x}", array.hash))
        };
        let name = array.name;
        write!(out, "the device is built for another array: {key} is {found}, this array ({name}) has {own}")
    }
}

/// The whole text, what was found, and what to do.
macro_rules! text {
    ($found:literal, $advice:literal) => {
        (concat!($found, ": ", $advice), $found, $advice)
    };
}

/// The same of a line that damages this share of frames. `tests/noise.rs` shows what plays need.
macro_rules! noisy {
    ($share:literal) => {
        (
            concat!(
                "the line damages ",
                $share,
                " of the device's frames; plays need a fifth of them whole: use a shorter or shielded cable, away from motors"
            ),
            concat!("the line damages ", $share, " of the device's frames; plays need a fifth of them whole"),
            "use a shorter or shielded cable, away from motors",
        )
    };
}

/// The same of a device that contradicts itself.
macro_rules! contradicts {
    ($how:literal) => {
        (
            concat!(
                "the device contradicts itself, ",
                $how,
                ": power it off and on, and update its firmware"
            ),
            concat!("the device contradicts itself, ", $how),
            "power it off and on, and update its firmware",
        )
    };
}

impl LostReason {
    /// What was found and what to do, on one line.
    pub fn text(self) -> Cow<'static, str> {
        match self {
            Self::WrongArray(_) => format!("{}: {}", self.found(), self.advice()).into(),
            _ => self.texts().0.into(),
        }
    }

    /// What was found.
    pub fn found(self) -> Cow<'static, str> {
        match self {
            Self::WrongArray(arrays) => arrays.to_string().into(),
            _ => self.texts().1.into(),
        }
    }

    /// What to do.
    pub const fn advice(self) -> &'static str {
        self.texts().2
    }

    const fn texts(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::NoAnswer => text!("the device does not answer", "check its cable and power"),
            Self::NoBoard => text!(
                "the device does not answer as a board",
                "check that --device names the board, or power the board off and on"
            ),
            Self::Restarted => text!("the device has restarted", "check its power supply"),
            Self::Version => {
                text!("the device speaks another protocol version", "update its firmware or this program")
            }
            Self::WrongArray(_) => text!(
                "the device is built for another array",
                "build its firmware for this array, or choose the array that it has"
            ),
            Self::Noisy { percent: 99.. } => noisy!("99 % or more"),
            Self::Noisy { percent: 95.. } => noisy!("95 % or more"),
            Self::Noisy { percent: 90.. } => noisy!("90 % or more"),
            Self::Noisy { percent: 75.. } => noisy!("75 % or more"),
            Self::Noisy { percent: 50.. } => noisy!("50 % or more"),
            Self::Noisy { .. } => noisy!("many"),
            Self::Contradicts(how) => match how {
                Contradiction::Hello => contradicts!("its first message has values out of range"),
                Contradiction::Clock => contradicts!("its clock jumps"),
                Contradiction::Command => contradicts!("it answers a command that it was not sent"),
                Contradiction::Stream => contradicts!("it acknowledges strokes that it was not sent"),
                Contradiction::Credits => contradicts!("it reports more free stroke slots than it has"),
                Contradiction::Reports => contradicts!("reports that it announces do not come"),
                Contradiction::Report => contradicts!("it reports about strokes that it was not sent"),
                Contradiction::State => contradicts!("its state changes without a command"),
                Contradiction::Counters => contradicts!("its counts of bursts shrink or jump"),
                Contradiction::Board => contradicts!("its board report cannot be true"),
                Contradiction::Telemetry => contradicts!("it sends telemetry without having sensors"),
            },
        }
    }
}

/// What a session reports to its owner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The device answered the handshake.
    Opened(DeviceHello),
    /// The session is over; this is its last event.
    Lost(LostReason),
    /// The device contradicted itself, in this session for the first time in this way. The session ignored the message.
    Contradiction(Contradiction),
    /// The device carried a command out, or refused it.
    Control(Result<(), Refusal>),
    /// The device's status.
    Status {
        /// As sent.
        status: Status,
        /// The device's clock, widened.
        tick: Tick,
    },
    /// The device decided about a stroke.
    Step(Step, Verdict),
    /// The device has taken a frame that replaces strokes. Reported before the strokes of the frame.
    Replaced {
        /// The motors whose old strokes are withdrawn.
        motors: MotorSet,
        /// The motors whose old strokes stay, because the frame came too late for them.
        kept: MotorSet,
    },
    /// The device refused the first frame of a play, because a stroke in it would have been late. It took nothing.
    OnsetRefused {
        /// The device's first free tick.
        rendered: Tick,
    },
    /// The device accepted the first frame of a play.
    OnsetAccepted,
    /// The onset of a play or of a later item has passed, and its trigger was given.
    Onset {
        /// When.
        tick: Tick,
        /// The counters once everything before the onset was played.
        counters: Counters,
    },
    /// The device cut what ran and flushed its queue.
    Cut {
        /// As sent.
        cut: Cut,
        /// `cut.at`, widened.
        at: Tick,
    },
    /// The device has brought pins down by itself, in this tick or shortly after.
    Lowered {
        /// Motors of which a move down was late. The verdict on that move follows.
        late: MotorSet,
        /// Motors whose pins were held for too long.
        held: MotorSet,
        /// The first tick in which it did so.
        tick: Tick,
    },
    /// A rising edge of the trigger input.
    Edge {
        /// When it came.
        tick: Tick,
        /// Its number since the device started. A gap: edges that it did not report.
        number: u32,
    },
    /// The device refused a queued stroke when it should have begun.
    StrokeRefused {
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: Tick,
        /// Why.
        reason: Refusal,
    },
    /// How the device is, as it answered a request.
    Board(Board),
    /// A self-test is over, or was refused.
    SelfTest(SelfTestState),
    /// Displacements in 0.01 µm.
    Telemetry {
        /// When they were sampled.
        tick: Tick,
        /// Per motor.
        y: PerMotor<i32>,
        /// The events so far name each accepted stroke before this tick that the device has refused.
        known_to: Tick,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::Array;

    #[test]
    fn another_array_is_named_by_the_key_that_differs() {
        let array = *Array::paper().layout().id();
        let advice = ": build its firmware for this array, or choose the array that it has";
        for (device, line) in [
            (ArrayId { tick_hz: 70_000, ..array }, "tick_hz is 70000, this array (tula35-6x4) has 85000"),
            (ArrayId { motors: 9, ..array }, "motors is 9, this array (tula35-6x4) has 24"),
            (ArrayId { duty_down: 750, ..array }, "duty.down is 0.75, this array (tula35-6x4) has 0.8"),
        ] {
            let text = LostReason::WrongArray(AnotherArray { device, array }).text();
            assert_eq!(text, format!("the device is built for another array: {line}{advice}"));
        }
    }
}
