//! Pins that follow any motion, in figures: what the motors reach of each stimulus, and how far pins drift without telemetry.
//!
//! [`motion_figures`] compiles each stimulus as the daemon does and compares the ideal motor's displacement with the waveform, and with
//! the waveform after the motor's response. [`drift_figures`] plays noise on simulated motors in open loop, burst by burst, and compares
//! the error of the pins with its theory: a random walk without a stop, and with a lower stop the reflected walk of the visits to rest.
//!
//! Invariant: results depend on the request alone.

use anyhow::Result;
use firmware_protocol::moves::Move;
use meissner::cli::{FollowingError, steps_of};
use meissner_array::motion::{
    Envelope, MotionError, Noise, Path, RampHold, Reached, Shape, Strength, Tone, Waveform, beginning, choose,
};
use meissner_array::motor::HalfTick;
use meissner_array::pattern::{Form, Motion, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::reflected_walk::ReflectedWalk;
use meissner_array::simulated::{LowerStop, Pin, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::{Step, StrokeOptions, Strokes};
use meissner_stream::{Bandwidth, Gains, LowerStopSettings, Settings};
use rayon::prelude::*;
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
        let (step_ms, moves, _) = compile(array, &[(9, hann(amplitude_um)?)])?;
        Ok(HarmonicRow { amplitude_um, step_ms, db: third_harmonic_db(array, &moves[0]) })
    };
    let third_harmonic_db =
        [80.0, 40.0, 20.0].into_iter().map(harmonic).collect::<Result<_, MotionError>>()?;
    Ok(MotionFigures { rows, third_harmonic_db })
}

/// The step of the grid, ms, and for each motor its moves and what it reaches.
type Compiled = (f64, Vec<Vec<Move>>, Vec<Reached>);

fn compile(array: Array, motors: &[(u8, Waveform)]) -> Result<Compiled, MotionError> {
    /// Longer than every stimulus.
    const WHOLE_NS: u64 = 60_000_000_000;
    let grid = choose(array, motors.iter().map(|(motor, waveform)| (*motor, waveform)), None)?;
    let of = |(motor, waveform): &(u8, Waveform)| beginning(array, *motor, waveform, grid, WHOLE_NS);
    let (moves, reached) = motors.iter().map(of).unzip();
    Ok((array.rate().ticks_to_ms(grid.step_ticks.into()), moves, reached))
}

fn row(array: Array, stimulus: &str, motors: &[(u8, Waveform)]) -> Result<StimulusRow, MotionError> {
    let (step_ms, moves, reached) = compile(array, motors)?;
    let worst = |error: fn(&Reached) -> meissner_array::motion::Deviation| {
        let all = reached.iter().map(error);
        let worst = all.reduce(|worst, of| if of.share > worst.share { of } else { worst });
        FollowingError::from(worst.unwrap_or_default())
    };
    let Bandwidth { open, closed } = Bandwidth::of_steps(steps_of(&moves), &Settings::of(array));
    Ok(StimulusRow {
        stimulus: stimulus.to_owned(),
        motors: motors.len(),
        step_ms,
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

/// Drift of noise that is played without telemetry.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DriftFigures {
    /// Motors of each array.
    pub motors: usize,
    /// Arrays, each with other motors.
    pub arrays: u64,
    /// Seconds of noise with a rest in each.
    pub seconds: u32,
    /// A row per kind of motors.
    pub rows: Vec<DriftRow>,
}

/// What holds the pins, and by what they push against it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Held {
    /// Nothing.
    Free,
    /// A lower stop; moves to rest are as long as the pin is high.
    Stop,
    /// A lower stop; moves to rest have the surplus that the daemon gives them.
    StopAndSurplus,
}

/// Simulated arrays of each row: enough that chance is a few per cent.
const ARRAYS: u64 = 8;

/// How far pins are from rest in the rests of noise that is played in open loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DriftRow {
    /// Standard deviation of a burst's gain.
    pub scatter: f64,
    /// Standard deviation of the asymmetry over motors.
    pub asymmetry_sd: f64,
    /// What holds the pins.
    pub held: Held,
    /// Mean surplus of a move to rest, µm.
    pub surplus_um: f64,
    /// RMS over motors and rests, µm.
    pub rms_um: f64,
    /// The same by the theory, µm.
    pub theory_um: f64,
    /// RMS over motors in the last rest, µm.
    pub last_um: f64,
    /// The same by the theory, µm.
    pub last_theory_um: f64,
}

/// Plays a second of noise with a rest again and again, on each pin another one, on simulated motors in open loop.
///
/// # Errors
/// If the noise cannot be compiled, which is our bug.
pub fn drift_figures(array: Array, seconds: u32) -> Result<DriftFigures> {
    let cases = [(0.1, 0.0), (0.1, 0.02), (0.3, 0.02)];
    let held = [Held::Free, Held::Stop, Held::StopAndSurplus];
    let cells: Vec<_> = cases.iter().flat_map(|case| held.map(|held| (*case, held))).collect();
    let rows = cells
        .par_iter()
        .map(|&((scatter, asymmetry_sd), held)| drift(array, seconds, (scatter, asymmetry_sd), held));
    Ok(DriftFigures { motors: array.motors(), arrays: ARRAYS, seconds, rows: rows.collect::<Result<_>>()? })
}

/// Noise of 5 to 50 Hz and 10 um RMS about 60 um for 0.8 s, and a rest; each motor has its own.
fn noise_with_rests(array: Array) -> Result<Pattern> {
    let motion = |motor: u8| {
        let (start_s, duration_s, low_hz, high_hz) = (0.0, 0.8, 5.0, 50.0);
        let (strength, about_um, seed) = (Strength::RmsUm(10.0), Some(60.0), 100 + u64::from(motor));
        let envelope = Envelope::AttackRelease { attack_s: 0.1, release_s: 0.1 };
        let noise = Noise { start_s, duration_s, low_hz, high_hz, strength, about_um, seed, envelope };
        Motion { motor, form: Form::Noise(noise) }
    };
    let pattern = Pattern::new(array, "noise", Some(1.0), Vec::new(), toml::Table::new())?;
    Ok(pattern.with_motions(array.numbers().map(motion).collect())?)
}

fn drift(array: Array, seconds: u32, (scatter, asymmetry_sd): (f64, f64), held: Held) -> Result<DriftRow> {
    let gains = Gains { scatter, ..Gains::default() };
    let lower_stop = (held == Held::StopAndSurplus).then(|| LowerStopSettings::of(array));
    let settings = Settings { lower_stop, ..Settings::of(array) };
    let surplus = settings.surplus(&PerMotor::all(array, gains));
    let options = StrokeOptions { surplus, ..StrokeOptions::lasting(f64::from(seconds)) };
    let motors = SimulatedMotorsConfig {
        gain_sd: scatter,
        asymmetry_sd,
        // The theory has neither.
        transient_gain: Some(1.0),
        end_stop_um: 100_000.0,
        telemetry_hz: 0,
        lower_stop: if held == Held::Free { LowerStop::None } else { LowerStop::AtRest },
        ..SimulatedMotorsConfig::default()
    };
    let steps: Vec<Step> = Strokes::new(&noise_with_rests(array)?, &options)?.collect::<Result<_, _>>()?;
    let um_per_pulse = array.motor().um_per_pulse;
    let mut walks = vec![Walk::default(); array.motors()];
    for step in &steps {
        let walk = &mut walks[usize::from(step.motor())];
        walk.add(f64::from(step.pulses()) * um_per_pulse, f64::from(step.surplus()) * um_per_pulse);
        walk.rests += usize::from(step.level() == 0);
    }
    let rests = walks.iter().map(|walk| walk.rests).min().unwrap_or(0);
    // Mean squares in each rest, played and by the theory.
    let of_array = |seed: u64| -> Vec<[f64; 2]> {
        let motors = SimulatedMotorsConfig { seed, ..motors };
        let mut pins: Vec<Pin> =
            array.numbers().map(|motor| Pin::new(array, &motors, motor.into())).collect();
        let mut squares = vec![[0.0; 2]; rests];
        let mut rest = vec![0; array.motors()];
        for step in &steps {
            let motor = usize::from(step.motor());
            step.bursts().for_each(|burst| pins[motor].play(burst));
            if step.level() == 0 && rest[motor] < rests {
                squares[rest[motor]][0] += pins[motor].position_um(step.end()).powi(2);
                rest[motor] += 1;
            }
        }
        for (walk, pin) in walks.iter().zip(&pins) {
            let theory = walk.squares(pin.asymmetry(), scatter, held, rests);
            squares.iter_mut().zip(theory).for_each(|(square, theory)| square[1] += theory);
        }
        squares
    };
    let arrays: Vec<Vec<[f64; 2]>> = (0..ARRAYS).into_par_iter().map(of_array).collect();
    let pins = ARRAYS as f64 * array.motors() as f64;
    let mean =
        |rest: usize| [0, 1].map(|of| arrays.iter().map(|squares| squares[rest][of]).sum::<f64>() / pins);
    let means: Vec<[f64; 2]> = (0..rests).map(mean).collect();
    let [rms_um, theory_um] =
        [0, 1].map(|of| (means.iter().map(|mean| mean[of]).sum::<f64>() / rests as f64).sqrt());
    let [last_um, last_theory_um] = means.last().map_or([0.0; 2], |mean| mean.map(f64::sqrt));
    let surplus: f64 = walks.iter().map(|walk| walk.surplus_um).sum();
    let all_rests: usize = walks.iter().map(|walk| walk.rests).sum();
    let surplus_um = surplus / all_rests as f64;
    Ok(DriftRow { scatter, asymmetry_sd, held, surplus_um, rms_um, theory_um, last_um, last_theory_um })
}

/// Sums over the bursts of a motor.
#[derive(Clone, Default)]
struct Walk {
    travel_um: f64,
    squares_um2: f64,
    surplus_um: f64,
    rests: usize,
}

impl Walk {
    fn add(&mut self, travel_um: f64, surplus_um: f64) {
        self.travel_um += travel_um;
        self.squares_um2 += travel_um * travel_um;
        self.surplus_um += surplus_um;
    }

    /// Mean square of the error in each of so many rests. From rest to rest a pin goes up by the asymmetry's share of its travel, half
    /// of it in each direction, and down by the surplus; its bursts scatter independently. A stop reflects it in the rests.
    fn squares(&self, asymmetry: f64, scatter: f64, held: Held, rests: usize) -> Vec<f64> {
        let each = self.rests as f64;
        let mean = (asymmetry / 2.0 * self.travel_um - self.surplus_um) / each;
        let sd = scatter * (self.squares_um2 / each).sqrt();
        if held == Held::Free {
            return (1..=rests).map(|n| (n as f64 * mean).powi(2) + n as f64 * sd * sd).collect();
        }
        ReflectedWalk::of_steps(mean, sd).rms_after_um(rests).into_iter().map(|um| um * um).collect()
    }
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

    #[test]
    fn drift_in_open_loop_is_that_of_the_theory() {
        let found = drift_figures(Array::paper(), 20).unwrap();
        for row in &found.rows {
            println!("{row:?}");
            // Where the surplus takes everything, rare rests above the stop are left.
            let off = (row.rms_um - row.theory_um).abs();
            assert!(off < 0.15 * row.theory_um + 0.5, "{row:?}");
            assert!((row.held == Held::StopAndSurplus) == (row.surplus_um > 0.0), "{row:?}");
        }
        // The stop alone takes half of a drift without a mean; the surplus keeps it small.
        let [free, stop, surplus] = &found.rows[3..6] else { panic!() };
        assert!(stop.rms_um < free.rms_um && surplus.rms_um < 0.3 * stop.rms_um, "{found:?}");
        // It is what keeps the rest error within 5 um, and no more: it grows with the scatter, and is below the most of the controller.
        let [even, uneven, wide] = [2, 5, 8].map(|at| found.rows[at]);
        assert!(even.rms_um < 6.0 && uneven.rms_um < 6.0 && even.surplus_um < 60.0, "{found:?}");
        assert!(uneven.surplus_um < 100.0 && uneven.surplus_um < wide.surplus_um, "{found:?}");
    }
}
