//! One motor's motions, walked from step to step of the grid, repeat after repeat.
//!
//! As a [`Lane`](super::lane::Lane), it computes its next move in advance. All its ticks are pattern time, counted from the first repeat's
//! beginning; the onset is added last.
//!
//! Where repeats follow each other the waveform of one goes on in the next: a waveform whose ends meet is played without a seam. The pin is
//! at rest at the end of the play, and of each repeat if the motor has drives too: if the waveform is too high for that, it comes down
//! before.
//!
//! Invariant: a pin that has no move to make for long gets one to the level that it has, so the next move is always found in bounded time.

use super::drive::NEVER;
use super::options::{StrokeOptions, Surplus};
use super::repeat::Repeat;
use crate::motion::{Grid, Moves, Rule, Section, Waveform, ns_at, ns_of, tick_of};
use crate::pattern::Pattern;
use crate::spec::Array;
use crate::strokes::Step;
use firmware_protocol::limits::correction;
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;
use std::sync::Arc;

/// Steps without a move after which there is one all the same.
const QUIET: u64 = 2_000;

#[derive(Clone, Debug)]
pub(super) struct MotionLane {
    array: Array,
    rule: Rule,
    /// The pattern's waveforms, and which of them this is.
    waveforms: Arc<[(u8, Waveform)]>,
    of: usize,
    scale: f64,
    surplus: Surplus,
    duration_s: Option<f64>,
    /// From here on the waveform is at rest, if it is not repeated.
    over: u64,
    /// The motor has drives too: each repeat begins and ends at rest.
    has_drives: bool,
    /// The end of the play.
    end: u64,
    repeat: Repeat,
    /// The next step.
    number: u64,
    level: u16,
    /// Pulses up since the pin was at rest.
    risen: u32,
    /// The next move, in pattern time, and the level before it.
    next: (Move, u16),
}

impl MotionLane {
    /// The lanes of a pattern's motions, on this grid.
    pub(super) fn of_pattern(
        pattern: &Pattern,
        grid: Grid,
        options: &StrokeOptions,
    ) -> impl Iterator<Item = Self> {
        let (array, waveforms) = (pattern.array(), pattern.shared_waveforms());
        let (duration_s, scale) = (pattern.duration_s(), options.scale);
        (0..waveforms.len()).map(move |of| {
            let motor = waveforms[of].0;
            Self {
                array,
                rule: Rule::new(array, grid),
                over: waveforms[of].1.span_ns().map_or(0, |(_, until)| tick_of(until, array.rate())),
                waveforms: waveforms.clone(),
                of,
                scale,
                surplus: options.surplus.clone(),
                duration_s,
                has_drives: pattern.drives().iter().any(|drive| drive.motor == motor),
                end: NEVER,
                repeat: Repeat::of(0, duration_s, array.rate()),
                number: 0,
                level: 0,
                risen: 0,
                next: (Move { motor, tick: Tick(0), level: 0, surplus: 0 }, 0),
            }
        })
    }

    pub(super) fn motor(&self) -> u8 {
        self.waveforms[self.of].0
    }

    /// The motor's waveform in one run, as high as it is played.
    pub(super) fn scaled(&self) -> Waveform {
        let whole = self.waveforms[self.of].1.clone();
        if self.scale == 1.0 { whole } else { whole.scaled(self.scale) }
    }

    /// So many seconds of the beginning of that waveform, and its moves.
    pub(super) fn beginning(&self, seconds: f64) -> (Waveform, Vec<Move>) {
        let beginning = self.waveforms[self.of].1.first(ns_of(seconds)).scaled(self.scale);
        let moves = Moves::new(self.array, self.motor(), &beginning, self.rule.grid()).collect();
        (beginning, moves)
    }

    /// Goes back to the beginning of a play that ends at `end`; returns when the first move begins.
    pub(super) fn begin(&mut self, end: u64) -> u64 {
        self.end = end;
        self.repeat = Repeat::of(0, self.duration_s, self.rule.rate);
        (self.number, self.level, self.risen) = (0, 0, 0);
        self.advance()
    }

    /// The next move of a play that began at `onset`.
    pub(super) fn step(&self, onset: Tick) -> Step {
        let (of, from) = self.next;
        Step::Move { of: Move { tick: onset + of.tick.0, ..of }, from }
    }

    /// Takes the next move and computes the one after it; returns when that begins.
    pub(super) fn advance(&mut self) -> u64 {
        let step = u64::from(self.rule.step);
        for quiet in 0.. {
            let start = self.number * step;
            let is_over = start >= self.end || (self.duration_s.is_none() && start >= self.over);
            if is_over && self.level == 0 {
                break;
            }
            while self.repeat.end <= start {
                self.repeat = Repeat::of(self.repeat.number + 1, self.duration_s, self.rule.rate);
            }
            // From the next step on there must be time to come down.
            let highest = self.rests_at().saturating_sub(start + step);
            let goal = self.rule.next_level(self.level, &self.section(start, start + step));
            let lowest = u64::from(self.level).saturating_sub(step);
            let goal = u64::from(goal).min(highest.max(lowest)) as u16;
            self.number += 1;
            if goal != self.level || quiet == QUIET {
                self.go(start, goal);
                return start;
            }
            self.skip(start);
        }
        NEVER
    }

    /// When the pin has to be at rest.
    fn rests_at(&self) -> u64 {
        if self.has_drives { self.end.min(self.repeat.end) } else { self.end }
    }

    /// The next move is to this level.
    fn go(&mut self, start: u64, goal: u16) {
        self.risen = self.risen.saturating_add(goal.saturating_sub(self.level).into());
        let mut surplus = 0;
        if goal == 0 && self.level > 0 {
            let pulses = self.surplus.pulses(self.array, self.motor(), self.risen, 1.0);
            surplus = u16::try_from(pulses)
                .unwrap_or(u16::MAX)
                .min(correction(self.array.layout().max_up_pulses()));
            self.risen = 0;
        }
        let of = Move { motor: self.motor(), tick: Tick(start), level: goal, surplus };
        self.next = (of, std::mem::replace(&mut self.level, goal));
    }

    /// Passes over the steps after that at `start` in which the pin stays where it is.
    fn skip(&mut self, start: u64) {
        let (step, rate) = (u64::from(self.rule.step), self.rule.rate);
        let steady = self.waveforms[self.of].1.steady_until(ns_at(start - self.repeat.start, rate));
        let steady = if steady == u64::MAX { NEVER } else { tick_of(steady, rate).saturating_sub(1) };
        let until = steady.saturating_add(self.repeat.start).min(self.repeat.end);
        let until = if self.duration_s.is_none() { until.min(self.over.max(start)) } else { until };
        let down = self.rests_at().saturating_sub(u64::from(self.level) + 2 * step);
        let until = if self.level > 0 { until.min(down) } else { until.min(self.end) };
        self.number = self.number.max(until / step);
    }

    /// What the waveform does between two ticks, over as many repeats as there are.
    fn section(&self, from: u64, to: u64) -> Section {
        let rate = self.rule.rate;
        let (mut whole, mut repeat, mut at) = (None::<Section>, self.repeat, from);
        while at < to {
            let until = to.min(repeat.end);
            let [begin, end] = [at, until].map(|tick| ns_at(tick - repeat.start, rate));
            let Section { rise_um, mean_um, extremes_um: [low, high] } =
                self.waveforms[self.of].1.section(begin, end);
            let share = (until - at) as f64 / (to - from) as f64;
            let before = whole.unwrap_or(Section { rise_um: 0.0, mean_um: 0.0, extremes_um: [low, high] });
            whole = Some(Section {
                rise_um: before.rise_um + rise_um,
                mean_um: before.mean_um + share * mean_um,
                extremes_um: [low.min(before.extremes_um[0]), high.max(before.extremes_um[1])],
            });
            (at, repeat) = (until, Repeat::of(repeat.number + 1, self.duration_s, rate));
        }
        let whole = whole.unwrap_or(Section { rise_um: 0.0, mean_um: 0.0, extremes_um: [0.0; 2] });
        Section {
            rise_um: self.scale * whole.rise_um,
            mean_um: self.scale * whole.mean_um,
            extremes_um: whole.extremes_um.map(|um| self.scale * um),
        }
    }
}
