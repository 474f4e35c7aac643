//! Keeps the motors that have pulses at once within the limits of their rail and their driver chip.
//!
//! The controller checks both bursts of a stroke when it begins, against what is left of the strokes that began before it. It
//! checks a begun stroke again when an amendment lengthens it. It never refuses returns and seeks: their bursts take turns.
//!
//! Invariant: in no tick do more motors of a rail or a chip have pulses than its limit. It holds because strokes change the lines
//! only where they were checked, and bursts that take turns fit the bursts that run on.

use crate::array::{CAPACITY, Layout, MotorSet, Ring};
use crate::controller::player::Player;
use crate::controller::player::pool::Pool;
use crate::limits::{PowerLimits, Refusal};
use crate::stroke::Stroke;
use crate::tick::Tick;

/// Ticks with pulses, from the rendered end. In 32 bits, because the chip's core is slow with 64.
#[derive(Clone, Copy, Debug)]
struct Span {
    start: i32,
    end: i32,
}

impl Span {
    /// The spans of both bursts. `now` is the low half of the rendered end.
    fn of(stroke: &Stroke, now: u32) -> [Self; 2] {
        let from = |tick: Tick| (tick.0 as u32).wrapping_sub(now).cast_signed();
        let span = |start: i32, pulses: u16| Self { start, end: start.wrapping_add(pulses.into()) };
        [span(from(stroke.up), stroke.up_pulses), span(from(stroke.down), stroke.down_pulses)]
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.start.max(other.start) < self.end.min(other.end)
    }

    /// Whether in each tick of this span fewer than `limit` of the others have pulses.
    fn shares(&self, others: &[Self], limit: usize) -> bool {
        if others.iter().filter(|other| self.overlaps(other)).count() < limit {
            return true;
        }
        // The number of motors with pulses peaks at the start of some burst.
        let few = |at: i32| others.iter().filter(|other| other.contains(at)).count() < limit;
        let later =
            others.iter().map(|other| other.start).filter(|at| (self.start + 1..self.end).contains(at));
        few(self.start) && later.into_iter().all(few)
    }

    fn contains(&self, at: i32) -> bool {
        (self.start..self.end).contains(&at)
    }
}

impl Player {
    /// Whether `stroke`, which begins at the rendered end or has begun, keeps the limits.
    pub(super) fn check_at_once(&self, stroke: &Stroke) -> Result<(), Refusal> {
        let PowerLimits { rail_at_once, chip_at_once, .. } = self.limits();
        let (pool, layout, low) = (&self.pool, &self.layout, self.rendered.0 as u32);
        if rail_at_once < layout.motors_per_rail()
            && !fits(pool, layout.next_on_rail(), low, stroke, rail_at_once.into())
        {
            return Err(Refusal::RailAtOnce);
        }
        if chip_at_once < layout.motors_per_chip()
            && !fits(pool, layout.next_on_chip(), low, stroke, chip_at_once.into())
        {
            return Err(Refusal::ChipAtOnce);
        }
        Ok(())
    }
}

/// Whether at most `limit` motors have pulses at once in the group of the stroke's motor: its rail or its chip.
#[inline(never)]
fn fits(pool: &Pool, ring: &Ring, now: u32, stroke: &Stroke, limit: usize) -> bool {
    let motor = usize::from(stroke.motor);
    let mut others = heapless::Vec::<[Span; 2], CAPACITY>::new();
    let mut other = usize::from(ring[motor]);
    while other != motor {
        if let Some(slot) = pool.current(other)
            && slot.charged.is_some()
        {
            // It fits: there are fewer other motors than places here.
            let _ = others.push(Span::of(&slot.stroke, now));
        }
        other = ring[other].into();
    }
    others.len() < limit || {
        let others = others.as_flattened();
        Span::of(stroke, now).iter().all(|mine| mine.shares(others, limit))
    }
}

/// Schedules the down bursts of the motors in `waiting` in turns from `ready` on, after the bursts that run. They take at
/// most [`Layout::turns`] times the longest burst.
#[inline(never)]
pub(super) fn take_turns(
    pool: &mut Pool,
    layout: &Layout,
    limits: PowerLimits,
    waiting: MotorSet,
    ready: Tick,
) {
    if !layout.takes_turns(&limits) {
        // All of them are planned from `ready` on, and may begin then.
        return;
    }
    let motors = layout.motors();
    // The bursts that have their time: first those that run. The others wait, in their order.
    let mut booked = MotorSet::EMPTY;
    let mut places = [0; CAPACITY];
    for (motor, of_motor) in places.iter_mut().enumerate().take(motors) {
        if waiting.contains(motor as u8) {
            *of_motor = place(pool, layout, waiting, motor);
        } else if pool.current(motor).is_some() {
            booked.insert(motor as u8);
        }
    }
    let mut left = waiting;
    while let Some(first) = left.lowest().map(usize::from) {
        let rail = layout.rail(first);
        let mut turns = Turns::new(limits, ready);
        for motor in (0..motors).filter(|&motor| layout.rail(motor) == rail) {
            if booked.contains(motor as u8)
                && let Some(slot) = pool.current(motor)
            {
                turns.book(slot.stroke.end());
            }
        }
        while let Some(motor) = next(layout, left, rail, &places) {
            let chip = if limits.chip_at_once < layout.motors_per_chip() {
                chip_free(pool, layout.next_on_chip(), booked, motor, limits.chip_at_once, ready)
            } else {
                ready
            };
            let begin = (*turns.first_free()).max(chip);
            if let Some(slot) = pool.current_mut(motor) {
                slot.stroke.down = begin;
                turns.book(slot.stroke.end());
            }
            left.remove(motor as u8);
            booked.insert(motor as u8);
        }
    }
}

/// The motor of this rail among those left that comes first in the order of turns.
fn next(layout: &Layout, left: MotorSet, rail: u8, places: &[u32; CAPACITY]) -> Option<usize> {
    let mut first: Option<usize> = None;
    for motor in 0..layout.motors() {
        if left.contains(motor as u8)
            && layout.rail(motor) == rail
            && first.is_none_or(|first| places[motor] < places[first])
        {
            first = Some(motor);
        }
    }
    first
}

/// The place of `motor` in the order of turns: first those that have no other motor of their chip before them, then those that
/// have one, and so on; among these first those of chips with a running burst, then those of large chips. Before a motor are the
/// motors of its chip that run or have a lower number. In another order, the motors of one chip could come last, one after the
/// other.
fn place(pool: &Pool, layout: &Layout, waiting: MotorSet, motor: usize) -> u32 {
    let (mut before, mut size, mut runs) = (0, 1, false);
    let ring = layout.next_on_chip();
    let mut other = usize::from(ring[motor]);
    while other != motor {
        size += 1;
        let is_waiting = waiting.contains(other as u8);
        let is_running = !is_waiting && pool.current(other).is_some();
        runs |= is_running;
        before += u32::from(is_running || (is_waiting && other < motor));
        other = ring[other].into();
    }
    before << 16 | u32::from(!runs) << 8 | (CAPACITY as u32 - size)
}

/// The first tick from which fewer than `limit` of the `booked` bursts of the motor's chip have pulses.
fn chip_free(pool: &Pool, ring: &Ring, booked: MotorSet, motor: usize, limit: u8, ready: Tick) -> Tick {
    let end = |other: usize| {
        pool.current(other).filter(|_| booked.contains(other as u8)).map(|slot| slot.stroke.end())
    };
    // The ends from the latest on, those of the same tick one after the other.
    let (mut passed, mut free) = (0, None::<Tick>);
    while passed < limit {
        let (mut latest, mut same) = (None, 0);
        let mut other = usize::from(ring[motor]);
        while other != motor {
            let earlier = end(other).filter(|&end| free.is_none_or(|free| end < free));
            if earlier > latest {
                (latest, same) = (earlier, 1);
            } else if earlier.is_some() && earlier == latest {
                same += 1;
            }
            other = ring[other].into();
        }
        let Some(end) = latest else { return ready };
        (passed, free) = (passed + same, Some(end));
    }
    free.map_or(ready, |free| free.max(ready))
}

/// The turns of a rail's motors.
struct Turns {
    /// When each place for a burst becomes free. There are as many places as motors may have pulses at once; the other elements
    /// are not used.
    free: [Tick; CAPACITY],
    places: usize,
}

impl Turns {
    fn new(limits: PowerLimits, ready: Tick) -> Self {
        Self { free: [ready; CAPACITY], places: usize::from(limits.rail_at_once).clamp(1, CAPACITY) }
    }

    fn first_free(&mut self) -> &mut Tick {
        let mut first = 0;
        for at in 1..self.places {
            if self.free[at] < self.free[first] {
                first = at;
            }
        }
        &mut self.free[first]
    }

    /// Books a burst that ends at `end`.
    fn book(&mut self, end: Tick) {
        *self.first_free() = end;
    }
}
