//! Why a file's samples cannot be used.

/// The most bytes of a file: the paper's 24 motors for 10 minutes at 1 kHz take 55 MiB as `f4`.
pub const MAX_FILE_BYTES: usize = 64 << 20;
/// The most samples that are read from a file: an hour at 1 kHz.
pub const MAX_SAMPLES: usize = (1 << 22) - 2;
/// The highest rate of a pattern's samples, Hz. Motors vibrate up to 300 Hz.
pub const MOST_HZ: f64 = 8000.0;
/// The highest rate of a file, Hz: what a sound card records.
pub const MOST_FILE_HZ: f64 = 192_000.0;

/// What is wrong with a file, or with the choice of what to take from it. The message is one line.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum SamplesError {
    #[error("{bytes} bytes are too many: a sample file has at most {MAX_FILE_BYTES}")]
    TooLarge { bytes: usize },
    #[error("the name must end in .npy, .csv or .wav")]
    Kind,
    #[error("a recording of sound is no profile: name an NPY or a CSV file")]
    NoProfile,
    #[error("`{key}` is for other files: use `{other}`")]
    OtherKey { key: &'static str, other: &'static str },
    #[error("the name of a CSV file's column says its unit: leave the scale out")]
    OwnUnit,
    #[error("{count} {what}s: add {what} = 0 to {}", count.saturating_sub(1))]
    Several { what: &'static str, count: usize },
    #[error("no {what} {asked}: {count} {what}(s), counted from 0")]
    NoSuch { what: &'static str, asked: String, count: usize },
    #[error("add column = and the name of one, in quotes: there are {names}")]
    NoName { names: String },
    #[error("columns of an NPY file have no names: give the number, from 0")]
    Unnamed,
    #[error("add rate_hz: the file does not say the rate of its samples")]
    NoRate,
    #[error("rate_hz is {given}, but the file says {own} Hz: leave rate_hz out")]
    OtherRate { own: f64, given: f64 },
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
    #[error(
        "line {line}: {found}; a CSV file begins with names such as time_s,height_um, and has numbers with decimal points between \
         commas: `pandas` reads any other and writes this one, see docs/stimuli.md"
    )]
    Csv { line: u64, found: String },
    #[error(
        "line {line} is at {found} s, the row before at {before} s, which is not the same step as between the others: \
         samples must be evenly spaced"
    )]
    Uneven { line: u64, before: f64, found: f64 },
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
