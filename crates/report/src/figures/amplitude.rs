//! The amplitude that a motor of an array reaches against frequency; of the paper's array it is the paper's Fig. 3.
//!
//! Lines are the model in closed form. Points are measured by the telemetry of simulated motors, whose bursts scatter, in open
//! loop: the motors share out the amplitudes, so four pins of the paper's array play each one. The amplitude of a cycle is its
//! top minus the mean of the bottoms before and after it, at the model's instants, so that drift cancels. The model has no such
//! instants for a motor that does not follow as a moving average: its amplitude is the range of the samples of a cycle.
//!
//! Invariant: a measurement uses only telemetry, with its resolution.

use crate::chart::{Axis, Chart, Point, Scale, Series, draw};
use crate::figures::error::FiguresError;
use crate::figures::page::Section;
use crate::figures::table::{csv, number};
use crate::figures::{command, title};
use crate::progress::Parts;
use crate::statistics::mean_and_sd;
use firmware_protocol::stroke::{Direction, Lines};
use firmware_protocol::tick::Tick;
use meissner_array::motor::{MotorError, SquareWave, SteadyState};
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use rayon::prelude::*;
use serde::Serialize;

/// Commanded amplitudes, µm. An array has those up to its largest amplitude.
pub const AMPLITUDES_UM: [f64; 6] = [10.0, 20.0, 40.0, 80.0, 160.0, 320.0];
/// Measured frequencies, Hz; 233 is near the null of the model of the paper's motors.
const FREQUENCIES_HZ: [f64; 23] = [
    1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 120.0, 150.0,
    180.0, 200.0, 233.0, 260.0, 300.0,
];
/// The number of points of a line.
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
const SEED: u64 = 0;
/// The least model amplitude at which the ratio is evaluated, µm.
const WORTH_UM: f64 = 5.0;

/// A point of the figure.
#[derive(Clone, Copy, Debug)]
struct Row {
    frequency_hz: f64,
    amplitude_um: f64,
    model_um: f64,
    measured_um: f64,
    sd_um: f64,
    /// The number of measured cycles.
    cycles: usize,
}

/// The key figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Amplitude {
    /// Seed of the simulated motors.
    pub seed: u64,
    /// The number of measured points.
    pub points: usize,
    /// Measured over model: the mean over points with a model amplitude of 5 µm or more.
    pub measured_over_model: f64,
    /// The largest deviation of that ratio from 1.
    pub worst_deviation: f64,
}

/// Makes the section and the key figures.
pub(super) fn section(
    array: Array,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Section, Amplitude), FiguresError> {
    let amplitudes_um = amplitudes_um(array);
    let rows = rows(array, &amplitudes_um, progress)?;
    let ratios =
        || rows.iter().filter(|row| row.model_um >= WORTH_UM).map(|row| row.measured_um / row.model_um);
    let figures = Amplitude {
        seed: SEED,
        points: rows.len(),
        measured_over_model: ratios().sum::<f64>() / ratios().count() as f64,
        worst_deviation: ratios().fold(0.0, |worst, ratio| worst.max((ratio - 1.0).abs())),
    };
    let mut section = Section::new("amplitude", &title(array, "Amplitude against frequency", "Fig. 3"));
    let cycles = || rows.iter().map(|row| row.cycles);
    let (fewest, most) = (cycles().min().unwrap_or(0), cycles().max().unwrap_or(0));
    let cycles = if fewest == most { most.to_string() } else { format!("{fewest} to {most}") };
    let speed_mm_s = array.motor().um_per_pulse * f64::from(array.rate().hz()) / 1000.0;
    let follows = format!("moving average over {:.1} ms", window_s(array) * 1000.0);
    let read = "the amplitude of a cycle is its top minus the mean of the bottoms beside it, at the model's instants";
    let hz = number(1.0 / window_s(array));
    let null = format!(" The model's null at {hz} Hz is that of a moving average, not of a motor.");
    let caption = format!(
        "Steady amplitude of a pin, peak to peak, against the frequency of its drive, for amplitudes of {} µm. Lines: \
         the motor model (slope limited to {speed_mm_s:.1} mm/s, {follows}) before rounding to pulses and ticks. Points: mean and \
         standard deviation of {cycles} cycles of simulated motors (seed {SEED}, gain of each burst scattered by 10 %, open \
         loop, end stops out of reach), from telemetry at {SAMPLES_HZ} Hz in steps of 0.01 µm after the transient; {read}. \
         Where the model moves by {WORTH_UM} µm or more, the ratio of measured to model is {} in the mean, and off by {} % at \
         worst. Amplitudes below {LEAST_UM} µm lie in the strip below the break.{null}",
        amplitudes_um.iter().map(|um| number(*um)).collect::<Vec<_>>().join(", "),
        number(figures.measured_over_model),
        number((figures.worst_deviation * 1000.0).round() / 10.0),
    );
    let row = |row: &Row| {
        let Row { frequency_hz, amplitude_um, model_um, measured_um, sd_um, .. } = row;
        format!("{frequency_hz},{amplitude_um},{model_um},{measured_um:.4},{sd_um:.4}")
    };
    let head = "frequency_hz,amplitude_um,model_um,measured_um,measured_sd_um";
    let numbers = csv(head, rows.iter().map(row));
    let drawn = plot(array, &amplitudes_um, &rows)?;
    section.figure("amplitude", drawn, Some(numbers), &caption, &command(array));
    Ok((section, figures))
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

/// The lower end of the amplitude axis, µm.
const LEAST_UM: f64 = 0.5;

fn plot(array: Array, amplitudes_um: &[f64], rows: &[Row]) -> Result<String, MotorError> {
    let last = f64::from(LINE - 1);
    let mut line_hz: Vec<f64> = (0..LINE).map(|n| 300_f64.powf(f64::from(n) / last)).collect();
    let null_hz = Some(1.0 / window_s(array)).filter(|null| *null <= 300.0);
    line_hz.extend(null_hz);
    line_hz.sort_by(f64::total_cmp);
    let series = amplitudes_um.par_iter().map(|&um| {
        let line = line_hz.iter().map(|&hz| Ok((hz, SteadyState::ideal_um(array, hz, um)?)));
        let of_amplitude = rows.iter().filter(|row| row.amplitude_um == um);
        let point = |row: &Row| Point { x: row.frequency_hz, y: row.measured_um, sd: row.sd_um };
        let line = Series::line(format!("{um} µm"), line.collect::<Result<_, MotorError>>()?);
        Ok(Series { points: of_amplitude.map(point).collect(), ..line })
    });
    let chart = Chart {
        title: None,
        x: Axis { name: "frequency, Hz", scale: Scale::logarithmic(1.0, 300.0) },
        y: Axis {
            name: "amplitude, µm peak to peak",
            scale: Scale::logarithmic(LEAST_UM, 500.0).broken("below"),
        },
        series: series.collect::<Result<_, MotorError>>()?,
    };
    Ok(draw(&chart))
}

fn rows(
    array: Array,
    amplitudes_um: &[f64],
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Vec<Row>, FiguresError> {
    let parts = Parts::new(FREQUENCIES_HZ.len(), progress);
    let measured = FREQUENCIES_HZ.par_iter().map(|&frequency_hz| {
        // An array of few motors plays some amplitudes after the others.
        let parts_um = amplitudes_um.chunks(array.motors());
        let measured = parts_um.map(|some_um| measure(array, frequency_hz, some_um));
        let cycles = measured.collect::<Result<Vec<_>, FiguresError>>()?.concat();
        let rows = amplitudes_um.iter().zip(cycles).map(|(&amplitude_um, cycles)| {
            let (measured_um, sd_um) = mean_and_sd(&cycles);
            let model_um = SteadyState::ideal_um(array, frequency_hz, amplitude_um)?;
            let cycles = cycles.len();
            Ok(Row { frequency_hz, amplitude_um, model_um, measured_um, sd_um, cycles })
        });
        let rows = rows.collect::<Result<Vec<_>, MotorError>>()?;
        parts.done();
        Ok(rows)
    });
    Ok(measured.collect::<Result<Vec<_>, FiguresError>>()?.concat())
}

/// For each of some amplitudes, at most as many as there are motors: the peak-to-peak amplitudes of the measured cycles, µm. Motors of
/// consecutive numbers play the same amplitude.
fn measure(array: Array, frequency_hz: f64, amplitudes_um: &[f64]) -> Result<Vec<Vec<f64>>, FiguresError> {
    let plays = |motor: u8| usize::from(motor) * amplitudes_um.len() / array.motors();
    let config = SimulatedMotorsConfig {
        seed: SEED,
        end_stop_um: END_STOP_UM,
        telemetry_hz: SAMPLES_HZ,
        ..SimulatedMotorsConfig::default()
    };
    let mut motors = SimulatedMotors::new(array, config, Tick(0))?;
    let periods = window_s(array) * frequency_hz;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few")]
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
                for ((readings, wanted), y) in readings.iter_mut().zip(&wanted).zip(&sample.y) {
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
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time, rounded")]
fn sample(array: Array, twice: u64) -> u64 {
    let ticks = (twice as f64 + array.motor().window_ticks()) / 2.0;
    (ticks * f64::from(SAMPLES_HZ) / f64::from(array.rate().hz())).round() as u64
}
