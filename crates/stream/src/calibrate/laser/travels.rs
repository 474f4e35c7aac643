//! The travel of each burst in an aligned recording, and the sensor's drift and noise.
//!
//! Between bursts the pin rests, so the slope of all rests together is the sensor's drift. Around each burst, least squares fits
//! a level and the burst's travel, with the step of the motor model, to the samples. The step includes ramps and moving average,
//! so a travel is unbiased. Each burst has a level of its own, so a step of the sensor or of the pin elsewhere does not matter.
//!
//! Invariant: a travel has at least [`MIN_SIDE`] samples of rest on either side.

use crate::calibrate::laser::align::{Alignment, Figure};
use crate::calibrate::laser::played::{PlayedBurst, PlayedPlan};
use crate::calibrate::laser::recording::{Recording, Sample};
use crate::calibrate::travel::BurstTravel;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Ramp};
use meissner_array::spec::Array;

/// Samples of rest before and after a burst at least.
const MIN_SIDE: usize = 10;
/// Rest that counts before and after a burst, s at most.
const SIDE_S: f64 = 0.25;
/// Rest that counts for the drift before the first and after the last burst, s at most.
const END_S: f64 = 2.0;

/// A sample beside its fit. The sensor's offset, drift and sign are taken out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracePoint {
    /// Time since the first burst, s, by the device's clock.
    pub seconds: f64,
    /// Measured displacement, µm, upwards.
    pub measured_um: f64,
    /// The motor model's displacement with the fitted travels, µm.
    pub fitted_um: f64,
}

/// What the recording shows.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    array: Array,
    pub(super) travels: Vec<BurstTravel>,
    /// The variance that noise gives each travel, µm², in the same order.
    variances: Vec<f64>,
    pub(super) drift_um_per_s: Figure,
    pub(super) noise_um: f64,
    pub(super) pin_shift_um: Option<f64>,
    pub(super) trace: Vec<TracePoint>,
}

/// A burst with the rests on either side, in plan time, s.
#[derive(Clone, Copy, Debug)]
struct Window {
    array: Array,
    burst: PlayedBurst,
    from_s: f64,
    start_s: f64,
    rests_s: f64,
    to_s: f64,
}

impl Measured {
    pub(super) fn of(played: &PlayedPlan, recording: &Recording, alignment: &Alignment) -> Self {
        let windows = windows(played);
        let between = |from_s: f64, to_s: f64| {
            recording.between(alignment.sensor_s(from_s), alignment.sensor_s(to_s)).iter().map(|sample| {
                Sample { seconds: alignment.plan_s(sample.seconds), um: alignment.sign * sample.um }
            })
        };
        let rests = rests(&windows);
        let (drift, noise_um) = drift(rests.iter().map(|&(from_s, to_s)| between(from_s, to_s)));
        let level = |from_s: f64, to_s: f64| {
            let all: Vec<f64> =
                between(from_s, to_s).map(|sample| sample.um - drift.value * sample.seconds).collect();
            (all.len() >= MIN_SIDE).then(|| all.iter().sum::<f64>() / all.len() as f64)
        };
        let (mut travels, mut variances, mut trace) = (Vec::new(), Vec::new(), Vec::new());
        for window in &windows {
            let samples: Vec<Sample> = between(window.from_s, window.to_s)
                .map(|sample| Sample { um: sample.um - drift.value * sample.seconds, ..sample })
                .collect();
            let count = |is: &dyn Fn(&&Sample) -> bool| samples.iter().filter(is).count();
            if count(&|sample| sample.seconds < window.start_s) < MIN_SIDE
                || count(&|sample| sample.seconds > window.rests_s) < MIN_SIDE
            {
                continue;
            }
            let (level_um, um, variance) = window.step(&samples);
            travels.push(window.travel(played.motor(), um));
            variances.push(variance * noise_um * noise_um);
            // Each sample belongs to the burst before it.
            let own = samples.iter().filter(|sample| sample.seconds >= window.start_s);
            trace.extend(own.map(|sample| TracePoint {
                seconds: sample.seconds,
                measured_um: sample.um,
                fitted_um: level_um + um * window.share(sample.seconds),
            }));
        }
        let ends = rests.first().zip(rests.last());
        let pin_shift_um =
            ends.and_then(|(first, last)| Some(level(last.0, last.1)? - level(first.0, first.1)?));
        let origin = trace.first().map_or(0.0, |first: &TracePoint| first.measured_um);
        for point in &mut trace {
            (point.measured_um, point.fitted_um) = (point.measured_um - origin, point.fitted_um - origin);
        }
        Self {
            array: played.array(),
            travels,
            variances,
            drift_um_per_s: drift,
            noise_um,
            pin_shift_um,
            trace,
        }
    }

    /// The mean variance that noise gives the relative travel of measured bursts of a direction.
    pub(super) fn relative_variance(&self, direction: Direction) -> f64 {
        let of = self.travels.iter().zip(&self.variances);
        let of = of.filter(|(travel, _)| travel.direction == direction && !travel.warm_up);
        let um_per_pulse = self.array.motor().um_per_pulse;
        let relative =
            of.map(|(travel, variance)| variance / (f64::from(travel.pulses) * um_per_pulse).powi(2));
        let (sum, count) = relative.fold((0.0, 0_u32), |(sum, count), one| (sum + one, count + 1));
        sum / f64::from(count.max(1))
    }
}

fn windows(played: &PlayedPlan) -> Vec<Window> {
    let (array, bursts) = (played.array(), played.bursts());
    let window = |(n, burst): (usize, &PlayedBurst)| {
        let start_s = played.seconds(burst.burst().start);
        let rests_s = played.seconds(burst.rests_at(array));
        let before = n.checked_sub(1).map(|n| played.seconds(bursts[n].rests_at(array)));
        let after = bursts.get(n + 1).map(|next| played.seconds(next.burst().start));
        let from_s = before.map_or(start_s - SIDE_S, |before| before.max(start_s - SIDE_S));
        let to_s = after.map_or(rests_s + SIDE_S, |after| after.min(rests_s + SIDE_S));
        Window { array, burst: *burst, from_s, start_s, rests_s, to_s }
    };
    bursts.iter().enumerate().map(window).collect()
}

/// From when to when the pin rests: before the first burst, between bursts, after the last.
fn rests(windows: &[Window]) -> Vec<(f64, f64)> {
    let (Some(first), Some(last)) = (windows.first(), windows.last()) else { return Vec::new() };
    let between = windows.windows(2).map(|two| (two[0].rests_s, two[1].start_s));
    let before = (first.start_s - END_S, first.start_s);
    std::iter::once(before).chain(between).chain([(last.rests_s, last.rests_s + END_S)]).collect()
}

/// The common slope of all rests, µm/s, and the standard deviation of samples about it, µm.
fn drift<S: Iterator<Item = Sample>>(rests: impl Iterator<Item = S>) -> (Figure, f64) {
    let (mut tt, mut ty, mut yy, mut free) = (0.0, 0.0, 0.0, -1.0);
    for rest in rests {
        let rest: Vec<Sample> = rest.collect();
        if rest.len() < 2 {
            continue;
        }
        let count = rest.len() as f64;
        let t = rest.iter().map(|sample| sample.seconds).sum::<f64>() / count;
        let y = rest.iter().map(|sample| sample.um).sum::<f64>() / count;
        for sample in rest {
            let (t, y) = (sample.seconds - t, sample.um - y);
            (tt, ty, yy) = (tt + t * t, ty + t * y, yy + y * y);
        }
        free += count - 1.0;
    }
    let slope = if tt > 0.0 { ty / tt } else { 0.0 };
    let variance = (yy - slope * ty).max(0.0) / f64::max(free, 1.0);
    let sd = if tt > 0.0 { (variance / tt).sqrt() } else { 0.0 };
    (Figure { value: slope, sd }, variance.sqrt())
}

impl Window {
    /// The share of the burst's travel that the model shows at a time.
    fn share(&self, seconds: f64) -> f64 {
        let pulses = u32::from(self.burst.pulses);
        let ramp = Ramp::travelled(Tick(0), pulses, 1.0);
        let half_ticks = (seconds - self.start_s).max(0.0) * self.array.rate().half_ticks_per_s();
        ramp.share_um(HalfTick(half_ticks.round() as u64), self.array.motor())
    }

    /// Level before the burst and travel, µm, and the variance of the travel per variance of a sample.
    fn step(&self, samples: &[Sample]) -> (f64, f64, f64) {
        let count = samples.len() as f64;
        let shares: Vec<f64> = samples.iter().map(|sample| self.share(sample.seconds)).collect();
        let share = shares.iter().sum::<f64>() / count;
        let um = samples.iter().map(|sample| sample.um).sum::<f64>() / count;
        let squares: f64 = shares.iter().map(|one| (one - share).powi(2)).sum();
        let products: f64 =
            shares.iter().zip(samples).map(|(one, sample)| (one - share) * (sample.um - um)).sum();
        let travel = products / squares;
        (um - travel * share, travel, 1.0 / squares)
    }

    fn travel(&self, motor: u8, um: f64) -> BurstTravel {
        let burst = self.burst.burst();
        BurstTravel {
            motor,
            direction: burst.direction,
            start: burst.start,
            pulses: burst.pulses,
            travel_um: if burst.direction == Direction::Up { um } else { -um },
            warm_up: self.burst.warm_up,
        }
    }
}
