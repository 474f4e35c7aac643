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
    let mut periods = [Some(0); MOTORS];
    for motor in 0..MOTORS {
        let mut drives = drives.iter().filter(|drive| usize::from(drive.motor) == motor);
        let Some(drive) = drives.next() else { continue };
        periods[motor] = if drives.next().is_some() { None } else { period(drive, end) };
    }
    periods
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
