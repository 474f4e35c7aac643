//! The steady amplitude of a drive: the curve that the paper measured as its Fig. 3.
//!
//! The ideal amplitude has a closed form. The square wave with limited slope is a trapezoid with period T, odd about its mean. The
//! average over a window W therefore depends only on W mod T, and is largest when the window is centred on a plateau. Half the peak
//! to peak is then the integral of the trapezoid about its mean from -x to x, divided by W. The played amplitude is that of the
//! drive with its edges at ticks, evaluated piece by piece.
//!
//! Invariant: both amplitudes are exact up to f64; neither is sampled.

use super::model::MotorError;
use super::shaft::{HalfTick, Shaft};
use super::wave::SquareWave;
use crate::spec::Array;
use serde::Serialize;
use std::collections::BTreeSet;

/// Periods evaluated for the played amplitude. Rounding to ticks makes the wave drift through its possible shapes;
/// this many periods show them all, except at a few frequencies near ratios of small numbers.
const PERIODS: usize = 1024;

/// A drive's steady state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SteadyState {
    /// Displacement, peak to peak, before anything is rounded to pulses and ticks.
    pub peak_to_peak_um: f64,
    /// Pulses per burst, as [`SquareWave::pulses`].
    pub pulses: u32,
    /// Displacement between the highest and the lowest point, as played.
    pub played_peak_to_peak_um: f64,
    /// Whether the amplitude does not fit into half a period, so that the square becomes a triangle.
    pub saturated: bool,
}

impl SteadyState {
    /// Displacement of a drive of `amplitude_um`, peak to peak, µm, before anything is rounded to pulses and ticks.
    ///
    /// # Errors
    /// The first argument that is out of range.
    pub fn ideal_um(array: Array, frequency_hz: f64, amplitude_um: f64) -> Result<f64, MotorError> {
        SquareWave::new(array, frequency_hz, amplitude_um, 0.0)?;
        Ok(ideal(array, frequency_hz, amplitude_um))
    }

    /// The steady state of a drive of `amplitude_um` peak to peak.
    ///
    /// # Errors
    /// The first argument that is out of range.
    pub fn of(array: Array, frequency_hz: f64, amplitude_um: f64) -> Result<Self, MotorError> {
        let wave = SquareWave::new(array, frequency_hz, amplitude_um, 0.0)?;
        Ok(Self {
            peak_to_peak_um: ideal(array, frequency_hz, amplitude_um),
            pulses: wave.pulses(),
            played_peak_to_peak_um: played(&wave),
            saturated: wave.pulses() < wave.wanted_pulses(),
        })
    }
}

/// `(2/W)(A x - v max(0, x - p)²)`: half-window x, half-plateau p, slope v; times in ticks.
fn ideal(array: Array, frequency_hz: f64, amplitude_um: f64) -> f64 {
    let slope = array.motor().um_per_pulse;
    let window = array.motor().window_ticks();
    let period = f64::from(array.rate().hz()) / frequency_hz;
    let reached = amplitude_um.min(slope * period / 2.0);
    let plateau = (period / 2.0 - reached / slope) / 2.0;
    let cycles = window / period;
    let seen = (cycles - cycles.floor()) * period / 2.0;
    // Windows of T - w and w give the same, mirrored.
    let seen = seen.min(period / 2.0 - seen);
    2.0 / window * (reached * seen - slope * (seen - plateau).max(0.0).powi(2))
}

fn played(wave: &SquareWave) -> f64 {
    let array = wave.array();
    let motor = array.motor();
    let rest = wave.half_period_ticks().saturating_sub(wave.wanted_pulses().into());
    if rest >= motor.settled_ticks() {
        // Every plateau outlasts the window.
        return f64::from(wave.wanted_pulses()) * motor.um_per_pulse;
    }
    let settled = HalfTick(2 * wave.edge(0) + motor.window_half_ticks);
    let mut shaft = Shaft::new(motor);
    let mut breakpoints = BTreeSet::new();
    let mut range = Range::default();
    for excursion in wave.excursions().take(PERIODS) {
        for ramp in excursion.ramps(motor.um_per_pulse) {
            let ends = [HalfTick::from(ramp.start), ramp.end().into()];
            while let Some(at) = breakpoints.pop_first() {
                if at > ends[0] {
                    breakpoints.insert(at);
                    break;
                }
                if at >= settled {
                    range.piece_to(at, &shaft);
                }
            }
            shaft.push(ramp);
            breakpoints.extend(ends);
            breakpoints.extend(ends.map(|end| HalfTick(end.0 + motor.window_half_ticks)));
        }
    }
    range.highest - range.lowest
}

/// The highest and lowest displacement over the pieces so far.
#[derive(Default)]
struct Range {
    /// Where the last piece ended: instant, displacement, velocity.
    last: Option<(HalfTick, f64, f64)>,
    lowest: f64,
    highest: f64,
}

impl Range {
    /// Adds the piece from the last breakpoint to `at`: its ends, and its vertex if that lies between.
    fn piece_to(&mut self, at: HalfTick, shaft: &Shaft) {
        let (y, velocity) = (shaft.displacement_um(at), shaft.velocity_um_per_tick(at));
        match self.last {
            None => (self.lowest, self.highest) = (y, y),
            Some((from, y0, velocity0)) if velocity0 * velocity < 0.0 => {
                let ticks = (at.0 - from.0) as f64 / 2.0;
                self.take(y0 + velocity0 * ticks * velocity0 / (velocity0 - velocity) / 2.0);
            }
            Some(_) => {}
        }
        self.take(y);
        self.last = Some((at, y, velocity));
    }

    fn take(&mut self, y: f64) {
        self.lowest = self.lowest.min(y);
        self.highest = self.highest.max(y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_speed_triangle_at_300_hz_is_a_few_micrometres() {
        let steady = SteadyState::of(Array::paper(), 300.0, 400.0).unwrap();
        assert!((steady.peak_to_peak_um - 3.07).abs() < 0.005, "{steady:?}");
        assert!(steady.saturated && steady.pulses == 141);
    }

    #[test]
    fn a_slow_drive_has_its_amplitude_in_whole_pulses() {
        let steady = SteadyState::of(Array::paper(), 10.0, 9.5).unwrap();
        assert!((steady.peak_to_peak_um - 9.5).abs() < 1e-12 && !steady.saturated && steady.pulses == 70);
        assert!((steady.played_peak_to_peak_um - 9.5).abs() < 1e-12);
        assert_eq!(SteadyState::of(Array::paper(), 1e-300, 1e6).unwrap().pulses, 7_368_421);
        assert_eq!(SteadyState::of(Array::paper(), 60.0, 0.0).unwrap().played_peak_to_peak_um, 0.0);
    }
}
