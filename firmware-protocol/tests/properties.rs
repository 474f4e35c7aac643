//! Random requests, faults and noise in any order: every pulse belongs to a stroke, and every pulse is counted.

use crate::bench::{
    Bench, FIRMWARE, HOST_TIMEOUT, MOCK, NO_LIMITS, STOP, Shell, TIGHT, WHOLE_TRAVEL, arm, frame, layouts,
    pack, stroke,
};
use firmware_protocol::array::{Layout, MotorSet};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{
    Cause, DeviceMessage, HostMessage, LowerStop, Mark, MarkKind, Op as Command, State, Trigger, Withdraw,
};
use firmware_protocol::stroke::{Direction, Stroke};
use firmware_protocol::tick::{Tick, WireTick};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::cell::Cell;

#[derive(Clone, Copy, Debug)]
struct Sent {
    motor: u8,
    /// Ticks after the stroke before, of any motor.
    after: u16,
    pulses: u16,
    hold: u16,
    correction: i8,
}

#[derive(Clone, Debug)]
enum Op {
    Run(u16),
    Pause,
    Hello(u32),
    Ping,
    Arm {
        assume_rest: bool,
        host_timeout: u32,
        limits: PowerLimits,
    },
    Disarm,
    Stop,
    EStop,
    Reset,
    Move {
        motor: u8,
        direction: Direction,
        pulses: u16,
    },
    /// Asks for a seek, in an `arm` or by itself, and waits for its end.
    Seek {
        arm: bool,
        limits: PowerLimits,
        pulses: u16,
    },
    /// From this many ticks after the rendered end, or before it.
    Strokes {
        mark: Option<Mark>,
        withdraw: Option<Withdraw>,
        from: i16,
        strokes: Vec<Sent>,
    },
    /// Amends a stroke sent before.
    Amend {
        pick: prop::sample::Index,
        generation: u16,
        down: bool,
        change: i16,
    },
    /// The last frame again.
    Again,
    LinkLost,
    Fault,
    Noise(Vec<u8>),
    WildStrokes {
        epoch: u16,
        seq: u16,
        seen: u16,
        mark: Option<Mark>,
        withdraw: Option<Withdraw>,
        base: [u8; 4],
        batch: Vec<u8>,
    },
    WildAmend {
        generation: u16,
        base: [u8; 4],
        items: Vec<u8>,
    },
    WildControl {
        epoch: u16,
        host_timeout: u32,
    },
}

fn sent(surplus: bool) -> impl Strategy<Value = Sent> {
    let pulses = prop_oneof![8 => 1u16..60, 1 => 2_900u16..3_002];
    let correction = if surplus { 0..4i8 } else { 0..1i8 };
    (0u8..64, 0u16..120, pulses, 0u16..100, correction)
        .prop_map(|(motor, after, pulses, hold, correction)| Sent { motor, after, pulses, hold, correction })
}

fn mark() -> impl Strategy<Value = Option<Mark>> {
    let kind = prop::sample::select(vec![MarkKind::Play, MarkKind::Item]);
    let trigger =
        prop::option::of((0u16..300, any::<u8>()).prop_map(|(width, code)| Trigger { width, code }));
    prop::option::of((kind, trigger).prop_map(|(kind, trigger)| Mark { kind, trigger }))
}

fn withdraw() -> impl Strategy<Value = Option<Withdraw>> {
    let motors = prop_oneof![any::<u64>(), Just(u64::MAX), (0..64).prop_map(|motor| 1_u64 << motor)];
    prop::option::of(
        (motors, 0u16..6)
            .prop_map(|(motors, generation)| Withdraw { motors: MotorSet::from_bits(motors), generation }),
    )
}

fn strokes(surplus: bool) -> impl Strategy<Value = Op> {
    let strokes = prop::collection::vec(sent(surplus), 0..12);
    (mark(), withdraw(), prop_oneof![4 => 0i16..300, 1 => -40i16..0], strokes)
        .prop_map(|(mark, withdraw, from, strokes)| Op::Strokes { mark, withdraw, from, strokes })
}

/// Requests that keep strokes balanced and pins at their rest position.
fn tame(surplus: bool) -> impl Strategy<Value = Op> {
    prop_oneof![
        24 => (0u16..300).prop_map(Op::Run),
        1 => Just(Op::Pause),
        1 => (1u32..4).prop_map(Op::Hello),
        2 => Just(Op::Ping),
        5 => (1u32..300_000, limits()).prop_map(|(host_timeout, limits)| Op::Arm { assume_rest: false, host_timeout, limits }),
        1 => Just(Op::Disarm),
        2 => Just(Op::Stop),
        2 => Just(Op::EStop),
        3 => Just(Op::Reset),
        24 => strokes(surplus),
        2 => Just(Op::Again),
        1 => Just(Op::LinkLost),
        1 => Just(Op::Fault),
        1 => prop::collection::vec(any::<u8>(), 0..300).prop_map(Op::Noise),
    ]
}

fn wild() -> impl Strategy<Value = Op> {
    let bytes = || prop::collection::vec(any::<u8>(), 0..60);
    let pulses = 0u16..7_000;
    let direction = prop::sample::select(vec![Direction::Up, Direction::Down]);
    prop_oneof![
        20 => tame(true),
        1 => (1u32..300_000, limits()).prop_map(|(host_timeout, limits)| Op::Arm { assume_rest: true, host_timeout, limits }),
        2 => (0u8..26, direction, pulses).prop_map(|(motor, direction, pulses)| Op::Move { motor, direction, pulses }),
        8 => (any::<prop::sample::Index>(), 0u16..6, any::<bool>(), -9i16..10)
            .prop_map(|(pick, generation, down, change)| Op::Amend { pick, generation, down, change }),
        2 => (0u16..4, 0u16..4, any::<u16>(), mark(), withdraw(), any::<[u8; 4]>(), bytes())
            .prop_map(|(epoch, seq, seen, mark, withdraw, base, batch)| Op::WildStrokes { epoch, seq, seen, mark, withdraw, base, batch }),
        1 => (any::<u16>(), any::<[u8; 4]>(), bytes())
            .prop_map(|(generation, base, items)| Op::WildAmend { generation, base, items }),
        1 => (any::<u16>(), any::<u32>()).prop_map(|(epoch, host_timeout)| Op::WildControl { epoch, host_timeout }),
    ]
}

fn with_seeks() -> impl Strategy<Value = Op> {
    let direction = prop::sample::select(vec![Direction::Up, Direction::Up, Direction::Down]);
    let pulses = prop_oneof![3 => 1u16..700, 1 => 600u16..=WHOLE_TRAVEL];
    prop_oneof![
        20 => tame(true),
        4 => (0u8..24, direction, 1u16..700).prop_map(|(motor, direction, pulses)| Op::Move { motor, direction, pulses }),
        6 => (any::<bool>(), limits(), pulses).prop_map(|(arm, limits, pulses)| Op::Seek { arm, limits, pulses }),
    ]
}

/// A bench, and counts kept beside it.
struct World {
    bench: Bench,
    last_frame: Vec<u8>,
    strokes: Vec<Stroke>,
    accepted: u64,
    refused_in_frames: u64,
    /// Pulses of returns after an e-stop, and whether one is being played.
    own: u64,
    arming: bool,
    /// Seeks that came to their end.
    sought: u32,
}

impl World {
    fn new(shell: Shell, layout: Layout, limits: PowerLimits) -> Self {
        let mut bench = Bench::of(shell, layout, Tick::BOOT);
        bench.hello(1);
        bench.control(arm(true, HOST_TIMEOUT, limits));
        Self {
            bench,
            last_frame: vec![],
            strokes: vec![],
            accepted: 0,
            refused_in_frames: 0,
            own: 0,
            arming: false,
            sought: 0,
        }
    }

    /// Free slots, if there is a session.
    fn credits(&mut self) -> Option<u16> {
        // Noise may have left half a frame.
        self.bench.bytes(&[0]);
        self.bench.ping(0);
        match self.bench.inbox.iter().rev().find(|m| !matches!(m, DeviceMessage::Report { .. })) {
            Some(DeviceMessage::Status(status)) => Some(status.credits),
            _ => None,
        }
    }

    fn send(&mut self, bytes: Vec<u8>) {
        let (before, counted) = (self.credits(), self.bench.device.counters());
        self.bench.bytes(&bytes);
        // A frame may be next in order now that was buffered before; its strokes count here, too.
        self.bench.follow();
        if let (Some(before), Some(after)) = (before, self.credits()) {
            let counters = self.bench.device.counters();
            let replaced = (counters.replaced - counted.replaced) / 2;
            self.accepted += u64::from(before) + replaced - u64::from(after);
            self.refused_in_frames += counters.refused - counted.refused;
        }
        self.bench.seq = self.bench.inbox.iter().rev().find_map(next_seq).unwrap_or(0);
        self.last_frame = bytes;
    }

    fn off(&mut self, off: impl FnOnce(&mut Bench)) {
        let latched = self.bench.device.state() == State::Faulted;
        // A return that ends with this tick is over.
        self.bench.device.poll(Tick(self.bench.now));
        let arming = self.arming && self.bench.device.state() == State::Returning;
        off(&mut self.bench);
        if arming && !latched && self.bench.device.state() == State::Faulted {
            self.own -= self.bench.outstanding();
        }
        self.arming = false;
        self.bench.tick();
    }

    fn apply(&mut self, op: Op) {
        let bench = &mut self.bench;
        match op {
            Op::Run(ticks) => bench.run(ticks.into()),
            Op::Pause => bench.run(90_000),
            Op::Hello(session) => bench.hello(session),
            Op::Ping => bench.ping(1),
            Op::Arm { assume_rest, host_timeout, limits } => {
                let (state, outstanding) = (bench.device.state(), bench.outstanding());
                bench.control(arm(assume_rest, host_timeout, limits));
                if state == State::Disarmed && bench.device.state() == State::Returning {
                    self.own += outstanding;
                    self.arming = true;
                }
            }
            Op::Disarm => bench.control(Command::Disarm(Cause::Shutdown)),
            Op::Stop => bench.control(Command::Stop),
            Op::EStop => self.off(|bench| bench.control(Command::EStop)),
            Op::Fault => self.off(|bench| bench.device.fault(Tick(bench.now), Cause::Starved)),
            Op::Reset => bench.control(Command::Reset),
            Op::Move { motor, direction, pulses } => {
                bench.control(Command::Move { motor, direction, pulses });
            }
            Op::Seek { arm, limits, pulses } => {
                let lower_stop = Some(LowerStop { seek: pulses, ..STOP });
                let whole =
                    Command::Arm { assume_rest: false, host_timeout: HOST_TIMEOUT, limits, lower_stop };
                let idle = bench.device.state() != State::Returning;
                bench.control(if arm { whole } else { Command::Seek { pulses } });
                if idle && bench.device.state() == State::Returning {
                    bench.settle();
                    self.sought += 1;
                    for motor in 0..bench.layout().motors() as u8 {
                        assert_eq!(bench.above_stop(motor), 0, "motor {motor} after {pulses} pulses");
                    }
                }
            }
            Op::Strokes { mark, withdraw, from, strokes } => {
                let base = bench.device.rendered().0.wrapping_add_signed(from.into());
                // Some have motors that the array does not have.
                let motors = bench.layout().motors() as u8;
                let motor = |number: u8| (number % (motors + 2)).min(63);
                let mut up = base;
                let strokes: Vec<Stroke> = strokes
                    .iter()
                    .map(|sent| {
                        up += u64::from(sent.after);
                        let down = sent.pulses.saturating_add_signed(sent.correction.into());
                        stroke(motor(sent.motor), up, sent.pulses, sent.hold.into(), down)
                    })
                    .collect();
                let batch = pack(base, &strokes);
                let (epoch, seq, seen) = (bench.epoch, bench.seq, bench.seen());
                let (base, batch) = (Tick(base).wire(), batch.bytes());
                let bytes = frame(&HostMessage::Strokes { epoch, seq, seen, mark, withdraw, base, batch });
                self.strokes.extend(&strokes);
                self.send(bytes);
            }
            Op::Amend { pick, generation, down, change } => {
                let recent = &self.strokes[self.strokes.len().saturating_sub(12)..];
                if !recent.is_empty() {
                    let stroke = *pick.get(recent);
                    let direction = if down { Direction::Down } else { Direction::Up };
                    let pulses = if down { stroke.down_pulses } else { stroke.up_pulses };
                    bench.amend(generation, &stroke, direction, pulses.saturating_add_signed(change));
                }
            }
            Op::Again => self.send(self.last_frame.clone()),
            Op::LinkLost => bench.device.link_lost(Tick(bench.now)),
            Op::Noise(bytes) => bench.bytes(&bytes),
            Op::WildStrokes { epoch, seq, seen, mark, withdraw, base, batch } => {
                let (epoch, seq) = (bench.epoch.wrapping_sub(epoch), bench.seq.wrapping_add(seq));
                let base = WireTick(base);
                let batch = &batch;
                self.send(frame(&HostMessage::Strokes { epoch, seq, seen, mark, withdraw, base, batch }));
            }
            Op::WildAmend { generation, base, items } => {
                let epoch = bench.epoch;
                bench.send(&HostMessage::Amend { epoch, generation, base: WireTick(base), items: &items });
            }
            Op::WildControl { epoch, host_timeout } => {
                let op = arm(false, host_timeout, NO_LIMITS);
                bench.send(&HostMessage::Control { epoch, seen: 0, op });
                bench.hello(u32::from(epoch) + 10);
            }
        }
        self.arming &= self.bench.device.state() == State::Returning;
    }

    /// Disarms and waits: all lines are off, all slots free, every burst and pulse booked.
    fn end(&mut self, moves: bool) {
        let session = 1_000;
        self.bench.bytes(&[0]);
        if self.bench.device.state() == State::Armed || self.bench.device.state() == State::Returning {
            self.bench.hello(session);
            assert_ne!(self.bench.device.state(), State::Armed);
            self.bench.settle();
            assert_eq!(self.bench.device.state(), State::Disarmed);
        }
        self.bench.hello(session);
        self.bench.run(100);
        let total = self.bench.total();
        self.bench.run(3_000);
        assert_eq!(self.bench.total(), total, "a line is on");
        assert_eq!(self.credits(), Some(POOL as u16));
        let counters = self.bench.device.counters();
        let refused = counters.refused - self.refused_in_frames;
        let replaced = counters.replaced;
        assert_eq!(2 * self.accepted, counters.played + counters.dropped + refused + replaced);
        if moves {
            assert!(counters.pulses <= total);
        } else {
            assert_eq!(counters.pulses + self.own, total);
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

fn shells() -> impl Strategy<Value = Shell> {
    prop::sample::select(vec![FIRMWARE, FIRMWARE, TIGHT, MOCK])
}

/// Limits of plays. The bench checks in every tick that the controller keeps the limits on motors at once.
fn limits() -> impl Strategy<Value = PowerLimits> {
    let at_once = |rail_at_once, chip_at_once| PowerLimits { rail_at_once, chip_at_once, ..NO_LIMITS };
    prop_oneof![
        4 => Just(NO_LIMITS),
        4 => Just(PowerLimits { motor: 300, rail: 700, ..NO_LIMITS }),
        4 => (1u8..=6, 1u8..=2).prop_map(move |(rail, chip)| at_once(rail, chip)),
    ]
}

/// The same cases in every run.
fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(85_000),
        ..ProptestConfig::default()
    }
}

/// After a seek that is not refused all pins are at the stop, in every state of play, move, cut and stop before it.
#[test]
fn every_seek_reaches_the_stop() {
    let sought = Cell::new(0);
    proptest!(config(400), |(shell in shells(), layout in layouts(), limits in limits(), ops in prop::collection::vec(with_seeks(), 1..60))| {
        let mut world = World::new(shell, layout, limits);
        for op in ops {
            world.apply(op);
        }
        sought.set(sought.get() + world.sought);
        world.end(true);
    });
    assert!(sought.get() > 200, "{} seeks", sought.get());
}

proptest! {
    #![proptest_config(config(400))]

    /// With balanced strokes, without moves and `assume_rest`: a pin's outstanding pulses equal its height.
    #[test]
    fn every_pin_returns(shell in shells(), layout in layouts(), limits in limits(), ops in prop::collection::vec(tame(false), 1..80)) {
        let mut world = World::new(shell, layout, limits);
        for op in ops {
            world.apply(op);
            let state = world.bench.device.state();
            let out = (0..layout.motors() as u8).filter(|&motor| world.bench.net(motor) != i64::from(world.bench.device.outstanding(motor)));
            // Faulted or disarmed, nothing is played.
            prop_assert!(matches!(state, State::Armed | State::Returning) || out.count() == 0, "{state:?}");
        }
        world.end(false);
        for motor in 0..layout.motors() as u8 {
            prop_assert_eq!(world.bench.net(motor), i64::from(world.bench.device.outstanding(motor)));
            for burst in world.bench.bursts(motor) {
                prop_assert!(burst.pulses <= 3_000);
            }
        }
    }

    /// All requests: corrected, amended, moved and malformed.
    #[test]
    fn wild_requests_break_no_limit_and_no_account(shell in shells(), layout in layouts(), limits in limits(), ops in prop::collection::vec(wild(), 1..80)) {
        let mut world = World::new(shell, layout, limits);
        let moves = ops.iter().any(|op| matches!(op, Op::Move { .. } | Op::Arm { assume_rest: true, .. }));
        let moved = if moves { 4 * layout.max_travel() } else { 0 };
        for op in ops {
            let (state, total) = (world.bench.device.state(), world.bench.total());
            let running = matches!(op, Op::Run(_) | Op::Pause);
            world.apply(op);
            // The last pulse is in the tick of the fault.
            if running && matches!(state, State::Faulted | State::Disarmed) {
                prop_assert_eq!(world.bench.total(), total, "{:?}", state);
            }
        }
        world.end(moves);
        for motor in 0..layout.motors() as u8 {
            for burst in world.bench.bursts(motor) {
                prop_assert!(burst.pulses <= layout.max_down_pulses() + moved);
            }
        }
    }
}

#[test]
fn this_optimised_build_checks_for_overflows() {
    assert!(std::panic::catch_unwind(|| debug_assert!(std::hint::black_box(false))).is_err());
    assert!(std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1)).is_err());
}
