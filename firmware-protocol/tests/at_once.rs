//! The limits on motors that have pulses at once. [`Bench`] counts them in every tick of every test here.

use crate::bench::{
    Bench, FIRMWARE, HOST_TIMEOUT, MAX_SEEK, MOTORS, NO_LIMITS, PAPER, SHELLS, STOP, Shell, layouts, stroke,
};
use firmware_protocol::array::Layout;
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{LowerStop, Op, Report, State};
use firmware_protocol::stroke::{Direction, Stroke};
use firmware_protocol::tick::Tick;
use proptest::prelude::*;

fn at_once(rail_at_once: u8, chip_at_once: u8) -> PowerLimits {
    PowerLimits { rail_at_once, chip_at_once, ..NO_LIMITS }
}

fn armed(shell: Shell, limits: PowerLimits) -> Bench {
    armed_of(shell, PAPER, limits)
}

fn armed_of(shell: Shell, layout: Layout, limits: PowerLimits) -> Bench {
    Bench::without_stop(Bench::of(shell, layout, Tick::BOOT), HOST_TIMEOUT, limits)
}

/// So many motors of a rail and of a chip at once, of an array.
fn at_once_of(layout: &Layout, rail_at_once: u8, chip_at_once: u8) -> PowerLimits {
    let most = layout.no_limits();
    most.min(PowerLimits { rail_at_once, chip_at_once, ..most })
}

#[test]
fn the_stroke_that_would_be_one_too_many_is_refused_whole_and_named() {
    for shell in SHELLS {
        for (limits, others, reason) in
            [(at_once(2, 2), [7, 8, 9], Refusal::RailAtOnce), (at_once(6, 1), [6, 8, 7], Refusal::ChipAtOnce)]
        {
            // In its up burst, in its down burst, and beside them.
            for (from, refused) in [(3, true), (207, true), (10, false), (-300, false)] {
                let mut bench = armed(shell, limits);
                let soon = bench.soon() + 300;
                let [first, second, third] = others;
                let mut strokes = vec![stroke(first, soon, 10, 190, 10), stroke(second, soon, 10, 190, 10)];
                let last = stroke(third, soon.wrapping_add_signed(from), 4, 100, 4);
                strokes.insert(if from < 0 { 0 } else { 2 }, last);
                // The next rail is counted by itself.
                strokes.push(stroke(12, soon, 10, 190, 10));
                strokes.sort_by_key(|stroke| stroke.up);
                bench.strokes(&strokes);
                bench.run(1_000);
                let report = Report::Refused { motor: third, up: last.up.wire(), reason };
                let reports = if refused { vec![report] } else { vec![] };
                assert_eq!(bench.reports(), reports, "{limits:?} {from} {shell:?}");
                let counters = bench.device.counters();
                assert_eq!((counters.played, counters.refused), if refused { (6, 2) } else { (8, 0) });
            }
        }
    }
}

#[test]
fn a_begun_stroke_is_not_amended_to_break_the_limit() {
    for shell in SHELLS {
        let mut bench = armed(shell, at_once(1, 2));
        let begun = stroke(3, bench.soon(), 20, 200, 20);
        let next = stroke(4, begun.end().0, 10, 50, 10);
        bench.strokes(&[begun, next]);
        bench.run_to(begun.up.0 + 50);
        // Shorter, so that another one may begin earlier; then it may not become longer again.
        let third = stroke(5, begun.down.0 + 16, 3, 300, 3);
        bench.amend(1, &begun, Direction::Down, 16);
        bench.strokes(&[third]);
        bench.run_to(begun.down.0 - 64 - 5);
        bench.amend(2, &begun, Direction::Down, 18);
        // The rendered end lies before the third stroke: it has not begun, and is refused.
        bench.run(1_000);
        let played = bench.bursts(3)[1].pulses;
        let refused = bench.device.counters().refused;
        assert_eq!((played, refused), (18, 2), "{shell:?}");

        let mut bench = armed(shell, at_once(1, 2));
        let begun = stroke(3, bench.soon(), 20, 200, 20);
        // Its down burst begins where that of the first ends.
        let inner = stroke(4, begun.up.0 + 30, 10, 200, 10);
        bench.strokes(&[begun, inner]);
        bench.run_to(begun.up.0 + 100);
        bench.amend(1, &begun, Direction::Down, 21);
        assert_eq!(bench.device.counters().amendments_ignored, 1, "{shell:?}");
        bench.amend(2, &begun, Direction::Down, 18);
        bench.amend(3, &begun, Direction::Down, 20);
        assert_eq!(bench.device.counters().amendments_ignored, 1, "{shell:?}");
        bench.run(1_000);
        assert_eq!((bench.bursts(3)[1].pulses, bench.device.counters().played), (20, 4));
    }
}

/// What a controller without cuts has to play: a stroke that begins is refused if some tick of it has too many.
#[derive(Default)]
struct Plain {
    at_once: std::collections::HashMap<(usize, u64), usize>,
}

impl Plain {
    fn groups(layout: &Layout, stroke: &Stroke, limits: PowerLimits) -> [(usize, usize); 2] {
        let motor = usize::from(stroke.motor);
        [
            (layout.rail(motor).into(), limits.rail_at_once.into()),
            (100 + usize::from(layout.chip(motor)), limits.chip_at_once.into()),
        ]
    }

    fn takes(&mut self, layout: &Layout, stroke: &Stroke, limits: PowerLimits) -> bool {
        let ticks = || stroke.bursts().into_iter().flat_map(|burst| burst.start.0..burst.end().0);
        let groups = Self::groups(layout, stroke, limits);
        let fits = groups.iter().all(|&(group, limit)| {
            ticks().all(|tick| self.at_once.get(&(group, tick)).copied().unwrap_or(0) < limit)
        });
        for (group, _) in groups.into_iter().filter(|_| fits) {
            ticks().for_each(|tick| *self.at_once.entry((group, tick)).or_default() += 1);
        }
        fits
    }
}

/// Asserts that the returns after `cut` are over within `turns` times the longest outstanding return.
fn returns_in_time(bench: &Bench, limits: PowerLimits, cut: u64) -> Result<(), TestCaseError> {
    let bursts = (0..bench.layout().motors() as u8).flat_map(|motor| bench.bursts(motor));
    let longest = bursts.filter(|burst| burst.end().0 > cut).map(|burst| u64::from(burst.pulses)).max();
    let end = bench.last_pulse().unwrap_or(0) + 1;
    let most = cut + u64::from(bench.layout().turns(&limits)) * longest.unwrap_or(0);
    prop_assert!(end <= most, "{} ticks, longest {longest:?}, {limits:?}", end.saturating_sub(cut));
    if longest.is_some() {
        bench.last_cut();
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, rng_seed: proptest::test_runner::RngSeed::Fixed(36), ..ProptestConfig::default() })]

    /// Neither one stroke too many nor one too few is refused.
    #[test]
    fn strokes_are_refused_as_a_plain_count_says(
        shell in prop::sample::select(SHELLS.to_vec()),
        layout in layouts(),
        rail in 1u8..=8,
        chip in 1u8..=3,
        sent in prop::collection::vec((0u8..12, 0u64..30, 1u16..40, 0u64..120), 1..40),
    ) {
        let limits = at_once_of(&layout, rail, chip);
        let motors = layout.motors() as u8;
        let mut bench = armed_of(shell, layout, limits);
        let mut up = bench.soon();
        let mut strokes = Vec::new();
        let mut free = [0; 64];
        for (motor, after, pulses, hold) in sent {
            let motor = motor % motors;
            up += after;
            let one = stroke(motor, up.max(free[usize::from(motor)]), pulses, hold, pulses);
            free[usize::from(motor)] = one.end().0.max(one.up.0 + u64::from(layout.least_apart()));
            strokes.push(one);
        }
        strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
        let base = strokes[0].up.0;
        for part in strokes.chunks(8) {
            bench.frame(None, base, crate::bench::pack(base, part).bytes());
        }
        let mut plain = Plain::default();
        let refused: Vec<_> = strokes.iter().filter(|one| !plain.takes(&layout, one, limits)).map(|one| (one.motor, one.up.wire())).collect();
        bench.run_to(strokes.iter().map(|one| one.end().0).max().unwrap_or(0) + 200);
        let mut reported = Vec::new();
        for report in bench.reports() {
            let Report::Refused { motor, up, reason } = report else { panic!("{report:?}") };
            // So many strokes of few motors are another test's.
            prop_assume!(reason != Refusal::Dense);
            reported.push((motor, up));
        }
        prop_assert_eq!(reported, refused);
    }

    /// Pins that return take turns, and no more of them than needed: after a stop in any phase, and at `arm` after an e-stop.
    #[test]
    fn returns_take_turns_in_time(
        shell in prop::sample::select(SHELLS.to_vec()),
        layout in layouts(),
        rail in 1u8..=8,
        chip in 1u8..=3,
        sent in prop::collection::vec((0u8..12, 0u64..60, 1u16..100, 0u64..200), 1..16),
        run in 0u64..500,
        stops in any::<bool>(),
    ) {
        let limits = at_once_of(&layout, rail, chip);
        let motors = layout.motors() as u8;
        let mut bench = armed_of(shell, layout, limits);
        let (soon, mut busy, mut from) = (bench.soon(), 0u16, 0);
        for (motor, after, pulses, hold) in sent {
            let motor = motor % motors;
            from += after;
            if busy >> motor & 1 == 0 {
                busy |= 1 << motor;
                bench.strokes(&[stroke(motor, soon + from, pulses, hold, pulses)]);
            }
        }
        bench.run_to(soon + run);
        if stops {
            let cut = bench.device.ready().0;
            bench.control(Op::Stop);
            bench.settle();
            returns_in_time(&bench, limits, cut)?;
        } else {
            bench.control(Op::EStop);
            bench.run(100);
            bench.control(Op::Reset);
            let cut = bench.device.ready().0;
            bench.control(Op::Arm { assume_rest: false, host_timeout: HOST_TIMEOUT, limits, lower_stop: None });
            bench.settle();
            returns_in_time(&bench, limits, cut)?;
        }
        prop_assert_eq!(bench.device.state(), State::Armed);
        for motor in 0..motors {
            prop_assert_eq!(bench.net(motor), 0);
        }
    }
}

#[test]
fn a_seek_takes_turns_at_each_limit() {
    for (rail, chip, turns) in
        [(6, 2, 1), (5, 2, 2), (3, 2, 2), (2, 2, 3), (1, 2, 6), (6, 1, 2), (4, 1, 2), (2, 1, 3), (1, 1, 6)]
    {
        let limits = at_once(rail, chip);
        let mut bench = Bench::new(FIRMWARE);
        bench.hello(1);
        let ready = bench.device.ready().0;
        let lower_stop = Some(LowerStop { seek: MAX_SEEK, ..STOP });
        bench.control(Op::Arm { assume_rest: false, host_timeout: 10 * 85_000, limits, lower_stop });
        bench.settle();
        assert_eq!(bench.device.state(), State::Armed);
        let took = bench.last_pulse().map(|last| last + 1 - ready);
        assert_eq!(took, Some(turns * u64::from(MAX_SEEK)), "{limits:?}");
        assert_eq!(bench.last_cut().outstanding, MOTORS as u32 * u32::from(MAX_SEEK));
        assert_eq!(u64::from(PAPER.turns(&limits)), turns);
        assert_eq!(bench.total(), MOTORS as u64 * u64::from(MAX_SEEK));
        let chips = if chip == 1 { 3 } else { 6 };
        assert_eq!(bench.most_at_once[0], u32::from(rail.min(chips)), "{limits:?}");
    }
}
