//! The messages: one enum per direction, whose variants are only ever appended.
//!
//! They are plain data; what they mean and which answer they get stands in the crate's documentation.
//! Ticks are [`WireTick`]s and widen at the reader. Counts are varints (postcard).

use crate::limits::{OnTimeLimits, Refusal};
use crate::stroke::{Direction, MOTORS};
use crate::tick::WireTick;
use serde::{Deserialize, Serialize};

/// From the host to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum HostMessage<'a> {
    /// Opens a session; `session` is a random number. Repeated until answered.
    Hello {
        /// Names the session: the same number again is a repetition.
        session: u32,
    },
    /// Keeps the lease, asks for a status.
    Ping {
        /// Comes back in the status; not 0.
        token: u16,
        /// Reports read so far, all before it included.
        seen: u16,
    },
    /// A command; begins the epoch it names. Repeated until a status names that epoch.
    Control {
        /// The epoch it begins.
        epoch: u16,
        /// As in `Ping`.
        seen: u16,
        /// What to do.
        op: Op,
    },
    /// The next frame of the ordered stream.
    Strokes {
        /// The epoch it belongs to; older ones are acknowledged and ignored.
        epoch: u16,
        /// Its number within the epoch, from 0.
        seq: u16,
        /// As in `Ping`.
        seen: u16,
        /// `base` is the onset of a play: all its strokes are taken or none, and the onset is reported.
        onset: bool,
        /// The tick from which `batch` counts.
        base: WireTick,
        /// Packed strokes (see [`crate::batch`]).
        batch: &'a [u8],
    },
    /// New pulse counts for queued bursts; outside the ordered stream, never repeated.
    Amend {
        /// The epoch of the strokes it amends.
        epoch: u16,
        /// Grows by one with each amendment message: the newest wins.
        generation: u16,
        /// The tick from which `items` count.
        base: WireTick,
        /// Packed amendments (see [`crate::batch`]).
        items: &'a [u8],
    },
}

/// What a `Control` asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Op {
    /// Return what pins are owed, then take strokes.
    Arm {
        /// Take every pin as being at rest: the position is known, nothing is owed.
        assume_rest: bool,
        /// Ticks without a valid frame after which the controller returns and disarms; at most 10 s.
        host_timeout: u32,
        /// A site's limits; the lower of these and the device's own count.
        limits: OnTimeLimits,
    },
    /// Return, then disarm, for this reason.
    Disarm(Cause),
    /// Return, stay armed.
    Stop,
    /// All lines off at once; latched.
    EStop,
    /// From faulted to disarmed.
    Reset,
    /// A burst of its own that shifts where a pin rests. Only armed and with nothing queued.
    Move {
        /// Which pin.
        motor: u8,
        /// Which way.
        direction: Direction,
        /// How far.
        pulses: u16,
    },
}

/// What the controller is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// Lines off, strokes refused.
    Disarmed,
    /// Takes strokes.
    Armed,
    /// Plays down what pins are owed; strokes are refused.
    Returning,
    /// Lines off until a reset.
    Faulted,
}

/// Why the controller is in its state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Cause {
    /// It has just started.
    Boot,
    /// The host asked for it: arm, disarm, reset.
    Request,
    /// The host stopped the play.
    Stop,
    /// The host's daemon ends.
    Shutdown,
    /// The host gave up a play because of late strokes.
    Abort,
    /// The host's emergency stop.
    EStop,
    /// No valid frame for the lease.
    HostTimeout,
    /// The cable was pulled, the port closed.
    LinkLost,
    /// Another session was opened.
    NewHost,
    /// The lines ran out of rendered ticks.
    Starved,
    /// The firmware panicked, or its core faulted.
    Panic,
    /// The firmware hung, and its watchdog restarted it.
    Watchdog,
}

/// From the device to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DeviceMessage {
    /// The answer to `Hello`, and to any frame of another protocol version.
    Hello(DeviceHello),
    /// A frame came before a `Hello`: the device has restarted.
    NoSession,
    /// After valid frames, and at every change of state.
    Status(Status),
    /// Something that must not be lost: repeated until seen.
    Report {
        /// Its number, from 1, wrapping.
        number: u16,
        /// What happened.
        report: Report,
    },
    /// Displacements of all pins, from a device that can sense them.
    Telemetry {
        /// When they were sampled.
        tick: WireTick,
        /// In 0.01 µm.
        y: [i32; MOTORS],
    },
}

/// Who the device is and what it can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeviceHello {
    /// The session it answers.
    pub session: u32,
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
    /// Hash of the firmware's build.
    pub build: [u8; 4],
    /// Random at every boot.
    pub boot: u32,
    /// Number of motors.
    pub motors: u8,
    /// Ticks per second.
    pub tick_hz: u32,
    /// Stroke slots.
    pub pool: u16,
    /// Ticks rendered ahead at the most.
    pub horizon: u8,
    /// Up pulses of a stroke at the most.
    pub max_up_pulses: u16,
    /// On-time limits of its own.
    pub limits: OnTimeLimits,
    /// Bit 0: simulated; bit 1: telemetry.
    pub features: u32,
    /// The device's clock, all 64 bits.
    pub tick: u64,
    /// The present epoch.
    pub epoch: u16,
    /// The number of the last report before this session's: its first has the next number.
    pub reports: u16,
    /// The last cut since boot, for a host that lost the link before it could read of it.
    pub last_cut: Option<Cut>,
}

impl DeviceHello {
    /// Feature bit: shafts are simulated.
    pub const SIMULATED: u32 = 1;
    /// Feature bit: sends telemetry while armed.
    pub const TELEMETRY: u32 = 2;
}

/// How the device stands: acknowledgement, clock, credits and counters in one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// Of the last `Ping`, in the first status after it; else 0. So its round trip is known.
    pub token: u16,
    /// Now.
    pub tick: WireTick,
    /// The present epoch: acknowledges the `Control` that began it.
    pub epoch: u16,
    /// How that control ended, if it was refused.
    pub refusal: Option<Refusal>,
    /// The next frame of the ordered stream it waits for: acknowledges all before it.
    pub next_seq: u16,
    /// Bit i: frame `next_seq + 1 + i` has come early and is kept.
    pub out_of_order: u8,
    /// Free stroke slots, after all frames before `next_seq`.
    pub credits: u16,
    /// Reports made so far.
    pub reports: u16,
    /// What it is doing.
    pub state: State,
    /// Why.
    pub cause: Cause,
    /// Whether it knows where the pins are.
    pub position_known: bool,
    /// Down pulses owed by all pins together.
    pub outstanding: u32,
    /// Since boot.
    pub counters: Counters,
}

/// What the controller has counted since boot. `bursts` are halves of strokes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Bursts of strokes that have ended, whole or cut.
    pub played: u64,
    /// Their pulses.
    pub pulses: u64,
    /// Bursts of accepted strokes that never began: flushed.
    pub dropped: u64,
    /// Bursts of strokes that came late.
    pub late: u64,
    /// Bursts of strokes refused.
    pub refused: u64,
    /// Played bursts whose count an amendment had changed.
    pub amended: u64,
    /// Amendments ignored: late, without a stroke, out of limits.
    pub amendments_ignored: u64,
    /// Frames that could not be read.
    pub bad_frames: u64,
    /// Reports lost because the host did not read them.
    pub reports_lost: u64,
}

impl Counters {
    /// Nothing yet.
    pub const NONE: Self = Self {
        played: 0,
        pulses: 0,
        dropped: 0,
        late: 0,
        refused: 0,
        amended: 0,
        amendments_ignored: 0,
        bad_frames: 0,
        reports_lost: 0,
    };
}

/// What must reach the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Report {
    /// A frame of strokes was not taken as a whole.
    Verdict {
        /// The frame.
        seq: u16,
        /// Bit i: its stroke i came late and was dropped.
        late: u64,
        /// Bit i: its stroke i was refused.
        refused: u64,
        /// Why (the first of them).
        reason: Option<Refusal>,
        /// The first tick that was not rendered yet: the earliest start.
        rendered: WireTick,
    },
    /// A play's first frame would have been late: nothing of it was taken.
    OnsetRefused {
        /// The frame.
        seq: u16,
        /// The first tick that was not rendered yet.
        rendered: WireTick,
    },
    /// A play's onset has passed.
    Onset {
        /// When.
        tick: WireTick,
        /// As they stood when all before the onset had been played.
        counters: Counters,
    },
    /// What ran was cut and the queue flushed.
    Cut(Cut),
    /// A queued stroke was refused as it should have begun: an on-time limit.
    Refused {
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: WireTick,
        /// Which limit.
        reason: Refusal,
    },
}

/// Where strokes were cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cut {
    /// Why.
    pub cause: Cause,
    /// The first tick at which nothing of the queue was played any more.
    pub at: WireTick,
    /// Whether pins are returned from here on; if not (e-stop, fault), they stay where they are.
    pub returns: bool,
    /// Strokes flushed whole.
    pub flushed: u16,
    /// Down pulses owed from here on.
    pub outstanding: u32,
}
