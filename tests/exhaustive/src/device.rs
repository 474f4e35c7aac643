//! All orders of what can happen to the controller: a host's messages, lost, late and repeated; e-stops ahead of other bytes; a lost
//! link, a fault, another host, silence; and time.
//!
//! Each message that the host can send is sent in time, late, or not at all, and comes again later. From every state that is reached the
//! checks let the host fall silent until the device rests, compare all counts, and then lead a new host to a play.

#![expect(clippy::derived_hash_with_manual_eq, reason = "scenes are equal if their hashes are")]

use crate::shell::{Asked, Broken, Shell, USED, after, never};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{self, Amendment, BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::newer;
use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{
    Cause, Counters, DeviceMessage, HostMessage, Mark, MarkKind, Op, Report, State as Armed, Status, Trigger,
    Withdraw,
};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use stateright::{Model, Property};
use std::hash::{Hash, Hasher};

/// How far the exploration goes.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Messages of the host, and events of the device, at most.
    pub events: u8,
    /// How many of those are a loss, a repetition, an e-stop ahead of other bytes, a lost link, a fault, another host.
    pub faults: u8,
    /// Ticks in which events happen.
    pub ticks: u64,
    /// Whether events happen in every tick. Otherwise one tick before, at and after each tick in which something changes.
    pub every_tick: bool,
    /// Whether the host allows only one motor of a rail to have pulses at once.
    pub one_at_once: bool,
}

/// What the host says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Say {
    /// Arm, with a short host timeout.
    Arm,
    /// Disarm.
    Disarm,
    /// Stop.
    Stop,
    /// E-stop.
    EStop,
    /// Reset.
    Reset,
    /// A shift of motor 0 by one pulse up.
    Shift,
    /// A play's first frame, of two motors, as early as it can be.
    Onset,
    /// The same, one tick too early.
    LateOnset,
    /// A stroke of motor 0 behind its last one.
    Next,
    /// Strokes of both motors, the first of them one tick too early.
    Late,
    /// A ramp of motor 0 behind its last stroke: up, further up before it is there, and down.
    Ramp,
    /// A row: both motors go to a level, and stay.
    Row,
    /// The same row again: it changes nothing, or takes a pin up that could not go before.
    RowAgain,
    /// A lower level of motor 0.
    Down,
    /// Rest of both motors, one tick too late: they come down at once.
    LateRest,
    /// Replaces what motor 0 has queued from its last stroke on.
    Replace,
    /// Replaces the same by a stroke that is in time, whether the last one has begun or not.
    ReplaceLater,
    /// Withdraws both motors' strokes from the first tick that can still be had.
    Withdraw,
    /// Amends the way up of the last stroke, or of the last ramp, by a pulse more.
    AmendUp,
    /// Amends its way down by a pulse less.
    AmendDown,
    /// Shows that it is alive.
    Ping,
}

const SAYS: [Say; 21] = [
    Say::Arm,
    Say::Disarm,
    Say::Stop,
    Say::EStop,
    Say::Reset,
    Say::Shift,
    Say::Onset,
    Say::LateOnset,
    Say::Next,
    Say::Late,
    Say::Ramp,
    Say::Row,
    Say::RowAgain,
    Say::Down,
    Say::LateRest,
    Say::Replace,
    Say::ReplaceLater,
    Say::Withdraw,
    Say::AmendUp,
    Say::AmendDown,
    Say::Ping,
];

/// One step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Step {
    /// The host says something, and the device hears it.
    Say(Say),
    /// The host says something that does not come, or comes with [`Step::Again`].
    Lose(Say),
    /// The message of so many messages ago comes again, or comes now if it was lost.
    Again(usize),
    /// A damaged frame.
    Noise,
    /// The shell finds an e-stop ahead of what is not taken yet.
    Urgent,
    /// The cable is unplugged.
    LinkLost,
    /// The device's own fault.
    Fault,
    /// Another host opens a session.
    Hello,
    /// The shell takes a piece of the last frame.
    Piece,
    /// Time passes, up to this tick from the start.
    Until(u16),
}

/// A frame of moves that the device has heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Heard {
    epoch: u16,
    seq: u16,
    begins_play: bool,
    /// Moves in it.
    moves: u64,
}

/// What a frame has of one or all motors.
enum Item {
    Stroke(Stroke),
    Move(Move),
    /// At a tick, the levels of the motors from 0 on.
    Row(u64, [u16; USED]),
}

impl Item {
    fn moves(&self) -> Vec<Move> {
        match *self {
            Self::Stroke(stroke) => stroke.moves().to_vec(),
            Self::Move(of) => vec![of],
            Self::Row(tick, levels) => {
                (0..).zip(levels).map(|(motor, level)| to(motor, tick, level)).collect()
            }
        }
    }
}

/// A frame that replaces moves, and what may be played of the old and the new ones.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Replacing {
    epoch: u16,
    seq: u16,
    motors: u32,
    base: u64,
    old: Vec<Asked>,
    new: Vec<Asked>,
    /// What was rendered when it was heard.
    rendered: u64,
    /// The motors that the device keeps, by its verdict.
    kept: u32,
}

/// Where the host is in its session with the device.
#[derive(Clone, Copy, Debug, Default, Hash)]
struct Host {
    session: u32,
    epoch: u16,
    seq: u16,
    generation: u16,
    /// The last report it has read.
    seen: u16,
    /// The last stroke that was sent of motor 0.
    last: Option<Stroke>,
    status: Option<Status>,
}

impl Host {
    fn next_epoch(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        (self.seq, self.generation) = (0, 0);
    }

    fn control(&mut self, op: Op) -> Vec<u8> {
        self.next_epoch();
        encoded(&HostMessage::Control { epoch: self.epoch, seen: self.seen, op })
    }

    fn amendment(&mut self, direction: Direction, change: i16) -> Option<Vec<u8>> {
        let stroke = self.last?;
        self.generation = self.generation.wrapping_add(1);
        let pulses = stroke.level.saturating_add_signed(change);
        let tick = if direction == Direction::Up { stroke.up } else { stroke.down };
        let mut items = Packer::<BATCH_BYTES>::new(stroke.up);
        let packed = items.amendment(&Amendment { motor: 0, tick, pulses });
        assert!(packed.is_ok(), "one amendment fits");
        let (epoch, generation, base) = (self.epoch, self.generation, stroke.up.wire());
        Some(encoded(&HostMessage::Amend { epoch, generation, base, items: items.bytes() }))
    }
}

/// What the counts at rest must add up to.
#[derive(Clone, Copy, Debug, Default, Hash)]
struct Account {
    /// Moves of frames that were taken; and of those that were perhaps taken in part.
    taken: u64,
    torn: u64,
    /// Whether the rest of pins was shifted, and moves amended: then fewer sums are exact.
    shifted: bool,
    amended: bool,
}

/// What the device has counted when it rests. It follows from the other fields of a scene, and makes no other state.
#[derive(Clone, Copy, Debug)]
struct End(Counters);

impl Hash for End {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

/// The device, and what its host has said.
#[derive(Clone, Debug, Hash)]
pub struct Scene {
    /// The device.
    pub shell: Shell,
    /// When the exploration began.
    begun: u64,
    events: u8,
    faults: u8,
    /// The shell may not have taken all of the last frame.
    pieces: bool,
    host: Host,
    /// The last messages, the newest first.
    said: Vec<Vec<u8>>,
    /// Frames of moves of the present epoch that were heard and not acknowledged.
    heard: Vec<Heard>,
    /// The last frame that replaces, until it is taken.
    replacing: Option<Replacing>,
    account: Account,
    /// When the device heard a frame last.
    last_heard: u64,
    end: End,
}

const HOST_TIMEOUT: u32 = 200;
/// Between a move and the next but one of its motor.
const APART: u64 = 85;
/// The levels of a row.
const ROW: [u16; USED] = [4, 7];
/// Messages kept in `said`.
const KEPT: usize = 3;

impl PartialEq for Scene {
    fn eq(&self, other: &Self) -> bool {
        hash_of(self) == hash_of(other)
    }
}

fn hash_of(scene: &Scene) -> u64 {
    let mut hasher = std::hash::DefaultHasher::new();
    scene.hash(&mut hasher);
    hasher.finish()
}

impl Scene {
    fn new(one_at_once: bool) -> Self {
        let mut shell = Shell::new(1);
        shell.one_at_once = one_at_once;
        let now = shell.now;
        let mut scene = Self {
            shell,
            begun: now,
            events: 0,
            faults: 0,
            pieces: false,
            host: Host::default(),
            said: Vec::new(),
            heard: Vec::new(),
            replacing: None,
            account: Account::default(),
            last_heard: now,
            end: End(Counters::NONE),
        };
        scene.hello(1);
        scene
    }

    fn tick(&self) -> Tick {
        Tick(self.shell.now)
    }

    fn bytes(&mut self, mut bytes: &[u8]) {
        let now = self.tick();
        while !bytes.is_empty() {
            self.shell.device.read(now, &mut bytes);
        }
        self.drain();
    }

    /// Lets the device take all that it has heard, in no time.
    fn take_all(&mut self) {
        self.pieces = false;
        let now = self.tick();
        while self.shell.device.advance(now) {}
        self.drain();
    }

    /// Takes what the device sends.
    fn drain(&mut self) {
        let (now, mut out) = (self.tick(), [0; MAX_FRAME]);
        let mut decoder = Decoder::new();
        loop {
            let len = self.shell.device.transmit(now, &mut out);
            let Some(body) = decoder.next(&mut &out[..len]) else { break };
            match frame::read(body) {
                Ok(DeviceMessage::Hello(hello)) => {
                    (self.host.epoch, self.host.seq, self.host.seen) = (hello.epoch, 0, hello.reports);
                }
                Ok(DeviceMessage::Status(status)) => self.host.status = Some(status),
                Ok(DeviceMessage::Report { number, report }) if number == self.host.seen.wrapping_add(1) => {
                    self.host.seen = number;
                    if let Report::Verdict { seq, kept, .. } = report
                        && let Some(replacing) = self.replacing.as_mut().filter(|frame| frame.seq == seq)
                    {
                        replacing.kept |= kept.bits() as u32;
                    }
                    if let Report::OnsetRefused { seq, .. } = report {
                        // A play's first frame is taken whole or not at all: its moves count nowhere.
                        let refused =
                            self.heard.iter_mut().find(|heard| heard.seq == seq && heard.begins_play);
                        refused.into_iter().for_each(|heard| heard.moves = 0);
                    }
                }
                _ => {}
            }
        }
    }

    fn hello(&mut self, session: u32) {
        self.host.session = session;
        let bytes = encoded(&HostMessage::Hello { session });
        self.bytes(&bytes);
        self.take_all();
        self.last_heard = self.shell.now;
    }

    fn ping(&mut self) {
        self.bytes(&encoded(&HostMessage::Ping { token: 1, seen: self.host.seen }));
        self.take_all();
    }

    /// Behind the last stroke of motor 0, and in time.
    fn behind_last(&self) -> u64 {
        self.host.last.map_or(0, |last| last.down.0 + u64::from(last.level)).max(self.ready())
    }

    /// The first tick at which a move that is sent now may begin.
    fn ready(&self) -> u64 {
        self.shell.device.ready().0
    }

    /// The scene once the device has taken all that it has heard, in no time.
    fn caught_up(&self) -> Self {
        let mut scene = self.clone();
        scene.take_all();
        scene.ping();
        scene
    }

    /// The epoch ends: counts what was taken of the moves heard in it. If it ends ahead of other bytes, it may end within a
    /// frame.
    fn close_epoch(&mut self, ahead: bool) {
        if self.heard.is_empty() {
            return;
        }
        let now = self.tick();
        if ahead && self.shell.device.clone().advance(now) {
            self.account.torn += self.heard.drain(..).map(|heard| heard.moves).sum::<u64>();
            return;
        }
        self.account.taken += self.caught_up().acknowledged();
        self.heard.clear();
    }

    /// A frame that replaces is taken: from now on only the old moves may be played, or only the new ones.
    fn conclude_replacement(&mut self) {
        if self.replacing.is_none() {
            return;
        }
        let caught_up = self.caught_up();
        let status = caught_up.host.status;
        let frame = caught_up.replacing.filter(|frame| {
            status.is_some_and(|status| status.epoch == frame.epoch && frame.seq < status.next_seq)
        });
        self.replacing = None;
        let Some(Replacing { motors, base, old, new, rendered, kept, .. }) = frame else { return };
        for motor in (0..USED as u8).filter(|motor| motors >> motor & 1 == 1) {
            let of = |moves: &[Asked]| -> Vec<Asked> {
                moves.iter().filter(|asked| asked.of.motor == motor).copied().collect()
            };
            if kept >> motor & 1 == 1 {
                let (old, mut new) = (of(&old), of(&new));
                new.retain(|asked| !old.contains(asked));
                self.shell.take_back(&new);
            } else {
                if self.shell.has_begun(motor, base, rendered) {
                    self.shell.breaks(Broken::InPart);
                }
                let mut old = of(&old);
                old.retain(|asked| !new.contains(asked));
                self.shell.take_back(&old);
            }
        }
    }

    /// Moves of the frames heard in this epoch that the device has acknowledged.
    fn acknowledged(&self) -> u64 {
        let Some(status) = self.host.status else { return 0 };
        let taken =
            self.heard.iter().filter(|heard| heard.epoch == status.epoch && heard.seq < status.next_seq);
        taken.map(|heard| heard.moves).sum()
    }

    fn frame(&mut self, mark: Option<MarkKind>, motors: u32, base: u64, items: &[Item]) -> Vec<u8> {
        let mut batch = Packer::<BATCH_BYTES>::new(Tick(base));
        let old = self.shell.asked_from(motors, base);
        let before = self.shell.asked_from(u32::MAX, 0).len();
        for item in items {
            let packed = match *item {
                Item::Stroke(stroke) => batch.stroke(&stroke),
                Item::Move(of) => batch.moves(&of),
                Item::Row(tick, levels) => batch.row(Tick(tick), MotorSet::first(USED), &levels),
            };
            assert!(packed.is_ok(), "items in order");
            match item {
                Item::Row(..) => item.moves().iter().for_each(|of| self.shell.ask(&[*of])),
                _ => self.shell.ask(&item.moves()),
            }
        }
        if motors != 0 {
            let new = self.shell.asked_from(u32::MAX, 0)[before..].to_vec();
            let rendered = self.shell.device.rendered().0;
            let (epoch, seq) = (self.host.epoch, self.host.seq);
            self.replacing = Some(Replacing { epoch, seq, motors, base, old, new, rendered, kept: 0 });
        }
        let mark = mark.map(|kind| Mark { kind, trigger: Some(Trigger { width: 3, code: 0 }), hold: 0 });
        let withdraw =
            Some(Withdraw { motors: MotorSet::from_bits(motors.into()), generation: self.host.generation })
                .filter(|_| motors != 0);
        let (epoch, seq, seen) = (self.host.epoch, self.host.seq, self.host.seen);
        self.host.seq = self.host.seq.wrapping_add(1);
        let mut strokes = items.iter().filter_map(|item| match item {
            Item::Stroke(stroke) if stroke.motor == 0 => Some(*stroke),
            _ => None,
        });
        self.host.last = strokes.next_back().or(self.host.last);
        encoded(&HostMessage::Moves {
            epoch,
            seq,
            seen,
            mark,
            withdraw,
            base: Tick(base).wire(),
            batch: batch.bytes(),
        })
    }

    /// The bytes of what the host says now. `None` if it has no reason to.
    fn words(&mut self, say: Say) -> Option<Vec<u8>> {
        let ready = self.ready();
        Some(match say {
            Say::Arm => {
                let assume_rest = self.host.status.is_none_or(|status| !status.position_known);
                let rail_at_once =
                    if self.shell.one_at_once { 1 } else { Array::paper().layout().no_limits().rail_at_once };
                let (host_timeout, limits) =
                    (HOST_TIMEOUT, PowerLimits { rail_at_once, ..Array::paper().layout().no_limits() });
                self.host.control(Op::Arm { assume_rest, host_timeout, limits, lower_stop: None })
            }
            Say::Disarm => self.host.control(Op::Disarm(Cause::Shutdown)),
            Say::Stop => self.host.control(Op::Stop),
            Say::EStop => self.host.control(Op::EStop),
            Say::Reset => self.host.control(Op::Reset),
            Say::Shift => {
                self.account.shifted = true;
                self.shell.ask_shift(0, Direction::Up);
                self.host.control(Op::Move { motor: 0, direction: Direction::Up, pulses: 1 })
            }
            Say::Onset => {
                let first = if self.shell.one_at_once { around(0, ready) } else { short(0, ready) };
                self.frame(Some(MarkKind::Play), 0, ready, &[first, long(1, ready + 3)].map(Item::Stroke))
            }
            Say::LateOnset => {
                let late = [short(0, ready - 1), long(1, ready + 3)];
                self.frame(Some(MarkKind::Play), 0, ready - 1, &late.map(Item::Stroke))
            }
            Say::Next => {
                let at = self.behind_last();
                self.frame(Some(MarkKind::Item), 0, at, &[Item::Stroke(short(0, at))])
            }
            Say::Late => {
                self.frame(None, 0, ready - 1, &[short(0, ready - 1), short(1, ready)].map(Item::Stroke))
            }
            Say::Ramp => {
                let at = self.behind_last();
                let ramp = [to(0, at, 3), to(0, at + 2, 6), to(0, at + APART, 0)];
                let words = self.frame(None, 0, at, &ramp.map(Item::Move));
                // Amendments are of its second move.
                let (up, down) = (Tick(at + 2), Tick(at + APART));
                self.host.last = Some(Stroke { motor: 0, up, level: 3, down, surplus: 0 });
                words
            }
            Say::Row | Say::RowAgain => {
                let at = if say == Say::Row { ready } else { ready + 50 };
                self.frame(None, 0, at, &[Item::Row(at, ROW)])
            }
            Say::Down => self.frame(None, 0, ready, &[Item::Move(to(0, ready, 1))]),
            Say::LateRest => self.frame(None, 0, ready - 1, &[Item::Row(ready - 1, [0; USED])]),
            Say::Replace => {
                let at = self.host.last?.up.0;
                let long = Stroke { level: 3, down: Tick(at + 4), ..short(0, at) };
                self.frame(None, 1, at, &[Item::Stroke(long)])
            }
            Say::ReplaceLater => {
                let at = self.host.last?.up.0;
                self.frame(None, 1, at, &[Item::Stroke(short(0, at.max(ready)))])
            }
            Say::Withdraw => self.frame(None, 3, ready, &[]),
            Say::AmendUp => {
                self.shell.ask_amendment();
                self.host.amendment(Direction::Up, 1)?
            }
            Say::AmendDown => {
                self.shell.ask_amendment();
                self.host.amendment(Direction::Down, -1)?
            }
            Say::Ping => encoded(&HostMessage::Ping { token: 1, seen: self.host.seen }),
        })
    }

    /// The device hears what the host has said, now or before.
    fn hear_words(&mut self, bytes: &[u8]) {
        let mut decoder = Decoder::new();
        let body = decoder.next(&mut &bytes[..]);
        let Some(Ok(message)) = body.map(frame::read::<HostMessage>) else { return };
        let device = self.shell.device.epoch();
        match message {
            HostMessage::Control { epoch, op, .. } if device.is_some_and(|device| newer(epoch, device)) => {
                self.close_epoch(false);
                match op {
                    Op::EStop => self.goes_off(),
                    Op::Arm { .. } if self.shell.device.state() == Armed::Disarmed => {
                        self.shell.off_since = None;
                    }
                    _ => {}
                }
            }
            HostMessage::Moves { epoch, seq, mark, batch, .. } if device == Some(epoch) => {
                let moves = batch::moves(Tick(0), batch).map_or(0, |moves| moves.len() as u64);
                let begins_play = mark.is_some_and(|mark| mark.kind == MarkKind::Play);
                let heard = Heard { epoch, seq, begins_play, moves };
                if !self.heard.iter().any(|known| known.seq == seq) {
                    self.heard.push(heard);
                }
            }
            HostMessage::Amend { .. } => self.account.amended = true,
            _ => {}
        }
        if device.is_some() {
            self.last_heard = self.shell.now;
        }
        self.bytes(bytes);
        self.shell.watch_return();
        // Of moves and amendments the shell takes a piece at a time.
        if !matches!(message, HostMessage::Moves { .. } | HostMessage::Amend { .. }) {
            self.take_all();
        }
        if self.shell.device.state() == Armed::Faulted {
            self.shell.drivers_off();
        }
    }

    /// From now on the lines are to be low.
    fn goes_off(&mut self) {
        if self.shell.off_since.is_none() {
            self.shell.off_since = Some(self.shell.now);
        }
    }

    fn apply(&mut self, step: Step, bounds: &Bounds) -> Option<()> {
        let now = self.tick();
        if !matches!(step, Step::Piece | Step::Until(_)) {
            self.conclude_replacement();
            self.events += 1;
        }
        if matches!(
            step,
            Step::Lose(_)
                | Step::Again(_)
                | Step::Noise
                | Step::Urgent
                | Step::LinkLost
                | Step::Fault
                | Step::Hello
        ) {
            self.faults += 1;
        }
        self.pieces |= matches!(step, Step::Say(_) | Step::Again(_));
        match step {
            Step::Say(say) => {
                let words = self.words(say)?;
                self.hear_words(&words);
                self.keep(words, bounds);
            }
            Step::Lose(say) => {
                let words = self.words(say)?;
                self.replacing = None;
                self.keep(words, bounds);
            }
            Step::Again(at) => {
                let words = self.said.get(at)?.clone();
                self.hear_words(&words);
            }
            Step::Noise => self.bytes(&[7, 1, 2, 0]),
            Step::Urgent => {
                self.close_epoch(true);
                self.goes_off();
                self.host.next_epoch();
                self.shell.device.e_stop(now, self.host.epoch);
                self.shell.drivers_off();
                self.drain();
            }
            Step::LinkLost => {
                self.close_epoch(true);
                self.shell.device.link_lost(now);
            }
            Step::Fault => {
                self.close_epoch(true);
                self.goes_off();
                self.shell.device.fault(now, Cause::Starved);
                self.shell.drivers_off();
                self.drain();
            }
            Step::Hello => {
                self.close_epoch(false);
                self.hello(self.host.session + 1);
            }
            Step::Piece => {
                self.pieces = self.shell.device.advance(now);
                self.drain();
                if !self.pieces {
                    return None;
                }
            }
            Step::Until(tick) => {
                while self.shell.now < self.shell.start() + u64::from(tick) {
                    self.tick_once();
                }
                if !self.pieces {
                    self.conclude_replacement();
                }
            }
        }
        Some(())
    }

    /// What has happened before the exploration begins.
    fn begin_with(&mut self, steps: &[Step]) {
        let bounds = Bounds { events: 0, faults: 0, ticks: 0, every_tick: false, one_at_once: false };
        for &step in steps {
            self.apply(step, &bounds);
            self.take_all();
        }
        (self.events, self.begun) = (0, self.shell.now);
    }

    fn keep(&mut self, words: Vec<u8>, bounds: &Bounds) {
        // A message that cannot come again makes no difference.
        if self.faults < bounds.faults && self.events < bounds.events {
            self.said.insert(0, words);
            self.said.truncate(KEPT);
        } else {
            self.said.clear();
        }
    }

    fn tick_once(&mut self) {
        self.pieces &= self.shell.tick();
        self.drain();
    }

    /// The next tick, from the start, in which an event is tried.
    fn next_time(&self, bounds: &Bounds) -> Option<u16> {
        let (start, now) = (self.shell.start(), self.shell.now);
        if now >= self.begun + bounds.ticks {
            return None;
        }
        let next = if bounds.every_tick { now + 1 } else { self.shell.next_change() };
        u16::try_from(next - start).ok()
    }

    /// Lets the host be silent until the device rests, and compares what it has counted. Then leads a new host to a play.
    fn judge_end(&mut self) -> Option<Broken> {
        let mut end = self.clone();
        end.said.clear();
        end.conclude_replacement();
        let silent_until = end.last_heard.max(end.shell.now) + u64::from(HOST_TIMEOUT) + 300;
        end.take_all();
        // A silent host reads no statuses: what was taken is known before.
        let caught_up = end.caught_up();
        let taken = end.account.taken + caught_up.acknowledged();
        while end.shell.now < silent_until {
            end.shell.tick();
        }
        // What was seen on the way says more than how it ended.
        if end.shell.broken.is_some() {
            return end.shell.broken;
        }
        let device = &end.shell.device;
        if !matches!(device.state(), Armed::Disarmed | Armed::Faulted) || !end.shell.is_quiet() {
            return Some(Broken::Watchdog);
        }
        let counters = device.counters();
        self.end = End(counters);
        let counted =
            counters.played + counters.late + counters.dropped + counters.refused + counters.replaced;
        let pulses: u64 = end.shell.seen.iter().flatten().map(|&seen| u64::from(seen)).sum();
        if !(taken..=taken + end.account.torn).contains(&counted) || pulses != counters.pulses {
            return Some(Broken::Counts);
        }
        for motor in 0..USED {
            let ([up, down], height) = (end.shell.seen[motor], u32::from(device.outstanding(motor as u8)));
            let exact = !self.account.shifted && !self.account.amended;
            // Only an e-stop or a fault leaves a pin up.
            if (exact && up != down + height) || (height > 0 && end.shell.off_since.is_none()) {
                return Some(Broken::Position);
            }
        }
        end.way_out()
    }

    /// A new host resets, arms and plays one stroke. Then it has both pins go up: one comes down by a move in time, the other by a late one.
    fn way_out(&mut self) -> Option<Broken> {
        let wrong = Some(Broken::NoWayOut);
        // The end of a frame that was cut off.
        self.bytes(&[0]);
        self.hello(1_000);
        if self.shell.device.state() == Armed::Faulted {
            let words = self.words(Say::Reset)?;
            self.hear_words(&words);
        }
        self.ping();
        let words = self.words(Say::Arm)?;
        self.hear_words(&words);
        for _ in 0..190 {
            self.tick_once();
        }
        self.ping();
        if self.shell.device.state() != Armed::Armed {
            return wrong;
        }
        let (played, seen) = (self.shell.device.counters().played, self.shell.seen);
        let at = self.ready();
        let words = self.frame(Some(MarkKind::Play), 0, at, &[Item::Stroke(short(0, at))]);
        self.hear_words(&words);
        self.take_all();
        while self.shell.now < at + 10 {
            self.tick_once();
        }
        let [up, down] = seen[0];
        if self.shell.device.counters().played != played + 2 || self.shell.seen[0] != [up + 2, down + 2] {
            return wrong;
        }
        let (at, seen) = (self.ready(), self.shell.seen);
        let moves = [to(0, at, ROW[0]), to(1, at + 5, ROW[1]), to(0, at + APART, 0)];
        let words = self.frame(None, 0, at, &moves.map(Item::Move));
        self.hear_words(&words);
        self.take_all();
        while self.shell.now < at + APART + 10 {
            self.tick_once();
        }
        let went = |shell: &Shell, motor: usize| {
            let [[up, down], [up_before, down_before]] = [shell.seen[motor], seen[motor]];
            [up - up_before, down - down_before]
        };
        let levels = ROW.map(u32::from);
        if [went(&self.shell, 0), went(&self.shell, 1)] != [[levels[0]; 2], [levels[1], 0]] {
            return wrong;
        }
        let late = self.ready() - 1;
        let words = self.frame(None, 0, late, &[Item::Row(late, [0; USED])]);
        self.hear_words(&words);
        self.take_all();
        for _ in 0..130 {
            self.tick_once();
        }
        if [went(&self.shell, 0), went(&self.shell, 1)] != levels.map(|level| [level; 2]) {
            return wrong;
        }
        self.shell.broken
    }
}

fn to(motor: u8, tick: u64, level: u16) -> Move {
    Move { motor, tick: Tick(tick), level, surplus: 0 }
}

/// A stroke of two pulses, one tick of rest, and two pulses.
fn short(motor: u8, up: u64) -> Stroke {
    Stroke { motor, up: Tick(up), level: 2, down: Tick(up + 3), surplus: 0 }
}

fn encoded(message: &HostMessage<'_>) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = frame::encode(message, &mut out).unwrap_or(0);
    out[..len].to_vec()
}

/// A stroke whose bursts are longer than two blocks.
fn long(motor: u8, up: u64) -> Stroke {
    Stroke { motor, up: Tick(up), level: 35, down: Tick(up + 37), surplus: 0 }
}

/// A stroke around a [`long`] one three ticks later: both pins are up, and only one has pulses.
fn around(motor: u8, up: u64) -> Stroke {
    let Stroke { level, down, .. } = long(motor, up + 3);
    Stroke { down: down + u64::from(level), ..short(motor, up) }
}

/// The exploration of the controller.
#[derive(Clone, Copy, Debug)]
pub struct Device(pub Bounds);

impl Model for Device {
    type State = Scene;
    type Action = Step;

    fn init_states(&self) -> Vec<Scene> {
        let started = Scene::new(self.0.one_at_once);
        let mut armed = started.clone();
        armed.begin_with(&[Step::Say(Say::Arm)]);
        let mut playing = armed.clone();
        playing.begin_with(&[Step::Say(Say::Onset), Step::Until(34)]);
        vec![started, armed, playing]
    }

    fn actions(&self, scene: &Scene, steps: &mut Vec<Step>) {
        if scene.shell.broken.is_some() {
            return;
        }
        // Once no more events are tried, the judgement of the end sees the rest.
        if scene.events < self.0.events || scene.pieces {
            steps.extend(scene.next_time(&self.0).map(Step::Until));
        }
        if scene.pieces {
            steps.push(Step::Piece);
        }
        if scene.events < self.0.events {
            steps.extend(SAYS.map(Step::Say));
            if scene.faults < self.0.faults {
                // A last message that is lost is the same as one not said.
                if scene.events + 1 < self.0.events {
                    steps.extend(SAYS.map(Step::Lose));
                }
                steps.extend((0..scene.said.len()).map(Step::Again));
                steps.extend([Step::Noise, Step::Urgent, Step::LinkLost, Step::Fault, Step::Hello]);
            }
        }
    }

    fn next_state(&self, scene: &Scene, step: Step) -> Option<Scene> {
        after(scene, |scene| &mut scene.shell, |next| next.apply(step, &self.0), Scene::judge_end)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            never!(HighAfterStop, "after an e-stop or a fault no line is high later than one period"),
            never!(HighDisarmed, "a disarmed device has no line high"),
            never!(Unasked, "no pulse that nobody asked for"),
            never!(Forgotten, "a pin that is not at its goal moves, or waits to come down"),
            never!(Return, "a return is over in time, and then all pins are down"),
            never!(InPart, "a motor's moves are replaced as a whole or not at all"),
            never!(Drivers, "drivers are enabled for bursts, and before them"),
            never!(Counts, "at rest every move is counted once, and every pulse"),
            never!(Position, "at rest the pins are where the controller says"),
            never!(Watchdog, "a silent host is noticed, and the device comes to rest"),
            never!(NoWayOut, "every state has a way out"),
            never!(AtOnce, "never more motors of a rail than the limit have pulses at once"),
            never!(Panic, "no panic"),
            // These show that the exploration reaches states in which the properties above can fail.
            Property::sometimes("moves are played", |_, scene: &Scene| scene.end.0.played > 0),
            Property::sometimes("moves are dropped", |_, scene: &Scene| scene.end.0.dropped > 0),
            Property::sometimes("moves are late", |_, scene: &Scene| scene.end.0.late > 0),
            Property::sometimes("moves are refused", |_, scene: &Scene| scene.end.0.refused > 0),
            Property::sometimes("moves are replaced", |_, scene: &Scene| scene.end.0.replaced > 0),
            Property::sometimes("moves are amended", |_, scene: &Scene| scene.end.0.amended > 0),
            Property::sometimes("moves are shortened", |_, scene: &Scene| scene.end.0.shortened > 0),
            Property::sometimes("amendments are ignored", |_, scene: &Scene| {
                scene.end.0.amendments_ignored > 0
            }),
            Property::sometimes("a pin stays up", |_, scene: &Scene| scene.shell.device.outstanding(1) > 0),
        ]
    }
}
