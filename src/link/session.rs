//! One session with one device: see the module above.

use crate::link::Clock;
use crate::units::HostInstant;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer, Strokes};
use firmware_protocol::frame::{self, Decoder, FrameError, MAX_FRAME};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{
    Counters, Cut, DeviceHello, DeviceMessage, HostMessage, Op, Report, Status,
};
use firmware_protocol::stroke::{MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use std::collections::VecDeque;
use std::time::Duration;

/// Frames sent and not acknowledged, at the most.
const WINDOW: usize = 16;
/// A lost frame is noticed after a few round trips, within these bounds.
const RETRY: (Duration, Duration) = (Duration::from_millis(3), Duration::from_millis(50));
/// Round trips asked for at once after the handshake, to set the clock.
const FIRST_PINGS: u32 = 8;
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
        again: bool,
    },
    /// Refused for this reason.
    Refused(Refusal),
}

/// Why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LostReason {
    /// No answer to the handshake, or to pings.
    #[error("the device does not answer")]
    NoAnswer,
    /// It has forgotten the session.
    #[error("the device has restarted")]
    Restarted,
    /// It speaks another protocol.
    #[error("the device speaks another protocol version: update its firmware or this daemon")]
    Version,
    /// It is not the array this daemon drives.
    #[error("the device's motors or tick rate are not this array's")]
    WrongArray,
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
    OnsetTaken,
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

/// How fast bytes leave on the line, bytes per second: bounds what may wait in buffers we cannot reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineRate(pub u32);

impl LineRate {
    /// Bytes that may be on their way: 2 ms of the line, at least one frame.
    fn window_bytes(self) -> usize {
        (self.0 as usize / 500).max(MAX_FRAME)
    }
}

/// Bytes and frames since the session began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes sent, all overhead included.
    pub bytes_out: u64,
    /// Bytes received.
    pub bytes_in: u64,
    /// Frames sent again.
    pub again: u64,
    /// Frames received that could not be read.
    pub bad: u64,
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
    again: bool,
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
    window_bytes: usize,
    decoder: Decoder,
    hello: Option<DeviceHello>,
    hellos: u32,
    clock: Clock,
    traffic: Traffic,

    epoch: u16,
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
    /// Verdicts up to this number belong to an epoch that is over.
    stale: u16,
    /// Verdicts that came before the acknowledgement.
    verdicts: VecDeque<Report>,

    token: u16,
    /// When the ping was sent that waits for its answer.
    pinged: Option<HostInstant>,
    last_ping: HostInstant,
    ping_due: HostInstant,
    ping_every: Duration,
    first_pings: u32,
    unanswered: u32,
    first_unanswered: HostInstant,
    round_trip: Duration,
}

impl Session {
    /// A session over a line of this rate; `id` is a random number. It begins with the handshake.
    #[must_use]
    pub fn new(id: u32, rate: LineRate, now: HostInstant) -> Self {
        Self {
            phase: Phase::Opening,
            id,
            window_bytes: rate.window_bytes(),
            decoder: Decoder::default(),
            hello: None,
            hellos: 0,
            clock: Clock::default(),
            traffic: Traffic::default(),
            epoch: 0,
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
            stale: 0,
            verdicts: VecDeque::with_capacity(firmware_protocol::controller::REPORTS),
            token: 0,
            pinged: None,
            last_ping: HostInstant::default(),
            ping_due: now,
            ping_every: Duration::from_secs(1),
            first_pings: 0,
            unanswered: 0,
            first_unanswered: now,
            round_trip: RETRY.0,
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

    /// Whether the handshake is done, the clock is set and the session not over.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.phase == Phase::Open && self.first_pings >= FIRST_PINGS
    }

    /// Whether every control has been answered.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.control.is_none() && self.seen == self.made
    }

    /// Whether every stroke pushed has its verdict.
    #[must_use]
    pub fn is_drained(&self) -> bool {
        self.window.is_empty() && self.open_batch.is_none()
    }

    /// Keeps the lease with a ping at least this often.
    pub fn ping_every(&mut self, every: Duration, now: HostInstant) {
        self.ping_every = every;
        self.ping_due = self.ping_due.min(now + every);
    }

    /// Asks for a status soon; may be called again and again until it comes.
    pub fn ask(&mut self) {
        self.ping_due = self.ping_due.min(self.last_ping + ASK_EVERY);
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
        Batch { seq, onset, strokes, len: 0, first_sent: None, last_sent, due: true, again: false }
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
        let mut batch = self.batch(stroke.up, false);
        let packed = batch.strokes.stroke(stroke).is_ok();
        self.open_batch = Some(batch);
        packed
    }

    /// Ends the frame begun: it is sent as it is.
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

    /// Takes bytes from the device.
    pub fn receive(&mut self, now: HostInstant, mut bytes: &[u8], tell: &mut dyn FnMut(Event)) {
        self.traffic.bytes_in += bytes.len() as u64;
        let mut decoder = std::mem::take(&mut self.decoder);
        while let Some(body) = decoder.next(&mut bytes) {
            let message = body.and_then(|body| match postcard::take_from_bytes(body) {
                Ok((message, [])) => Ok(message),
                _ => Err(FrameError::Malformed),
            });
            match message {
                Ok(message) if self.phase != Phase::Over => self.handle(now, message, tell),
                Ok(_) => {}
                Err(FrameError::Version(_)) => self.lose(LostReason::Version, tell),
                Err(_) => self.traffic.bad += 1,
            }
        }
        self.decoder = decoder;
    }

    fn lose(&mut self, reason: LostReason, tell: &mut dyn FnMut(Event)) {
        if self.phase != Phase::Over {
            self.phase = Phase::Over;
            tell(Event::Lost(reason));
        }
    }

    fn handle(&mut self, now: HostInstant, message: DeviceMessage, tell: &mut dyn FnMut(Event)) {
        self.unanswered = 0;
        let near = |tick: firmware_protocol::tick::WireTick, clock: &Clock| {
            clock.tick_at(now).map_or(Tick(0), |now| tick.near(now))
        };
        match message {
            DeviceMessage::Hello(hello) => self.opened(now, hello, tell),
            _ if self.phase == Phase::Opening => {}
            DeviceMessage::NoSession => self.lose(LostReason::Restarted, tell),
            DeviceMessage::Status(status) => self.status(now, status, tell),
            DeviceMessage::Report { number, report } => {
                // In order: what comes after a gap is sent again.
                if number == self.seen.wrapping_add(1) {
                    self.seen = number;
                    if self.made.wrapping_sub(number) > u16::MAX / 2 {
                        self.made = number;
                    }
                    self.report(now, number, report, tell);
                    self.conclude(now, tell);
                }
            }
            DeviceMessage::Telemetry { tick, y } => {
                tell(Event::Telemetry { tick: near(tick, &self.clock), y });
            }
        }
    }

    fn opened(&mut self, now: HostInstant, hello: DeviceHello, tell: &mut dyn FnMut(Event)) {
        if self.phase != Phase::Opening || hello.session != self.id {
            return;
        }
        if usize::from(hello.motors) != MOTORS || hello.tick_hz != firmware_protocol::tick::TICK_HZ {
            self.lose(LostReason::WrongArray, tell);
            return;
        }
        self.phase = Phase::Open;
        self.epoch = hello.epoch;
        (self.seen, self.made, self.stale) = (hello.reports, hello.reports, hello.reports);
        self.credits = 0;
        self.hello = Some(hello);
        // The hello's tick widens those of the first statuses; its round trip counts for little.
        let sent = self.last_sent.unwrap_or(now);
        self.clock.round_trip(sent, Tick(hello.tick), now);
        self.ping_due = now;
        tell(Event::Opened(hello));
    }

    fn status(&mut self, now: HostInstant, status: Status, tell: &mut dyn FnMut(Event)) {
        let Some(host_tick) = self.clock.tick_at(now) else { return };
        let tick = status.tick.near(host_tick);
        if let Some(sent) = self.pinged.take_if(|_| status.token == self.token) {
            self.clock.round_trip(sent, tick, now);
            self.round_trip = (self.round_trip * 7 + now.since(sent)) / 8;
            self.first_pings += 1;
        }
        let ahead = status.reports.wrapping_sub(self.made);
        if ahead < u16::MAX / 2 {
            self.made = status.reports;
        }
        if status.epoch == self.epoch {
            if let Some(control) = self.control.take_if(|control| control.sent.is_some()) {
                if matches!(control.op, Op::Arm { .. }) {
                    self.ping_due = now;
                }
                self.stale = status.reports;
                tell(Event::Control(status.refusal.map_or(Ok(()), Err)));
            }
            // An old status, overtaken by a newer one, acknowledges nothing new.
            if status.next_seq.wrapping_sub(self.acked) < u16::MAX / 2 {
                self.acked = status.next_seq;
                self.credits = status.credits.into();
            }
        }
        tell(Event::Status { status, tick });
        self.conclude(now, tell);
    }

    fn report(&mut self, now: HostInstant, number: u16, report: Report, tell: &mut dyn FnMut(Event)) {
        let Some(now) = self.clock.tick_at(now) else { return };
        match report {
            Report::Verdict { .. } | Report::OnsetRefused { .. } => {
                let stale = self.stale.wrapping_sub(number) < u16::MAX / 2;
                if self.control.is_none() && !stale {
                    self.verdicts.push_back(report);
                }
            }
            Report::Onset { tick, counters } => tell(Event::Onset { tick: tick.near(now), counters }),
            Report::Cut(cut) => tell(Event::Cut { cut, at: cut.at.near(now) }),
            Report::Refused { motor, up, reason } => {
                tell(Event::StrokeRefused { motor, up: up.near(now), reason });
            }
        }
    }

    /// Tells the verdicts of acknowledged frames, once all reports that the acknowledgement counts are read.
    fn conclude(&mut self, now: HostInstant, tell: &mut dyn FnMut(Event)) {
        if self.seen != self.made {
            return;
        }
        let Some(tick) = self.clock.tick_at(now) else { return };
        while let Some(batch) = self.window.front() {
            let decided = self.acked.wrapping_sub(batch.seq);
            if decided == 0 || decided > u16::MAX / 2 {
                break;
            }
            let Some(batch) = self.window.pop_front() else { break };
            let strokes = Strokes::new(batch.strokes.base(), batch.strokes.bytes()).flatten();
            let (mut late_mask, mut refused_mask, mut why, mut free) = (0, 0, Refusal::Malformed, tick);
            match self.verdicts.front().copied() {
                Some(Report::OnsetRefused { seq, rendered }) if seq == batch.seq => {
                    self.verdicts.pop_front();
                    tell(Event::OnsetRefused { rendered: rendered.near(tick) });
                    continue;
                }
                Some(Report::Verdict { seq, late, refused, reason, rendered }) if seq == batch.seq => {
                    self.verdicts.pop_front();
                    (late_mask, refused_mask) = (late, refused);
                    why = reason.unwrap_or(why);
                    free = rendered.near(tick);
                }
                _ => {}
            }
            if batch.onset {
                tell(Event::OnsetTaken);
            }
            for (i, stroke) in strokes.enumerate() {
                let verdict = if late_mask >> i & 1 == 1 {
                    let sent = batch.first_sent.unwrap_or(now);
                    Verdict::Late { rendered: free, sent, again: batch.again }
                } else if refused_mask >> i & 1 == 1 {
                    Verdict::Refused(why)
                } else {
                    Verdict::Accepted
                };
                tell(Event::Stroke(stroke, verdict));
            }
        }
    }

    fn retry_after(&self) -> Duration {
        (self.round_trip * 3).clamp(RETRY.0, RETRY.1)
    }

    /// Writes the next frame that is due into `out` and returns its length; 0 when none is.
    pub fn transmit(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        tell: &mut dyn FnMut(Event),
    ) -> usize {
        let len = match self.phase {
            Phase::Opening => self.next_hello(now, out, tell),
            Phase::Open => self.next_frame(now, out, tell),
            Phase::Over => 0,
        };
        self.traffic.bytes_out += len as u64;
        len
    }

    fn next_hello(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        tell: &mut dyn FnMut(Event),
    ) -> usize {
        if self.last_sent.is_some_and(|sent| now.since(sent) < HELLO_EVERY) {
            return 0;
        }
        if self.hellos == MAX_HELLOS {
            self.lose(LostReason::NoAnswer, tell);
            return 0;
        }
        self.hellos += 1;
        self.last_sent = Some(now);
        // A zero first ends whatever half a frame the device has from before.
        out[0] = 0;
        1 + written(&HostMessage::Hello { session: self.id }, &mut out[1..])
    }

    fn next_frame(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        tell: &mut dyn FnMut(Event),
    ) -> usize {
        let (epoch, seen, retry) = (self.epoch, self.seen, self.retry_after());
        if let Some(control) = &mut self.control
            && control.sent.is_none_or(|sent| now.since(sent) >= retry)
        {
            self.traffic.again += u64::from(control.sent.is_some());
            control.sent = Some(now);
            return written(&HostMessage::Control { epoch, seen, op: control.op }, out);
        }
        if self.amendments.items() > 0 && self.control.is_none() {
            self.generation = self.generation.wrapping_add(1);
            let (generation, base) = (self.generation, self.amendments.base().wire());
            let items = self.amendments.bytes();
            let len = written(&HostMessage::Amend { epoch, generation, base, items }, out);
            self.amendments = Packer::new(Tick(0));
            return len;
        }
        if let Some(len) = self.next_batch(now, out) {
            return len;
        }
        self.next_ping(now, out, tell)
    }

    /// The next frame of strokes: goes back to the first without an answer after a time.
    fn next_batch(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME]) -> Option<usize> {
        if self.control.is_some() {
            return None;
        }
        let (epoch, seen, retry, acked) = (self.epoch, self.seen, self.retry_after(), self.acked);
        let waiting = |batch: &Batch| batch.seq.wrapping_sub(acked) < u16::MAX / 2;
        let first = self.window.iter().find(|batch| waiting(batch))?;
        let overdue = !first.due && now.since(first.last_sent) >= retry;
        let mut out_now = 0;
        for batch in self.window.iter_mut().filter(|batch| waiting(batch)) {
            if overdue && !batch.due {
                (batch.due, batch.again) = (true, true);
            }
            out_now += if batch.due { 0 } else { batch.len };
        }
        let budget = self.window_bytes.saturating_sub(out_now);
        let next = self.window.iter_mut().filter(|batch| waiting(batch)).find(|batch| batch.due)?;
        if out_now > 0 && budget < MAX_FRAME {
            return None;
        }
        let (seq, onset, base) = (next.seq, next.onset, next.strokes.base().wire());
        let batch = next.strokes.bytes();
        let len = written(&HostMessage::Strokes { epoch, seq, seen, onset, base, batch }, out);
        self.traffic.again += u64::from(next.again);
        next.due = false;
        next.len = len;
        next.first_sent = next.first_sent.or(Some(now));
        next.last_sent = now;
        Some(len)
    }

    fn next_ping(
        &mut self,
        now: HostInstant,
        out: &mut [u8; MAX_FRAME],
        tell: &mut dyn FnMut(Event),
    ) -> usize {
        if now < self.ping_due {
            return 0;
        }
        if self.unanswered >= DEAF_PINGS && now.since(self.first_unanswered) >= DEAF_FOR {
            self.lose(LostReason::NoAnswer, tell);
            return 0;
        }
        if self.unanswered == 0 {
            self.first_unanswered = now;
        }
        self.unanswered += 1;
        let setting_clock = self.first_pings < FIRST_PINGS;
        let every = match self.unanswered {
            _ if setting_clock || !self.is_settled() => FIRST_PING_EVERY,
            1 => self.ping_every,
            _ => self.ping_every.min(DOUBT_EVERY),
        };
        self.ping_due = now + every;
        self.token = self.token.wrapping_add(1).max(1);
        (self.pinged, self.last_ping) = (Some(now), now);
        written(&HostMessage::Ping { token: self.token, seen: self.seen }, out)
    }

    /// When [`Self::transmit`] may have something next, if nothing happens before.
    #[must_use]
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let retry = self.retry_after();
        match self.phase {
            Phase::Opening => self.last_sent.map_or(now, |sent| sent + HELLO_EVERY),
            Phase::Over => now + Duration::from_secs(1),
            Phase::Open => {
                let control = self.control.as_ref().map(|c| c.sent.map_or(now, |sent| sent + retry));
                let frames = self.window.front().map(|batch| match batch.first_sent {
                    Some(_) => batch.last_sent + retry,
                    None => now,
                });
                [control, frames].into_iter().flatten().fold(self.ping_due, HostInstant::min)
            }
        }
    }
}

fn written(message: &HostMessage<'_>, out: &mut [u8]) -> usize {
    // Every message fits a frame: batches are bounded by `BATCH_BYTES`.
    frame::encode(message, out).unwrap_or(0)
}
