//! The messages of the protocol: [`HostMessage`] to the device, [`DeviceMessage`] from it.
//!
//! They are plain data. The crate's documentation says what they do and how they are answered. The reader widens a
//! [`WireTick`]; integers are varints (postcard). The order of fields and variants is the wire format: `tests/golden.rs`
//! keeps the bytes of this version.

use crate::array::{ArrayId, Layout, MotorSet};
use crate::board::{Board, SelfTestState};
use crate::limits::{PowerLimits, Refusal};
use crate::stroke::Direction;
use crate::tick::WireTick;
use core::fmt;
use serde::de::{Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// From the host to the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum HostMessage<'a> {
    /// Opens a session. Repeated until answered.
    Hello {
        /// A random number that names the session; the same number again is a repetition.
        session: u32,
    },
    /// Shows that the host is alive, and asks for a status.
    Ping {
        /// Comes back in the status. Not 0.
        token: u16,
        /// Number of the last report that the host has read; it has read all before it too.
        seen: u16,
    },
    /// A command that begins a new epoch. Repeated until a status names that epoch.
    Control {
        /// The epoch it begins.
        epoch: u16,
        /// As in `Ping`.
        seen: u16,
        /// The command.
        op: Op,
    },
    /// The next frame of the ordered stream.
    Moves {
        /// The epoch it belongs to. The device acknowledges and ignores other epochs.
        epoch: u16,
        /// Its number within the epoch, from 0.
        seq: u16,
        /// As in `Ping`.
        seen: u16,
        /// The mark at `base`, if the frame begins a play or a later item of it.
        mark: Option<Mark>,
        /// What the frame withdraws before its moves are queued, if it replaces moves.
        withdraw: Option<Withdraw>,
        /// The tick from which `batch` counts, and from which moves are withdrawn.
        base: WireTick,
        /// Packed moves (see [`crate::batch`]).
        batch: &'a [u8],
    },
    /// New pulse counts for queued moves. Outside the ordered stream, never repeated.
    Amend {
        /// The epoch of the moves it amends.
        epoch: u16,
        /// Grows by one with each amendment message; the newest wins.
        generation: u16,
        /// The tick from which `items` count.
        base: WireTick,
        /// Packed amendments (see [`crate::batch`]).
        items: &'a [u8],
    },
    /// Asks for a [`Board`] report. Repeated until answered.
    Board {
        /// A new number ends the time over which the report's `slack` is taken; the same number is a repetition.
        window: u16,
    },
    /// Asks for a self-test, or how far it is. Repeated until it is over.
    SelfTest {
        /// A new number begins a test if the device is disarmed; the same number asks how far it is.
        run: u16,
    },
}

/// The onset of a play or of one of its later items. The device reports it when it has passed ([`Report::Onset`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Mark {
    /// Whose onset it is.
    pub kind: MarkKind,
    /// What the trigger output does from this tick on.
    pub trigger: Option<Trigger>,
    /// Of a play: for how many ticks after its last pulse a pin may stay above rest, from this tick on. At most
    /// [`Layout::longest_hold`]; 0 is a fifth of a second.
    pub hold: u32,
}

/// The motors whose queued moves a frame replaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Withdraw {
    /// Those motors.
    pub motors: MotorSet,
    /// The generation of the host's last amendment. Amendments up to it do not concern moves queued from now on.
    pub generation: u16,
}

/// Whose onset a [`Mark`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum MarkKind {
    /// A play's: the device takes the frame as a whole or not at all.
    Play,
    /// A later item's: if the mark is late, the device refuses it alone and judges each move by itself.
    Item,
}

/// A pulse or a code on the trigger output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Trigger {
    /// Ticks of the pulse, or of each of the ten cells of a code; 0 counts as 1.
    pub width: u16,
    /// 0: one pulse. Otherwise a start cell (high), eight cells with the bits of the code, lowest first (high is 1), and a low
    /// cell: a serial frame with one start bit and one stop bit, idle low.
    pub code: u8,
}

impl Layout {
    /// A trigger of one pulse of 10 ms: long enough for an amplifier that samples at 200 Hz.
    pub const fn trigger_pulse(&self) -> Trigger {
        Trigger { width: (self.tick_hz() / 100) as u16, code: 0 }
    }
}

/// What a `Control` asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Op {
    /// Play the outstanding return pulses, then take moves.
    Arm {
        /// Treat every pin as at rest: the position is known, and no return pulses are outstanding.
        assume_rest: bool,
        /// Host watchdog timeout: the controller returns and disarms after this many ticks without a valid frame. At most 10 s.
        host_timeout: u32,
        /// The site's limits. The lower value of these and the device's own applies.
        limits: PowerLimits,
        /// The array's lower stop, if it has one.
        lower_stop: Option<LowerStop>,
    },
    /// Return, then disarm, for this reason.
    Disarm(Cause),
    /// Return, stay armed.
    Stop,
    /// Turn all lines off at once and latch.
    EStop,
    /// From faulted to disarmed.
    Reset,
    /// Shift the rest position of a pin by one burst. Only while armed with nothing queued.
    Move {
        /// The pin's motor.
        motor: u8,
        /// Direction of the burst.
        direction: Direction,
        /// Length of the burst.
        pulses: u16,
    },
    /// Drive all pins down to the lower stop by so many pulses: the position is known then. Only while armed with nothing queued.
    Seek {
        /// At least [`Layout::least_seek`](crate::array::Layout::least_seek), at most
        /// [`Layout::max_seek`](crate::array::Layout::max_seek).
        pulses: u16,
    },
}

/// What the controller may do against a lower stop: a plate below which no pin can go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LowerStop {
    /// Most pulses in a sliding second by which a motor may push against it.
    pub pulses_per_s: u32,
    /// Drive all pins down to the stop by so many pulses first, instead of the outstanding return pulses; 0: do not.
    pub seek: u16,
}

/// The state of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum State {
    /// Lines off; refuses moves.
    Disarmed,
    /// Takes moves.
    Armed,
    /// Plays outstanding return pulses, refuses moves.
    Returning,
    /// Lines off until a reset.
    Faulted,
}

/// Why the controller is in its state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Cause {
    /// The device has just started.
    Boot,
    /// The host asked for it by arm, disarm or reset.
    Request,
    /// The host stopped the play.
    Stop,
    /// The host's daemon ended.
    Shutdown,
    /// The host aborted a play because of late moves.
    Abort,
    /// The host's emergency stop.
    EStop,
    /// No valid frame for longer than the host watchdog timeout.
    HostTimeout,
    /// The cable was unplugged or the port closed.
    LinkLost,
    /// A host opened another session.
    NewHost,
    /// The lines ran out of rendered ticks.
    Starved,
    /// The firmware panicked or its core faulted.
    Panic,
    /// The firmware hung and its watchdog restarted it.
    Watchdog,
    /// The outputs stopped following what was rendered. The position is unknown, and only a restart of the device helps.
    Output,
}

/// From the device to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DeviceMessage {
    /// The answer to `Hello`, and to any frame of another protocol version.
    Hello(DeviceHello),
    /// The answer to a frame before `Hello`: the device has restarted.
    NoSession,
    /// The answer to a valid frame; also sent at every change of state.
    Status(Status),
    /// An event that must reach the host. Repeated until seen.
    Report {
        /// Its number, from 1, wrapping.
        number: u16,
        /// What happened.
        report: Report,
    },
    /// Displacements of some pins, from a device that senses them. A sample of more than [`MAX_SAMPLES`] pins takes several
    /// messages, in order.
    Telemetry {
        /// When they were sampled.
        tick: WireTick,
        /// The motor of the first one.
        first: u8,
        /// Per motor from that one on, in 0.01 µm.
        y: Samples,
    },
    /// The answer to `HostMessage::Board`.
    Board(Board),
    /// The answer to `HostMessage::SelfTest`; also sent when the test is over.
    SelfTest {
        /// The number of the test.
        run: u16,
        /// How far it is.
        state: SelfTestState,
    },
}

/// Most displacements in a message of telemetry: so many fit a frame, whatever they are.
pub const MAX_SAMPLES: usize = 32;

/// Displacements of a message of telemetry, at most [`MAX_SAMPLES`].
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Samples {
    len: u8,
    y: [i32; MAX_SAMPLES],
}

impl Samples {
    /// The first displacements of `y`, as many as fit a message.
    pub fn of(y: &[i32]) -> Self {
        let mut samples = Self { len: 0, y: [0; MAX_SAMPLES] };
        for (place, &y) in samples.y.iter_mut().zip(y) {
            *place = y;
            samples.len += 1;
        }
        samples
    }

    /// The displacements.
    pub fn as_slice(&self) -> &[i32] {
        self.y.get(..self.len.into()).unwrap_or_default()
    }
}

impl fmt::Debug for Samples {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_slice().fmt(out)
    }
}

impl Serialize for Samples {
    fn serialize<S: Serializer>(&self, out: S) -> Result<S::Ok, S::Error> {
        self.as_slice().serialize(out)
    }
}

impl<'de> Deserialize<'de> for Samples {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct List;
        impl<'de> Visitor<'de> for List {
            type Value = Samples;
            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(out, "at most {MAX_SAMPLES} displacements")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut from: A) -> Result<Samples, A::Error> {
                let mut samples = Samples::of(&[]);
                while let Some(y) = from.next_element()? {
                    let place = samples.y.get_mut(usize::from(samples.len));
                    *place.ok_or_else(|| A::Error::custom("too many displacements"))? = y;
                    samples.len += 1;
                }
                Ok(samples)
            }
        }
        from.deserialize_seq(List)
    }
}

/// What the device is and what it can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DeviceHello {
    /// The session that it answers.
    pub session: u32,
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
    /// Hash of the firmware's build.
    pub build: [u8; 4],
    /// Random at every boot.
    pub boot: u32,
    /// The array that it is built for.
    pub array: ArrayId,
    /// Slots for moves.
    pub pool: u16,
    /// A move that begins this many ticks from now, or later, is never late: the render horizon and the drivers' lead.
    pub horizon: u8,
    /// The highest level.
    pub max_up_pulses: u16,
    /// The device's own limits.
    pub limits: PowerLimits,
    /// The feature bits of this type; other bits are 0.
    pub features: u32,
    /// The device's clock, in 64 bits.
    pub tick: u64,
    /// The present epoch.
    pub epoch: u16,
    /// Number of the last report before this session; the session's first report has the next number.
    pub reports: u16,
    /// The last cut since boot, for a host that lost the link before it read the report.
    pub last_cut: Option<Cut>,
}

impl DeviceHello {
    /// Feature bit: shafts are simulated.
    pub const SIMULATED: u32 = 1;
    /// Feature bit: sends telemetry while armed.
    pub const TELEMETRY: u32 = 2;
    /// Feature bit: has a trigger input, whose edges it reports.
    pub const TRIGGER_INPUT: u32 = 4;
    /// Feature bit: has no trigger output. Its trigger pin may be the input.
    pub const NO_TRIGGER_OUTPUT: u32 = 8;
}

/// The device's status: acknowledgement, clock, credits and counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Status {
    /// Token of the last `Ping`, in the first status after it; else 0. The host measures round trips with it.
    pub token: u16,
    /// The device's clock.
    pub tick: WireTick,
    /// The present epoch; acknowledges the `Control` that began it.
    pub epoch: u16,
    /// Why that control was refused, if it was.
    pub refusal: Option<Refusal>,
    /// The frame of the ordered stream that the device waits for; acknowledges all before it.
    pub next_seq: u16,
    /// Bit i: frame `next_seq + 1 + i` arrived out of order and is buffered.
    pub out_of_order: u8,
    /// Free slots for moves after all frames before `next_seq`, less the refused moves whose report is not seen.
    pub credits: u16,
    /// Reports made so far.
    pub reports: u16,
    /// The state of the controller.
    pub state: State,
    /// Why it is in that state.
    pub cause: Cause,
    /// Whether the device knows where the pins are.
    pub position_known: bool,
    /// Outstanding return pulses of all pins together.
    pub outstanding: u32,
    /// Counts since boot.
    pub counters: Counters,
}

/// Counts of the controller since boot. Each move taken is counted once: as played, dropped, late, refused or replaced. In a status they
/// are those of the ticks before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Counters {
    /// Moves that have begun, with those that take no slot because their pin is at rest.
    pub played: u64,
    /// Pulses of all lines.
    pub pulses: u64,
    /// Accepted moves that were flushed before they began, or were rendered and not played because of an e-stop or a fault.
    pub dropped: u64,
    /// Late moves.
    pub late: u64,
    /// Moves refused in their frame or as they were to begin.
    pub refused: u64,
    /// Accepted moves that were withdrawn before they began, and moves not taken because a motor's old ones stay.
    pub replaced: u64,
    /// Begun moves whose number of pulses an amendment changed.
    pub amended: u64,
    /// Begun moves before which the pin had not come to its goal. A move to the goal, without a surplus, is none of them.
    pub shortened: u64,
    /// Amendments ignored: too late, without a move, of a move that changes nothing, or out of limits.
    pub amendments_ignored: u64,
    /// Bad frames received (see the crate's documentation).
    pub bad_frames: u64,
    /// Reports lost because the host did not read those before them.
    pub reports_lost: u64,
}

impl Counters {
    /// All zero.
    pub const NONE: Self = Self {
        played: 0,
        pulses: 0,
        dropped: 0,
        late: 0,
        refused: 0,
        replaced: 0,
        amended: 0,
        shortened: 0,
        amendments_ignored: 0,
        bad_frames: 0,
        reports_lost: 0,
    };
}

/// An event that must reach the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Report {
    /// Some moves of a frame were not accepted, or a motor's old moves were not withdrawn.
    Verdict {
        /// The frame's number.
        seq: u16,
        /// Bit i: move i was late and dropped, or not taken because its motor is kept.
        late: u64,
        /// Bit i: move i was refused.
        refused: u64,
        /// Motors of which nothing was withdrawn. Their queued moves stay, and those of the frame are not taken (bits of `late`).
        kept: MotorSet,
        /// Why the first of the refused moves was refused.
        reason: Option<Refusal>,
        /// The earliest possible start when the device judged the first late move or kept the first motor. The device judges
        /// the moves of a long frame one after the other, so a later one may begin after this tick and be late.
        rendered: WireTick,
    },
    /// A mark was late. If it was a play's, nothing of its frame was taken.
    OnsetRefused {
        /// The frame's number.
        seq: u16,
        /// The first tick not rendered yet.
        rendered: WireTick,
    },
    /// A mark has passed, and its trigger began at its tick.
    Onset {
        /// The mark's tick.
        tick: WireTick,
        /// Counts at the onset.
        counters: Counters,
    },
    /// The queues were flushed, and pins come down or stay where they are.
    Cut(Cut),
    /// A queued move up was refused when it was to begin, because of a limit.
    Refused {
        /// The move's motor.
        motor: u8,
        /// The move's tick.
        tick: WireTick,
        /// The limit.
        reason: Refusal,
    },
    /// The device brings pins down by itself. A motor may be in both sets.
    Lowered {
        /// The first tick in which it may have done so.
        tick: WireTick,
        /// Motors of which a move down was late.
        late: MotorSet,
        /// Motors whose pins were held for too long.
        held: MotorSet,
    },
    /// A rising edge of the trigger input.
    Edge {
        /// When it came.
        tick: WireTick,
        /// Its number since boot, from 1, wrapping. A gap: edges that were not reported.
        number: u32,
    },
}

/// When and why the queues were flushed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Cut {
    /// The reason.
    pub cause: Cause,
    /// The first tick in which nothing of the queue was played.
    pub at: WireTick,
    /// How many ticks after `at` the pins are back, with the last pulse of the return. `None`: they stay where they are, after an
    /// e-stop or a fault.
    pub return_ticks: Option<u32>,
    /// Moves flushed before they began, and moves that were rendered and not played.
    pub flushed: u16,
    /// Outstanding return pulses at this tick.
    pub outstanding: u32,
}
