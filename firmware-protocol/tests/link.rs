//! The stream over a bad line, after a restart, and with a faulty host: every frame takes effect at most once.
//!
//! Sequence numbers, epochs, sessions, reports, and frames that cannot be read.

use crate::bench::{Bench, FIRMWARE, NO_LIMITS, ONSET, TICK_HZ, frame, pack, stroke};
use crate::taking::bursts;
use firmware_protocol::batch::{MAX_BATCH, Stroke};
use firmware_protocol::controller::{POOL, REORDER_WINDOW, REPORTS};
use firmware_protocol::frame::PROTOCOL;
use firmware_protocol::message::{Cause, DeviceMessage, HostMessage, Op, State};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// A frame of the stream with this epoch and number.
fn strokes(bench: &Bench, epoch: u16, seq: u16, strokes: &[Stroke]) -> Vec<u8> {
    let base = strokes.first().map_or(bench.now, |stroke| stroke.up.0);
    let batch = pack(base, strokes);
    let (seen, base) = (bench.seen(), Tick(base).wire());
    frame(&HostMessage::Moves { epoch, seq, seen, mark: None, withdraw: None, base, batch: batch.bytes() })
}

fn control(epoch: u16, op: Op) -> Vec<u8> {
    frame(&HostMessage::Control { epoch, seen: 0, op })
}

/// Three frames of one stroke each.
fn three(bench: &Bench) -> ([Stroke; 3], [Vec<u8>; 3]) {
    let three = [0, 1, 2].map(|k| stroke(1, bench.now + 200 + 100 * k, 7, 6, 7));
    (three, [0, 1, 2].map(|k| strokes(bench, bench.epoch, k, &[three[usize::from(k)]])))
}

#[test]
fn frames_out_of_order_are_buffered_until_the_missing_one_arrives() {
    let mut bench = Bench::armed(FIRMWARE);
    let (sent, frames) = three(&bench);
    for (i, next_seq, early) in [(2, 0, 0b10), (2, 0, 0b10), (1, 0, 0b11), (0, 3, 0), (1, 3, 0)] {
        bench.bytes(&frames[i]);
        if i == 0 {
            // The others are taken one by one.
            assert_eq!((bench.status().next_seq, bench.status().out_of_order), (1, 1));
            bench.follow();
        }
        assert_eq!((bench.status().next_seq, bench.status().out_of_order), (next_seq, early));
    }
    bench.run(500);
    assert_eq!(bench.bursts(1), bursts(&sent));
}

#[test]
fn a_frame_buffered_and_repeated_is_taken_once() {
    let mut bench = Bench::armed(FIRMWARE);
    let (sent, frames) = three(&bench);
    bench.bytes(&frames[1]);
    // In one packet, so that no buffered frame is taken in between.
    bench.bytes(&[&frames[0][..], &frames[1], &frames[2]].concat());
    assert_eq!((bench.status().next_seq, bench.status().out_of_order), (3, 0));
    bench.follow();
    assert_eq!((bench.status().next_seq, bench.reports()), (3, vec![]));
    bench.run(500);
    assert_eq!(bench.bursts(1), bursts(&sent));
}

#[test]
fn a_frame_beyond_the_reorder_window_is_ignored() {
    let mut bench = Bench::armed(FIRMWARE);
    let late = |bench: &Bench, seq| {
        let up = bench.now + 10_000 + u64::from(seq) * 100;
        strokes(bench, bench.epoch, seq, &[stroke(2, up, 7, 6, 7)])
    };
    for seq in [REORDER_WINDOW as u16, REORDER_WINDOW as u16 + 1, u16::MAX] {
        let frame = late(&bench, seq);
        bench.bytes(&frame);
    }
    assert_eq!((bench.status().next_seq, bench.status().out_of_order), (0, 1 << (REORDER_WINDOW - 1)));
    for seq in 0..REORDER_WINDOW as u16 {
        let frame = late(&bench, seq);
        bench.bytes(&frame);
    }
    bench.follow();
    assert_eq!((bench.status().next_seq, bench.status().out_of_order), (REORDER_WINDOW as u16 + 1, 0));
    // A new epoch drops the frames buffered in the old one.
    let frame = late(&bench, REORDER_WINDOW as u16 + 3);
    bench.bytes(&frame);
    assert_eq!(bench.status().out_of_order, 0b10);
    bench.control(Op::Stop);
    assert_eq!((bench.status().next_seq, bench.status().out_of_order), (0, 0));
}

#[test]
fn frames_of_another_epoch_are_acknowledged_and_ignored() {
    let mut bench = Bench::armed(FIRMWARE);
    let (_, frames) = three(&bench);
    bench.bytes(&frames[0]);
    bench.control(Op::Stop);
    // Frames that were on the line when the stop was sent.
    let answers = bench.inbox.len();
    bench.bytes(&frames[1]);
    bench.bytes(&frames[0]);
    assert_eq!(bench.inbox.len(), answers + 2);
    for epoch in [bench.epoch.wrapping_add(1), bench.epoch.wrapping_add(0x8000)] {
        bench.bytes(&strokes(&bench, epoch, 0, &[stroke(1, bench.now + 200, 7, 6, 7)]));
    }
    assert_eq!((bench.status().next_seq, bench.status().credits), (0, POOL as u16));
    bench.run(500);
    assert_eq!(bench.total(), 0);
    assert_eq!((bench.device.counters().dropped, bench.device.counters().refused), (2, 0));
}

#[test]
fn a_repeated_or_older_control_does_nothing() {
    let mut bench = Bench::armed(FIRMWARE);
    bench.control(Op::Move { motor: 1, direction: Direction::Up, pulses: 10 });
    for epoch in [0, 1, 2, 0x7fff, 0x8000].map(|back| bench.epoch.wrapping_sub(back)) {
        bench.run(100);
        bench.bytes(&control(epoch, Op::Move { motor: 1, direction: Direction::Up, pulses: 10 }));
        bench.bytes(&control(epoch, Op::Disarm(Cause::Shutdown)));
        assert_eq!((bench.status().epoch, bench.status().refusal), (bench.epoch, None));
    }
    bench.is(State::Armed, Cause::Request);
    assert_eq!(bench.net(1), 10);
    // The farthest epoch that counts as newer.
    bench.bytes(&control(bench.epoch.wrapping_add(0x7fff), Op::EStop));
    bench.is(State::Faulted, Cause::EStop);
}

#[test]
fn the_sequence_and_the_epoch_wrap() {
    let mut bench = Bench::armed(FIRMWARE);
    for round in 0..65_536u32 + 3 {
        assert_eq!(u32::from(bench.seq), round % 65_536);
        bench.frame(None, bench.now, &[]);
        bench.inbox.drain(..bench.inbox.len() - 1);
    }
    let next = stroke(1, bench.soon(), 7, 6, 7);
    let stale = strokes(&bench, bench.epoch, 2, &[next]);
    bench.bytes(&stale);
    bench.bytes(&strokes(&bench, bench.epoch, 13, &[next]));
    assert_eq!((bench.status().next_seq, bench.status().credits), (3, POOL as u16));
    bench.strokes(&[next]);
    assert_eq!((bench.status().next_seq, bench.status().credits), (4, POOL as u16 - 2));

    let first = bench.epoch;
    for _ in 0..65_536u32 + 3 {
        bench.control(Op::Reset);
        assert_eq!((bench.status().epoch, bench.status().next_seq), (bench.epoch, 0));
        bench.inbox.drain(..bench.inbox.len() - 1);
    }
    assert_eq!(bench.epoch, first.wrapping_add(3));
    bench.run(200);
    assert_eq!(bench.bursts(1), bursts([&next]));
}

/// The numbers of the reports sent since the last call.
fn numbers(bench: &mut Bench) -> Vec<u16> {
    let numbers = bench.inbox.iter().filter_map(|message| match message {
        DeviceMessage::Report { number, .. } => Some(*number),
        _ => None,
    });
    let numbers = numbers.collect();
    bench.inbox.clear();
    numbers
}

#[test]
fn a_report_is_repeated_every_ten_ms_while_the_host_is_heard_until_it_is_seen() {
    let mut bench = Bench::armed(FIRMWARE);
    bench.reading = false;
    for motor in [24, 25] {
        bench.strokes(&[stroke(motor, bench.now + 500, 7, 6, 7)]);
    }
    assert_eq!(numbers(&mut bench), [1, 2]);
    let repeat = u64::from(TICK_HZ) / 100;
    bench.run(repeat - 1);
    bench.ping(1);
    assert_eq!(numbers(&mut bench), []);
    bench.tick();
    // Only when the host is heard.
    bench.drain();
    assert_eq!(numbers(&mut bench), []);
    bench.ping(2);
    assert_eq!(numbers(&mut bench), [1, 2]);
    bench.run(repeat);
    bench.send(&HostMessage::Ping { token: 3, seen: 1 });
    assert_eq!(numbers(&mut bench), [2]);
    // Numbers that were never sent are ignored.
    bench.run(repeat);
    bench.send(&HostMessage::Ping { token: 3, seen: 3 });
    bench.send(&HostMessage::Ping { token: 3, seen: 0x9000 });
    assert_eq!(numbers(&mut bench), [2]);
    bench.send(&HostMessage::Ping { token: 3, seen: 2 });
    bench.run(repeat);
    bench.ping(4);
    assert_eq!((bench.status().reports, numbers(&mut bench)), (2, vec![]));
}

#[test]
fn a_full_ring_takes_no_strokes_and_loses_the_newest_report() {
    let mut bench = Bench::armed(FIRMWARE);
    bench.reading = false;
    let kept = REPORTS as u16 - 12;
    let at = bench.now + 50_000;
    for _ in 0..kept + 3 {
        bench.strokes(&[stroke(24, at, 7, 6, 7)]);
    }
    assert_eq!((bench.status().next_seq, bench.status().reports), (kept, kept));
    assert_eq!(bench.device.counters().refused, 2 * u64::from(kept));
    // Onsets and cuts have twelve more places; then they are lost and counted.
    let waiting = bench.seq;
    for lost in [0; 12].into_iter().chain([1, 2]) {
        bench.control(Op::Stop);
        assert_eq!(bench.status().counters.reports_lost, lost);
    }
    assert_eq!((waiting, bench.status().reports), (kept, REPORTS as u16));
    // A host that reads gets all of them in order, and can send strokes again.
    bench.reading = true;
    bench.run(850);
    bench.ping(1);
    assert_eq!(bench.seen, REPORTS as u16);
    assert_eq!(bench.reports().len(), REPORTS);
    let next = stroke(1, bench.soon(), 7, 6, 7);
    bench.strokes(&[next]);
    bench.run(200);
    assert_eq!(bench.bursts(1), bursts([&next]));
}

#[test]
fn before_a_hello_every_frame_is_answered_with_no_session_and_does_nothing() {
    let mut bench = Bench::new(FIRMWARE);
    let frames = [
        frame(&HostMessage::Ping { token: 1, seen: 0 }),
        control(1, crate::bench::arm(true, 85_000, NO_LIMITS)),
        control(2, Op::EStop),
        strokes(&bench, 0, 0, &[stroke(1, bench.soon(), 7, 6, 7)]),
        frame(&HostMessage::Amend { epoch: 0, generation: 1, base: Tick(0).wire(), items: &[] }),
    ];
    for bytes in &frames {
        bench.inbox.clear();
        bench.bytes(bytes);
        assert_eq!(bench.inbox, [DeviceMessage::NoSession]);
    }
    bench.is(State::Disarmed, Cause::Boot);
    // The same after a lost link.
    let mut bench = Bench::armed(FIRMWARE);
    bench.strokes(&[stroke(1, bench.soon(), 90, 6, 90)]);
    bench.run(80);
    bench.device.link_lost(Tick(bench.now));
    bench.inbox.clear();
    bench.settle();
    assert_eq!(bench.inbox, []);
    bench.ping(1);
    assert_eq!(bench.inbox, [DeviceMessage::NoSession]);
    assert_eq!(bench.net(1), 0);
}

#[test]
fn the_same_session_again_changes_nothing_and_skips_no_report() {
    let mut bench = Bench::armed(FIRMWARE);
    let next = stroke(1, bench.soon(), 7, 6, 7);
    bench.strokes(&[next]);
    bench.strokes(&[stroke(24, bench.soon(), 7, 6, 7)]);
    let epoch = bench.epoch;
    bench.hello(1);
    let Some(DeviceMessage::Hello(hello)) = bench.inbox.last().copied() else { panic!("a hello") };
    assert_eq!((hello.session, hello.epoch, hello.reports, hello.boot), (1, epoch, 0, 7));
    bench.is(State::Armed, Cause::Request);
    bench.run(200);
    assert_eq!(bench.bursts(1), bursts([&next]));
}

#[test]
fn a_new_session_starts_with_clean_reports_and_an_epoch_of_its_own() {
    let mut bench = Bench::armed(FIRMWARE);
    let (_, frames) = three(&bench);
    bench.bytes(&frames[0]);
    bench.onset(bench.now + 5_000, &[]);
    bench.run(180);
    // An onset that is rendered and has not passed belongs to the old session too.
    bench.onset(bench.device.rendered().0, &[]);
    bench.run(32);
    let old = bench.epoch;
    bench.hello(2);
    let Some(DeviceMessage::Hello(hello)) =
        bench.inbox.iter().rev().find(|message| matches!(message, DeviceMessage::Hello(_)))
    else {
        panic!("a hello")
    };
    assert_eq!((hello.session, hello.epoch), (2, old + 1));
    assert_eq!(hello.last_cut.map(|cut| (cut.cause, cut.flushed)), Some((Cause::NewHost, 0)));
    bench.inbox.clear();
    bench.bytes(&frames[1]);
    bench.settle();
    bench.is(State::Disarmed, Cause::NewHost);
    bench.run(6_000);
    assert_eq!((bench.reports(), bench.net(1)), (vec![], 0));
    // Armed by the new host, old frames stay ignored.
    bench.arm(false);
    bench.bytes(&frames[1]);
    assert_eq!((bench.status().next_seq, bench.status().state), (0, State::Armed));
}

/// A whole frame of another protocol version.
fn foreign(version: u8) -> Vec<u8> {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut message = vec![version, 200, 0, 1];
    message.extend(crc.checksum(&message).to_le_bytes());
    let mut bytes = vec![0; 20];
    let len = cobs::encode(&message, &mut bytes);
    bytes.truncate(len + 1);
    bytes
}

#[test]
fn another_version_is_answered_with_a_hello() {
    for version in [0, 1, 2, 255] {
        let mut bench = Bench::new(FIRMWARE);
        bench.bytes(&foreign(version));
        assert!(matches!(bench.inbox[..], [DeviceMessage::Hello(hello)] if hello.session == 0));
        assert_eq!(bench.device.counters().bad_frames, 0);
    }
    // This version, but no message: an unknown variant, or bytes left over.
    let mut bench = Bench::armed(FIRMWARE);
    bench.inbox.clear();
    bench.bytes(&foreign(PROTOCOL));
    assert_eq!((bench.inbox.len(), bench.device.counters().bad_frames), (0, 1));
}

#[test]
fn bad_frames_are_counted_and_change_nothing() {
    let mut bench = Bench::armed(FIRMWARE);
    let (_, frames) = three(&bench);
    let mut damaged = frames[0].clone();
    // Not to a zero, which would split the frame.
    let at = damaged.iter().rposition(|&byte| byte > 1).unwrap();
    damaged[at] ^= 1;
    let cut_short = [&frames[0][..6], &[0]].concat();
    let too_long = [vec![1; 600], vec![0]].concat();
    let mut crowd = Vec::new();
    for k in 0..MAX_BATCH / 2 + 1 {
        // Motor 0: a stroke 1 tick after the last, to level 1, held 20; then the same again.
        crowd.extend_from_slice(if k == 0 { &[0x40, 1, 1 << 1, 20] } else { &[0x80, 1, 20] });
    }
    // Motor 0: moves 1 tick after the last, to level 1. And a row of all motors three times.
    let moves = [0x00, 1, 1 << 1].repeat(MAX_BATCH + 1);
    let row = [&[0xc1, 1, 0xff, 0xff, 0xff, 0x07][..], &[1; 24]].concat();
    let rows =
        [&row[..], &[&[0xc0, 1][..], &[1; 24]].concat(), &[&[0xc0, 1][..], &[1; 24]].concat()].concat();
    // A stroke again and a row again without one before; a row of no motor; a level above 16 bits; a set above 64 bits.
    let broken: [&[u8]; 5] = [
        &[0x80, 1, 20],
        &[0xc0, 1, 1],
        &[0xc1, 1, 0],
        &[0x00, 1, 0x80, 0x80, 0x08],
        &[0xc1, 1, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x02, 1],
    ];
    let (epoch, base) = (bench.epoch, Tick(bench.now).wire());
    let in_a_frame = |batch: &[u8]| {
        frame(&HostMessage::Moves { epoch, seq: 0, seen: 0, mark: Some(ONSET), withdraw: None, base, batch })
    };
    let batches = [&crowd[..], &moves, &rows, &[0x40, 1]].into_iter().chain(broken).map(in_a_frame);
    let bad = [damaged, cut_short, too_long].into_iter().chain(batches);
    bench.inbox.clear();
    for (i, bytes) in bad.enumerate() {
        bench.bytes(&bytes);
        assert_eq!(bench.device.counters().bad_frames, i as u64 + 1);
    }
    assert_eq!(bench.inbox, []);
    // The next frame is read.
    bench.bytes(&frames[0]);
    assert_eq!((bench.status().next_seq, bench.status().credits), (1, POOL as u16 - 2));
}

#[test]
fn the_numbers_of_reports_wrap() {
    let mut bench = Bench::armed(FIRMWARE);
    let bad = stroke(24, bench.soon(), 7, 6, 7);
    for round in 1..65_536u32 + 40 {
        bench.strokes(&[bad]);
        assert_eq!((u32::from(bench.seen), bench.status().reports), (round % 65_536, bench.seen));
        bench.inbox.drain(..bench.inbox.len() - 2);
    }
    assert_eq!(bench.device.counters().reports_lost, 0);
}
