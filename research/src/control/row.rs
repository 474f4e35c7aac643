//! Measures one cell of the grid.

use crate::mean;
use meissner_api::SensorFault;
use meissner_array::motor::MotorError;
use meissner_stream::{MotorRun, Period, rest_bound_um};
use serde::Serialize;

/// The largest ratio of rest error to bound, for a scatter up to [`SCATTER`].
const RATIO: f64 = 1.2;
const SCATTER: f64 = 0.1;
/// The largest ratio for more scatter, because the controller must first learn an unexpected scatter.
const LARGE_RATIO: f64 = 1.5;
/// The largest relative error of the mean amplitude; half a pulse is allowed, too.
const AMPLITUDE: f64 = 0.01;
/// The amplitude has a limit only if half a period has at least this many burst lengths; otherwise longer bursts do not fit.
const ROOM: f64 = 1.3;
/// An excess of fewer standard errors may be chance: one cell in a hundred has it.
const CHANCE: f64 = 2.5;
/// The standard error is computed from the means of this many parts, because neighbouring errors are correlated.
const PARTS: usize = 40;

/// A cell and its figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ControlRow {
    /// The settings of the cell.
    #[serde(flatten)]
    pub run: MotorRun,
    /// Time from the newest sample that a burst can use to the burst, ms.
    pub delay_ms: f64,
    /// The number of counted periods: those of the first 2 s, or ten delays, are left out.
    pub periods: usize,
    /// The planned amplitude: as much as fits, µm.
    pub planned_um: f64,
    /// Half a period, in burst lengths.
    pub room: f64,
    /// The true rest error, RMS, µm.
    pub rest_rms_um: f64,
    /// The least possible rest error at `delay_ms` and the planned amplitude, µm.
    pub bound_um: f64,
    /// The limit of [`Self::rest_rms_um`].
    pub limit_um: f64,
    /// The relative error of the mean amplitude: top minus the mean of the rests beside it.
    pub amplitude_error: f64,
    /// Its relative standard error.
    pub amplitude_se: f64,
    /// Its limit; none if longer bursts do not fit.
    pub amplitude_limit: Option<f64>,
    /// The share of corrected bursts.
    pub corrected_share: f64,
    /// The sensor fault that the controller found. The telemetry is sound, so it should find none.
    pub doubt: Option<SensorFault>,
    /// Whether the cell is within its limits.
    pub verdict: Verdict,
}

/// Whether a cell is within its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Within all limits.
    Holds,
    /// The amplitude is beyond its limit by less than 2.5 standard errors, which may be chance.
    Chance,
    /// Beyond a limit.
    Misses,
}

impl ControlRow {
    pub(super) fn of(run: &MotorRun, seconds: f64) -> Result<Self, MotorError> {
        let delay_ms = run.delay_ms();
        let (rate, um_per_pulse) = (run.array.rate(), run.array.motor().um_per_pulse);
        let skipped = rate.seconds_in_ticks(2f64.max(10.0 * delay_ms / 1000.0));
        let mut periods: Vec<Period> = Vec::new();
        let keep = |period: &Period| {
            if period.up as f64 >= skipped {
                periods.push(*period);
            }
        };
        let doubt = run.run(seconds, |_, y| Some(y), keep)?;
        let planned_um = mean(periods.iter().map(|period| period.planned_um));
        let half_period_um = f64::from(rate.hz()) / 2.0 / run.frequency_hz * um_per_pulse;
        let room = half_period_um / planned_um;
        let rest_rms_um = mean(periods.iter().map(|period| period.rest_um.powi(2))).sqrt();
        let bound_um =
            rest_bound_um(run.array, run.frequency_hz, planned_um, run.scatter, delay_ms, run.telemetry_hz);
        let limit_um = match run.scatter {
            0.0 => calm_um(run),
            ..=SCATTER => RATIO * bound_um,
            _ => LARGE_RATIO * bound_um,
        };
        let errors: Vec<f64> = periods
            .windows(2)
            .map(|two| two[1].top_um - (two[0].rest_um + two[1].rest_um) / 2.0 - two[1].planned_um)
            .map(|um| um / planned_um)
            .collect();
        let (amplitude_error, amplitude_se) = (mean(errors.iter().copied()), standard_error(&errors));
        let amplitude_limit = (room >= ROOM).then(|| AMPLITUDE.max(um_per_pulse / 2.0 / planned_um));
        let beyond = amplitude_limit.map_or(0.0, |limit| amplitude_error.abs() - limit);
        let verdict = if doubt.is_some() || rest_rms_um > limit_um || beyond > CHANCE * amplitude_se {
            Verdict::Misses
        } else if beyond > 0.0 {
            Verdict::Chance
        } else {
            Verdict::Holds
        };
        let corrected = periods.iter().flat_map(|period| {
            period.pulses.map(|pulses| f64::from(pulses) * um_per_pulse - period.planned_um)
        });
        let corrected_share = mean(corrected.map(|um| f64::from(um.abs() > um_per_pulse / 2.0)));
        Ok(Self {
            run: *run,
            delay_ms,
            periods: periods.len(),
            planned_um,
            room,
            rest_rms_um,
            bound_um,
            limit_um,
            amplitude_error,
            amplitude_se,
            amplitude_limit,
            corrected_share,
            doubt,
            verdict,
        })
    }

    /// The settings apart from the lead.
    pub(super) fn cell(&self) -> MotorRun {
        MotorRun { lead_ms: 0.0, ..self.run }
    }

    /// The excess of the amplitude's error over its limit and over chance.
    pub(super) fn amplitude_beyond(&self) -> f64 {
        self.amplitude_limit
            .map_or(0.0, |limit| self.amplitude_error.abs() - limit - CHANCE * self.amplitude_se)
    }

    /// The largest ratio of an error to its limit; above 1 the cell misses.
    #[must_use]
    pub fn over_limit(&self) -> f64 {
        let amplitude = self.amplitude_limit.map_or(0.0, |limit| self.amplitude_error.abs() / limit);
        let fault = if self.doubt.is_some() { f64::INFINITY } else { 0.0 };
        (self.rest_rms_um / self.limit_um).max(amplitude).max(fault)
    }

    /// Rest error over bound; without scatter, in pulses.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        self.rest_rms_um / if self.run.scatter > 0.0 { self.bound_um } else { calm_um(&self.run) }
    }
}

/// The largest rest error of a run without scatter, µm: a pulse, because pulse counts are rounded.
pub(super) fn calm_um(run: &MotorRun) -> f64 {
    run.array.motor().um_per_pulse
}

/// The standard error of the mean of numbers whose neighbours are correlated.
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
    fn correlated_numbers_have_a_larger_standard_error() {
        let independent: Vec<f64> = (0..4000).map(|n| meissner_array::random::normal([1, n, 0, 0])).collect();
        let error = standard_error(&independent);
        assert!((0.7..1.3).contains(&(error * 4000f64.sqrt())), "{error}");
        let correlated: Vec<f64> = (0..4000).map(|n| independent[n / 10]).collect();
        assert!(standard_error(&correlated) > 2.0 * error);
        assert_eq!((standard_error(&[]), standard_error(&[1.0])), (0.0, 0.0));
    }
}
