//! Compiles a waveform to moves: at each tick of a grid, the level that the pin should go to.
//!
//! A motor pulses once a tick, so a move of d pulses is a ramp of d ticks at full speed, and the rest of the step of S ticks is still.
//! A slow waveform becomes a staircase, a fast one hardly any: a level that is the waveform's value at either end of the step would lead
//! or lag by a time that depends on the speed, which is distortion. So the level is chosen such that pin and waveform have the same mean
//! over the step while the waveform's speed s, in pulses per tick, is steady:
//!
//! ```text
//! level = mean of h over the step + S s|s| / 2
//! ```
//!
//! At full speed that is h at the end of the step, for a slow waveform h in its middle. The mean is exact, and keeps what is faster than
//! the grid from becoming slow motion. It costs amplitude: a slow sine of f is sinc²(fS) as large, 0.98 at 40 Hz and 2 ms. Levels are
//! absolute, so whatever one move leaves, by rounding or because the step was too short, is in the difference that the next one makes.
//! The grid of every motor begins at tick 0.
//!
//! A move is made if the level is off by (`least_pulses` + 1)/2 or more, and is at least `least_pulses` long unless it goes to 0. One
//! pulse of that is hysteresis: without it a waveform that stays half-way would make the pin go up and down.
//!
//! Invariant: levels are 0 to `most_pulses`, ticks are strictly in order, no two moves are further apart in level than in ticks, and the
//! last level is 0. All ticks are multiples of the step.

use super::waveform::Section;
use crate::spec::{Array, MotorSpec};
use crate::units::TickRate;

/// The steps of grids that are tried, ms. Shorter ones are more moves than the link takes from the paper's 24 motors, longer ones do not
/// vanish in the average of 4.3 ms of the paper's motors.
pub(crate) const STEPS_MS: [u64; 4] = [SLOWEST_STEP_MS, 3, 2, 1];

/// The longest of them: a move may begin so much before its waveform, and the last one so much after it.
pub(crate) const SLOWEST_STEP_MS: u64 = 4;

/// Far more than what rounding changes of a level, pulses.
const ROUNDING: f64 = 1e-9;

/// The least error that can be asked for, µm: a small part of a pulse.
pub const LEAST_ERROR_UM: f64 = 0.01;

/// Instants at which moves begin: the multiples of a step, for all motors of a play, so that many moves share a row on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// The step, at least 1.
    pub step_ticks: u32,
}

/// How long a stretch of each waveform is tried and measured, shared among the motors, s.
pub const TRIED_S: f64 = 240.0;

impl Grid {
    /// The multiples of so many milliseconds, rounded up to ticks.
    pub fn of_ms(array: Array, ms: u64) -> Self {
        Self { step_ticks: array.rate().of_ms(ms) as u32 }
    }
}

/// The module's rule for the level of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    pub(crate) rate: TickRate,
    spec: &'static MotorSpec,
    /// Ticks of a step.
    pub(crate) step: u32,
}

impl Rule {
    /// Of a grid for an array.
    pub(crate) fn new(array: Array, grid: Grid) -> Self {
        Self { rate: array.rate(), spec: array.spec().motor(), step: grid.step_ticks }
    }

    /// The grid that it was made for.
    pub(crate) const fn grid(&self) -> Grid {
        Grid { step_ticks: self.step }
    }

    /// The level to go to in a step, in which the waveform does this, from the present level.
    pub(crate) fn next_level(&self, level: u16, section: &Section) -> u16 {
        let step = f64::from(self.step);
        let Section { rise_um, mean_um, extremes_um, .. } = *section;
        let speed = (self.spec.pulses(rise_um) / step).clamp(-1.0, 1.0);
        let wanted = self.spec.pulses(mean_um) + step * speed * speed.abs() / 2.0;
        // At a jump within the step the speed is not steady, and the pin must not overshoot.
        let [lowest, highest] = extremes_um.map(|um| self.spec.pulses(um));
        self.level_for(level, wanted.clamp(lowest, highest))
    }

    /// The displacements, µm, at which the pin keeps a level: while the waveform is from the first to the second, [`Self::next_level`] is
    /// this level. The first is above the second if there are none.
    pub(crate) fn kept_um(&self, level: u16) -> [f64; 2] {
        let [least, most, at] = [self.spec.least_pulses, self.spec.most_pulses, level].map(f64::from);
        let enough = (least + 1.0) / 2.0;
        let low = if level == 0 { f64::NEG_INFINITY } else { enough.max(at - enough) };
        // At the top there may be no room for a move up.
        let high = if at + least > most { f64::INFINITY } else { at + enough };
        [low + ROUNDING, high - ROUNDING].map(|pulses| pulses * self.spec.um_per_pulse)
    }

    /// The level to go to for a wanted one.
    fn level_for(&self, level: u16, wanted: f64) -> u16 {
        let (least, most) = (i32::from(self.spec.least_pulses), i32::from(self.spec.most_pulses));
        let level = i32::from(level);
        let enough = (f64::from(least) + 1.0) / 2.0;
        let wanted = wanted.clamp(0.0, f64::from(most));
        let off = wanted - f64::from(level);
        let goal = if wanted < enough {
            0
        } else if off.abs() < enough {
            level
        } else if off.abs() < f64::from(least) {
            (level + if off > 0.0 { least } else { -least }).max(0)
        } else {
            wanted.round() as i32
        };
        // At the top there may be no room for the shortest burst.
        let goal = if goal > most { level } else { goal };
        let reach = i32::try_from(self.step).unwrap_or(i32::MAX);
        u16::try_from(level + (goal - level).clamp(-reach, reach)).expect("between two levels")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::reached::steps_within;
    use crate::motion::tests::{noise, ramp, tone};
    use crate::motion::{Envelope, ns_at};
    use crate::motion::{Waveform, tick_of};
    use crate::spec::names;
    use crate::strokes::{choose, moves};
    use firmware_protocol::moves::Move;
    use firmware_protocol::tick::Tick;
    use proptest::prelude::*;

    fn paper(waveform: &Waveform, ms: u64) -> Vec<(u64, u16)> {
        let grid = Grid::of_ms(Array::paper(), ms);
        moves(Array::paper(), 9, waveform, grid).into_iter().map(|of| (of.tick.0, of.level)).collect()
    }

    /// The rule at each step of the grid; nothing is passed over.
    fn step_by_step(array: Array, waveform: &Waveform, grid: Grid) -> Vec<Move> {
        let (rule, step) = (Rule::new(array, grid), u64::from(grid.step_ticks));
        let over = waveform.span_ns().map_or(0, |(_, until)| tick_of(until, array.rate()));
        let (mut moves, mut level, mut tick) = (Vec::new(), 0, 0);
        // Rounding to ns may put the beginning just after a tick of the grid.
        let from = waveform.span_ns().map_or(0, |(from, _)| tick_of(from, array.rate()).saturating_sub(1));
        tick += from / step * step;
        while tick < over || level > 0 {
            let [from, to] = [tick, tick + step].map(|tick| ns_at(tick, array.rate()));
            let next = rule.next_level(level, &waveform.section(from, to));
            if next != level {
                moves.push(Move { motor: 2, tick: Tick(tick), level: next, surplus: 0 });
            }
            (level, tick) = (next, tick + step);
        }
        moves
    }

    #[test]
    fn a_ramp_is_even_steps_and_its_hold_has_no_moves() {
        let moves = paper(&ramp(200.0, 0.05).waveform().unwrap(), 2);
        // 1473.7 pulses in 25 steps: 58.9 each, but for the first, which begins in the middle, and the last.
        assert_eq!((moves.len(), moves[0].0, moves[25]), (52, 8500, (12_750, 1474)));
        assert!(moves[1..25].windows(2).all(|two| (58..=60).contains(&(two[1].1 - two[0].1))), "{moves:?}");
        assert_eq!((moves[26].0, moves[51]), (29_750, (34_000, 0)));
    }

    #[test]
    fn a_jump_on_the_grid_begins_at_its_tick_and_goes_at_full_speed() {
        let jump = ramp(190.0 * 0.95 / 7.0, 0.0);
        let expected = [(8500, 170), (8670, 190), (25_500, 20), (25_670, 0)];
        assert_eq!(paper(&jump.waveform().unwrap(), 2), expected);
    }

    #[test]
    fn ten_hours_on_the_moves_are_the_same() {
        let um: Vec<f64> = (0..500).map(|k| 40.0 + 30.0 * f64::from(k * 37 % 100) / 100.0).collect();
        let moves = |start_s| paper(&Waveform::samples(start_s, 437.0, &um).unwrap(), 3);
        let later = moves(36_000.0);
        assert_eq!(
            moves(0.0).iter().map(|(tick, level)| (tick + 36_000 * 85_000, *level)).collect::<Vec<_>>(),
            later
        );
    }

    #[test]
    fn what_stays_or_hardly_moves_makes_no_moves() {
        let hover = |um: f64| {
            let um: Vec<f64> = (0..1000).map(|k| um + 0.06 * f64::from(k % 2)).collect();
            paper(&Waveform::samples(0.0, 1000.0, &um).unwrap(), 1).len()
        };
        // Up and down once, at whatever height: also where rounding would change from sample to sample.
        assert!((0..200).map(|k| 3.0 + f64::from(k) * 0.01).all(|um| hover(um) <= 4));
        assert_eq!((paper(&Waveform::default(), 1).len(), hover(0.3)), (0, 0));
    }

    #[test]
    fn the_coarsest_grid_within_the_error_is_taken() {
        let array = Array::paper();
        let (slow, fast) = (
            ramp(200.0, 0.05).waveform().unwrap(),
            tone(40.0, 40.0, 80.0, Some(Envelope::HANN)).waveform().unwrap(),
        );
        let all_within = |motors: &[(u8, &Waveform)], grid, error_um| {
            motors.iter().all(|(motor, waveform)| {
                let moves = moves(array, *motor, waveform, grid);
                steps_within(array, waveform, &moves, error_um)
            })
        };
        let step = |motors: &[(u8, &Waveform)], error_um: Option<f64>| {
            let grid = choose(array, motors.iter().copied(), error_um, 240.0).unwrap();
            assert!(all_within(motors, grid, error_um.unwrap_or(0.95)), "{grid:?}");
            grid.step_ticks / 85
        };
        assert_eq!((step(&[(3, &slow)], None), step(&[(4, &fast)], None)), (2, 1));
        assert_eq!(
            (step(&[(3, &slow), (4, &fast)], None), step(&[(3, &slow), (4, &fast)], Some(8.0))),
            (1, 4)
        );
        // Noise that is too fast at places: no grid is within so little.
        let rough = noise(5.0, 150.0, 15.0, 1).waveform().unwrap();
        let rough = [(0, &rough)];
        let finest = choose(array, rough.into_iter(), Some(0.1), 240.0).unwrap();
        assert!(finest.step_ticks == 85 && !all_within(&rough, finest, 0.1));
        assert!(choose(array, rough.into_iter(), Some(0.0), 240.0).is_err());
        assert!(choose(array, [].into_iter(), None, 240.0).is_ok());
    }

    proptest! {
        #[test]
        fn moves_are_in_range_in_order_not_too_fast_and_end_at_rest(
            name in prop::sample::select(names()),
            start_s in 0.0..5000.0,
            rate_hz in 1.0..8000.0,
            (scale, um) in (0.1..600.0, prop::collection::vec(-0.5..1.2, 2..200)),
            ms in 1_u64..5,
        ) {
            let array = Array::named(name).unwrap();
            let um: Vec<f64> = um.into_iter().map(|share: f64| share * scale).collect();
            // At low rates so few samples that the test takes no longer.
            let count = um.len().min(2 + (rate_hz / 2.0) as usize);
            let waveform = Waveform::samples(start_s, rate_hz, &um[..count]).unwrap();
            let grid = Grid::of_ms(array, ms);
            let motor = array.motor();
            let highest = motor.pulses(waveform.extremes_um()[1]) + (f64::from(motor.least_pulses) + 1.0) / 2.0;
            let found = moves(array, 2, &waveform, grid);
            prop_assert_eq!(&found, &step_by_step(array, &waveform, grid));
            let (mut level, mut next) = (0, 0);
            for each in found {
                prop_assert!(each.tick.0 >= next && each.tick.0.is_multiple_of(grid.step_ticks.into()));
                prop_assert!(each.level <= motor.most_pulses && f64::from(each.level) <= highest);
                let pulses = each.level.abs_diff(level);
                prop_assert!(u32::from(pulses) <= grid.step_ticks);
                prop_assert!(pulses >= motor.least_pulses || each.level == 0);
                (level, next) = (each.level, each.tick.0 + u64::from(grid.step_ticks));
            }
            prop_assert_eq!(level, 0);
        }
    }
}
