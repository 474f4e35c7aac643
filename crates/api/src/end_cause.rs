//! Why a play ended before its end: the `cause` of receipts, events and the session record.
//!
//! In JSON it is a text. Programs compare [`EndCause`], and only the edges (JSON, log, terminal) read or write its text.
//!
//! Invariant: each text is read as the cause that writes it. A text that this version does not know, such as that of an older
//! record, is kept as it is.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use std::fmt;

/// Lists each cause with its text once.
macro_rules! causes {
    ($($(#[$doc:meta])* $name:ident = $text:literal,)*) => {
        /// Why a play ended before its end.
        #[derive(Clone, Debug, PartialEq, Eq)]
        pub enum EndCause {
            $($(#[$doc])* $name,)*
            /// Why a link was lost, in words; that a live play is done; or a cause of another version. No program decides by it.
            Other(Cow<'static, str>),
        }

        impl EndCause {
            /// The text in JSON.
            pub fn text(&self) -> &str {
                match self {
                    $(Self::$name => $text,)*
                    Self::Other(text) => text,
                }
            }
        }

        impl From<String> for EndCause {
            fn from(text: String) -> Self {
                match &*text {
                    $($text => Self::$name,)*
                    _ => Self::Other(text.into()),
                }
            }
        }

        #[cfg(test)]
        const TEXTS: &[&str] = &[$($text),*];
    };
}

causes! {
    /// The device has started.
    Boot = "boot",
    /// The device obeyed a command.
    Request = "request",
    /// A stop.
    Stop = "stop",
    /// The daemon's end.
    Shutdown = "shutdown",
    /// A play that aborted, and with it all others.
    Abort = "abort",
    /// An emergency stop.
    EStop = "estop",
    /// The host watchdog ran out.
    HostTimeout = "lease",
    /// The device lost the link.
    LinkLost = "link-lost",
    /// Another host has opened the device.
    NewHost = "new-host",
    /// The firmware rendered too late.
    Starved = "starved",
    /// The firmware panicked.
    Panic = "panic",
    /// The board's watchdog ran out.
    Watchdog = "watchdog",
    /// The board's outputs did not follow.
    Output = "output",
    /// A disarm.
    Disarm = "disarm",
    /// An edge of the trigger input, as its order says.
    Edge = "edge",
    /// A client has taken it out of the queue.
    Withdrawn = "withdrawn",
    /// Another play took its place.
    Replaced = "replaced",
    /// The client of a live play was silent.
    ClientSilent = "client-silent",
    /// The clients for which the motors were armed were silent.
    OwnerSilent = "owner-silent",
    /// The access token of its order was revoked.
    Revoked = "revoked",
    /// The owner of an exclusive session has come back: the play was another client's.
    OwnerReturned = "owner-returned",
    /// A participant's limit ordered its end.
    ParticipantLimit = "participant-limit",
    /// A pin that it drives may be too far from rest.
    DriftLimit = "drift-limit",
    /// Late strokes, which its late policy does not allow.
    LateStrokes = "late strokes",
    /// The device could not begin it in time, or a play before it ended later than predicted.
    OnsetMissed = "the onset could not be kept",
    /// The line is too slow for it.
    LineTooSlow = "the line does not carry the pattern",
    /// Its strokes broke a limit: a bug.
    BrokenStrokes = "the compiled strokes failed their own check: a bug, please report it",
    /// The `arm` before it took too long.
    NotArmed = "not armed in time",
    /// The device refused the command before it.
    CommandRefused = "the device refused the command before it",
    /// Another device took the place of its device.
    AnotherDevice = "another device was opened",
    /// The device's port is gone.
    Unplugged = "the device was unplugged",
}

impl EndCause {
    /// Whether the play itself could not go on: it was aborted, not stopped.
    pub const fn is_abort(&self) -> bool {
        matches!(self, Self::LateStrokes | Self::OnsetMissed | Self::LineTooSlow | Self::BrokenStrokes)
    }
}

impl fmt::Display for EndCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

impl Serialize for EndCause {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.text())
    }
}

impl<'de> Deserialize<'de> for EndCause {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer).map(Into::into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_text_is_read_as_the_cause_that_writes_it() {
        for text in TEXTS {
            let json = serde_json::to_string(text).unwrap();
            let cause: EndCause = serde_json::from_str(&json).unwrap();
            assert!(!matches!(cause, EndCause::Other(_)), "{text}");
            assert_eq!(serde_json::to_string(&cause).unwrap(), json);
        }
        let of_another_version = "the device does not answer any more";
        let cause = EndCause::from(of_another_version.to_owned());
        assert_eq!((cause.text(), cause.is_abort()), (of_another_version, false));
    }
}
