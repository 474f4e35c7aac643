//! Writes JSON whose texts hold only plain characters. All others become `\\u` escapes, so that a line is safe to show on a
//! terminal.
//!
//! Invariant: a reader gets the text as it was.

use meissner_input::message::is_plain;
use serde::Serialize;
use serde_json::ser::Formatter;
use std::io::{self, Write};

/// Writes a value.
///
/// # Errors
/// If it cannot be serialized or written.
pub(crate) fn write(to: impl Write, value: &impl Serialize) -> io::Result<()> {
    Ok(value.serialize(&mut serde_json::Serializer::with_formatter(to, Plain))?)
}

struct Plain;

impl Formatter for Plain {
    fn write_string_fragment<W: ?Sized + Write>(&mut self, to: &mut W, text: &str) -> io::Result<()> {
        for piece in text.split_inclusive(|c| !is_plain(c)) {
            let plain = piece.trim_end_matches(|c| !is_plain(c));
            to.write_all(plain.as_bytes())?;
            for unit in piece[plain.len()..].encode_utf16() {
                write!(to, "\\u{unit:04x}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn every_text_is_plain_and_reads_back() {
        const ODD: &str = "µm \"\\ x\n\u{1b}[2J\u{7f}\u{9b}\u{2028}\u{202e}\u{feff}\u{e0041}";
        let value = json!({ODD: [ODD, {"key": ODD}]});
        let mut line = Vec::new();
        write(&mut line, &value).unwrap();
        let line = String::from_utf8(line).unwrap();
        assert!(line.chars().all(is_plain), "{line:?}");
        assert_eq!(serde_json::from_str::<Value>(&line).unwrap(), value);
    }
}
