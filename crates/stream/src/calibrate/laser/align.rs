//! Aligns a recording with the bursts of a plan: when the plan began by the sensor's clock, how fast that clock runs, and
//! whether the sensor counts upwards.
//!
//! First a search: the recording's steps, in bins of [`BIN_S`], are correlated with the plan's bursts at every lag and at
//! clock errors of [`SEARCH_PPM`]. Offsets and slow drift have no steps, so they do not matter. Then each burst's middle is
//! measured: the area under a step tells when it happened, whatever its shape. A line through the middles is the clock.
//!
//! The plan's lengths come in an order without repeats, so one lag fits better than all others. A reversed sign with a lag half a
//! stroke longer fits all but one burst of each group. So both are measured, and the one that finds more is taken.
//!
//! Invariant: an alignment puts its bursts' middles on one line, with a slope within [`MAX_CLOCK_PPM`] of 1.

use crate::calibrate::laser::error::{LEAST_CORRELATION, LaserError, MAX_CLOCK_PPM};
use crate::calibrate::laser::played::{PlayedBurst, PlayedPlan};
use crate::calibrate::laser::recording::{Recording, Sample};
use firmware_protocol::stroke::Direction;
use serde::Serialize;

/// The bins of the search, s.
const BIN_S: f64 = 0.01;
/// Bins on either side of a step. Bursts are 125 ms apart.
const SIDE: usize = 5;
/// Clock errors tried, ppm: neighbours differ by 22 ms at the ends of the longest plan, and a step is 100 ms wide.
const SEARCH_PPM: [f64; 9] = [-1200.0, -900.0, -600.0, -300.0, 0.0, 300.0, 600.0, 900.0, 1200.0];
/// Windows about a burst's middle: their half length and the part about the middle where no level is measured, s. The first
/// is for an error of the search.
const WINDOWS: [(f64, f64); 3] = [(0.060, 0.030), (0.040, 0.012), (0.040, 0.012)];
/// The longest gap between samples in a window, in sampling steps.
const MOST_MISSING: f64 = 5.0;
/// Bursts at least for a line.
const MIN_BURSTS: usize = 20;
/// Steps below this share of the plan's do not count as steps.
const STILL: f64 = 0.1;
/// Middles farther than so many standard deviations from the line do not count.
const OUTLIER_SD: f64 = 4.0;

/// A figure and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// The estimate.
    pub value: f64,
    /// One standard deviation of the estimate.
    pub sd: f64,
}

/// Where the plan lies in a recording.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alignment {
    /// The sensor's time at plan time 0, s, and its seconds per second of the device.
    onset_s: f64,
    rate: f64,
    /// One standard deviation of each.
    onset_sd_s: f64,
    rate_sd: f64,
    /// 1, or -1 for a sensor that counts downwards.
    pub(super) sign: f64,
    /// Correlation of the steps at the bursts with the plan's.
    pub(super) correlation: f64,
}

/// The middle of a burst's motion in plan time, s, and its travel by the model, µm, signed.
fn middle(played: &PlayedPlan, burst: &PlayedBurst) -> (f64, f64) {
    let array = played.array();
    let motor = array.motor();
    let after = (f64::from(burst.pulses) + motor.window_ticks()) / 2.0 / f64::from(array.rate().hz());
    let um = f64::from(burst.pulses) * motor.um_per_pulse;
    let burst = burst.burst();
    (played.seconds(burst.start) + after, if burst.direction == Direction::Up { um } else { -um })
}

impl Alignment {
    pub(super) fn of(played: &PlayedPlan, recording: &Recording) -> Result<Self, LaserError> {
        let motor = played.motor();
        let middles: Vec<(f64, f64)> = played.bursts().iter().map(|burst| middle(played, burst)).collect();
        let [first, second] = search(&middles, recording)
            .map(|(line, sign)| Candidate::refined(motor, &middles, recording, line, sign));
        let best = match (first, second) {
            (Ok(first), Ok(second)) if second.explained > first.explained => second,
            (Ok(first), _) => first,
            (Err(_), Ok(second)) => second,
            (Err(problem), Err(_)) => return Err(problem),
        };
        let Candidate { line: found, sign, correlation, .. } = best;
        let ppm = (found.rate - 1.0) * 1e6;
        if ppm.abs() > MAX_CLOCK_PPM {
            return Err(LaserError::Clock { ppm });
        }
        let Line { middle_s, at_s, rate, at_sd_s, rate_sd } = found;
        Ok(Self {
            onset_s: at_s - rate * middle_s,
            rate,
            onset_sd_s: at_sd_s.hypot(rate_sd * middle_s),
            rate_sd,
            sign,
            correlation,
        })
    }

    /// The sensor's time at a time of the plan, s.
    pub(super) fn sensor_s(&self, plan_s: f64) -> f64 {
        self.onset_s + self.rate * plan_s
    }

    /// The plan's time at a time of the sensor, s.
    pub(super) fn plan_s(&self, sensor_s: f64) -> f64 {
        (sensor_s - self.onset_s) / self.rate
    }

    pub(super) fn clock_error_ppm(&self) -> Figure {
        Figure { value: (self.rate - 1.0) * 1e6, sd: self.rate_sd * 1e6 }
    }

    pub(super) fn first_burst_s(&self) -> Figure {
        Figure { value: self.onset_s, sd: self.onset_sd_s }
    }
}

/// An alignment that was looked at closely.
struct Candidate {
    line: Line,
    sign: f64,
    correlation: f64,
    /// How much of the recording's steps the plan explains, with the best common gain, µm².
    explained: f64,
}

impl Candidate {
    fn refined(
        motor: u8,
        middles: &[(f64, f64)],
        recording: &Recording,
        mut line: Line,
        sign: f64,
    ) -> Result<Self, LaserError> {
        let (mut correlation, mut explained) = (0.0, 0.0);
        for window in WINDOWS {
            let steps = steps(middles, recording, &line, window);
            let step_um = rms(steps.iter().map(|step| step.um));
            let expected_um = rms(steps.iter().map(|step| step.expected_um));
            if steps.len() < MIN_BURSTS {
                let (covered, planned) = (steps.len(), middles.len());
                return Err(LaserError::TooFew { covered, planned });
            }
            if step_um < STILL * expected_um {
                return Err(LaserError::Still { motor, um: step_um, expected_um });
            }
            let product = sign * steps.iter().map(|step| step.um * step.expected_um).sum::<f64>();
            let count = steps.len() as f64;
            correlation = product / count / step_um / expected_um;
            explained = product * product / count / (expected_um * expected_um);
            if correlation.is_nan() || correlation < LEAST_CORRELATION {
                return Err(LaserError::Unrelated { motor, correlation });
            }
            line = Line::through(&steps);
        }
        Ok(Self { line, sign, correlation, explained })
    }
}

/// Finds the lags and clock errors at which the recording's steps follow the plan's bursts best: upwards and turned round, the
/// better one first. Bins of 10 ms do not tell these two apart.
fn search(middles: &[(f64, f64)], recording: &Recording) -> [(Line, f64); 2] {
    let samples = recording.samples();
    let (first, last) = (samples[0].seconds, samples[samples.len() - 1].seconds);
    let steps = binned_steps(samples, first, ((last - first) / BIN_S) as usize + 1);
    let length = middles.last().map_or(0.0, |last| last.0);
    let (middle_s, before) = (length / 2.0, (length / BIN_S) as usize + 2 * SIDE);
    // Index `before` of the scores is a plan whose middle lies at the recording's beginning.
    let mut best = [1.0, -1.0].map(|sign| (Line::at(middle_s, first, 1.0), sign, 0.0_f64));
    // For each lag: the product of steps and plan, and the plan's square.
    let mut scores = vec![(0.0_f64, 0.0_f64); steps.len() + 2 * before];
    for ppm in SEARCH_PPM {
        let rate = 1.0 + ppm / 1e6;
        scores.fill((0.0, 0.0));
        for &(at, um) in middles {
            // Bins from the plan's middle to this burst.
            let bins = ((at - middle_s) * rate / BIN_S).round() as i64;
            let from = (before as i64 - bins).max(0) as usize;
            let skipped = (bins - before as i64).max(0) as usize;
            let scores = scores.iter_mut().skip(from);
            for (score, step) in scores.zip(steps.iter().skip(skipped)) {
                *score = (score.0 + um * step, score.1 + um * um);
            }
        }
        for (index, &(product, square)) in scores.iter().enumerate() {
            let [up, down] = &mut best;
            let best = if product < 0.0 { down } else { up };
            // What the plan explains with the best common gain: a lag with longer bursts is no better for that.
            let score = product * product / square.max(f64::MIN_POSITIVE);
            if score > best.2 {
                let at_s = first + (index as f64 - before as f64) * BIN_S;
                *best = (Line::at(middle_s, at_s, rate), best.1, score);
            }
        }
    }
    best.sort_by(|one, two| two.2.total_cmp(&one.2));
    best.map(|(line, sign, _)| (line, sign))
}

/// The step at the beginning of each bin: the mean after it less the mean before it, µm; 0 where samples are missing.
fn binned_steps(samples: &[Sample], first: f64, count: usize) -> Vec<f64> {
    let mut bins = vec![(0.0, 0.0); count];
    for sample in samples {
        let bin = &mut bins[(((sample.seconds - first) / BIN_S) as usize).min(count - 1)];
        *bin = (bin.0 + sample.um, bin.1 + 1.0);
    }
    let mean = |range: std::ops::Range<usize>| {
        let full = bins[range].iter().filter(|bin| bin.1 > 0.0);
        let (sum, number) = full.fold((0.0, 0.0), |(sum, number), bin| (sum + bin.0 / bin.1, number + 1.0));
        (number * 2.0 > SIDE as f64).then_some(sum / number)
    };
    let step = |at: usize| {
        if at < SIDE || at + SIDE > count {
            return 0.0;
        }
        mean(at..at + SIDE).zip(mean(at - SIDE..at)).map_or(0.0, |(after, before)| after - before)
    };
    (0..count).map(step).collect()
}

/// A burst's step in the recording.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Its middle in plan time, s.
    plan_s: f64,
    /// Its middle by the sensor's clock, s.
    sensor_s: f64,
    um: f64,
    expected_um: f64,
}

/// The steps at the bursts that the recording covers without a gap.
fn steps(
    middles: &[(f64, f64)],
    recording: &Recording,
    line: &Line,
    (half_s, blind_s): (f64, f64),
) -> Vec<Step> {
    let most_s = MOST_MISSING * recording.median_step_s();
    let whole = |&(plan_s, expected_um): &(f64, f64)| {
        let at = line.sensor_s(plan_s);
        let samples = recording.between(at - half_s, at + half_s);
        let (first, last) = (samples.first()?, samples.last()?);
        let gap = samples.windows(2).map(|two| two[1].seconds - two[0].seconds).fold(0.0, f64::max);
        let ends = (first.seconds - (at - half_s)).max(at + half_s - last.seconds);
        (gap.max(ends) <= most_s).then_some(Around { at, blind_s, samples, plan_s, expected_um })
    };
    let around: Vec<Around<'_>> = middles.iter().filter_map(whole).collect();
    // The sensor's drift is the common slope of the levels.
    let slopes = around.iter().flat_map(|around| [around.slope(Side::Before), around.slope(Side::After)]);
    let (products, squares) = slopes.fold((0.0, 0.0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    let drift = if squares > 0.0 { products / squares } else { 0.0 };
    around.iter().filter_map(|around| around.step(drift)).collect()
}

/// The samples about a burst.
struct Around<'a> {
    /// Its supposed middle by the sensor's clock, s.
    at: f64,
    blind_s: f64,
    samples: &'a [Sample],
    plan_s: f64,
    expected_um: f64,
}

#[derive(Clone, Copy)]
enum Side {
    Before,
    After,
}

impl Around<'_> {
    /// The samples of the level before or after the burst.
    fn level(&self, side: Side) -> impl Iterator<Item = &Sample> {
        self.samples.iter().filter(move |sample| match side {
            Side::Before => sample.seconds < self.at - self.blind_s,
            Side::After => sample.seconds > self.at + self.blind_s,
        })
    }

    /// The sums of a level's regression: products and squares.
    fn slope(&self, side: Side) -> (f64, f64) {
        let Some((seconds, um)) = mean(self.level(side), 0.0) else { return (0.0, 0.0) };
        self.level(side).fold((0.0, 0.0), |sum, sample| {
            let off_s = sample.seconds - seconds;
            (sum.0 + off_s * (sample.um - um), sum.1 + off_s * off_s)
        })
    }

    /// The step without the drift, and its middle.
    fn step(&self, drift: f64) -> Option<Step> {
        let (_, before) = mean(self.level(Side::Before), drift)?;
        let (_, after) = mean(self.level(Side::After), drift)?;
        let um = |sample: &Sample| sample.um - drift * sample.seconds - before;
        let area = |two: &[Sample]| (two[1].seconds - two[0].seconds) * (um(&two[0]) + um(&two[1])) / 2.0;
        let area: f64 = self.samples.windows(2).map(area).sum();
        let sensor_s = self.samples.last()?.seconds - area / (after - before);
        Some(Step { plan_s: self.plan_s, sensor_s, um: after - before, expected_um: self.expected_um })
    }
}

/// The mean time, s, and the mean displacement without the drift, µm.
fn mean<'s>(samples: impl Iterator<Item = &'s Sample>, drift: f64) -> Option<(f64, f64)> {
    let sum = samples.fold((0.0, 0.0, 0.0), |(seconds, um, count), sample| {
        (seconds + sample.seconds, um + sample.um - drift * sample.seconds, count + 1.0)
    });
    (sum.2 > 0.0).then(|| (sum.0 / sum.2, sum.1 / sum.2))
}

fn rms(numbers: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = numbers.fold((0.0, 0_u32), |(sum, count), number| (sum + number * number, count + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

/// The sensor's clock against the plan's: `sensor = at_s + rate (plan - middle_s)`.
#[derive(Clone, Copy, Debug)]
struct Line {
    middle_s: f64,
    at_s: f64,
    rate: f64,
    at_sd_s: f64,
    rate_sd: f64,
}

impl Line {
    const fn at(middle_s: f64, at_s: f64, rate: f64) -> Self {
        Self { middle_s, at_s, rate, at_sd_s: f64::INFINITY, rate_sd: f64::INFINITY }
    }

    fn sensor_s(&self, plan_s: f64) -> f64 {
        self.at_s + self.rate * (plan_s - self.middle_s)
    }

    /// The line through the middles. A middle's error is the noise over the step, so it weighs as the step's square.
    fn through(steps: &[Step]) -> Self {
        // A step that noise has swallowed has no middle.
        let is_clear =
            |step: &&Step| step.um.abs() > STILL * step.expected_um.abs() && step.sensor_s.is_finite();
        let mut kept: Vec<&Step> = steps.iter().filter(is_clear).collect();
        let mut line = Self::at(0.0, 0.0, 1.0);
        for _ in 0..3 {
            let weight = |step: &Step| step.expected_um * step.expected_um;
            let sum =
                |of: &dyn Fn(&Step) -> f64| kept.iter().map(|step| weight(step) * of(step)).sum::<f64>();
            let all = sum(&|_| 1.0);
            let (middle_s, at_s) = (sum(&|step| step.plan_s) / all, sum(&|step| step.sensor_s) / all);
            let squares = sum(&|step| (step.plan_s - middle_s).powi(2));
            let rate = sum(&|step| (step.plan_s - middle_s) * (step.sensor_s - at_s)) / squares;
            let off = |step: &Step| step.sensor_s - at_s - rate * (step.plan_s - middle_s);
            let spread = sum(&|step| off(step).powi(2)) / (kept.len() as f64 - 2.0).max(1.0);
            let (at_sd_s, rate_sd) = ((spread / all).sqrt(), (spread / squares).sqrt());
            line = Self { middle_s, at_s, rate, at_sd_s, rate_sd };
            let near = |step: &Step| off(step).powi(2) * weight(step) <= OUTLIER_SD * OUTLIER_SD * spread;
            let next: Vec<&Step> = kept.iter().copied().filter(|step| near(step)).collect();
            if next.len() < MIN_BURSTS {
                break;
            }
            kept = next;
        }
        line
    }
}
