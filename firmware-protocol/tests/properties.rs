//! Any bytes are a world of requests, faults, noise and silence: pins come down, no limit breaks, every move and every pulse is
//! counted once, and from every state a new host finds its way to a play. Without corrections and shifts the lines are as
//! [`crate::rule`] says.
//!
//! `cargo test` plays the same bytes in every run; the long form plays those of `MEISSNER_SEED`, or of the day, and prints the seed.
//! A failure prints its bytes; `MEISSNER_BYTES=1,2,3 cargo test -p firmware-protocol NAME` plays them again, and prints every message.

use crate::bench::{
    Bench, FIRMWARE, HOST_TIMEOUT, LAYOUTS, MOCK, STOP, TIGHT, WHOLE_TRAVEL, arm, frame, stroke, to,
};
use crate::rule::{Frame, Rule, Sent};
use firmware_protocol::array::{Layout, MotorSet};
use firmware_protocol::batch::{BATCH_BYTES, MAX_BATCH, Packer};
use firmware_protocol::controller::{BLOCK, POOL};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{
    Cause, DeviceMessage, HostMessage, LowerStop, Mark, MarkKind, Op, Report, State, Status, Trigger,
    Withdraw,
};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::{Tick, WireTick};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::cell::Cell;

/// What a world has besides requests that keep the pins' rest where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Nothing: the rule judges every tick.
    Plain,
    /// Pushes of a few pulses, shifts and seeks.
    Seeks,
    /// Corrections, shifts, and frames of any bytes.
    Wild,
    /// Pushes and corrections, under limits on on-time.
    OnTime,
}

#[derive(Clone)]
struct Input(Vec<u8>);

impl std::fmt::Debug for Input {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let bytes: Vec<String> = self.0.iter().map(u8::to_string).collect();
        write!(out, "MEISSNER_BYTES={}", bytes.join(","))
    }
}

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        self.0.split_off_first().copied().unwrap_or(0)
    }

    fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    fn bits(&mut self) -> u64 {
        u64::from_le_bytes([(); 8].map(|()| self.byte()))
    }

    /// Below `end`.
    fn below(&mut self, end: u16) -> u16 {
        if end > 256 { self.word() % end } else { u16::from(self.byte()) % end }
    }

    fn one_in(&mut self, of: u8) -> bool {
        self.byte() % of == of - 1
    }

    fn one_of<T: Copy>(&mut self, of: &[T]) -> T {
        of[usize::from(self.byte()) % of.len()]
    }

    fn bytes(&mut self) -> Vec<u8> {
        let len = self.byte() % 60;
        (0..len).map(|_| self.byte()).collect()
    }

    fn level(&mut self) -> u16 {
        match self.byte() % 13 {
            0..3 => 0,
            3..11 => 1 + self.below(59),
            11 => 60 + self.below(540),
            _ => 2_900 + self.below(102),
        }
    }

    fn mark(&mut self) -> Option<Mark> {
        if self.one_in(2) {
            return None;
        }
        let kind = self.one_of(&[MarkKind::Play, MarkKind::Play, MarkKind::Item]);
        let trigger = self.one_in(2).then(|| Trigger { width: self.word() % 300, code: self.byte() });
        let hold = match self.byte() % 3 {
            0 => 0,
            1 => u32::from(self.word()),
            _ => u32::from(self.word()) << 16,
        };
        Some(Mark { kind, trigger, hold })
    }

    fn withdraw(&mut self) -> Option<Withdraw> {
        if !self.one_in(3) {
            return None;
        }
        let motors = match self.byte() % 3 {
            0 => self.bits(),
            1 => u64::MAX,
            _ => 1 << self.below(64),
        };
        Some(Withdraw { motors: MotorSet::from_bits(motors), generation: self.below(6) })
    }
}

/// A bench, and counts kept beside it.
struct World {
    kind: Kind,
    limits: PowerLimits,
    bench: Bench,
    /// Frames have motors below this one. Some have motors that the array does not have.
    motors: u8,
    /// The most by which a move pushes.
    surplus: u16,
    last_frame: (Vec<u8>, Option<Frame>),
    sent: Vec<Move>,
    accepted: u64,
    refused_in_frames: u64,
    /// When the host said something last, and its timeout.
    heard: u64,
    timeout: u64,
    /// Whether pins were shifted.
    shifted: bool,
    /// Seeks that came to their end.
    sought: u32,
}

impl World {
    fn new(kind: Kind, input: &mut Bytes<'_>) -> Self {
        let shell = input.one_of(&[FIRMWARE, FIRMWARE, TIGHT, MOCK]);
        let layout = input.one_of(LAYOUTS);
        let none = layout.no_limits();
        let limits = match input.byte() % 3 {
            _ if kind == Kind::OnTime => PowerLimits { motor: 300, rail: 700, ..none },
            0 => none,
            1 => PowerLimits { motor: 300, rail: 700, ..none },
            _ => {
                PowerLimits { rail_at_once: 1 + input.byte() % 6, chip_at_once: 1 + input.byte() % 2, ..none }
            }
        };
        // Some worlds cross the wrap of the wire's ticks.
        let start = input.one_of(&[Tick::BOOT, Tick((1 << 32) - 20_000)]);
        let mut bench = Bench::of(shell, layout, start);
        if kind == Kind::Plain {
            bench.rule = Some(Box::new(Rule::new(layout, none.min(limits))));
        }
        let surplus = match kind {
            Kind::Plain => 0,
            Kind::Seeks | Kind::Wild => 3,
            Kind::OnTime => input.one_of(&[0, 60]),
        };
        let motors = input.one_of(&[2, 5, layout.motors() as u8 + 2]);
        let mut world = Self {
            kind,
            motors,
            surplus,
            limits,
            heard: bench.now,
            timeout: HOST_TIMEOUT.into(),
            bench,
            last_frame: (vec![], None),
            sent: vec![],
            accepted: 0,
            refused_in_frames: 0,
            shifted: false,
            sought: 0,
        };
        if !input.one_in(8) {
            world.hello(1);
            world.control(arm(true, HOST_TIMEOUT, limits));
        }
        world
    }

    fn layout(&self) -> Layout {
        self.bench.layout()
    }

    fn state(&self) -> State {
        self.bench.device.state()
    }

    fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            let before = self.state();
            self.bench.tick();
            let silent = self.bench.now - self.heard;
            match self.state() {
                State::Armed => {
                    assert!(silent <= self.timeout + u64::from(BLOCK), "a silent host goes unnoticed");
                }
                _ => assert!(
                    before != State::Armed || silent > self.timeout,
                    "a host that is heard counts as silent"
                ),
            }
        }
    }

    /// An event, and what came of it.
    fn event(&mut self, event: impl FnOnce(&mut Bench)) {
        let before = self.state();
        event(&mut self.bench);
        self.bench.changed_from(before);
    }

    fn hello(&mut self, session: u32) {
        self.heard = self.bench.now;
        let before = self.bench.device.epoch();
        self.bench.hello(session);
        // The same session again begins no epoch.
        if self.bench.device.epoch() != before
            && let Some(rule) = &mut self.bench.rule
        {
            rule.new_epoch();
        }
    }

    fn ping(&mut self) {
        self.heard = self.bench.now;
        self.bench.ping(0);
    }

    fn control(&mut self, op: Op) {
        let (before, open) = (self.state(), self.bench.device.epoch().is_some());
        self.heard = self.bench.now;
        self.bench.control(op);
        let after = self.state();
        let is_off = matches!(after, State::Disarmed | State::Faulted);
        // Not by the state before: a return that was over, or a silent host, may have disarmed it by now.
        let arms = matches!(op, Op::Arm { .. }) && open && self.bench.status().refusal.is_none();
        match op {
            _ if !open => assert!(after == before || before == State::Returning, "without a session"),
            Op::EStop => assert_eq!(after, State::Faulted),
            Op::Reset if before == State::Faulted => assert_eq!(after, State::Disarmed),
            Op::Disarm(_) => assert!(is_off || after == State::Returning),
            Op::Arm { host_timeout, .. } if arms => {
                self.timeout = u64::from(host_timeout.min(self.layout().max_host_timeout()));
            }
            _ => {}
        }
        let Some(rule) = &mut self.bench.rule else { return };
        if open {
            rule.new_epoch();
        }
        match op {
            Op::Stop if before == State::Armed && open => rule.come_down(false),
            Op::Arm { assume_rest, .. } if arms => rule.come_down(assume_rest),
            _ => {}
        }
    }

    /// The device's status, if there is a session. The host has read all reports then.
    fn status(&mut self) -> Option<Status> {
        self.ping();
        // Others, because the device may have repeated reports that the bench had read before the last `Hello`, and sends 32 at a time.
        let mut seen = None;
        while seen.replace(self.bench.seen()) != Some(self.bench.seen()) {
            self.ping();
        }
        match self.bench.inbox.iter().rev().find(|m| !matches!(m, DeviceMessage::Report { .. })) {
            Some(DeviceMessage::Status(status)) => Some(*status),
            _ => None,
        }
    }

    /// Sends a frame of moves. The rule judges it, if it is there and knows what the frame says.
    fn send(&mut self, bytes: Vec<u8>, frame: Option<Frame>) {
        let (before, counted) = (self.status(), self.bench.device.counters());
        let (armed, sent) = (self.state() == State::Armed, self.bench.inbox.len());
        self.bench.bytes(&bytes);
        // A frame may be next in order now that was buffered before; its moves count here, too.
        self.bench.follow();
        if let (Some(before), Some(after)) = (before, self.status()) {
            let counters = self.bench.device.counters();
            // Moves that changed nothing have been played.
            let (replaced, played) = (counters.replaced - counted.replaced, counters.played - counted.played);
            self.accepted += u64::from(before.credits) + replaced + played - u64::from(after.credits);
            self.refused_in_frames += counters.refused - counted.refused;
            if let Some(mut rule) = self.bench.rule.take() {
                let seq = before.next_seq;
                match frame.as_ref().filter(|frame| frame.seq == seq && after.next_seq != seq) {
                    Some(frame) => rule.take(frame, &self.bench, armed, &self.bench.inbox[sent..]),
                    None => assert_eq!(after.next_seq, seq, "a frame was taken that is not next"),
                }
                self.bench.rule = Some(rule);
            }
        }
        self.bench.seq = self.bench.inbox.iter().rev().find_map(next_seq).unwrap_or(0);
        self.last_frame = (bytes, frame);
    }

    /// Moves in any order of motors from some ticks before or after the rendered end on.
    fn moves(&mut self, input: &mut Bytes<'_>) {
        // One move that is late: a pin that is up comes down.
        let alone = input.one_in(4);
        let (mark, withdraw) = if alone { (None, None) } else { (input.mark(), input.withdraw()) };
        let late = alone || input.one_in(5);
        let from = if late { -i64::from(input.byte() % 40) - 1 } else { input.below(300).into() };
        let count = if alone { 1 } else { input.one_of(&[0, 1, 1, 2, 3, 4, 6, 9, 12]) };
        let base = self.bench.device.rendered().0.wrapping_add_signed(from);
        let (mut tick, mut packer, mut all) =
            (base, Packer::<BATCH_BYTES>::new(Tick(base)), Vec::<Sent>::new());
        for _ in 0..count {
            tick += if alone { 0 } else { u64::from(input.byte() % 120) };
            let motor = (input.byte() % self.motors).min(63);
            // Those for which there is no room are left out.
            let of: Vec<Sent> = match if alone { 8 } else { input.byte() % 13 } {
                0..8 => {
                    let (level, hold, surplus) =
                        (input.level(), input.byte() % 100, input.below(self.surplus + 1));
                    let of = stroke(motor, tick, level, hold.into(), level + surplus);
                    packer.stroke(&of).map(|()| of.moves().into_iter().zip([false, true]).collect())
                }
                8..12 => {
                    let (level, surplus) = (input.level(), input.below(self.surplus + 1));
                    let of = Move { surplus, ..to(motor, tick, level) };
                    packer.moves(&of).map(|()| vec![(of, false)])
                }
                _ => {
                    let motors = MotorSet::from_bits(input.bits() & input.bits());
                    // Each one's level is higher than that of the one before.
                    let (level, step) = (input.level(), input.below(40));
                    let levels: Vec<u16> = (0..motors.len() as u16).map(|k| level + step * k).collect();
                    let of =
                        motors.iter().zip(&levels).map(|(motor, &level)| (to(motor, tick, level), false));
                    packer.row(Tick(tick), motors, &levels).map(|()| of.collect())
                }
            }
            .unwrap_or_default();
            all.extend(of);
        }
        assert!(all.len() <= MAX_BATCH);
        self.sent.extend(all.iter().map(|(of, _)| of));
        if self.bench.prints {
            println!("{all:?}");
        }
        let (epoch, seq, seen) = (self.bench.epoch, self.bench.seq, self.bench.seen());
        let bytes = frame(&HostMessage::Moves {
            epoch,
            seq,
            seen,
            mark,
            withdraw,
            base: Tick(base).wire(),
            batch: packer.bytes(),
        });
        self.send(bytes, Some(Frame { seq, mark, withdraw, base, moves: all }));
    }

    /// Amends a move sent before.
    fn amend(&mut self, input: &mut Bytes<'_>) {
        let recent = &self.sent[self.sent.len().saturating_sub(24)..];
        if recent.is_empty() {
            return;
        }
        let (to, change) = (input.one_of(recent), i16::from(input.byte() % 19) - 9);
        // What it is planned to go, if it follows the move before.
        let of_motor = self.sent.iter().filter(|of| of.motor == to.motor && of.tick < to.tick);
        let from = of_motor.max_by_key(|of| of.tick).map_or(0, |of| of.level);
        let pulses = to.level.abs_diff(from).saturating_add_signed(change);
        self.heard = self.bench.now;
        self.bench.amend(input.below(6), to.motor, to.tick, pulses);
    }

    /// Asks for a seek, in an `arm` or by itself, and waits for its end: then all pins are at the stop, in every state before it.
    fn seek(&mut self, input: &mut Bytes<'_>) {
        let pulses =
            if input.one_in(4) { 600 + input.below(WHOLE_TRAVEL - 599) } else { 1 + input.below(700) };
        let idle = self.state() != State::Returning;
        self.control(if input.one_in(2) {
            let lower_stop = Some(LowerStop { seek: pulses, ..STOP });
            Op::Arm { assume_rest: false, host_timeout: HOST_TIMEOUT, limits: self.limits, lower_stop }
        } else {
            Op::Seek { pulses }
        });
        if idle && self.state() == State::Returning {
            self.bench.settle();
            self.sought += 1;
            for motor in 0..self.layout().motors() as u8 {
                assert_eq!(self.bench.above_stop(motor), 0, "motor {motor} after {pulses} pulses");
            }
        }
    }

    /// Most often a host that may not play finds its way back first.
    fn recover(&mut self, input: &mut Bytes<'_>) {
        if self.bench.device.epoch().is_none() {
            self.hello(7);
        }
        if self.state() == State::Faulted {
            self.control(Op::Reset);
        }
        if self.state() == State::Disarmed {
            let at = self.bench.device.rendered();
            self.arm(input);
            self.returns(at);
        }
    }

    /// All pins that come down from `at` on are down in the time that the device says.
    fn returns(&mut self, at: Tick) {
        self.bench.settle();
        let mut cuts = self.bench.reports().into_iter().rev().filter_map(|report| match report {
            Report::Cut(cut) => Some(cut),
            _ => None,
        });
        if let Some(cut) = cuts.next().filter(|cut| cut.at == at.wire())
            && let (Some(ticks), Some(last)) = (cut.return_ticks, self.bench.last_pulse())
        {
            assert!(last < at.0 + u64::from(ticks).max(1), "{cut:?}, and the last pulse at {last}");
        }
    }

    fn arm(&mut self, input: &mut Bytes<'_>) {
        let assume_rest = matches!(self.kind, Kind::Plain | Kind::Wild) && input.one_in(4);
        let host_timeout = 1 + u32::from(input.word()) * input.one_of(&[1, 5]);
        self.control(arm(assume_rest, host_timeout, self.limits));
    }

    fn step(&mut self, input: &mut Bytes<'_>) {
        if self.state() != State::Armed && !input.one_in(4) {
            self.recover(input);
        }
        match input.byte() % 100 {
            0 => self.run(20_000 + u64::from(input.word())),
            1 => self.hello(1 + u32::from(input.byte() % 3)),
            2 | 3 => self.ping(),
            4..9 => self.arm(input),
            9 => self.control(Op::Disarm(Cause::Shutdown)),
            10 | 11 => {
                let at = self.bench.device.rendered();
                self.control(Op::Stop);
                if input.one_in(2) {
                    self.returns(at);
                }
            }
            12 => self.control(Op::EStop),
            // The shell has found an e-stop ahead of other bytes.
            13 => {
                if let Some(epoch) = self.bench.device.epoch() {
                    self.event(|bench| bench.device.e_stop(Tick(bench.now), epoch.wrapping_add(1)));
                    self.bench.epoch = epoch.wrapping_add(1);
                    self.bench.seq = 0;
                }
            }
            14 => self.event(|bench| bench.device.fault(Tick(bench.now), Cause::Starved)),
            15 | 16 => self.control(Op::Reset),
            17 => self.event(|bench| bench.device.link_lost(Tick(bench.now))),
            18 => {
                self.bench.bytes(&input.bytes());
                // What it leaves of a frame would spoil the next one.
                self.bench.bytes(&[0]);
            }
            // It may be next now, if there was no session or no room.
            19..21 => {
                let (bytes, frame) = self.last_frame.clone();
                self.send(bytes, frame);
            }
            21..48 => self.moves(input),
            48..56 => match self.kind {
                Kind::Plain => self.moves(input),
                Kind::Seeks => self.seek(input),
                Kind::Wild | Kind::OnTime => self.amend(input),
            },
            56..60 if matches!(self.kind, Kind::Seeks | Kind::Wild) => {
                let direction = input.one_of(&[Direction::Up, Direction::Up, Direction::Down]);
                let (motor, pulses) = (input.byte() % 26, 1 + input.below(700));
                self.shifted = true;
                self.control(Op::Move { motor, direction, pulses });
            }
            60..64 if self.kind == Kind::Wild => self.wild(input),
            _ => self.run(input.below(300).into()),
        }
        assert!(self.bench.device.is_consistent(), "a motor is forgotten");
        if let Some(rule) = &self.bench.rule {
            rule.check(&self.bench);
        }
    }

    /// Messages of any numbers and bytes.
    fn wild(&mut self, input: &mut Bytes<'_>) {
        let epoch = self.bench.epoch.wrapping_sub(input.below(4));
        let seq = self.bench.seq.wrapping_add(input.below(4));
        let base = WireTick([(); 4].map(|()| input.byte()));
        let (generation, kind) = (input.word(), input.byte() % 4);
        let (mark, withdraw, batch) = (input.mark(), input.withdraw(), input.bytes());
        match kind {
            0 => {
                self.heard = self.bench.now;
                let epoch = self.bench.epoch;
                self.bench.send(&HostMessage::Amend { epoch, generation, base, items: &batch });
            }
            1 => {
                // The bench knows no others.
                let op = arm(false, HOST_TIMEOUT, self.limits);
                self.heard = self.bench.now;
                self.bench.send(&HostMessage::Control { epoch: generation, seen: 0, op });
                self.timeout = self.timeout.max(HOST_TIMEOUT.into());
                self.hello(u32::from(generation) + 10);
            }
            _ => {
                let seen = generation;
                let batch = &batch;
                self.heard = self.bench.now;
                self.send(frame(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch }), None);
            }
        }
    }

    /// A new host comes: the device returns, all slots are free, every move and pulse was counted, no limit was broken, and then the host plays.
    fn end(&mut self) {
        let returns = matches!(self.state(), State::Armed | State::Returning);
        self.hello(1_000);
        assert_ne!(self.state(), State::Armed);
        self.bench.settle();
        if returns {
            assert_eq!((self.state(), self.bench.outstanding()), (State::Disarmed, 0));
        }
        let total = self.bench.total();
        self.run(3_000);
        assert_eq!(self.bench.total(), total, "a line is on");
        let status = self.status().expect("a session");
        assert_eq!(usize::from(status.credits), POOL);
        let counters = self.bench.device.counters();
        let refused = counters.refused - self.refused_in_frames;
        assert_eq!(self.accepted, counters.played + counters.dropped + refused + counters.replaced);
        assert_eq!(counters.pulses, total);
        if let Some(rule) = &self.bench.rule {
            assert_eq!(refused, rule.refused, "refused as they began");
            rule.check(&self.bench);
        }
        self.keeps_limits();
        self.bench.rule = None;
        self.control(Op::Reset);
        self.control(arm(!status.position_known, HOST_TIMEOUT, self.layout().no_limits()));
        self.bench.settle();
        assert_eq!(self.state(), State::Armed, "no way to a play");
        let (at, before) = (self.bench.soon(), self.bench.pulses(0).count());
        self.bench.moves(&[to(0, at, 9), to(0, at + 20, 0)]);
        self.bench.run(400);
        assert_eq!(self.bench.pulses(0).count(), before + 18, "a new host plays");
    }

    /// No sliding second has more pulses of a motor or a rail than the limits say, and no burst is longer than may be.
    fn keeps_limits(&self) {
        let (layout, limits) = (self.layout(), self.layout().no_limits().min(self.limits));
        let shifted = if self.shifted { 4 * layout.max_travel() } else { 0 };
        let mut rails = vec![Vec::new(); 64];
        for motor in 0..layout.motors() {
            for burst in self.bench.bursts(motor as u8) {
                assert!(self.kind == Kind::Seeks || burst.pulses <= layout.max_down_pulses() + shifted);
            }
            let ticks: Vec<u64> = self.bench.pulses(motor as u8).map(|(tick, _)| tick).collect();
            // Seeks and what was up when a pin was taken to be at rest may take more.
            if self.kind == Kind::OnTime {
                assert!(!breaks(&ticks, layout.tick_hz(), limits.motor), "on-time of motor {motor}");
                rails[usize::from(layout.rail(motor))].extend(ticks);
            }
        }
        for (rail, mut ticks) in rails.into_iter().enumerate() {
            ticks.sort_unstable();
            assert!(!breaks(&ticks, layout.tick_hz(), limits.rail), "on-time of rail {rail}");
        }
    }
}

fn next_seq(message: &DeviceMessage) -> Option<u16> {
    match message {
        DeviceMessage::Status(status) => Some(status.next_seq),
        DeviceMessage::Hello(_) => Some(0),
        _ => None,
    }
}

/// Whether so many ticks have more than `limit` of these, which are in order.
fn breaks(ticks: &[u64], within: u32, limit: u32) -> bool {
    let limit = limit as usize;
    ticks.windows(limit + 1).any(|some| some[limit] - some[0] < within.into())
}

/// How many worlds: more in `verify/run tests`.
fn cases() -> u32 {
    if is_long() { 5_000 } else { 400 }
}

fn is_long() -> bool {
    std::env::var_os("MEISSNER_LONG").is_some()
}

/// The seed of the worlds.
fn seed() -> u64 {
    let of_day = || {
        let since_1970 = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
        if is_long() { since_1970.as_secs() / 86_400 } else { 85_000 }
    };
    let seed = std::env::var("MEISSNER_SEED").map_or_else(|_| of_day(), |seed| seed.parse().expect("a seed"));
    println!("MEISSNER_SEED={seed}");
    seed
}

/// Plays a world to its end. Returns how many seeks came to theirs.
fn play(kind: Kind, bytes: &[u8], prints: bool) -> u32 {
    let mut input = Bytes(bytes);
    let mut world = World::new(kind, &mut input);
    world.bench.prints = prints;
    while !input.0.is_empty() {
        world.step(&mut input);
    }
    world.end();
    world.sought
}

/// Plays the same worlds in every run, or the one that `MEISSNER_BYTES` names.
fn worlds(kind: Kind) -> u32 {
    if let Ok(bytes) = std::env::var("MEISSNER_BYTES") {
        let bytes = bytes.split(',').map(|byte| byte.trim().parse().expect("bytes")).collect::<Vec<u8>>();
        return play(kind, &bytes, true);
    }
    let sought = Cell::new(0);
    let config = ProptestConfig {
        cases: cases(),
        failure_persistence: None,
        max_shrink_iters: 4_096,
        rng_seed: RngSeed::Fixed(seed()),
        ..ProptestConfig::default()
    };
    proptest!(config, |(bytes in prop::collection::vec(any::<u8>(), 0..1_500).prop_map(Input))| {
        sought.set(sought.get() + play(kind, &bytes.0, false));
    });
    sought.get()
}

#[test]
fn plain_worlds_are_as_the_rule_says() {
    worlds(Kind::Plain);
}

#[test]
fn every_seek_reaches_the_stop() {
    assert!(worlds(Kind::Seeks) > cases() / 2);
}

#[test]
fn wild_worlds_break_no_limit_and_no_account() {
    worlds(Kind::Wild);
}

#[test]
fn no_sliding_second_has_more_pulses_than_the_limits() {
    worlds(Kind::OnTime);
}

#[test]
fn this_optimised_build_checks_for_overflows() {
    assert!(std::panic::catch_unwind(|| debug_assert!(std::hint::black_box(false))).is_err());
    assert!(std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1)).is_err());
}
