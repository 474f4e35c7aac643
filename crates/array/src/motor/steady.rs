//! The steady amplitude of a drive: the curve that the paper measured as its Fig. 3.
//!
//! The ideal amplitude has a closed form. The square wave with limited slope is a trapezoid with period T, odd about its mean. The
//! average over a window W therefore depends only on W mod T, and is largest when the window is centred on a plateau. Half the peak
//! to peak is then the integral of the trapezoid about its mean from -x to x, divided by W. The played amplitude is that of the
//! drive with its edges at ticks, evaluated piece by piece.
//!
//! A motor with another response has neither form: both amplitudes are sampled, and what is left between the samples is far below a pulse.
//!
//! Invariant: both amplitudes of a moving average are exact up to f64; neither is sampled.

use super::model::MotorError;
use super::response::Response;
use super::shaft::{HalfTick, Shaft};
use super::wave::SquareWave;
use crate::spec::{Array, MotorSpec};
use serde::Serialize;
use std::collections::BTreeSet;

/// Periods evaluated for the played amplitude. Rounding to ticks makes the wave drift through its possible shapes;
/// this many periods show them all, except at a few frequencies near ratios of small numbers.
const PERIODS: usize = 1024;
/// Periods of a motor with another response that are sampled, and samples after an edge.
const PERIODS_SAMPLED: u32 = 16;
const SAMPLES: u32 = 512;

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
    if let Response::Lag { omega, damping } = array.motor().response {
        return lagging(reached, period, 2.0 * reached / slope, array.motor(), omega, damping);
    }
    let cycles = window / period;
    let seen = (cycles - cycles.floor()) * period / 2.0;
    // Windows of T - w and w give the same, mirrored.
    let seen = seen.min(period / 2.0 - seen);
    2.0 / window * (reached * seen - slope * (seen - plateau).max(0.0).powi(2))
}

/// Peak to peak of a lag's answer to a trapezoid that goes up and down by `um` in `rise` half ticks each, every `half` half ticks.
fn lagging(um: f64, half: f64, rise: f64, motor: &MotorSpec, omega: f64, damping: f64) -> f64 {
    if um == 0.0 {
        return 0.0;
    }
    let settled = motor.window_half_ticks as f64;
    // What an edge has contributed `after` half ticks after its start.
    let edge = |after: f64| {
        if after - rise >= settled {
            return um;
        }
        let of_ramp = |after| Response::of_ramp(omega, damping, after);
        um / rise * (of_ramp(after) - of_ramp(after - rise))
    };
    // The last edge goes up; those before it go down and up in turn, so that their levels cancel in pairs.
    let pairs = ((settled + rise) / (2.0 * half)).ceil() as u32 + 1;
    let at = |t: f64| {
        let edges = (0..2 * pairs)
            .map(|n| if n % 2 == 0 { edge(t + f64::from(n) * half) } else { -edge(t + f64::from(n) * half) });
        edges.sum::<f64>()
    };
    let seen = half.min(settled + rise);
    // The mean of the levels is half an edge below the upper one, which is 0 here. Half a period later all is the same upside down.
    let from_mean = |n: u32| (at(seen * f64::from(n) / f64::from(SAMPLES)) + um / 2.0).abs();
    2.0 * (0..SAMPLES).map(from_mean).fold(0.0, f64::max)
}

/// [`played`] of a motor whose displacement has no closed form.
fn sampled(wave: &SquareWave, motor: &MotorSpec) -> f64 {
    let mut shaft = Shaft::new(motor);
    let settled = 2 * wave.edge(0) + motor.window_half_ticks;
    let mut range = (f64::INFINITY, f64::NEG_INFINITY);
    let mut excursions = wave.excursions();
    let mut next = excursions.next();
    let mut seen = 0;
    while let Some(excursion) = next
        && seen < PERIODS_SAMPLED
    {
        next = excursions.next();
        let end = next.map_or_else(|| excursion.end(), |next| next.up);
        let ramps = excursion.ramps(motor.um_per_pulse);
        let starts = ramps.map(|ramp| ramp.start.0).into_iter().chain([end]);
        for (ramp, (from, to)) in ramps.into_iter().zip(starts.clone().zip(starts.skip(1))) {
            shaft.push(ramp);
            for part in 0..u64::from(SAMPLES) {
                let at =
                    2 * from + (2 * (to - from)).min(motor.window_half_ticks) * part / u64::from(SAMPLES);
                if at >= settled {
                    let um = shaft.displacement_um(HalfTick(at));
                    range = (range.0.min(um), range.1.max(um));
                }
            }
        }
        seen += u32::from(2 * end >= settled);
    }
    (range.1 - range.0).max(0.0)
}

fn played(wave: &SquareWave) -> f64 {
    let array = wave.array();
    let motor = array.motor();
    if motor.response != Response::Average {
        return sampled(wave, motor);
    }
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
    #[expect(clippy::cast_precision_loss, reason = "a distance of breakpoints")]
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

    /// A slow drive of a stiff lag has its amplitude; a fast one has what the frequency response of the first harmonic says.
    #[test]
    fn a_lagging_motor_has_the_amplitude_of_its_frequency_response() {
        let text = "name = \"lagging\"\npins = { rows = 1, columns = 1, pitch_mm = 2.0 }\ntick_hz = 85000\nduty = { up = 0.2, down = 0.8 }\n\
                    [motor]\nstep_um = 0.1\nlag = { natural_hz = 100.0, damping = 0.7 }\ntravel_um = 100.0\nmost_pulses = 1000\n";
        let array = Array::known(crate::spec::ArraySpec::parse(text, "lagging.toml").unwrap()).unwrap();
        let of = |hz, um| SteadyState::of(array, hz, um).unwrap();
        let slow = of(1.0, 20.0);
        // A step overshoots by 4.6 %, at the top and at the bottom; this edge takes 2.4 ms.
        assert!((21.4..21.85).contains(&slow.peak_to_peak_um), "{slow:?}");
        let fast = of(300.0, 5.0);
        // At three times the natural frequency the gain is 1 / |1 - 9 + 2i 0.7 3| = 0.1107. The first harmonic of a square is 4/pi of
        // it; edges of 50 ticks in a period of 283 lower it by 5 %.
        assert!(
            (fast.peak_to_peak_um / (5.0 * 4.0 / std::f64::consts::PI * 0.1107 * 0.949) - 1.0).abs() < 0.02,
            "{fast:?}"
        );
        for (hz, um) in [(10.0, 30.0), (60.0, 40.0), (150.0, 20.0), (300.0, 5.0)] {
            let steady = of(hz, um);
            // Edges are rounded to ticks, so periods differ.
            let apart = (steady.played_peak_to_peak_um / steady.peak_to_peak_um - 1.0).abs();
            assert!(apart < 0.04, "{hz} Hz, {um} um: {steady:?}");
        }
    }
}
