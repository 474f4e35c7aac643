//! The session against the controller over a line that loses frames: every stroke gets one verdict.

use firmware_protocol::controller::{BLOCK, Controller, HORIZON, Identity, newer};
use firmware_protocol::frame::{self, Decoder, MAX_FRAME, encode};
use firmware_protocol::message::{Cause, Counters, DeviceMessage, HostMessage, Op as Command, State};
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::{Step, Stroke};
use meissner_stream::link::{BadFrames, Contradiction, Event, LineRate, Session, Verdict};
use meissner_stream::time::HostInstant;
use proptest::prelude::*;
use std::collections::VecDeque;

#[derive(Clone, Debug)]
enum Op {
    /// `.0` strokes, the first `.1` ticks from now; a negative number makes them late.
    Push(u8, i16),
    Begin(i16),
    Seal,
    Command(u8),
    /// Bytes that the device did not send.
    Noise(Vec<u8>),
    /// Frames in both directions; those whose bit is set are lost.
    Exchange(u32, u32),
    Wait(u16),
}

fn op() -> impl Strategy<Value = Op> {
    prop_oneof![
        4 => (1u8..40, -200i16..5000).prop_map(|(count, ahead)| Op::Push(count, ahead)),
        1 => (-200i16..5000).prop_map(Op::Begin),
        2 => Just(Op::Seal),
        1 => (0u8..5).prop_map(Op::Command),
        1 => prop::collection::vec(any::<u8>(), 0..300).prop_map(Op::Noise),
        6 => (any::<u32>(), any::<u32>()).prop_map(|(out, back)| Op::Exchange(out & out >> 3, back & back >> 3)),
        4 => (1u16..4000).prop_map(Op::Wait),
    ]
}

/// A session and a controller, and a line between them that loses frames.
#[derive(Clone)]
struct Pair {
    session: Session,
    device: Controller,
    ticks: u64,
    events: Vec<Event>,
}

impl Pair {
    fn new() -> Self {
        let array = Array::paper();
        let session = Session::new(array, 7, LineRate(100_000), HostInstant::from_ns(0));
        let device = Controller::new(Identity::default(), *array.layout());
        Self { session, device, ticks: 0, events: Vec::new() }
    }

    /// After the handshake, and some exchanges without a loss.
    fn open() -> Self {
        let mut pair = Self::new();
        for _ in 0..40 {
            pair.exchange(0, 0);
            pair.wait(170);
        }
        pair
    }

    fn now(&self) -> HostInstant {
        HostInstant::from_ns(self.ticks * 1_000_000_000 / 85_000)
    }

    fn wait(&mut self, ticks: u64) {
        self.ticks += ticks;
        let now = Tick::BOOT + self.ticks;
        while self.device.rendered() < now + 32 {
            let left = now + 32 - self.device.rendered();
            let _ = self.device.render(left.min(32) as u32);
        }
        self.device.poll(now);
    }

    /// The device is asked for a status and says what it has to; of that the first `most` messages arrive, changed so.
    fn hear(&mut self, most: usize, change: impl Fn(&mut DeviceMessage)) {
        let (now, tick, mut frame) = (self.now(), Tick::BOOT + self.ticks, [0; MAX_FRAME]);
        let len = encode(&HostMessage::Ping { token: u16::MAX, seen: 0 }, &mut frame).unwrap();
        self.device.receive(tick, &frame[..len]);
        for at in 0.. {
            let len = self.device.transmit(tick, &mut frame);
            if len == 0 {
                break;
            }
            if at < most {
                let (mut decoder, mut bytes) = (Decoder::new(), &frame[..len]);
                let mut message = frame::read(decoder.next(&mut bytes).unwrap()).unwrap();
                change(&mut message);
                let len = encode(&message, &mut frame).unwrap();
                self.session.receive(now, &frame[..len], &mut |event| self.events.push(event));
            }
        }
    }

    fn doubts(&self) -> usize {
        let doubted = |event: &&Event| matches!(event, Event::Contradiction(_) | Event::Lost(_));
        self.events.iter().filter(doubted).count()
    }

    fn exchange(&mut self, lost_out: u32, lost_back: u32) {
        let (now, tick) = (self.now(), Tick::BOOT + self.ticks);
        let mut frame = [0; MAX_FRAME];
        let events = &mut self.events;
        for i in 0..64 {
            let len = self.session.transmit(now, &mut frame, &mut |event| events.push(event));
            assert!(len <= MAX_FRAME);
            if len == 0 {
                break;
            }
            if lost_out >> (i % 32) & 1 == 0 {
                self.device.receive(tick, &frame[..len]);
            }
        }
        for i in 0..64 {
            let len = self.device.transmit(tick, &mut frame);
            if len == 0 {
                break;
            }
            if lost_back >> (i % 32) & 1 == 0 {
                self.session.receive(now, &frame[..len], &mut |event| events.push(event));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    /// With any strokes, losses, commands and forged bytes: each stroke gets one verdict, in the order of pushing; after a
    /// command only those that the device did not accept. A late stroke begins before the device's first free tick.
    #[test]
    fn each_stroke_has_one_verdict(ops in prop::collection::vec(op(), 1..80)) {
        run(ops)?;
    }
}

/// The last report of one epoch comes when the frames of the next have no verdict: it is not about them.
#[test]
fn a_report_of_the_epoch_before_the_last_is_not_taken_for_the_last_ones() {
    let ops = vec![
        Op::Exchange(10_772_524, 109_068_288),
        Op::Push(1, 0),
        Op::Push(32, 0),
        Op::Wait(1),
        Op::Exchange(1168, 419_430_418),
        Op::Command(3),
        Op::Exchange(18_688, 103_228_544),
        Op::Push(33, 0),
        Op::Command(0),
    ];
    run(ops).unwrap();
}

/// The device hears a hello and its answer is lost: what it reports until it answers the next one is true.
#[test]
fn reports_from_within_a_handshake_contradict_nothing() {
    for lost in 1..10 {
        let mut pair = Pair::new();
        for _ in 0..lost {
            pair.exchange(0, u32::MAX);
            pair.wait(850);
            pair.device.fault(Tick::BOOT + pair.ticks, Cause::Starved);
        }
        for _ in 0..40 {
            pair.exchange(0, 0);
            pair.wait(170);
        }
        let told = |event: &Event| matches!(event, Event::Cut { cut, .. } if cut.cause == Cause::Starved);
        assert_eq!(pair.events.iter().filter(|event| told(event)).count(), 1, "{:?}", pair.events);
        assert_eq!(pair.doubts(), 0, "{lost} lost: {:?}", pair.events);
    }
}

/// Armed, a stroke of every motor queued, and the tick of the mark before them.
fn about_to_play() -> (Pair, u64) {
    let mut pair = Pair::open();
    pair.session.command(arm());
    pair.exchange(0, 0);
    pair.wait(170);
    pair.exchange(0, 0);
    let begin = pair.ticks + 2000;
    pair.session.begin(Tick::BOOT + begin, None, u32::MAX);
    for motor in 0..24 {
        let up = Tick::BOOT + begin + 12 * u64::from(motor);
        let stroke = Stroke { motor, up, up_pulses: 200, down: up + 300, down_pulses: 200 };
        assert!(pair.session.push(&stroke.into()));
    }
    pair.session.seal();
    while pair.ticks < begin - 2 {
        pair.exchange(0, 0);
        pair.wait((begin - 2 - pair.ticks).min(100));
    }
    pair.exchange(0, 0);
    (pair, begin)
}

/// The outputs fail at a tick and the device finds that so many ticks later. In between it says once what it counts.
fn fail(pair: &mut Pair, at: u64, found: u64, told: u64, most: usize) {
    pair.wait(at + told - pair.ticks);
    pair.hear(most, |_| {});
    pair.wait(found - told);
    pair.device.output_failed(Tick::BOOT + at);
}

/// What the device has said since its outputs failed counts more than what it says when it has found that; and the report of a mark may
/// come before that or after.
#[test]
fn a_device_that_takes_its_counts_back_when_its_outputs_fail_is_true() {
    let (ready, begin) = about_to_play();
    let (mut shrunk, mut early, mut late) = (0, 0, 0);
    for at in (begin - 1..begin + 20).chain([begin + 250]) {
        for found in [1, u64::from(BLOCK), u64::from(BLOCK) + 2] {
            for (told, most, then) in (0..=found).flat_map(|told| {
                [(64, 64), (1, 64), (64, 1), (1, 1), (0, 1)].map(|(most, then)| (told, most, then))
            }) {
                let mut pair = ready.clone();
                pair.events.clear();
                fail(&mut pair, at, found, told, most);
                let onset = |event: &Event| matches!(event, Event::Onset { .. });
                let is_early = pair.events.iter().any(onset);
                pair.hear(then, |_| {});
                for _ in 0..20 {
                    pair.wait(900);
                    pair.exchange(0, 0);
                }
                let case = format!("{at} after {begin}, + {found}, told {told}, {most}, {then}");
                assert_eq!(pair.doubts(), 0, "{case}: {:?}", pair.events);
                let counts = pair.events.iter().filter_map(|event| match event {
                    Event::Status { status, .. } => Some(status.counters),
                    _ => None,
                });
                let counts: Vec<_> = counts.collect();
                shrunk += usize::from(counts.windows(2).any(|of| of[1].pulses < of[0].pulses));
                early += usize::from(is_early);
                late += usize::from(!is_early && pair.events.iter().any(onset));
            }
        }
    }
    assert!(shrunk > 100 && early > 100 && late > 100, "{shrunk} {early} {late}");
}

/// Counts shrink for no other cause, in nothing else, and not by more than is played in the horizon.
#[test]
fn a_device_whose_counts_shrink_otherwise_is_doubted() {
    type Lie = fn(&mut Counters);
    let lies: [(&str, Lie); 5] = [
        ("nothing", |_| {}),
        ("too many pulses", |of| of.pulses -= 24 * u64::from(HORIZON)),
        ("none dropped", |of| of.dropped = 0),
        ("bad frames", |of| of.bad_frames -= 1),
        ("jump", |of| of.pulses += 1 << 40),
    ];
    let (ready, begin) = about_to_play();
    for cause in [Cause::Output, Cause::Panic] {
        for (name, lie) in lies {
            let mut pair = ready.clone();
            pair.device.receive(Tick::BOOT + pair.ticks, &[9, 1, 0]);
            fail(&mut pair, begin + 250, 16, 12, 64);
            pair.events.clear();
            pair.hear(1, |message| {
                let DeviceMessage::Status(status) = message else { return };
                (status.cause, status.position_known) = (cause, cause != Cause::Output);
                lie(&mut status.counters);
            });
            let is_true = (cause, name) == (Cause::Output, "nothing");
            let counters = Event::Contradiction(Contradiction::Counters);
            assert_eq!(pair.events.contains(&counters), !is_true, "{cause:?}, {name}: {:?}", pair.events);
        }
    }
}

/// The line takes no bytes, and the e-stop goes ahead of them: the device answers a command whose frame has not left.
#[test]
fn an_e_stop_ahead_of_its_frame_is_answered() {
    let mut pair = Pair::open();
    pair.session.command(Command::EStop);
    let epoch = pair.session.take_e_stop().unwrap();
    let (now, tick) = (pair.now(), Tick::BOOT + pair.ticks);
    pair.device.e_stop(tick, epoch);
    let mut frame = [0; MAX_FRAME];
    let len = pair.device.transmit(tick, &mut frame);
    pair.events.clear();
    let events = &mut pair.events;
    pair.session.receive(now, &frame[..len], &mut |event| events.push(event));
    assert!(events.contains(&Event::Control(Ok(()))), "{events:?}");
    assert!(!events.iter().any(|event| matches!(event, Event::Contradiction(_))), "{events:?}");
}

fn arm() -> Command {
    let limits = Array::paper().layout().no_limits();
    Command::Arm { assume_rest: true, host_timeout: 850_000, limits, lower_stop: None }
}

fn run(ops: Vec<Op>) -> Result<(), TestCaseError> {
    let mut pair = Pair::open();
    prop_assert!(pair.session.is_open());
    pair.session.command(arm());
    let (mut waiting, mut forgotten) = (VecDeque::new(), Vec::new());
    let (mut last, mut judged) = (Tick(0), 0u64);
    for op in
        ops.into_iter().chain([Op::Seal]).chain((0..60).flat_map(|_| [Op::Exchange(0, 0), Op::Wait(900)]))
    {
        let tick = Tick::BOOT + pair.ticks;
        let at = |ahead: i16| Tick(tick.0.saturating_add_signed(ahead.into()));
        match op {
            Op::Push(count, ahead) => {
                for i in 0..u64::from(count) {
                    let up = last.max(at(ahead) + 5 * i);
                    let motor = (i % 24) as u8;
                    let stroke = Stroke { motor, up, up_pulses: 9, down: up + 20, down_pulses: 9 };
                    if !pair.session.push(&stroke.into()) {
                        break;
                    }
                    last = up;
                    waiting.push_back(stroke);
                }
            }
            Op::Begin(ahead) if pair.session.has_room() => {
                last = last.max(at(ahead));
                pair.session.begin(last, None, u32::MAX);
            }
            Op::Begin(_) => {}
            Op::Seal => pair.session.seal(),
            Op::Command(which) => {
                pair.session.command(match which {
                    0 => Command::Stop,
                    1 => Command::Disarm(Cause::Request),
                    2 => Command::EStop,
                    3 => Command::Reset,
                    _ => arm(),
                });
                forgotten.extend(waiting.drain(..));
                // No later stroke is the same as one of these.
                last = last + 1;
            }
            Op::Noise(bytes) => {
                let (now, events) = (pair.now(), &mut pair.events);
                pair.session.receive(now, &bytes, &mut |event| events.push(event));
                pair.session.receive(now, &[0], &mut |event| events.push(event));
            }
            Op::Exchange(out, back) => pair.exchange(out, back),
            Op::Wait(ticks) => pair.wait(ticks.into()),
        }
        for event in pair.events.drain(..) {
            match event {
                Event::Step(Step::Stroke(stroke), verdict) => {
                    if let Some(at) = forgotten.iter().position(|&before| before == stroke) {
                        forgotten.swap_remove(at);
                        prop_assert_ne!(verdict, Verdict::Accepted);
                    } else {
                        prop_assert_eq!(waiting.pop_front(), Some(stroke));
                    }
                    judged += 1;
                    if let Verdict::Late { rendered, .. } = verdict {
                        prop_assert!(stroke.up < rendered);
                    }
                }
                // The device refused the whole first frame; this host gives it up.
                Event::OnsetRefused { .. } => {
                    let frame = waiting.iter().take_while(|stroke| stroke.up < last + 1).count();
                    prop_assert!(frame <= waiting.len());
                    forgotten.extend(waiting.drain(..));
                    last = last + 1;
                    pair.session.command(Command::Stop);
                }
                Event::Lost(reason) => prop_assert!(false, "{reason:?}"),
                Event::Contradiction(how) => prop_assert!(false, "a true device was doubted: {how:?}"),
                _ => {}
            }
        }
    }
    prop_assert_eq!(waiting.len(), 0, "{} judged", judged);
    Ok(())
}

#[test]
fn frames_that_cannot_be_read_are_counted_by_kind() {
    let mut frame = [0; MAX_FRAME];
    let len = encode(&(DeviceMessage::NoSession, 7u8), &mut frame).unwrap();
    let with_a_byte_more = frame[..len].to_vec();
    let mut damaged = with_a_byte_more.clone();
    // The payload 7 becomes 6. (The tag before it would become 0, which ends a frame.)
    damaged[3] ^= 1;
    let not_cobs = [9, 1, 0];
    let endless = [[1; MAX_FRAME].as_slice(), &[0]].concat();

    let now = HostInstant::from_ns(0);
    let mut session = Session::new(Array::paper(), 7, LineRate(100_000), now);
    let frames = [
        &endless,
        &not_cobs[..],
        &damaged,
        &damaged,
        &with_a_byte_more,
        &with_a_byte_more,
        &with_a_byte_more,
    ];
    for frame in frames {
        session.receive(now, frame, &mut |event| panic!("{event:?}"));
    }
    let counted = BadFrames { too_long: 1, malformed: 1, crc: 2, unknown: 3 };
    assert_eq!(session.traffic().bad, counted);
}

#[test]
fn each_e_stop_to_a_device_that_is_not_trusted_goes_by_request_too() {
    let mut pair = Pair::open();
    pair.session.distrust(Contradiction::Command, &mut |_| {});
    let mut epochs = Vec::new();
    for _ in 0..30 {
        while let Some(epoch) = pair.session.take_e_stop() {
            if pair.device.epoch().is_some_and(|present| newer(epoch, present)) {
                pair.device.e_stop(Tick::BOOT + pair.ticks, epoch);
            }
            epochs.push(epoch);
        }
        // All frames are lost.
        pair.exchange(u32::MAX, 0);
        pair.wait(425);
    }
    assert_eq!(pair.device.state(), State::Faulted);
    assert_eq!(epochs.len(), 20);
    assert!(epochs.windows(2).all(|pair| pair[1].wrapping_sub(pair[0]) == 0x5555));
}
