//! Reads a channel of a WAV file: PCM of 8 to 32 bits, or 32-bit floating point. Full scale is 1.

use crate::error::SamplesError;
use crate::{Found, only};
use hound::{SampleFormat, WavReader, WavSpec};
use meissner_input::message::cut;

pub(crate) fn read(bytes: &[u8], channel: Option<usize>) -> Result<Found, SamplesError> {
    let mut file = WavReader::new(bytes).map_err(format)?;
    let WavSpec { channels, sample_rate, bits_per_sample, sample_format } = file.spec();
    let channels = usize::from(channels);
    let channel = only(channel, channels, "channel")?;
    let wanted = file.duration() as usize;
    // Samples take at least a byte, whatever the header says.
    let mut values = Vec::with_capacity(wanted.min(bytes.len() / channels));
    let truncated = |found| SamplesError::Truncated { found, wanted, what: "samples" };
    match sample_format {
        SampleFormat::Int => {
            let full = f64::from(1_u32 << (bits_per_sample - 1).min(31));
            for sample in file.samples::<i32>().skip(channel).step_by(channels) {
                values
                    .push(f64::from(sample.map_err(|error| ended(error, &truncated, values.len()))?) / full);
            }
        }
        SampleFormat::Float => {
            for sample in file.samples::<f32>().skip(channel).step_by(channels) {
                values.push(sample.map_err(|error| ended(error, &truncated, values.len()))?.into());
            }
        }
    }
    if values.len() < wanted {
        return Err(truncated(values.len()));
    }
    let kind = if sample_format == SampleFormat::Int { "bit" } else { "bit float" };
    let place = if channels == 1 { String::new() } else { format!(", channel {channel} of {channels}") };
    let note = format!("WAV {bits_per_sample} {kind}{place}");
    Ok(Found { values, rate_hz: Some(sample_rate), header: None, note })
}

fn format(error: hound::Error) -> SamplesError {
    SamplesError::Format { kind: "a WAV", message: cut(&error.to_string(), 200) }
}

/// The error of a sample that cannot be read: mostly the file is too short.
fn ended(error: hound::Error, truncated: &impl Fn(usize) -> SamplesError, found: usize) -> SamplesError {
    if matches!(error, hound::Error::IoError(_)) { truncated(found) } else { format(error) }
}
