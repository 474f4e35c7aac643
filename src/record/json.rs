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
    use crate::record::{CommandEntry, Entry, Peer};
    use meissner_api::{DeviceInfo, Event, Receipt, Terms};
    use serde_json::{Value, json};

    const ODD: &str = "µm \"\\ x\n\u{1b}[2J\u{7f}\u{9b}\u{2028}\u{202e}\u{feff}\u{e0041}";

    fn line(value: &impl Serialize) -> String {
        let mut line = Vec::new();
        write(&mut line, value).unwrap();
        String::from_utf8(line).unwrap()
    }

    fn texts(value: &Value) -> Vec<&str> {
        match value {
            Value::String(text) => vec![text],
            Value::Array(items) => items.iter().flat_map(texts).collect(),
            Value::Object(keys) => {
                keys.iter().flat_map(|(key, value)| [&**key].into_iter().chain(texts(value))).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Tests every text of every entry that a client, a file or a device can choose.
    #[test]
    fn every_text_of_an_entry_is_plain_and_reads_back() {
        let odd = || ODD.to_owned();
        let mut command = CommandEntry::new("play", Peer::local(1, 0));
        command.set_arguments(json!({"pattern": ODD, ODD: [ODD]}));
        command.answer = odd();
        let (simulated, telemetry) = (true, true);
        let device = DeviceInfo {
            kind: odd(),
            firmware: odd(),
            build: odd(),
            boot: 1,
            simulated,
            telemetry,
            trigger_input: false,
        };
        let mut receipt = Receipt::new(ODD, ODD, 1, &Terms::default());
        receipt.cause = Some(odd().into());
        let events = [
            (Event::Connected { device }, 3),
            (Event::Disconnected { reason: odd().into() }, 1),
            (Event::Queued { id: 1, name: odd(), ordered_ms: None }, 1),
            (Event::Ended { receipt: Box::new(receipt) }, 3),
            (Event::Calibrated { id: 1, motors: vec![1], problem: Some(odd()) }, 1),
        ];
        let notes = [
            (Entry::Command(command), 4),
            (Entry::DaemonStarted { version: "1", pid: 1, wanted: odd() }, 1),
            (Entry::DaemonEnded { problem: Some(odd()) }, 1),
        ];
        let events = events.into_iter().map(|(event, odd)| (Entry::of(&event, None).unwrap(), odd));
        for (entry, count) in events.chain(notes) {
            let line = line(&entry);
            assert!(line.chars().all(is_plain), "{line:?}");
            let value: Value = serde_json::from_str(&line).unwrap();
            assert_eq!(texts(&value).into_iter().filter(|&text| text == ODD).count(), count, "{line}");
        }
    }
}
