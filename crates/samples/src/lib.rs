//! Reads samples of displacement from the bytes of NPY, CSV and WAV files.
//!
//! [`read`] takes one column or channel, turns it into µm, and resamples it to [`MOST_HZ`] if its rate is above that. The result says
//! what was done, for the pattern that keeps the samples. The crate opens no file.
//!
//! Invariant: every sample of [`read`] is finite, there are 2 to [`MAX_SAMPLES`], and no bytes make the reader panic or take more memory than 16
//! times their number. Each error is one line.

mod csv_file;
mod error;
mod npy;
mod resample;
pub mod table;
mod wav;

pub use error::SamplesError;

use meissner_input::message::quote;
use table::{LengthUnit, Said, TimeUnit};

/// The most bytes of a file: the paper's 24 motors for 10 minutes at 1 kHz take 55 MiB as `f4`.
pub const MAX_FILE_BYTES: usize = 64 << 20;
/// The most samples that are read from a file: an hour at 1 kHz.
pub const MAX_SAMPLES: usize = (1 << 22) - 2;
/// The highest rate of a pattern's samples, Hz. Motors vibrate up to 300 Hz.
pub const MOST_HZ: f64 = 8000.0;
/// The highest rate of a file, Hz: what a sound card records.
pub const MOST_FILE_HZ: f64 = 192_000.0;

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Column {
    /// Its number, from 0.
    Number(usize),
    /// Its name, in the row of names of a CSV file.
    Name(String),
}

/// What to take from a file, and how to turn it into µm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// The column of an NPY or a CSV file; needed if there are several.
    pub column: Option<Column>,
    /// The channel of a WAV file, from 0; needed if there are several.
    pub channel: Option<usize>,
    /// The rate of the samples, Hz; needed for NPY and CSV. A WAV file has its own.
    pub rate_hz: Option<f64>,
    /// µm for a value of 1; needed for WAV, where 1 is full scale, and where the header of a CSV file names another unit than µm. Without
    /// it, values of NPY and CSV are µm.
    pub scale_um: Option<f64>,
    /// Added to each sample, µm.
    pub offset_um: f64,
}

/// The samples of one column or channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Samples {
    /// Their rate, Hz.
    pub rate_hz: f64,
    /// The displacement, µm.
    pub um: Vec<f32>,
    /// What was read and what was done to it, in one line without the file's name.
    pub note: String,
}

/// What a reader found: values, not yet µm.
struct Found {
    values: Vec<f64>,
    /// The file's own rate, if it has one.
    rate_hz: Option<u32>,
    /// The times of the samples, if a column has them.
    times: Option<Times>,
    /// The unit that its header names, if it names one.
    header: Option<InHeader>,
    note: String,
}

/// What a file's own column of times says.
struct Times {
    column: String,
    unit: Option<TimeUnit>,
    /// The first time, the last one, and the least and the largest step.
    first: f64,
    last: f64,
    steps: [f64; 2],
    count: u32,
}

impl Times {
    const fn new(column: String, unit: Option<TimeUnit>) -> Self {
        Self { column, unit, first: f64::NAN, last: f64::NAN, steps: [f64::INFINITY, 0.0], count: 0 }
    }

    /// With the time of the next sample.
    fn with(mut self, time: f64) -> Self {
        let step = time - self.last;
        // Comparisons with the NaN before the first time are false.
        self.first = if self.count == 0 { time } else { self.first };
        self.steps = [step.min(self.steps[0]), step.max(self.steps[1])];
        (self.last, self.count) = (time, self.count + 1);
        self
    }

    /// Refuses a rate that these times contradict. Times without a unit are in any; those that count by 1 may be numbers of rows.
    fn check(&self, rate_hz: f64) -> Result<(), SamplesError> {
        let [least, largest] = self.steps;
        let span = self.last - self.first;
        let is_even = largest - least <= 0.01 * largest;
        if self.count < 2
            || span.is_nan()
            || span <= 0.0
            || (self.unit.is_none() && is_even && (largest - 1.0).abs() < 0.01)
        {
            return Ok(());
        }
        let wanted_s = f64::from(self.count - 1) / rate_hz;
        let fits = |unit: TimeUnit| {
            // Times that are not even are rounded.
            let rounded = if is_even { 0.0 } else { largest };
            ((span * unit.seconds()) - wanted_s).abs() <= 0.01 * wanted_s + rounded * unit.seconds()
        };
        use TimeUnit::{Microseconds, Milliseconds, Nanoseconds, Seconds};
        let units =
            self.unit.map_or(vec![Seconds, Milliseconds, Microseconds, Nanoseconds], |unit| vec![unit]);
        if units.iter().any(|unit| fits(*unit)) {
            return Ok(());
        }
        // With as many digits as a person reads.
        let own_hz = (f64::from(self.count - 1) / (span * units[0].seconds()) * 1e6).round() / 1e6;
        Err(SamplesError::OtherTimes { column: self.column.clone(), own_hz, given: rate_hz })
    }
}

/// What a header says of a column's unit.
struct InHeader {
    column: String,
    said: Said<LengthUnit>,
}

impl InHeader {
    /// Refuses values that are not in µm.
    fn um(self) -> Result<(), SamplesError> {
        let (column, key) = (self.column, "scale_um");
        match self.said {
            Said::Nothing | Said::Unit(LengthUnit::Micrometres) => Ok(()),
            Said::Unit(unit) => Err(SamplesError::Unit { column, unit, key }),
            Said::Other(unit) => {
                let said = format!("{} of column {column}", quote(&unit));
                Err(SamplesError::OtherUnit { said, key })
            }
        }
    }
}

/// Reads the samples of a file. The end of its name says its format: `.npy`, `.csv` or `.wav`.
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read(name: &str, bytes: &[u8], choice: &Choice) -> Result<Samples, SamplesError> {
    if bytes.len() > MAX_FILE_BYTES {
        return Err(SamplesError::TooLarge { bytes: bytes.len() });
    }
    let end = name.rsplit_once('.').map_or("", |(_, end)| end).to_ascii_lowercase();
    let is_wav = end == "wav";
    for (key, given, other) in [
        ("column", choice.column.is_some() && is_wav, "channel"),
        ("channel", choice.channel.is_some() && !is_wav, "column"),
    ] {
        if given {
            return Err(SamplesError::OtherKey { key, other });
        }
    }
    let Found { values, rate_hz: own_hz, times, header, mut note } = match end.as_str() {
        "npy" => npy::read(bytes, choice.column.as_ref())?,
        "csv" => csv_file::read(bytes, choice.column.as_ref())?,
        "wav" => wav::read(bytes, choice.channel)?,
        _ => return Err(SamplesError::Kind),
    };
    let rate_hz = match (own_hz, choice.rate_hz) {
        (Some(own), Some(given)) if f64::from(own) != given => {
            return Err(SamplesError::OtherRate { own, given });
        }
        (Some(own), _) => f64::from(own),
        (None, Some(given)) => given,
        (None, None) => return Err(SamplesError::NoRate),
    };
    if !(1.0..=MOST_FILE_HZ).contains(&rate_hz) || (rate_hz > MOST_HZ && rate_hz.fract() != 0.0) {
        return Err(SamplesError::Rate { rate_hz });
    }
    times.map_or(Ok(()), |times| times.check(rate_hz))?;
    let scale_um = match choice.scale_um {
        Some(scale_um) if !scale_um.is_finite() => return Err(SamplesError::Scale { scale_um }),
        Some(scale_um) => scale_um,
        None if is_wav => return Err(SamplesError::NoScale),
        None => {
            if let Some(header) = header {
                header.um()?;
                note += " in um";
            }
            1.0
        }
    };
    note += &format!(", {rate_hz} Hz");
    let mut um = Vec::with_capacity(values.len());
    for (number, value) in values.iter().enumerate() {
        #[expect(clippy::cast_possible_truncation, reason = "what is beyond f32 is refused below")]
        let sample = (value * scale_um + choice.offset_um) as f32;
        if !sample.is_finite() {
            #[expect(clippy::cast_precision_loss, reason = "only shown")]
            let at_s = number as f64 / rate_hz;
            return Err(SamplesError::Sample { number, at_s, value: *value });
        }
        um.push(sample);
    }
    drop(values);
    if let Some(scale_um) = choice.scale_um {
        note +=
            &if is_wav { format!(", full scale {scale_um} um") } else { format!(", times {scale_um} um") };
    }
    if choice.offset_um != 0.0 {
        note += &format!(", plus {} um", choice.offset_um);
    }
    let samples = resample::resampled_len(um.len(), rate_hz);
    if !(2..=MAX_SAMPLES).contains(&samples) {
        return Err(SamplesError::Count { samples });
    }
    if rate_hz <= MOST_HZ {
        return Ok(Samples { rate_hz, um, note });
    }
    note += &format!(", resampled to {MOST_HZ} Hz");
    Ok(Samples { rate_hz: MOST_HZ, um: resample::resampled(&um, rate_hz), note })
}

/// Reads all values of an NPY file, row by row, with the numbers of rows and columns. They may be no finite numbers.
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read_table(bytes: &[u8]) -> Result<([usize; 2], Vec<f64>), SamplesError> {
    if bytes.len() > MAX_FILE_BYTES {
        return Err(SamplesError::TooLarge { bytes: bytes.len() });
    }
    npy::read_table(bytes)
}

/// Reads columns of a CSV file by their names. They may hold no finite numbers.
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read_columns<const N: usize>(bytes: &[u8], names: [&str; N]) -> Result<[Vec<f64>; N], SamplesError> {
    if bytes.len() > MAX_FILE_BYTES {
        return Err(SamplesError::TooLarge { bytes: bytes.len() });
    }
    let mut columns = names.map(|_| Vec::new());
    for (values, name) in columns.iter_mut().zip(names) {
        *values = csv_file::read(bytes, Some(&Column::Name(name.to_owned())))?.values;
    }
    Ok(columns)
}

/// The column or channel to take of so many: the one that was asked for, or the only one.
fn only(asked: Option<usize>, count: usize, what: &'static str) -> Result<usize, SamplesError> {
    match asked {
        Some(asked) if asked < count => Ok(asked),
        Some(asked) => Err(SamplesError::NoSuch { what, asked: asked.to_string(), count }),
        None if count == 1 => Ok(0),
        None => Err(SamplesError::Several { what, count }),
    }
}
