//! Samples of displacement from the bytes of NPY, CSV and WAV files.
//!
//! [`read`] takes one column or channel, turns it into µm, and resamples it to [`MOST_HZ`] if its rate is above that. The result says
//! what was done, for the pattern that keeps the samples. The readers open no file.
//!
//! Invariant: every sample of [`read`] is finite, there are 2 to [`MAX_SAMPLES`], and no bytes make a reader panic or take more memory than 16
//! times their number. Each error is one line.

mod csv_file;
mod error;
mod found;
mod npy;
mod resample;
mod wav;

pub use error::{MAX_FILE_BYTES, MAX_SAMPLES, MOST_FILE_HZ, MOST_HZ, SamplesError};
pub use found::Column;

use found::Found;

/// What to take from a file, and how to turn it into µm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// The column of an NPY or a CSV file; needed if there are several.
    pub column: Option<Column>,
    /// The channel of a WAV file, from 0; needed if there are several.
    pub channel: Option<usize>,
    /// The rate of the samples, Hz; needed for NPY. WAV and CSV files say their own.
    pub rate_hz: Option<f64>,
    /// µm for a value of 1; needed for WAV, where 1 is full scale. Without it, values of NPY are µm. A CSV file says its unit.
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

/// What a file is, by the end of its name.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Npy,
    Csv,
    Wav,
}

impl Kind {
    fn of(name: &str, bytes: &[u8]) -> Result<Self, SamplesError> {
        check_size(bytes)?;
        match name.rsplit_once('.').map_or("", |(_, end)| end).to_ascii_lowercase().as_str() {
            "npy" => Ok(Self::Npy),
            "csv" => Ok(Self::Csv),
            "wav" => Ok(Self::Wav),
            _ => Err(SamplesError::Kind),
        }
    }
}

fn check_size(bytes: &[u8]) -> Result<(), SamplesError> {
    if bytes.len() > MAX_FILE_BYTES { Err(SamplesError::TooLarge { bytes: bytes.len() }) } else { Ok(()) }
}

/// Reads the samples of a file. The end of its name says its format: `.npy`, `.csv` or `.wav`.
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read(name: &str, bytes: &[u8], choice: &Choice) -> Result<Samples, SamplesError> {
    let kind = Kind::of(name, bytes)?;
    for (key, given, other) in [
        ("column", choice.column.is_some() && kind == Kind::Wav, "channel"),
        ("channel", choice.channel.is_some() && kind != Kind::Wav, "column"),
    ] {
        if given {
            return Err(SamplesError::OtherKey { key, other });
        }
    }
    if kind == Kind::Csv && choice.scale_um.is_some() {
        return Err(SamplesError::OwnUnit);
    }
    let Found { values, rate_hz: own_hz, mut note } = match kind {
        Kind::Npy => npy::read(bytes, choice.column.as_ref())?,
        Kind::Csv => csv_file::read(bytes, choice.column.as_ref())?,
        Kind::Wav => wav::read(bytes, choice.channel)?,
    };
    let rate_hz = match (own_hz, choice.rate_hz) {
        (Some(own), Some(given)) if own != given => return Err(SamplesError::OtherRate { own, given }),
        (Some(own), _) => own,
        (None, Some(given)) => given,
        (None, None) => return Err(SamplesError::NoRate),
    };
    if !(1.0..=MOST_FILE_HZ).contains(&rate_hz) || (rate_hz > MOST_HZ && rate_hz.fract() != 0.0) {
        return Err(SamplesError::Rate { rate_hz });
    }
    let scale_um = match choice.scale_um {
        Some(scale_um) if !scale_um.is_finite() => return Err(SamplesError::Scale { scale_um }),
        None if kind == Kind::Wav => return Err(SamplesError::NoScale),
        scale_um => scale_um.unwrap_or(1.0),
    };
    note += &format!(", {rate_hz} Hz");
    let um = scaled(values, rate_hz, scale_um, choice.offset_um)?;
    if choice.scale_um.is_some() {
        note += &match kind {
            Kind::Wav => format!(", full scale {scale_um} um"),
            _ => format!(", times {scale_um} um"),
        };
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

/// Reads the heights of a profile, µm, from a column of an NPY or CSV file; `scale_um`: the µm of a value of 1, as of [`Choice`].
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read_profile(
    name: &str,
    bytes: &[u8],
    column: Option<&Column>,
    scale_um: Option<f64>,
) -> Result<Vec<f32>, SamplesError> {
    let found = match Kind::of(name, bytes)? {
        Kind::Npy => npy::read(bytes, column)?,
        Kind::Csv if scale_um.is_some() => return Err(SamplesError::OwnUnit),
        Kind::Csv => csv_file::read_profile(bytes, column)?,
        Kind::Wav => return Err(SamplesError::NoProfile),
    };
    let um = scaled(found.values, 1.0, scale_um.unwrap_or(1.0), 0.0)?;
    if (2..=MAX_SAMPLES).contains(&um.len()) {
        Ok(um)
    } else {
        Err(SamplesError::Count { samples: um.len() })
    }
}

/// Values in µm; fails at the first that is no number.
fn scaled(values: Vec<f64>, rate_hz: f64, scale_um: f64, offset_um: f64) -> Result<Vec<f32>, SamplesError> {
    let mut um = Vec::with_capacity(values.len());
    for (number, value) in values.into_iter().enumerate() {
        let sample = (value * scale_um + offset_um) as f32;
        if !sample.is_finite() {
            let at_s = number as f64 / rate_hz;
            return Err(SamplesError::Sample { number, at_s, value });
        }
        um.push(sample);
    }
    Ok(um)
}

/// Reads all values of an NPY file, row by row, with the numbers of rows and columns. They may be no finite numbers.
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read_table(bytes: &[u8]) -> Result<([usize; 2], Vec<f64>), SamplesError> {
    check_size(bytes)?;
    npy::read_table(bytes)
}

/// Reads columns of a CSV file by their names. They may hold no finite numbers.
///
/// # Errors
/// The first thing that is wrong, in one line without the file's name.
pub fn read_columns<const N: usize>(bytes: &[u8], names: [&str; N]) -> Result<[Vec<f64>; N], SamplesError> {
    check_size(bytes)?;
    csv_file::read_columns(bytes, names)
}
