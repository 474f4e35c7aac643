//! Errors with which the daemon cannot start or has ended.
//!
//! Every message says what failed, where, and what to do, in one line.

use crate::daemon::net::socket::SocketError;
use crate::store::StoreError;
use std::io;
use std::path::PathBuf;

/// Why the daemon cannot start or has ended.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// The socket.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// The library or the configured directory of patterns.
    #[error("`patterns_dir`: {0}")]
    Store(#[from] StoreError),
    /// The session record has no directory and cannot make one.
    #[error("`logbook_dir`: {}: neither it nor its parent is a directory: make one, or name another", .dir.display())]
    Record {
        /// The configured directory.
        dir: PathBuf,
    },
    /// The system gave no descriptor or thread.
    #[error("the system gives no {what}: {source}")]
    System {
        /// What the daemon requested.
        what: &'static str,
        /// The system's answer.
        source: io::Error,
    },
    /// The system gives the process too little memory.
    #[error(
        "the daemon may use {} MiB of address space and needs {}: raise the limit (`ulimit -v`, LimitAS=)", .bytes >> 20, .needed >> 20
    )]
    AddressSpace {
        /// The limit.
        bytes: u64,
        /// What the daemon needs.
        needed: u64,
    },
    /// A part panicked: our bug, or the system refused memory or a thread.
    #[error(
        "internal error: a part of the daemon has failed (see the lines before this one); it has switched the motors off"
    )]
    Panicked,
    /// The event loop ended by itself: our bug.
    #[error(
        "internal error: the daemon gets no more events from its streamer; motors go off when the host watchdog (`lease_ms`) expires"
    )]
    EventLoop,
    /// The thread for emergency stops ended by itself: our bug.
    #[error("internal error: the thread for emergency stops has ended")]
    EStops,
    /// The streamer ended by itself: our bug.
    #[error(
        "internal error: the streamer's thread has ended; motors go off when the host watchdog (`lease_ms`) expires"
    )]
    Streamer,
}

/// Makes an [`io::Error`] a [`DaemonError::System`].
pub(in crate::daemon) fn system(what: &'static str) -> impl Fn(io::Error) -> DaemonError {
    move |source| DaemonError::System { what, source }
}
