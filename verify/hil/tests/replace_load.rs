//! What a host may send besides strokes at the maximum load: replacements, 24 motors at 300 Hz, strokes queued 100 ms ahead, 200
//! replacements a second; and rows of levels.
//!
//! The example `margin` prints the least time left to render in each of these conditions.

use crate::hand::Hand;
use crate::margin::TIME;
use crate::random::uniform;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::BLOCK;
use firmware_protocol::message::{Mark, MarkKind};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::time::{MS, TICK};
use meissner_test_support::paper::MOTORS;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Ticks of a period at 300 Hz, and pulses of a burst.
const PERIOD: u64 = 283;
const PULSES: u16 = 60;
/// Ticks of a millisecond.
const TICKS: u64 = 85;
/// Cycles between two replacements.
const EVERY: u64 = 5 * MS;
/// Milliseconds of a play.
const PLAY: u64 = 300;
const ALL: u32 = (1 << MOTORS) - 1;

/// What is replaced each time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Replaced {
    /// Nothing: the same play.
    Nothing,
    /// All that one motor has queued, motor by motor.
    Motor,
    /// The end of the longest queues that the pool can hold, 135 ms, of all motors: each withdrawal looks through one.
    Tails,
    /// The same, in a frame that has no strokes.
    TailsByNothing,
    /// The end of what three motors have queued, if these alone play with a lead that fills the pool, 1.1 s.
    ThreeTails,
    /// The same of one motor, 3.3 s.
    OneTail,
    /// All that each motor has queued, with a lead of so many ms instead of 100.
    All(u64),
    /// All that each motor has queued, as soon as the device has taken the replacement before.
    Always,
}

/// A core slower by this factor, what is replaced, and whether all motors are in phase.
pub(crate) type Condition = (f64, Replaced, bool);

/// The conditions whose time left is measured. A core a tenth slower has no time to do more besides the play.
pub(crate) const CONDITIONS: [Condition; 15] = [
    (1.0, Replaced::Nothing, true),
    (1.1, Replaced::Nothing, true),
    (1.1, Replaced::Motor, true),
    (1.1, Replaced::Motor, false),
    (1.0, Replaced::Tails, true),
    (1.1, Replaced::Tails, true),
    (1.1, Replaced::Tails, false),
    (1.1, Replaced::TailsByNothing, true),
    (1.0, Replaced::TailsByNothing, false),
    (1.1, Replaced::ThreeTails, true),
    (1.1, Replaced::OneTail, true),
    (1.1, Replaced::All(20), true),
    (1.0, Replaced::All(20), false),
    (1.1, Replaced::Always, true),
    (1.1, Replaced::Always, false),
];

impl Replaced {
    /// The motors that play: the first ones.
    const fn motors(self) -> usize {
        match self {
            Self::OneTail => 1,
            Self::ThreeTails => 3,
            _ => MOTORS,
        }
    }

    /// Ticks for which strokes are queued.
    const fn lead(self) -> u64 {
        TICKS
            * match self {
                Self::All(ms) => ms,
                Self::Tails | Self::TailsByNothing => 135,
                Self::ThreeTails => 1_100,
                Self::OneTail => 3_300,
                Self::Nothing | Self::Motor => 100,
                // Twice as many strokes fit the pool.
                Self::Always => 60,
            }
    }
}

/// Strokes of a motor from `up` on.
fn train(motor: u8, up: Tick, until: Tick, up_pulses: u16) -> Vec<Stroke> {
    let ups = (0..).map(|n| up + n * PERIOD).take_while(|&up| up < until);
    let stroke = |up: Tick| {
        let down = up + PERIOD / 2;
        Stroke { motor, up, up_pulses, down, down_pulses: up_pulses }
    };
    ups.map(stroke).collect()
}

/// Strokes that go on without an end, and are replaced.
struct Load {
    hand: Hand,
    replaced: Replaced,
    /// The first up tick of each motor, and the strokes that it has queued.
    first: [Tick; MOTORS],
    queued: [Vec<Stroke>; MOTORS],
}

impl Load {
    /// Appends strokes to each motor up to `until`.
    fn extend(&mut self, until: Tick) {
        let mut new = Vec::new();
        for (motor, strokes) in self.queued.iter_mut().enumerate().take(self.replaced.motors()) {
            let up = strokes.last().map_or(self.first[motor], |last| last.up + PERIOD);
            let more = train(motor as u8, up, until, PULSES);
            strokes.extend(&more);
            new.extend(more);
        }
        self.hand.append(new);
    }

    /// The next replacement: the strokes begin when the old ones would have, with other pulses.
    fn replace(&mut self, round: u64) {
        let now = self.hand.tick();
        let (motors, base) = match self.replaced {
            Replaced::Nothing => (0, now),
            Replaced::Motor => (1 << (round % MOTORS as u64), now + 10 * TICKS),
            Replaced::Tails | Replaced::TailsByNothing => (ALL, now + 125 * TICKS),
            Replaced::ThreeTails => (0b111, now + 1_090 * TICKS),
            Replaced::OneTail => (1, now + 3_290 * TICKS),
            Replaced::All(_) | Replaced::Always => (ALL, now + 5 * TICKS),
        };
        let until = now + self.replaced.lead();
        let mut new = Vec::new();
        for (motor, strokes) in self.queued.iter_mut().enumerate() {
            strokes.retain(|stroke| stroke.end() > now);
            if motors >> motor & 1 == 0 {
                continue;
            }
            let withdrawn = strokes.split_off(strokes.partition_point(|stroke| stroke.up < base));
            if let (Some(first), true) = (withdrawn.first(), self.replaced != Replaced::TailsByNothing) {
                strokes.extend(train(motor as u8, first.up, until, PULSES + (round % 7) as u16));
            }
            new.extend(strokes.iter().filter(|stroke| stroke.up >= base));
        }
        if motors != 0 {
            self.hand.replace(motors, base, new);
        }
        self.extend(until);
    }
}

/// Plays, prints the least ticks left to render and the share of the time for which the core was busy, and returns whether half
/// of the time is left.
pub(crate) fn load((slow, replaced, in_phase): Condition) -> bool {
    let hand = Hand::armed(&ChipOptions { slow, ..ChipOptions::new(1) }, 25_500);
    let begin = hand.tick() + 30 * TICKS;
    let offset = |motor: usize| if in_phase { 0 } else { motor as u64 * PERIOD / MOTORS as u64 };
    let first = std::array::from_fn(|motor| begin + offset(motor));
    let mut load = Load { hand, replaced, first, queued: Default::default() };
    for sixth in 1..=6 {
        load.extend(begin + replaced.lead() * sixth / 6);
        load.hand.settle();
    }
    load.hand.slack();
    let (from, busy, sent) = (load.hand.now(), load.hand.chip.busy_cycles(), load.hand.sent);
    let mut rounds = 0;
    while load.hand.now() < from + PLAY * MS {
        load.replace(rounds);
        rounds += 1;
        if replaced == Replaced::Always {
            load.hand.settle();
        } else {
            load.hand.run_to(from + rounds * EVERY);
        }
    }
    let elapsed = load.hand.now() - from;
    let sent = load.hand.sent - sent;
    let share = (load.hand.chip.busy_cycles() - busy) as f64 / elapsed as f64;
    load.hand.settle();
    let slack = load.hand.slack();
    let counters = load.hand.finish(replaced.lead() / TICKS + 20);
    let per_s = |count: u64| (count * 1_000 * MS) as f64 / elapsed as f64;
    println!(
        "core at {:.0} %, {} motors at 300 Hz{}, {replaced:?} replaced at {:.0} Hz: of {TIME} ticks, {slack} are left at least; {:.0} moves/s \
         sent, {:.0} % busy; {} of {} moves replaced",
        100.0 / slow,
        replaced.motors(),
        if in_phase { " in phase" } else { "" },
        per_s(rounds),
        per_s(sent),
        100.0 * share,
        counters.replaced,
        counters.replaced + counters.played,
    );
    2 * slack >= TIME
}

/// Ticks of the grid of 500 moves a second.
const GRID: u64 = 170;

/// Rows of all motors, 500 a second, with levels below `most` that change with each row: 12 000 moves a second. Prints the load and
/// the least time left to render, and returns whether half of it is left, or a block to a slower core.
pub(crate) fn rows(slow: f64, most: u64) -> bool {
    let mut hand = Hand::armed(&ChipOptions { slow, ..ChipOptions::new(1) }, 25_500);
    let base = hand.tick() + 3_000;
    let mut random = ChaCha8Rng::seed_from_u64(most);
    let (mut from, mut busy) = (0, 0);
    hand.slack();
    for pair in 0..150 {
        let tick = base + 2 * pair * GRID;
        let mut packer = Packer::<BATCH_BYTES>::new(tick);
        for row in 0..2 {
            let levels: Vec<_> = (0..MOTORS).map(|_| uniform(&mut random, 0.0, most as f64) as u16).collect();
            packer.row(tick + row * GRID, MotorSet::from_bits(ALL.into()), &levels).unwrap();
        }
        // The first frame of the play has as many moves as it may.
        let mark = (pair == 0).then_some(Mark { kind: MarkKind::Play, trigger: None, hold: 0 });
        hand.moves(&packer, mark, 0);
        if pair == 10 {
            (from, busy) = (hand.now(), hand.chip.busy_cycles());
        }
        hand.run(2 * GRID * TICK);
    }
    let load = (hand.chip.busy_cycles() - busy) as f64 / (hand.now() - from) as f64;
    let left = hand.slack();
    let counters = hand.finish(250);
    println!(
        "core at {:.0} %, 24 motors x 500 moves/s in rows, levels below {most}: {:.1} % busy, of {TIME} ticks {left} are left at least; \
         {} played, {} shortened",
        100.0 / slow,
        100.0 * load,
        counters.played,
        counters.shortened
    );
    if slow > 1.0 { left >= BLOCK.into() } else { 2 * left >= TIME }
}

/// Bursts that end before the next row, and bursts that each row cuts.
pub(crate) const ROWS: [(f64, u64); 4] = [(1.0, 150), (1.1, 150), (1.0, 700), (1.1, 700)];

#[test]
fn half_of_the_time_is_left_while_all_motors_follow_rows() {
    assert!(ROWS.into_iter().all(|(slow, most)| rows(slow, most)));
}

#[cfg(test)]
fn half_is_left(in_phase: bool) {
    let conditions = CONDITIONS.into_iter().filter(|condition| condition.2 == in_phase);
    let short: Vec<_> = conditions.filter(|&condition| !load(condition)).collect();
    assert!(short.is_empty(), "{short:?}");
}

#[test]
fn half_of_the_time_is_left_while_full_load_is_replaced() {
    half_is_left(false);
}

#[test]
fn half_of_the_time_is_left_while_full_load_in_phase_is_replaced() {
    half_is_left(true);
}
