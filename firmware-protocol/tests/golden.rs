//! The bytes of version 7 on the wire; `golden.py` makes them by hand. Once version 7 is released, never edit them: a changed byte is
//! a new version.

use crate::bench::{MOTORS, NO_LIMITS, ONSET, PAPER, frame, pack, stroke, to};
use firmware_protocol::array::{ArrayId, MotorSet, Name};
use firmware_protocol::batch::{Amendment, BATCH_BYTES, MAX_BATCH, Packer};
use firmware_protocol::board::{
    Board, Counts, LineTest, Output, Outputs, RamTest, Reset, SelfTest, SelfTestState, WaveTest,
};
use firmware_protocol::frame::{Decoder, FRAME_OVERHEAD, MAX_FRAME, PROTOCOL};
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{
    Cause, Counters, Cut, DeviceHello, DeviceMessage, HostMessage, LowerStop, MAX_SAMPLES, Mark, MarkKind,
    Op, Report, Samples, State, Status, Trigger, Withdraw,
};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
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
    shortened: 11,
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
    array: ArrayId { duty_up: 200, duty_down: 800, hash: 0x0123_4567_89ab_cdef, ..*PAPER.id() },
    pool: 1024,
    horizon: 107,
    max_up_pulses: 3000,
    limits: NO_LIMITS,
    features: DeviceHello::SIMULATED | DeviceHello::TELEMETRY,
    tick: 0xffd9_1a30,
    epoch: 1,
    reports: 0,
    last_cut: Some(CUT),
};

const fn lines(lines: u64) -> Outputs {
    Outputs { lines: MotorSet::from_bits(lines), trigger: false, enable: false }
}

const BOARD: Board = Board {
    window: 300,
    reset: Reset::Watchdog,
    uptime_s: 86_400,
    slack: Some(26),
    slack_since_boot: Some(25),
    counts: Counts { stalls: Some(1), usb_recoveries: Some(2), output_faults: 3 },
    high_at_boot: Some(Outputs { enable: true, ..lines(1 << 23) }),
};
const TESTED: SelfTest = SelfTest {
    lines: Some(LineTest {
        stuck_high: lines(1),
        stuck_low: lines(2),
        shorted: Outputs { trigger: true, enable: true, ..lines(12) },
        pair: Some((Output::Line(2), Output::Trigger)),
    }),
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
            stroke(23, BASE + 59, 147, 561, 147),
            stroke(23, BASE + 1_600, 147, 561, 150),
            stroke(63, BASE + 100_000, 3_000, 0, 3_000),
        ],
    );
    let mut single = Packer::<BATCH_BYTES>::new(Tick(BASE));
    for to in [
        to(0, BASE, 1),
        to(23, BASE, 64),
        to(0, BASE + 85, 3_000),
        Move { surplus: 900, ..to(63, BASE + 200_000, 0) },
    ] {
        single.moves(&to).unwrap();
    }
    let mut rows = Packer::<BATCH_BYTES>::new(Tick(BASE));
    let three = MotorSet::from_bits(1 << 63 | 0x0080_0001);
    let levels: Vec<u16> = (0..24).collect();
    rows.row(Tick(BASE + 170), three, &[0, 300, 3_000]).unwrap();
    rows.row(Tick(BASE + 340), three, &[127, 128, 0]).unwrap();
    rows.stroke(&stroke(1, BASE + 341, 147, 0, 147)).unwrap();
    rows.row(Tick(BASE + 510), MotorSet::from_bits(1), &[1]).unwrap();
    rows.moves(&Move { surplus: 1, ..to(0, BASE + 600, 0) }).unwrap();
    rows.stroke(&stroke(2, BASE + 600, 147, 0, 147)).unwrap();
    rows.row(Tick(BASE + 680), MotorSet::from_bits(1), &[2]).unwrap();
    rows.row(Tick(BASE + 850), MotorSet::first(24), &levels).unwrap();
    let mut items = Packer::<BATCH_BYTES>::new(Tick(BASE));
    for (motor, tick, pulses) in [(9, BASE + 1_417, 151), (63, BASE + 1_400, 143)] {
        items.amendment(&Amendment { motor, tick: Tick(tick), pulses }).unwrap();
    }
    let base = Tick(BASE).wire();
    let limits = PowerLimits { motor: 20_000, rail: 90_000, rail_at_once: 3, chip_at_once: 1 };
    let arm = |lower_stop| Op::Arm { assume_rest: true, host_timeout: 25_500, limits, lower_stop };
    let control = |op| HostMessage::Control { epoch: 7, seen: 400, op };
    let coded = Mark { kind: MarkKind::Item, trigger: Some(Trigger { width: 85, code: 200 }), hold: 0 };
    let silent = Mark { kind: MarkKind::Play, trigger: None, hold: 17_000 };
    let marked = |mark| HostMessage::Moves {
        epoch: 7,
        seq: 1,
        seen: 1,
        mark: Some(mark),
        withdraw: None,
        base,
        batch: &[],
    };
    fn packed(base: WireTick, batch: &Packer<BATCH_BYTES>) -> HostMessage<'_> {
        let batch = batch.bytes();
        HostMessage::Moves { epoch: 7, seq: 0, seen: 1, mark: None, withdraw: None, base, batch }
    }
    let cases = [
        (HostMessage::Hello { session: 0xdead_beef }, "02070aeffdb6f50d6394ea5000"),
        (HostMessage::Ping { token: 513, seen: 0 }, "050701810405dbf8254800"),
        (control(arm(None)), "0607020790030d019cc701a09c0190bf0503010560764a5400"),
        (
            control(arm(Some(LowerStop { pulses_per_s: 17_000, seek: 7_400 }))),
            "06070207900317019cc701a09c0190bf05030101e88401e8395a0a3dcb00",
        ),
        (control(Op::Seek { pulses: 7_400 }), "0d070207900306e83941f2e1eb00"),
        (control(Op::Disarm(Cause::Shutdown)), "0c07020790030103eda3379800"),
        (control(Op::Disarm(Cause::Abort)), "0c070207900301044e36530600"),
        (control(Op::Stop), "0b070207900302dd70e07300"),
        (control(Op::EStop), "0b0702079003034b40e70400"),
        (control(Op::Reset), "0b070207900304e8d5839a00"),
        (
            control(Op::Move { motor: 5, direction: Direction::Down, pulses: 1_000 }),
            "0f0702079003050501e80730af06ba00",
        ),
        (
            HostMessage::Moves {
                epoch: 7,
                seq: 0,
                seen: 1,
                mark: Some(ONSET),
                withdraw: None,
                base,
                batch: strokes.bytes(),
            },
            "040703070301010401d20605e0a3b702070df0edfe194017a602b104973bb10457850ca70203b1047fe08006f02e05bdb1d94200",
        ),
        (packed(base, &single), "04070307020101060df0edfe12010302170380010f55f02e3feb990c018407db490bdd00"),
        (
            packed(base, &rows),
            "04070307020101130df0edfe4cc1aa01818080848080808080010bac02b817c0aa017f8001054101a60206c1a9010101055a010182010bc05002c1aa01ffffff071c0102030405060708090a0b0c0d0e0f10111213141516179a22332c00",
        ),
        (marked(coded), "0b070307010101010155c801050df0edfe0511f3b16a00"),
        (marked(silent), "070703070101010104e88401050df0edfe0533bc932500"),
        (
            HostMessage::Moves {
                epoch: 7,
                seq: 2,
                seen: 1,
                mark: None,
                withdraw: Some(Withdraw {
                    motors: MotorSet::from_bits(1 << 63 | 0x0080_0001),
                    generation: 300,
                }),
                base,
                batch: &[],
            },
            "060703070201120181808084808080808001ac020df0edfe0592381d3900",
        ),
        (
            HostMessage::Moves {
                epoch: 7,
                seq: 65_535,
                seen: 1,
                mark: None,
                withdraw: None,
                base,
                batch: &[],
            },
            "08070307ffff030101050df0edfe0575738c2600",
        ),
        (
            HostMessage::Amend { epoch: 7, generation: 1_000, base, items: items.bytes() },
            "18070407e8070df0edfe0909921697013f218f017b868cc800",
        ),
        (HostMessage::Board { window: 300 }, "090705ac0287b7e45600"),
        (HostMessage::SelfTest { run: 65_535 }, "0a0706ffff03f4ecdce500"),
    ];
    for (message, hex) in cases {
        golden(&message, hex, &mut Vec::new());
    }
}

#[test]
fn from_the_device() {
    let report = |report| DeviceMessage::Report { number: 200, report };
    let rendered = Tick(BASE + 64).wire();
    let refused = |reason| report(Report::Refused { motor: 17, tick: Tick(BASE).wire(), reason });
    let test = |state| DeviceMessage::SelfTest { run: 300, state };
    let status = |state, cause, refusal| DeviceMessage::Status(Status { state, cause, refusal, ..STATUS });
    let mut y = [0; MOTORS];
    (y[0], y[1], y[22], y[23]) = (1, -1, 8_000, i32::MIN);
    let cases = [
        (
            DeviceMessage::Hello(HELLO),
            "02070beffdb6f50d010203cafe3301630a74756c6133352d36783418889805c801a006ef9bafcdf8acd1910180086bb817889805b0901f060203b0b4e4fe0f011101060102030401b009ac024d8ef84c7a00",
        ),
        (
            DeviceMessage::Hello(DeviceHello { last_cut: None, ..HELLO }),
            "02070beffdb6f50d010203cafe3301630a74756c6133352d36783418889805c801a006ef9bafcdf8acd1910180086bb817889805b0901f060203b0b4e4fe0f0101022303759900",
        ),
        (DeviceMessage::NoSession, "070701aeb49f7900"),
        (
            DeviceMessage::Status(STATUS),
            "0607028104ff04fe7f020aac02058008050101011101a6020304050a060b070809ffbc5afe00",
        ),
        (
            status(State::Disarmed, Cause::Boot, Some(Refusal::PositionUnknown)),
            "0607028104ff0cfe7f020108ac02058008050102011101a6020304050a060b0708091bd1274400",
        ),
        (
            status(State::Returning, Cause::LinkLost, Some(Refusal::State)),
            "0607028104ff0ffe7f020109ac02058008050207011101a6020304050a060b070809b611f5c300",
        ),
        (
            status(State::Returning, Cause::NewHost, Some(Refusal::Travel)),
            "0607028104ff0ffe7f02010aac02058008050208011101a6020304050a060b07080916eb98e100",
        ),
        (
            status(State::Faulted, Cause::EStop, None),
            "0607028104ff04fe7f020aac02058008050305011101a6020304050a060b070809fffc86f300",
        ),
        (
            status(State::Faulted, Cause::Starved, None),
            "0607028104ff04fe7f020aac02058008050309011101a6020304050a060b0708091b5573b600",
        ),
        (
            status(State::Faulted, Cause::Output, None),
            "0607028104ff04fe7f020aac0205800805030c011101a6020304050a060b07080990ebf48500",
        ),
        (
            status(State::Faulted, Cause::Panic, Some(Refusal::Malformed)),
            "0607028104ff0ffe7f02010bac0205800805030a011101a6020304050a060b070809c221057c00",
        ),
        (
            report(Report::Verdict {
                kept: MotorSet::from_bits(1 << 63 | 0x0080_0001),
                seq: 300,
                late: 1,
                refused: 1 << 63,
                reason: Some(Refusal::NotArmed),
                rendered,
            }),
            "050703c80119ac0201808080808080808080018180808480808080800101094df0edfe988969bf00",
        ),
        (report(Report::OnsetRefused { seq: 1, rendered }), "0f0703c80101014df0edfe6343bcac00"),
        (
            report(Report::Onset { tick: rendered, counters: COUNTERS }),
            "1a0703c801024df0edfe01a6020304050a060b070809ea5ea87100",
        ),
        (report(Report::Cut(CUT)), "150703c80103060102030401b009ac024d92114f4400"),
        (
            report(Report::Cut(Cut { cause: Cause::Stop, return_ticks: None, ..CUT })),
            "0b0703c80103020102030408ac024d1063439900",
        ),
        (
            report(Report::Lowered {
                tick: rendered,
                late: MotorSet::from_bits(1 << 63 | 0x0080_0001),
                held: MotorSet::from_bits(6),
            }),
            "190703c801054df0edfe8180808480808080800106a27d759200",
        ),
        (report(Report::Edge { tick: rendered, number: 300 }), "100703c801064df0edfeac028197ef8900"),
        (refused(Refusal::Motor), "100703c80104110df0edfe01cf260f7800"),
        (refused(Refusal::Level), "100703c80104110df0edfe02757706e100"),
        (refused(Refusal::Surplus), "100703c80104110df0edfe03e347019600"),
        (refused(Refusal::TooFar), "100703c80104110df0edfe0440d2650800"),
        (refused(Refusal::PoolFull), "100703c80104110df0edfe05d6e2627f00"),
        (refused(Refusal::MotorOnTime), "100703c80104110df0edfe066cb36be600"),
        (refused(Refusal::RailOnTime), "100703c80104110df0edfe07fa836c9100"),
        (refused(Refusal::Pushing), "100703c80104110df0edfe0c725abe0600"),
        (refused(Refusal::RailAtOnce), "100703c80104110df0edfe0de46ab97100"),
        (refused(Refusal::ChipAtOnce), "100703c80104110df0edfe0e5e3bb0e800"),
        (refused(Refusal::Dense), "100703c80104110df0edfe0fc80bb79f00"),
        (
            DeviceMessage::Telemetry { tick: rendered, first: 0, y: Samples::of(&y) },
            "0707044df0edfe04180201010101010101010101010101010101010101010c807dffffffff0f36b8460400",
        ),
        (
            DeviceMessage::Telemetry { tick: rendered, first: 32, y: Samples::of(&[-5; MAX_SAMPLES]) },
            "2d07044df0edfe20200909090909090909090909090909090909090909090909090909090909090909455dd3fd00",
        ),
        (DeviceMessage::Board(BOARD), "170705ac020480a305011a0119010101020301808080040601c0e5255400"),
        (
            DeviceMessage::Board(Board {
                reset: Reset::Program,
                slack: None,
                slack_since_boot: None,
                counts: Counts { output_faults: 3, ..Counts::NONE },
                high_at_boot: None,
                ..BOARD
            }),
            "090705ac020680a3050101010203054fcc55ba00",
        ),
        (test(SelfTestState::Refused), "050706ac020557b23db300"),
        (test(SelfTestState::Running), "0a0706ac0201c1823ac400"),
        (test(SelfTestState::Ended), "0a0706ac02027bd3335d00"),
        (
            test(SelfTestState::Done(TESTED)),
            "080706ac0203010101020201050c0101011d020101a08d06b442d08902018080040180808c8002019e015b3409d800",
        ),
        (test(SelfTestState::Done(SelfTest::default())), "060706ac020301010105211264ce00"),
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
        shortened: ALL,
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
    let array = ArrayId {
        name: Name::new("a-name-of-32-characters--longest").unwrap(),
        motors: u8::MAX,
        tick_hz: u32::MAX,
        duty_up: u16::MAX,
        duty_down: u16::MAX,
        hash: ALL,
    };
    assert_eq!(array.name.as_str().len(), 32);
    let every = Outputs { trigger: true, enable: true, ..lines(ALL) };
    let tested = SelfTest {
        lines: Some(LineTest {
            stuck_high: every,
            stuck_low: every,
            shorted: every,
            pair: Some((Output::Line(u8::MAX), Output::Line(u8::MAX))),
        }),
        wave: Some(WaveTest { timer_us: u32::MAX, ticks: u32::MAX, words: u32::MAX }),
        ram: Some(RamTest { bytes: u32::MAX, bad: Some(u32::MAX) }),
        work_us: Some(u32::MAX),
    };
    let hello = DeviceHello {
        session: u32::MAX,
        boot: u32::MAX,
        array,
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
            kept: MotorSet::from_bits(ALL),
            seq: u16::MAX,
            late: ALL,
            refused: ALL,
            reason: Some(reason),
            rendered: tick,
        }),
        report(Report::OnsetRefused { seq: u16::MAX, rendered: tick }),
        report(Report::Onset { tick, counters }),
        report(Report::Cut(cut)),
        report(Report::Refused { motor: u8::MAX, tick, reason }),
        report(Report::Lowered { tick, late: MotorSet::from_bits(ALL), held: MotorSet::from_bits(ALL) }),
        report(Report::Edge { tick, number: u32::MAX }),
        DeviceMessage::Telemetry { tick, first: u8::MAX, y: Samples::of(&[i32::MIN; MAX_SAMPLES]) },
        DeviceMessage::Board(Board {
            window: u16::MAX,
            uptime_s: u32::MAX,
            counts: Counts { output_faults: u32::MAX, ..BOARD.counts },
            high_at_boot: Some(every),
            ..BOARD
        }),
        DeviceMessage::SelfTest { run: u16::MAX, state: SelfTestState::Done(tested) },
    ];
    let longest = device.iter().map(|message| frame(message).len()).max();
    assert!(longest.is_some_and(|longest| longest <= MAX_FRAME), "{longest:?}");

    let (epoch, seq, seen, generation) = (u16::MAX, u16::MAX, u16::MAX, u16::MAX);
    let list = [0xff; BATCH_BYTES];
    let trigger = Some(Trigger { width: u16::MAX, code: u8::MAX });
    let mark = Some(Mark { kind: MarkKind::Item, trigger, hold: u32::MAX });
    let withdraw = Some(Withdraw { motors: MotorSet::from_bits(ALL), generation });
    let moves = HostMessage::Moves { epoch, seq, seen, mark, withdraw, base: tick, batch: &list };
    // The longest header and batch exactly fill a frame.
    assert_eq!(frame(&moves).len(), MAX_FRAME);
    let amend = HostMessage::Amend { epoch, generation, base: tick, items: &list };
    assert!(frame(&amend).len() <= MAX_FRAME);
    let lower_stop = Some(LowerStop { pulses_per_s: u32::MAX, seek: u16::MAX });
    let op = Op::Arm { assume_rest: true, host_timeout: u32::MAX, limits, lower_stop };
    assert!(frame(&HostMessage::Control { epoch, seen, op }).len() <= MAX_FRAME);
}

/// Bytes of a frame with these items and the mark of a play.
fn length(batch: &Packer<BATCH_BYTES>) -> usize {
    let (epoch, seq, seen, base) = (u16::MAX, u16::MAX, u16::MAX, batch.base().wire());
    let (mark, batch) = (Some(ONSET), batch.bytes());
    frame(&HostMessage::Moves { epoch, seq, seen, mark, withdraw: None, base, batch }).len()
}

#[test]
fn a_steady_play_takes_less_than_three_bytes_per_move() {
    // 24 motors at 60 Hz and 147 pulses, as many strokes in the frame as fit.
    let mut packer = Packer::<BATCH_BYTES>::new(Tick(BASE));
    let mut k = 0;
    while packer.stroke(&stroke((k % 24) as u8, BASE + 59 * k, 147, 561, 147)).is_ok() {
        k += 1;
    }
    assert_eq!((packer.count(), k), (MAX_BATCH, MAX_BATCH as u64 / 2));
    let strokes = length(&packer);
    assert!(strokes > FRAME_OVERHEAD && strokes <= 3 * MAX_BATCH, "{strokes}");
    // Waveforms of 24 motors on a grid of 500 Hz.
    let mut packer = Packer::<BATCH_BYTES>::new(Tick(BASE));
    let mut k = 0;
    let levels: Vec<u16> = (0..24).map(|motor| 1_000 + 80 * motor).collect();
    while packer.row(Tick(BASE + 170 * k), MotorSet::first(24), &levels).is_ok() {
        k += 1;
    }
    assert_eq!(packer.count(), 48);
    assert!(length(&packer) <= 3 * 48, "{}", length(&packer));
    assert_eq!(PROTOCOL, 7);
}
