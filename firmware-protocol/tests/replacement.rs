//! Frames that replace queued strokes: each motor's as a whole or not at all, none of them in part, all of them counted.

use crate::bench::{Bench, FIRMWARE, MOCK, MOTORS, ONSET, SHELLS, SOON, stroke};
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::{BLOCK, POOL};
use firmware_protocol::message::{Counters, Op, Report, Withdraw};
use firmware_protocol::stroke::{Direction, Stroke};
use firmware_protocol::tick::Tick;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Length of a period of [`train`], of one of its bursts, and of what comes between them.
const PERIOD: u64 = 100;
const PULSES: u16 = 20;
const HOLD: u64 = 30;

/// Strokes of `motor`, one in each period from `first` on.
fn train(motor: u8, first: u64, count: u64, pulses: u16) -> Vec<Stroke> {
    (0..count).map(|k| stroke(motor, first + k * PERIOD, pulses, HOLD, pulses)).collect()
}

/// The bursts of these strokes.
fn bursts(strokes: &[Stroke]) -> Vec<firmware_protocol::stroke::Burst> {
    strokes.iter().flat_map(Stroke::bursts).collect()
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

/// A replacement sent at each phase of a running stroke, and for each distance of `base`: what has begun is played whole, then
/// either the new strokes or, if they come too late, the old ones.
#[test]
fn in_every_phase_a_replacement_is_whole_or_not_at_all() {
    for shell in SHELLS {
        let (mut done, mut late) = (0, 0);
        for phase in 0..PERIOD {
            for ahead in [0, 1, 20, 63, 64, 65, 80, 100, 130, 250] {
                let mut bench = Bench::armed(shell);
                let old = train(1, bench.soon(), 12, PULSES);
                bench.strokes(&old);
                bench.run_to(old[2].up.0 + phase);
                let base = bench.now + ahead;
                let (before, after) = old.split_at(old.partition_point(|old| old.up.0 < base));
                let new = train(1, after[0].up.0, 9, PULSES + 9);
                bench.replace(1 << 1, 0, base, &new);
                let kept = !kept(&bench).is_empty();
                bench.run(2_000);
                let expected = if kept { &old } else { &[before, &new[..]].concat() };
                assert_eq!(bench.bursts(1), bursts(expected), "phase {phase}, {ahead} ticks ahead");
                let counters = bench.device.counters();
                assert_eq!((counters.dropped, counters.refused), (0, 0));
                assert_eq!(counted(counters), 2 * (old.len() + new.len()) as u64);
                assert_eq!(counters.pulses, bench.total());
                let replaced = 2 * if kept { new.len() } else { after.len() } as u64;
                assert_eq!((counters.replaced, counters.late), (replaced, 0));
                bench.ping(0);
                assert_eq!(bench.status().credits, POOL as u16);
                if kept { late += 1 } else { done += 1 }
            }
        }
        assert!(done > 400 && (late > 100 || shell.ahead < 2), "{done} done, {late} late");
    }
}

/// A base so long ago that strokes from it on were played whole is as late as one in a running stroke: the host counts those
/// strokes as withdrawn unless the device says that it kept them.
#[test]
fn what_was_played_since_the_base_keeps_the_rest() {
    for shell in SHELLS {
        for (played, new) in [(0, false), (0, true), (1, false), (1, true), (3, true)] {
            let mut bench = Bench::armed(shell);
            let old = train(1, bench.soon(), 6, PULSES);
            bench.strokes(&old);
            // In a pause: of the strokes from the base on, `played` have ended.
            bench.run_to(old[3].end().0 + 1);
            let base = old[3 - played].end().0;
            let new = if new { train(1, old[5].up.0, 1, 9) } else { Vec::new() };
            bench.replace(0b10, 0, base, &new);
            let is_kept = played > 0 || bench.device.rendered() > old[4].up;
            assert_eq!(kept(&bench), vec![0b10; usize::from(is_kept)], "{played} played, {shell:?}");
            bench.run(1_000);
            let expected = if is_kept { old.clone() } else { [&old[..4], &new].concat() };
            assert_eq!(bench.bursts(1), bursts(&expected), "{played} played, {shell:?}");
            assert_eq!(counted(bench.device.counters()), 2 * (6 + new.len() as u64));
        }
    }
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
    bench.strokes(&train(1, old[11].end().0 + 10, 2, 7));
    bench.strokes(&other[1..]);
    assert_eq!(kept(&bench), [0b10]);
    assert_eq!((bench.device.counters().late, bench.device.counters().replaced), (0, 6));
    let new = train(1, old[7].up.0 + 11, 3, 9);
    bench.replace(0b10, 0, old[7].up.0 - 3, &new);
    bench.run(2_000);
    assert_eq!(bench.bursts(1), bursts(&[&old[..7], &new].concat()));
    assert_eq!(bench.bursts(2), bursts(&other));
    assert_eq!(counted(bench.device.counters()), 2 * (12 + 1 + 1 + 2 + 2 + 3));
}

#[test]
fn a_play_or_a_command_ends_what_was_kept() {
    for command in [false, true] {
        let mut bench = Bench::armed(FIRMWARE);
        let old = train(1, bench.soon(), 2, PULSES);
        bench.strokes(&old);
        bench.run_to(old[0].up.0 + 5);
        bench.replace(0b10, 0, old[0].up.0, &train(1, bench.soon(), 1, 7));
        assert_eq!(kept(&bench), [0b10]);
        bench.run(1_000);
        if command {
            bench.control(Op::Stop);
            bench.settle();
        }
        let new = train(1, bench.soon(), 2, 7);
        if command {
            bench.strokes(&new);
        } else {
            bench.onset(new[0].up.0, &new);
        }
        bench.run(1_000);
        assert_eq!(bench.bursts(1), bursts(&[old, new].concat()));
    }
}

#[test]
fn a_motor_without_new_strokes_falls_silent_and_the_drivers_go_off() {
    let mut bench = Bench::armed(FIRMWARE);
    let old: Vec<Vec<Stroke>> =
        (0..MOTORS as u8).map(|motor| train(motor, bench.soon(), 10, PULSES)).collect();
    for strokes in &old {
        bench.strokes(strokes);
    }
    bench.run_to(old[0][3].up.0 + 1);
    bench.replace(u64::MAX, 0, old[0][4].up.0 - 20, &[]);
    assert_eq!(bench.status().credits, (POOL - MOTORS) as u16, "one running stroke per motor");
    let (enabled, now) = (bench.enabled_ticks, bench.now);
    bench.run(2_000);
    assert!(bench.enabled_ticks - enabled < old[0][4].up.0 - now, "the drivers stay on");
    for motor in 0..MOTORS as u8 {
        assert_eq!(bench.bursts(motor), bursts(&old[usize::from(motor)][..4]));
    }
    assert_eq!(bench.device.counters().replaced, 2 * 6 * 24);
}

/// The first stroke of each motor decides: what overlaps the running stroke, or breaks a limit, leaves the old strokes in place.
#[test]
fn a_first_stroke_that_cannot_be_queued_keeps_the_old_ones() {
    let mut bench = Bench::armed(MOCK);
    let old = train(1, bench.soon(), 4, PULSES);
    bench.strokes(&old);
    bench.run_to(old[0].up.0 + 5);
    let base = old[0].up.0 + 6;
    let harmful = [
        stroke(1, old[0].end().0 - 1, PULSES, HOLD, PULSES),
        stroke(1, old[1].up.0, 3_001, 1, 3_001),
        stroke(1, old[1].up.0, PULSES, HOLD, PULSES - 1),
    ];
    for harmful in harmful {
        bench.replace(0b10, 0, base, &[harmful]);
    }
    assert_eq!(kept(&bench), [0b10; 3]);
    bench.run(1_000);
    assert_eq!(bench.bursts(1), bursts(&old));
    assert_eq!((bench.device.counters().replaced, bench.device.counters().refused), (2, 4));
}

#[test]
fn an_amendment_of_a_withdrawn_stroke_does_not_change_the_new_one() {
    for (generation, pulses) in [(4, PULSES), (5, PULSES), (6, PULSES + 2)] {
        let mut bench = Bench::armed_without_stop(FIRMWARE);
        let old = train(1, bench.soon() + 100, 3, PULSES);
        bench.strokes(&old);
        bench.replace(0b10, 5, old[0].up.0, &old);
        // On its way since before the replacement, or sent after it.
        bench.amend(generation, &old[0], Direction::Up, PULSES + 2);
        bench.run(1_000);
        assert_eq!(bench.bursts(1)[0].pulses, pulses, "generation {generation}");
        assert_eq!(bench.device.counters().replaced, 6);
    }
}

/// While a frame is taken in pieces, an e-stop may come between any two of them.
#[test]
fn an_e_stop_between_the_pieces_of_a_replacement_loses_no_count() {
    for blocks in 0..12 {
        let mut bench = Bench::armed(FIRMWARE);
        let old: Vec<Vec<Stroke>> =
            (0..MOTORS as u8).map(|motor| train(motor, bench.soon() + 50, 8, PULSES)).collect();
        for strokes in &old {
            bench.strokes(strokes);
        }
        bench.run_to((old[0][1].up.0 + 7).next_multiple_of(BLOCK.into()));
        bench.in_pieces = true;
        let base = bench.now + SOON + 200;
        let first = old[0].iter().find(|old| old.up.0 >= base).expect("one").up.0;
        let new: Vec<Stroke> = (0..MOTORS as u8).map(|motor| stroke(motor, first, 9, HOLD, 9)).collect();
        let frame = bench.replacement(
            None,
            Withdraw { motors: MotorSet::from_bits(u64::MAX), generation: 0 },
            base,
            &new,
        );
        bench.bytes(&frame);
        bench.run(blocks * u64::from(BLOCK));
        let epoch = bench.epoch.wrapping_add(1);
        bench.device.e_stop(Tick(bench.now), epoch);
        let counters = bench.device.counters();
        let taken = 4 * blocks.saturating_sub(3).min(6);
        assert_eq!(counted(counters), 2 * (8 * 24 + taken), "{blocks} blocks: {counters:?}");
        let withdrawn = old[0].iter().filter(|old| old.up.0 >= base).count() as u64;
        assert_eq!(counters.replaced, 2 * withdrawn * taken, "{blocks} blocks");
        assert_eq!(counters.pulses, bench.total());
    }
}

/// Searching a long queue takes as long as searching many short ones, so lines are rendered between two searches.
#[test]
fn long_queues_are_searched_one_at_a_time() {
    let mut bench = Bench::armed(FIRMWARE);
    let old: Vec<Vec<Stroke>> = (1..4).map(|motor| train(motor, bench.soon(), 140, PULSES)).collect();
    for strokes in old.iter().flat_map(|old| old.chunks(32)) {
        bench.strokes(strokes);
    }
    bench.in_pieces = true;
    let last = old[0][139].up.0;
    bench.bytes(&bench.replacement(
        None,
        Withdraw { motors: MotorSet::from_bits(0b1110), generation: 0 },
        last,
        &[],
    ));
    let mut replaced: Vec<u64> = (0..8)
        .map(|_| {
            bench.run(BLOCK.into());
            bench.device.counters().replaced
        })
        .collect();
    replaced.dedup();
    assert_eq!(replaced, [0, 2, 4, 6]);
}

#[test]
fn a_full_device_takes_a_replacement_frame_by_frame() {
    let mut bench = Bench::armed(FIRMWARE);
    let first = bench.soon();
    // 42 periods of 24 motors, and one stroke of each that is left.
    for period in 0..42 {
        let strokes: Vec<Stroke> = (0..MOTORS as u8)
            .map(|motor| stroke(motor, first + period * PERIOD + 4_000, PULSES, HOLD, PULSES))
            .collect();
        bench.strokes(&strokes);
    }
    assert_eq!(usize::from(bench.status().credits), POOL - 42 * 24);
    for motor in 0..24 {
        // No denser than the device allows.
        let new: Vec<Stroke> =
            (0..16).map(|k| stroke(motor, first + 4_000 + 3 * k * PERIOD, 9, HOLD, 9)).collect();
        bench.replace(1 << motor, 0, first, &new);
    }
    bench.run(9_000);
    let counters = bench.device.counters();
    assert_eq!((counters.replaced, counters.played, counters.refused), (2 * 42 * 24, 2 * 16 * 24, 0));
}

#[test]
fn the_first_frame_of_a_play_withdraws_nothing() {
    let mut bench = Bench::armed(FIRMWARE);
    let old = train(1, bench.soon(), 3, PULSES);
    bench.strokes(&old);
    let new = train(2, bench.soon(), 3, PULSES);
    let base = new[0].up.0;
    let frame = bench.replacement(
        Some(ONSET),
        Withdraw { motors: MotorSet::from_bits(0b10), generation: 0 },
        base,
        &new,
    );
    bench.bytes(&frame);
    bench.run(1_000);
    assert_eq!((bench.bursts(1), bench.bursts(2)), (bursts(&old), bursts(&new)));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, rng_seed: RngSeed::Fixed(22), ..ProptestConfig::default() })]

    /// Random trains of three motors replace each other, many of them too late or on top of one another: what the pins do is a
    /// sequence of strokes that were sent, each whole, and every one sent is counted once.
    #[test]
    fn whatever_is_replaced_only_whole_strokes_are_played(
        shell in prop::sample::select(SHELLS.to_vec()),
        in_pieces: bool,
        updates in prop::collection::vec((0u64..400, 0u64..8, -80i64..300, 0u64..200, 0u64..9, 1u16..40), 1..40),
    ) {
        let mut bench = Bench::armed(shell);
        bench.in_pieces = in_pieces && shell.ahead > 1;
        let mut sent = Vec::new();
        for (number, (wait, motors, ahead, offset, count, pulses)) in updates.into_iter().enumerate() {
            bench.run(wait);
            let base = bench.now.wrapping_add_signed(ahead);
            let drives = (1..4u8).filter(|motor| motors >> (motor - 1) & 1 == 1);
            let mut strokes: Vec<Stroke> =
                drives.flat_map(|motor| train(motor, base + offset * u64::from(motor), count, pulses)).collect();
            strokes.sort_by_key(|stroke| stroke.up);
            strokes.truncate(32);
            bench.seq = number as u16;
            bench.replace(motors << 1, 0, base, &strokes);
            sent.extend(strokes);
        }
        bench.run(3_000);
        let counters = bench.device.counters();
        prop_assert_eq!(counted(counters), 2 * sent.len() as u64);
        prop_assert_eq!((counters.dropped, counters.pulses), (0, bench.total()));
        let mut played = 0;
        for motor in 1..4 {
            for pair in bench.bursts(motor).chunks(2) {
                prop_assert!(sent.iter().any(|stroke| stroke.motor == motor && stroke.bursts() == *pair), "{:?}", pair);
                played += 2;
            }
        }
        prop_assert_eq!(counters.played, played);
    }
}
