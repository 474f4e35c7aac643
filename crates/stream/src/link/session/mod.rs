//! One session with one device: its state, and what the streamer hands over. What the device says is read in
//! `inbound`, what is due is sent in `outbound`.

mod inbound;
mod line;
mod outbound;
mod probe;

use crate::link::Clock;
use crate::time::HostInstant;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::controller::{EARLY, REPORTS};
use firmware_protocol::frame::{Decoder, MAX_FRAME};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Counters, Cut, DeviceHello, Op, Report, Status};
use firmware_protocol::stroke::{MOTORS, Stroke};
use firmware_protocol::tick::Tick;
pub use line::{LineRate, RoundTrip, Traffic};
pub use probe::Budget;
use probe::Probe;
use std::collections::VecDeque;
use std::time::Duration;

/// Frames sent and not acknowledged, at the most: the one waited for and those the device keeps.
const WINDOW: usize = 1 + EARLY;
/// A lost frame is noticed after a few round trips, within these bounds.
const RETRY: (Duration, Duration) = (Duration::from_millis(3), Duration::from_millis(50));
/// Round trips asked for at once after the handshake, to set the clock.
const FIRST_PINGS: u32 = 8;
/// Pings that may be on their way at once and still be told apart.
const PINGS: usize = 64;
const FIRST_PING_EVERY: Duration = Duration::from_millis(2);
/// The device is lost when so many pings in a row, over so long, bring no answer.
const DEAF_PINGS: u32 = 5;
const DEAF_FOR: Duration = Duration::from_millis(400);
/// Pings after the first without an answer come this often.
const DOUBT_EVERY: Duration = Duration::from_millis(100);
/// Who waits for a status asks this often.
const ASK_EVERY: Duration = Duration::from_millis(1);
/// Hellos without an answer until the device is given up.
const HELLO_EVERY: Duration = Duration::from_millis(50);
const MAX_HELLOS: u32 = 40;

/// What became of a stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Queued in the device.
    Accepted,
    /// It began before `rendered`, the device's first free tick: dropped.
    Late {
        /// The first tick that was free.
        rendered: Tick,
        /// When its frame was sent first.
        sent: HostInstant,
        /// Whether the frame had to be sent again.
        retransmitted: bool,
    },
    /// Refused for this reason.
    Refused(Refusal),
}

/// Why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LostReason {
    /// No answer to pings.
    NoAnswer,
    /// No answer to the handshake.
    NoBoard,
    /// It has forgotten the session.
    Restarted,
    /// It speaks another protocol.
    Version,
    /// It is not the array this daemon drives.
    WrongArray,
}

/// The whole text, what was found, and what to do.
macro_rules! said {
    ($found:literal, $advice:literal) => {
        (concat!($found, ": ", $advice), $found, $advice)
    };
}

impl LostReason {
    /// On one line, for a person.
    #[must_use]
    pub const fn text(self) -> &'static str {
        self.said().0
    }

    /// Of that, what was found.
    #[must_use]
    pub const fn found(self) -> &'static str {
        self.said().1
    }

    /// And what to do.
    #[must_use]
    pub const fn advice(self) -> &'static str {
        self.said().2
    }

    const fn said(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::NoAnswer => said!("the device does not answer", "see its cable and power"),
            Self::NoBoard => said!(
                "what is there does not answer as a board",
                "see that --device names the board, or power it off and on"
            ),
            Self::Restarted => said!("the device has restarted", "see its power"),
            Self::Version => {
                said!("the device speaks another protocol version", "update its firmware or this program")
            }
            Self::WrongArray => {
                said!("the device's motors or tick rate are not this array's", "see its firmware")
            }
        }
    }
}

/// What the device said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The handshake is done.
    Opened(DeviceHello),
    /// The session is over; nothing more comes.
    Lost(LostReason),
    /// A control was carried out or refused.
    Control(Result<(), Refusal>),
    /// How the device stands.
    Status {
        /// As sent.
        status: Status,
        /// Its clock, widened.
        tick: Tick,
    },
    /// What became of a stroke.
    Stroke(Stroke, Verdict),
    /// The first frame of a play would have been late: nothing of it was taken.
    OnsetRefused {
        /// The device's first free tick.
        rendered: Tick,
    },
    /// The first frame of a play was taken.
    OnsetAccepted,
    /// The onset of a play has passed.
    Onset {
        /// When.
        tick: Tick,
        /// As they stood when all before it was played.
        counters: Counters,
    },
    /// What ran was cut, the queue flushed.
    Cut {
        /// As sent.
        cut: Cut,
        /// `cut.at`, widened.
        at: Tick,
    },
    /// A queued stroke was refused as it should have begun.
    StrokeRefused {
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: Tick,
        /// Why.
        reason: Refusal,
    },
    /// Displacements in 0.01 µm.
    Telemetry {
        /// When they were sampled.
        tick: Tick,
        /// Per motor.
        y: [i32; MOTORS],
    },
}

/// A frame of strokes from its first stroke to its verdict.
#[derive(Debug)]
struct Batch {
    seq: u16,
    onset: bool,
    strokes: Packer<BATCH_BYTES>,
    /// Bytes on the wire, when it was sent.
    len: usize,
    first_sent: Option<HostInstant>,
    last_sent: HostInstant,
    /// To be sent (again).
    due: bool,
    /// The device has it, but not those before it.
    kept: bool,
    retransmitted: bool,
}

#[derive(Debug)]
struct Control {
    op: Op,
    sent: Option<HostInstant>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Opening,
    Open,
    Over,
}

/// The host's end of one session.
#[derive(Debug)]
pub struct Session {
    phase: Phase,
    id: u32,
    /// The line's rate as its transport knows it; as it was measured, and how long an acknowledgement takes besides.
    nominal: LineRate,
    line: Option<(LineRate, Duration)>,
    window_bytes: usize,
    probe: Probe,
    decoder: Decoder,
    hellos: u32,
    clock: Clock,
    traffic: Traffic,

    epoch: u16,
    /// The epoch the session began with.
    greeted: u16,
    control: Option<Control>,
    window: VecDeque<Batch>,
    open_batch: Option<Batch>,
    next_seq: u16,
    /// Acknowledged by the device: all before.
    acked: u16,
    /// Its free slots, after the frames before `acked`.
    credits: usize,
    last_sent: Option<HostInstant>,
    amendments: Packer<BATCH_BYTES>,
    generation: u16,

    /// Reports read, all before included.
    seen: u16,
    /// Reports made, as far as known.
    made: u16,
    /// The tick of the newest status.
    newest: Tick,
    /// Verdicts up to this number belong to an epoch that is over.
    stale: u16,
    /// Verdicts that came before the acknowledgement.
    verdicts: VecDeque<Report>,

    token: u16,
    /// The last ping that was answered.
    answered: u16,
    /// The last pings and when they were sent: an answer may come after later ones have left.
    pinged: [(u16, HostInstant); PINGS],
    last_ping: HostInstant,
    ping_due: HostInstant,
    ping_every: Duration,
    first_pings: u32,
    unanswered: u32,
    first_unanswered: HostInstant,
    round_trip: Duration,
    /// The shortest round trip so far.
    fastest: Duration,
    trip: Option<RoundTrip>,
}

impl Session {
    /// A session over a line of this rate; `id` is a random number. It begins with the handshake.
    #[must_use]
    pub fn new(id: u32, rate: LineRate, now: HostInstant) -> Self {
        Self {
            phase: Phase::Opening,
            id,
            nominal: rate,
            line: None,
            window_bytes: rate.window_bytes(),
            probe: Probe::new(Budget::default()),
            decoder: Decoder::default(),
            hellos: 0,
            clock: Clock::default(),
            traffic: Traffic::default(),
            epoch: 0,
            greeted: 0,
            control: None,
            window: VecDeque::with_capacity(WINDOW + 1),
            open_batch: None,
            next_seq: 0,
            acked: 0,
            credits: 0,
            last_sent: None,
            amendments: Packer::new(Tick(0)),
            generation: 0,
            seen: 0,
            made: 0,
            newest: Tick(0),
            stale: 0,
            verdicts: VecDeque::with_capacity(REPORTS),
            token: 0,
            answered: 0,
            pinged: [(0, HostInstant::default()); PINGS],
            last_ping: HostInstant::default(),
            ping_due: now,
            ping_every: Duration::from_secs(1),
            first_pings: 0,
            unanswered: 0,
            first_unanswered: now,
            round_trip: RETRY.0,
            fastest: Duration::MAX,
            trip: None,
        }
    }

    /// The device's clock.
    #[must_use]
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Bytes and frames so far.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }

    /// The last round trip, once.
    pub fn take_round_trip(&mut self) -> Option<RoundTrip> {
        self.trip.take()
    }

    /// Whether the handshake is done, the clock is set and the session not over.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.phase == Phase::Open && self.first_pings >= FIRST_PINGS
    }

    /// Whether every control has been answered.
    #[must_use]
    pub fn is_answered(&self) -> bool {
        self.control.is_none() && self.seen == self.made
    }

    /// Whether the handshake is done and the session not over: commands can be sent.
    #[must_use]
    pub fn can_command(&self) -> bool {
        self.phase == Phase::Open
    }

    /// Keeps the lease with a ping at least this often.
    pub fn keep_alive_every(&mut self, every: Duration, now: HostInstant) {
        self.ping_every = every;
        self.ping_due = self.ping_due.min(now + every);
    }

    /// Asks for a status soon; may be called again and again until it comes.
    pub fn request_status(&mut self) {
        self.ping_due = self.ping_due.min(self.last_ping + ASK_EVERY);
    }

    /// Asks for a status within this time: free slots are told by statuses, and who has none sends nothing that brings one.
    pub fn request_status_within(&mut self, time: Duration) {
        self.ping_due = self.ping_due.min(self.last_ping + time);
    }

    /// Sends a command, in a new epoch, until it is answered. What was pushed before and has no verdict is forgotten.
    pub fn command(&mut self, op: Op) {
        self.epoch = self.epoch.wrapping_add(1);
        self.control = Some(Control { op, sent: None });
        self.window.clear();
        self.open_batch = None;
        self.verdicts.clear();
        (self.next_seq, self.acked, self.generation) = (0, 0, 0);
        self.amendments = Packer::new(Tick(0));
    }

    /// Begins a play: the next strokes go into a frame of their own that is taken whole or not at all.
    /// Nothing can be pushed after that frame is sealed until it is answered.
    pub fn begin(&mut self, onset: Tick) {
        self.seal();
        self.open_batch = Some(self.batch(onset, true));
    }

    fn batch(&self, base: Tick, onset: bool) -> Batch {
        let strokes = Packer::new(base);
        let seq = self.next_seq;
        let last_sent = HostInstant::default();
        Batch {
            seq,
            onset,
            strokes,
            len: 0,
            first_sent: None,
            last_sent,
            due: true,
            kept: false,
            retransmitted: false,
        }
    }

    /// How many strokes the device's credits still allow.
    #[must_use]
    pub fn credits(&self) -> usize {
        let open = self.open_batch.as_ref().map_or(0, |batch| batch.strokes.items());
        let out: usize = self.window.iter().map(|batch| batch.strokes.items()).sum();
        self.credits.saturating_sub(out + open)
    }

    /// Whether a frame may be begun: the window has room, and no onset waits for its verdict.
    #[must_use]
    pub fn has_room(&self) -> bool {
        self.control.is_none()
            && self.window.len() < WINDOW
            && !self.window.back().is_some_and(|batch| batch.onset)
    }

    /// Takes a stroke, not before the last one; `false` if it has to wait for credits, the window or an onset's verdict.
    pub fn push(&mut self, stroke: &Stroke) -> bool {
        if self.phase != Phase::Open || !self.has_room() || self.credits() == 0 {
            return false;
        }
        if let Some(batch) = &mut self.open_batch {
            if batch.strokes.stroke(stroke).is_ok() {
                return true;
            }
            self.seal();
            return self.push(stroke);
        }
        // What could not be sent yet takes more: on a link whose answers take long, frames get longer, not more.
        if let Some(last) = self.window.back_mut()
            && last.first_sent.is_none()
            && !last.onset
            && last.strokes.stroke(stroke).is_ok()
        {
            return true;
        }
        let mut batch = self.batch(stroke.up, false);
        let packed = batch.strokes.stroke(stroke).is_ok();
        self.open_batch = Some(batch);
        packed
    }

    /// Ends the frame begun: it can be sent. While it cannot, more strokes may be put into it, unless it is an onset's.
    pub fn seal(&mut self) {
        if let Some(batch) = self.open_batch.take() {
            self.next_seq = self.next_seq.wrapping_add(1);
            self.window.push_back(batch);
        }
    }

    /// Adds a new count for a queued burst to the next amendment message; `false` if that is full.
    pub fn amend(&mut self, amendment: &Amendment) -> bool {
        if self.amendments.items() == 0 {
            self.amendments = Packer::new(amendment.up);
        }
        self.amendments.amendment(amendment).is_ok()
    }

    fn retry_after(&self) -> Duration {
        let usual = (self.round_trip * 3).clamp(RETRY.0, RETRY.1);
        // What is on a slow line is late, not lost.
        let line = self.line().map_or(Duration::ZERO, |line| line.time(self.window_bytes + MAX_FRAME));
        usual.max(self.round_trip.min(RETRY.1) + line)
    }
}
