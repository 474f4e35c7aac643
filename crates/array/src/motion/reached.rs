//! What a motor will do with its moves, told before anything is played: its path, its error, and where it is too slow.
//!
//! The path is that of the ideal motor: one pulse a tick, then the motor's own response. It is compared with the waveform at some 5 000
//! instants a second, among them each tick of a grid of whole milliseconds.
//!
//! Invariant: nothing is clamped before it is compared, except in [`Reached::step_error_um`], which says so.

use super::moves::{ns_at, tick_of};
use super::waveform::{Waveform, s_of};
use crate::motor::{HalfTick, Ramp, Shaft};
use crate::spec::{Array, MotorSpec};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// Samples per millisecond.
const PER_MS: u64 = 5;

/// The path of one pin, asked at instants in order of time.
#[derive(Debug)]
pub struct Path<'a> {
    ahead: std::slice::Iter<'a, Move>,
    shaft: Shaft,
    um_per_pulse: f64,
    level: u16,
}

impl<'a> Path<'a> {
    /// The path of an ideal motor of the array that plays these moves of one motor, in order of time.
    #[must_use]
    pub fn new(array: Array, moves: &'a [Move]) -> Self {
        let motor = array.spec().motor();
        Self { ahead: moves.iter(), shaft: Shaft::new(motor), um_per_pulse: motor.um_per_pulse, level: 0 }
    }

    /// The commanded position and the displacement, after the motor's response, at an instant not before the last one, µm.
    pub fn um_at(&mut self, at: HalfTick) -> [f64; 2] {
        while let Some(next) = self.ahead.as_slice().first().filter(|next| HalfTick::from(next.tick) <= at) {
            let way = if next.level > self.level { Direction::Up } else { Direction::Down };
            let pulses = next.level.abs_diff(self.level).into();
            self.shaft.push(Ramp::new(next.tick, pulses, way, self.um_per_pulse));
            self.level = next.level;
            self.ahead.next();
        }
        [self.shaft.position_um(at), self.shaft.displacement_um(at)]
    }
}

/// How far the displacement is from a reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Root mean square of the difference, µm.
    pub rms_um: f64,
    /// It as a share of the RMS of the reference; 0 if the reference is at rest.
    pub share: f64,
    /// The correlation r; `None` if one of both does not move.
    pub correlation: Option<f64>,
    /// The largest difference of either sign, µm.
    pub peak_um: f64,
}

/// What a motor reaches of a waveform.
#[derive(Clone, Debug, PartialEq)]
pub struct Reached {
    /// The displacement against the waveform itself: the motor's lag and smoothing count.
    pub from_asked: Deviation,
    /// The displacement against the waveform after the motor's response: what speed, range and steps cost.
    pub from_filtered: Deviation,
    /// The largest difference, µm, from what a motor of the same speed and range would reach without steps and shortest bursts:
    /// what the compilation costs.
    pub step_error_um: f64,
    /// When the waveform is ahead of the motor's highest speed by more than a burst of `least_pulses`: from and until, s. Range does not
    /// count.
    pub too_slow_s: Vec<(f64, f64)>,
    /// Moves in all.
    pub moves: usize,
    /// Moves per second, from the beginning of the waveform until the pin rests again.
    pub moves_per_s: f64,
    /// The most moves that begin within a second.
    pub busiest_second: usize,
    /// The lowest displacement asked, µm; below 0 the pin cannot follow.
    pub lowest_um: f64,
    /// The highest displacement asked, µm. The motor's travel and `most_pulses` may be less.
    pub highest_um: f64,
}

/// Sums for a [`Deviation`].
#[derive(Default)]
struct Comparison {
    count: f64,
    sum: [f64; 2],
    square: [f64; 2],
    product: f64,
    error_square: f64,
    peak_um: f64,
}

impl Comparison {
    fn add(&mut self, reference: f64, reached: f64) {
        self.count += 1.0;
        for (place, um) in [reference, reached].into_iter().enumerate() {
            self.sum[place] += um;
            self.square[place] += um * um;
        }
        self.product += reference * reached;
        self.error_square += (reached - reference).powi(2);
        self.peak_um = self.peak_um.max((reached - reference).abs());
    }

    fn deviation(&self) -> Deviation {
        if self.count == 0.0 {
            return Deviation::default();
        }
        let variance = |place: usize| self.square[place] - self.sum[place] * self.sum[place] / self.count;
        let scale = (variance(0) * variance(1)).sqrt();
        let covariance = self.product - self.sum[0] * self.sum[1] / self.count;
        let rms = |square: f64| (square / self.count).sqrt();
        let reference = rms(self.square[0]);
        Deviation {
            rms_um: rms(self.error_square),
            share: if reference > 0.0 { rms(self.error_square) / reference } else { 0.0 },
            correlation: (scale > 0.0).then(|| (covariance / scale).clamp(-1.0, 1.0)),
            peak_um: self.peak_um,
        }
    }
}

/// A function of time after a motor's response: pushed sample by sample, linear between.
struct Filtered {
    shaft: Shaft,
    um: f64,
}

impl Filtered {
    fn new(motor: &MotorSpec) -> Self {
        Self { shaft: Shaft::new(motor), um: 0.0 }
    }

    /// What the response makes of it at the end of a line to `um`, which begins at `from`.
    #[expect(clippy::cast_possible_truncation, reason = "a fifth of a millisecond")]
    fn next(&mut self, from: u64, ticks: u64, um: f64) -> f64 {
        self.shaft.push(Ramp::travelled(Tick(from), ticks as u32, um - self.um));
        self.um = um;
        self.shaft.displacement_um(HalfTick(2 * (from + ticks)))
    }
}

impl Reached {
    /// What an ideal motor reaches with these moves, which follow the waveform. Takes some 2 ms per second of the waveform.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "a count of moves")]
    pub fn of(array: Array, waveform: &Waveform, moves: &[Move]) -> Self {
        let (motor, rate) = (array.spec().motor(), array.rate());
        let [lowest_um, highest_um] = waveform.extremes_um();
        let every = rate.of_ms(1) / PER_MS;
        let (from, until) = waveform.span_ns().map_or((0, 0), |(from, until)| {
            let last = moves.last().map_or(0, |last| last.tick.0 + rate.of_ms(1));
            let from = tick_of(from, rate).saturating_sub(every) / every * every;
            (from, last.max(tick_of(until, rate)) + motor.settled_ticks())
        });
        let mut path = Path::new(array, moves);
        let (mut filtered, mut best) = (Filtered::new(motor), Filtered::new(motor));
        let (mut from_asked, mut from_filtered) = (Comparison::default(), Comparison::default());
        let (mut step_error_um, mut too_slow): (f64, Vec<(u64, u64)>) = (0.0, Vec::new());
        let most_um = f64::from(motor.most_pulses) * motor.um_per_pulse;
        let least_um = f64::from(motor.least_pulses) * motor.um_per_pulse;
        let most_step_um = ticks_um(motor, every);
        for start in (from..until).step_by(usize::try_from(every).unwrap_or(usize::MAX)) {
            let end = start + every;
            let asked = waveform.um_at(ns_at(end, rate));
            let [_, um] = path.um_at(HalfTick(2 * end));
            from_asked.add(asked, um);
            from_filtered.add(filtered.next(start, every, asked), um);
            // The fastest motor that has this one's speed: it goes to what is asked as soon as it can.
            let possible = asked.clamp(0.0, most_um);
            let limited = best.um + (possible - best.um).clamp(-most_step_um, most_step_um);
            step_error_um = step_error_um.max((best.next(start, every, limited) - um).abs());
            if (possible - limited).abs() > least_um {
                match too_slow.last_mut().filter(|last| last.1 == start) {
                    Some(last) => last.1 = end,
                    None => too_slow.push((start, end)),
                }
            }
        }
        let seconds = |tick| s_of(ns_at(tick, rate));
        Self {
            from_asked: from_asked.deviation(),
            from_filtered: from_filtered.deviation(),
            step_error_um,
            too_slow_s: too_slow.into_iter().map(|(from, until)| (seconds(from), seconds(until))).collect(),
            moves: moves.len(),
            moves_per_s: if until > from { moves.len() as f64 / seconds(until - from) } else { 0.0 },
            busiest_second: busiest(moves, rate.per_s()),
            lowest_um,
            highest_um,
        }
    }
}

#[expect(clippy::cast_precision_loss, reason = "a fifth of a millisecond")]
fn ticks_um(motor: &MotorSpec, ticks: u64) -> f64 {
    ticks as f64 * motor.um_per_pulse
}

/// The most moves that begin within so many ticks.
fn busiest(moves: &[Move], ticks: u64) -> usize {
    let mut first = 0;
    let count = |(last, newest): (usize, &Move)| {
        while newest.tick - moves[first].tick >= ticks {
            first += 1;
        }
        last + 1 - first
    };
    moves.iter().enumerate().map(count).max().unwrap_or(0)
}
