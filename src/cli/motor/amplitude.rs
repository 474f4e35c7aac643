//! The amplitude that a motor reaches against frequency: the paper's Fig. 3.
//!
//! The model is in closed form. Amplitudes are measured by the telemetry of simulated motors, whose bursts scatter, in open
//! loop: the motors share out the amplitudes, so four pins of the paper's array play each one. The amplitude of a cycle is its
//! top minus the mean of the bottoms before and after it, at the model's instants, so that drift cancels. The model has no such
//! instants for a motor that does not follow as a moving average: its amplitude is the range of the samples of a cycle.
//!
//! Invariant: a measurement uses only telemetry, with its resolution.

use super::measured::{SEED, mean_and_sd};
use anyhow::Result;
use firmware_protocol::stroke::{Direction, Lines};
use firmware_protocol::tick::Tick;
use meissner_array::motor::{SquareWave, SteadyState};
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Commanded amplitudes, µm. An array has those up to its largest amplitude.
const AMPLITUDES_UM: [f64; 6] = [10.0, 20.0, 40.0, 80.0, 160.0, 320.0];
/// Measured frequencies, Hz; 233 is near the null of the model of the paper's motors.
const FREQUENCIES_HZ: [f64; 23] = [
    1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 150.0,
    180.0, 200.0, 233.0, 260.0, 300.0,
];
/// The number of the model's points for each amplitude.
const LINE: u32 = 160;
/// The number of measured cycles on each pin.
const CYCLES: usize = 20;
/// The number of cycles left out at the beginning, besides those in the window: the first burst after a rest is short.
const TRANSIENT: usize = 3;
/// Telemetry samples per second.
const SAMPLES_HZ: u32 = meissner_array::simulated::MAX_TELEMETRY_HZ;
/// Reads of telemetry per second: 50 samples lie between two, fewer than its queue holds.
const READS_PER_S: u64 = 200;
/// Distance of the end stops: out of reach, because pins drift in open loop.
const END_STOP_UM: f64 = 10_000.0;
/// The least model amplitude at which the ratio is evaluated, µm.
const WORTH_UM: f64 = 5.0;

/// What was measured.
#[derive(Serialize)]
pub(super) struct Amplitudes {
    measured: Vec<Measured>,
    /// The model in between, up to the highest frequency.
    model: Vec<Model>,
}

/// The mean of the measured cycles, and their standard deviation. Amplitudes are peak to peak.
#[derive(Clone, Copy, Serialize)]
struct Measured {
    frequency_hz: f64,
    amplitude_um: f64,
    model_um: f64,
    measured_um: f64,
    sd_um: f64,
    cycles: usize,
}

#[derive(Serialize)]
struct Model {
    frequency_hz: f64,
    amplitude_um: f64,
    model_um: f64,
}

pub(super) fn measure(array: Array, progress: &(dyn Fn(f64) + Sync)) -> Result<Amplitudes> {
    let amplitudes_um = amplitudes_um(array);
    Ok(Amplitudes {
        measured: measured(array, &amplitudes_um, progress)?,
        model: model(array, &amplitudes_um)?,
    })
}

impl Amplitudes {
    /// Measured over model where the model moves by [`WORTH_UM`] or more: the mean, and the largest deviation from 1.
    pub(super) fn over_model(&self) -> [f64; 2] {
        let worth = self.measured.iter().filter(|of| of.model_um >= WORTH_UM);
        let ratios: Vec<f64> = worth.map(|of| of.measured_um / of.model_um).collect();
        let worst = ratios.iter().fold(0.0_f64, |worst, ratio| worst.max((ratio - 1.0).abs()));
        [mean_and_sd(&ratios).0, worst]
    }
}

/// The amplitudes that the array's motors can make, µm: those of [`AMPLITUDES_UM`], or the largest if that is smaller than all.
fn amplitudes_um(array: Array) -> Vec<f64> {
    let travel_um = array.motor().travel_um;
    let within: Vec<f64> = AMPLITUDES_UM.into_iter().filter(|um| *um <= travel_um).collect();
    if within.is_empty() { vec![travel_um] } else { within }
}

/// The window of the moving average, s.
fn window_s(array: Array) -> f64 {
    array.motor().window_ticks() / f64::from(array.rate().hz())
}

/// The model at frequencies that are evenly spaced on a logarithmic scale, and where a moving average has its null.
fn model(array: Array, amplitudes_um: &[f64]) -> Result<Vec<Model>> {
    let [.., highest_hz] = FREQUENCIES_HZ;
    let mut line_hz: Vec<f64> =
        (0..LINE).map(|n| highest_hz.powf(f64::from(n) / f64::from(LINE - 1))).collect();
    line_hz.extend(Some(1.0 / window_s(array)).filter(|null| *null <= highest_hz));
    line_hz.sort_by(f64::total_cmp);
    let of = |(amplitude_um, frequency_hz)| {
        let model_um = SteadyState::ideal_um(array, frequency_hz, amplitude_um)?;
        Ok(Model { frequency_hz, amplitude_um, model_um })
    };
    let all: Vec<_> = amplitudes_um.iter().flat_map(|&um| line_hz.iter().map(move |&hz| (um, hz))).collect();
    all.into_par_iter().map(of).collect()
}

fn measured(array: Array, amplitudes_um: &[f64], progress: &(dyn Fn(f64) + Sync)) -> Result<Vec<Measured>> {
    let done = AtomicUsize::new(0);
    let measured = FREQUENCIES_HZ.par_iter().map(|&frequency_hz| {
        // An array of few motors plays some amplitudes after the others.
        let parts_um = amplitudes_um.chunks(array.motors());
        let cycles =
            parts_um.map(|some_um| cycles(array, frequency_hz, some_um)).collect::<Result<Vec<_>>>()?;
        let rows = amplitudes_um.iter().zip(cycles.concat()).map(|(&amplitude_um, cycles)| {
            let (measured_um, sd_um) = mean_and_sd(&cycles);
            let model_um = SteadyState::ideal_um(array, frequency_hz, amplitude_um)?;
            Ok(Measured { frequency_hz, amplitude_um, model_um, measured_um, sd_um, cycles: cycles.len() })
        });
        let rows = rows.collect::<Result<Vec<_>>>()?;
        progress((done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / FREQUENCIES_HZ.len() as f64);
        Ok(rows)
    });
    Ok(measured.collect::<Result<Vec<_>>>()?.concat())
}

/// For each of some amplitudes, at most as many as there are motors: the peak-to-peak amplitudes of the measured cycles, µm. Motors of
/// consecutive numbers play the same amplitude.
fn cycles(array: Array, frequency_hz: f64, amplitudes_um: &[f64]) -> Result<Vec<Vec<f64>>> {
    let plays = |motor: u8| usize::from(motor) * amplitudes_um.len() / array.motors();
    let config = SimulatedMotorsConfig {
        seed: SEED,
        end_stop_um: END_STOP_UM,
        telemetry_hz: SAMPLES_HZ,
        ..SimulatedMotorsConfig::default()
    };
    let mut motors = SimulatedMotors::new(array, config, Tick(0))?;
    let periods = window_s(array) * frequency_hz;
    let skipped = TRANSIENT + periods.ceil() as usize;

    let mut toggles: Vec<(Tick, u8, Direction)> = Vec::new();
    // For each motor: the numbers of its samples at bottoms and tops alternately, with a bottom first and last.
    let mut wanted: Vec<Vec<u64>> = Vec::new();
    for motor in array.numbers() {
        let wave = SquareWave::new(array, frequency_hz, amplitudes_um[plays(motor)], 0.0)?;
        let excursions: Vec<_> = wave.excursions().take(skipped + CYCLES + 1).collect();
        for excursion in &excursions {
            let pulses = u64::from(excursion.pulses);
            for (start, direction) in [(excursion.up, Direction::Up), (excursion.down, Direction::Down)] {
                toggles.extend([start, start + pulses].map(|tick| (Tick(tick), motor, direction)));
            }
        }
        let mut samples = Vec::new();
        for pair in excursions[skipped - 1..].windows(2) {
            let (this, next) = (pair[0], pair[1]);
            samples.push(sample(array, this.end() + next.up));
            samples.push(sample(array, next.up + u64::from(next.pulses) + next.down));
        }
        // Drop the last top: no bottom follows it.
        samples.pop();
        wanted.push(samples);
    }
    toggles.sort_by_key(|toggle| toggle.0);

    let mut readings: Vec<Vec<f64>> = vec![Vec::new(); array.motors()];
    let (mut taken, read_ticks) = (0, array.rate().per_s() / READS_PER_S);
    let mut advance = |motors: &mut SimulatedMotors, lines: Lines, until: Tick| {
        while motors.now() < until {
            motors.advance(lines, read_ticks.min(until - motors.now()));
            while let Some(sample) = motors.telemetry() {
                taken += 1;
                let of_motors = readings.iter_mut().zip(&wanted).zip(&sample.y);
                for ((readings, wanted), y) in of_motors {
                    if wanted.get(readings.len()) == Some(&taken) {
                        readings.push(f64::from(*y) / 100.0);
                    }
                }
            }
        }
    };
    let mut lines = Lines::OFF;
    for (tick, motor, direction) in toggles {
        advance(&mut motors, lines, tick);
        lines.set_mut(direction).toggle(motor);
    }
    let end = motors.now() + 2 * array.motor().window_half_ticks;
    advance(&mut motors, Lines::OFF, end);

    // With an odd number of whole periods in the window the wave is inverted.
    let sign = if periods.floor() % 2.0 == 0.0 { 1.0 } else { -1.0 };
    let mut cycles: Vec<Vec<f64>> = vec![Vec::new(); amplitudes_um.len()];
    for (motor, readings) in (0..).zip(&readings) {
        let of_motor = readings.windows(3).step_by(2);
        cycles[plays(motor)]
            .extend(of_motor.map(|three| sign * (three[1] - f64::midpoint(three[0], three[2]))));
    }
    Ok(cycles)
}

/// The number of the sample nearest to the middle of a plateau, which the command reaches at half of `twice` ticks. The
/// shaft follows half a window later.
fn sample(array: Array, twice: u64) -> u64 {
    let ticks = (twice as f64 + array.motor().window_ticks()) / 2.0;
    (ticks * f64::from(SAMPLES_HZ) / f64::from(array.rate().hz())).round() as u64
}
