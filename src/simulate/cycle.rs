//! When a receptor's state repeats, so that what follows need not be computed again.
//!
//! Without noise, and with drives that repeat to the tick, a group of receptors whose whole state is at one multiple of the common
//! period what it was at an earlier one, bit by bit, goes on as it went on then. Whether that happens is watched
//! as Brent does for cycles of any function: the state is compared with one kept, which is renewed at each power of 2.
//!
//! Invariant: states are compared relative to their own multiple of the period, and all of their bits.

use super::exact::Snapshot;
use crate::motor::WINDOW_HALF_TICKS;
use crate::pattern::Drive;
use firmware_protocol::stroke::MOTORS;

/// Periods after which nobody waits for a repetition any more.
const PATIENCE: u64 = 1024;
/// How long a period may be looked for in multiples of a drive's own.
const MULTIPLES: u64 = 2048;

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
        if 3 * ticks > ends {
            return None;
        }
        // The first few decide nearly always; then all.
        let repeats = |h: u64| wave.edge(h + 2 * cycles) == wave.edge(h) + ticks;
        ((0..64).all(repeats) && (64..).take_while(|&h| wave.edge(h) < ends).all(repeats)).then_some(ticks)
    })
}

/// The watch over a group.
#[derive(Debug)]
pub(super) struct Cycle {
    /// Half ticks.
    period: f64,
    /// The next multiple at which the state is looked at.
    pub(super) next: f64,
    kept: Option<(f64, Snapshot)>,
    count: u64,
    renewed: u64,
}

/// What a look at the state came to.
#[derive(Debug, PartialEq)]
pub(super) enum Look {
    /// Not seen before.
    New,
    /// Not seen before, and kept to be compared with.
    Kept,
    /// The state of so many half ticks ago.
    Again(f64),
    /// It is not worth to go on looking.
    GivenUp,
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
        (4.0 * period < end).then_some(Self { period, next: 2.0 * period, kept: None, count: 0, renewed: 0 })
    }

    /// Looks at the state at [`Self::next`].
    pub(super) fn look(&mut self, snapshot: Snapshot) -> Look {
        let now = self.next;
        self.next += self.period;
        self.count += 1;
        if let Some((at, kept)) = &self.kept
            && *kept == snapshot
        {
            return Look::Again(now - at);
        }
        if self.count > PATIENCE {
            return Look::GivenUp;
        }
        if self.count > 2 * self.renewed {
            self.renewed = self.count;
            self.kept = Some((now, snapshot));
            return Look::Kept;
        }
        Look::New
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
