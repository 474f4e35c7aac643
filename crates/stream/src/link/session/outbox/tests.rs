//! Which frames leave: again after a gap or a timeout, and no more than may be under way.

use super::*;
use firmware_protocol::message::{Cause, Counters, State};
use meissner_array::strokes::Stroke;

const RETRY: Duration = Duration::from_millis(3);
const ROUND_TRIP: Duration = Duration::from_millis(1);
const PLENTY: usize = 9 * MAX_FRAME;

fn at(ms: u64) -> HostInstant {
    HostInstant::from_ns(ms * 1_000_000)
}

/// A status of a device with many free slots.
fn status(next_seq: u16, gap: bool) -> Status {
    Status {
        token: 0,
        tick: Tick(0).wire(),
        epoch: 1,
        refusal: None,
        next_seq,
        gap,
        credits: 100,
        reports: 0,
        state: State::Armed,
        cause: Cause::Request,
        position_known: true,
        outstanding: 0,
        counters: Counters::NONE,
    }
}

/// Frames of a stroke each, at marks 0, 1 and so on.
fn with_frames(count: u64) -> Outbox {
    let mut outbox = Outbox::new();
    outbox.acknowledge(&status(0, false), at(0), ROUND_TRIP);
    for mark in 0..count {
        outbox.begin(Tick(mark), Mark { kind: MarkKind::Item, trigger: None, hold: 0 });
        let up = Tick(900 * mark + 5);
        let stroke = Stroke { motor: 0, up, up_pulses: 10, down: up + 50, down_pulses: 10 };
        assert!(outbox.push(&stroke.into()));
        outbox.seal();
    }
    outbox
}

/// The numbers of the frames that leave at an instant.
fn written(outbox: &mut Outbox, ms: u64, window_bytes: usize) -> Vec<u16> {
    let (mut numbers, mut out) = (Vec::new(), [0; MAX_FRAME]);
    let head = Head { epoch: 1, seen: 0 };
    while let Some(written) = outbox.write_next(at(ms), head, RETRY, window_bytes, &mut out) {
        let mut decoder = frame::Decoder::new();
        let message = frame::read(decoder.next(&mut &out[..written.len]).unwrap());
        let Ok(HostMessage::Moves { seq, .. }) = message else { panic!("{message:?}") };
        assert_eq!(written.marks.is_none(), written.retransmitted);
        numbers.push(seq);
    }
    numbers
}

#[test]
fn all_that_is_not_acknowledged_is_sent_again_in_order() {
    let mut outbox = with_frames(4);
    assert_eq!(written(&mut outbox, 1, PLENTY), [0, 1, 2, 3]);
    assert_eq!((outbox.unacknowledged(), outbox.credits()), (4, 92));
    // The second is lost: the device says so. What it says before the next round trip is old.
    outbox.acknowledge(&status(1, true), at(2), ROUND_TRIP);
    assert_eq!(written(&mut outbox, 2, PLENTY), [1, 2, 3]);
    outbox.acknowledge(&status(1, true), at(2), ROUND_TRIP);
    assert!(written(&mut outbox, 2, PLENTY).is_empty());
    // Nothing comes.
    assert_eq!(outbox.due(at(3), RETRY), Some(at(5)));
    assert!(written(&mut outbox, 4, PLENTY).is_empty());
    assert_eq!(written(&mut outbox, 5, PLENTY), [1, 2, 3]);
    // Of the first copies one had arrived.
    outbox.acknowledge(&status(3, false), at(6), ROUND_TRIP);
    assert_eq!(written(&mut outbox, 8, PLENTY), [3]);
    outbox.acknowledge(&status(4, false), at(9), ROUND_TRIP);
    assert_eq!((outbox.bytes_under_way(), outbox.due(at(9), RETRY)), (0, None));
}

#[test]
fn no_more_is_under_way_than_may_be() {
    let mut outbox = with_frames(3);
    assert_eq!(written(&mut outbox, 1, HEADER), [0]);
    assert_eq!(written(&mut outbox, 4, HEADER), [0]);
    outbox.acknowledge(&status(1, false), at(5), ROUND_TRIP);
    assert_eq!(written(&mut outbox, 5, HEADER), [1]);
    assert_eq!(written(&mut outbox, 6, MAX_FRAME), [2]);
}
