//! One session with one device: it routes between parts that own what they decide.
//!
//! | part | owns |
//! |---|---|
//! | `wire` | bytes become messages; what is counted of both |
//! | `line` | what the line carries: the `probe`, its `rate`, the `quality` of long frames |
//! | `pinger` | pings, round trips, the device's clock |
//! | `commands` | epochs, the command under way, e-stops |
//! | `outbox` | frames of strokes (`batch`) until their verdicts, those that a command `retired`, amendments |
//! | `reports` | the order of the device's reports, and what is decided once they are read |
//! | `bounds` | what is known of the device, and whether what it says can be true |
//! | `contradiction` | whether the device is trusted |
//! | `telemetry` | samples that came in parts |
//! | `board` | requests for the board report and the self-test |
//!
//! The streamer pushes strokes, amendments and commands into a [`Session`]. `outbound` writes the frame that is due, `inbound`
//! passes what the device says to the parts; the session reports both as [`Event`]s. No part knows another: the session passes
//! values.
//!
//! Invariant: a session is opening, open, closing and over, in this order, and takes strokes only while it is open.

mod batch;
mod board;
mod bounds;
mod commands;
mod contradiction;
mod event;
mod inbound;
mod line;
mod outbound;
mod outbox;
mod pinger;
mod probe;
mod quality;
mod rate;
mod repetition;
mod reports;
mod retired;
mod telemetry;
mod wire;

pub use contradiction::{Contradiction, Contradictions};
pub use event::{AnotherArray, Event, LostReason, Verdict};
pub use pinger::RoundTrip;
pub use probe::Budget;
pub use rate::LineRate;
pub use wire::{BadFrames, Traffic};

use crate::link::clock::Clock;
use crate::link::session::board::BoardRequests;
use crate::link::session::bounds::DeviceKnowledge;
use crate::link::session::commands::Commands;
use crate::link::session::contradiction::Trust;
use crate::link::session::line::Line;
use crate::link::session::outbox::Outbox;
use crate::link::session::pinger::Pinger;
use crate::link::session::repetition::Repetition;
use crate::link::session::reports::Reports;
use crate::link::session::telemetry::Telemetry;
use crate::link::session::wire::Wire;
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::Amendment;
use firmware_protocol::message::{Mark, MarkKind, Op, Trigger};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Step;
use std::time::Duration;

/// Interval of the hellos without an answer.
const HELLO_EVERY: Duration = Duration::from_millis(50);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Opening,
    Open,
    /// The device is not trusted: the session repeats an e-stop, and reads nothing.
    Closing(Contradiction),
    Over,
}

/// The host's end of one session.
#[derive(Clone, Debug)]
pub struct Session {
    phase: Phase,
    id: u32,
    hellos: Repetition,
    wire: Wire,
    line: Line,
    pinger: Pinger,
    commands: Commands,
    outbox: Outbox,
    reports: Reports,
    known: DeviceKnowledge,
    telemetry: Telemetry,
    trust: Trust,
    asking: BoardRequests,
}

impl Session {
    /// A session with a device of this array, over a line of this rate; `id` is a random number. It begins with the handshake.
    pub fn new(array: Array, id: u32, rate: LineRate, now: HostInstant) -> Self {
        Self {
            phase: Phase::Opening,
            id,
            hellos: Repetition::new(HELLO_EVERY),
            wire: Wire::default(),
            line: Line::new(rate),
            pinger: Pinger::new(array.rate(), now),
            commands: Commands::new(),
            outbox: Outbox::new(),
            reports: Reports::new(),
            known: DeviceKnowledge::new(array),
            telemetry: Telemetry::new(array),
            trust: Trust::default(),
            asking: BoardRequests::new(now),
        }
    }

    /// The device's clock.
    pub fn clock(&self) -> &Clock {
        self.pinger.clock()
    }

    /// Bytes and frames so far.
    pub fn traffic(&self) -> Traffic {
        self.wire.traffic()
    }

    /// The last round trip; each is returned once.
    pub fn take_round_trip(&mut self) -> Option<RoundTrip> {
        self.pinger.take_round_trip()
    }

    /// Whether the link probe is over; before that, the line's rate is unknown.
    pub fn is_probed(&self) -> bool {
        self.line.probe.is_over()
    }

    /// Whether the link probe has measured nothing, and it is time to probe again: the host stood still, or the device did not answer.
    /// Until something is measured, the line counts as what its transport says, and no play is refused because of it.
    pub fn wants_probe(&self, now: HostInstant) -> bool {
        self.line.wants_probe(now)
    }

    /// Probes the line again with this budget, for a closer measurement. Not while a play runs.
    pub fn probe(&mut self, budget: Budget) {
        self.line.probe(budget);
    }

    /// Bytes per second of full frames that the device acknowledges: the line's rate, or less where the host waits for
    /// acknowledgements because few bytes may be unacknowledged. `None` until measured.
    pub fn capacity(&self) -> Option<u32> {
        self.line.capacity()
    }

    /// Bytes per second that the line carries while nothing waits, and the part of its time in which so many frames a second,
    /// however short, wait for acknowledgements: more than 1 if it does not carry them. `None` until measured.
    pub fn rate_beside(&self, frames_per_s: u32) -> Option<(u32, f64)> {
        self.line.rate_beside(frames_per_s)
    }

    /// How long a frame that is sent now takes to the device, with those that are not acknowledged before it.
    pub fn delivery(&self) -> Duration {
        self.line.delivery(self.outbox.bytes_under_way(), self.pinger.shortest())
    }

    /// How long a frame waits, besides its bytes' time, until the device has acknowledged the frames before it.
    pub fn ack_wait(&self) -> Option<Duration> {
        self.line.ack_wait()
    }

    /// Whether the session takes plays: the handshake is done, the clock is set and the session is not over.
    pub fn is_open(&self) -> bool {
        self.phase == Phase::Open && self.pinger.is_set()
    }

    /// Whether the device answered every command, and the session read every report.
    pub fn is_answered(&self) -> bool {
        !self.commands.is_waiting() && self.reports.are_complete()
    }

    /// The session knows which of the accepted strokes before this tick the device has refused as they began.
    pub fn known_to(&self) -> Tick {
        self.reports.concluded().tick
    }

    /// Whether the session takes commands: the handshake is done and the session is not over.
    pub fn can_command(&self) -> bool {
        self.phase == Phase::Open
    }

    /// When an e-stop first left for the device, if the device has not answered it.
    pub fn e_stopped_at(&self) -> Option<HostInstant> {
        self.commands.e_stopped_at()
    }

    /// Pings at least this often, so that the device's host watchdog does not time out.
    pub fn keep_alive_every(&mut self, every: Duration, now: HostInstant) {
        self.pinger.keep_alive_every(every, now);
    }

    /// Asks for a status soon. Callers may repeat it until the status comes.
    pub fn request_status(&mut self) {
        self.pinger.hasten();
    }

    /// Asks for a status within this time. Statuses report free slots; a host without credits sends nothing else that
    /// would bring one.
    pub fn request_status_within(&mut self, time: Duration) {
        self.pinger.hasten_within(time);
    }

    /// Asks for a board report now. Returns the number of the request, whose answer covers the time before it was sent.
    pub fn ask_board(&mut self) -> u16 {
        self.asking.ask()
    }

    /// Begins a self-test, and asks until it is over ([`Event::SelfTest`]).
    pub fn ask_self_test(&mut self) {
        self.asking.ask_test();
    }

    /// Sends a command in a new epoch, until the device answers. Of strokes that have no verdict yet, the session emits
    /// only the verdicts late and refused, as the device reports them.
    pub fn command(&mut self, op: Op) {
        // While another command waits, the frames that may still be judged are those that it ended.
        let retires = (!self.commands.is_waiting()).then(|| self.reports.stale());
        self.known.command(&op);
        self.commands.begin(op);
        self.outbox.begin_epoch(retires);
        self.reports.begin_epoch();
    }

    /// The epoch of an e-stop that has become due, once: for a device that takes it past the bytes that wait
    /// ([`crate::device::Device::e_stop`]). Its frame is sent as well.
    #[must_use]
    pub fn take_e_stop(&mut self) -> Option<u16> {
        match self.phase {
            Phase::Opening | Phase::Over => None,
            Phase::Open | Phase::Closing(_) => self.commands.take_e_stop(),
        }
    }

    /// Begins a play: the next strokes go into a frame of their own, which the device takes whole or not at all.
    /// Once that frame is sealed, nothing can be pushed until the device answers it. After `hold` ticks above rest without a pulse, the
    /// device lowers a pin; its own bound may be lower.
    pub fn begin(&mut self, onset: Tick, trigger: Option<Trigger>, hold: u32) {
        self.outbox.begin(onset, Mark { kind: MarkKind::Play, trigger, hold });
    }

    /// Marks the onset of a later item of a play: the next strokes go into a frame of their own. The device reports the mark
    /// when it has passed.
    pub fn mark(&mut self, onset: Tick, trigger: Option<Trigger>, hold: u32) {
        self.outbox.begin(onset, Mark { kind: MarkKind::Item, trigger, hold });
    }

    /// Withdraws what these motors have queued from `from` on. The strokes pushed next take their place, each motor's from its
    /// first on; no stroke follows for the motors `silent`. They go into frames of their own. Call it again only after the answer
    /// to the last such frame.
    pub fn replace(&mut self, from: Tick, motors: MotorSet, silent: MotorSet) {
        self.outbox.replace(from, motors, silent);
    }

    /// Moves that the device's credits still allow.
    pub fn credits(&self) -> usize {
        self.outbox.credits()
    }

    /// Whether a frame may be begun: the window has room, and neither a command nor an onset waits for its answer.
    pub fn has_room(&self) -> bool {
        self.phase == Phase::Open && !self.commands.is_waiting() && self.outbox.has_room()
    }

    /// Takes a step that does not begin before the last one; `false` if it must wait for credits, the window or an
    /// onset's verdict.
    pub fn push(&mut self, step: &Step) -> bool {
        self.has_room() && self.outbox.push(step, self.line.quality.frame_bytes)
    }

    /// Ends the open frame, so that it can be sent. While it waits, it takes more strokes, unless it has a mark.
    pub fn seal(&mut self) {
        self.outbox.seal();
    }

    /// Adds a corrected pulse count for a queued burst to the next amendment message; `false` if that is full.
    pub fn amend(&mut self, amendment: &Amendment) -> bool {
        self.outbox.amend(amendment)
    }

    /// Closes the link to a device that cannot be trusted: turns its lines off first.
    pub fn distrust(&mut self, how: Contradiction, emit: &mut dyn FnMut(Event)) {
        match self.phase {
            Phase::Opening => self.lose(LostReason::Contradicts(how), emit),
            Phase::Open => {
                self.phase = Phase::Closing(how);
                self.commands.close();
                self.outbox.drop_frames();
            }
            Phase::Closing(_) | Phase::Over => {}
        }
    }

    fn lose(&mut self, reason: LostReason, emit: &mut dyn FnMut(Event)) {
        if self.phase != Phase::Over {
            self.phase = Phase::Over;
            emit(Event::Lost(reason));
        }
    }
}
