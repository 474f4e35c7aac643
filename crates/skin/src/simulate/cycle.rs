//! When a receptor's state repeats, so that what follows need not be computed again.
//!
//! Without noise, and with drives that repeat to the tick, a receptor whose whole state is at one multiple of the common
//! period what it was at an earlier one, bit by bit, goes on as it went on then. Whether that happens is watched
//! as Brent does for cycles of any function: the state is compared with one kept, which is renewed at each power of 2.
//!
//! Invariant: states are compared relative to their own multiple of the period, and all of their bits.

use super::exact::LANES;
use firmware_protocol::stroke::MOTORS;
use meissner_array::motor::WINDOW_HALF_TICKS;
use meissner_array::pattern::Drive;

/// Periods after which nobody waits for a repetition any more.
const PATIENCE: u64 = 1024;
/// How long a period may be looked for in multiples of a drive's own.
const MULTIPLES: u64 = 2048;

/// Numbers of a state.
const PARTS: usize = 7;
/// A lane's state, instants relative to when it is looked at.
pub(super) type State = [f64; PARTS];

/// The periods of the motors of a scene, in ticks; 0: at rest; none: the motor does not repeat to the tick.
pub(super) type Periods = [Option<u64>; MOTORS];

/// Those of a scene's drives until `end`, half ticks.
pub(super) fn periods(drives: &[Drive], end: f64) -> Periods {
    std::array::from_fn(|motor| {
        let mut drives = drives.iter().filter(|drive| usize::from(drive.motor) == motor);
        match (drives.next(), drives.next()) {
            (None, _) => Some(0),
            (Some(drive), None) => period(drive, end),
            (Some(_), Some(_)) => None,
        }
    })
}

/// In ticks: the least time after which each edge before `end` has another one of its kind.
fn period(drive: &Drive, end: f64) -> Option<u64> {
    let wave = drive.wave().ok()?;
    if wave.wanted_pulses() == 0 {
        return Some(0);
    }
    if drive.start_s.is_some_and(|start| start > 0.0) || drive.stop_s.is_some() {
        return None;
    }
    let ends = (end / 2.0) as u64;
    (1..=MULTIPLES).find_map(|cycles| {
        let ticks = wave.edge(2 * cycles) - wave.edge(0);
        if ticks > ends / 3 {
            return None;
        }
        // The first few decide nearly always; then all.
        let repeats = |h: u64| wave.edge(h + 2 * cycles) == wave.edge(h) + ticks;
        ((0..64).all(repeats) && (64..).take_while(|&h| wave.edge(h) < ends).all(repeats)).then_some(ticks)
    })
}

/// The watch over the lanes of a group.
#[derive(Debug)]
pub(super) struct Cycle {
    /// Half ticks.
    period: f64,
    /// The next multiple at which the states are looked at.
    pub(super) next: f64,
    /// The states kept, and when they were.
    kept: [State; LANES],
    kept_at: f64,
    count: u64,
    renewed: u64,
}

/// What a look at the states came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    /// Lanes that are as they were, a bit each, and how many half ticks ago.
    pub(super) again: u32,
    pub(super) ago: f64,
    /// Whether these are now the states to be compared with.
    pub(super) kept: bool,
    /// Whether it is not worth to look any more.
    pub(super) given_up: bool,
}

impl Cycle {
    /// Of a group that some motors reach (a bit each); none if together they do not repeat often enough before `end`.
    pub(super) fn new(periods: &Periods, motors: u32, end: f64) -> Option<Self> {
        let mut common: u64 = 1;
        for (motor, period) in periods.iter().enumerate() {
            if motors >> motor & 1 == 1 {
                match (*period)? {
                    0 => {}
                    period => common = least_common_multiple(common, period)?,
                }
            }
        }
        if common == 1 {
            return None;
        }
        // So long that whatever the window still holds of the beginning is gone at the second multiple.
        let period = common * WINDOW_HALF_TICKS.div_ceil(common);
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

    /// Looks at the states at [`Self::next`].
    pub(super) fn look(&mut self, states: &[State; LANES]) -> Look {
        let now = self.next;
        self.next += self.period;
        self.count += 1;
        // No state equals that of NaN with which it begins.
        let again = (0..LANES).filter(|&lane| states[lane] == self.kept[lane]);
        let again = again.fold(0, |lanes, lane| lanes | 1 << lane);
        let ago = now - self.kept_at;
        let kept = self.count > 2 * self.renewed;
        if kept {
            (self.renewed, self.kept, self.kept_at) = (self.count, *states, now);
        }
        Look { again, ago, kept, given_up: self.count > PATIENCE }
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
        periods(&[drive], seconds * 170_000.0)[usize::from(drive.motor)]
    }

    #[test]
    fn a_period_is_the_least_that_repeats_to_the_tick() {
        assert_eq!(of(drive(3, 60.0), 10.0), Some(4250));
        assert_eq!(of(drive(3, 50.0), 10.0), Some(1700));
        assert_eq!(of(drive(3, 85_000.0 / 1700.5), 10.0), Some(3401));
        assert_eq!(of(drive(3, 60.0 * std::f64::consts::PI), 10.0), None);
        // Not even three of them.
        assert_eq!(of(drive(3, 60.0), 0.14), None);
        assert_eq!(of(Drive { amplitude_um: 0.01, ..drive(3, 60.0) }, 10.0), Some(0));
        assert_eq!(of(Drive { start_s: Some(0.1), ..drive(3, 60.0) }, 10.0), None);
        assert_eq!(of(Drive { stop_s: Some(5.0), ..drive(3, 60.0) }, 10.0), None);
        let end = 10.0 * 170_000.0;
        let periods = periods(&[drive(0, 60.0), drive(1, 50.0), drive(1, 50.0)], end);
        assert_eq!((periods[0], periods[1], periods[2]), (Some(4250), None, Some(0)));
    }

    #[test]
    fn a_group_repeats_with_the_motors_that_reach_it() {
        let end = 10.0 * 170_000.0;
        let periods = periods(&[drive(0, 60.0), drive(1, 50.0), drive(2, 61.803_398)], end);
        assert_eq!(periods[2], None);
        let period = |motors, end| Cycle::new(&periods, motors, end).map(|cycle| cycle.period);
        assert_eq!(period(0b01, end), Some(8500.0));
        assert_eq!(period(0b11, end), Some(17_000.0));
        assert_eq!(period(0b111, end), None);
        assert_eq!(period(0b1000, end), None);
        assert_eq!(period(0b11, 60_000.0), None);
    }

    #[test]
    fn a_period_shorter_than_the_window_is_taken_several_times() {
        let mut periods = [Some(0); MOTORS];
        periods[0] = Some(100);
        let cycle = Cycle::new(&periods, 1, 1e6).unwrap();
        // At the first look at 3200 half ticks the window holds nothing from before the first period.
        assert_eq!((cycle.period, cycle.next), (1600.0, 3200.0));
    }
}
