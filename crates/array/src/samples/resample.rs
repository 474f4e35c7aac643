//! Resamples to [`MOST_HZ`] through a low-pass filter: a sinc of 3 kHz in a Blackman window of 4 ms, evaluated at each new instant.
//!
//! It keeps what is below 2.3 kHz and takes out, by 74 dB, what is above 3.7 kHz. The filter is symmetric, so nothing is delayed. Its
//! weights add up to 1, and before the first and after the last sample the value stays as it is there, so a displacement that begins
//! or ends above rest does not ring. (`rubato` is built for streams: it is off by up to a sample in time, and pads with 0.) All
//! functions are those of `libm`, so equal files give equal samples on every machine.

use super::error::MOST_HZ;
use std::f64::consts::PI;

/// The filter's edge, where it halves the amplitude, Hz.
const EDGE_HZ: f64 = 3000.0;
/// Half the length of its window, s.
const HALF_S: f64 = 0.002;

/// How many samples there are after [`resampled`], or without it at a rate that stays.
pub(super) fn resampled_len(samples: usize, rate_hz: f64) -> usize {
    let Some(last) = samples.checked_sub(1).filter(|_| rate_hz > MOST_HZ) else { return samples };
    (last as f64 * MOST_HZ / rate_hz) as usize + 1
}

/// The samples at [`MOST_HZ`], the first at the same instant. `rate_hz` is a whole number, there is a sample, and the result is not
/// longer than the samples of a pattern.
pub(super) fn resampled(um: &[f32], rate_hz: f64) -> Vec<f32> {
    // New instants are `step` / `phases` samples apart.
    let divisor = gcd(rate_hz as usize, MOST_HZ as usize);
    let (step, phases) = (rate_hz as usize / divisor, MOST_HZ as usize / divisor);
    let half = (HALF_S * rate_hz) as isize;
    let filters: Vec<Vec<f64>> = (0..phases).map(|phase| filter(phase, phases, half, rate_hz)).collect();
    let at = |number: usize| {
        let (place, filter) = ((number * step / phases) as isize, &filters[number * step % phases]);
        let near = (place - half..).map(|place| um[place.clamp(0, um.len() as isize - 1) as usize]);
        filter.iter().zip(near).map(|(weight, um)| weight * f64::from(um)).sum::<f64>() as f32
    };
    (0..resampled_len(um.len(), rate_hz)).map(at).collect()
}

/// The weights of the samples from `half` before to `half` + 1 after a new instant, which is `phase` / `phases` of a sample late.
fn filter(phase: usize, phases: usize, half: isize, rate_hz: f64) -> Vec<f64> {
    let weight = |place: isize| {
        let after_s = (place as f64 - phase as f64 / phases as f64) / rate_hz;
        let (angle, share) = (2.0 * PI * EDGE_HZ * after_s, PI * after_s / HALF_S);
        let sinc = if angle == 0.0 { 1.0 } else { libm::sin(angle) / angle };
        let window = 0.42 + 0.5 * libm::cos(share) + 0.08 * libm::cos(2.0 * share);
        if share.abs() < PI { sinc * window } else { 0.0 }
    };
    let weights: Vec<f64> = (-half..=half + 1).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|weight| weight / sum).collect()
}

const fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn sine(hz: f64, rate_hz: f64, samples: usize) -> Vec<f32> {
        (0..samples).map(|k| (100.0 + 50.0 * (TAU * hz * k as f64 / rate_hz).sin()) as f32).collect()
    }

    #[test]
    fn what_motors_can_do_is_kept_in_time_and_amplitude() {
        for rate_hz in [44_100.0, 48_000.0, 8001.0, 192_000.0, 22_050.0, 44_101.0] {
            let samples = (rate_hz * 0.3) as usize;
            for hz in [5.0, 60.0, 300.0] {
                let (found, wanted) =
                    (resampled(&sine(hz, rate_hz, samples), rate_hz), sine(hz, MOST_HZ, 2400));
                assert_eq!(found.len(), resampled_len(samples, rate_hz));
                // The ends are held, not known.
                let worst = found[100..2300]
                    .iter()
                    .zip(&wanted[100..])
                    .map(|(a, b)| (a - b).abs())
                    .fold(0.0, f32::max);
                assert!(worst < 0.01, "{rate_hz} Hz, {hz} Hz: {worst} um");
            }
        }
    }

    #[test]
    fn what_would_become_slow_motion_is_taken_out() {
        // 8.05 kHz would be seen as 50 Hz.
        let found = resampled(&sine(8050.0, 44_100.0, 44_100), 44_100.0);
        let worst = found[100..7900].iter().map(|um| (um - 100.0).abs()).fold(0.0, f32::max);
        assert!(worst < 0.005, "{worst} um");
    }

    #[test]
    fn a_constant_stays_and_does_not_ring_at_its_ends() {
        let found = resampled(&[250.0; 3000], 44_100.0);
        assert!(found.iter().all(|um| (um - 250.0).abs() < 0.005), "{found:?}");
        assert_eq!((found.len(), resampled(&[1.0; 2], 192_000.0).len()), (545, 1));
    }
}
