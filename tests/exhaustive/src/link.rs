//! All orders of what can happen between the host's link session and the device: the session's calls, a line that delivers, loses,
//! repeats, reorders and damages frames, a device that restarts, a cable that is unplugged.
//!
//! From every state that is reached the line becomes good: then session and device must come to agree, and every stroke must have its
//! verdict, and be on the lines if it was accepted.

use crate::shell::{Broken, Shell, after, never};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::Amendment;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, Counters, Op, State, Status};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::{self, Stroke};
use meissner_stream::link::{Event, LineRate, Session, Verdict};
use meissner_stream::time::HostInstant;
use stateright::{Model, Property};
use std::collections::VecDeque;
use std::fmt::{self, Write};
use std::hash::{DefaultHasher, Hash, Hasher};

/// How far the exploration goes.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Calls of the session, at most.
    pub calls: u8,
    /// Frames lost, repeated, reordered or damaged, restarts, and cables unplugged, at most.
    pub faults: u8,
    /// How often time passes without a delivery, at most.
    pub waits: u8,
}

/// A call of the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Call {
    /// Begins a play of two strokes.
    Begin,
    /// Pushes one more stroke of motor 0.
    Push,
    /// Pushes a stroke that comes too late.
    PushLate,
    /// Replaces the last stroke of motor 0.
    Replace,
    /// Amends it.
    Amend,
    /// Arms.
    Arm,
    /// Stops.
    Stop,
    /// Disarms.
    Disarm,
    /// Orders an e-stop.
    EStop,
    /// Orders an e-stop that also comes past the bytes that wait.
    Urgent,
    /// Resets.
    Reset,
}

const CALLS: [Call; 11] = [
    Call::Begin,
    Call::Push,
    Call::PushLate,
    Call::Replace,
    Call::Amend,
    Call::Arm,
    Call::Stop,
    Call::Disarm,
    Call::EStop,
    Call::Urgent,
    Call::Reset,
];

/// One step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Step {
    /// The session's owner calls it.
    Call(Call),
    /// The line delivers the oldest frame to the device, or to the host.
    Deliver(To),
    /// It loses it.
    Lose(To),
    /// It delivers it, and keeps it.
    Repeat(To),
    /// It lets the next frame overtake it.
    Swap(To),
    /// It damages it.
    Damage(To),
    /// Time passes until the session has something to do, at most 4 ms.
    Wait,
    /// The device restarts.
    Restart,
    /// The cable is unplugged and plugged in again.
    Unplug,
}

/// Where a frame goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum To {
    /// To the device.
    Device,
    /// To the host.
    Host,
}

/// Frames under way in each direction at most: the session waits beyond.
const UNDER_WAY: usize = 3;
const FAULTS: [fn(To) -> Step; 4] = [Step::Lose, Step::Repeat, Step::Swap, Step::Damage];

/// The outcome once the line has been good for long enough.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    counters: Counters,
    retransmitted: u64,
    sessions: u32,
}

/// A session, a device, and the line between them.
#[derive(Clone, Debug)]
pub struct Pair {
    session: Session,
    sessions: u32,
    shell: Shell,
    boots: u32,
    /// Ticks of the host's clock since the start.
    elapsed: u64,
    /// Frames under way, each with the number of its session: the frames of one do not overtake those of another.
    to_device: VecDeque<(u32, Vec<u8>)>,
    to_host: VecDeque<(u32, Vec<u8>)>,
    calls: u8,
    faults: u8,
    waits: u8,
    /// Strokes pushed since the last command or session, that have no verdict.
    waiting: VecDeque<Stroke>,
    /// Pulses that must be on the lines, by the verdicts.
    accepted: u64,
    /// Strokes were cut, refused, withdrawn or amended, or the device restarted: not all accepted pulses are played.
    cut: bool,
    /// A replacement is not answered yet.
    replacing: bool,
    last: Option<Stroke>,
    newest: Option<Status>,
    /// The outcome once both agree. It follows from the other fields.
    end: Outcome,
}

struct Text<'a, H>(&'a mut H);

impl<H: Hasher> Write for Text<'_, H> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

impl Hash for Pair {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Self {
            session,
            sessions,
            shell,
            boots,
            elapsed,
            to_device,
            to_host,
            calls,
            faults,
            waits,
            waiting,
            accepted,
            cut,
            replacing,
            last,
            newest,
            end: _,
        } = self;
        // The session has floating-point numbers, so its text is hashed, which is exact.
        let _ = write!(Text(hasher), "{session:?}");
        (sessions, shell, boots, elapsed, to_device, to_host, calls, faults, waits).hash(hasher);
        (waiting, accepted, cut, replacing, last, newest).hash(hasher);
    }
}

impl PartialEq for Pair {
    fn eq(&self, other: &Self) -> bool {
        let hash = |pair: &Self| {
            let mut hasher = DefaultHasher::new();
            pair.hash(&mut hasher);
            hasher.finish()
        };
        hash(self) == hash(other)
    }
}

impl Pair {
    /// A session that is open, its device armed.
    fn armed() -> Self {
        let mut pair = Self {
            session: Session::new(Array::paper(), 1, LineRate(100_000), HostInstant::from_ns(0)),
            sessions: 1,
            shell: Shell::new(1),
            boots: 1,
            elapsed: 0,
            to_device: VecDeque::new(),
            to_host: VecDeque::new(),
            calls: 0,
            faults: 0,
            waits: 0,
            waiting: VecDeque::new(),
            accepted: 0,
            cut: false,
            replacing: false,
            last: None,
            newest: None,
            end: Outcome::default(),
        };
        while !pair.session.is_open() {
            pair.exchange();
        }
        pair.call(Call::Arm);
        for _ in 0..20 {
            pair.exchange();
        }
        pair.calls = 0;
        pair
    }

    fn now(&self) -> HostInstant {
        HostInstant::from_ns(self.elapsed * 1_000_000_000 / 85_000)
    }

    /// A tick so far ahead that a stroke that is pushed now is in time on a good line.
    fn soon(&self) -> u64 {
        let tick = self.session.clock().tick_at(self.now()).unwrap_or_default();
        tick.0 + 340
    }

    fn call(&mut self, call: Call) -> Option<()> {
        self.calls += 1;
        match call {
            Call::Begin => {
                let at = self.soon();
                self.has_room()?;
                self.session.begin(Tick(at), None, u32::MAX);
                self.push(stroke(0, at))?;
                self.push(stroke(1, at + 3))?;
                self.session.seal();
            }
            Call::Push => {
                self.has_room()?;
                let at = self.last.map_or(0, |last| last.end().0).max(self.soon());
                self.push(stroke(0, at))?;
                self.session.seal();
            }
            Call::PushLate => {
                self.has_room()?;
                let at = self.soon() - 400;
                self.push(stroke(1, at))?;
                self.session.seal();
            }
            Call::Replace => {
                self.has_room()?;
                let last = self.last.filter(|_| !self.replacing)?;
                (self.replacing, self.cut) = (true, true);
                self.session.replace(last.up, MotorSet::from_bits(1), MotorSet::EMPTY);
                self.push(Stroke { up_pulses: 3, down_pulses: 3, ..last })?;
                self.session.seal();
            }
            Call::Amend => {
                let last = self.last?;
                self.cut = true;
                self.shell.ask_amendment();
                let pulses = last.up_pulses + 1;
                let amendment = Amendment { motor: 0, tick: last.up, pulses };
                if !self.session.amend(&amendment) {
                    return None;
                }
            }
            Call::Arm => {
                let assume_rest = self.newest.is_none_or(|status| !status.position_known);
                let (host_timeout, limits) = (3 * 85_000, Array::paper().layout().no_limits());
                self.command(Op::Arm { assume_rest, host_timeout, limits, lower_stop: None })?;
                // The device may have been disarmed, and return.
                self.shell.off_since = None;
            }
            Call::Stop => self.command(Op::Stop)?,
            Call::Disarm => self.command(Op::Disarm(Cause::Shutdown))?,
            Call::EStop => self.command(Op::EStop)?,
            Call::Urgent => {
                self.command(Op::EStop)?;
                let epoch = self.session.take_e_stop()?;
                // The shell compares epochs when it finds the e-stop.
                let device = self.shell.device.epoch();
                if device.is_some_and(|device| firmware_protocol::controller::newer(epoch, device)) {
                    self.shell.device.e_stop(Tick(self.shell.now), epoch);
                    self.shell.off_since = Some(self.shell.now);
                    self.shell.drivers_off();
                }
            }
            Call::Reset => self.command(Op::Reset)?,
        }
        self.pump();
        Some(())
    }

    fn has_room(&self) -> Option<()> {
        (self.session.has_room() && self.session.credits() >= 4).then_some(())
    }

    fn push(&mut self, stroke: Stroke) -> Option<()> {
        if !self.session.push(&stroke.into()) {
            return None;
        }
        self.shell.ask(&stroke.packed()?.moves());
        self.waiting.push_back(stroke);
        if stroke.motor == 0 {
            self.last = Some(stroke);
        }
        Some(())
    }

    fn command(&mut self, op: Op) -> Option<()> {
        if !self.session.can_command() {
            return None;
        }
        self.session.command(op);
        self.waiting.clear();
        (self.cut, self.replacing) = (true, false);
        Some(())
    }

    /// Lets session and device put on the line what they have to send.
    fn pump(&mut self) {
        let (now, mut frame) = (self.now(), [0; MAX_FRAME]);
        let mut events = Vec::new();
        while self.to_device.len() < UNDER_WAY {
            let len = self.session.transmit(now, &mut frame, &mut |event| events.push(event));
            if len == 0 {
                break;
            }
            self.to_device.push_back((self.sessions, frame[..len].to_vec()));
        }
        while self.to_host.len() < UNDER_WAY {
            let len = self.shell.device.transmit(Tick(self.shell.now), &mut frame);
            if len == 0 {
                break;
            }
            self.to_host.push_back((self.sessions, frame[..len].to_vec()));
        }
        self.session.check_silence(now, &mut |event| events.push(event));
        self.hear(events);
    }

    fn deliver(&mut self, to: To, bytes: &[u8]) {
        let now = self.now();
        match to {
            To::Device => {
                let before = self.shell.device.state();
                self.shell.device.receive(Tick(self.shell.now), bytes);
                self.shell.watch_return();
                if before != State::Faulted && self.shell.device.state() == State::Faulted {
                    self.shell.off_since = Some(self.shell.now);
                    self.shell.drivers_off();
                }
            }
            To::Host => {
                let mut events = Vec::new();
                self.session.receive(now, bytes, &mut |event| events.push(event));
                self.hear(events);
            }
        }
        self.pump();
    }

    fn hear(&mut self, events: Vec<Event>) {
        for event in events {
            match event {
                Event::Status { status, .. } => self.newest = Some(status),
                Event::Step(strokes::Step::Stroke(stroke), verdict) => self.judge(stroke, verdict),
                Event::Replaced { .. } => self.replacing = false,
                // The device refused all strokes of that frame, which is the first that waits.
                Event::OnsetRefused { .. } => {
                    self.waiting.drain(..self.waiting.len().min(2));
                }
                Event::Cut { .. } | Event::StrokeRefused { .. } => self.cut = true,
                Event::Contradiction(_) => self.shell.breaks(Broken::Disagree),
                Event::Lost(_) => self.reconnect(),
                _ => {}
            }
        }
    }

    fn judge(&mut self, stroke: Stroke, verdict: Verdict) {
        if self.waiting.front() == Some(&stroke) {
            self.waiting.pop_front();
            if verdict == Verdict::Accepted {
                self.accepted += u64::from(stroke.pulses());
            }
        } else if verdict == Verdict::Accepted || !self.cut {
            // After a command the session tells only of strokes that the device did not accept.
            self.shell.breaks(Broken::Verdict);
        }
    }

    /// The streamer opens another session.
    fn reconnect(&mut self) {
        self.sessions += 1;
        self.session = Session::new(Array::paper(), self.sessions, LineRate(100_000), self.now());
        self.waiting.clear();
        (self.cut, self.replacing, self.last, self.newest) = (true, false, None, None);
    }

    fn wait(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.elapsed += 1;
            self.shell.tick();
        }
        self.pump();
    }

    /// A good line for a millisecond.
    fn exchange(&mut self) {
        self.pump();
        for _ in 0..8 {
            let (out, back) = (self.to_device.pop_front(), self.to_host.pop_front());
            if out.is_none() && back.is_none() {
                break;
            }
            out.into_iter().for_each(|(_, frame)| self.deliver(To::Device, &frame));
            back.into_iter().for_each(|(_, frame)| self.deliver(To::Host, &frame));
        }
        self.wait(85);
    }

    fn line(&mut self, to: To) -> &mut VecDeque<(u32, Vec<u8>)> {
        match to {
            To::Device => &mut self.to_device,
            To::Host => &mut self.to_host,
        }
    }

    fn apply(&mut self, step: Step) -> Option<()> {
        if !matches!(step, Step::Call(_) | Step::Deliver(_) | Step::Wait) {
            self.faults += 1;
        }
        match step {
            Step::Call(call) => self.call(call)?,
            Step::Deliver(to) => {
                let (_, frame) = self.line(to).pop_front()?;
                self.deliver(to, &frame);
            }
            Step::Lose(to) => {
                self.line(to).pop_front()?;
                self.pump();
            }
            Step::Repeat(to) => {
                let (_, frame) = self.line(to).front()?.clone();
                self.deliver(to, &frame);
            }
            Step::Swap(to) => {
                let line = self.line(to);
                if line.len() < 2 || line[0].0 != line[1].0 {
                    return None;
                }
                line.swap(0, 1);
            }
            Step::Damage(to) => {
                let (_, mut frame) = self.line(to).pop_front()?;
                // The delimiter is lost, so that the next frame is read with this one.
                frame.pop();
                self.deliver(to, &frame);
            }
            Step::Wait => {
                self.waits += 1;
                let due = self.session.wake_at(self.now()).since(self.now());
                let ticks = (due.as_secs_f64() * 85_000.0).ceil().clamp(1.0, 340.0);
                self.wait(ticks as u64);
            }
            Step::Restart => {
                self.boots += 1;
                let broken = self.shell.broken;
                self.shell = Shell::starting_at(self.boots, self.shell.start());
                self.shell.broken = broken;
                self.to_host.clear();
                self.cut = true;
            }
            Step::Unplug => {
                self.shell.device.link_lost(Tick(self.shell.now));
                (self.to_device, self.to_host) = (VecDeque::new(), VecDeque::new());
                self.reconnect();
            }
        }
        Some(())
    }

    /// The line is good from now on.
    fn judge_end(&mut self) -> Option<Broken> {
        let mut end = self.clone();
        // A lost session needs seconds to notice.
        let mut agreed = 0;
        for round in 0..6_000 {
            end.exchange();
            if round % 8 == 0 {
                end.session.request_status();
            }
            let same = end.newest.is_some_and(|status| {
                let device = &end.shell.device;
                status.state == device.state() && status.counters == device.counters()
            });
            let ready = end.session.is_open() && end.session.is_answered() && end.waiting.is_empty();
            agreed = if same && ready { agreed + 1 } else { 0 };
            if agreed >= 20 || end.shell.broken.is_some() {
                break;
            }
        }
        if let Some(broken) = end.shell.broken {
            return Some(broken);
        }
        let (counters, retransmitted) = (end.shell.device.counters(), end.session.traffic().retransmitted);
        self.end = Outcome { counters, retransmitted, sessions: end.sessions };
        if agreed == 0 {
            return Some(if end.waiting.is_empty() { Broken::Disagree } else { Broken::Verdict });
        }
        let pulses: u64 = end.shell.seen.iter().flatten().map(|&seen| u64::from(seen)).sum();
        let exact = !end.cut && pulses != end.accepted;
        if pulses < end.shell.device.counters().pulses || exact {
            return Some(Broken::Counts);
        }
        None
    }
}

/// A stroke of two pulses, one tick of rest, and two pulses.
fn stroke(motor: u8, up: u64) -> Stroke {
    Stroke { motor, up: Tick(up), up_pulses: 2, down: Tick(up + 3), down_pulses: 2 }
}

/// The exploration of the link.
#[derive(Clone, Copy, Debug)]
pub struct Link(pub Bounds);

impl Model for Link {
    type State = Pair;
    type Action = Step;

    fn init_states(&self) -> Vec<Pair> {
        let mut pair = Pair::armed();
        pair.cut = false;
        vec![pair]
    }

    fn actions(&self, pair: &Pair, steps: &mut Vec<Step>) {
        if pair.shell.broken.is_some() {
            return;
        }
        let goes_on = pair.calls < self.0.calls || pair.faults < self.0.faults;
        if !goes_on {
            return;
        }
        if pair.calls < self.0.calls {
            steps.extend(CALLS.map(Step::Call));
        }
        for (to, line) in [(To::Device, &pair.to_device), (To::Host, &pair.to_host)] {
            if line.is_empty() {
                continue;
            }
            steps.push(Step::Deliver(to));
            if pair.faults < self.0.faults {
                steps.extend(FAULTS.map(|fault| fault(to)));
            }
        }
        if pair.waits < self.0.waits {
            steps.push(Step::Wait);
        }
        if pair.faults < self.0.faults {
            steps.extend([Step::Restart, Step::Unplug]);
        }
    }

    fn next_state(&self, pair: &Pair, step: Step) -> Option<Pair> {
        after(pair, |pair| &mut pair.shell, |next| next.apply(step), Pair::judge_end)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        let mut properties = vec![
            never!(HighAfterStop, "after an e-stop or a fault no line is high later than one period"),
            never!(HighDisarmed, "a disarmed device has no line high"),
            never!(Unasked, "no pulse that nobody asked for"),
            never!(Forgotten, "a pin that is not at its goal moves, or waits to come down"),
            never!(Return, "a return is over in time, and then all pins are down"),
            never!(Drivers, "drivers are enabled for bursts, and before them"),
            never!(Verdict, "every stroke has one verdict, and the right one"),
            never!(Counts, "what was accepted is on the lines"),
            never!(Disagree, "host and device agree once the line is good"),
            never!(Panic, "no panic"),
            // These show that the exploration reaches states in which the properties above can fail.
            Property::sometimes("strokes are played", |_, pair: &Pair| pair.end.counters.played > 0),
            Property::sometimes("strokes are dropped", |_, pair: &Pair| pair.end.counters.dropped > 0),
            Property::sometimes("strokes are late", |_, pair: &Pair| pair.end.counters.late > 0),
        ];
        if self.0.faults > 0 {
            properties.extend([
                Property::sometimes("frames are sent again", |_, pair: &Pair| pair.end.retransmitted > 0),
                Property::sometimes("another session is opened", |_, pair: &Pair| pair.end.sessions > 1),
            ]);
        }
        properties
    }
}
