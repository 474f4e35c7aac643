//! A frame taken in pieces, with blocks rendered and events in between: nothing is counted twice or lost.
//!
//! [`half_taken`] is the beginning of each test: a frame of 64 moves, 32 strokes, of which the device takes one piece in each block.

use crate::bench::{Bench, FIRMWARE, HOST_TIMEOUT, ONSET, frame, pack, stroke};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, MAX_BATCH, MAX_FIRST_BATCH, Packer, Stroke};
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

#[test]
fn a_silent_host_or_a_lost_link_between_pieces_refuses_the_rest() {
    for blocks in 2..BLOCKS {
        let events: [fn(&mut Bench); 2] = [
            |bench| bench.device.link_lost(Tick(bench.now)),
            |bench| {
                bench.device.advance(Tick(bench.now + u64::from(HOST_TIMEOUT) + 1));
            },
        ];
        for (event, cause) in events.into_iter().zip([Cause::LinkLost, Cause::HostTimeout]) {
            let (mut bench, _) = half_taken(500, blocks);
            event(&mut bench);
            bench.is(State::Returning, cause);
            check(&mut bench, 32, "return");
            bench.is(State::Disarmed, cause);
            // The move up had begun; the pin came down by itself.
            assert_eq!((bench.device.counters().played, bench.net(23)), (1, 0));
        }
    }
}

#[test]
fn a_hello_of_another_session_between_pieces_ends_the_frame() {
    for blocks in 2..BLOCKS {
        let (mut bench, _) = half_taken(500, blocks);
        bench.device.open_session(Tick(bench.now), 2);
        bench.is(State::Returning, Cause::NewHost);
        check(&mut bench, taken(blocks), "hello");
        assert_eq!(
            bench.reports().iter().filter(|report| matches!(report, Report::Verdict { .. })).count(),
            0
        );
    }
}

#[test]
fn a_duplicate_between_pieces_is_taken_once() {
    for blocks in 0..BLOCKS {
        let (mut bench, bytes) = half_taken(500, blocks);
        bench.bytes(&bytes);
        bench.run(BLOCKS * u64::from(BLOCK));
        check(&mut bench, 32, "duplicate");
        assert_eq!((bench.device.counters().played, bench.status().next_seq), (66, bench.seq + 1));
    }
}

#[test]
fn a_verdict_names_the_rendered_end_of_the_first_late_stroke() {
    let (mut bench, _) = half_taken(SOON, 0);
    // The second piece is late: it comes after three blocks to unpack the frame, one for its head, and one for the first piece.
    let second = bench.device.rendered() + 5 * u64::from(BLOCK);
    bench.run(BLOCKS * u64::from(BLOCK));
    let Report::Verdict { late, rendered, .. } = bench.last_report() else { panic!("a verdict") };
    // The first piece has five strokes, of two moves each; 22 strokes begin together.
    assert_eq!((late & 0xfff_ffff_ffff, rendered), (0xfff_ffff_fc00, second.wire()));
    check(&mut bench, 32, "late");
}

/// Rows have more moves than a piece; each of them is taken or left by itself.
#[test]
fn rows_are_taken_in_pieces_of_ten_moves_and_each_move_counts_once() {
    for blocks in 0..BLOCKS {
        let mut bench = busy();
        let at = bench.now + 500;
        let motors = MotorSet::from_bits((1 << 21) - 1);
        let mut packer = Packer::<BATCH_BYTES>::new(Tick(at));
        for (k, level) in [(0, 90), (100, 40), (300, 0)] {
            packer.row(Tick(at + k), motors, &[level; 21]).unwrap();
        }
        let (epoch, seq, seen, base) = (bench.epoch, bench.seq, bench.seen(), Tick(at).wire());
        let batch = packer.bytes();
        let row = HostMessage::Moves { epoch, seq, seen, mark: None, withdraw: None, base, batch };
        bench.bytes(&frame(&row));
        bench.run(blocks * u64::from(BLOCK));
        bench.device.e_stop(Tick(bench.now), epoch.wrapping_add(1));
        // Items are unpacked whole: two blocks for three rows, and one for the head.
        let taken = (10 * blocks.saturating_sub(3)).min(63);
        assert_eq!(counted(bench.device.counters()), 2 + taken, "{blocks} blocks");
        bench.run(1_000);
        assert_eq!(bench.device.counters().pulses, bench.total());
    }
}
