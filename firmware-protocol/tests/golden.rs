//! The bytes of version 2 on the wire. Never edit them: a changed byte is a new version.

use crate::bench::{ONSET, frame, pack, stroke};
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::frame::{Decoder, FRAME_OVERHEAD, MAX_FRAME, PROTOCOL};
use firmware_protocol::limits::{OnTimeLimits, Refusal};
use firmware_protocol::message::{
    Cause, Counters, Cut, DeviceHello, DeviceMessage, HostMessage, LowerStop, Mark, MarkKind, Op, Report,
    State, Status, Trigger,
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
    amended: 6,
    amendments_ignored: 7,
    bad_frames: 8,
    reports_lost: 9,
};
const CUT: Cut = Cut {
    cause: Cause::HostTimeout,
    at: WireTick([1, 2, 3, 4]),
    returns: true,
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
    limits: OnTimeLimits::NONE,
    features: DeviceHello::SIMULATED | DeviceHello::TELEMETRY,
    tick: 0xffd9_1a30,
    epoch: 1,
    reports: 0,
    last_cut: Some(CUT),
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
    let limits = OnTimeLimits { motor: 20_000, rail: 90_000 };
    let arm = |lower_stop| Op::Arm { assume_rest: true, host_timeout: 25_500, limits, lower_stop };
    let control = |op| HostMessage::Control { epoch: 7, seen: 400, op };
    let coded = Mark { kind: MarkKind::Item, trigger: Some(Trigger { width: 85, code: 200 }) };
    let silent = Mark { kind: MarkKind::Play, trigger: None };
    let marked =
        |mark| HostMessage::Strokes { epoch: 7, seq: 1, seen: 1, mark: Some(mark), base, batch: &[] };
    let cases = [
        (HostMessage::Hello { session: 0xdead_beef }, "02020aeffdb6f50dc4bbd20200"),
        (HostMessage::Ping { token: 513, seen: 0 }, "050201810405ab77c58000"),
        (control(arm(None)), "0602020790030b019cc701a09c0190bf0505d1ad364d00"),
        (
            control(arm(Some(LowerStop { pulses_per_s: 17_000, seek: 7_400 }))),
            "06020207900315019cc701a09c0190bf0501e88401e8394a2d24d100",
        ),
        (control(Op::Seek { pulses: 7_400 }), "0d020207900306e83925fc01a300"),
        (control(Op::Disarm(Cause::Shutdown)), "0c020207900301034a8c0fca00"),
        (control(Op::Disarm(Cause::Abort)), "0c02020790030104e9196b5400"),
        (control(Op::Stop), "0b0202079003026ee12d2300"),
        (control(Op::EStop), "0b020207900303f8d12a5400"),
        (control(Op::Reset), "0b0202079003045b444eca00"),
        (
            control(Op::Move { motor: 5, direction: Direction::Down, pulses: 1_000 }),
            "0f0202079003050501e80774642f5c00",
        ),
        (
            HostMessage::Strokes {
                epoch: 7,
                seq: 0,
                seen: 1,
                mark: Some(ONSET),
                base,
                batch: strokes.bytes(),
            },
            "040203070301010401d206070df0edfe1340109301b104373bb1040604e58c06b8170601694d691c00",
        ),
        (marked(coded), "0f020307010101010155c80df0edfe05a67adac900"),
        (marked(silent), "0702030701010101050df0edfe058f166d5000"),
        (
            HostMessage::Strokes { epoch: 7, seq: 65_535, seen: 1, mark: None, base, batch: &[] },
            "08020307ffff0301050df0edfe0564be8ee400",
        ),
        (
            HostMessage::Amend { epoch: 7, generation: 1_000, base, items: items.bytes() },
            "18020407e8070df0edfe09099216970137218f012e23b23300",
        ),
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
    let status = |state, cause, refusal| DeviceMessage::Status(Status { state, cause, refusal, ..STATUS });
    let mut y = [0; MOTORS];
    (y[0], y[1], y[22], y[23]) = (1, -1, 8_000, i32::MIN);
    let cases = [
        (
            DeviceMessage::Hello(HELLO),
            "02020beffdb6f50d010203cafe19016318889805800840b817889805b0901f03b0b4e4fe0f010f01060102030401ac024d1e243fd700",
        ),
        (
            DeviceMessage::Hello(DeviceHello { last_cut: None, ..HELLO }),
            "02020beffdb6f50d010203cafe19016318889805800840b817889805b0901f03b0b4e4fe0f0101057733266800",
        ),
        (DeviceMessage::NoSession, "070201eb40e80400"),
        (
            DeviceMessage::Status(STATUS),
            "0602028104ff04fe7f020aac02058008050101010f01a6020304050607080999cee73600",
        ),
        (
            status(State::Disarmed, Cause::Boot, Some(Refusal::PositionUnknown)),
            "0602028104ff0cfe7f02010aac02058008050102010f01a602030405060708093359d11600",
        ),
        (
            status(State::Returning, Cause::LinkLost, Some(Refusal::State)),
            "0602028104ff0ffe7f02010bac02058008050207010f01a602030405060708095818161500",
        ),
        (
            status(State::Returning, Cause::NewHost, Some(Refusal::Travel)),
            "0602028104ff0ffe7f02010cac02058008050208010f01a60203040506070809354b815b00",
        ),
        (
            status(State::Faulted, Cause::EStop, None),
            "0602028104ff04fe7f020aac02058008050305010f01a60203040506070809a260301700",
        ),
        (
            status(State::Faulted, Cause::Starved, None),
            "0602028104ff04fe7f020aac02058008050309010f01a6020304050607080959d98a8d00",
        ),
        (
            status(State::Faulted, Cause::Output, None),
            "0602028104ff04fe7f020aac0205800805030c010f01a602030405060708094a6aa59000",
        ),
        (
            status(State::Faulted, Cause::Panic, Some(Refusal::Malformed)),
            "0602028104ff0ffe7f02010dac0205800805030a010f01a60203040506070809969c083900",
        ),
        (
            report(Report::Verdict {
                seq: 300,
                late: 1,
                refused: 1 << 63,
                reason: Some(Refusal::NotArmed),
                rendered,
            }),
            "050203c8010fac02018080808080808080800101094df0edfead9e618400",
        ),
        (report(Report::OnsetRefused { seq: 1, rendered }), "0f0203c80101014df0edfe2788954a00"),
        (
            report(Report::Onset { tick: rendered, counters: COUNTERS }),
            "140203c801024df0edfe01a602030405060708090478bd6b00",
        ),
        (report(Report::Cut(CUT)), "130203c80103060102030401ac024d143bb0f800"),
        (
            report(Report::Cut(Cut { cause: Cause::Stop, returns: false, ..CUT })),
            "0b0203c80103020102030408ac024d7d0de01d00",
        ),
        (refused(Refusal::Motor), "100203c80104110df0edfe018d8a580900"),
        (refused(Refusal::UpPulses), "100203c80104110df0edfe0237db519000"),
        (refused(Refusal::Bursts), "100203c80104110df0edfe03a1eb56e700"),
        (refused(Refusal::Unbalanced), "100203c80104110df0edfe04027e327900"),
        (refused(Refusal::Overlap), "100203c80104110df0edfe05944e350e00"),
        (refused(Refusal::TooFar), "100203c80104110df0edfe062e1f3c9700"),
        (refused(Refusal::PoolFull), "100203c80104110df0edfe07b82f3be000"),
        (refused(Refusal::MotorOnTime), "100203c80104110df0edfe082932847000"),
        (refused(Refusal::Pushing), "100203c80104110df0edfe0e1c97e79900"),
        (refused(Refusal::RailOnTime), "100203c80104110df0edfe09bf02830700"),
        (
            DeviceMessage::Telemetry { tick: rendered, y },
            "0902044df0edfe0201010101010101010101010101010101010101010c807dffffffff0f58e9393b00",
        ),
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
        amended: ALL,
        amendments_ignored: ALL,
        bad_frames: ALL,
        reports_lost: ALL,
    };
    let limits = OnTimeLimits { motor: u32::MAX, rail: u32::MAX };
    let tick = WireTick([0; 4]);
    let cut = Cut { cause: Cause::Panic, at: tick, returns: true, flushed: u16::MAX, outstanding: u32::MAX };
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
    ];
    let longest = device.iter().map(|message| frame(message).len()).max();
    assert!(longest.is_some_and(|longest| longest <= MAX_FRAME), "{longest:?}");

    let (epoch, seq, seen, generation) = (u16::MAX, u16::MAX, u16::MAX, u16::MAX);
    let list = [0xff; BATCH_BYTES];
    let trigger = Some(Trigger { width: u16::MAX, code: u8::MAX });
    let mark = Some(Mark { kind: MarkKind::Item, trigger });
    let strokes = HostMessage::Strokes { epoch, seq, seen, mark, base: tick, batch: &list };
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
        base,
        batch: packer.bytes(),
    });
    assert!(frame.len() > FRAME_OVERHEAD && frame.len() as u64 <= 6 * 2 * k, "{} for {k}", frame.len());
    assert_eq!(PROTOCOL, 2);
}
