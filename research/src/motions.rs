//! Pins that follow any motion, in figures: what the motors reach of each stimulus.
//!
//! [`motion_figures`] compiles each stimulus as the daemon does and compares the ideal motor's displacement with the waveform, and with
//! the waveform after the motor's response.
//!
//! Invariant: results depend on the request alone.

use anyhow::Result;
use firmware_protocol::moves::Move;
use meissner::cli::{FollowingError, steps_of};
use meissner_array::motion::{
    Envelope, Grid, MotionError, Noise, Path, RampHold, Reached, Shape, Strength, Tone, Waveform, beginning,
    choose,
};
use meissner_array::motor::HalfTick;
use meissner_array::spec::Array;
use meissner_stream::{Bandwidth, Settings};
use serde::Serialize;
use std::f64::consts::{PI, TAU};

/// The rate of the trace.
const TRACE_HZ: f64 = 2000.0;

/// What motors reach of the stimuli.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionFigures {
    /// A row per stimulus.
    pub rows: Vec<StimulusRow>,
    /// Third harmonic of the Hann burst of 40 Hz below its first, dB, by amplitude, µm, on the compiler's grid.
    pub third_harmonic_db: Vec<HarmonicRow>,
}

/// What motors reach of a stimulus. Of several motors, the worst.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StimulusRow {
    /// What is asked.
    pub stimulus: String,
    /// Motors that play it.
    pub motors: usize,
    /// The step of the grid, ms.
    pub step_ms: f64,
    /// The highest displacement asked, µm.
    pub highest_um: f64,
    /// From the waveform.
    pub from_asked: FollowingError,
    /// From the waveform after the motor's response.
    pub from_filtered: FollowingError,
    /// Seconds in which a motor is too slow.
    pub too_slow_s: f64,
    /// Moves per second of all motors, from the beginning until all pins rest.
    pub moves_per_s: f64,
    /// Bytes per second that the link must carry at the peak, without corrections.
    pub link_bytes_per_s: u32,
    /// The same with every burst corrected.
    pub link_bytes_per_s_corrected: u32,
}

/// The third harmonic of a burst.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct HarmonicRow {
    /// Amplitude of the burst, peak to peak, µm.
    pub amplitude_um: f64,
    /// The step of the grid, ms.
    pub step_ms: f64,
    /// The third harmonic over the first, dB.
    pub db: f64,
}

/// Compares each stimulus with what the motors of an array reach.
///
/// # Errors
/// If a waveform cannot be made, which is our bug.
pub fn motion_figures(array: Array) -> Result<MotionFigures, MotionError> {
    let one = |waveform: Waveform| vec![(9, waveform)];
    let stimuli: Vec<(String, Vec<(u8, Waveform)>)> = vec![
        ("ramp to 200 um in 50 ms, held 500 ms".to_owned(), one(ramp()?)),
        ("Hann burst, 40 Hz, 80 um".to_owned(), one(hann(80.0)?)),
        ("Hann burst, 40 Hz, 20 um".to_owned(), one(hann(20.0)?)),
        ("chirp 10 to 200 Hz, 15 um, Hann".to_owned(), one(chirp()?)),
        ("noise 5 to 50 Hz, 10 um RMS".to_owned(), one(noise(10.0, 10.0, 3)?)),
        ("recorded-like texture, 2 s at 2 kHz".to_owned(), one(recorded()?)),
        (
            format!("noise 5 to 50 Hz, 10 um RMS, another one on each of {} pins", array.motors()),
            array
                .numbers()
                .map(|motor| Ok((motor, noise(10.0, 4.0, 100 + u64::from(motor))?)))
                .collect::<Result<_, MotionError>>()?,
        ),
    ];
    let rows = stimuli.iter().map(|(stimulus, motors)| row(array, stimulus, motors));
    let rows = rows.collect::<Result<_, _>>()?;
    let harmonic = |amplitude_um| {
        let (grid, moves, _) = compiled(array, &[(9, hann(amplitude_um)?)])?;
        let step_ms = array.rate().ticks_to_ms(grid.step_ticks.into());
        Ok(HarmonicRow { amplitude_um, step_ms, db: third_harmonic_db(array, &moves[0]) })
    };
    let third_harmonic_db =
        [80.0, 40.0, 20.0].into_iter().map(harmonic).collect::<Result<_, MotionError>>()?;
    Ok(MotionFigures { rows, third_harmonic_db })
}

/// The grid that the daemon takes, the moves of each motor, and what it reaches.
type Compiled = (Grid, Vec<Vec<Move>>, Vec<Reached>);

fn compiled(array: Array, motors: &[(u8, Waveform)]) -> Result<Compiled, MotionError> {
    let grid = choose(array, motors.iter().map(|(motor, waveform)| (*motor, waveform)), None)?;
    let whole = |(motor, waveform): &(u8, Waveform)| beginning(array, *motor, waveform, grid, u64::MAX);
    let (moves, reached) = motors.iter().map(whole).unzip();
    Ok((grid, moves, reached))
}

fn row(array: Array, stimulus: &str, motors: &[(u8, Waveform)]) -> Result<StimulusRow, MotionError> {
    let (grid, moves, reached) = compiled(array, motors)?;
    let worst = |error: fn(&Reached) -> meissner_array::motion::Deviation| {
        let all = reached.iter().map(error);
        let worst = all.reduce(|worst, of| if of.share > worst.share { of } else { worst });
        FollowingError::from(worst.unwrap_or_default())
    };
    let Bandwidth { open, closed } = Bandwidth::of_steps(steps_of(&moves), &Settings::of(array));
    Ok(StimulusRow {
        stimulus: stimulus.to_owned(),
        motors: motors.len(),
        step_ms: array.rate().ticks_to_ms(grid.step_ticks.into()),
        highest_um: motors.iter().map(|(_, waveform)| waveform.extremes_um()[1]).fold(0.0, f64::max),
        from_asked: worst(|of| of.from_asked),
        from_filtered: worst(|of| of.from_filtered),
        too_slow_s: reached
            .iter()
            .flat_map(|of| &of.too_slow_s)
            .fold(0.0, |sum, (from, until)| sum + until - from),
        moves_per_s: reached.iter().map(|of| of.moves_per_s).sum(),
        link_bytes_per_s: open.rate,
        link_bytes_per_s_corrected: closed.rate,
    })
}

fn ramp() -> Result<Waveform, MotionError> {
    let (start_s, to_um, rise_s, hold_s, fall_s, shape) = (0.0, 200.0, 0.05, 0.5, 0.05, Shape::Linear);
    RampHold { start_s, to_um, rise_s, hold_s, fall_s, shape }.waveform()
}

fn hann(amplitude_um: f64) -> Result<Waveform, MotionError> {
    tone(40.0, 40.0, amplitude_um)
}

fn chirp() -> Result<Waveform, MotionError> {
    tone(10.0, 200.0, 15.0)
}

/// One second, under a Hann envelope.
fn tone(start_hz: f64, end_hz: f64, amplitude_um: f64) -> Result<Waveform, MotionError> {
    let (start_s, duration_s, about_um, phase, envelope) = (0.0, 1.0, None, 0.75, Envelope::Hann);
    Tone { start_s, duration_s, start_hz, end_hz, amplitude_um, about_um, phase, envelope }.waveform()
}

fn noise(rms_um: f64, duration_s: f64, seed: u64) -> Result<Waveform, MotionError> {
    let (start_s, low_hz, high_hz, strength) = (0.0, 5.0, 50.0, Strength::RmsUm(rms_um));
    let envelope = Envelope::AttackRelease { attack_s: 0.1, release_s: 0.1 };
    Noise { start_s, duration_s, low_hz, high_hz, strength, about_um: None, seed, envelope }.waveform()
}

/// Stands for a recorded trace: a finger that slides over ridges of 2 mm at 20 to 60 mm/s and back, with fine texture, as samples.
fn recorded() -> Result<Waveform, MotionError> {
    let sample = |number: u32| {
        let t = f64::from(number) / TRACE_HZ;
        // Position along the ridges, mm: the speed is 20 + 40 sin²(πt/2).
        let along = 40.0 * t - 20.0 / PI * (PI * t).sin();
        let ridges = (TAU * along / 2.0).sin().max(-0.4) + 0.4;
        let texture = 0.12 * (TAU * along / 0.37).sin() + 0.08 * (TAU * along / 0.23 + 1.0).sin();
        let press = 1.0 - (TAU * t / 2.0).cos();
        (press * (6.0 + 9.0 * ridges + 9.0 * texture)).max(0.0)
    };
    let um: Vec<f64> = (0..=4000).map(sample).collect();
    Waveform::samples(0.0, TRACE_HZ, &um)
}

/// The third harmonic of a second of 40 Hz over the first, dB, of an ideal motor that plays these moves.
fn third_harmonic_db(array: Array, moves: &[Move]) -> f64 {
    let per_s = array.rate().per_s();
    let mut path = Path::new(array, moves);
    let um: Vec<f64> = (0..per_s).map(|tick| path.um_at(HalfTick(2 * tick))[1]).collect();
    let count = um.len() as f64;
    let amplitude = |cycles: f64| -> f64 {
        let part = |shift: f64| -> f64 {
            um.iter().enumerate().map(|(n, um)| um * (TAU * cycles * n as f64 / count + shift).cos()).sum()
        };
        part(0.0).hypot(part(PI / 2.0))
    };
    20.0 * (amplitude(120.0) / amplitude(40.0)).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stimuli_are_reached_as_the_book_says() {
        let found = motion_figures(Array::paper()).unwrap();
        assert_eq!(found.rows.len(), 7);
        for row in &found.rows {
            assert!(row.from_filtered.r.unwrap() >= 0.98 && row.too_slow_s == 0.0, "{row:?}");
            assert!(row.from_asked.rms_um >= row.from_filtered.rms_um, "{row:?}");
            assert!(row.link_bytes_per_s <= 40_000, "{row:?}");
        }
        assert!(found.rows[0].from_filtered.peak_um < 0.95 && found.rows[6].motors == 24, "{found:?}");
        for row in &found.third_harmonic_db {
            assert!(row.db <= -40.0, "{row:?}");
        }
    }
}
