//! A second simulator, written from the equations alone: slow, scalar, one afferent after the other.
//!
//! Tests compare the exact simulator with it on random scenes. It shares no code with the crate. Input breakpoints are integer
//! half ticks and the window's content integer half pulses; between breakpoints every instant at which the equations change (the
//! input's sign, end of refractoriness, end of the lowered threshold, its floor) begins a new segment with a closed form. A
//! segment is cut at its maximum. Bisection finds the maximum and the crossing.
//!
//! Invariant: it marks what it cannot promise. Each spike carries the difference that two correct programs may have, and
//! each afferent the first instant after which a rounding error decides.

mod arrays;
mod scenes;

pub use arrays::Array;
pub use scenes::{Drive, Model, Rectify, Scene, random_scene, random_scene_on};
use std::collections::BTreeMap;

const MIN_WEIGHT: f64 = 1e-10;
const MIN_THRESHOLD: f64 = 0.05;
/// The difference in `P` that two correct programs may have: rounding over some thousand segments.
const MEMBRANE_ERROR: f64 = 1e-12;
/// If `P` comes this close to the threshold without a clean crossing, a spike is uncertain.
const NEAR_MISS: f64 = 1e-9;
/// A spike this close to the end may be counted or not.
const END_SLACK_S: f64 = 1e-8;

/// A spike and how well it is determined.
#[derive(Clone, Copy, Debug)]
pub struct Spike {
    pub t_s: f64,
    /// Slope of `P - threshold` at the crossing, 1/s; infinite if refractoriness alone held the spike back.
    pub margin: f64,
    /// The error that `MEMBRANE_ERROR` can cause in its time, with the errors of the spikes before it.
    pub error_s: f64,
}

/// An afferent's spikes.
#[derive(Clone, Debug)]
pub struct Train {
    pub spikes: Vec<Spike>,
    /// The first near miss, graze or spike at the very end: from here on nothing is promised. Else infinite.
    pub doubtful_from_s: f64,
}

/// Each afferent's spikes, in the scene's order.
pub fn spikes(scene: &Scene) -> Vec<Train> {
    spikes_with_gains(scene, &vec![1.0; scene.array.pins.len()])
}

/// The same with each motor's travel multiplied by its gain.
pub fn spikes_with_gains(scene: &Scene, gains: &[f64]) -> Vec<Train> {
    let bursts = all_bursts(scene);
    (0..scene.afferents.len()).map(|afferent| train(scene, &bursts, gains, afferent)).collect()
}

/// The same with these bursts in place of the drives.
pub fn spikes_of_bursts(scene: &Scene, bursts: &[(usize, Burst)]) -> Vec<Train> {
    let gains = vec![1.0; scene.array.pins.len()];
    (0..scene.afferents.len()).map(|afferent| train(scene, bursts, &gains, afferent)).collect()
}

/// Compares all promised spikes and returns their number. A spike whose error in `expected` is above `tolerance_s` ends
/// the comparison of its afferent.
pub fn compare(expected: &[Train], found: &[Vec<f64>], tolerance_s: f64) -> Result<usize, String> {
    if expected.len() != found.len() {
        return Err(format!("{} afferents instead of {}", found.len(), expected.len()));
    }
    let mut compared = 0;
    for (afferent, (train, found)) in expected.iter().zip(found).enumerate() {
        let mut promised_until = train.doubtful_from_s;
        let mut next = 0;
        for spike in &train.spikes {
            if spike.error_s > tolerance_s {
                promised_until = promised_until.min(spike.t_s - spike.error_s);
            }
            if spike.t_s >= promised_until - tolerance_s {
                break;
            }
            match found.get(next) {
                Some(t) if (t - spike.t_s).abs() <= tolerance_s => next += 1,
                other => {
                    return Err(format!("afferent {afferent}, spike {next}: {other:?} instead of {spike:?}"));
                }
            }
        }
        if let Some(t) = found.get(next).filter(|&&t| t < promised_until - tolerance_s) {
            return Err(format!("afferent {afferent}, spike {next}: at {t} s there is none"));
        }
        compared += next;
    }
    Ok(compared)
}

/// Full speed, as a whole number, so that sums over the window are exact.
pub const FULL: i64 = 1 << 20;

/// From `start` to `end` (half ticks) a motor's shaft moves at a speed, [`FULL`] being a pulse per tick upwards.
#[derive(Clone, Copy, Debug)]
pub struct Burst {
    pub start: i64,
    pub end: i64,
    pub speed: i64,
}

fn seconds_to_ticks(array: &Array, seconds: f64) -> f64 {
    (seconds * array.ticks_per_s + 0.5).floor()
}

/// A drive's bursts that start before `horizon_s`.
fn bursts(array: &Array, drive: &Drive, horizon_s: f64) -> Vec<Burst> {
    let start = seconds_to_ticks(array, drive.start_s);
    let edge = |h: u32| {
        (((f64::from(h) / 2.0 + drive.phase) * array.ticks_per_s) / drive.frequency_hz + 0.5).floor() + start
    };
    let wanted = (drive.amplitude_um / array.um_per_pulse + 0.5).floor();
    let mut bursts = Vec::new();
    for h in (0..).step_by(2) {
        let (up, down, next_up) = (edge(h), edge(h + 1), edge(h + 2));
        let pulses = wanted.min(down - up).min(next_up - down);
        let stopped = drive.stop_s.is_some_and(|stop| down + pulses > seconds_to_ticks(array, stop));
        if stopped || up >= horizon_s * array.ticks_per_s {
            break;
        }
        for (tick, speed) in [(up, FULL), (down, -FULL)] {
            bursts.push(Burst { start: 2 * tick as i64, end: 2 * (tick + pulses) as i64, speed });
        }
    }
    bursts
}

/// The bursts of all drives, with their motors.
pub fn all_bursts(scene: &Scene) -> Vec<(usize, Burst)> {
    let horizon_s = scene.duration_s + END_SLACK_S;
    let of_drive = |drive: &Drive| {
        let motor = drive.motor;
        bursts(&scene.array, drive, horizon_s).into_iter().map(move |burst| (motor, burst))
    };
    scene.drives.iter().flat_map(of_drive).collect()
}

fn pin_weight((x_mm, y_mm): (f64, f64), (pin_x, pin_y): (f64, f64), sigma_mm: f64) -> f64 {
    let weight = (-((x_mm - pin_x).powi(2) + (y_mm - pin_y).powi(2)) / (2.0 * sigma_mm.powi(2))).exp();
    if weight < MIN_WEIGHT { 0.0 } else { weight }
}

/// `u(t)` from one breakpoint to the next: `u + slope * (t - from_s)`.
#[derive(Clone, Copy, Debug)]
struct Piece {
    from_s: f64,
    to_s: f64,
    u: f64,
    slope: f64,
}

/// All pieces of an afferent's input until `horizon_s`.
fn pieces(
    scene: &Scene,
    moves: &[(usize, Burst)],
    gains: &[f64],
    afferent: (f64, f64),
    horizon_s: f64,
) -> Vec<Piece> {
    // At a break: by how much the slope of which motor's `r(t) - r(t-W)` changes; full is half a pulse per half tick.
    let mut breakpoints: BTreeMap<i64, Vec<(usize, i64)>> = BTreeMap::from([(0, Vec::new())]);
    let array = &scene.array;
    let weight = |(pin, gain): (&(f64, f64), &f64)| gain * pin_weight(afferent, *pin, scene.model.sigma_mm);
    let weights: Vec<f64> = array.pins.iter().zip(gains).map(weight).collect();
    for &(motor, Burst { start, end, speed }) in moves.iter().filter(|(motor, _)| weights[*motor] > 0.0) {
        breakpoints.entry(start).or_default().push((motor, speed));
        breakpoints.entry(end).or_default().push((motor, -speed));
        breakpoints.entry(start + array.window_half_ticks).or_default().push((motor, -speed));
        breakpoints.entry(end + array.window_half_ticks).or_default().push((motor, speed));
    }
    let scale = array.um_per_pulse / 2.0 / array.window_s / FULL as f64;
    let weighted = |pulses: &[i64]| -> f64 {
        weights.iter().zip(pulses).map(|(weight, &pulses)| weight * scale * pulses as f64).sum()
    };
    let (mut content, mut slopes) = (vec![0_i64; array.pins.len()], vec![0_i64; array.pins.len()]);
    let half_ticks_per_s = array.half_ticks_per_s();
    let mut pieces = Vec::new();
    let times: Vec<i64> = breakpoints.keys().copied().collect();
    for (index, &at) in times.iter().enumerate() {
        for &(motor, change) in &breakpoints[&at] {
            slopes[motor] += change;
        }
        let from_s = at as f64 / half_ticks_per_s;
        let to_s =
            times.get(index + 1).map_or(horizon_s, |&next| next as f64 / half_ticks_per_s).min(horizon_s);
        if from_s < to_s {
            pieces.push(Piece {
                from_s,
                to_s,
                u: weighted(&content),
                slope: weighted(&slopes) * half_ticks_per_s,
            });
        }
        if let Some(next) = times.get(index + 1) {
            for (content, slope) in content.iter_mut().zip(&slopes) {
                *content += slope * (next - at);
            }
        }
    }
    pieces
}

/// `x + expm1(-x)`, which cancels for small `x`: `x²/2! - x³/3! + …`.
fn x_plus_expm1_minus_x(x: f64) -> f64 {
    if x >= 0.5 {
        return x + (-x).exp_m1();
    }
    let (mut sum, mut term) = (0.0, -x);
    for n in 2..30 {
        term *= -x / f64::from(n);
        sum += term;
    }
    sum
}

/// Membrane and threshold while nothing changes in their equations, by the time since the segment's start.
#[derive(Clone, Copy, Debug)]
struct Segment {
    alpha: f64,
    tau: f64,
    p: f64,
    g: f64,
    g_slope: f64,
    threshold: f64,
    threshold_slope: f64,
}

impl Segment {
    fn membrane(&self, t: f64) -> f64 {
        let x = t / self.tau;
        let e = (-x).exp_m1();
        let ramp = self.tau * self.tau * x_plus_expm1_minus_x(x);
        self.p + self.p * e + self.alpha * (self.g * (-self.tau * e) + self.g_slope * ramp)
    }

    /// Membrane above threshold.
    fn excess(&self, t: f64) -> f64 {
        self.membrane(t) - (self.threshold + self.threshold_slope * t)
    }

    /// The slope of the excess. It is monotonic within the segment.
    fn excess_slope(&self, t: f64) -> f64 {
        let x = t / self.tau;
        (self.alpha * self.g - self.p / self.tau) * (-x).exp()
            - self.alpha * self.g_slope * self.tau * (-x).exp_m1()
            - self.threshold_slope
    }

    /// Where the excess has a maximum inside `0..length`.
    fn maximum(&self, length: f64) -> Option<f64> {
        (self.excess_slope(0.0) > 0.0 && self.excess_slope(length) < 0.0)
            .then(|| bisect(0.0, length, |t| self.excess_slope(t) <= 0.0))
    }

    /// The first instant at which the membrane is at its threshold.
    fn crossing(&self, length: f64) -> Option<f64> {
        let reached = |t: f64| self.excess(t) >= 0.0;
        if reached(0.0) {
            return Some(0.0);
        }
        match self.maximum(length) {
            Some(top) if reached(top) => Some(bisect(0.0, top, reached)),
            _ => reached(length).then(|| bisect(0.0, length, reached)),
        }
    }
}

/// The first float in `no..=yes` at which `is` holds; it must not at `no` and must at `yes`.
fn bisect(mut no: f64, mut yes: f64, is: impl Fn(f64) -> bool) -> f64 {
    loop {
        let middle = no + (yes - no) / 2.0;
        if middle <= no || middle >= yes {
            return yes;
        }
        if is(middle) {
            yes = middle;
        } else {
            no = middle;
        }
    }
}

/// The last spike, and the rise of the membrane per second of delay of that spike.
#[derive(Clone, Copy, Debug)]
struct Last {
    t_s: f64,
    error_s: f64,
    drive: f64,
}

/// The threshold from `t_s` on: value, slope, and the end of that.
fn threshold(model: &Model, offset: f64, last: Option<Last>, t_s: f64) -> (f64, f64, f64) {
    let rest = 1.0 + offset;
    let (depth, length) = (model.hyperexcitability_depth, model.hyperexcitability_s);
    match last {
        Some(Last { t_s: spike, .. }) if t_s < spike + length && rest > MIN_THRESHOLD => {
            let slope = depth / length;
            let lowered = rest - depth * (1.0 - (t_s - spike) / length);
            let off_floor = spike + (MIN_THRESHOLD - (rest - depth)) / slope;
            if rest - depth < MIN_THRESHOLD && t_s < off_floor {
                (MIN_THRESHOLD, 0.0, off_floor.min(spike + length))
            } else {
                (lowered, slope, spike + length)
            }
        }
        _ => (rest.max(MIN_THRESHOLD), 0.0, f64::INFINITY),
    }
}

fn train(scene: &Scene, bursts: &[(usize, Burst)], gains: &[f64], afferent: usize) -> Train {
    let model = &scene.model;
    let offsets = scene.offsets.get(afferent).map_or(&[][..], Vec::as_slice);
    let mut train = Train { spikes: Vec::new(), doubtful_from_s: f64::INFINITY };
    let (mut p, mut last) = (0.0, None::<Last>);
    for piece in pieces(scene, bursts, gains, scene.afferents[afferent], scene.duration_s + END_SLACK_S) {
        let zero_s = piece.from_s - piece.u / piece.slope;
        let mut t = piece.from_s;
        while t < piece.to_s {
            let offset = if offsets.is_empty() { 0.0 } else { offsets[train.spikes.len()] };
            let (threshold, threshold_slope, threshold_until) = threshold(model, offset, last, t);
            let ready_s = last.map_or(0.0, |last| last.t_s + model.refractory_s);
            let to = [zero_s, ready_s, threshold_until, piece.to_s];
            let to = to.into_iter().filter(|&to| to > t).fold(f64::INFINITY, f64::min);
            let u = piece.u + piece.slope * (t - piece.from_s);
            let u_in_the_middle = piece.u + piece.slope * ((t + to) / 2.0 - piece.from_s);
            let sign = match model.rectify {
                Rectify::Signed => 1.0,
                Rectify::Full => u_in_the_middle.signum(),
                Rectify::Half => f64::from(u8::from(u_in_the_middle > 0.0)),
            };
            let segment = Segment {
                alpha: model.alpha_per_um,
                tau: model.tau_s,
                p,
                g: sign * u,
                g_slope: sign * piece.slope,
                threshold,
                threshold_slope,
            };
            let length = to - t;
            let crossing = if t < ready_s { None } else { segment.crossing(length) };
            // The error of the excess because of the last spike's error.
            let inherited = last.map_or(0.0, |last| {
                last.error_s * (last.drive.abs() + threshold_slope + segment.excess_slope(0.0).abs())
            });
            let near = |at: f64| segment.excess(at).abs() < NEAR_MISS + inherited;
            let points = [Some(0.0), segment.maximum(length), Some(length)];
            if t >= ready_s
                && let Some(at) = points.into_iter().flatten().find(|&at| near(at))
            {
                train.doubtful_from_s = train.doubtful_from_s.min(t + crossing.unwrap_or(at).min(at));
            }
            let Some(at) = crossing else {
                p = segment.membrane(length);
                t = to;
                continue;
            };
            t += at;
            p = 0.0;
            let held_back = at == 0.0 && last.is_some() && t <= ready_s;
            let margin = if held_back { f64::INFINITY } else { segment.excess_slope(at).max(0.0) };
            let error_s = last.map_or(MEMBRANE_ERROR / margin, |last| {
                let inherited = last.drive * (-(t - last.t_s) / model.tau_s).exp() - threshold_slope;
                if held_back {
                    last.error_s
                } else {
                    (MEMBRANE_ERROR + inherited.abs() * last.error_s) / margin
                }
            });
            train.spikes.push(Spike { t_s: t, margin, error_s });
            last = Some(Last { t_s: t, error_s, drive: model.alpha_per_um * sign * (u + piece.slope * at) });
        }
    }
    let end = scene.duration_s - END_SLACK_S;
    if train.spikes.iter().any(|spike| (spike.t_s - scene.duration_s).abs() <= END_SLACK_S) {
        train.doubtful_from_s = train.doubtful_from_s.min(end);
    }
    train.spikes.retain(|spike| spike.t_s < scene.duration_s);
    train
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_comparison_sees_a_spike_moved_lost_or_added() {
        let trains = spikes(&random_scene(2));
        let right: Vec<Vec<f64>> =
            trains.iter().map(|train| train.spikes.iter().map(|spike| spike.t_s).collect()).collect();
        let afferent = (0..right.len()).max_by_key(|&afferent| right[afferent].len()).unwrap();
        assert!(right[afferent].len() > 2 && compare(&trains, &right, 1e-9).is_ok());
        let changes: [fn(&mut Vec<f64>); 3] = [
            |spikes| spikes[1] += 2e-9,
            |spikes| _ = spikes.remove(1),
            |spikes| spikes.push(spikes[spikes.len() - 1] + 1e-5),
        ];
        for change in changes {
            let mut wrong = right.clone();
            change(&mut wrong[afferent]);
            compare(&trains, &wrong, 1e-9).unwrap_err();
        }
    }
}
