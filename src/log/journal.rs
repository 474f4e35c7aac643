//! journald's native protocol: a line is one datagram of named fields.
//!
//! The fields are `MESSAGE`, `PRIORITY`, `SYSLOG_IDENTIFIER`, `TARGET`, and each field of the event in capitals: `play_id` is
//! `PLAY_ID`. Spans are ignored. The usual crate for this sends on a blocking socket, so a stuck journald would delay an emergency
//! stop.
//!
//! Invariants: sending never blocks; a line that journald does not accept is lost; a value holds no line break.

use meissner_input::message::Escaping;
use std::fmt::{self, Write};
use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// Most bytes of a field's value: a datagram that is too large would be lost whole.
const MAX_VALUE: usize = 8 << 10;
/// Most bytes of a field's name: journald's limit.
const MAX_NAME: usize = 64;

/// A layer that sends events to journald.
#[derive(Debug)]
pub(super) struct Journal {
    socket: UnixDatagram,
    /// The path is resolved for each line, because journald may restart.
    path: PathBuf,
}

impl Journal {
    /// Sends to the socket at `path`, which must exist.
    pub(super) fn new(path: &Path) -> io::Result<Self> {
        path.metadata()?;
        let socket = UnixDatagram::unbound()?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, path: path.to_owned() })
    }
}

impl<S: Subscriber> Layer<S> for Journal {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut line = Line::default();
        line.field("PRIORITY", priority(*event.metadata().level()));
        line.field("SYSLOG_IDENTIFIER", "meissner");
        line.field("TARGET", event.metadata().target());
        event.record(&mut line);
        // An error means that the line is lost.
        let _ = self.socket.send_to(&line.bytes, &self.path);
    }
}

/// The syslog priority of a level.
const fn priority(level: Level) -> &'static str {
    match level {
        Level::ERROR => "3",
        Level::WARN => "4",
        Level::INFO => "6",
        Level::DEBUG | Level::TRACE => "7",
    }
}

/// The datagram of a line.
#[derive(Default)]
struct Line {
    bytes: Vec<u8>,
    text: String,
}

impl Line {
    /// `NAME=value`. The value is escaped: journald would take the text after a newline as another field.
    fn field(&mut self, name: &str, value: &str) {
        let value = &value[..value.floor_char_boundary(MAX_VALUE)];
        self.bytes.extend_from_slice(name.as_bytes());
        self.bytes.push(b'=');
        self.bytes.extend_from_slice(value.as_bytes());
        self.bytes.push(b'\n');
    }

    fn value(&mut self, field: &Field, value: &dyn fmt::Display) {
        let mut text = std::mem::take(&mut self.text);
        text.clear();
        // Writing to a string cannot fail; if a value's formatting fails, the value is cut there.
        let _ = write!(Escaping(&mut text), "{value}");
        if field.name() == "message" {
            self.field("MESSAGE", &text);
        } else if let Some(name) = name(field.name()) {
            self.field(&name, &text);
        }
        self.text = text;
    }
}

/// A field's name for journald: capitals, digits and underscores, with a letter first. None for a name that we or journald reserve.
fn name(field: &str) -> Option<String> {
    let capital = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' };
    let name: String = field.chars().take(MAX_NAME).map(capital).collect();
    let ours = ["MESSAGE", "PRIORITY", "SYSLOG_IDENTIFIER", "TARGET"].contains(&name.as_str());
    (name.starts_with(|c: char| c.is_ascii_uppercase()) && !ours).then_some(name)
}

impl Visit for Line {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.value(field, &format_args!("{value:?}"));
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.value(field, &value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::time::Duration;
    use tracing_subscriber::layer::SubscriberExt;

    /// Parses a datagram as journald does.
    fn parse(mut bytes: &[u8]) -> BTreeMap<String, String> {
        let mut fields = BTreeMap::new();
        while !bytes.is_empty() {
            let at = bytes.iter().position(|byte| b"=\n".contains(byte)).unwrap();
            assert_eq!(bytes[at], b'=', "no value has a line break");
            let (name, rest) = (String::from_utf8(bytes[..at].to_vec()).unwrap(), &bytes[at + 1..]);
            let (value, rest) = rest.split_at(rest.iter().position(|&byte| byte == b'\n').unwrap());
            assert!(fields.insert(name, String::from_utf8(value.to_vec()).unwrap()).is_none());
            assert_eq!(rest[0], b'\n');
            bytes = &rest[1..];
        }
        fields
    }

    fn with_journald(work: impl FnOnce(&dyn Fn() -> BTreeMap<String, String>, &UnixDatagram)) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("socket");
        let journald = UnixDatagram::bind(&path).unwrap();
        journald.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let log = tracing_subscriber::registry().with(Journal::new(&path).unwrap());
        let read = || {
            let mut bytes = vec![0; 1 << 17];
            let length = journald.recv(&mut bytes).unwrap();
            parse(&bytes[..length])
        };
        tracing::subscriber::with_default(log, || work(&read, &journald));
    }

    fn map(fields: &[(&str, &str)]) -> BTreeMap<String, String> {
        fields.iter().map(|&(name, value)| (name.to_owned(), value.to_owned())).collect()
    }

    #[test]
    fn a_message_has_its_fields() {
        with_journald(|read, _| {
            let (play_id, tick) = (3_u64, 123_456_u64);
            let none: Option<u8> = None;
            tracing::info!(play_id, tick, pattern = "edge-45", motor = none, "play {play_id} done");
            let fields = read();
            let wanted = [
                ("MESSAGE", "play 3 done"),
                ("PRIORITY", "6"),
                ("SYSLOG_IDENTIFIER", "meissner"),
                ("TARGET", "meissner::log::journal::tests"),
                ("PLAY_ID", "3"),
                ("TICK", "123456"),
                ("PATTERN", "edge-45"),
            ];
            assert_eq!(fields, map(&wanted));
            tracing::error!(um = 1.5, ok = false, "bug");
            let fields = read();
            assert_eq!((&*fields["UM"], &*fields["OK"], &*fields["PRIORITY"]), ("1.5", "false", "3"));
            tracing::warn!("world");
            assert_eq!(read()["PRIORITY"], "4");
            tracing::debug!("fault");
            assert_eq!(read()["PRIORITY"], "7");
        });
    }

    #[test]
    fn a_value_cannot_make_another_field() {
        with_journald(|read, _| {
            let text = "two\nPRIORITY=0\n\u{1b}[31mlines\u{2028}\u{202e}";
            let shown = r"two\nPRIORITY=0\n\u{1b}[31mlines\u{2028}\u{202e}";
            tracing::info!(
                cause = text,
                _private = 1,
                priority = 0,
                message_id = "x",
                r#type = 2,
                a.b = 3,
                "{text}"
            );
            let fields = read();
            assert_eq!((&*fields["MESSAGE"], &*fields["CAUSE"], &*fields["PRIORITY"]), (shown, shown, "6"));
            assert_eq!((&*fields["TYPE"], &*fields["A_B"], fields.len()), ("2", "3", 8));
            tracing::info!("{}", "ä".repeat(100_000));
            assert_eq!(read()["MESSAGE"].len(), MAX_VALUE);
        });
    }

    #[test]
    fn a_stuck_or_missing_journald_delays_nothing() {
        with_journald(|read, journald| {
            // Nobody reads: a log that waited would never go on.
            for line in 0..20_000 {
                tracing::info!("{line}");
            }
            assert_eq!(read()["MESSAGE"], "0");
            let path = journald.local_addr().unwrap().as_pathname().unwrap().to_owned();
            std::fs::remove_file(&path).unwrap();
            tracing::info!("lost");
            let again = UnixDatagram::bind(&path).unwrap();
            tracing::info!("found");
            let mut bytes = [0; 1000];
            let length = again.recv(&mut bytes).unwrap();
            assert_eq!(parse(&bytes[..length])["MESSAGE"], "found");
        });
        assert!(Journal::new(Path::new("/nonexistent/socket")).is_err());
    }
}
