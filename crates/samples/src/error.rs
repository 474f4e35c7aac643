//! Why a file's samples cannot be used.

use crate::table::LengthUnit;
use crate::{MAX_FILE_BYTES, MAX_SAMPLES, MOST_FILE_HZ, MOST_HZ};

/// What is wrong with a file, or with the choice of what to take from it. The message is one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum SamplesError {
    #[error("{bytes} bytes are too many: a sample file has at most {MAX_FILE_BYTES}")]
    TooLarge { bytes: usize },
    #[error("the name must end in .npy, .csv or .wav")]
    Kind,
    #[error("`{key}` is for other files: use `{other}`")]
    OtherKey { key: &'static str, other: &'static str },
    #[error("{count} {what}s: add {what} = 0 to {}", count.saturating_sub(1))]
    Several { what: &'static str, count: usize },
    #[error("no {what} {asked}: {count} {what}(s), counted from 0")]
    NoSuch { what: &'static str, asked: String, count: usize },
    #[error("no column named {name}: the names above the numbers are {names}")]
    NoName { name: String, names: String },
    #[error("several columns are named {name}: give the number, from 0")]
    SameNames { name: String },
    #[error(
        "{names} names stand above {columns} columns of numbers: correct the names; if commas are decimal marks, put semicolons between the \
         columns"
    )]
    Names { names: usize, columns: usize },
    #[error("columns of an NPY file have no names: give the number, from 0")]
    Unnamed,
    #[error("add rate_hz: the file does not say the rate of its samples")]
    NoRate,
    #[error("rate_hz is {given}, but the file says {own} Hz: leave rate_hz out")]
    OtherRate { own: u32, given: f64 },
    #[error(
        "rate_hz is {given}, but the times of column {column} say {own_hz} Hz: correct the one or the other"
    )]
    OtherTimes { column: String, own_hz: f64, given: f64 },
    #[error(
        "rate_hz is {rate_hz}: must be 1 to {MOST_FILE_HZ} Hz, and a whole number above {MOST_HZ} (it is resampled to {MOST_HZ} Hz)"
    )]
    Rate { rate_hz: f64 },
    #[error("add scale_um: the displacement of full scale, um")]
    NoScale,
    #[error("scale_um is {scale_um}: must be a number")]
    Scale { scale_um: f64 },
    #[error("sample {number} at {at_s} s is {value}: must be a number")]
    Sample { number: usize, at_s: f64, value: f64 },
    #[error(transparent)]
    Table(#[from] crate::table::TableError),
    #[error("line {line}: {found} is not a number")]
    NotANumber { line: u64, found: String },
    #[error("line {line} has {found} cells, other rows have {wanted}: complete the row, or delete it")]
    Cells { line: u64, found: usize, wanted: usize },
    #[error(
        "line {line}: {cell} stands in a row above the numbers that is not like theirs: correct the row, or delete it"
    )]
    Above { line: u64, cell: String },
    #[error("line {line} has no value, and each row is a sample: delete it, or write the missing value")]
    EmptyRow { line: u64 },
    #[error(
        "the header says that column {column} is in {}, not um: add {key} = {}, or 1 if the values are um",
        .unit.symbol(), .unit.um()
    )]
    Unit { column: String, unit: LengthUnit, key: &'static str },
    #[error("the header says {said}, which is no unit of length: add {key}, the um of a value of 1")]
    OtherUnit { said: String, key: &'static str },
    #[error("{samples} samples: must be 2 to {MAX_SAMPLES}")]
    Count { samples: usize },
    #[error("not {kind} file: {message}")]
    Format { kind: &'static str, message: String },
    #[error("truncated: it ends after {found} of {wanted} {what}")]
    Truncated { found: usize, wanted: usize, what: &'static str },
    #[error("the array holds {found}: save it as float32, float64, int16 or int32 with numpy.save")]
    Type { found: String },
    #[error("the array has the shape {shape}: must be (samples,) or (samples, columns)")]
    Shape { shape: String },
}

impl SamplesError {
    /// The same for a file in which another key than `scale_um` is the µm of a value of 1.
    #[must_use]
    pub fn scaled_by(mut self, other: &'static str) -> Self {
        if let Self::Unit { key, .. } | Self::OtherUnit { key, .. } = &mut self {
            *key = other;
        }
        self
    }
}
