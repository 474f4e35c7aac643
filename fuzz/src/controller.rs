//! The controller: any requests, bytes, faults and ticks in any order break no limit and no account.
//!
//! The first byte chooses the array, the shell and whether the host is tame: a tame host corrects nothing and leaves rest where it is, so that
//! every pulse can be accounted for. The oracle is that of `firmware-protocol/tests/properties.rs`.

use crate::input::{arm, array, byte, cause, chunk, direction, flag, long, mark, motor, withdraw, word};
use crate::shell::Shell;
use arbitrary::Unstructured;
use firmware_protocol::array::{MAX_MOTORS, MotorSet};
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer, Stroke};
use firmware_protocol::board::SelfTest;
use firmware_protocol::controller::POOL;
use firmware_protocol::frame::{self, MAX_FRAME};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, HostMessage, LowerStop, Op, State};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::{Tick, WireTick};
use meissner_array::spec::Array;

/// Ticks that an input may let pass: longer ones only repeat what is quiet.
const MOST_TICKS: u64 = 12_000;
const MOST_TICKS_TIGHT: u64 = 1_500;

struct World {
    array: Array,
    shell: Shell,
    tame: bool,
    last_frame: ([u8; MAX_FRAME], usize),
    moves: Vec<Move>,
    /// Whether all moves came in frames that were counted: raw bytes may be anything.
    counted: bool,
    accepted: u64,
    refused_in_frames: u64,
    ticks_left: u64,
}

/// See the module.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let how = byte(&mut input);
    let array = array(how);
    let tight = how & 1 == 1;
    let tame = how & 2 == 0;
    // Also with a clock that comes near its end, or runs long.
    let start = if how & 4 == 0 { Tick::BOOT } else { Tick(1 << 40) };
    let mut world = World {
        array,
        shell: Shell::new(array, tight, start),
        tame,
        last_frame: ([0; MAX_FRAME], 0),
        moves: Vec::new(),
        counted: true,
        accepted: 0,
        refused_in_frames: 0,
        ticks_left: if tight { MOST_TICKS_TIGHT } else { MOST_TICKS },
    };
    // Neighbouring bursts may join: the end of one is the begin of the next.
    let layout = array.layout();
    world.shell.longest = if tame {
        layout.max_up_pulses().into()
    } else {
        u64::from(layout.max_down_pulses())
            + 4 * u64::from(layout.max_travel())
            + u64::from(layout.max_seek())
    };
    if how & 8 == 0 {
        world.shell.send(&HostMessage::Hello { session: 1 });
        world.shell.control(usual_arm(array, true));
        assert_eq!(world.shell.device.state(), State::Armed);
    }
    while !input.is_empty() {
        world.step(&mut input);
    }
    world.end();
}

fn usual_arm(array: Array, assume_rest: bool) -> Op {
    let layout = array.layout();
    let lower_stop = Some(LowerStop { pulses_per_s: layout.max_pushes_per_s(), seek: 0 });
    Op::Arm { assume_rest, host_timeout: 2 * layout.tick_hz(), limits: layout.no_limits(), lower_stop }
}

impl World {
    fn pass(&mut self, ticks: u64) {
        let ticks = ticks.min(self.ticks_left);
        self.ticks_left -= ticks;
        self.shell.run(ticks);
    }

    fn step(&mut self, input: &mut Unstructured<'_>) {
        let op = byte(input) % if self.tame { 20 } else { 32 };
        match op {
            0..=3 => self.pass(byte(input).into()),
            4 => self.pass(word(input).into()),
            5 => self.shell.send(&HostMessage::Hello { session: (byte(input) % 3).into() }),
            6 => {
                let (token, seen) = (byte(input).into(), self.shell.seen());
                self.shell.send(&HostMessage::Ping { token, seen });
            }
            7 => self.arm(input),
            8 => self.shell.control(Op::Disarm(if self.tame { Cause::Shutdown } else { cause(input) })),
            9 => self.shell.control(Op::Stop),
            10 => self.off(|shell| shell.control(Op::EStop)),
            11 => self.off(|shell| {
                shell.device.fault(Tick(shell.now), Cause::Starved);
                assert_eq!(shell.device.state(), State::Faulted);
                shell.after_event();
            }),
            12 => {
                let epoch = self.shell.epoch.wrapping_add(byte(input).into());
                self.off(|shell| shell.e_stop(epoch));
            }
            13 => self.shell.control(Op::Reset),
            14..=16 => self.moves(input),
            17 => {
                let (bytes, len) = self.last_frame;
                self.send(&bytes[..len], false);
            }
            18 => {
                self.shell.device.link_lost(Tick(self.shell.now));
                self.shell.after_event();
            }
            19 => {
                self.shell.reading = flag(input);
            }
            _ => self.wild(op, input),
        }
        if self.tame && !matches!(self.shell.device.state(), State::Armed | State::Returning) {
            for (motor, &net) in self.shell.net.iter().enumerate() {
                assert_eq!(net, i64::from(self.shell.device.outstanding(motor as u8)), "motor {motor}");
            }
        }
    }

    fn wild(&mut self, op: u8, input: &mut Unstructured<'_>) {
        self.counted &= !matches!(op, 24 | 26 | 27 | 31);
        match op {
            20 => {
                let (motor, direction, pulses) =
                    (motor(input, self.array), direction(input), word(input) % 7_000);
                self.shell.control(Op::Move { motor, direction, pulses });
            }
            21 => self.shell.control(Op::Seek { pulses: word(input) % 20_000 }),
            22 | 23 => self.amend(input),
            24 => self.raw_moves(input),
            25 => {
                let (generation, base) = (byte(input).into(), self.base(input));
                let (epoch, items) = (self.shell.epoch, chunk(input));
                let items = &items[..items.len().min(BATCH_BYTES)];
                self.shell.send(&HostMessage::Amend { epoch, generation, base, items });
            }
            26 => {
                let (epoch, assume_rest) = (self.shell.epoch.wrapping_sub(word(input)), flag(input));
                let op = arm(input, self.array, assume_rest);
                self.shell.send(&HostMessage::Control { epoch, seen: word(input), op });
            }
            27 => {
                let in_pieces = flag(input);
                let bytes = chunk(input);
                self.send(bytes, in_pieces);
            }
            28 => {
                let followed = Tick(self.shell.device.rendered().0.saturating_sub(byte(input).into()));
                self.off(|shell| {
                    shell.device.output_failed(followed);
                    shell.after_event();
                });
            }
            29 => {
                self.shell.send(&HostMessage::Board { window: byte(input).into() });
                self.shell.device.rendered_with(byte(input).into());
            }
            30 => {
                self.shell.send(&HostMessage::SelfTest { run: (byte(input) % 4).into() });
                if flag(input) {
                    self.shell.device.tested(SelfTest::default());
                    self.shell.drain();
                }
            }
            _ => {
                let now = Tick(self.shell.now);
                match byte(input) % 3 {
                    1 => self.shell.device.edge(now),
                    0 => self.shell.device.open_session(now, (byte(input) % 3).into()),
                    _ => self.shell.device.telemetry(now, &[i32::MIN; MAX_MOTORS]),
                }
                self.shell.after_event();
            }
        }
    }

    fn arm(&mut self, input: &mut Unstructured<'_>) {
        let op = if self.tame {
            let op = usual_arm(self.array, false);
            match (byte(input), op) {
                (0..0x80, op) => op,
                (tight, Op::Arm { assume_rest, lower_stop, .. }) => {
                    let (rail_at_once, chip_at_once) = (tight % 7, tight % 3);
                    let limits = PowerLimits { motor: 300, rail: 700, rail_at_once, chip_at_once };
                    Op::Arm { assume_rest, host_timeout: 300 * u32::from(tight), limits, lower_stop }
                }
                (_, op) => op,
            }
        } else {
            let assume_rest = flag(input);
            arm(input, self.array, assume_rest)
        };
        self.shell.control(op);
    }

    fn off(&mut self, off: impl FnOnce(&mut Shell)) {
        off(&mut self.shell);
        self.shell.run(1);
    }

    fn base(&self, input: &mut Unstructured<'_>) -> WireTick {
        let from = i64::from(word(input).cast_signed());
        Tick(self.shell.device.rendered().0.saturating_add_signed(from)).wire()
    }

    fn moves(&mut self, input: &mut Unstructured<'_>) {
        let (mark, withdraw) = (mark(input), withdraw(input, self.array));
        let from = i64::from(byte(input)) - 40;
        let base = self.shell.device.rendered().0.saturating_add_signed(from);
        let mut packer = Packer::<BATCH_BYTES>::new(Tick(base));
        let mut at = base;
        for _ in 0..byte(input) % 12 {
            at += u64::from(byte(input) / 2);
            let (motor, tick) = (motor(input, self.array), Tick(at));
            let level = match byte(input) {
                few @ 0..0xf0 => u16::from(few % 60),
                _ => self.array.layout().max_up_pulses() - 100 + u16::from(byte(input) % 102),
            };
            let (how, with) = (byte(input), byte(input));
            let surplus = if self.tame || how & 0x1c != 0 { 0 } else { u16::from(how >> 5) };
            match how & 3 {
                0 | 1 => {
                    let down = tick + u64::from(level) + u64::from(with % 100);
                    let stroke = Stroke { motor, up: tick, level, down, surplus };
                    if packer.stroke(&stroke).is_ok() {
                        self.moves.extend(stroke.moves());
                    }
                }
                2 => {
                    let surplus = if level == 0 { surplus } else { 0 };
                    let of = Move { motor, tick, level, surplus };
                    if packer.moves(&of).is_ok() {
                        self.moves.push(of);
                    }
                }
                _ => {
                    let motors = MotorSet::from_bits(u64::from(with) << (motor % 56));
                    let levels: Vec<u16> =
                        (0..motors.len() as u16).map(|k| level + k * u16::from(how >> 2)).collect();
                    if packer.row(tick, motors, &levels).is_ok() {
                        let of = motors.iter().zip(levels);
                        self.moves.extend(of.map(|(motor, level)| Move { motor, tick, level, surplus: 0 }));
                    }
                }
            }
        }
        let shell = &self.shell;
        let (epoch, seq, seen) = (shell.epoch, shell.seq, shell.seen());
        let (base, batch) = (Tick(base).wire(), packer.bytes());
        self.stream(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch });
    }

    fn raw_moves(&mut self, input: &mut Unstructured<'_>) {
        let epoch = self.shell.epoch.wrapping_sub((byte(input) % 4).into());
        let seq = self.shell.seq.wrapping_add((byte(input) % 10).into());
        let (seen, mark, withdraw, base) =
            (long(input) as u16, mark(input), withdraw(input, self.array), self.base(input));
        let batch = chunk(input);
        let batch = &batch[..batch.len().min(BATCH_BYTES)];
        self.stream(&HostMessage::Moves { epoch, seq, seen, mark, withdraw, base, batch });
    }

    fn stream(&mut self, message: &HostMessage<'_>) {
        let mut out = [0; MAX_FRAME];
        let len = frame::encode(message, &mut out).expect("a message that fits");
        self.last_frame = (out, len);
        self.send(&out[..len], false);
    }

    /// Sends bytes, and counts the moves that they queue.
    fn send(&mut self, bytes: &[u8], in_pieces: bool) {
        let (before, counted) = (self.shell.credits(), self.shell.device.counters());
        self.shell.bytes(bytes, in_pieces);
        if let (true, Some(before), Some(after)) = (self.counted, before, self.shell.credits()) {
            let counters = self.shell.device.counters();
            // Those to rest of pins at rest are played at once.
            let (replaced, played) = (counters.replaced - counted.replaced, counters.played - counted.played);
            self.accepted += u64::from(before) + replaced + played - u64::from(after);
            self.refused_in_frames += counters.refused - counted.refused;
        }
    }

    fn amend(&mut self, input: &mut Unstructured<'_>) {
        let (generation, pick) = (byte(input) % 6, usize::from(byte(input)));
        let change = i16::from(byte(input) % 19) - 9;
        let recent = &self.moves[self.moves.len().saturating_sub(24)..];
        let Some(&Move { motor, tick, level, .. }) = recent.get(pick % recent.len().max(1)) else { return };
        // What it is planned to go, if it follows the move before.
        let of_motor = recent.iter().filter(|of| of.motor == motor && of.tick < tick);
        let from = of_motor.max_by_key(|of| of.tick).map_or(0, |of| of.level);
        let mut packer = Packer::<BATCH_BYTES>::new(tick);
        let pulses = level.abs_diff(from).saturating_add_signed(change);
        packer.amendment(&Amendment { motor, tick, pulses }).expect("room");
        let (epoch, base, items) = (self.shell.epoch, tick.wire(), packer.bytes());
        self.shell.send(&HostMessage::Amend { epoch, generation: generation.into(), base, items });
    }

    /// Disarms and waits: all lines are off, all slots free, every move and pulse is counted.
    fn end(&mut self) {
        let shell = &mut self.shell;
        shell.reading = true;
        shell.bytes(&[0], false);
        shell.send(&HostMessage::Hello { session: 1_000 });
        assert_ne!(shell.device.state(), State::Armed);
        shell.run(100);
        for _ in 0..1_000 {
            if shell.device.state() != State::Returning {
                break;
            }
            shell.run(200);
        }
        assert!(matches!(shell.device.state(), State::Disarmed | State::Faulted), "a return ends");
        shell.run(100);
        let total = shell.total;
        shell.run(300);
        assert_eq!(shell.total, total, "a line is on");
        assert_eq!(shell.credits(), Some(POOL as u16));
        let counters = shell.device.counters();
        if self.counted {
            let refused = counters.refused - self.refused_in_frames;
            assert_eq!(self.accepted, counters.played + counters.dropped + refused + counters.replaced);
        }
        if self.tame {
            assert_eq!(counters.pulses, total);
            for (motor, &net) in shell.net.iter().enumerate() {
                assert_eq!(net, i64::from(shell.device.outstanding(motor as u8)), "motor {motor}");
            }
        } else {
            assert!(counters.pulses <= total);
        }
    }
}
