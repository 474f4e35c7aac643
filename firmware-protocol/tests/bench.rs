//! A shell around the controller, as thin as the firmware's, that records every pulse.
//!
//! It renders in blocks and holds the lines low while `forced_off`. Only [`Bench::tick`] moves time. An event reaches the
//! controller in the tick `now`, whose lines are already out (except in [`MOCK`]). In each tick it checks the driver enable, and counts
//! the motors of each rail and chip that have pulses at once.

use crate::rule::Rule;
use firmware_protocol::array::{ArrayId, Layout, MotorSet, Name};
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::{BLOCK, Controller, DRIVER_TAIL, HORIZON, Identity, REORDER_WINDOW, Run};
use firmware_protocol::frame::{Decoder, MAX_FRAME, encode};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{
    Cause, Cut, DeviceMessage, HostMessage, LowerStop, Mark, MarkKind, Op, Report, State, Status, Trigger,
    Withdraw,
};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::{Direction, Line, Lines};
use firmware_protocol::tick::Tick;
use serde::Serialize;
use std::collections::VecDeque;

/// The paper's array, which the tests are about unless they name another.
pub(crate) const PAPER: Layout = layout("tula35-6x4", 85_000, &grouped::<24>(6), &grouped::<24>(2), 3_000);
pub(crate) const MOTORS: usize = PAPER.motors();
pub(crate) const TICK_HZ: u32 = PAPER.tick_hz();
pub(crate) const NO_LIMITS: PowerLimits = PAPER.no_limits();

pub(crate) const MAX_PUSHES_PER_S: u32 = PAPER.max_pushes_per_s();

pub(crate) const WHOLE_TRAVEL: u16 = PAPER.whole_travel();
pub(crate) const MAX_SEEK: u16 = PAPER.max_seek();
pub(crate) const LEAST_APART: u64 = PAPER.least_apart() as u64;
pub(crate) const PULSE: Trigger = PAPER.trigger_pulse();

/// A layout with these groups.
const fn layout(name: &str, tick_hz: u32, rails: &[u8], chips: &[u8], most_pulses: u16) -> Layout {
    let Some(name) = Name::new(name) else { panic!("a name") };
    let id = ArrayId { name, motors: rails.len() as u8, tick_hz, duty_up: 250, duty_down: 750, hash: 1 };
    match Layout::new(id, rails, chips, most_pulses, 17_000) {
        Ok(layout) => layout,
        Err(_) => panic!("a layout"),
    }
}

/// For each motor its number divided by `by`.
const fn grouped<const N: usize>(by: usize) -> [u8; N] {
    let (mut groups, mut motor) = ([0; N], 0);
    while motor < N {
        groups[motor] = (motor / by) as u8;
        motor += 1;
    }
    groups
}

/// Eight supplies of eight motors, whose chips have three, three and two of them.
#[cfg(not(feature = "pico"))]
const fn chips_of_eights() -> [u8; 64] {
    let (mut chips, mut motor) = ([0; 64], 0);
    while motor < 64 {
        chips[motor] = (motor / 8 * 3 + motor % 8 / 3) as u8;
        motor += 1;
    }
    chips
}

/// Arrays of several sizes and carriers: the paper's; one supply; groups of all sizes, with gaps in their numbers and motors in no order;
/// as many motors as there may be, where the build has room for them.
pub(crate) const LAYOUTS: &[Layout] = &[
    PAPER,
    layout("two-by-three", 20_000, &[0; 6], &grouped::<6>(2), 3_000),
    layout("three-by-three", 70_000, &[0, 7, 0, 7, 0, 7, 7, 0, 7], &[1, 9, 1, 9, 1, 63, 9, 4, 63], 500),
    layout("six-by-four", 70_000, &grouped::<24>(6), &grouped::<24>(2), 3_000),
    #[cfg(not(feature = "pico"))]
    layout("eight-by-eight", 200_000, &grouped::<64>(8), &chips_of_eights(), 3_000),
];

/// How a shell renders: blocks of `block` ticks, up to `ahead` ticks from now.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shell {
    pub(crate) ahead: u64,
    pub(crate) block: u64,
}

/// Blocks up to the horizon.
pub(crate) const FIRMWARE: Shell = Shell { ahead: HORIZON as u64, block: BLOCK as u64 };
/// Only the tick being played.
pub(crate) const TIGHT: Shell = Shell { ahead: 1, block: 1 };
/// Bytes first, then the ticks up to now: nothing is rendered ahead when an event comes.
pub(crate) const MOCK: Shell = Shell { ahead: 0, block: 1 };
pub(crate) const SHELLS: [Shell; 3] = [FIRMWARE, TIGHT, MOCK];

/// The mark of a play with a usual trigger.
pub(crate) const ONSET: Mark = Mark { kind: MarkKind::Play, trigger: Some(PULSE), hold: 60 * TICK_HZ };

/// A train of pulses in one direction, one pulse a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Burst {
    pub(crate) start: Tick,
    pub(crate) direction: Direction,
    pub(crate) pulses: u16,
}

impl Burst {
    /// The first tick after the last pulse.
    pub(crate) fn end(&self) -> Tick {
        self.start + u64::from(self.pulses)
    }
}

/// The lower stop that [`arm`] names.
pub(crate) const STOP: LowerStop = LowerStop { pulses_per_s: MAX_PUSHES_PER_S, seek: 0 };

/// Ticks from now to [`Bench::soon`].
pub(crate) const SOON: u64 = PAPER.horizon() as u64 + 5;

/// The host watchdog timeout that [`Bench::arm`] sets.
pub(crate) const HOST_TIMEOUT: u32 = 2 * TICK_HZ;

pub(crate) struct Bench {
    pub(crate) device: Controller,
    pub(crate) now: u64,
    start: u64,
    shell: Shell,
    /// The limits of the last `arm`.
    limits: PowerLimits,
    /// Whether it takes frames as the firmware does: a piece in each block, with lines rendered in between.
    pub(crate) in_pieces: bool,
    /// Runs of one tick, each with whether a stroke that was to begin then or soon was refused by a limit, withdrawn or flushed.
    ahead: VecDeque<(Run, bool)>,
    /// Moves refused as they began, withdrawn or flushed until the last tick was rendered.
    taken_back: u64,
    /// The tick by which a shift of rest has begun or was flushed.
    shift_by: u64,
    log: Vec<(u64, Lines)>,
    /// Ticks in which the trigger was high.
    pub(crate) triggered: Vec<u64>,
    /// Ticks for which the drivers have been enabled, and those without a pulse.
    enabled: u32,
    enabled_idle: u32,
    /// Ticks in which the drivers were enabled.
    pub(crate) enabled_ticks: u64,
    decoder: Decoder,
    /// All messages that the device has sent.
    pub(crate) inbox: Vec<DeviceMessage>,
    pub(crate) epoch: u16,
    pub(crate) seq: u16,
    /// Number of the last report read. Sent as `seen` while `reading`.
    pub(crate) seen: u16,
    pub(crate) reading: bool,
    /// Prints the host's messages.
    pub(crate) prints: bool,
    /// Judges every tick, if it is there.
    pub(crate) rule: Option<Box<Rule>>,
}

pub(crate) fn stroke(motor: u8, up: u64, pulses: u16, hold: u64, down_pulses: u16) -> Stroke {
    let surplus = down_pulses - pulses;
    Stroke { motor, up: Tick(up), level: pulses, down: Tick(up + u64::from(pulses) + hold), surplus }
}

pub(crate) fn to(motor: u8, tick: u64, level: u16) -> Move {
    Move { motor, tick: Tick(tick), level, surplus: 0 }
}

pub(crate) fn burst(start: u64, direction: Direction, pulses: u64) -> Burst {
    Burst { start: Tick(start), direction, pulses: u16::try_from(pulses).expect("a burst") }
}

/// `message` as a frame.
pub(crate) fn frame(message: &impl Serialize) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let len = encode(message, &mut out).expect("a message that fits");
    out[..len].to_vec()
}

/// Strokes packed for a batch that counts from `base`.
pub(crate) fn pack(base: u64, strokes: &[Stroke]) -> Packer<BATCH_BYTES> {
    let mut packer = Packer::new(Tick(base));
    for stroke in strokes {
        packer.stroke(stroke).expect("room for a stroke");
    }
    packer
}

impl Bench {
    pub(crate) fn new(shell: Shell) -> Self {
        Self::starting_at(shell, Tick::BOOT)
    }

    pub(crate) fn starting_at(shell: Shell, start: Tick) -> Self {
        Self::of(shell, PAPER, start)
    }

    /// A bench of another array.
    pub(crate) fn of(shell: Shell, layout: Layout, start: Tick) -> Self {
        let mut bench = Self {
            device: Controller::starting_at(Identity { boot: 7, ..Identity::default() }, layout, start),
            now: start.0,
            start: start.0,
            shell,
            limits: layout.no_limits(),
            in_pieces: false,
            ahead: VecDeque::new(),
            taken_back: 0,
            shift_by: 0,
            log: Vec::new(),
            triggered: Vec::new(),
            enabled: 0,
            enabled_idle: 0,
            enabled_ticks: 0,
            decoder: Decoder::default(),
            inbox: Vec::new(),
            epoch: 0,
            seq: 0,
            seen: 0,
            reading: true,
            prints: false,
            rule: None,
        };
        bench.fill(bench.now + shell.ahead);
        if shell.ahead > 0 {
            bench.play();
        }
        bench
    }

    /// A tick at which a stroke that is sent now can begin, in every shell, whether the drivers are on or not.
    pub(crate) fn soon(&self) -> u64 {
        self.now + u64::from(self.layout().horizon()) + 5
    }

    pub(crate) fn layout(&self) -> Layout {
        *self.device.layout()
    }

    /// An armed bench with every pin at rest.
    pub(crate) fn armed(shell: Shell) -> Self {
        let mut bench = Self::new(shell);
        bench.hello(1);
        bench.arm(true);
        assert_eq!(bench.device.state(), State::Armed);
        bench
    }

    /// As [`Self::armed`], on an array without a lower stop: there an amendment may lengthen a down burst.
    pub(crate) fn armed_without_stop(shell: Shell) -> Self {
        Self::without_stop(Self::new(shell), HOST_TIMEOUT, NO_LIMITS)
    }

    pub(crate) fn without_stop(mut bench: Self, host_timeout: u32, limits: PowerLimits) -> Self {
        bench.hello(1);
        bench.control(Op::Arm { assume_rest: true, host_timeout, limits, lower_stop: None });
        assert_eq!(bench.device.state(), State::Armed);
        bench
    }

    fn fill(&mut self, to: u64) {
        while self.device.rendered().0 < to {
            let run_begins = self.device.rendered().0;
            let run = self.device.render((to - run_begins) as u32);
            let counters = self.device.counters();
            // A move that has begun may find its pin where it should be.
            let taken_back = counters.refused + counters.replaced + counters.dropped + counters.played;
            let refuses = taken_back > std::mem::replace(&mut self.taken_back, taken_back)
                || run_begins < self.shift_by;
            assert!(run.ticks > 0, "rendering makes progress");
            if let Some(rule) = &mut self.rule {
                (run_begins..).take(run.ticks as usize).for_each(|tick| rule.render(tick, run));
            }
            self.ahead.extend((0..run.ticks).map(|_| (Run { ticks: 1, ..run }, refuses)));
        }
        assert!(self.device.rendered() - Tick(self.now) <= u64::from(HORIZON));
    }

    /// Puts out the lines of the tick `now`.
    fn play(&mut self) {
        let (rendered, refuses) = self.ahead.pop_front().expect("a rendered tick");
        let forced = self.device.forced_off(Tick(self.now));
        let off = Run { lines: Lines::OFF, trigger: false, drivers: false, ticks: 1 };
        let Run { lines, trigger, drivers, .. } = if forced { off } else { rendered };
        self.check_drivers(lines != Lines::OFF, drivers, refuses);
        if trigger {
            self.triggered.push(self.now);
        }
        assert!((lines.up & lines.down).is_empty(), "a line in both sets");
        let all = self.layout().all();
        assert!(lines.pulsing().without(all).is_empty(), "a line that does not exist");
        self.check_at_once(lines.pulsing());
        if lines != Lines::OFF {
            let state = self.device.state();
            assert!(
                !matches!(state, State::Faulted | State::Disarmed),
                "a pulse while {state:?} at {}",
                self.now
            );
            if let Some(rule) = &mut self.rule {
                rule.play(lines);
            }
            self.log.push((self.now, lines));
        }
    }

    /// Asserts that no more motors of a rail or a chip have pulses than the limits allow.
    fn check_at_once(&self, pulses: MotorSet) {
        if pulses.is_empty() {
            return;
        }
        let PowerLimits { rail_at_once, chip_at_once, .. } = self.limits;
        let (mut rails, mut chips) = ([0_u8; 64], [0_u8; 64]);
        for motor in pulses.iter().map(usize::from) {
            rails[usize::from(self.device.layout().rail(motor))] += 1;
            chips[usize::from(self.device.layout().chip(motor))] += 1;
        }
        let groups = [(rails, rail_at_once), (chips, chip_at_once)];
        for (groups, limit) in groups {
            let at_once = groups.into_iter().max().unwrap_or(0);
            assert!(at_once <= limit, "{at_once} of a group at {}", self.now);
        }
    }

    /// Asserts that no pulse comes before the drivers' lead, and that the drivers are not enabled for longer than lead and tail
    /// without a pulse. They may be if a limit refuses a stroke in the tick in which it was to begin, or if a frame withdraws it
    /// or a cut flushes it shortly before.
    fn check_drivers(&mut self, pulse: bool, enabled: bool, refuses: bool) {
        let at = self.now;
        if !enabled {
            assert!(!pulse, "a pulse with the drivers off at {at}");
            (self.enabled, self.enabled_idle) = (0, 0);
            return;
        }
        let lead = self.device.layout().driver_lead();
        self.enabled += 1;
        self.enabled_ticks += 1;
        self.enabled_idle = if pulse || refuses { 0 } else { self.enabled_idle + 1 };
        assert!(!pulse || self.enabled > lead, "a pulse {} ticks after the enable at {at}", self.enabled - 1);
        assert!(self.enabled_idle <= lead + DRIVER_TAIL, "drivers enabled without a pulse at {at}");
    }

    /// Lets one tick pass.
    pub(crate) fn tick(&mut self) {
        if self.shell.ahead == 0 {
            self.fill(self.now + 1);
            self.play();
        }
        self.now += 1;
        if (self.now - self.start).is_multiple_of(self.shell.block) {
            let before = self.device.state();
            if self.in_pieces {
                self.device.advance(Tick(self.now));
            } else {
                self.device.poll(Tick(self.now));
            }
            self.changed_from(before);
            self.fill(self.now + self.shell.ahead);
            self.drain();
        }
        if self.shell.ahead > 0 {
            self.play();
        }
    }

    /// What came of an event.
    pub(crate) fn changed_from(&mut self, before: State) {
        let after = self.device.state();
        if after == State::Faulted {
            // A shell forces the drivers off at once.
            (self.enabled, self.enabled_idle) = (0, 0);
        }
        let Some(rule) = &mut self.rule else { return };
        match (before, after) {
            (State::Armed, State::Returning | State::Disarmed) => rule.come_down(false),
            (State::Armed | State::Returning | State::Disarmed, State::Faulted) => rule.turn_off(),
            _ => {}
        }
    }

    pub(crate) fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick();
        }
    }

    pub(crate) fn run_to(&mut self, tick: u64) {
        while self.now < tick {
            self.tick();
        }
    }

    /// Runs until the controller has returned and every stroke is booked.
    pub(crate) fn settle(&mut self) {
        self.run(100);
        // Each motor after the other, with all that it may push.
        let longest = 64 * 2 * u64::from(self.layout().max_seek());
        let end = self.now + longest;
        while self.device.state() == State::Returning {
            assert!(self.now < end, "a return of more than {longest} ticks");
            self.tick();
        }
    }

    /// Takes the frames that the device sends now.
    pub(crate) fn drain(&mut self) {
        loop {
            let mut out = [0; MAX_FRAME];
            let len = self.device.transmit(Tick(self.now), &mut out);
            if len == 0 {
                return;
            }
            let mut bytes = &out[..len];
            let body = self.decoder.next(&mut bytes).expect("a whole frame").expect("a valid frame");
            let message: DeviceMessage = postcard::from_bytes(body).expect("a message");
            if let DeviceMessage::Hello(hello) = message {
                (self.epoch, self.seq, self.seen) = (hello.epoch, 0, hello.reports);
            }
            if let DeviceMessage::Report { number, .. } = message
                && number == self.seen.wrapping_add(1)
            {
                self.seen = number;
            }
            self.inbox.push(message);
        }
    }

    pub(crate) fn bytes(&mut self, mut bytes: &[u8]) {
        let before = self.device.state();
        if self.in_pieces {
            while !bytes.is_empty() {
                self.device.read(Tick(self.now), &mut bytes);
            }
        } else {
            self.device.receive(Tick(self.now), bytes);
        }
        self.changed_from(before);
        self.drain();
    }

    /// Has the device take its buffered frames that are next in order, one with each poll.
    pub(crate) fn follow(&mut self) {
        for _ in 0..REORDER_WINDOW {
            self.device.poll(Tick(self.now));
        }
        self.drain();
    }

    pub(crate) fn send(&mut self, message: &HostMessage<'_>) {
        if self.prints {
            println!("{} {:?}: {message:?}", self.now, self.device.state());
        }
        self.bytes(&frame(message));
    }

    pub(crate) fn seen(&self) -> u16 {
        if self.reading { self.seen } else { 0 }
    }

    pub(crate) fn hello(&mut self, session: u32) {
        self.send(&HostMessage::Hello { session });
    }

    pub(crate) fn ping(&mut self, token: u16) {
        self.send(&HostMessage::Ping { token, seen: self.seen() });
    }

    pub(crate) fn control(&mut self, op: Op) {
        if let Op::Arm { limits, .. } = op
            && self.device.state() == State::Disarmed
        {
            self.limits = self.layout().no_limits().min(limits);
        }
        if let Op::Move { .. } = op {
            self.shift_by = self.soon();
        }
        self.epoch = self.epoch.wrapping_add(1);
        self.seq = 0;
        self.send(&HostMessage::Control { epoch: self.epoch, seen: self.seen(), op });
    }

    pub(crate) fn arm(&mut self, assume_rest: bool) {
        self.control(arm(assume_rest, HOST_TIMEOUT, self.layout().no_limits()));
    }

    pub(crate) fn limited(shell: Shell, motor: u32, rail: u32) -> Self {
        Self::without_stop(Self::new(shell), 10 * TICK_HZ, PowerLimits { motor, rail, ..NO_LIMITS })
    }

    /// Sends the next frame of the stream.
    pub(crate) fn frame(&mut self, mark: Option<Mark>, base: u64, batch: &[u8]) {
        let (epoch, seq, seen) = (self.epoch, self.seq, self.seen());
        let withdraw = None;
        self.send(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base: Tick(base).wire(), batch });
        self.seq = self.status().next_seq;
    }

    /// Sends a frame that withdraws from `base` on what these motors have queued, and queues these strokes.
    pub(crate) fn replace(&mut self, motors: u64, generation: u16, base: u64, strokes: &[Stroke]) {
        let bytes = self.replacement(
            None,
            Withdraw { motors: MotorSet::from_bits(motors), generation },
            base,
            strokes,
        );
        self.bytes(&bytes);
        self.seq = self.status().next_seq;
    }

    /// The same as bytes, perhaps with a mark.
    pub(crate) fn replacement(
        &self,
        mark: Option<Mark>,
        withdraw: Withdraw,
        base: u64,
        strokes: &[Stroke],
    ) -> Vec<u8> {
        let (epoch, seq, seen) = (self.epoch, self.seq, self.seen());
        let batch = pack(base, strokes);
        let (withdraw, base, batch) = (Some(withdraw), Tick(base).wire(), batch.bytes());
        frame(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch })
    }

    pub(crate) fn strokes(&mut self, strokes: &[Stroke]) {
        let base = strokes[0].up.0;
        self.frame(None, base, pack(base, strokes).bytes());
    }

    pub(crate) fn onset(&mut self, base: u64, strokes: &[Stroke]) {
        self.frame(Some(ONSET), base, pack(base, strokes).bytes());
    }

    /// Sends moves in any order of motors.
    pub(crate) fn moves(&mut self, moves: &[Move]) {
        let base = moves[0].tick.0;
        let mut packer = Packer::<BATCH_BYTES>::new(Tick(base));
        moves.iter().for_each(|to| packer.moves(to).expect("room for a move"));
        self.frame(None, base, packer.bytes());
    }

    pub(crate) fn amend(&mut self, generation: u16, motor: u8, tick: Tick, pulses: u16) {
        let mut packer = Packer::<BATCH_BYTES>::new(tick);
        packer.amendment(&Amendment { motor, tick, pulses }).expect("room");
        let (epoch, base) = (self.epoch, tick.wire());
        self.send(&HostMessage::Amend { epoch, generation, base, items: packer.bytes() });
    }

    /// The last status.
    pub(crate) fn status(&self) -> Status {
        let last = self.inbox.iter().rev().find_map(|message| match message {
            DeviceMessage::Status(status) => Some(*status),
            _ => None,
        });
        last.expect("a status")
    }

    /// Every report, once, in order.
    pub(crate) fn reports(&self) -> Vec<Report> {
        let (mut reports, mut last) = (Vec::new(), None::<u16>);
        for message in &self.inbox {
            if let DeviceMessage::Report { number, report } = message
                && last.is_none_or(|last| last.wrapping_add(1) == *number)
            {
                reports.push(*report);
                last = Some(*number);
            }
        }
        reports
    }

    /// The last report: a cut. What it says of the return is what was on the lines.
    pub(crate) fn last_cut(&self) -> Cut {
        let Report::Cut(cut) = self.last_report() else { panic!("{:?} is no cut", self.last_report()) };
        if let Some(ticks) = cut.return_ticks {
            let at = cut.at.near(Tick(self.now)).0;
            let over = self.last_pulse().map_or(at, |last| at.max(last + 1));
            assert!(over <= at + u64::from(ticks), "{cut:?}, and the last pulse was before {over}");
        }
        cut
    }

    pub(crate) fn last_report(&self) -> Report {
        *self.reports().last().expect("a report")
    }

    /// Tick and direction of every pulse of the motor.
    pub(crate) fn pulses(&self, motor: u8) -> impl Iterator<Item = (u64, Direction)> + '_ {
        self.log.iter().filter_map(move |(tick, lines)| match lines.line(motor) {
            Line::Pulse(direction) => Some((*tick, direction)),
            Line::Off => None,
        })
    }

    /// The pulses of the motor as bursts.
    pub(crate) fn bursts(&self, motor: u8) -> Vec<Burst> {
        let mut bursts: Vec<Burst> = Vec::new();
        for (tick, direction) in self.pulses(motor) {
            match bursts.last_mut() {
                Some(last) if last.end() == Tick(tick) && last.direction == direction => last.pulses += 1,
                _ => bursts.push(burst(tick, direction, 1)),
            }
        }
        bursts
    }

    /// Up pulses minus down pulses so far.
    pub(crate) fn net(&self, motor: u8) -> i64 {
        self.pulses(motor).map(|(_, direction)| if direction == Direction::Up { 1 } else { -1 }).sum()
    }

    /// Height of a pin above a lower stop that it began at, in pulses.
    pub(crate) fn above_stop(&self, motor: u8) -> u64 {
        self.pulses(motor).fold(0, |above, (_, way)| match way {
            Direction::Up => above + 1,
            Direction::Down => above.saturating_sub(1),
        })
    }

    /// Pulses on all lines so far.
    pub(crate) fn total(&self) -> u64 {
        self.log.iter().map(|(_, lines)| u64::from(lines.pulsing().len())).sum()
    }

    /// The last tick with a pulse.
    pub(crate) fn last_pulse(&self) -> Option<u64> {
        self.log.last().map(|(tick, _)| *tick)
    }

    pub(crate) fn outstanding(&self) -> u64 {
        (0..64).map(|motor| u64::from(self.device.outstanding(motor))).sum()
    }

    pub(crate) fn is(&self, state: State, cause: Cause) {
        assert_eq!((self.device.state(), self.device.cause()), (state, cause), "at {}", self.now);
    }
}

pub(crate) fn arm(assume_rest: bool, host_timeout: u32, limits: PowerLimits) -> Op {
    Op::Arm { assume_rest, host_timeout, limits, lower_stop: Some(STOP) }
}
