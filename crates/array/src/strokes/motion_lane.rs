//! One motor's motions, walked from step to step of the grid, repeat after repeat.
//!
//! As a [`Lane`](super::lane::Lane), it computes its next move in advance. All its ticks are pattern time, counted from the first repeat's
//! beginning; the onset is added last.
//!
//! Where repeats follow each other the waveform of one goes on in the next: a waveform whose ends meet is played without a seam. The pin is
//! at rest at the end of the play, and of each repeat if the motor has drives too: if the waveform is too high for that, it comes down
//! before.
//!
//! Invariant: the next move is found with bounded work. Steps in which the waveform stays about the level that the pin has are passed over,
//! and if [`MOST_WORK`] finds no move, there is one to the level that the pin has.

use super::drive::NEVER;
use super::options::{StrokeOptions, Surplus};
use super::repeat::Repeat;
use crate::motion::{
    Grid, LEAST_ERROR_UM, MotionError, Reached, Rule, SLOWEST_STEP_MS, STEPS_MS, Section, Waveform, ns_at,
    ns_of, steps_within, tick_of,
};
use crate::motor::MAX_AMPLITUDE_UM;
use crate::pattern::Pattern;
use crate::reflected_walk::Bursts;
use crate::spec::Array;
use crate::strokes::Step;
use firmware_protocol::limits::correction;
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;

/// Steps and knots that are looked at for a move, at most; some thousand knots more if the last step has so many. Some 50 µs of work.
const MOST_WORK: u64 = 4_096;

/// The moves of a motor that follow a waveform whose time 0 is tick 0, in order of time. Surplus is 0.
pub(crate) fn moves(array: Array, motor: u8, waveform: &Waveform, grid: Grid) -> Vec<Move> {
    let mut lane = MotionLane::new(array, motor, waveform.clone(), grid);
    let (mut moves, mut begins) = (Vec::new(), lane.begin(NEVER));
    while begins != NEVER {
        let (next, from) = lane.next;
        // After much work for a move there is one to the level that the pin has.
        moves.extend(Some(next).filter(|next| next.level != from));
        begins = lane.advance();
    }
    moves
}

/// The coarsest grid, of 1 to 4 ms, on which each pin stays within `error_um` of what the motor can do at best
/// ([`Reached::step_error_um`], measured from the moves); `None`: a burst of `least_pulses`. If none does, the finest grid of which the
/// controller takes the moves of so many motors. Of long waveforms the first `tried_s` decide, shared among the motors.
///
/// # Errors
/// If `error_um` is below [`LEAST_ERROR_UM`].
pub(crate) fn choose<'a>(
    array: Array,
    motors: impl ExactSizeIterator<Item = (u8, &'a Waveform)> + Clone,
    error_um: Option<f64>,
    tried_s: f64,
) -> Result<Grid, MotionError> {
    let error_um = error_um.unwrap_or(f64::from(array.motor().least_pulses) * array.motor().um_per_pulse);
    MotionError::check("error_um", "um", error_um, LEAST_ERROR_UM, MAX_AMPLITUDE_UM)?;
    let (ticks, most) = (array.layout().dense_ticks(), usize::from(array.layout().max_dense()));
    let tried_ns = tried_ns(tried_s, motors.len());
    let mut finest = Grid::of_ms(array, SLOWEST_STEP_MS);
    for step_ms in STEPS_MS {
        let grid = Grid::of_ms(array, step_ms);
        if motors.len() * (ticks / grid.step_ticks + 1) as usize > most {
            break;
        }
        finest = grid;
        let is_within = |(motor, waveform): (u8, &Waveform)| {
            let waveform = waveform.first(tried_ns);
            let moves = moves(array, motor, &waveform, grid);
            steps_within(array, &waveform, &moves, error_um)
        };
        if motors.clone().all(is_within) {
            break;
        }
    }
    Ok(finest)
}

/// How much of each motion is tried and measured, ns, if so many motors share it.
pub(crate) fn tried_ns(tried_s: f64, motors: usize) -> u64 {
    ns_of(tried_s) / motors.max(1) as u64
}

/// The moves of a motor in the first so many nanoseconds of its waveform's span, and what it reaches by then: work that does not grow with
/// a waveform of years. Of a shorter waveform all.
pub(crate) fn beginning(
    array: Array,
    motor: u8,
    whole: &Waveform,
    grid: Grid,
    ns: u64,
) -> (Vec<Move>, Reached) {
    let waveform = whole.first(ns);
    let mut moves = moves(array, motor, &waveform, grid);
    let cut_ns = waveform.span_ns().zip(whole.span_ns()).and_then(|(of, whole)| (of < whole).then_some(of.1));
    // Where it is cut the pin would come down.
    let end =
        cut_ns.map(|ns| tick_of(ns, array.rate()) / u64::from(grid.step_ticks) * u64::from(grid.step_ticks));
    moves.retain(|of| end.is_none_or(|end| of.tick.0 < end));
    let reached = Reached::of(array, &waveform, &moves, end);
    (moves, reached)
}

#[derive(Clone, Debug)]
pub(super) struct MotionLane {
    array: Array,
    rule: Rule,
    /// As high as it is played.
    waveform: Waveform,
    tried_s: f64,
    surplus: Surplus,
    duration_s: Option<f64>,
    /// From here on the waveform is at rest, if it is not repeated.
    over: u64,
    /// The displacements at which it never leaves rest, µm, include those of the whole waveform.
    is_silent: bool,
    /// The motor has drives too: each repeat begins and ends at rest.
    has_drives: bool,
    /// The end of the play.
    end: u64,
    repeat: Repeat,
    /// The next step.
    number: u64,
    level: u16,
    /// Since the pin was at rest.
    bursts: Bursts,
    /// The next move, in pattern time, and the level before it.
    next: (Move, u16),
    /// Steps and knots that were looked at for it.
    work: u64,
}

impl MotionLane {
    /// The lanes of a pattern's motions, on this grid.
    pub(super) fn of_pattern(
        pattern: &Pattern,
        grid: Grid,
        options: &StrokeOptions,
    ) -> impl Iterator<Item = Self> {
        pattern.waveforms().iter().map(move |(motor, waveform)| Self {
            tried_s: options.tried_s,
            surplus: options.surplus.clone(),
            duration_s: pattern.duration_s(),
            has_drives: pattern.drives().iter().any(|drive| drive.motor == *motor),
            ..Self::new(pattern.array(), *motor, waveform.clone().scaled(options.scale), grid)
        })
    }

    /// A waveform alone, without a surplus.
    fn new(array: Array, motor: u8, waveform: Waveform, grid: Grid) -> Self {
        let rule = Rule::new(array, grid);
        Self {
            array,
            rule,
            is_silent: waveform.extremes_um()[1] < rule.kept_um(0)[1],
            over: waveform.span_ns().map_or(0, |(_, until)| tick_of(until, array.rate())),
            waveform,
            tried_s: 0.0,
            surplus: Surplus::None,
            duration_s: None,
            has_drives: false,
            end: NEVER,
            repeat: Repeat::of(0, None, array.rate()),
            number: 0,
            level: 0,
            bursts: Bursts::default(),
            next: (Move { motor, tick: Tick(0), level: 0, surplus: 0 }, 0),
            work: 0,
        }
    }

    pub(super) const fn array(&self) -> Array {
        self.array
    }

    pub(super) const fn motor(&self) -> u8 {
        self.next.0.motor
    }

    /// The grid of its moves.
    pub(super) const fn grid(&self) -> Grid {
        self.rule.grid()
    }

    /// How much of the motions is measured before the play, s; all motors share it.
    pub(super) const fn tried_s(&self) -> f64 {
        self.tried_s
    }

    /// The motor's waveform in one run, as high as it is played.
    pub(super) const fn waveform(&self) -> &Waveform {
        &self.waveform
    }

    /// Goes back to the beginning of a play that ends at `end`; returns when the first move begins.
    pub(super) fn begin(&mut self, end: u64) -> u64 {
        self.end = end;
        self.repeat = Repeat::of(0, self.duration_s, self.rule.rate);
        (self.number, self.level, self.bursts) = (0, 0, Bursts::default());
        self.advance()
    }

    /// The next move of a play that began at `onset`.
    pub(super) fn step(&self, onset: Tick) -> Step {
        let (of, from) = self.next;
        Step::Move { of: Move { tick: onset + of.tick.0, ..of }, from }
    }

    /// The steps of the grid and the knots of the waveform that were looked at for the next move.
    pub(super) const fn work(&self) -> u64 {
        self.work
    }

    /// Takes the next move and computes the one after it; returns when that begins.
    pub(super) fn advance(&mut self) -> u64 {
        let step = u64::from(self.rule.step);
        self.work = 0;
        loop {
            let start = self.number * step;
            let is_over = start >= self.end || (self.duration_s.is_none() && start >= self.over);
            if (is_over || self.is_silent) && self.level == 0 {
                return NEVER;
            }
            while self.repeat.end <= start {
                self.repeat = Repeat::of(self.repeat.number + 1, self.duration_s, self.rule.rate);
            }
            // From the next step on there must be time to come down.
            let highest = self.rests_at().saturating_sub(start + step);
            let section = self.section(start, start + step);
            self.work += 1 + section.knots as u64;
            let goal = self.rule.next_level(self.level, &section);
            let lowest = u64::from(self.level).saturating_sub(step);
            let goal = u64::from(goal).min(highest.max(lowest)) as u16;
            self.number += 1;
            if goal != self.level || self.work >= MOST_WORK {
                self.go(start, goal);
                return start;
            }
            self.skip(start);
        }
    }

    /// When the pin has to be at rest.
    fn rests_at(&self) -> u64 {
        if self.has_drives { self.end.min(self.repeat.end) } else { self.end }
    }

    /// The next move is to this level.
    fn go(&mut self, start: u64, goal: u16) {
        let travel = f64::from(goal) - f64::from(self.level);
        if travel != 0.0 {
            self.bursts.add(travel * self.array.motor().um_per_pulse);
        }
        let mut surplus = 0;
        if goal == 0 && self.level > 0 {
            let most = correction(self.array.layout().max_up_pulses());
            surplus = self.surplus.pulses_after(self.array, self.motor(), &self.bursts, most);
            self.bursts = Bursts::default();
        }
        let of = Move { motor: self.motor(), tick: Tick(start), level: goal, surplus };
        self.next = (of, std::mem::replace(&mut self.level, goal));
    }

    /// Passes over the steps after that at `start` in which the pin stays where it is.
    fn skip(&mut self, start: u64) {
        let (step, rate) = (u64::from(self.rule.step), self.rule.rate);
        // A scale of 0 is silent, and never comes here.
        let kept_um = self.rule.kept_um(self.level);
        let (steady, knots) = self.waveform.stays_until(ns_at(start - self.repeat.start, rate), kept_um);
        self.work += knots as u64;
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
            let Section { rise_um, mean_um, extremes_um: [low, high], knots } =
                self.waveform.section(begin, end);
            let share = (until - at) as f64 / (to - from) as f64;
            let before = whole.unwrap_or(Section { extremes_um: [low, high], ..Section::default() });
            whole = Some(Section {
                knots: before.knots + 1 + knots,
                rise_um: before.rise_um + rise_um,
                mean_um: before.mean_um + share * mean_um,
                extremes_um: [low.min(before.extremes_um[0]), high.max(before.extremes_um[1])],
            });
            (at, repeat) = (until, Repeat::of(repeat.number + 1, self.duration_s, rate));
        }
        whole.unwrap_or_default()
    }
}
