//! The limits on motors that have pulses at once. [`Bench`] counts them in every tick of every test here.

use crate::bench::{
    Bench, FIRMWARE, HOST_TIMEOUT, MAX_SEEK, MOTORS, NO_LIMITS, PAPER, SHELLS, STOP, Shell, layouts, stroke,
};
use Direction::{Down, Up};
use firmware_protocol::array::Layout;
use firmware_protocol::batch::Stroke;
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{LowerStop, Op, Report, State};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use proptest::prelude::*;

fn at_once(rail_at_once: u8, chip_at_once: u8) -> PowerLimits {
    PowerLimits { rail_at_once, chip_at_once, ..NO_LIMITS }
}

fn armed_of(shell: Shell, layout: Layout, limits: PowerLimits) -> Bench {
    Bench::without_stop(Bench::of(shell, layout, Tick::BOOT), HOST_TIMEOUT, limits)
}

/// So many motors of a rail and of a chip at once, of an array.
fn at_once_of(layout: &Layout, rail_at_once: u8, chip_at_once: u8) -> PowerLimits {
    let most = layout.no_limits();
    most.min(PowerLimits { rail_at_once, chip_at_once, ..most })
}

/// What a motor does, tick by tick.
#[derive(Clone, Copy, Default)]
struct Plain {
    height: u16,
    goal: u16,
    runs: Option<Direction>,
}

impl Plain {
    fn is_busy(&self) -> bool {
        self.runs.is_some() && self.height != self.goal
    }

    fn waits(&self) -> bool {
        self.runs.is_none() && self.height > self.goal
    }
}

/// Why a group of `motor` has no room for it: as many others have pulses as may, or, for a way up, one waits to come down.
fn full(
    layout: &Layout,
    limits: PowerLimits,
    pins: &[Plain],
    motor: usize,
    way: Direction,
) -> Option<Refusal> {
    let on_rail = |other: usize| layout.rail(other) == layout.rail(motor);
    let on_chip = |other: usize| layout.chip(other) == layout.chip(motor);
    let is_full = |limit: u8, most: u8, among: &dyn Fn(usize) -> bool| {
        let others =
            || (0..pins.len()).filter(|&other| other != motor && among(other)).map(|other| pins[other]);
        let waits = way == Up && others().any(|other| other.waits());
        limit < most && (waits || others().filter(Plain::is_busy).count() >= limit.into())
    };
    if is_full(limits.rail_at_once, layout.motors_per_rail(), &on_rail) {
        return Some(Refusal::RailAtOnce);
    }
    is_full(limits.chip_at_once, layout.motors_per_chip(), &on_chip).then_some(Refusal::ChipAtOnce)
}

/// The bursts of each motor, and the refused strokes, of strokes that leave time between those of a motor.
fn plain(
    layout: &Layout,
    limits: PowerLimits,
    strokes: &[Stroke],
    end: u64,
) -> (Vec<Vec<(u64, Direction)>>, Vec<Report>) {
    let mut pins = vec![Plain::default(); layout.motors()];
    let (mut pulses, mut reports) = (vec![Vec::new(); layout.motors()], Vec::new());
    let mut left_out = vec![false; strokes.len()];
    for tick in strokes[0].up.0..end {
        for motor in 0..pins.len() {
            if !pins[motor].is_busy() {
                pins[motor].runs = None;
            }
            let begins = |stroke: &Stroke| usize::from(stroke.motor) == motor && stroke.up.0 == tick;
            let ends = |stroke: &Stroke| usize::from(stroke.motor) == motor && stroke.down.0 == tick;
            if let Some(index) = strokes.iter().position(begins) {
                match full(layout, limits, &pins, motor, Up) {
                    None => (pins[motor].goal, pins[motor].runs) = (strokes[index].level, Some(Up)),
                    Some(reason) => {
                        left_out[index] = true;
                        reports.push(Report::Refused { motor: motor as u8, tick: Tick(tick).wire(), reason });
                    }
                }
            } else if strokes.iter().zip(&left_out).any(|(stroke, left_out)| ends(stroke) && !left_out) {
                pins[motor].goal = 0;
            }
            if pins[motor].waits() && full(layout, limits, &pins, motor, Down).is_none() {
                pins[motor].runs = Some(Down);
            }
        }
        for (pin, pulses) in pins.iter_mut().zip(&mut pulses) {
            let Some(way) = pin.runs.filter(|_| pin.height != pin.goal) else { continue };
            pulses.push((tick, way));
            pin.height = if way == Up { pin.height + 1 } else { pin.height - 1 };
        }
    }
    (pulses, reports)
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

    /// Neither one stroke too many nor one too few is refused, and pins wait no longer than they must.
    #[test]
    fn strokes_are_played_as_a_plain_count_says(
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
            // By then a pin is down that had to wait for all others.
            free[usize::from(motor)] = one.down.0 + 64 * 40;
            strokes.push(one);
        }
        strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
        let base = strokes[0].up.0;
        for part in strokes.chunks(8) {
            bench.frame(None, base, crate::bench::pack(base, part).bytes());
        }
        let end = strokes.iter().map(|one| one.down.0).max().unwrap_or(0) + 64 * 40;
        let (pulses, refused) = plain(&layout, limits, &strokes, end);
        bench.run_to(end);
        let reports = bench.reports();
        // So many strokes of few motors are another test's.
        prop_assume!(!reports.iter().any(|report| matches!(report, Report::Refused { reason: Refusal::Dense, .. })));
        prop_assert_eq!(reports, refused);
        for (motor, wanted) in (0..).zip(pulses) {
            prop_assert_eq!(bench.pulses(motor).collect::<Vec<_>>(), wanted, "motor {}", motor);
        }
        let counters = bench.device.counters();
        prop_assert_eq!((counters.played + counters.refused, counters.shortened), (2 * strokes.len() as u64, 0));
    }

    /// Pins that return take turns, and are down in the time that the report of the cut says: after a stop in any phase, and at `arm` after an
    /// e-stop.
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
    // In the order of the motors' numbers: with 2 and 1 the last motor waits for the chip, while the rail has a place.
    for (rail, chip, turns) in
        [(6, 2, 1), (5, 2, 2), (3, 2, 2), (2, 2, 3), (1, 2, 6), (6, 1, 2), (4, 1, 2), (2, 1, 4), (1, 1, 6)]
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
        assert!(u64::from(PAPER.turns(&limits)) >= turns, "{limits:?}");
        assert_eq!(bench.total(), MOTORS as u64 * u64::from(MAX_SEEK));
        let chips = if chip == 1 { 3 } else { 6 };
        assert_eq!(bench.most_at_once[0], u32::from(rail.min(chips)), "{limits:?}");
    }
}
