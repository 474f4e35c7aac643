//! Replacements at the maximum load: 24 motors at 300 Hz, strokes queued 100 ms ahead, 200 replacements a second.
//!
//! The example `margin` prints the least time left to render in each of these conditions.

use crate::hand::Hand;
use crate::margin::TIME;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::time::MS;
use meissner_test_support::paper::MOTORS;

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
            self.hand.replace(motors, base, new, true);
        }
        self.extend(until);
    }

    fn busy(&mut self) -> u64 {
        self.hand.chip().busy_cycles()
    }
}

/// Plays, prints the least ticks left to render and the share of the time for which the core was busy, and returns whether half
/// of the time is left.
pub(crate) fn load((slow, replaced, in_phase): Condition) -> bool {
    let which = Which::Chip(ChipOptions { slow, ..ChipOptions::new(1) });
    let mut hand = Hand::armed(&which, 25_500);
    let begin = hand.tick() + 30 * TICKS;
    let offset = |motor: usize| if in_phase { 0 } else { motor as u64 * PERIOD / MOTORS as u64 };
    let first = std::array::from_fn(|motor| begin + offset(motor));
    let mut load = Load { hand, replaced, first, queued: Default::default() };
    for sixth in 1..=6 {
        load.extend(begin + replaced.lead() * sixth / 6);
        load.hand.settle();
    }
    load.hand.slack();
    let (from, busy, sent) = (load.hand.now(), load.busy(), load.hand.sent);
    load.hand.chip().profile(true).unwrap();
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
    let longest = load.hand.chip().profile(false).unwrap().longest.into_iter();
    let longest =
        longest.filter(|(function, _)| function.contains("take_moves")).map(|(_, cycles)| cycles).max();
    let share = (load.busy() - busy) as f64 / elapsed as f64;
    load.hand.settle();
    let slack = u64::from(load.hand.slack().unwrap());
    let verdicts = load.hand.verdicts(0);
    assert_eq!((verdicts.kept, verdicts.late), (0, 0), "{replaced:?}");
    let (_, counters) = load.hand.finish(false);
    let per_s = |count: u64| (count * 1_000 * MS) as f64 / elapsed as f64;
    println!(
        "core at {:.0} %, {} motors at 300 Hz{}, {replaced:?} replaced at {:.0} Hz: of {TIME} ticks, {slack} are left at least; {:.0} moves/s \
         sent, {:.0} % busy, at most {} cycles to take a piece of a frame; {} of {} moves replaced",
        100.0 / slow,
        replaced.motors(),
        if in_phase { " in phase" } else { "" },
        per_s(rounds),
        per_s(sent),
        100.0 * share,
        longest.unwrap_or(0),
        counters.replaced,
        counters.replaced + counters.played,
    );
    2 * slack >= TIME
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
