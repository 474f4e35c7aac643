//! Finds when an afferent's state repeats, so that the rest need not be computed again.
//!
//! This needs an afferent without noise, and drives that repeat to the tick. If its whole state at one multiple of the common
//! period equals, bit by bit, its state at an earlier multiple, everything between them repeats. [`Cycle`] searches with Brent's
//! cycle-finding algorithm: it compares each state with one kept state, which it renews at each power of 2.
//!
//! Invariant: states are compared in all their bits, with times relative to their own multiple of the period.

use crate::member::numbers;
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::{Array, ArraySpec};

/// Periods after which the search for a repetition ends.
const MAX_PERIODS: u64 = 1024;
/// The most cycles that a drive may take to repeat to the tick.
const MAX_CYCLES: u64 = 2048;

/// Numbers in a state.
const PARTS: usize = 7;
/// A lane's state, with instants relative to the time of comparison.
pub(crate) type State = [f64; PARTS];

/// The periods of a scene's motors, in ticks: 0 at rest, none if the motor does not repeat to the tick.
pub(crate) type Periods = PerMotor<Option<u64>>;

/// The periods of a scene's motors until `end`, half ticks.
pub(crate) fn periods(array: Array, drives: &[Drive], end: f64) -> Periods {
    PerMotor::from_fn(array, |motor| {
        let mut drives = drives.iter().filter(|drive| drive.motor == motor);
        match (drives.next(), drives.next()) {
            (None, _) => Some(0),
            (Some(drive), None) => period(array, drive, end),
            (Some(_), Some(_)) => None,
        }
    })
}

/// The shortest time, in ticks, by which each edge before `end` is followed by another of its kind.
fn period(array: Array, drive: &Drive, end: f64) -> Option<u64> {
    let wave = drive.wave(array).ok()?;
    if !wave.moves() {
        return Some(0);
    }
    if drive.start_s.is_some_and(|start| start > 0.0) || drive.stop_s.is_some() {
        return None;
    }
    let ends = (end / 2.0) as u64;
    (1..=MAX_CYCLES).find_map(|cycles| {
        let ticks = wave.edge(2 * cycles) - wave.edge(0);
        if ticks > ends / 3 {
            return None;
        }
        // Check the first few edges, which nearly always decide, and then all.
        let repeats = |h: u64| wave.edge(h + 2 * cycles) == wave.edge(h) + ticks;
        ((0..64).all(repeats) && (64..).take_while(|&h| wave.edge(h) < ends).all(repeats)).then_some(ticks)
    })
}

/// The search for repetitions in the lanes of a group.
#[derive(Debug)]
pub(crate) struct Cycle<const LANES: usize> {
    /// Half ticks.
    period: f64,
    /// The next multiple at which states are compared.
    pub(crate) next: f64,
    /// The kept states, and their time.
    kept: [State; LANES],
    kept_at: f64,
    count: u64,
    renewed: u64,
}

/// The result of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// Lanes whose state equals the kept one, one bit each, and how many half ticks ago that was.
    pub(crate) repeats: u32,
    pub(crate) ago: f64,
    /// Whether these states are now the kept ones.
    pub(crate) kept: bool,
    /// Whether the search ends.
    pub(crate) given_up: bool,
}

impl<const LANES: usize> Cycle<LANES> {
    /// The search for a group that these motors reach (one bit each). None if together they do not repeat often enough before
    /// `end`.
    pub(crate) fn new(array: &ArraySpec, periods: &Periods, motors: u64, end: f64) -> Option<Self> {
        let mut common: u64 = 1;
        for motor in numbers(motors) {
            match periods[motor]? {
                0 => {}
                period => common = least_common_multiple(common, period)?,
            }
        }
        if common == 1 {
            return None;
        }
        // Long enough that at the second multiple the window no longer covers the beginning.
        let period = common * array.motor().window_half_ticks.div_ceil(common);
        let period = 2.0 * period as f64;
        let cycle = Self {
            period,
            next: 2.0 * period,
            kept: [[f64::NAN; PARTS]; LANES],
            kept_at: 0.0,
            count: 0,
            renewed: 0,
        };
        (4.0 * period < end).then_some(cycle)
    }

    /// Compares the states at [`Self::next`] with the kept ones.
    pub(crate) fn compare(&mut self, states: &[State; LANES]) -> Comparison {
        let now = self.next;
        self.next += self.period;
        self.count += 1;
        // The first kept state is NaN, so no state equals it.
        let repeats = (0..LANES).filter(|&lane| states[lane] == self.kept[lane]);
        let repeats = repeats.fold(0, |lanes, lane| lanes | 1 << lane);
        let ago = now - self.kept_at;
        let kept = self.count > 2 * self.renewed;
        if kept {
            (self.renewed, self.kept, self.kept_at) = (self.count, *states, now);
        }
        Comparison { repeats, ago, kept, given_up: self.count > MAX_PERIODS }
    }
}

fn least_common_multiple(a: u64, b: u64) -> Option<u64> {
    let (mut x, mut y) = (a, b);
    while y > 0 {
        (x, y) = (y, x % y);
    }
    // Beyond this the common period is longer than any scene.
    (a / x).checked_mul(b).filter(|&common| common < 1 << 50)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(motor: u8, frequency_hz: f64) -> Drive {
        Drive { motor, frequency_hz, amplitude_um: 80.0, phase: 0.3, start_s: None, stop_s: None }
    }

    fn of(drive: Drive, seconds: f64) -> Option<u64> {
        periods(Array::paper(), &[drive], seconds * 170_000.0)[usize::from(drive.motor)]
    }

    #[test]
    fn a_period_is_the_least_that_repeats_to_the_tick() {
        assert_eq!(of(drive(3, 60.0), 10.0), Some(4250));
        assert_eq!(of(drive(3, 50.0), 10.0), Some(1700));
        assert_eq!(of(drive(3, 85_000.0 / 1700.5), 10.0), Some(3401));
        assert_eq!(of(drive(3, 60.0 * std::f64::consts::PI), 10.0), None);
        // The scene is shorter than three periods.
        assert_eq!(of(drive(3, 60.0), 0.14), None);
        assert_eq!(of(Drive { amplitude_um: 0.01, ..drive(3, 60.0) }, 10.0), Some(0));
        assert_eq!(of(Drive { start_s: Some(0.1), ..drive(3, 60.0) }, 10.0), None);
        assert_eq!(of(Drive { stop_s: Some(5.0), ..drive(3, 60.0) }, 10.0), None);
        let end = 10.0 * 170_000.0;
        let periods = periods(Array::paper(), &[drive(0, 60.0), drive(1, 50.0), drive(1, 50.0)], end);
        assert_eq!((periods[0], periods[1], periods[2]), (Some(4250), None, Some(0)));
    }

    #[test]
    fn a_group_repeats_with_the_motors_that_reach_it() {
        let end = 10.0 * 170_000.0;
        let periods = periods(Array::paper(), &[drive(0, 60.0), drive(1, 50.0), drive(2, 61.803_398)], end);
        assert_eq!(periods[2], None);
        let period =
            |motors, end| Cycle::<8>::new(&Array::paper(), &periods, motors, end).map(|cycle| cycle.period);
        assert_eq!(period(0b01, end), Some(8500.0));
        assert_eq!(period(0b11, end), Some(17_000.0));
        assert_eq!(period(0b111, end), None);
        assert_eq!(period(0b1000, end), None);
        assert_eq!(period(0b11, 60_000.0), None);
    }

    #[test]
    fn a_period_shorter_than_the_window_is_taken_several_times() {
        let mut periods = PerMotor::all(Array::paper(), Some(0));
        periods[0] = Some(100);
        let cycle = Cycle::<8>::new(&Array::paper(), &periods, 1, 1e6).unwrap();
        // At the first comparison, at 3200 half ticks, the window holds nothing from before the first period.
        assert_eq!((cycle.period, cycle.next), (1600.0, 3200.0));
    }
}
