//! Frames that replace queued moves: each motor's from one tick on or not at all, all of them counted.

use crate::bench::{Bench, FIRMWARE, stroke};
use crate::taking::{bursts, end};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::BLOCK;
use firmware_protocol::message::{Counters, HostMessage, Report, Withdraw};
use firmware_protocol::moves::Move;

/// Length of a period of [`train`], of one of its bursts, and of what comes between them.
const PERIOD: u64 = 100;
const PULSES: u16 = 20;
const HOLD: u64 = 30;

/// Strokes of `motor`, one in each period from `first` on.
fn train(motor: u8, first: u64, count: u64, pulses: u16) -> Vec<Stroke> {
    (0..count).map(|k| stroke(motor, first + k * PERIOD, pulses, HOLD, pulses)).collect()
}

/// The moves of these strokes.
fn moves<'a>(strokes: impl IntoIterator<Item = &'a Stroke>) -> Vec<Move> {
    strokes.into_iter().flat_map(Stroke::moves).collect()
}

fn counted(counters: Counters) -> u64 {
    counters.played + counters.late + counters.dropped + counters.refused + counters.replaced
}

/// The motors that the verdicts so far say were kept.
fn kept(bench: &Bench) -> Vec<u64> {
    let kept = |report: &Report| match report {
        Report::Verdict { kept, .. } if !kept.is_empty() => Some(kept.bits()),
        _ => None,
    };
    bench.reports().iter().filter_map(kept).collect()
}

/// After a replacement that came too late, frames behind it on the line do not mix with the old strokes.
#[test]
fn a_kept_motor_plays_its_old_strokes_until_it_is_replaced_again() {
    let mut bench = Bench::armed(FIRMWARE);
    let old = train(1, bench.soon(), 12, PULSES);
    bench.strokes(&old);
    bench.run_to(old[2].up.0 + 5);
    let other = train(2, bench.soon(), 3, PULSES);
    bench.replace(0b10, 0, old[2].up.0, &[&train(1, bench.soon(), 1, 7)[..], &other[..1]].concat());
    bench.strokes(&train(1, end(&old[11]) + 10, 2, 7));
    bench.strokes(&other[1..]);
    assert_eq!(kept(&bench), [0b10]);
    assert_eq!((bench.device.counters().late, bench.device.counters().replaced), (0, 6));
    let new = train(1, old[7].up.0 + 11, 3, 9);
    bench.replace(0b10, 0, old[7].up.0 - 3, &new);
    bench.run(2_000);
    assert_eq!(bench.bursts(1), bursts(old[..7].iter().chain(&new)));
    assert_eq!(bench.bursts(2), bursts(&other));
    assert_eq!(counted(bench.device.counters()), 2 * (12 + 1 + 1 + 2 + 2 + 3));
}

#[test]
fn an_amendment_of_a_withdrawn_stroke_does_not_change_the_new_one() {
    for (generation, pulses) in [(4, PULSES), (5, PULSES), (6, PULSES + 2)] {
        let mut bench = Bench::armed_without_stop(FIRMWARE);
        let old = train(1, bench.soon() + 100, 3, PULSES);
        bench.strokes(&old);
        bench.replace(0b10, 5, old[0].up.0, &old);
        // On its way since before the replacement, or sent after it.
        bench.amend(generation, 1, old[0].up, PULSES + 2);
        bench.run(1_000);
        assert_eq!(bench.bursts(1)[0].pulses, pulses, "generation {generation}");
        assert_eq!(bench.device.counters().replaced, 6);
    }
}

/// The blocks, with a piece of work in each, until the counters are so.
fn blocks_until(bench: &mut Bench, count: impl Fn(Counters) -> bool) -> usize {
    let taken = (1..500).find(|_| {
        bench.run(BLOCK.into());
        count(bench.device.counters())
    });
    taken.expect("the frame is taken")
}

/// A search of a long queue goes on in the next piece after 128 moves, so lines are rendered meanwhile.
#[test]
fn long_queues_are_searched_in_pieces() {
    let queued = || {
        let mut bench = Bench::armed(FIRMWARE);
        let old: Vec<Vec<Stroke>> = (1..4).map(|motor| train(motor, bench.soon(), 140, PULSES)).collect();
        for strokes in old.iter().flat_map(|old| old.chunks(32)) {
            bench.strokes(strokes);
        }
        bench.in_pieces = true;
        (bench, moves(&old[0]))
    };
    let (mut bench, old) = queued();
    let withdraw = Withdraw { motors: MotorSet::from_bits(0b1110), generation: 0 };
    bench.bytes(&bench.replacement(None, withdraw, old[278].tick.0, &[]));
    // Three times 278 moves.
    let blocks = [2, 4, 6].map(|moves| blocks_until(&mut bench, |counters| counters.replaced == moves));
    assert_eq!((blocks[1], blocks[2]), (2, 2));
    // The last amendment is for no move. Those in order of time go on where the one before has come to.
    for (in_order, pieces) in [(true, 14..20), (false, 90..120)] {
        let (mut bench, mut old) = queued();
        if !in_order {
            old.reverse();
        }
        let ends = if in_order { &old[229..] } else { &old[..51] };
        let mut packer = Packer::<BATCH_BYTES>::new(ends[0].tick);
        let none = Move { tick: ends[50].tick + 1, ..ends[50] };
        for to in ends.iter().chain([&none]) {
            packer.amendment(&Amendment { motor: 1, tick: to.tick, pulses: PULSES - 1 }).expect("room");
        }
        let (epoch, base) = (bench.epoch, ends[0].tick.wire());
        bench.send(&HostMessage::Amend { epoch, generation: 1, base, items: packer.bytes() });
        let blocks = blocks_until(&mut bench, |counters| counters.amendments_ignored == 1);
        assert!(pieces.contains(&blocks), "{in_order}: {blocks}");
        bench.in_pieces = false;
        bench.run(15_000);
        let Counters { amended, amendments_ignored, .. } = bench.device.counters();
        assert_eq!((amended, amendments_ignored), (51, 1), "{in_order}");
    }
}
