//! The bytes of version 1 on the wire. Never edit them: a changed byte is a new version.

use crate::bench::{arm, frame, pack, stroke};
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer};
use firmware_protocol::frame::{Decoder, FRAME_OVERHEAD, MAX_FRAME, PROTOCOL};
use firmware_protocol::limits::{OnTimeLimits, Refusal};
use firmware_protocol::message::{
    Cause, Counters, Cut, DeviceHello, DeviceMessage, HostMessage, Op, Report, State, Status,
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
    let control = |op| HostMessage::Control { epoch: 7, seen: 400, op };
    let limits = OnTimeLimits { motor: 20_000, rail: 90_000 };
    let cases = [
        (HostMessage::Hello { session: 0xdead_beef }, "02010aeffdb6f50d59a13a3300"),
        (HostMessage::Ping { token: 513, seen: 0 }, "0501018104057b0d65c700"),
        (control(arm(true, 25_500, limits)), "0601020790030f019cc701a09c0190bf05b44d6ea200"),
        (control(Op::Disarm(Cause::Shutdown)), "0c01020790030103d796e7fb00"),
        (control(Op::Disarm(Cause::Abort)), "0c010207900301047403836500"),
        (control(Op::Stop), "0b010207900302c093b9a500"),
        (control(Op::EStop), "0b01020790030356a3bed200"),
        (control(Op::Reset), "0b010207900304f536da4c00"),
        (
            control(Op::Move { motor: 5, direction: Direction::Down, pulses: 1_000 }),
            "0f0102079003050501e80777df18b700",
        ),
        (
            HostMessage::Strokes { epoch: 7, seq: 0, seen: 1, onset: true, base, batch: strokes.bytes() },
            "040103070901010df0edfe1340109301b104373bb1040604e58c06b8170601cb0c61d000",
        ),
        (
            HostMessage::Strokes { epoch: 7, seq: 65_535, seen: 1, onset: false, base, batch: &[] },
            "08010307ffff0301050df0edfe05aad2445900",
        ),
        (
            HostMessage::Amend { epoch: 7, generation: 1_000, base, items: items.bytes() },
            "18010407e8070df0edfe09099216970137218f0187a5e49000",
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
            "02010beffdb6f50d010203cafe19016318889805800840b817889805b0901f03b0b4e4fe0f010f01060102030401ac024d7a11ed9100",
        ),
        (
            DeviceMessage::Hello(DeviceHello { last_cut: None, ..HELLO }),
            "02010beffdb6f50d010203cafe19016318889805800840b817889805b0901f03b0b4e4fe0f0101058c2fbdbb00",
        ),
        (DeviceMessage::NoSession, "0701012813c52f00"),
        (
            DeviceMessage::Status(STATUS),
            "0601028104ff04fe7f020aac02058008050101010f01a6020304050607080981eb467200",
        ),
        (
            status(State::Disarmed, Cause::Boot, Some(Refusal::PositionUnknown)),
            "0601028104ff0cfe7f02010aac02058008050102010f01a602030405060708094060f90500",
        ),
        (
            status(State::Returning, Cause::LinkLost, Some(Refusal::State)),
            "0601028104ff0ffe7f02010bac02058008050207010f01a602030405060708092b213e0600",
        ),
        (
            status(State::Returning, Cause::NewHost, Some(Refusal::Travel)),
            "0601028104ff0ffe7f02010cac02058008050208010f01a602030405060708094672a94800",
        ),
        (
            status(State::Faulted, Cause::EStop, None),
            "0601028104ff04fe7f020aac02058008050305010f01a60203040506070809ba45915300",
        ),
        (
            status(State::Faulted, Cause::Starved, None),
            "0601028104ff04fe7f020aac02058008050309010f01a6020304050607080941fc2bc900",
        ),
        (
            status(State::Faulted, Cause::Panic, Some(Refusal::Malformed)),
            "0601028104ff0ffe7f02010dac0205800805030a010f01a60203040506070809e5a5202a00",
        ),
        (
            report(Report::Verdict {
                seq: 300,
                late: 1,
                refused: 1 << 63,
                reason: Some(Refusal::NotArmed),
                rendered,
            }),
            "050103c8010fac02018080808080808080800101094df0edfe85377fdc00",
        ),
        (report(Report::OnsetRefused { seq: 1, rendered }), "0f0103c80101014df0edfe2433a2a100"),
        (
            report(Report::Onset { tick: rendered, counters: COUNTERS }),
            "180103c801024df0edfe01a60203040506070809a9feebc800",
        ),
        (report(Report::Cut(CUT)), "130103c80103060102030401ac024dcf1ed18400"),
        (
            report(Report::Cut(Cut { cause: Cause::Stop, returns: false, ..CUT })),
            "0b0103c80103020102030408ac024da628816100",
        ),
        (refused(Refusal::Motor), "100103c80104110df0edfe018cecba9000"),
        (refused(Refusal::UpPulses), "100103c80104110df0edfe0236bdb30900"),
        (refused(Refusal::Bursts), "100103c80104110df0edfe03a08db47e00"),
        (refused(Refusal::Unbalanced), "100103c80104110df0edfe040318d0e000"),
        (refused(Refusal::Overlap), "100103c80104110df0edfe059528d79700"),
        (refused(Refusal::TooFar), "100103c80104110df0edfe062f79de0e00"),
        (refused(Refusal::PoolFull), "100103c80104110df0edfe07b949d97900"),
        (refused(Refusal::MotorOnTime), "100103c80104110df0edfe08285466e900"),
        (refused(Refusal::RailOnTime), "100103c80104110df0edfe09be64619e00"),
        (
            DeviceMessage::Telemetry { tick: rendered, y },
            "0901044df0edfe0201010101010101010101010101010101010101010c807dffffffff0f41d7eab000",
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
    let strokes = HostMessage::Strokes { epoch, seq, seen, onset: true, base: tick, batch: &list };
    // The longest header and batch exactly fill a frame.
    assert_eq!(frame(&strokes).len(), MAX_FRAME);
    let amend = HostMessage::Amend { epoch, generation, base: tick, items: &list };
    assert!(frame(&amend).len() <= MAX_FRAME);
    let op = Op::Arm { assume_rest: true, host_timeout: u32::MAX, limits };
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
        onset: true,
        base,
        batch: packer.bytes(),
    });
    assert!(frame.len() > FRAME_OVERHEAD && frame.len() as u64 <= 6 * 2 * k, "{} for {k}", frame.len());
    assert_eq!(PROTOCOL, 1);
}
