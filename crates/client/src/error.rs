//! The errors of a call to the daemon, each one line that says what to do.
//!
//! [`ClientError::Problem`] is the daemon's own answer; all others mean that no usable answer came.
//!
//! Invariant: the display of a [`ClientError`] holds no line break.

use crate::endpoint::{Endpoint, MAX_SOCKET_PATH, Place, is_hidden};
use meissner_api::Problem;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No daemon listens at the endpoint.
    #[error("no daemon answers at {endpoint}: {}", .endpoint.how_to_start())]
    NoDaemon {
        /// The places that were tried.
        endpoint: Endpoint,
        /// The system's error.
        source: io::Error,
    },
    /// The system denies access to the socket, and groups or file modes explain why.
    #[error("{}: {found}: {advice}", .socket.display())]
    Denied {
        /// The socket.
        socket: PathBuf,
        /// Why the user may not use it.
        found: String,
        /// What to do.
        advice: String,
    },
    /// The place cannot be used for another reason.
    #[error("{place}: {source}; {}", how_to_reach(.place))]
    Connect {
        /// The place.
        place: Place,
        /// The system's error.
        source: io::Error,
    },
    /// The socket's path is longer than the system allows.
    #[error("{}: a socket's path has at most {MAX_SOCKET_PATH} bytes: choose a shorter one with --socket", .socket.display())]
    TooLong {
        /// The socket.
        socket: PathBuf,
    },
    /// This is no URL of a daemon.
    #[error("{url}: not the URL of a daemon: {why}; give one such as http://lab-pc:8765")]
    BadUrl {
        /// The URL.
        url: String,
        /// What is wrong with it.
        why: &'static str,
    },
    /// The daemon answered with an error.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The connection broke before the answer was complete.
    #[error("{place}: the daemon closed the connection: see its log")]
    HungUp {
        /// The place.
        place: Place,
        /// The HTTP library's error.
        source: Option<hyper::Error>,
    },
    /// No answer, or no event, came in time.
    #[error("{place}: no answer within {} s: see the daemon's log", .timeout.as_secs_f32())]
    Timeout {
        /// The place.
        place: Place,
        /// How long the client waited.
        timeout: Duration,
    },
    /// The answer is not one that a daemon of this version gives.
    #[error("{place}: not an answer of this version's daemon: {what}; restart the daemon, or choose another")]
    BadAnswer {
        /// The place.
        place: Place,
        /// What is wrong with the answer.
        what: String,
    },
    /// The system gives the client no event queue.
    #[error("cannot start the client: {0}")]
    Runtime(#[source] io::Error),
}

impl ClientError {
    /// Whether the user lacks the right to search the socket's directory, for example after `su`, which keeps another user's
    /// runtime directory.
    pub fn is_hidden(&self) -> bool {
        matches!(self, Self::Connect { place: Place::Socket(socket), source } if is_hidden(source, socket))
    }
}

const fn how_to_reach(place: &Place) -> &'static str {
    match place {
        Place::Socket(_) => "check that you may use the socket (its group), or choose another with --socket",
        Place::Network(_) => "check the URL and the network, or choose another with --connect",
    }
}
