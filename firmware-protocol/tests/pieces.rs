//! A frame taken in pieces, with blocks rendered and events in between: nothing is counted twice or lost.
//!
//! [`half_taken`] is the beginning of each test: a frame of 64 moves, 32 strokes, of which the device takes one piece in each block.

use crate::bench::{Bench, FIRMWARE, ONSET, frame, pack, stroke};
use firmware_protocol::batch::{MAX_BATCH, MAX_FIRST_BATCH, Stroke};
use firmware_protocol::controller::{BLOCK, HORIZON};
use firmware_protocol::message::{Cause, Counters, HostMessage, Mark, Op, Report, State};
use firmware_protocol::tick::Tick;

/// Ticks from now to the first stroke of the frame: late by the time its second piece is taken.
const SOON: u64 = HORIZON as u64 + 4 * BLOCK as u64;
/// Blocks until a frame of 64 moves is taken: three to unpack it, the first of which reads its message; one for its head; seven for its
/// pieces of five strokes; and one to spare.
const BLOCKS: u64 = 12;
/// Strokes taken after so many blocks.
fn taken(blocks: u64) -> u64 {
    (5 * blocks.saturating_sub(4)).min(32)
}

/// An armed bench in an up burst, so that the drivers are on and the device takes long frames in pieces.
fn busy() -> Bench {
    let mut bench = Bench::armed(FIRMWARE);
    bench.strokes(&[stroke(23, bench.soon(), 1_000, 5, 1_000)]);
    bench.run_to((bench.soon() + 100).next_multiple_of(BLOCK.into()));
    bench.in_pieces = true;
    bench
}

/// The first 22 begin together, so a late piece has late strokes.
fn strokes(bench: &Bench, ahead: u64, count: usize) -> Vec<Stroke> {
    (0..count as u64).map(|k| stroke(k as u8 % 22, bench.now + ahead + 100 * (k / 22), 9, 5, 9)).collect()
}

fn message(bench: &Bench, mark: Option<Mark>, strokes: &[Stroke]) -> Vec<u8> {
    let base = strokes[0].up;
    let batch = pack(base.0, strokes);
    let (epoch, seq, seen) = (bench.epoch, bench.seq, bench.seen());
    frame(&HostMessage::Moves {
        epoch,
        seq,
        seen,
        mark,
        withdraw: None,
        base: base.wire(),
        batch: batch.bytes(),
    })
}

/// Reads a frame whose strokes begin `ahead` ticks from now, and takes it for so many blocks.
fn half_taken(ahead: u64, blocks: u64) -> (Bench, Vec<u8>) {
    let mut bench = busy();
    let bytes = message(&bench, None, &strokes(&bench, ahead, MAX_BATCH / 2));
    bench.bytes(&bytes);
    bench.run(blocks * u64::from(BLOCK));
    (bench, bytes)
}

/// Moves counted.
fn counted(counters: Counters) -> u64 {
    counters.played + counters.late + counters.dropped + counters.refused + counters.replaced
}

/// Plays to the end, and asserts that each move of the strokes taken was counted once, and as many pulses as the lines gave.
fn check(bench: &mut Bench, taken: u64, what: &str) {
    bench.run(4_000);
    let counters = bench.device.counters();
    assert_eq!(counted(counters), 2 * (1 + taken), "{what}: {counters:?}");
    assert_eq!(counters.pulses, bench.total(), "{what}");
}

#[test]
fn the_onset_of_a_busy_device_decides_on_the_whole_frame() {
    let mut outcomes = std::collections::HashSet::new();
    for ahead in u64::from(HORIZON)..u64::from(HORIZON) + 8 * u64::from(BLOCK) {
        let mut bench = busy();
        let bytes = message(&bench, Some(ONSET), &strokes(&bench, ahead, MAX_FIRST_BATCH / 2));
        bench.bytes(&bytes);
        // A block is rendered before each piece.
        bench.run((BLOCKS + 3) * u64::from(BLOCK));
        let counters = bench.device.counters();
        assert_eq!((counters.late, counters.refused), (0, 0), "{ahead}");
        let refused = bench.reports().iter().any(|report| matches!(report, Report::OnsetRefused { .. }));
        check(&mut bench, if refused { 0 } else { MAX_FIRST_BATCH as u64 / 2 }, "onset");
        outcomes.insert(refused);
    }
    assert_eq!(outcomes.len(), 2, "one in time and one that is not");
}

#[test]
fn an_e_stop_between_pieces_keeps_what_was_counted() {
    for (ahead, blocks) in
        [SOON, 500].into_iter().flat_map(|ahead| (0..BLOCKS).map(move |blocks| (ahead, blocks)))
    {
        let (mut bench, _) = half_taken(ahead, blocks);
        let epoch = bench.epoch.wrapping_add(1);
        bench.device.e_stop(Tick(bench.now), epoch);
        bench.is(State::Faulted, Cause::EStop);
        let stopped = counted(bench.device.counters());
        let taken = taken(blocks);
        assert_eq!(stopped, 2 * (1 + taken), "{ahead}, {blocks} blocks: {:?}", bench.device.counters());
        // The rest of its epoch is ignored, also after a reset.
        bench.epoch = epoch;
        bench.control(Op::Reset);
        bench.run(BLOCKS * u64::from(BLOCK));
        bench.is(State::Disarmed, Cause::Request);
        check(&mut bench, taken, "after the reset");
    }
}
