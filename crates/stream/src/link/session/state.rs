//! The state of a session, and the calls of the streamer.

use crate::link::clock::Clock;
use crate::link::session::board::BoardRequests;
use crate::link::session::bounds::DeviceKnowledge;
use crate::link::session::contradiction::Contradiction;
use crate::link::session::event::{Event, LostReason};
use crate::link::session::line::{LineRate, MeasuredLine, Quality, RoundTrip, Traffic};
use crate::link::session::probe::{Budget, Probe};
use crate::time::HostInstant;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::controller::{REORDER_WINDOW, REPORTS};
use firmware_protocol::frame::{Decoder, MAX_FRAME};
use firmware_protocol::message::{Mark, MarkKind, Op, Report, Trigger};
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;
use std::collections::VecDeque;
use std::time::Duration;

/// Unacknowledged frames at most: the next in order, and those the device keeps out of order (selective repeat).
const WINDOW: usize = 1 + REORDER_WINDOW;
/// The host retransmits a frame after a few round trips, within these bounds.
const RETRY: (Duration, Duration) = (Duration::from_millis(3), Duration::from_millis(50));
/// Round trips right after the handshake, to set the clock.
pub(super) const FIRST_PINGS: u32 = 8;
/// Pings that may be under way at once and still be told apart.
const PINGS: usize = 64;
/// Bytes of a stroke in a frame, usually; at most 21.
const STROKE_BYTES: usize = 8;
/// A session that waits for a status asks this often.
const STATUS_EVERY: Duration = Duration::from_millis(1);

/// A frame of strokes from its first stroke to its verdict.
#[derive(Clone, Debug)]
pub(super) struct Batch {
    pub(super) seq: u16,
    pub(super) mark: Option<Mark>,
    /// The motors from which it withdraws what begins at its base or later.
    pub(super) withdraws: Option<u32>,
    pub(super) strokes: Packer<BATCH_BYTES>,
    /// Its bytes on the wire, once sent.
    pub(super) len: usize,
    pub(super) first_sent: Option<HostInstant>,
    pub(super) last_sent: HostInstant,
    /// To be sent, or sent again.
    pub(super) due: bool,
    /// The device keeps it, but misses one before it.
    pub(super) kept: bool,
    pub(super) retransmitted: bool,
}

impl Batch {
    /// Whether it is the first frame of a play.
    pub(super) fn is_onset(&self) -> bool {
        self.mark.is_some_and(|mark| mark.kind == MarkKind::Play)
    }

    /// Whether one more stroke leaves the frame within this length.
    fn has_space(&self, longest: usize) -> bool {
        longest == MAX_FRAME
            || self.strokes.items() == 0
            || MAX_FRAME - BATCH_BYTES + self.strokes.bytes().len() + STROKE_BYTES <= longest
    }
}

/// The frames that had no verdict when a command ended their epoch. The device may have refused strokes of them before.
#[derive(Clone, Debug)]
pub(super) struct Retired {
    pub(super) frames: VecDeque<Batch>,
    /// The motors whose old strokes the device had kept before the first of them.
    pub(super) kept: u32,
    /// Their verdicts that are read and not emitted. There is at most one for a frame.
    pub(super) verdicts: VecDeque<Report>,
    /// Reports up to this one are about earlier epochs.
    pub(super) after: u16,
}

#[derive(Clone, Debug)]
pub(super) struct Control {
    pub(super) op: Op,
    pub(super) first_sent: Option<HostInstant>,
    pub(super) sent: Option<HostInstant>,
    /// Its frame was sent, or its e-stop has gone ahead of the bytes that wait: the device may answer.
    pub(super) under_way: bool,
}

/// What a status says about strokes once all the reports that it counts are read.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reported {
    /// Number of the last of these reports.
    pub(super) reports: u16,
    /// The fate of the strokes that begin before this tick is decided.
    pub(super) tick: Tick,
    /// The frames before this one have their verdicts.
    pub(super) next_seq: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    Opening,
    Open,
    /// The device is not trusted: the session repeats an e-stop, and reads nothing.
    Closing(Contradiction),
    Over,
}

/// So many contradictions within this time close the link.
const MAX_CONTRADICTIONS: usize = 5;
const CONTRADICTIONS_WITHIN: Duration = Duration::from_secs(1);

/// The host's end of one session.
#[derive(Clone, Debug)]
pub struct Session {
    pub(super) phase: Phase,
    pub(super) id: u32,
    /// The line's rate as its transport knows it, and as the probe measured it.
    nominal: LineRate,
    pub(super) line: Option<MeasuredLine>,
    pub(super) window_bytes: usize,
    pub(super) probe: Probe,
    pub(super) decoder: Decoder,
    pub(super) hellos: u32,
    pub(super) first_hello: Option<HostInstant>,
    pub(super) known: DeviceKnowledge,
    /// When the device contradicted itself: the last times.
    contradicted: [Option<HostInstant>; MAX_CONTRADICTIONS],
    /// E-stops sent to a device that is not trusted.
    pub(super) e_stops: u16,
    /// When the first of them left.
    pub(super) distrusted_at: Option<HostInstant>,
    /// Since when the report after this number is announced and missing.
    pub(super) missing: Option<(u16, HostInstant)>,
    pub(super) clock: Clock,
    pub(super) traffic: Traffic,
    pub(super) quality: Quality,
    /// Damaged frames since the last whole one.
    pub(super) noise: u32,

    pub(super) epoch: u16,
    /// The epoch the session began with.
    pub(super) first_epoch: u16,
    pub(super) control: Option<Control>,
    /// The epoch of an e-stop that [`Session::take_e_stop`] has not returned yet.
    pub(super) new_e_stop: Option<u16>,
    pub(super) window: VecDeque<Batch>,
    open_batch: Option<Batch>,
    /// A replacement that is not in frames yet: from which tick on, and the motors.
    replacing: Option<(Tick, u32)>,
    /// The motors whose old strokes the device keeps: it takes no others until it is asked to withdraw again.
    pub(super) kept: u32,
    pub(super) next_seq: u16,
    /// The device acknowledged all frames before this one.
    pub(super) acked: u16,
    /// The device's free stroke slots, after the frames before `acked`.
    pub(super) credits: usize,
    pub(super) last_sent: Option<HostInstant>,
    pub(super) amendments: Packer<BATCH_BYTES>,
    pub(super) generation: u16,

    /// The last report read; all before it were read too.
    pub(super) seen: u16,
    /// Reports that overtook one before them, by number: the device sends no others ahead.
    pub(super) early: [Option<(u16, Report)>; REPORTS],
    /// The last report that the device is known to have made.
    pub(super) announced: u16,
    /// The newest status all of whose reports are read; the oldest with a report missing; the newest of all.
    pub(super) concluded: Reported,
    pub(super) waiting: Option<Reported>,
    pub(super) latest: Reported,
    /// Verdicts up to this report belong to an epoch that is over.
    pub(super) stale: u16,
    /// Verdicts that came before their acknowledgement.
    pub(super) verdicts: VecDeque<Report>,
    pub(super) retired: Retired,

    pub(super) asking: BoardRequests,
    pub(super) token: u16,
    /// The last ping that the device answered.
    pub(super) answered: u16,
    /// The last pings and when they left: an answer may come after later pings have left.
    pub(super) pinged: [(u16, HostInstant); PINGS],
    pub(super) last_ping: HostInstant,
    pub(super) ping_due: HostInstant,
    pub(super) ping_every: Duration,
    pub(super) first_pings: u32,
    pub(super) unanswered: u32,
    pub(super) first_unanswered: HostInstant,
    pub(super) round_trip: Duration,
    /// The shortest round trip so far.
    pub(super) shortest_trip: Duration,
    pub(super) last_trip: Option<RoundTrip>,
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
            probe: Probe::new(Budget::default(), rate),
            decoder: Decoder::default(),
            hellos: 0,
            first_hello: None,
            known: DeviceKnowledge::new(),
            contradicted: [None; MAX_CONTRADICTIONS],
            e_stops: 0,
            distrusted_at: None,
            missing: None,
            clock: Clock::default(),
            traffic: Traffic::default(),
            quality: Quality::default(),
            noise: 0,
            epoch: 0,
            first_epoch: 0,
            control: None,
            new_e_stop: None,
            window: VecDeque::with_capacity(WINDOW + 1),
            open_batch: None,
            replacing: None,
            kept: 0,
            next_seq: 0,
            acked: 0,
            credits: 0,
            last_sent: None,
            amendments: Packer::new(Tick(0)),
            generation: 0,
            seen: 0,
            early: [None; REPORTS],
            announced: 0,
            concluded: Reported::default(),
            waiting: None,
            latest: Reported::default(),
            stale: 0,
            verdicts: VecDeque::with_capacity(REPORTS),
            retired: Retired {
                frames: VecDeque::with_capacity(WINDOW + 1),
                kept: 0,
                verdicts: VecDeque::with_capacity(REPORTS),
                after: 0,
            },
            asking: BoardRequests::new(now),
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
            shortest_trip: Duration::MAX,
            last_trip: None,
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

    /// The last round trip; each is returned once.
    pub fn take_round_trip(&mut self) -> Option<RoundTrip> {
        self.last_trip.take()
    }

    /// Whether the link probe is over; before that, the line's rate is unknown.
    #[must_use]
    pub fn is_probed(&self) -> bool {
        self.probe.is_over()
    }

    /// Probes the line again with this budget, for a closer measurement. Not while a play runs.
    pub fn probe(&mut self, budget: Budget) {
        self.probe = Probe::new(budget, self.nominal);
    }

    /// Takes over what the probe measured, once it is over.
    pub(super) fn adopt_probe(&mut self) {
        if self.probe.is_over() {
            self.line = self.probe.result();
            self.window_bytes = self.line.map_or(self.nominal, |line| line.rate).window_bytes();
        }
    }

    /// Bytes per second of full frames that the device acknowledges: the line's rate, or less where the host waits for
    /// acknowledgements because few bytes may be unacknowledged. `None` until measured.
    #[must_use]
    pub fn capacity(&self) -> Option<u32> {
        let MeasuredLine { rate, ack_wait } = self.line?;
        let share = self.quality.share;
        let under_way = (self.frames_under_way() * MAX_FRAME) as f64;
        let waiting = under_way / (ack_wait + rate.time(MAX_FRAME)).as_secs_f64();
        Some((waiting.min(rate.0.into()) * share) as u32)
    }

    /// Bytes per second left on the line while so many frames a second, however short, wait for acknowledgements.
    /// `None` until measured.
    #[must_use]
    pub fn rate_left(&self, frames_per_s: u32) -> Option<u32> {
        let waiting = f64::from(frames_per_s) * self.ack_wait()?.as_secs_f64() / self.quality.share;
        Some((f64::from(self.line?.rate.0) * self.quality.share * (1.0 - waiting)) as u32)
    }

    /// How long a frame that is sent now takes to the device, with those that are not acknowledged before it.
    #[must_use]
    pub fn delivery(&self) -> Duration {
        let waits: usize = self.window.iter().filter(|batch| !batch.kept).map(|batch| batch.len).sum();
        let bytes = self.line.map_or(Duration::ZERO, |line| line.rate.time(waits + MAX_FRAME));
        bytes + self.shortest_trip.min(RETRY.1) / 2
    }

    /// How long a frame waits, besides its bytes' time, until the device has acknowledged the frames before it.
    #[must_use]
    pub fn ack_wait(&self) -> Option<Duration> {
        Some(self.line?.ack_wait / self.frames_under_way() as u32)
    }

    /// Whole frames that may be unacknowledged at once.
    fn frames_under_way(&self) -> usize {
        self.window_bytes / MAX_FRAME
    }

    /// Whether the session takes plays: the handshake is done, the clock is set and the session is not over.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.phase == Phase::Open && self.first_pings >= FIRST_PINGS
    }

    /// Whether the device answered every command, and the session read every report.
    #[must_use]
    pub fn is_answered(&self) -> bool {
        self.control.is_none() && self.seen == self.announced
    }

    /// The session knows which of the accepted strokes before this tick the device has refused as they began.
    #[must_use]
    pub fn known_to(&self) -> Tick {
        self.concluded.tick
    }

    /// Whether the session takes commands: the handshake is done and the session is not over.
    #[must_use]
    pub fn can_command(&self) -> bool {
        self.phase == Phase::Open
    }

    /// The device contradicted itself. One contradiction is counted; several in a row close the link.
    pub(super) fn contradicts(&mut self, now: HostInstant, how: Contradiction, emit: &mut dyn FnMut(Event)) {
        if self.traffic.contradictions.count(how) {
            emit(Event::Contradiction(how));
        }
        self.contradicted.rotate_right(1);
        self.contradicted[0] = Some(now);
        let first = self.contradicted[MAX_CONTRADICTIONS - 1];
        if first.is_some_and(|first| now.since(first) <= CONTRADICTIONS_WITHIN) {
            self.distrust(how, emit);
        } else {
            // The next status shows soon which of the two was wrong.
            self.request_status();
        }
    }

    /// Closes the link to a device that cannot be trusted: turns its lines off first.
    pub fn distrust(&mut self, how: Contradiction, emit: &mut dyn FnMut(Event)) {
        match self.phase {
            Phase::Opening => self.lose(LostReason::Contradicts(how), emit),
            Phase::Open => {
                self.phase = Phase::Closing(how);
                self.control = None;
                // Its frame may wait behind bytes that the device does not take.
                self.new_e_stop = Some(self.last_epoch(1));
                self.window.clear();
                (self.open_batch, self.replacing) = (None, None);
                self.last_sent = None;
            }
            Phase::Closing(_) | Phase::Over => {}
        }
    }

    /// When an e-stop first left for the device, if the device has not answered it.
    #[must_use]
    pub fn e_stopped_at(&self) -> Option<HostInstant> {
        let control = self.control.as_ref().filter(|control| control.op == Op::EStop);
        self.distrusted_at.or(control.and_then(|control| control.first_sent))
    }

    /// Pings at least this often, so that the device's host watchdog does not time out.
    pub fn keep_alive_every(&mut self, every: Duration, now: HostInstant) {
        self.ping_every = every;
        self.ping_due = self.ping_due.min(now + every);
    }

    /// Asks for a status soon. Callers may repeat it until the status comes.
    pub fn request_status(&mut self) {
        self.ping_due = self.ping_due.min(self.last_ping + STATUS_EVERY);
    }

    /// Asks for a status within this time. Statuses report free slots; a host without credits sends nothing else that
    /// would bring one.
    pub fn request_status_within(&mut self, time: Duration) {
        self.ping_due = self.ping_due.min(self.last_ping + time);
    }

    /// Sends a command in a new epoch, until the device answers. Of strokes that have no verdict yet, the session emits
    /// only the verdicts late and refused, as the device reports them.
    pub fn command(&mut self, op: Op) {
        self.epoch = self.epoch.wrapping_add(1);
        self.known.command(&op);
        if self.control.is_none() {
            std::mem::swap(&mut self.window, &mut self.retired.frames);
            std::mem::swap(&mut self.verdicts, &mut self.retired.verdicts);
            self.retired.after = self.stale;
            self.retired.kept = self.kept;
        }
        self.control = Some(Control { op, first_sent: None, sent: None, under_way: false });
        self.new_e_stop = (op == Op::EStop).then_some(self.epoch);
        self.window.clear();
        (self.open_batch, self.replacing, self.kept) = (None, None, 0);
        self.verdicts.clear();
        (self.next_seq, self.acked, self.generation) = (0, 0, 0);
        let marks = [Some(&mut self.concluded), self.waiting.as_mut(), Some(&mut self.latest)];
        marks.into_iter().flatten().for_each(|mark| mark.next_seq = 0);
        self.amendments = Packer::new(Tick(0));
    }

    /// The epoch of an e-stop that has become due, once: for a device that takes it past the bytes that wait
    /// ([`crate::device::Device::e_stop`]). Its frame is sent as well.
    #[must_use]
    pub fn take_e_stop(&mut self) -> Option<u16> {
        if matches!(self.phase, Phase::Opening | Phase::Over) {
            return None;
        }
        let epoch = self.new_e_stop.take()?;
        if let Some(control) = &mut self.control {
            control.under_way = true;
        }
        Some(epoch)
    }

    /// Begins a play: the next strokes go into a frame of their own, which the device takes whole or not at all.
    /// Once that frame is sealed, nothing can be pushed until the device answers it.
    pub fn begin(&mut self, onset: Tick, trigger: Option<Trigger>) {
        self.seal();
        self.open_batch = Some(self.batch(onset, Some(Mark { kind: MarkKind::Play, trigger })));
    }

    /// Marks the onset of a later item of a play: the next strokes go into a frame of their own. The device reports the mark
    /// when it has passed.
    pub fn mark(&mut self, onset: Tick, trigger: Option<Trigger>) {
        self.seal();
        self.open_batch = Some(self.batch(onset, Some(Mark { kind: MarkKind::Item, trigger })));
    }

    /// Withdraws what these motors have queued from `from` on. The strokes pushed next take their place, each motor's from its
    /// first on; no stroke follows for the motors `silent`. They go into frames of their own. Call it again only after the answer
    /// to the last such frame.
    pub fn replace(&mut self, from: Tick, motors: u32, silent: u32) {
        self.seal();
        self.open_batch = Some(Batch { withdraws: Some(motors & silent), ..self.batch(from, None) });
        self.replacing = Some((from, motors & !silent)).filter(|&(_, motors)| motors != 0);
    }

    fn batch(&self, base: Tick, mark: Option<Mark>) -> Batch {
        let strokes = Packer::new(base);
        Batch {
            seq: self.next_seq,
            mark,
            withdraws: None,
            strokes,
            len: 0,
            first_sent: None,
            last_sent: HostInstant::default(),
            due: true,
            kept: false,
            retransmitted: false,
        }
    }

    /// Strokes that the device's credits still allow.
    #[must_use]
    pub fn credits(&self) -> usize {
        let open = self.open_batch.as_ref().map_or(0, |batch| batch.strokes.items());
        let out: usize = self.window.iter().map(|batch| batch.strokes.items()).sum();
        self.credits.saturating_sub(out + open)
    }

    /// Whether a frame may be begun: the window has room, and no onset waits for its verdict.
    #[must_use]
    pub fn has_room(&self) -> bool {
        self.phase == Phase::Open
            && self.control.is_none()
            && self.window.len() < WINDOW
            && !self.window.back().is_some_and(Batch::is_onset)
    }

    /// Takes a stroke that does not begin before the last one; `false` if it must wait for credits, the window or an
    /// onset's verdict.
    pub fn push(&mut self, stroke: &Stroke) -> bool {
        if self.phase != Phase::Open || !self.has_room() || self.credits() == 0 {
            return false;
        }
        let longest = self.quality.frame_bytes;
        let bit = 1 << stroke.motor;
        if let Some(batch) = &mut self.open_batch {
            if batch.has_space(longest) && batch.strokes.stroke(stroke).is_ok() {
                // The first stroke of a motor takes the place of its old ones.
                if let (Some(withdraws), Some((from, motors))) = (&mut batch.withdraws, self.replacing) {
                    *withdraws |= bit & motors;
                    self.replacing = Some((from, motors & !bit)).filter(|&(_, motors)| motors != 0);
                }
                return true;
            }
            self.seal();
            return self.push(stroke);
        }
        if let Some((from, _)) = self.replacing {
            self.open_batch = Some(Batch { withdraws: Some(0), ..self.batch(from, None) });
            return self.push(stroke);
        }
        // A frame that waits takes more strokes: on a link with slow answers frames get longer, not more.
        if let Some(last) = self.window.back_mut()
            && last.first_sent.is_none()
            && last.mark.is_none()
            && last.has_space(longest)
            && last.strokes.stroke(stroke).is_ok()
        {
            return true;
        }
        let mut batch = self.batch(stroke.up, None);
        let packed = batch.strokes.stroke(stroke).is_ok();
        self.open_batch = Some(batch);
        packed
    }

    /// Ends the open frame, so that it can be sent. While it waits, it takes more strokes, unless it has a mark.
    pub fn seal(&mut self) {
        if let Some(batch) = self.open_batch.take() {
            self.next_seq = self.next_seq.wrapping_add(1);
            self.window.push_back(batch);
        }
    }

    /// Adds a corrected pulse count for a queued burst to the next amendment message; `false` if that is full.
    pub fn amend(&mut self, amendment: &Amendment) -> bool {
        if self.amendments.items() == 0 {
            self.amendments = Packer::new(amendment.up);
        }
        self.amendments.amendment(amendment).is_ok()
    }

    /// How long the session waits for an acknowledgement before it retransmits.
    pub(super) fn retry_after(&self) -> Duration {
        let usual = (self.round_trip * 3).clamp(RETRY.0, RETRY.1);
        // A frame on a slow line is late, not lost.
        let line = self.line.map_or(Duration::ZERO, |line| line.rate.time(self.window_bytes + MAX_FRAME));
        usual.max(self.round_trip.min(RETRY.1) + line)
    }
}
