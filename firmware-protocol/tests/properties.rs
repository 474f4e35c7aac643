//! Random requests, faults and noise in any order: pins come down, no limit breaks, every move and every pulse is counted once.

use crate::bench::{
    Bench, FIRMWARE, HOST_TIMEOUT, MOCK, NO_LIMITS, STOP, Shell, TIGHT, WHOLE_TRAVEL, arm, frame, layouts,
    stroke, to,
};
use firmware_protocol::array::{Layout, MotorSet};
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{
    Cause, DeviceMessage, HostMessage, LowerStop, Mark, MarkKind, Op as Command, State, Trigger, Withdraw,
};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::{Tick, WireTick};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::cell::Cell;

#[derive(Clone, Copy, Debug)]
enum Sent {
    Stroke {
        motor: u8,
        pulses: u16,
        hold: u16,
        surplus: u16,
    },
    Move {
        motor: u8,
        level: u16,
        surplus: u16,
    },
    /// Each one's level is higher by `step` than that of the one before.
    Row {
        motors: u64,
        level: u16,
        step: u16,
    },
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
    /// From this many ticks after the rendered end, or before it. Each so many ticks after the one before, of any motor.
    Moves {
        mark: Option<Mark>,
        withdraw: Option<Withdraw>,
        from: i16,
        moves: Vec<(u16, Sent)>,
    },
    /// Amends a move sent before.
    Amend {
        pick: prop::sample::Index,
        generation: u16,
        change: i16,
    },
    /// The last frame again.
    Again,
    LinkLost,
    Fault,
    Noise(Vec<u8>),
    WildMoves {
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

fn sent(most_surplus: u16) -> impl Strategy<Value = (u16, Sent)> {
    let level = || prop_oneof![3 => Just(0u16), 8 => 1u16..60, 1 => 60u16..600, 1 => 2_900u16..3_002];
    let surplus = move || 0..=most_surplus;
    let stroke = (0u8..64, level(), 0u16..100, surplus())
        .prop_map(|(motor, pulses, hold, surplus)| Sent::Stroke { motor, pulses, hold, surplus });
    let single = (0u8..64, level(), surplus()).prop_map(|(motor, level, surplus)| Sent::Move {
        motor,
        level,
        surplus,
    });
    let row = (any::<u64>(), any::<u64>(), level(), 0u16..40)
        .prop_map(|(motors, fewer, level, step)| Sent::Row { motors: motors & fewer, level, step });
    (0u16..120, prop_oneof![8 => stroke, 4 => single, 1 => row])
}

fn mark() -> impl Strategy<Value = Option<Mark>> {
    let kind = prop::sample::select(vec![MarkKind::Play, MarkKind::Item]);
    let trigger =
        prop::option::of((0u16..300, any::<u8>()).prop_map(|(width, code)| Trigger { width, code }));
    let hold = prop_oneof![Just(0), 0u32..200_000, any::<u32>()];
    prop::option::of((kind, trigger, hold).prop_map(|(kind, trigger, hold)| Mark { kind, trigger, hold }))
}

fn withdraw() -> impl Strategy<Value = Option<Withdraw>> {
    let motors = prop_oneof![any::<u64>(), Just(u64::MAX), (0..64).prop_map(|motor| 1_u64 << motor)];
    prop::option::of(
        (motors, 0u16..6)
            .prop_map(|(motors, generation)| Withdraw { motors: MotorSet::from_bits(motors), generation }),
    )
}

fn moves(most_surplus: u16) -> impl Strategy<Value = Op> {
    let moves = prop::collection::vec(sent(most_surplus), 0..12);
    (mark(), withdraw(), prop_oneof![4 => 0i16..300, 1 => -40i16..0], moves)
        .prop_map(|(mark, withdraw, from, moves)| Op::Moves { mark, withdraw, from, moves })
}

fn amend() -> impl Strategy<Value = Op> {
    (any::<prop::sample::Index>(), 0u16..6, -9i16..10).prop_map(|(pick, generation, change)| Op::Amend {
        pick,
        generation,
        change,
    })
}

/// Requests that keep the pins' rest where it is.
fn tame(most_surplus: u16) -> impl Strategy<Value = Op> {
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
        24 => moves(most_surplus),
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
        20 => tame(3),
        1 => (1u32..300_000, limits()).prop_map(|(host_timeout, limits)| Op::Arm { assume_rest: true, host_timeout, limits }),
        2 => (0u8..26, direction, pulses).prop_map(|(motor, direction, pulses)| Op::Move { motor, direction, pulses }),
        8 => amend(),
        2 => (0u16..4, 0u16..4, any::<u16>(), mark(), withdraw(), any::<[u8; 4]>(), bytes())
            .prop_map(|(epoch, seq, seen, mark, withdraw, base, batch)| Op::WildMoves { epoch, seq, seen, mark, withdraw, base, batch }),
        1 => (any::<u16>(), any::<[u8; 4]>(), bytes())
            .prop_map(|(generation, base, items)| Op::WildAmend { generation, base, items }),
        1 => (any::<u16>(), any::<u32>()).prop_map(|(epoch, host_timeout)| Op::WildControl { epoch, host_timeout }),
    ]
}

fn with_seeks() -> impl Strategy<Value = Op> {
    let direction = prop::sample::select(vec![Direction::Up, Direction::Up, Direction::Down]);
    let pulses = prop_oneof![3 => 1u16..700, 1 => 600u16..=WHOLE_TRAVEL];
    prop_oneof![
        20 => tame(3),
        4 => (0u8..24, direction, 1u16..700).prop_map(|(motor, direction, pulses)| Op::Move { motor, direction, pulses }),
        6 => (any::<bool>(), limits(), pulses).prop_map(|(arm, limits, pulses)| Op::Seek { arm, limits, pulses }),
    ]
}

/// A bench, and counts kept beside it.
struct World {
    bench: Bench,
    last_frame: Vec<u8>,
    sent: Vec<Move>,
    accepted: u64,
    refused_in_frames: u64,
    /// Seeks that came to their end.
    sought: u32,
}

impl World {
    fn new(shell: Shell, layout: Layout, limits: PowerLimits) -> Self {
        let mut bench = Bench::of(shell, layout, Tick::BOOT);
        bench.hello(1);
        bench.control(arm(true, HOST_TIMEOUT, limits));
        Self { bench, last_frame: vec![], sent: vec![], accepted: 0, refused_in_frames: 0, sought: 0 }
    }

    /// Free slots, if there is a session.
    fn credits(&mut self) -> Option<u16> {
        // Noise may have left half a frame.
        self.bench.bytes(&[0]);
        self.bench.ping(0);
        // Others, because the device may have repeated reports that the bench had read before the last `Hello`, and sends 32 at a time.
        let mut seen = None;
        while seen.replace(self.bench.seen()) != Some(self.bench.seen()) {
            self.bench.ping(0);
        }
        match self.bench.inbox.iter().rev().find(|m| !matches!(m, DeviceMessage::Report { .. })) {
            Some(DeviceMessage::Status(status)) => Some(status.credits),
            _ => None,
        }
    }

    fn send(&mut self, bytes: Vec<u8>) {
        let (before, counted) = (self.credits(), self.bench.device.counters());
        self.bench.bytes(&bytes);
        if let (Some(before), Some(after)) = (before, self.credits()) {
            let counters = self.bench.device.counters();
            // Moves that changed nothing have been played.
            let (replaced, played) = (counters.replaced - counted.replaced, counters.played - counted.played);
            self.accepted += u64::from(before) + replaced + played - u64::from(after);
            self.refused_in_frames += counters.refused - counted.refused;
        }
        self.bench.seq = self.bench.inbox.iter().rev().find_map(next_seq).unwrap_or(0);
        self.last_frame = bytes;
    }

    fn off(&mut self, off: impl FnOnce(&mut Bench)) {
        off(&mut self.bench);
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
                bench.control(arm(assume_rest, host_timeout, limits));
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
            Op::Moves { mark, withdraw, from, moves } => {
                let base = bench.device.rendered().0.wrapping_add_signed(from.into());
                // Some have motors that the array does not have.
                let motors = bench.layout().motors() as u8;
                let motor = |number: u8| (number % (motors + 2)).min(63);
                let (mut tick, mut packer) = (base, Packer::<BATCH_BYTES>::new(Tick(base)));
                for (after, sent) in moves {
                    tick += u64::from(after);
                    // Those for which there is no room are left out.
                    let of: Vec<Move> = match sent {
                        Sent::Stroke { motor: number, pulses, hold, surplus } => {
                            let of = stroke(motor(number), tick, pulses, hold.into(), pulses + surplus);
                            packer.stroke(&of).map(|()| of.moves().to_vec()).unwrap_or_default()
                        }
                        Sent::Move { motor: number, level, surplus } => {
                            let of = Move { surplus, ..to(motor(number), tick, level) };
                            packer.moves(&of).map(|()| vec![of]).unwrap_or_default()
                        }
                        Sent::Row { motors, level, step } => {
                            let motors = MotorSet::from_bits(motors);
                            let levels: Vec<u16> =
                                (0..motors.len() as u16).map(|k| level + step * k).collect();
                            let of = motors.iter().zip(&levels).map(|(motor, &level)| to(motor, tick, level));
                            packer.row(Tick(tick), motors, &levels).map(|()| of.collect()).unwrap_or_default()
                        }
                    };
                    self.sent.extend(of);
                }
                let (epoch, seq, seen) = (bench.epoch, bench.seq, bench.seen());
                let (base, batch) = (Tick(base).wire(), packer.bytes());
                self.send(frame(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch }));
            }
            Op::Amend { pick, generation, change } => {
                let recent = &self.sent[self.sent.len().saturating_sub(24)..];
                if !recent.is_empty() {
                    let to = *pick.get(recent);
                    // What it is planned to go, if it follows the move before.
                    let of_motor = self.sent.iter().filter(|of| of.motor == to.motor && of.tick < to.tick);
                    let from = of_motor.max_by_key(|of| of.tick).map_or(0, |of| of.level);
                    let pulses = to.level.abs_diff(from).saturating_add_signed(change);
                    bench.amend(generation, to.motor, to.tick, pulses);
                }
            }
            Op::Again => self.send(self.last_frame.clone()),
            Op::LinkLost => bench.device.link_lost(Tick(bench.now)),
            Op::Noise(bytes) => bench.bytes(&bytes),
            Op::WildMoves { epoch, seq, seen, mark, withdraw, base, batch } => {
                let (epoch, seq) = (bench.epoch.wrapping_sub(epoch), bench.seq.wrapping_add(seq));
                let base = WireTick(base);
                let batch = &batch;
                self.send(frame(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch }));
            }
            Op::WildAmend { generation, base, items } => {
                let epoch = bench.epoch;
                bench.send(&HostMessage::Amend { epoch, generation, base: WireTick(base), items: &items });
            }
            Op::WildControl { epoch, host_timeout } => {
                // The bench knows no others.
                let op = arm(false, host_timeout, bench.device.limits());
                bench.send(&HostMessage::Control { epoch, seen: 0, op });
                bench.hello(u32::from(epoch) + 10);
            }
        }
    }

    /// Disarms and waits: all lines are off, all slots free, every move and pulse counted. Returns whether the pins are down: they are unless
    /// the device is faulted, or was and has not been armed since.
    fn end(&mut self) -> bool {
        let session = 1_000;
        self.bench.bytes(&[0]);
        let returns = matches!(self.bench.device.state(), State::Armed | State::Returning);
        if returns {
            self.bench.hello(session);
            assert_ne!(self.bench.device.state(), State::Armed);
            self.bench.settle();
            assert_eq!(self.bench.device.state(), State::Disarmed);
            assert_eq!(self.bench.outstanding(), 0);
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
        assert_eq!(self.accepted, counters.played + counters.dropped + refused + replaced);
        assert_eq!(counters.pulses, total);
        returns
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

/// How many cases: more in `tests/long/run tests`.
fn cases() -> u32 {
    if std::env::var_os("MEISSNER_LONG").is_some() { 400 } else { 100 }
}

/// The same cases in every run.
fn config() -> ProptestConfig {
    ProptestConfig {
        cases: cases(),
        failure_persistence: None,
        rng_seed: RngSeed::Fixed(85_000),
        ..ProptestConfig::default()
    }
}

/// After a seek that is not refused all pins are at the stop, in every state of play, move, cut and stop before it.
#[test]
fn every_seek_reaches_the_stop() {
    let sought = Cell::new(0);
    proptest!(config(), |(shell in shells(), layout in layouts(), limits in limits(), ops in prop::collection::vec(with_seeks(), 1..60))| {
        let mut world = World::new(shell, layout, limits);
        for op in ops {
            world.apply(op);
        }
        sought.set(sought.get() + world.sought);
        world.end();
    });
    assert!(sought.get() > cases() / 2, "{} seeks", sought.get());
}

proptest! {
    #![proptest_config(config())]

    /// Without corrections, surplus and shifts: a pin's outstanding pulses equal its height, and in the end it is down.
    #[test]
    fn every_pin_returns(shell in shells(), layout in layouts(), limits in limits(), ops in prop::collection::vec(tame(0), 1..80)) {
        let mut world = World::new(shell, layout, limits);
        for op in ops {
            world.apply(op);
            let state = world.bench.device.state();
            for motor in 0..layout.motors() as u8 {
                let net = world.bench.net(motor);
                prop_assert!((0..=i64::from(layout.max_up_pulses())).contains(&net));
                // Faulted or disarmed, nothing is played.
                if matches!(state, State::Faulted | State::Disarmed) {
                    prop_assert_eq!(net, i64::from(world.bench.device.outstanding(motor)), "{:?}", state);
                }
            }
        }
        let is_down = world.end();
        for motor in 0..layout.motors() as u8 {
            let net = world.bench.net(motor);
            prop_assert_eq!(net, i64::from(world.bench.device.outstanding(motor)));
            prop_assert!(net == 0 || !is_down);
        }
    }

    /// All requests: corrected, amended, moved and malformed.
    #[test]
    fn wild_requests_break_no_limit_and_no_account(shell in shells(), layout in layouts(), limits in limits(), ops in prop::collection::vec(wild(), 1..80)) {
        let mut world = World::new(shell, layout, limits);
        let shifts = ops.iter().any(|op| matches!(op, Op::Move { .. } | Op::Arm { assume_rest: true, .. }));
        let shifted = if shifts { 4 * layout.max_travel() } else { 0 };
        for op in ops {
            let (state, total) = (world.bench.device.state(), world.bench.total());
            let running = matches!(op, Op::Run(_) | Op::Pause);
            world.apply(op);
            // The last pulse is in the tick of the fault.
            if running && matches!(state, State::Faulted | State::Disarmed) {
                prop_assert_eq!(world.bench.total(), total, "{:?}", state);
            }
        }
        world.end();
        for motor in 0..layout.motors() as u8 {
            for burst in world.bench.bursts(motor) {
                prop_assert!(burst.pulses <= layout.max_down_pulses() + shifted);
            }
        }
    }

    /// No second has more pulses of a motor or a rail than the limits say, with all ways down, their surplus and their corrections, returns
    /// and stops included.
    #[test]
    fn no_sliding_second_has_more_pulses_than_the_limits(
        shell in shells(),
        layout in layouts(),
        ops in prop::collection::vec(prop_oneof![3 => tame(60), 1 => amend()], 1..120),
    ) {
        let limits = PowerLimits { motor: 300, rail: 700, ..layout.no_limits() };
        let mut world = World::new(shell, layout, limits);
        for op in ops {
            world.apply(match op {
                Op::Arm { assume_rest, host_timeout, .. } => Op::Arm { assume_rest, host_timeout, limits },
                op => op,
            });
        }
        world.end();
        let second = u64::from(layout.tick_hz());
        let mut rails = vec![Vec::new(); 64];
        for motor in 0..layout.motors() {
            let ticks: Vec<u64> = world.bench.pulses(motor as u8).map(|(tick, _)| tick).collect();
            prop_assert!(!breaks(&ticks, second, limits.motor), "motor {}", motor);
            rails[usize::from(layout.rail(motor))].extend(ticks);
        }
        for (rail, mut ticks) in rails.into_iter().enumerate() {
            ticks.sort_unstable();
            prop_assert!(!breaks(&ticks, second, limits.rail), "rail {}", rail);
        }
    }
}

/// Whether so many ticks have more than `limit` of these, which are in order.
fn breaks(ticks: &[u64], within: u64, limit: u32) -> bool {
    ticks.windows(limit as usize + 1).any(|some| some[limit as usize] - some[0] < within)
}

#[test]
fn this_optimised_build_checks_for_overflows() {
    assert!(std::panic::catch_unwind(|| debug_assert!(std::hint::black_box(false))).is_err());
    assert!(std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1)).is_err());
}
