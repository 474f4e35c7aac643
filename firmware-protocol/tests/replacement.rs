//! Frames that replace queued moves: each motor's from one tick on or not at all, all of them counted.

use crate::bench::{Bench, FIRMWARE, MOCK, MOTORS, ONSET, SHELLS, SOON, burst, stroke, to};
use crate::taking::{bursts, end, plain};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{Amendment, BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::{BLOCK, POOL};
use firmware_protocol::message::{Counters, HostMessage, Op, Report, Withdraw};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
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

/// The moves of these strokes.
fn moves<'a>(strokes: impl IntoIterator<Item = &'a Stroke>) -> Vec<Move> {
    strokes.into_iter().flat_map(Stroke::moves).collect()
}

/// The strokes that begin before `base`.
fn strokes_before(base: u64, strokes: &[Stroke]) -> Vec<Stroke> {
    strokes.iter().copied().filter(|stroke| stroke.up.0 < base).collect()
}

/// The moves that begin before `base`.
fn before(base: u64, moves: &[Move]) -> Vec<Move> {
    moves.iter().copied().filter(|to| to.tick.0 < base).collect()
}

/// Sends a frame of single moves that withdraws from `base` on.
fn replace(bench: &mut Bench, motors: u64, base: u64, moves: &[Move]) {
    let mut packer = Packer::<BATCH_BYTES>::new(Tick(base));
    moves.iter().for_each(|to| packer.moves(to).expect("room"));
    let withdraw = Some(Withdraw { motors: MotorSet::from_bits(motors), generation: 0 });
    let (epoch, seq, seen, base, batch) =
        (bench.epoch, bench.seq, bench.seen(), Tick(base).wire(), packer.bytes());
    bench.send(&HostMessage::Moves { epoch, seq, seen, mark: None, withdraw, base, batch });
    bench.seq = bench.status().next_seq;
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

/// A replacement sent at each phase of a running stroke, and for each distance of `base`: what begins before it is played as sent, then
/// either the new strokes or, if they come too late, the old ones. A stroke that `base` divides stays whole.
#[test]
fn in_every_phase_a_replacement_is_whole_or_not_at_all() {
    for shell in SHELLS {
        let (mut done, mut late, mut divided) = (0, 0, 0);
        for phase in 0..PERIOD {
            for ahead in [0, 1, 20, 63, 64, 65, 80, 100, 130, 250] {
                let mut bench = Bench::armed(shell);
                let old = train(1, bench.soon(), 12, PULSES);
                bench.strokes(&old);
                bench.run_to(old[2].up.0 + phase);
                let base = bench.now + ahead;
                let first = old.iter().find(|old| old.up.0 >= base).expect("one");
                let new = train(1, first.up.0, 9, PULSES + 9);
                let (rendered, ready) = (bench.device.rendered(), bench.device.ready());
                bench.replace(1 << 1, 0, base, &new);
                let has_begun = old.iter().any(|old| old.up.0 >= base && old.up < rendered);
                let is_kept = has_begun || first.up < ready;
                assert_eq!(kept(&bench), vec![0b10; usize::from(is_kept)], "phase {phase}, {ahead} ahead");
                bench.run(2_000);
                let stay = strokes_before(base, &old);
                let withdrawn = 2 * (old.len() - stay.len());
                divided += usize::from(!is_kept && stay.last().is_some_and(|last| last.down.0 >= base));
                let expected = if is_kept { old.clone() } else { [&stay[..], &new].concat() };
                assert_eq!(bench.bursts(1), bursts(&expected), "phase {phase}, {ahead} ticks ahead");
                let counters = bench.device.counters();
                assert_eq!((counters.dropped, counters.refused, counters.late), (0, 0, 0));
                assert_eq!(counted(counters), 2 * (old.len() + new.len()) as u64);
                assert_eq!((counters.pulses, counters.shortened), (bench.total(), 0));
                let replaced = if is_kept { 2 * new.len() } else { withdrawn } as u64;
                assert_eq!(counters.replaced, replaced);
                bench.ping(0);
                assert_eq!(bench.status().credits, POOL as u16);
                *(if is_kept { &mut late } else { &mut done }) += 1;
            }
        }
        assert!(done > 400 && (late > 100 || shell.ahead < 2), "{done} done, {late} late");
        assert!(divided > 100, "{divided} divided");
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
        assert_eq!(bench.bursts(1), bursts(old.iter().chain(&new)));
    }
}

/// The first move or stroke of each motor decides: if it is late, breaks a limit or comes too soon, the old moves stay in place. So the pin
/// comes down as planned.
#[test]
fn a_first_stroke_that_cannot_be_queued_keeps_the_old_ones() {
    let mut bench = Bench::armed(MOCK);
    let old = train(1, bench.soon(), 4, PULSES);
    bench.strokes(&old);
    bench.run_to(old[0].up.0 + 5);
    let base = old[0].up.0 + 6;
    let next = old[1].up.0;
    let harmful = [
        // The third move within a millisecond.
        stroke(1, base, 9, 10, 9),
        stroke(1, bench.device.ready().0 - 1, PULSES, HOLD, PULSES),
        stroke(1, next, 3_001, 1, 3_001),
        stroke(1, next, PULSES, HOLD, PULSES + 901),
        stroke(1, next, PULSES, 1 << 30, PULSES),
    ];
    for harmful in harmful {
        bench.replace(0b10, 0, base.min(harmful.up.0), &[harmful]);
    }
    assert_eq!(kept(&bench), [0b10; 5]);
    bench.run(1_000);
    assert_eq!(bench.bursts(1), bursts(&old));
    let counters = bench.device.counters();
    assert_eq!((counters.replaced, counters.refused, counters.late), (4, 6, 0));
}

/// A late move down lowers its pin, but not if it was to replace moves that are kept.
#[test]
fn a_late_move_of_a_kept_motor_changes_nothing() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let at = bench.soon();
        bench.moves(&[to(1, at, 100), to(1, at + 300, 50), to(1, at + 600, 0)]);
        bench.run_to(at + 200);
        let now = bench.now;
        replace(&mut bench, 0b10, now - 50, &[to(1, now - 10, 20)]);
        bench.moves(&[to(1, now - 5, 10)]);
        assert_eq!(kept(&bench), [0b10]);
        bench.run(1_000);
        let (pulses, _) = plain(&[to(1, at, 100), to(1, at + 300, 50), to(1, at + 600, 0)], bench.now);
        assert_eq!(bench.pulses(1).collect::<Vec<_>>(), pulses);
        assert_eq!((bench.device.counters().replaced, bench.device.counters().late), (2, 0));
    }
}

/// A late move ends a burst up in the tick that is rendered next; a frame that withdraws in the same tick leaves that to be done.
#[test]
fn a_burst_that_a_late_move_has_ended_ends_whatever_is_withdrawn() {
    for shell in SHELLS {
        for withdrawn in [0b10, 0b110] {
            let mut bench = Bench::armed(shell);
            let at = bench.soon();
            bench.moves(&[to(1, at, 100)]);
            bench.run_to(at + 30);
            let height = u64::from(bench.device.outstanding(1));
            let (now, missed) = (bench.now, bench.device.ready().0 - 1);
            bench.moves(&[to(1, missed, 90)]);
            replace(&mut bench, withdrawn, now, &[]);
            bench.run(5_000);
            assert_eq!(bench.bursts(1), [burst(at, Direction::Up, height)], "{shell:?}");
            assert_eq!(u64::from(bench.device.outstanding(1)), height);
        }
    }
}

/// Also one whose way up changes nothing, because the pin is there.
#[test]
fn a_stroke_is_withdrawn_whole_or_stays_whole() {
    for shell in SHELLS {
        for base in [150, 200, 201, 300, 420, 421] {
            let mut bench = Bench::armed(shell);
            let at = bench.soon();
            bench.moves(&[to(1, at, 20)]);
            bench.strokes(&[stroke(1, at + 200, 20, 200, 20)]);
            bench.replace(0b10, 0, at + base, &[]);
            bench.run(1_000);
            let stays = base > 200;
            assert_eq!(bench.net(1), if stays { 0 } else { 20 }, "{base}");
            let counters = bench.device.counters();
            assert_eq!((counters.played, counters.replaced), if stays { (3, 0) } else { (1, 2) });
        }
    }
}

/// Moves are replaced in the middle of a ramp: the pin goes on from where it is.
#[test]
fn a_ramp_is_replaced_in_the_middle() {
    for shell in SHELLS {
        for phase in 0..100 {
            let mut bench = Bench::armed(shell);
            let at = bench.soon();
            let ramp = |from: u64, levels: &[u16]| -> Vec<Move> {
                levels.iter().zip(0..).map(|(&level, k)| to(1, from + 100 * k, level)).collect()
            };
            let old = ramp(at, &[50, 120, 180, 180, 260, 200, 90, 0]);
            bench.moves(&old);
            bench.run_to(at + 150 + phase);
            let base = bench.soon();
            let new = ramp(base + 30, &[40, 10, 70, 0]);
            replace(&mut bench, 0b10, base, &new);
            assert_eq!(kept(&bench), []);
            bench.run(1_500);
            let expected = [before(base, &old), new].concat();
            let (pulses, shortened) = plain(&expected, bench.now);
            assert_eq!(bench.pulses(1).collect::<Vec<_>>(), pulses, "{phase} {shell:?}");
            assert_eq!((bench.device.counters().shortened, bench.net(1)), (shortened, 0));
            assert_eq!(counted(bench.device.counters()), 12);
        }
    }
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
        let taken = 3 * blocks.saturating_sub(3).min(8);
        assert_eq!(counted(counters), 2 * (8 * 24 + taken), "{blocks} blocks: {counters:?}");
        let withdrawn = old[0].iter().filter(|old| old.up.0 >= base).count() as u64;
        assert_eq!(counters.replaced, 2 * withdrawn * taken, "{blocks} blocks");
        assert_eq!(counters.pulses, bench.total());
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

    /// Random trains of three motors replace each other, many of them too late or on top of one another. The pins do what a plain model of the
    /// moves does that the device says it took, less those withdrawn, and every move sent is counted once.
    #[test]
    fn whatever_is_replaced_pins_follow_the_moves_taken(
        shell in prop::sample::select(SHELLS.to_vec()),
        in_pieces: bool,
        updates in prop::collection::vec((0u64..400, 0u64..8, -80i64..300, 0u64..200, 0u64..9, 1u16..40), 1..40),
    ) {
        let mut bench = Bench::armed(shell);
        bench.in_pieces = in_pieces && shell.ahead > 1;
        // Pins may stay up.
        bench.frame(Some(ONSET), bench.soon(), &[]);
        bench.run(20);
        let mut frames = Vec::new();
        for (number, (wait, motors, ahead, offset, count, pulses)) in updates.into_iter().enumerate() {
            bench.run(wait);
            let base = bench.now.wrapping_add_signed(ahead);
            let drives = (1..4u8).filter(|motor| motors >> (motor - 1) & 1 == 1);
            let mut strokes: Vec<Stroke> =
                drives.flat_map(|motor| train(motor, base + offset * u64::from(motor), count, pulses)).collect();
            strokes.sort_by_key(|stroke| stroke.up);
            strokes.truncate(32);
            bench.seq = number as u16 + 1;
            bench.replace(motors << 1, 0, base, &strokes);
            frames.push((MotorSet::from_bits(motors << 1), base, moves(&strokes)));
        }
        bench.run(4_000);
        // Each with the beginning of its stroke.
        let mut planned: [Vec<(u64, Move)>; 4] = Default::default();
        let (mut sent, mut refusals) = (0, 0);
        let reports = bench.reports();
        for (number, (motors, base, moves)) in frames.iter().enumerate() {
            let verdict = reports.iter().find_map(|report| match *report {
                Report::Verdict { seq, late, refused, kept, .. } if usize::from(seq) == number + 1 => {
                    Some((late, refused, kept))
                }
                _ => None,
            });
            let (late, refused, kept) = verdict.unwrap_or((0, 0, MotorSet::EMPTY));
            for motor in motors.without(kept).iter() {
                planned[usize::from(motor)].retain(|&(up, _)| up < *base);
            }
            for (place, to) in moves.iter().enumerate() {
                let is_taken = (late | refused) >> place & 1 == 0;
                prop_assert!(!is_taken || !kept.contains(to.motor), "of a kept motor");
                if is_taken {
                    planned[usize::from(to.motor)].push((moves[place & !1].tick.0, *to));
                }
            }
            sent += moves.len() as u64;
            refusals += u64::from(refused.count_ones());
        }
        let mut shortened = 0;
        for (motor, moves) in (0..).zip(&planned) {
            let moves: Vec<Move> = moves.iter().map(|&(_, to)| to).collect();
            let (pulses, of_motor) = plain(&moves, bench.now);
            prop_assert_eq!(bench.pulses(motor).collect::<Vec<_>>(), pulses, "{:?}", moves);
            shortened += of_motor;
        }
        let counters = bench.device.counters();
        prop_assert_eq!(counted(counters), sent);
        prop_assert_eq!((counters.dropped, counters.refused, counters.pulses), (0, refusals, bench.total()));
        prop_assert_eq!(counters.shortened, shortened);
    }
}
