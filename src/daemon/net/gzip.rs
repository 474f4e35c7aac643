//! Compresses answers for clients that accept gzip.
//!
//! Invariant: other clients have their turn between two parts of a long text.

use axum::http::HeaderMap;
use axum::http::header::ACCEPT_ENCODING;
pub(in crate::daemon) use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{self, Write};

/// What is compressed at once, bytes: less than a millisecond.
const PART: usize = 16 << 10;

/// Whether a client with these headers accepts gzip.
pub(in crate::daemon) fn is_accepted(headers: &HeaderMap) -> bool {
    let values = headers.get_all(ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|coding| {
        let (name, weight) = coding.split_once(';').unwrap_or((coding, ""));
        let weight = weight.trim().strip_prefix("q=").and_then(|q| q.parse::<f64>().ok());
        name.trim().eq_ignore_ascii_case("gzip") && weight != Some(0.0)
    })
}

/// The text in gzip's format.
pub(in crate::daemon) async fn compress(text: &[u8], level: Compression) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::with_capacity(text.len() / 4), level);
    for part in text.chunks(PART) {
        encoder.write_all(part)?;
        tokio::task::yield_now().await;
    }
    encoder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_accepted_by_name_and_unless_its_weight_is_0() {
        let accepts = |value: &'static str| {
            is_accepted(&HeaderMap::from_iter([(ACCEPT_ENCODING, value.try_into().unwrap())]))
        };
        for value in ["gzip", "deflate, gzip;q=0.5, br", "br,GZIP"] {
            assert!(accepts(value), "{value}");
        }
        for value in ["", "identity", "br", "gzip;q=0", "gzip; q=0.0", "x-gzip"] {
            assert!(!accepts(value), "{value}");
        }
        assert!(!is_accepted(&HeaderMap::new()));
    }
}
