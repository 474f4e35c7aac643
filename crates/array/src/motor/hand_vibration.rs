//! Hand-transmitted vibration of one pin, by the frequency weighting of ISO 5349-1. Ethics boards know this figure.
//!
//! The weighting is that of annex A: a band limit from 6.31 to 1258.9 Hz, and a transition from acceleration to velocity at 15.915
//! Hz. The motion is the drive's as commanded, at constant velocity during bursts; the motor's averaging only lowers
//! the result. The standard is about tools that a hand grips; `docs/safety.md` says what it can tell about pins.
//!
//! Invariant: above 16 Hz the result hardly exceeds 2π · 16 Hz times the velocity of a burst, at any drive.

use super::model::MotorError;
use super::wave::SquareWave;
use crate::spec::Array;
use std::f64::consts::{PI, SQRT_2, TAU};

/// Harmonics above this frequency weigh less than a thousandth, Hz.
const HIGHEST_HZ: f64 = 20_000.0;
/// The largest number of harmonics in the sum: at 0.1 Hz they reach 200 Hz, where they are negligible.
const HARMONICS: u32 = 2000;

/// The factor by which ISO 5349-1 weights acceleration at a frequency.
pub fn weighting(hz: f64) -> f64 {
    const BAND: (f64, f64, f64) = (6.310, 1258.9, 0.71);
    const TRANSITION: (f64, f64) = (15.915, 0.64);
    let resonance = |at: f64, q: f64| {
        let ratio = hz / at;
        ((1.0 - ratio * ratio).powi(2) + (ratio / q).powi(2)).sqrt()
    };
    let (low, high, q) = BAND;
    let band = (hz / low).powi(2) / resonance(low, q) / resonance(high, q);
    let (at, q) = TRANSITION;
    band * (1.0 + (hz / at).powi(2)).sqrt() / resonance(at, q)
}

/// Root mean square of the weighted acceleration of a pin that such a drive moves, m/s².
///
/// # Errors
/// The first argument that is out of range.
pub fn weighted_acceleration_m_s2(
    array: Array,
    frequency_hz: f64,
    amplitude_um: f64,
) -> Result<f64, MotorError> {
    let wave = SquareWave::new(array, frequency_hz, amplitude_um, 0.0)?;
    let velocity_m_s = array.motor().um_per_pulse * f64::from(array.rate().hz()) * 1e-6;
    // A burst's share of the period. Up and down bursts are half a period apart, so even harmonics vanish.
    let share = f64::from(wave.pulses()) / f64::from(array.rate().hz()) * frequency_hz;
    let harmonic = |number: u32| {
        let (k, hz) = (f64::from(number), f64::from(number) * frequency_hz);
        let velocity = 4.0 * velocity_m_s / (PI * k) * (PI * k * share).sin() / SQRT_2;
        (velocity * TAU * hz * weighting(hz)).powi(2)
    };
    let numbers = (1..2 * HARMONICS).step_by(2).take_while(|k| f64::from(*k) * frequency_hz <= HIGHEST_HZ);
    Ok(numbers.map(harmonic).sum::<f64>().sqrt())
}

/// The daily exposure A(8) of `hours` of it, m/s².
pub fn daily_exposure_m_s2(weighted_m_s2: f64, hours: f64) -> f64 {
    weighted_m_s2 * (hours / 8.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ISO 5349-1:2001, table A.2, at nominal third octaves; the table's frequencies are 10^(n/10) Hz.
    #[test]
    fn the_weighting_is_that_of_the_standard() {
        for (n, weight) in
            [(9, 0.873), (10, 0.951), (12, 0.896), (15, 0.519), (18, 0.256), (20, 0.160), (24, 0.0634)]
        {
            let found = weighting(10_f64.powf(f64::from(n) / 10.0));
            assert!((found / weight - 1.0).abs() < 0.005, "{n}: {found}");
        }
    }

    /// Bursts so short that they are impulses of velocity: the first harmonics dominate, and the sum has a closed form.
    #[test]
    fn a_saturated_drive_is_a_square_wave_of_velocity() {
        // 200 Hz and 400 um: the pin moves all the time, so its velocity is that of a burst.
        let found = weighted_acceleration_m_s2(Array::paper(), 200.0, 400.0).unwrap();
        let velocity_m_s = 0.95 / 7.0 * 85_000.0 * 1e-6;
        let first = 4.0 / PI / SQRT_2 * velocity_m_s * TAU * 200.0 * weighting(200.0);
        assert!((first..1.15 * first).contains(&found), "{found} and {first}");
    }
}
