//! What the closed loop is worth: how far pins rest from where they ought to, against the best there can be.
//!
//! [`control_tradeoff`] plays one motor with its loop ([`MotorRun`], bursts without a link) at every cell of a [`ControlGrid`], and says of each
//! the rest error beside its bound ([`rest_bound_um`]), how far the mean amplitude is off, and whether that is within the
//! limits below. Beside the grid: the rest error against how often telemetry comes, and what corrections cost on the
//! wire. What is too little to be told from chance is told as such.
//!
//! Invariant: the same grid makes the same figures, on every machine and any number of cores.

mod plot;
mod summary;

pub use plot::plot_control;
pub use summary::{Bias, ControlSummary, Worst};

use crate::methods::SIXTY_HERTZ;
use firmware_protocol::tick::TICK_HZ;
use meissner_api::SensorFault;
use meissner_array::motor::MotorError;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::units::{UM_PER_PULSE, seconds_in_ticks};
use meissner_skin::Scene;
use meissner_stream::{MotorRun, Period, Settings, rest_bound_um, simulate_play};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};

/// At most so many times the bound, for a scatter up to [`SCATTER`].
const RATIO: f64 = 1.2;
const SCATTER: f64 = 0.1;
/// And so many times for a larger one: the loop has to learn a scatter that it does not expect.
const LARGE_RATIO: f64 = 1.5;
/// Without scatter there is nothing but counts to round: a pulse, µm.
const CALM_UM: f64 = UM_PER_PULSE;
/// The mean amplitude may be off by this share, or by half a pulse.
const AMPLITUDE: f64 = 0.01;
/// Where half a period is at least so many bursts long; below, a weak motor has no room for longer bursts.
const ROOM: f64 = 1.3;
/// What exceeds a limit by fewer standard errors may be chance: one cell in a hundred does.
const CHANCE: f64 = 2.5;
/// A mean's standard error is that of so many parts' means: errors of neighbours go together.
const PARTS: usize = 40;
/// What the wire's cost is measured on: all motors for so long, s.
const WIRE_S: f64 = 10.0;

/// What is tried: every combination.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlGrid {
    /// Frequencies, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Amplitudes, peak to peak, µm.
    pub amplitudes_um: Vec<f64>,
    /// Leads, ms. They share their draws, so that nothing but the lead makes a difference.
    pub leads_ms: Vec<f64>,
    /// MethodLabel old telemetry is when it comes, ms.
    pub ages_ms: Vec<f64>,
    /// Standard deviations of a burst's gain.
    pub scatters: Vec<f64>,
    /// Gain up less gain down.
    pub asymmetries: Vec<f64>,
    /// Samples per second, each with all frequencies at [`MotorRun::default`]'s other settings.
    pub telemetry_hz: Vec<f64>,
    /// Each cell lasts at least so long, s of device time,
    pub seconds: f64,
    /// and at least so many periods.
    pub periods: f64,
}

impl Default for ControlGrid {
    /// The whole: 2 160 cells, 11 days of device time.
    fn default() -> Self {
        Self {
            frequencies_hz: vec![1.0, 10.0, 60.0, 150.0, 300.0],
            amplitudes_um: vec![2.0, 10.0, 80.0, 200.0],
            leads_ms: vec![20.0, 100.0, 500.0],
            ages_ms: vec![1.0, 5.0, 20.0, 100.0],
            scatters: vec![0.0, 0.1, 0.3],
            asymmetries: vec![0.0, 0.02, 0.1],
            telemetry_hz: vec![1000.0, 500.0, 200.0, 100.0, 50.0, 20.0],
            seconds: 20.0,
            periods: 2000.0,
        }
    }
}

impl ControlGrid {
    /// The cells in order, the last quantity first to change.
    fn cells(&self) -> Vec<MotorRun> {
        let (mut cells, mut seed) = (Vec::new(), 0);
        for &frequency_hz in &self.frequencies_hz {
            for &amplitude_um in &self.amplitudes_um {
                for &lead_ms in &self.leads_ms {
                    let mut draws = seed;
                    for &age_ms in &self.ages_ms {
                        for &scatter in &self.scatters {
                            for &asymmetry in &self.asymmetries {
                                let cell = MotorRun {
                                    frequency_hz,
                                    amplitude_um,
                                    lead_ms,
                                    age_ms,
                                    ..MotorRun::default()
                                };
                                cells.push(MotorRun { scatter, asymmetry, seed: draws, ..cell });
                                draws += 1;
                            }
                        }
                    }
                }
                seed += (self.ages_ms.len() * self.scatters.len() * self.asymmetries.len()) as u64;
            }
        }
        cells
    }

    /// The cells at which only the telemetry's rate and the frequency differ; the same draws at all rates.
    fn rates(&self) -> Vec<MotorRun> {
        let of = |(&frequency_hz, seed): (&f64, u64)| {
            let with = move |&telemetry_hz: &f64| MotorRun {
                frequency_hz,
                telemetry_hz,
                seed,
                ..MotorRun::default()
            };
            self.telemetry_hz.iter().map(with)
        };
        self.frequencies_hz.iter().zip(1_000_000..).flat_map(of).collect()
    }

    fn seconds(&self, motor_run: &MotorRun) -> f64 {
        self.seconds.max(self.periods / motor_run.frequency_hz)
    }
}

/// MethodLabel well the loop holds rest positions and amplitudes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlTradeoff {
    /// The grid's cells, in order.
    pub rows: Vec<ControlRow>,
    /// Telemetry's rate against the rest error.
    pub rates: Vec<ControlRow>,
    /// What corrections cost.
    pub wire: Wire,
    /// MethodLabel many cells hold.
    pub summary: ControlSummary,
    /// What it comes to, in a sentence.
    pub recommendation: String,
}

/// A cell and what came of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ControlRow {
    /// Of the square wave.
    pub frequency_hz: f64,
    /// As asked for, peak to peak.
    pub amplitude_um: f64,
    /// MethodLabel far ahead strokes were sent.
    pub lead_ms: f64,
    /// MethodLabel old telemetry was.
    pub age_ms: f64,
    /// Samples per second.
    pub telemetry_hz: f64,
    /// Standard deviation of a burst's gain.
    pub scatter: f64,
    /// Gain up less gain down.
    pub asymmetry: f64,
    /// From a burst back to the newest sample that it could go by.
    pub delay_ms: f64,
    /// Periods that count: the first 2 s, or ten delays, are left out.
    pub periods: usize,
    /// The amplitude as planned, which is what fits.
    pub planned_um: f64,
    /// Half a period over a burst's length.
    pub room: f64,
    /// Root mean square of the true rest error.
    pub rest_rms_um: f64,
    /// The least there can be, at `delay_ms` and the planned amplitude.
    pub bound_um: f64,
    /// The same with samples a millisecond fresher: between two wake-ups a burst may come closer by so much before its count
    /// is settled, and in a motor_run samples come with the wake-ups.
    pub strict_bound_um: f64,
    /// What [`Self::rest_rms_um`] is held against.
    pub limit_um: f64,
    /// Of the mean amplitude, top less the mean of the rests beside it, relative to what was planned.
    pub amplitude_error: f64,
    /// Its standard error, relative, from 40 parts' means.
    pub amplitude_se: f64,
    /// What it is held against; none without room.
    pub amplitude_limit: Option<f64>,
    /// Bursts whose count was changed.
    pub corrected_share: f64,
    /// Why the loop gave honest telemetry up: it must not.
    pub doubt: Option<SensorFault>,
    /// Whether it is within the limits.
    pub verdict: Verdict,
}

/// Whether a cell is within its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It is.
    Holds,
    /// The amplitude is not, by less than 2.5 standard errors: chance may be all there is to it.
    Chance,
    /// It is not.
    Misses,
}

/// Bytes to the device, of 24 motors at 60 Hz and 80 µm through link and controller in virtual time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wire {
    /// For so long.
    pub seconds: f64,
    /// With the loop.
    pub on: WireRow,
    /// Without.
    pub off: WireRow,
}

/// A play's bytes and what they bought.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WireRow {
    /// All bytes to the device over bursts.
    pub bytes_per_burst: f64,
    /// And over time.
    pub bytes_per_s: f64,
    /// Bursts planned.
    pub bursts: u64,
    /// Of them those whose count was changed on the way.
    pub amended: u64,
    /// Root mean square of the rest error of all motors, the first second included.
    pub rest_rms_um: f64,
}

/// Plays each cell of a grid. `progress` hears now and then which part is done, on any thread.
///
/// # Errors
/// A frequency or amplitude that no motor can be asked for.
pub fn control_tradeoff(
    grid: &ControlGrid,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<ControlTradeoff, MotorError> {
    let (cells, rates) = (grid.cells(), grid.rates());
    // What a cell takes goes by its samples, and there are most at the lowest frequencies.
    let samples = |motor_run: &MotorRun| grid.seconds(motor_run) * motor_run.telemetry_hz;
    let all: f64 = cells.iter().chain(&rates).map(samples).sum();
    let done = AtomicU64::new(0);
    let measure = |motor_run: &MotorRun| {
        let row = ControlRow::of(motor_run, grid.seconds(motor_run));
        let before = done.fetch_add(samples(motor_run) as u64, Ordering::Relaxed);
        progress(((before as f64 + samples(motor_run)) / all).min(1.0));
        row
    };
    let measure =
        |trials: Vec<MotorRun>| trials.par_iter().with_max_len(1).map(measure).collect::<Result<Vec<_>, _>>();
    let (rows, rates) = (measure(cells)?, measure(rates)?);
    let (on, off) = rayon::join(|| WireRow::of(false), || WireRow::of(true));
    let wire = Wire { seconds: WIRE_S, on, off };
    let summary = ControlSummary::of(&rows);
    let recommendation = summary::recommendation(&rows, &rates, &wire);
    Ok(ControlTradeoff { rows, rates, wire, summary, recommendation })
}

impl ControlRow {
    fn of(motor_run: &MotorRun, seconds: f64) -> Result<Self, MotorError> {
        let delay_ms = motor_run.delay_ms();
        let skipped = seconds_in_ticks(2f64.max(10.0 * delay_ms / 1000.0));
        let mut periods: Vec<Period> = Vec::new();
        let keep = |period: &Period| {
            if period.up as f64 >= skipped {
                periods.push(*period);
            }
        };
        let doubt = motor_run.run(seconds, |_, y| Some(y), keep)?;
        let planned_um = mean(periods.iter().map(|period| period.planned_um));
        let half_period_um = f64::from(TICK_HZ) / 2.0 / motor_run.frequency_hz * UM_PER_PULSE;
        let room = half_period_um / planned_um;
        let rest_rms_um = mean(periods.iter().map(|period| period.rest_um.powi(2))).sqrt();
        let bound = |delay_ms: f64| {
            rest_bound_um(
                motor_run.frequency_hz,
                planned_um,
                motor_run.scatter,
                delay_ms,
                motor_run.telemetry_hz,
            )
        };
        let bound_um = bound(delay_ms);
        let limit_um = match motor_run.scatter {
            0.0 => CALM_UM,
            ..=SCATTER => RATIO * bound_um,
            _ => LARGE_RATIO * bound_um,
        };
        let errors: Vec<f64> = periods
            .windows(2)
            .map(|two| two[1].top_um - (two[0].rest_um + two[1].rest_um) / 2.0 - two[1].planned_um)
            .map(|um| um / planned_um)
            .collect();
        let (amplitude_error, amplitude_se) = (mean(errors.iter().copied()), standard_error(&errors));
        let amplitude_limit = (room >= ROOM).then(|| AMPLITUDE.max(UM_PER_PULSE / 2.0 / planned_um));
        let beyond = amplitude_limit.map_or(0.0, |limit| amplitude_error.abs() - limit);
        let verdict = if doubt.is_some() || rest_rms_um > limit_um || beyond > CHANCE * amplitude_se {
            Verdict::Misses
        } else if beyond > 0.0 {
            Verdict::Chance
        } else {
            Verdict::Holds
        };
        let corrected = periods.iter().flat_map(|period| {
            period.pulses.map(|pulses| f64::from(pulses) * UM_PER_PULSE - period.planned_um)
        });
        let corrected_share = mean(corrected.map(|um| f64::from(um.abs() > UM_PER_PULSE / 2.0)));
        Ok(Self {
            frequency_hz: motor_run.frequency_hz,
            amplitude_um: motor_run.amplitude_um,
            lead_ms: motor_run.lead_ms,
            age_ms: motor_run.age_ms,
            telemetry_hz: motor_run.telemetry_hz,
            scatter: motor_run.scatter,
            asymmetry: motor_run.asymmetry,
            delay_ms,
            periods: periods.len(),
            planned_um,
            room,
            rest_rms_um,
            bound_um,
            strict_bound_um: bound(delay_ms - 1.0),
            limit_um,
            amplitude_error,
            amplitude_se,
            amplitude_limit,
            corrected_share,
            doubt,
            verdict,
        })
    }

    /// Which cell it is, but for the lead.
    fn cell(&self) -> [f64; 6] {
        [self.frequency_hz, self.amplitude_um, self.age_ms, self.telemetry_hz, self.scatter, self.asymmetry]
    }

    /// By how much the amplitude is beyond its limit and what chance explains.
    fn amplitude_beyond(&self) -> f64 {
        self.amplitude_limit
            .map_or(0.0, |limit| self.amplitude_error.abs() - limit - CHANCE * self.amplitude_se)
    }

    /// Whether the rest error would be beyond its limit if that went by the strict bound.
    fn misses_strictly(&self) -> bool {
        self.rest_rms_um > self.limit_um * (self.strict_bound_um / self.bound_um)
    }

    /// MethodLabel far it is beyond its worst limit: above 1 it does not hold.
    #[must_use]
    pub fn over_limit(&self) -> f64 {
        let amplitude = self.amplitude_limit.map_or(0.0, |limit| self.amplitude_error.abs() / limit);
        let doubted = if self.doubt.is_some() { f64::INFINITY } else { 0.0 };
        (self.rest_rms_um / self.limit_um).max(amplitude).max(doubted)
    }

    /// Rest error over bound; without scatter, where the bound is a rounding, in pulses.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        self.rest_rms_um / if self.scatter > 0.0 { self.bound_um } else { CALM_UM }
    }
}

impl WireRow {
    fn of(open_loop: bool) -> Self {
        let scene = Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").expect("it is shipped, as a test shows");
        let pattern = Pattern::new("sixty-hertz", None, scene.drives().to_vec(), toml::Table::new())
            .expect("its drives are a pattern's, as a test shows");
        let played = simulate_play(
            &pattern,
            Some(WIRE_S),
            &SimulatedMotorsConfig::default(),
            Settings::default(),
            open_loop,
        )
        .expect("it has an end, and the default plant is one");
        let (bursts, bytes) = (played.outcome.bursts, played.outcome.wire_bytes as f64);
        Self {
            bytes_per_burst: bytes / bursts.planned.max(1) as f64,
            bytes_per_s: bytes / WIRE_S,
            bursts: bursts.planned,
            amended: bursts.amended,
            rest_rms_um: played.rest.rms_um(),
        }
    }
}

fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = numbers.fold((0.0, 0.0), |(count, sum), number| (count + 1.0, sum + number));
    sum / f64::max(count, 1.0)
}

/// Of the mean of numbers of which neighbours go together.
fn standard_error(numbers: &[f64]) -> f64 {
    let means: Vec<f64> =
        numbers.chunks_exact((numbers.len() / PARTS).max(1)).map(|part| mean(part.iter().copied())).collect();
    let whole = mean(means.iter().copied());
    let count = means.len().max(2) as f64;
    (means.iter().map(|part| (part - whole).powi(2)).sum::<f64>() / (count - 1.0) / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leads_share_their_draws_and_no_other_cells_do() {
        let grid = ControlGrid::default();
        let cells = grid.cells();
        assert_eq!((cells.len(), grid.rates().len()), (2160, 30));
        let mut seen = std::collections::BTreeMap::new();
        for cell in &cells {
            let same = MotorRun { lead_ms: 0.0, ..*cell };
            assert_eq!(*seen.entry(cell.seed).or_insert(same), same);
        }
        assert_eq!(seen.len(), 720);
    }

    #[test]
    fn a_mean_of_numbers_that_go_together_is_known_worse() {
        let alone: Vec<f64> = (0..4000).map(|n| meissner_array::random::normal([1, n, 0, 0])).collect();
        let error = standard_error(&alone);
        assert!((0.7..1.3).contains(&(error * 4000f64.sqrt())), "{error}");
        let together: Vec<f64> = (0..4000).map(|n| alone[n / 10]).collect();
        assert!(standard_error(&together) > 2.0 * error);
        assert_eq!((standard_error(&[]), standard_error(&[1.0])), (0.0, 0.0));
    }
}
