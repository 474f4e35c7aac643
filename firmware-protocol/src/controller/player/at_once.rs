//! Keeps the motors that have pulses at once within the limits of their rail and their driver chip.
//!
//! The controller checks both bursts of a stroke when it begins, against what is left of the strokes that began before it. It
//! checks a begun stroke again when an amendment lengthens it. It never refuses returns and seeks: their bursts take turns.
//!
//! Invariant: in no tick do more motors of a rail or a chip have pulses than its limit. It holds because strokes change the lines
//! only where they were checked, and bursts that take turns fit the bursts that run on.

use crate::controller::player::Player;
use crate::controller::player::pool::Pool;
use crate::limits::{MOTORS_PER_CHIP, MOTORS_PER_RAIL, PowerLimits, RAILS, Refusal};
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
        let (pool, low) = (&self.pool, self.rendered.0 as u32);
        if usize::from(rail_at_once) < MOTORS_PER_RAIL
            && !fits::<MOTORS_PER_RAIL>(pool, low, stroke, rail_at_once.into())
        {
            return Err(Refusal::RailAtOnce);
        }
        if usize::from(chip_at_once) < MOTORS_PER_CHIP
            && !fits::<MOTORS_PER_CHIP>(pool, low, stroke, chip_at_once.into())
        {
            return Err(Refusal::ChipAtOnce);
        }
        Ok(())
    }
}

/// Whether at most `limit` motors have pulses at once in the group of the stroke's motor: its rail or its chip, of `GROUP`
/// motors.
#[inline(never)]
fn fits<const GROUP: usize>(pool: &Pool, now: u32, stroke: &Stroke, limit: usize) -> bool {
    let motor = usize::from(stroke.motor);
    let first = motor - motor % GROUP;
    let mut others = heapless::Vec::<[Span; 2], MOTORS_PER_RAIL>::new();
    for other in first..first + GROUP {
        if other != motor
            && let Some(slot) = pool.current(other)
            && slot.charged.is_some()
        {
            // It fits: a rail has fewer other motors than places here.
            let _ = others.push(Span::of(&slot.stroke, now));
        }
    }
    others.len() < limit || {
        let others = others.as_flattened();
        Span::of(stroke, now).iter().all(|mine| mine.shares(others, limit))
    }
}

/// Schedules the down bursts of the motors in `waiting` in turns from `ready` on, after the bursts that run. They take at
/// most [`PowerLimits::turns`] times the longest burst.
pub(super) fn take_turns(pool: &mut Pool, limits: PowerLimits, waiting: u32, ready: Tick) {
    if limits.turns() == 1 {
        // All of them are planned from `ready` on, and may begin then.
        return;
    }
    for rail in 0..RAILS {
        let mut turns = Turns { limits, free: [ready; MOTORS_PER_RAIL], chips: [ready; CHIPS] };
        for order in 0..ORDERS {
            for at in 0..MOTORS_PER_RAIL {
                let motor = rail * MOTORS_PER_RAIL + at;
                if place(pool, waiting, motor) != order {
                    continue;
                }
                let Some(slot) = pool.current_mut(motor) else { continue };
                let chip = at / MOTORS_PER_CHIP;
                let pulses = slot.stroke.down_pulses.into();
                if order == 0 {
                    turns.book(chip, slot.stroke.end());
                } else {
                    slot.stroke.down = turns.next(chip);
                    turns.book(chip, slot.stroke.down + pulses);
                }
            }
        }
    }
}

/// The place of `motor` in the order of turns: first bursts that run, then one motor of each chip without a running burst,
/// then the second motor of chips with one, then the rest. In another order, both motors of one chip could come last, one
/// after the other.
fn place(pool: &Pool, waiting: u32, motor: usize) -> usize {
    let bit = |motor: usize| waiting >> motor & 1 == 1;
    let runs = |motor: usize| !bit(motor) && pool.current(motor).is_some();
    let first = motor - motor % MOTORS_PER_CHIP;
    let mut chip = first..first + MOTORS_PER_CHIP;
    if !bit(motor) {
        return if runs(motor) { 0 } else { ORDERS };
    }
    if chip.clone().any(runs) {
        2
    } else if chip.find(|&other| bit(other)) == Some(motor) {
        1
    } else {
        3
    }
}

/// Driver chips of a rail.
const CHIPS: usize = MOTORS_PER_RAIL / MOTORS_PER_CHIP;
/// See [`place`].
const ORDERS: usize = 4;

/// The turns of a rail's motors.
struct Turns {
    limits: PowerLimits,
    /// When each place for a burst becomes free. There are as many places as motors may have pulses at once; the other elements
    /// are not used.
    free: [Tick; MOTORS_PER_RAIL],
    /// When the burst of each chip ends.
    chips: [Tick; CHIPS],
}

impl Turns {
    fn first_free(&mut self) -> &mut Tick {
        let mut first = 0;
        for at in 1..usize::from(self.limits.rail_at_once).min(MOTORS_PER_RAIL) {
            if self.free[at] < self.free[first] {
                first = at;
            }
        }
        &mut self.free[first]
    }

    /// When the next burst of `chip` may begin.
    fn next(&mut self, chip: usize) -> Tick {
        let free = *self.first_free();
        if usize::from(self.limits.chip_at_once) < MOTORS_PER_CHIP {
            free.max(self.chips[chip])
        } else {
            free
        }
    }

    /// Books a burst of `chip` that ends at `end`.
    fn book(&mut self, chip: usize, end: Tick) {
        *self.first_free() = end;
        self.chips[chip] = end;
    }
}
