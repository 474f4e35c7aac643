//! The host's session with a device that lies: whatever it says, the session stays sane and each stroke has one verdict at most.
//!
//! The device says true things, true things with a change, and bytes, all with a right CRC. Its truth is small: a clock that
//! follows the host's, and the epochs and frames that the session has sent.

use crate::input::{Raw, arm, array, byte, cause, chunk, flag, long, motor, motors, one_of, word};
use arbitrary::Unstructured;
use firmware_protocol::array::MAX_MOTORS;
use firmware_protocol::batch::Amendment;
use firmware_protocol::board::{Board, Counts, Outputs, Reset, SelfTest, SelfTestState};
use firmware_protocol::frame::{self, Decoder, MAX_FRAME};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{
    Cause, Counters, Cut, DeviceHello, DeviceMessage, HostMessage, Op, Report, Samples, State, Status,
    Trigger,
};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::{Step, Stroke};
use meissner_stream::link::{Budget, Contradictions, Event, LineRate, LostReason, Session, Verdict};
use meissner_stream::time::HostInstant;
use serde::Serialize;
use std::time::Duration;

/// What the device would say if it were true.
struct Device {
    status: Status,
    reports: u16,
    window: u16,
    run: u16,
    decoder: Decoder,
}

struct World {
    array: Array,
    session: Session,
    device: Device,
    ns: u64,
    /// Strokes that were pushed and have no verdict.
    pushed: Vec<Stroke>,
    last: Tick,
    opened: bool,
    lost: Option<LostReason>,
    doubts: u32,
}

const SESSION: u32 = 7;

/// See the module.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let how = byte(&mut input);
    let rate = LineRate([100_000, 800_000, 11_520, 1][usize::from(how & 3)]);
    let status = Status {
        token: 0,
        tick: Tick::BOOT.wire(),
        epoch: 0,
        refusal: None,
        next_seq: 0,
        out_of_order: 0,
        credits: 512,
        reports: 0,
        state: State::Disarmed,
        cause: Cause::Boot,
        position_known: false,
        outstanding: 0,
        counters: Counters::NONE,
    };
    let device = Device { status, reports: 0, window: 0, run: 0, decoder: Decoder::new() };
    let array = array(how);
    let mut world = World {
        array,
        session: Session::new(array, SESSION, rate, HostInstant::from_ns(0)),
        device,
        ns: 0,
        pushed: Vec::new(),
        last: Tick(0),
        opened: false,
        lost: None,
        doubts: 0,
    };
    if how & 4 == 0 {
        // A handshake, the first pings, and armed.
        world.transmit();
        world.hello(&mut Unstructured::new(&[]));
        for _ in 0..12 {
            world.ns += 2_000_000;
            world.transmit();
            world.say_status();
        }
        assert!(world.session.is_open());
    }
    while !input.is_empty() {
        world.step(&mut input);
        world.check();
    }
    // The session ends, whatever it has been told.
    for _ in 0..400 {
        if world.lost.is_some() {
            break;
        }
        world.ns += 200_000_000;
        world.transmit();
        world.silence();
    }
    assert!(!world.session.is_open() && !world.session.can_command(), "a silent device is lost");
}

fn emit<'a>(
    array: Array,
    pushed: &'a mut Vec<Stroke>,
    opened: &'a mut bool,
    lost: &'a mut Option<LostReason>,
    doubts: &'a mut u32,
) -> impl FnMut(Event) {
    move |event| {
        assert!(lost.is_none(), "{event:?} after the last event");
        match event {
            Event::Opened(hello) => {
                assert!(!std::mem::replace(opened, true), "a session opens once");
                assert_eq!(hello.session, SESSION);
            }
            Event::Lost(reason) => {
                assert!(!reason.text().is_empty());
                *lost = Some(reason);
            }
            Event::Contradiction(_) => *doubts += 1,
            event => {
                assert!(*opened, "{event:?} before the handshake");
                if let Event::Step(Step::Stroke(stroke), verdict) = event {
                    let at = pushed.iter().position(|&before| before == stroke);
                    let at = at.expect("a verdict on a stroke that was pushed and has none");
                    pushed.remove(at);
                    if let Verdict::Late { sent, .. } = verdict {
                        let _ = sent.as_ns();
                    }
                }
                if let Event::StrokeRefused { motor, .. } = event {
                    assert!(array.has(motor));
                }
            }
        }
    }
}

macro_rules! emitter {
    ($world:ident) => {
        &mut emit($world.array, &mut $world.pushed, &mut $world.opened, &mut $world.lost, &mut $world.doubts)
    };
}

impl World {
    fn now(&self) -> HostInstant {
        HostInstant::from_ns(self.ns)
    }

    fn tick(&self) -> Tick {
        Tick::BOOT + self.ns * u64::from(self.array.layout().tick_hz()) / 1_000_000_000
    }

    /// The session sends; the device notes what it would know.
    fn transmit(&mut self) {
        let mut out = [0; MAX_FRAME];
        for _ in 0..64 {
            let now = self.now();
            let len = self.session.transmit(now, &mut out, emitter!(self));
            if len == 0 {
                break;
            }
            let body = self.device.decoder.next(&mut &out[..len]).expect("a whole frame");
            let status = &mut self.device.status;
            match frame::read(body).expect("a message of this version") {
                HostMessage::Hello { session } => assert_eq!(session, SESSION),
                HostMessage::Ping { token, .. } => status.token = token,
                HostMessage::Control { epoch, op, .. } => {
                    (status.epoch, status.next_seq) = (epoch, 0);
                    status.state = match op {
                        Op::Arm { .. } if status.state != State::Faulted => State::Armed,
                        Op::EStop => State::Faulted,
                        Op::Disarm(_) | Op::Reset => State::Disarmed,
                        _ => status.state,
                    };
                }
                HostMessage::Moves { epoch, seq, .. } if epoch == status.epoch && seq == status.next_seq => {
                    status.next_seq = seq.wrapping_add(1);
                }
                HostMessage::Board { window } => self.device.window = window,
                HostMessage::SelfTest { run } => self.device.run = run,
                _ => {}
            }
        }
        assert!(self.lost.is_none() || self.session.transmit(self.now(), &mut out, &mut |_| ()) == 0);
    }

    fn silence(&mut self) {
        let now = self.now();
        self.session.check_silence(now, emitter!(self));
    }

    fn receive(&mut self, bytes: &[u8]) {
        let now = self.now();
        self.session.receive(now, bytes, emitter!(self));
    }

    fn say(&mut self, message: &impl Serialize) {
        let mut out = [0; MAX_FRAME];
        if let Ok(len) = frame::encode(message, &mut out) {
            self.receive(&out[..len]);
        }
    }

    fn say_status(&mut self) {
        self.device.status.tick = self.tick().wire();
        self.say(&DeviceMessage::Status(self.device.status));
        self.device.status.token = 0;
    }

    fn hello(&mut self, input: &mut Unstructured<'_>) {
        let layout = self.array.layout();
        let mut hello = DeviceHello {
            session: SESSION,
            firmware: [0, 1, 0],
            build: [0; 4],
            boot: 9,
            array: *layout.id(),
            pool: 512,
            horizon: layout.horizon(),
            max_up_pulses: layout.max_up_pulses(),
            limits: layout.no_limits(),
            features: 7,
            tick: self.tick().0,
            epoch: self.device.status.epoch,
            reports: self.device.reports,
            last_cut: None,
        };
        match byte(input) {
            1 => hello.session = long(input),
            2 => hello.tick = input.arbitrary().unwrap_or_default(),
            3 => hello.pool = word(input),
            4 => hello.horizon = byte(input),
            5 => hello.features = long(input),
            6 => hello.max_up_pulses = word(input),
            7 => hello.reports = word(input),
            8 => hello.epoch = word(input),
            9 => hello.array.motors = byte(input),
            10 => hello.array.tick_hz = long(input),
            _ => {}
        }
        self.say(&DeviceMessage::Hello(hello));
    }

    /// A status, true but for some of its fields.
    fn status(&mut self, input: &mut Unstructured<'_>) {
        self.device.status.tick = self.tick().wire();
        let mut status = self.device.status;
        for _ in 0..byte(input) % 4 {
            let (field, by) = (byte(input), word(input));
            match field % 16 {
                0 => status.token = status.token.wrapping_add(by),
                1 => {
                    status.tick =
                        Tick(self.tick().0.wrapping_add_signed(i64::from(by.cast_signed()) << (field >> 4)))
                            .wire();
                }
                2 => status.epoch = status.epoch.wrapping_add(by),
                3 => {
                    status.refusal = one_of(
                        input,
                        [None, Some(Refusal::State), Some(Refusal::PositionUnknown), Some(Refusal::Travel)],
                    );
                }
                4 => status.next_seq = status.next_seq.wrapping_add(by),
                5 => status.out_of_order = by as u8,
                6 => status.credits = by,
                7 => status.reports = status.reports.wrapping_add(by),
                8 => {
                    status.state =
                        one_of(input, [State::Disarmed, State::Armed, State::Returning, State::Faulted]);
                }
                9 => status.cause = cause(input),
                10 => status.position_known = by & 1 == 1,
                11 => status.outstanding = u32::from(by) << (field >> 4),
                12 => {
                    status.counters.played =
                        status.counters.played.wrapping_add(u64::from(by) << (field >> 4));
                }
                13 => {
                    status.counters.pulses =
                        status.counters.pulses.wrapping_add(u64::from(by) << (field >> 4));
                }
                14 => status.counters.late = u64::from(by) << ((field >> 4) * 4),
                _ => status.counters.bad_frames = status.counters.bad_frames.wrapping_add(by.into()),
            }
        }
        // The truth is what was said last, or what was true before.
        if flag(input) {
            self.device.status = status;
        }
        self.device.status.token = 0;
        self.say(&DeviceMessage::Status(status));
    }

    fn report(&mut self, input: &mut Unstructured<'_>) {
        let how = byte(input);
        let rendered = Tick(self.tick().0 + 64).wire();
        let seq = self.device.status.next_seq.wrapping_sub((how >> 4).into());
        let tick = Tick(self.last.0.saturating_sub(word(input).into())).wire();
        let report = match how % 7 {
            0 => Report::Verdict {
                seq,
                late: u64::from(long(input)),
                refused: u64::from(long(input)),
                kept: motors(input),
                reason: one_of(input, [None, Some(Refusal::PoolFull), Some(Refusal::Malformed)]),
                rendered,
            },
            1 => Report::OnsetRefused { seq, rendered },
            2 => Report::Onset { tick: self.last.wire(), counters: self.device.status.counters },
            3 => Report::Cut(Cut {
                cause: cause(input),
                at: rendered,
                return_ticks: flag(input).then(|| word(input).into()),
                flushed: word(input) % 600,
                outstanding: word(input).into(),
            }),
            4 => Report::Lowered { tick, late: motors(input), held: motors(input) },
            5 => Report::Edge { tick, number: byte(input).into() },
            _ => Report::Refused {
                motor: motor(input, self.array),
                tick,
                reason: one_of(input, [Refusal::RailOnTime, Refusal::Pushing, Refusal::State]),
            },
        };
        let skipped = if flag(input) { 0 } else { byte(input) % 40 };
        let number = self.device.reports.wrapping_add(1 + u16::from(skipped));
        if flag(input) {
            self.device.reports = number;
            self.device.status.reports = number;
        }
        self.say(&DeviceMessage::Report { number, report });
    }

    fn board(&mut self, input: &mut Unstructured<'_>) {
        if flag(input) {
            self.session.ask_board();
            return;
        }
        let count = |input: &mut Unstructured<'_>| flag(input).then(|| long(input));
        let board = Board {
            window: self.device.window.wrapping_add((byte(input) % 3).into()),
            reset: one_of(input, [Reset::Unknown, Reset::Power, Reset::Watchdog]),
            uptime_s: long(input),
            slack: flag(input).then(|| byte(input)),
            slack_since_boot: flag(input).then(|| byte(input)),
            counts: Counts { stalls: count(input), usb_recoveries: count(input), output_faults: long(input) },
            high_at_boot: flag(input).then(|| motors(input)).map(|lines| Outputs { lines, ..Outputs::NONE }),
        };
        self.say(&DeviceMessage::Board(board));
    }

    fn step(&mut self, input: &mut Unstructured<'_>) {
        match byte(input) % 32 {
            0 => self.receive(chunk(input)),
            1 | 2 => {
                let body = chunk(input);
                self.say(&Raw(body));
            }
            3 => self.hello(input),
            4..=9 => self.status(input),
            10..=12 => self.report(input),
            13 => self.say(&DeviceMessage::Telemetry {
                tick: Tick(self.tick().0.wrapping_sub(word(input).into())).wire(),
                first: byte(input) % (self.array.motors().div_ceil(8) as u8 + 1) * 8,
                y: Samples::of(&[long(input).cast_signed(); MAX_MOTORS][..usize::from(byte(input) % 4) * 8]),
            }),
            14 => self.board(input),
            15 => {
                if flag(input) {
                    self.session.ask_self_test();
                } else {
                    let done = SelfTestState::Done(SelfTest::default());
                    let state = one_of(
                        input,
                        [SelfTestState::Refused, SelfTestState::Running, SelfTestState::Ended, done],
                    );
                    self.say(&DeviceMessage::SelfTest { run: self.device.run, state });
                }
            }
            16 => self.say(&DeviceMessage::NoSession),
            17..=19 => {
                self.ns += u64::from(word(input)) * 1_000;
                self.transmit();
                self.silence();
            }
            20 => self.ns += u64::from(long(input)),
            21..=23 => self.push(input),
            24 => {
                self.session.seal();
                if self.session.has_room() {
                    let trigger = flag(input).then_some(Trigger { width: 9, code: 7 });
                    self.last = self.last.max(self.tick() + u64::from(word(input)));
                    if flag(input) {
                        self.session.begin(self.last, trigger, u32::MAX);
                    } else {
                        self.session.mark(self.last, trigger, u32::MAX);
                    }
                }
            }
            25 => {
                self.session.seal();
                if self.session.has_room() {
                    self.session.replace(self.last, motors(input), motors(input));
                }
            }
            26 => self.session.command(match byte(input) % 6 {
                0 => Op::Stop,
                1 => Op::Disarm(Cause::Request),
                2 => Op::EStop,
                3 => Op::Reset,
                4 => Op::Seek { pulses: word(input) },
                _ => {
                    let assume_rest = flag(input);
                    arm(input, self.array, assume_rest)
                }
            }),
            27 => {
                let amendment = Amendment {
                    motor: byte(input) % self.array.motors() as u8,
                    tick: Tick(self.last.0.saturating_sub(byte(input).into())),
                    pulses: word(input),
                };
                let _ = self.session.amend(&amendment);
            }
            28 => {
                let budget =
                    Budget { bytes: word(input).into(), time: Duration::from_millis(byte(input).into()) };
                self.session.probe(budget);
            }
            29 => {
                let (every, now) = (Duration::from_millis(1 + u64::from(byte(input))), self.now());
                self.session.keep_alive_every(every, now);
                self.session.request_status();
            }
            30 => {
                let _ = (self.session.take_e_stop(), self.session.take_round_trip());
            }
            _ => self.transmit(),
        }
    }

    fn push(&mut self, input: &mut Unstructured<'_>) {
        let ahead = u64::from(word(input));
        for i in 0..byte(input) % 40 {
            let up = self.last.max(self.tick() + ahead) + 1;
            let (motor, up_pulses) = (i % self.array.motors() as u8, 1 + u16::from(i));
            let stroke = Stroke { motor, up, up_pulses, down: up + 60, down_pulses: up_pulses };
            if !self.session.push(&stroke.into()) {
                break;
            }
            self.last = up;
            self.pushed.push(stroke);
        }
    }

    fn check(&mut self) {
        let now = self.now();
        let session = &self.session;
        let _ = (session.wake_at(now), session.clock().tick_at(now), session.known_to(), session.capacity());
        let _ = (session.delivery(), session.ack_wait(), session.rate_beside(9), session.is_answered());
        assert!(session.credits() <= usize::from(u16::MAX));
        let Contradictions { .. } = session.traffic().contradictions;
        assert!(self.doubts <= 11, "each kind of doubt is reported once");
        if self.lost.is_some() {
            assert!(!session.is_open() && !session.can_command() && !session.has_room());
        }
    }
}
