//! What makes a recording useless, and the bounds that say so.

use crate::calibrate::fit::FitError;
use meissner_samples::table::TableError;

/// Bytes of a recording at most, also unpacked: five minutes at 25 kHz.
pub const MAX_RECORDING_BYTES: usize = 256 << 20;
/// Samples of a recording at most.
pub const MAX_SAMPLES: usize = 8_000_000;
/// The longest recording, s: the longest plan takes 300 s.
pub const MAX_SECONDS: f64 = 1800.0;
/// Samples of a recording at least.
pub(super) const MIN_SAMPLES: usize = 100;

/// The slowest sampling, s: the pin rests for 118 ms between two bursts.
pub(super) const SLOWEST_S: f64 = 0.005;
/// The correlation of steps and plan below which the recording is of something else. A motor with 10 % scatter has 0.995, with
/// 45 % 0.91; the same bursts in another order have 0.85.
pub(super) const LEAST_CORRELATION: f64 = 0.9;
/// The largest clock error of the sensor, ppm: twenty times that of a bad quartz.
pub const MAX_CLOCK_PPM: f64 = 1000.0;
/// The largest plausible scatter of a motor, as for telemetry.
pub(super) const MOST_SCATTER: f64 = 0.35;

/// A file that is no recording.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum RecordingError {
    #[error(transparent)]
    Table(#[from] TableError),
    #[error("line {line}: has {found} cells, other rows have {wanted}: complete the row, or delete it")]
    Columns { line: u64, found: usize, wanted: usize },
    #[error("line {line}: the {column} is {text}, not a number: correct the row, or delete it")]
    NotANumber { line: u64, column: &'static str, text: String },
    #[error(
        "line {line}: the time {seconds} s is not after the one before, {before} s: times must increase; if they are rounded, \
         give --rate-hz, or name another column with --time-column"
    )]
    Order { line: u64, seconds: f64, before: f64 },
    #[error("has several columns that may be the {what}: {columns}; name one with {option}")]
    Several { what: &'static str, columns: String, option: &'static str },
    #[error("{option}: no column is called {text}: there are {columns}")]
    NoColumn { option: &'static str, text: String, columns: String },
    #[error("has no column of times: give --rate-hz, or name the column with --time-column")]
    NoTime,
    #[error("has no column of displacements: name it with --column")]
    NoDisplacement,
    #[error("does not say the unit of the displacement: give --displacement-unit")]
    NoUnit,
    #[error(
        "the {what} in column {column} has the unit {unit}, which is not read: name another column, or give {option}"
    )]
    Unit { what: &'static str, column: String, unit: String, option: &'static str },
    #[error("--rate-hz is {rate_hz}: must be 1 to 10000000")]
    Rate { rate_hz: f64 },
    #[error("has {found} samples: must be at least {MIN_SAMPLES}")]
    TooFew { found: usize },
    #[error("has more than {MAX_SAMPLES} samples: record at a lower rate, or cut the file")]
    TooMany,
    #[error(
        "lasts {seconds:.0} s: at most {MAX_SECONDS} s can be read; check the unit of the time, or cut the file"
    )]
    TooLong { seconds: f64 },
}

/// A recording that gives no calibration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum LaserError {
    #[error(
        "one sample each {:.1} ms is too slow to see a burst: record at {:.0} samples per second or more",
        .step_s * 1000.0, 1.0 / SLOWEST_S
    )]
    TooSlow { step_s: f64 },
    #[error(
        "the sensor is clipped at {um:.2} um, in {runs} places: set its range so that the whole travel fits, and record again"
    )]
    Clipped { um: f64, runs: usize },
    #[error(
        "the pin moves by {um:.3} um where the bursts would move it by {expected_um:.1} um: check that the sensor points at \
         motor {motor}'s pin, and the unit of the displacement"
    )]
    Still { motor: u8, um: f64, expected_um: f64 },
    #[error(
        "the recording does not follow the plan's bursts (correlation {correlation:.2}, {LEAST_CORRELATION} is needed): check \
         that it was made during this plan, of motor {motor}'s pin, and the unit of the time"
    )]
    Unrelated { motor: u8, correlation: f64 },
    #[error(
        "it covers {covered} of {planned} bursts: record from before the first burst until after the last"
    )]
    TooFew { covered: usize, planned: usize },
    #[error(
        "the sensor's clock differs by {ppm:.0} ppm from the device's, which is more than {MAX_CLOCK_PPM}: check the unit \
         of the time and the sampling rate"
    )]
    Clock { ppm: f64 },
    #[error(
        "bursts {} scatter by {:.0} %, which no motor does (at most {:.0} %): check that nothing touches the pin or the \
         sensor, and record again", if *.up { "upwards" } else { "downwards" }, .scatter * 100.0, MOST_SCATTER * 100.0
    )]
    Scatter { up: bool, scatter: f64 },
    #[error(transparent)]
    Fit(#[from] FitError),
    #[error("no burst that counts was measured: record the whole plan")]
    Nothing,
}
