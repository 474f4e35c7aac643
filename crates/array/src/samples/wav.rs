//! Reads a channel of a WAV file: PCM of 8 to 32 bits, or floating point of 32 or 64 bits, by a plain or an extensible header. Full
//! scale is 1. (`hound` reads no 64-bit floating point, which SciPy writes, and no PCM of 12 or 20 bits.)

use super::error::SamplesError;
use super::found::{Found, only};

const PCM: u16 = 1;
const FLOAT: u16 = 3;
const EXTENSIBLE: u16 = 0xFFFE;

pub(super) fn read(bytes: &[u8], channel: Option<usize>) -> Result<Found, SamplesError> {
    let (format, data, length) = chunks(bytes).ok_or_else(|| other("it has no samples"))?;
    let word = |at: usize| format.get(at..at + 2).map(|two| u16::from_le_bytes([two[0], two[1]]));
    let header = || {
        // An extensible header has the kind as the first word of its GUID.
        let kind = word(0).filter(|kind| *kind != EXTENSIBLE).or_else(|| word(24))?;
        let rate_hz = u32::from(word(4)?) | (u32::from(word(6)?) << 16);
        Some((kind, usize::from(word(2)?), rate_hz, usize::from(word(12)?), word(14)?))
    };
    let (kind, channels, rate_hz, block, bits) = header().ok_or_else(|| other("its header is too short"))?;
    let bytes_each = block.checked_div(channels).unwrap_or(0);
    let fits = match kind {
        PCM => (1..=4).contains(&bytes_each),
        FLOAT => matches!(bytes_each, 4 | 8),
        _ => false,
    };
    if !fits || bytes_each * channels != block || usize::from(bits).div_ceil(8) > bytes_each {
        let message = format!("kind {kind} of {bits} bits: save it as PCM of 8 to 32 bits, or as float");
        return Err(other(&message));
    }
    let channel = only(channel, channels, "channel")?;
    let (found, wanted) = (data.len() / block, length / block);
    if found < wanted {
        return Err(SamplesError::Truncated { found, wanted, what: "samples" });
    }
    let sample = |frame: &[u8]| {
        let mut whole = [0; 8];
        let own = &frame[channel * bytes_each..][..bytes_each];
        // At the upper end, where the sign is.
        whole[8 - bytes_each..].copy_from_slice(own);
        match (kind, bytes_each) {
            (FLOAT, 4) => f64::from(f32::from_le_bytes([own[0], own[1], own[2], own[3]])),
            (FLOAT, _) => f64::from_le_bytes(whole),
            // 8-bit samples have no sign.
            (_, 1) => f64::from(i16::from(own[0]) - 128) / 128.0,
            _ => {
                f64::from(i32::from_le_bytes([whole[4], whole[5], whole[6], whole[7]])) / -f64::from(i32::MIN)
            }
        }
    };
    let values = data.chunks_exact(block).map(sample).collect();
    let kind = if kind == PCM { "bit" } else { "bit float" };
    let place = if channels == 1 { String::new() } else { format!(", channel {channel} of {channels}") };
    let note = format!("WAV {bits} {kind}{place}");
    Ok(Found { values, rate_hz: Some(rate_hz.into()), note })
}

/// The format chunk, what there is of the samples, and how many bytes of them the header promises.
fn chunks(bytes: &[u8]) -> Option<(&[u8], &[u8], usize)> {
    let mut rest = bytes.strip_prefix(b"RIFF")?.get(4..)?.strip_prefix(b"WAVE")?;
    let mut format = None;
    loop {
        let (head, after) = rest.split_at_checked(8)?;
        let length = u32::from_le_bytes([head[4], head[5], head[6], head[7]]) as usize;
        let own = &after[..length.min(after.len())];
        match (&head[..4], format) {
            (b"fmt ", _) => format = Some(own),
            (b"data", Some(format)) => return Some((format, own, length)),
            _ => {}
        }
        // Chunks begin at even places.
        rest = after.get(length + length % 2..)?;
    }
}

fn other(message: &str) -> SamplesError {
    SamplesError::Format { kind: "a WAV", message: message.to_owned() }
}
