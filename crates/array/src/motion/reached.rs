//! What a motor will do with its moves, told before anything is played: its path, its error, and where it is too slow.
//!
//! The path is that of the ideal motor: one pulse a tick, then the motor's own response. It is compared with the waveform at some 5 000
//! instants a second, among them each tick of a grid of whole milliseconds.
//!
//! Invariant: nothing is clamped before it is compared, except in [`Reached::step_error_um`], which says so.

use super::waveform::{Waveform, ns_at, s_of, tick_of};
use crate::motor::{HalfTick, Path, Ramp, Shaft};
use crate::spec::{Array, MotorSpec};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// Samples per millisecond.
const PER_MS: u64 = 5;

/// The path of an ideal motor of the array that plays these moves of one motor, in order of time.
fn path(array: Array, moves: &[Move]) -> Path {
    let (motor, mut level) = (array.spec().motor(), 0);
    let mut path = Path::new(motor);
    path.extend(moves.iter().map(|next| {
        let way = if next.level > level { Direction::Up } else { Direction::Down };
        let pulses = next.level.abs_diff(level).into();
        level = next.level;
        Ramp::new(next.tick, pulses, way, motor.um_per_pulse)
    }));
    path
}

/// How far the displacement is from a reference.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    /// Root mean square of the difference, µm.
    pub rms_um: f64,
    /// It as a share of the RMS of the reference about its mean; 0 if the reference does not move.
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
    /// The longest time above rest from the last pulse of a move to the next move, s.
    pub longest_hold_s: f64,
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
        let reference = rms(variance(0).max(0.0));
        Deviation {
            rms_um: rms(self.error_square),
            share: if reference > 0.0 { rms(self.error_square) / reference } else { 0.0 },
            correlation: (scale > 0.0).then(|| (covariance / scale).clamp(-1.0, 1.0)),
            peak_um: self.peak_um,
        }
    }
}

/// A function of time after a motor's response: pushed line by line.
struct Filtered {
    shaft: Shaft,
    um: f64,
}

impl Filtered {
    fn new(motor: &MotorSpec) -> Self {
        Self { shaft: Shaft::new(motor), um: 0.0 }
    }

    /// What the response makes of it at the end of a line from one value to another. A jump before it takes the first tick.
    fn next(&mut self, start: u64, ticks: u64, [from_um, to_um]: [f64; 2]) -> f64 {
        let jump = u64::from(from_um != self.um);
        self.shaft.push(Ramp::travelled(Tick(start), jump as u32, from_um - self.um));
        self.shaft.push(Ramp::travelled(Tick(start + jump), (ticks - jump) as u32, to_um - from_um));
        self.um = to_um;
        self.shaft.displacement_um(HalfTick(2 * (start + ticks)))
    }
}

/// A motor's path beside what was asked, at [`PER_MS`] instants a millisecond.
struct Tracking<'a> {
    array: Array,
    waveform: &'a Waveform,
    path: Path,
    /// A motor of this speed and range without steps: it goes to what is asked as soon as it can.
    best: Filtered,
    /// What was asked at the last instant, after a jump there.
    begins_um: f64,
    /// Ticks from which, until which and in steps of which it samples.
    from: u64,
    until: u64,
    every: u64,
}

/// The time from one instant to the next, and what is there at its end.
struct Sample {
    start: u64,
    end: u64,
    /// The displacement.
    um: f64,
    /// What was asked from the beginning to the end.
    asked_um: [f64; 2],
    /// What the motor without steps is off by, before its response.
    behind_um: f64,
    /// How far the displacement is from that of the motor without steps.
    step_error_um: f64,
}

impl<'a> Tracking<'a> {
    /// Up to a tick, or until the motor has settled.
    fn new(array: Array, waveform: &'a Waveform, moves: &[Move], end: Option<u64>) -> Self {
        let (motor, rate) = (array.spec().motor(), array.rate());
        let every = rate.of_ms(1) / PER_MS;
        let (from, until) = waveform.span_ns().map_or((0, 0), |(from, until)| {
            let last = moves.last().map_or(0, |last| last.tick.0 + rate.of_ms(1));
            let from = tick_of(from, rate).saturating_sub(every) / every * every;
            (from, end.unwrap_or_else(|| last.max(tick_of(until, rate)) + motor.settled_ticks()))
        });
        let (path, best) = (path(array, moves), Filtered::new(motor));
        let begins_um = waveform.um_at(ns_at(from, rate));
        Self { array, waveform, path, best, begins_um, from, until, every }
    }
}

impl Iterator for Tracking<'_> {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        let (motor, start) = (self.array.spec().motor(), self.from);
        if start >= self.until {
            return None;
        }
        let end = start + self.every;
        self.from = end;
        let [asked_um, next_um] = self.waveform.um_around(ns_at(end, self.array.rate()));
        let asked_um = [std::mem::replace(&mut self.begins_um, next_um), asked_um];
        let um = self.path.um_at(HalfTick(2 * end));
        let possible = asked_um[1].clamp(0.0, f64::from(motor.most_pulses) * motor.um_per_pulse);
        let most_step_um = ticks_um(motor, self.every);
        let limited = self.best.um + (possible - self.best.um).clamp(-most_step_um, most_step_um);
        let best_um = self.best.next(start, self.every, [self.best.um, limited]);
        let (behind_um, step_error_um) = ((possible - limited).abs(), (best_um - um).abs());
        Some(Sample { start, end, um, asked_um, behind_um, step_error_um })
    }
}

/// Whether [`Reached::step_error_um`] of moves is at most this.
pub(crate) fn steps_within(array: Array, waveform: &Waveform, moves: &[Move], error_um: f64) -> bool {
    Tracking::new(array, waveform, moves, None).all(|sample| sample.step_error_um <= error_um)
}

impl Reached {
    /// What an ideal motor reaches with these moves, which follow the waveform, up to a tick, if one is given. Takes about 1 ms per second of
    /// the waveform.
    pub(crate) fn of(array: Array, waveform: &Waveform, moves: &[Move], end: Option<u64>) -> Self {
        let (motor, rate) = (array.spec().motor(), array.rate());
        let samples = Tracking::new(array, waveform, moves, end);
        let (from, until) = (samples.from, samples.until);
        let mut filtered = Filtered::new(motor);
        let (mut from_asked, mut from_filtered) = (Comparison::default(), Comparison::default());
        let (mut step_error_um, mut too_slow): (f64, Vec<(u64, u64)>) = (0.0, Vec::new());
        let least_um = f64::from(motor.least_pulses) * motor.um_per_pulse;
        for Sample { start, end, um, asked_um, behind_um, step_error_um: off_um } in samples {
            from_asked.add(asked_um[1], um);
            from_filtered.add(filtered.next(start, end - start, asked_um), um);
            step_error_um = step_error_um.max(off_um);
            if behind_um > least_um {
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
            longest_hold_s: rate.ticks_to_seconds(longest_hold(moves)),
        }
    }
}

fn ticks_um(motor: &MotorSpec, ticks: u64) -> f64 {
    ticks as f64 * motor.um_per_pulse
}

/// The longest time above rest without a pulse, in ticks.
fn longest_hold(moves: &[Move]) -> u64 {
    let mut level = 0;
    let held = |two: &[Move]| {
        let pulses = two[0].level.abs_diff(level);
        level = two[0].level;
        if level > 0 { (two[1].tick - two[0].tick).saturating_sub(pulses.into()) } else { 0 }
    };
    moves.windows(2).map(held).max().unwrap_or(0)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::tests::{ramp, tone};
    use crate::motion::{Envelope, Grid};
    use crate::strokes::{choose, moves};
    use std::f64::consts::{PI, TAU};

    /// The displacement at each tick of a second, by the paper's motor on this grid; of a play that begins at 0.
    fn second_um(waveform: &Waveform, ms: u64) -> Vec<f64> {
        let array = Array::paper();
        let moves = moves(array, 9, waveform, Grid::of_ms(array, ms));
        let mut path = path(array, &moves);
        (0..85_000).map(|tick| path.um_at(HalfTick(2 * tick))).collect()
    }

    /// Amplitude of a whole number of cycles, by projection on sine and cosine.
    fn amplitude(um: &[f64], cycles: f64) -> f64 {
        let count = um.len() as f64;
        let part = |shift: f64| -> f64 {
            um.iter().enumerate().map(|(n, um)| um * (TAU * cycles * n as f64 / count + shift).cos()).sum()
        };
        2.0 / count * part(0.0).hypot(part(PI / 2.0))
    }

    fn reached(array: Array, waveform: &Waveform, error_um: Option<f64>) -> Reached {
        let grid = choose(array, [(0, waveform)].into_iter(), error_um, 240.0).unwrap();
        let moves = moves(array, 0, waveform, grid);
        Reached::of(array, waveform, &moves, None)
    }

    #[test]
    fn a_ramp_of_200_um_in_50_ms_is_followed() {
        let found = reached(Array::paper(), &ramp(200.0, 0.05).waveform().unwrap(), None);
        assert!(found.step_error_um < 0.95 && found.from_filtered.peak_um < 0.95, "{found:?}");
        assert!(found.from_filtered.correlation.unwrap() > 0.9999 && found.too_slow_s.is_empty());
        // In the ramp, a moving average over 4.3 ms is 2.15 ms late; after it, it has arrived.
        let um = second_um(&ramp(200.0, 0.05).waveform().unwrap(), 2);
        let at = |ms: f64| um[(ms * 85.0) as usize];
        assert!((at(125.0) - 4.0 * (25.0 - 2.15)).abs() < 0.95, "{}", at(125.0));
        assert!((at(155.0) - 200.0).abs() < 0.1, "{}", at(155.0));
        assert!(at(410.0).abs() < 1e-9);
        // Held from 150 to 350 ms, on a grid of 2 ms.
        assert!((0.199..0.204).contains(&found.longest_hold_s), "{}", found.longest_hold_s);
        assert!((found.from_asked.peak_um - 4.0 * 2.15).abs() < 1.0);
    }

    #[test]
    fn a_hann_burst_of_40_hz_has_no_third_harmonic() {
        for (amplitude_um, ms) in [(80.0, 1), (40.0, 1), (20.0, 2)] {
            let um = second_um(&tone(40.0, 40.0, amplitude_um, Some(Envelope::HANN)).waveform().unwrap(), ms);
            let [first, third] = [40.0, 120.0].map(|cycles| amplitude(&um, cycles));
            let db = 20.0 * (third / first).log10();
            println!("Hann 40 Hz, {amplitude_um} um, {ms} ms: third harmonic {db:.1} dB");
            assert!(db < -40.0, "{amplitude_um} um: {db}");
            // Half the amplitude, half the envelope, and the mean over 4.3 ms of a sine of 40 Hz. The steps are two means more.
            let expected = amplitude_um / 4.0 * (PI * 40.0 * 0.0043).sin() / (PI * 40.0 * 0.0043);
            assert!((first / expected - 1.0).abs() < 0.02, "{first} instead of {expected}");
        }
    }

    #[test]
    fn what_a_motor_cannot_do_is_told() {
        // 200 um at 11.536 mm/s take 17.34 ms; the last 0.95 um of the way count as there.
        let jump = reached(Array::paper(), &ramp(200.0, 0.0).waveform().unwrap(), None);
        let [(from, until), (down, _)] = jump.too_slow_s[..] else { panic!("{jump:?}") };
        assert!(
            (from - 0.1).abs() < 3e-4 && (until - 0.1 - 0.01725).abs() < 3e-4 && (down - 0.3).abs() < 3e-4
        );
        assert!(jump.from_asked.peak_um > 195.0 && jump.step_error_um < 0.95, "{jump:?}");
        // 60 um peak to peak at 100 Hz would need 18.8 mm/s.
        let fast = reached(Array::paper(), &tone(100.0, 100.0, 60.0, None).waveform().unwrap(), None);
        assert!(fast.too_slow_s.len() > 100 && fast.from_filtered.share > 0.02);
        let low = Waveform::samples(0.0, 10.0, &[0.0, -20.0, 500.0, 500.0, 0.0]).unwrap();
        let low = reached(Array::paper(), &low, None);
        assert!(low.too_slow_s.is_empty());
        assert!((low.from_filtered.peak_um - (500.0 - 3000.0 * 0.95 / 7.0)).abs() < 0.5, "{low:?}");
        let rest = reached(Array::paper(), &Waveform::default(), None);
        assert_eq!((rest.from_asked, rest.moves_per_s), (Deviation::default(), 0.0));
    }
}
