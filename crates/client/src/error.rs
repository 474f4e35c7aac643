//! What a call to the daemon can come to, in words.
//!
//! It knows no HTTP; who made an error says where it came from.
//!
//! Invariant: the display of a [`ClientError`] is one line that says what to do.

use super::{Endpoint, MAX_SOCKET_PATH, is_hidden};
use meissner_api::Problem;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// What a call can come to.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// Nobody answers.
    #[error("no daemon answers at {endpoint}: {}", .endpoint.start())]
    NoDaemon {
        /// Where.
        endpoint: Endpoint,
        /// What the system said.
        source: io::Error,
    },
    /// We may not, and it can be said why.
    #[error("{}: {found}: {advice}", .socket.display())]
    Denied {
        /// Where.
        socket: PathBuf,
        /// Why.
        found: String,
        /// What to do.
        advice: String,
    },
    /// It is not to be had.
    #[error("{}: {source}; see that you may use the socket (its group), or choose another with --socket", .socket.display())]
    Connect {
        /// Where.
        socket: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// More than the system takes.
    #[error("{}: a socket's path has at most {MAX_SOCKET_PATH} bytes: choose a shorter one with --socket", .socket.display())]
    TooLong {
        /// Where.
        socket: PathBuf,
    },
    /// The daemon says no.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The connection broke.
    #[error("{}: the daemon hung up: see its log", .socket.display())]
    HungUp {
        /// Where.
        socket: PathBuf,
        /// What HTTP said.
        source: Option<hyper::Error>,
    },
    /// It takes too long.
    #[error("{}: no answer within {} s: see the daemon's log", .socket.display(), .timeout.as_secs_f32())]
    Slow {
        /// Where.
        socket: PathBuf,
        /// How long it was waited for.
        timeout: Duration,
    },
    /// Something else answers there, or another version.
    #[error("{}: not an answer of this version's daemon: {what}; restart it, or choose another with --socket", .socket.display())]
    Answer {
        /// Where.
        socket: PathBuf,
        /// What is odd about it.
        what: String,
    },
    /// No runtime.
    #[error("cannot start: {0}")]
    Runtime(#[source] io::Error),
}

impl ClientError {
    /// Whether there is a socket that is not even to be seen: `su` leaves one with the runtime directory of somebody else.
    #[must_use]
    pub fn is_hidden(&self) -> bool {
        matches!(self, Self::Connect { socket, source } if is_hidden(source, socket))
    }
}
