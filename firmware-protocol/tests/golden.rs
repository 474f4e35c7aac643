//! The bytes of version 6 on the wire. Never edit them: a changed byte is a new version.

use crate::bench::{ONSET, frame, pack, stroke};
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::board::{Board, LineTest, RamTest, Reset, SelfTest, SelfTestState, WaveTest};
use firmware_protocol::frame::{Decoder, FRAME_OVERHEAD, MAX_FRAME, PROTOCOL};
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{
    Cause, Counters, Cut, DeviceHello, DeviceMessage, HostMessage, LowerStop, Mark, MarkKind, Op, Report,
    State, Status, Trigger, Withdraw,
};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::{Tick, WireTick};
use serde::{Deserialize, Serialize};
use std::fmt::Debug;

const BASE: u64 = 0xfeed_f00d;
const COUNTERS: Counters = Counters {
    played: 1,
    pulses: 294,
    dropped: 3,
    late: 4,
    refused: 5,
    replaced: 10,
    amended: 6,
    amendments_ignored: 7,
    bad_frames: 8,
    reports_lost: 9,
};
const CUT: Cut = Cut {
    cause: Cause::HostTimeout,
    at: WireTick([1, 2, 3, 4]),
    return_ticks: Some(1_200),
    flushed: 300,
    outstanding: 77,
};
const STATUS: Status = Status {
    token: 513,
    tick: WireTick([0xff, 0, 0xfe, 0x7f]),
    epoch: 2,
    refusal: None,
    next_seq: 300,
    out_of_order: 5,
    credits: 1024,
    reports: 5,
    state: State::Armed,
    cause: Cause::Request,
    position_known: true,
    outstanding: 0,
    counters: COUNTERS,
};
const HELLO: DeviceHello = DeviceHello {
    session: 0xdead_beef,
    firmware: [1, 2, 3],
    build: [0xca, 0xfe, 0, 1],
    boot: 99,
    motors: 24,
    tick_hz: 85_000,
    pool: 1024,
    horizon: 64,
    max_up_pulses: 3000,
    limits: PowerLimits::NONE,
    features: DeviceHello::SIMULATED | DeviceHello::TELEMETRY,
    tick: 0xffd9_1a30,
    epoch: 1,
    reports: 0,
    last_cut: Some(CUT),
};

const BOARD: Board = Board {
    window: 300,
    reset: Reset::Watchdog,
    uptime_s: 86_400,
    slack: Some(26),
    slack_since_boot: Some(25),
    stalls: Some(1),
    usb_recoveries: Some(2),
    output_faults: 3,
    high_at_boot: Some(1 << 25),
};
const TESTED: SelfTest = SelfTest {
    lines: Some(LineTest { stuck_high: 1, stuck_low: 2, shorted: 12, pair: Some((2, 3)) }),
    wave: Some(WaveTest { timer_us: 100_000, ticks: 8_500, words: 34_000 }),
    ram: Some(RamTest { bytes: 65_536, bad: Some(0x2003_0000) }),
    work_us: Some(158),
};

/// Checks that `message` is written as these bytes and read back from them.
fn golden<'de, M: Serialize + Deserialize<'de> + PartialEq + Copy + Debug>(
    message: &M,
    hex: &str,
    room: &'de mut Vec<u8>,
) {
    let written: String = frame(message).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(written, hex, "{message:?}");
    let wire: Vec<u8> =
        (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex")).collect();
    let mut decoder = Decoder::default();
    room.extend(decoder.next(&mut &wire[..]).expect("a frame").expect("a valid one"));
    assert_eq!(postcard::take_from_bytes::<M>(room), Ok((*message, &[][..])));
}

#[test]
fn from_the_host() {
    let strokes = pack(
        BASE,
        &[
            stroke(0, BASE, 147, 561, 147),
            stroke(23, BASE + 59, 147, 561, 150),
            stroke(4, BASE + 100_000, 3_000, 0, 2_999),
        ],
    );
    let mut items = Packer::<BATCH_BYTES>::new(Tick(BASE));
    for (motor, up, direction, pulses) in
        [(9, BASE + 1_417, Direction::Up, 151), (23, BASE + 1_400, Direction::Down, 143)]
    {
        items.amendment(&Amendment { motor, up: Tick(up), direction, pulses }).unwrap();
    }
    let base = Tick(BASE).wire();
    let limits = PowerLimits { motor: 20_000, rail: 90_000, rail_at_once: 3, chip_at_once: 1 };
    let arm = |lower_stop| Op::Arm { assume_rest: true, host_timeout: 25_500, limits, lower_stop };
    let control = |op| HostMessage::Control { epoch: 7, seen: 400, op };
    let coded = Mark { kind: MarkKind::Item, trigger: Some(Trigger { width: 85, code: 200 }) };
    let silent = Mark { kind: MarkKind::Play, trigger: None };
    let marked = |mark| HostMessage::Strokes {
        epoch: 7,
        seq: 1,
        seen: 1,
        mark: Some(mark),
        withdraw: None,
        base,
        batch: &[],
    };
    let cases = [
        (HostMessage::Hello { session: 0xdead_beef }, "02060aeffdb6f50dd79f9df600"),
        (HostMessage::Ping { token: 513, seen: 0 }, "0506018104056bd1457500"),
        (control(arm(None)), "0606020790030d019cc701a09c0190bf0503010538f6a88300"),
        (
            control(arm(Some(LowerStop { pulses_per_s: 17_000, seek: 7_400 }))),
            "06060207900317019cc701a09c0190bf05030101e88401e8397d6f184a00",
        ),
        (control(Op::Seek { pulses: 7_400 }), "0d060207900306e839dff24b2700"),
        (control(Op::Disarm(Cause::Shutdown)), "0c0602079003010359a8403e00"),
        (control(Op::Disarm(Cause::Abort)), "0c06020790030104fa3d24a000"),
        (control(Op::Stop), "0b06020790030278a3bcb800"),
        (control(Op::EStop), "0b060207900303ee93bbcf00"),
        (control(Op::Reset), "0b0602079003044d06df5100"),
        (
            control(Op::Move { motor: 5, direction: Direction::Down, pulses: 1_000 }),
            "0f0602079003050501e8070ec4c45500",
        ),
        (
            HostMessage::Strokes {
                epoch: 7,
                seq: 0,
                seen: 1,
                mark: Some(ONSET),
                withdraw: None,
                base,
                batch: strokes.bytes(),
            },
            "040603070301010401d20601070df0edfe1340109301b104373bb1040604e58c06b8170601d0386e5700",
        ),
        (marked(coded), "0b060307010101010155c8050df0edfe05c7a6590300"),
        (marked(silent), "070603070101010101050df0edfe055b4aef8c00"),
        (
            HostMessage::Strokes {
                epoch: 7,
                seq: 2,
                seen: 1,
                mark: None,
                withdraw: Some(Withdraw { motors: 0x0080_0001, generation: 300 }),
                base,
                batch: &[],
            },
            "0606030702010c0181808004ac020df0edfe059d646d4300",
        ),
        (
            HostMessage::Strokes {
                epoch: 7,
                seq: 65_535,
                seen: 1,
                mark: None,
                withdraw: None,
                base,
                batch: &[],
            },
            "08060307ffff030101050df0edfe05039283bb00",
        ),
        (
            HostMessage::Amend { epoch: 7, generation: 1_000, base, items: items.bytes() },
            "18060407e8070df0edfe09099216970137218f01cc2edada00",
        ),
        (HostMessage::Board { window: 300 }, "090605ac02e2d058ee00"),
        (HostMessage::SelfTest { run: 65_535 }, "0a0606ffff0344c5bcd800"),
    ];
    for (message, hex) in cases {
        golden(&message, hex, &mut Vec::new());
    }
}

#[test]
fn from_the_device() {
    let report = |report| DeviceMessage::Report { number: 200, report };
    let rendered = Tick(BASE + 64).wire();
    let refused = |reason| report(Report::Refused { motor: 17, up: Tick(BASE).wire(), reason });
    let test = |state| DeviceMessage::SelfTest { run: 300, state };
    let status = |state, cause, refusal| DeviceMessage::Status(Status { state, cause, refusal, ..STATUS });
    let mut y = [0; MOTORS];
    (y[0], y[1], y[22], y[23]) = (1, -1, 8_000, i32::MIN);
    let cases = [
        (
            DeviceMessage::Hello(HELLO),
            "02060beffdb6f50d010203cafe1b016318889805800840b817889805b0901f060203b0b4e4fe0f011101060102030401b009ac024d6f1b336900",
        ),
        (
            DeviceMessage::Hello(DeviceHello { last_cut: None, ..HELLO }),
            "02060beffdb6f50d010203cafe1b016318889805800840b817889805b0901f060203b0b4e4fe0f0101054d61cb8100",
        ),
        (DeviceMessage::NoSession, "070601ef85846000"),
        (
            DeviceMessage::Status(STATUS),
            "0606028104ff04fe7f020aac02058008050101011001a6020304050a060708095bc4af7600",
        ),
        (
            status(State::Disarmed, Cause::Boot, Some(Refusal::PositionUnknown)),
            "0606028104ff0cfe7f02010aac02058008050102011001a6020304050a060708095401990a00",
        ),
        (
            status(State::Returning, Cause::LinkLost, Some(Refusal::State)),
            "0606028104ff0ffe7f02010bac02058008050207011001a6020304050a06070809c57efad000",
        ),
        (
            status(State::Returning, Cause::NewHost, Some(Refusal::Travel)),
            "0606028104ff0ffe7f02010cac02058008050208011001a6020304050a0607080973f4b7e300",
        ),
        (
            status(State::Faulted, Cause::EStop, None),
            "0606028104ff04fe7f020aac02058008050305011001a6020304050a06070809d1fa85c700",
        ),
        (
            status(State::Faulted, Cause::Starved, None),
            "0606028104ff04fe7f020aac02058008050309011001a6020304050a06070809fc6b70ed00",
        ),
        (
            status(State::Faulted, Cause::Output, None),
            "0606028104ff04fe7f020aac0205800805030c011001a6020304050a060708099105d36900",
        ),
        (
            status(State::Faulted, Cause::Panic, Some(Refusal::Malformed)),
            "0606028104ff0ffe7f02010dac0205800805030a011001a6020304050a06070809f68f0aac00",
        ),
        (
            report(Report::Verdict {
                kept: 0x0080_0001,
                seq: 300,
                late: 1,
                refused: 1 << 63,
                reason: Some(Refusal::NotArmed),
                rendered,
            }),
            "050603c80113ac0201808080808080808080018180800401094df0edfeb8b303f300",
        ),
        (report(Report::OnsetRefused { seq: 1, rendered }), "0f0603c80101014df0edfe5d287e4300"),
        (
            report(Report::Onset { tick: rendered, counters: COUNTERS }),
            "190603c801024df0edfe01a6020304050a0607080910fd538a00",
        ),
        (report(Report::Cut(CUT)), "150603c80103060102030401b009ac024d038027ea00"),
        (
            report(Report::Cut(Cut { cause: Cause::Stop, return_ticks: None, ..CUT })),
            "0b0603c80103020102030408ac024d66824c0400",
        ),
        (refused(Refusal::Motor), "100603c80104110df0edfe010ff981b900"),
        (refused(Refusal::UpPulses), "100603c80104110df0edfe02b5a8882000"),
        (refused(Refusal::Bursts), "100603c80104110df0edfe0323988f5700"),
        (refused(Refusal::Unbalanced), "100603c80104110df0edfe04800debc900"),
        (refused(Refusal::Overlap), "100603c80104110df0edfe05163decbe00"),
        (refused(Refusal::TooFar), "100603c80104110df0edfe06ac6ce52700"),
        (refused(Refusal::PoolFull), "100603c80104110df0edfe073a5ce25000"),
        (refused(Refusal::MotorOnTime), "100603c80104110df0edfe08ab415dc000"),
        (refused(Refusal::Pushing), "100603c80104110df0edfe0e9ee43e2900"),
        (refused(Refusal::RailAtOnce), "100603c80104110df0edfe0f08d4395e00"),
        (refused(Refusal::ChipAtOnce), "100603c80104110df0edfe10fdd931d300"),
        (refused(Refusal::Dense), "100603c80104110df0edfe116be936a400"),
        (refused(Refusal::RailOnTime), "100603c80104110df0edfe093d715ab700"),
        (
            DeviceMessage::Telemetry { tick: rendered, y },
            "0906044df0edfe0201010101010101010101010101010101010101010c807dffffffff0ffabaa3b300",
        ),
        (DeviceMessage::Board(BOARD), "1b0605ac020480a305011a0119010101020301808080108d40b40e00"),
        (
            DeviceMessage::Board(Board {
                reset: Reset::Program,
                slack: None,
                slack_since_boot: None,
                stalls: None,
                usb_recoveries: None,
                high_at_boot: None,
                ..BOARD
            }),
            "090605ac020680a305010101020305392d5a2700",
        ),
        (test(SelfTestState::Refused), "050606ac0205e79b5d8e00"),
        (test(SelfTestState::Running), "0a0606ac020171ab5af900"),
        (test(SelfTestState::Ended), "0a0606ac0202cbfa536000"),
        (
            test(SelfTestState::Done(TESTED)),
            "270606ac02030101020c01020301a08d06b442d08902018080040180808c8002019e0137ea43f900",
        ),
        (test(SelfTestState::Done(SelfTest::default())), "060606ac02030101010562061fd900"),
    ];
    for (message, hex) in cases {
        golden(&message, hex, &mut Vec::new());
    }
}

/// Every message with the longest numbers.
#[test]
fn messages_fit() {
    const ALL: u64 = u64::MAX;
    let counters = Counters {
        played: ALL,
        pulses: ALL,
        dropped: ALL,
        late: ALL,
        refused: ALL,
        replaced: ALL,
        amended: ALL,
        amendments_ignored: ALL,
        bad_frames: ALL,
        reports_lost: ALL,
    };
    let limits =
        PowerLimits { motor: u32::MAX, rail: u32::MAX, rail_at_once: u8::MAX, chip_at_once: u8::MAX };
    let tick = WireTick([0; 4]);
    let cut = Cut {
        cause: Cause::Panic,
        at: tick,
        return_ticks: Some(u32::MAX),
        flushed: u16::MAX,
        outstanding: u32::MAX,
    };
    let reason = Refusal::Malformed;
    let status = Status {
        token: u16::MAX,
        epoch: u16::MAX,
        refusal: Some(reason),
        next_seq: u16::MAX,
        out_of_order: u8::MAX,
        credits: u16::MAX,
        reports: u16::MAX,
        outstanding: u32::MAX,
        counters,
        ..STATUS
    };
    let hello = DeviceHello {
        session: u32::MAX,
        boot: u32::MAX,
        tick_hz: u32::MAX,
        pool: u16::MAX,
        max_up_pulses: u16::MAX,
        limits,
        features: u32::MAX,
        tick: ALL,
        epoch: u16::MAX,
        reports: u16::MAX,
        last_cut: Some(cut),
        ..HELLO
    };
    let report = |report| DeviceMessage::Report { number: u16::MAX, report };
    let device = [
        DeviceMessage::Hello(hello),
        DeviceMessage::NoSession,
        DeviceMessage::Status(status),
        report(Report::Verdict {
            kept: u32::MAX,
            seq: u16::MAX,
            late: ALL,
            refused: ALL,
            reason: Some(reason),
            rendered: tick,
        }),
        report(Report::OnsetRefused { seq: u16::MAX, rendered: tick }),
        report(Report::Onset { tick, counters }),
        report(Report::Cut(cut)),
        report(Report::Refused { motor: u8::MAX, up: tick, reason }),
        DeviceMessage::Telemetry { tick, y: [i32::MIN; MOTORS] },
        DeviceMessage::Board(Board {
            window: u16::MAX,
            uptime_s: u32::MAX,
            output_faults: u32::MAX,
            ..BOARD
        }),
        DeviceMessage::SelfTest { run: u16::MAX, state: SelfTestState::Done(TESTED) },
    ];
    let longest = device.iter().map(|message| frame(message).len()).max();
    assert!(longest.is_some_and(|longest| longest <= MAX_FRAME), "{longest:?}");

    let (epoch, seq, seen, generation) = (u16::MAX, u16::MAX, u16::MAX, u16::MAX);
    let list = [0xff; BATCH_BYTES];
    let trigger = Some(Trigger { width: u16::MAX, code: u8::MAX });
    let mark = Some(Mark { kind: MarkKind::Item, trigger });
    let withdraw = Some(Withdraw { motors: u32::MAX, generation });
    let strokes = HostMessage::Strokes { epoch, seq, seen, mark, withdraw, base: tick, batch: &list };
    // The longest header and batch exactly fill a frame.
    assert_eq!(frame(&strokes).len(), MAX_FRAME);
    let amend = HostMessage::Amend { epoch, generation, base: tick, items: &list };
    assert!(frame(&amend).len() <= MAX_FRAME);
    let lower_stop = Some(LowerStop { pulses_per_s: u32::MAX, seek: u16::MAX });
    let op = Op::Arm { assume_rest: true, host_timeout: u32::MAX, limits, lower_stop };
    assert!(frame(&HostMessage::Control { epoch, seen, op }).len() <= MAX_FRAME);
}

#[test]
fn a_steady_play_takes_less_than_six_bytes_per_burst() {
    // 24 motors at 60 Hz and 147 pulses, as many strokes in the frame as fit.
    let mut packer = Packer::<BATCH_BYTES>::new(Tick(BASE));
    let mut k = 0;
    while packer.stroke(&stroke((k % 24) as u8, BASE + 59 * k, 147, 561, 147)).is_ok() {
        k += 1;
    }
    let base = packer.base().wire();
    let frame = frame(&HostMessage::Strokes {
        epoch: u16::MAX,
        seq: u16::MAX,
        seen: u16::MAX,
        mark: Some(ONSET),
        withdraw: None,
        base,
        batch: packer.bytes(),
    });
    assert!(frame.len() > FRAME_OVERHEAD && frame.len() as u64 <= 6 * 2 * k, "{} for {k}", frame.len());
    assert_eq!(PROTOCOL, 6);
}
