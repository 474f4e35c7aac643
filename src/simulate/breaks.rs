//! When the input to the skin bends: the breaks of every motor's velocity, in order of time.
//!
//! The displacement y of a shaft changes at `dy/dt = D / W` with `D = r(t) - r(t - W)`, and D is linear between
//! the starts and ends of ramps and W after each. A [`Break`] says where D bends and by how much. D is counted in
//! half pulses and time in half ticks, so that for strokes every D is a whole number and rest is exactly 0.
//!
//! [`Breaks`] is one motor's; [`Blocks`] merges all of them, in blocks of bounded size, so that a scene of a month
//! takes no more memory than one of a second.
//!
//! Invariant: breaks are in order of time, whatever the size of the blocks.

use super::scene::Scene;
use crate::motor::{Ramp, WINDOW_HALF_TICKS};
use crate::units::{UM_PER_PULSE, seconds_to_ticks};
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::{TICK_HZ, Tick};
use std::collections::VecDeque;

/// Half ticks in a second.
pub(super) const HALF_TICKS_PER_S: f64 = 2.0 * TICK_HZ as f64;
/// Half ticks of the moving average.
const WINDOW: f64 = WINDOW_HALF_TICKS as f64;
/// Breaks of a block, about: what fits a processor's nearer cache.
const BLOCK: f64 = 16_384.0;

/// Where a motor's velocity bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Break {
    /// Half ticks since the scene's beginning, a whole number.
    pub(super) at: f64,
    /// By how much the slope of D changes, half pulses per half tick: a whole number unless a ramp was
    /// played with a gain.
    pub(super) bend: f64,
    pub(super) motor: u8,
}

/// Ramps of one motor, in order of time and without overlap.
type Ramps<'s> = Box<dyn Iterator<Item = Ramp> + Send + 's>;

/// The breaks of one motor: those of the leading edge of the window merged with those of the trailing edge.
pub(super) struct Breaks<'s> {
    motor: u8,
    ramps: Ramps<'s>,
    /// Breaks of the leading edge that the trailing edge has yet to pass.
    behind: VecDeque<Break>,
    /// How many of `behind`, from the back, the leading edge has yet to pass.
    ahead: usize,
    /// About how many there are in a second.
    per_s: f64,
}

impl Breaks<'_> {
    pub(super) const fn motor(&self) -> u8 {
        self.motor
    }

    /// About how many there are in a second.
    pub(super) const fn per_s(&self) -> f64 {
        self.per_s
    }
}

impl Iterator for Breaks<'_> {
    type Item = Break;

    #[inline]
    fn next(&mut self) -> Option<Break> {
        if self.ahead == 0
            && let Some(ramp) = self.ramps.next()
        {
            let bend = ramp.um_per_tick / UM_PER_PULSE;
            for (tick, bend) in [(ramp.start, bend), (ramp.end(), -bend)] {
                self.behind.push_back(Break { at: half_ticks(tick), bend, motor: self.motor });
            }
            self.ahead = 2;
        }
        let leading = self.ahead.checked_sub(1).map(|last| self.behind[self.behind.len() - 1 - last]);
        let trailing =
            self.behind.front().map(|found| Break { at: found.at + WINDOW, bend: -found.bend, ..*found });
        if let Some(leading) = leading
            && trailing.is_none_or(|trailing| leading.at <= trailing.at)
        {
            self.ahead -= 1;
            return Some(leading);
        }
        self.behind.pop_front();
        trailing
    }
}

fn half_ticks(tick: Tick) -> f64 {
    2.0 * tick.0 as f64
}

/// The breaks of the scene's strokes, motor by motor; motors that never move have none.
pub(super) fn of_scene(scene: &Scene) -> Vec<Breaks<'_>> {
    let end = end(scene.duration_s());
    let mut drives: Vec<_> = scene.drives().iter().filter(|drive| drive.amplitude_um > 0.0).collect();
    drives.sort_by(|a, b| a.start_s.unwrap_or(0.0).total_cmp(&b.start_s.unwrap_or(0.0)));
    let of_motor = |motor: u8| {
        let mut per_s = 0.0;
        let mut ramps: Ramps<'_> = Box::new(std::iter::empty());
        for drive in drives.iter().filter(|drive| drive.motor == motor) {
            let Ok(wave) = drive.wave() else { continue };
            if wave.wanted_pulses() == 0 {
                continue;
            }
            per_s += 8.0 * drive.frequency_hz;
            let start = seconds_to_ticks(drive.start_s.unwrap_or(0.0));
            let stop = drive.stop_s.map_or(u64::MAX, seconds_to_ticks);
            let strokes = wave.excursions().take_while(move |excursion| {
                start.saturating_add(excursion.end()) <= stop
                    && half_ticks(Tick(start.saturating_add(excursion.up))) < end
            });
            ramps = Box::new(ramps.chain(strokes.flat_map(move |excursion| {
                [(excursion.up, Direction::Up), (excursion.down, Direction::Down)].map(|(tick, direction)| {
                    Ramp::new(Tick(start.saturating_add(tick)), excursion.pulses, direction, 1.0)
                })
            })));
        }
        let breaks = Breaks { motor, ramps, behind: VecDeque::new(), ahead: 0, per_s };
        (per_s > 0.0).then_some(breaks)
    };
    (0..MOTORS as u8).filter_map(of_motor).collect()
}

/// The end of a scene, half ticks. It need not be a whole number. What lies before it, and only that,
/// lies before `duration_s` in seconds, too, whichever way either was rounded.
pub(super) fn end(duration_s: f64) -> f64 {
    let mut end = duration_s * HALF_TICKS_PER_S;
    while end > 0.0 && end.next_down() / HALF_TICKS_PER_S >= duration_s {
        end = end.next_down();
    }
    while end / HALF_TICKS_PER_S < duration_s {
        end = end.next_up();
    }
    end
}

/// The breaks of all motors, block by block.
pub(super) struct Blocks<'s> {
    motors: Vec<(Breaks<'s>, Option<Break>)>,
    /// How far the blocks go that were given out, half ticks.
    reached: f64,
    end: f64,
    length: f64,
}

impl<'s> Blocks<'s> {
    pub(super) fn new(motors: Vec<Breaks<'s>>, end: f64) -> Self {
        let per_s: f64 = motors.iter().map(|motor| motor.per_s).sum();
        let length = (BLOCK / per_s * HALF_TICKS_PER_S).max(2.0 * WINDOW);
        let motors = motors.into_iter().map(|mut motor| {
            let first = motor.next();
            (motor, first)
        });
        Self { motors: motors.collect(), reached: 0.0, end, length }
    }

    /// Up to where blocks were given out, half ticks.
    pub(super) const fn reached(&self) -> f64 {
        self.reached
    }

    /// The next block, in place of the last; false if there is none. Breaks of one instant are in order of motor.
    pub(super) fn next_into(&mut self, block: &mut Vec<Break>) -> bool {
        block.clear();
        if self.reached >= self.end {
            return false;
        }
        self.reached = (self.reached + self.length).min(self.end);
        for (breaks, next) in &mut self.motors {
            while let Some(found) = next.take_if(|found| found.at < self.reached) {
                block.push(found);
                *next = breaks.next();
            }
        }
        // Stable, and made for runs that are in order already.
        block.sort_by_key(|found| found.at as u64);
        true
    }
}
