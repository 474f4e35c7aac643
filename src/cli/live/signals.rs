//! Makes SIGINT, SIGTERM and SIGHUP readable from a file descriptor, so that a loop can wait for them and for its other files.
//!
//! The second signal ends this process at once; its connection closes, and the daemon ends the play.

use crate::cli::ending::on_signals;
use anyhow::Result;
use std::io::{Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::process;

#[derive(Debug)]
pub(super) struct Signals(UnixStream);

impl Signals {
    pub(super) fn listen() -> Result<Self> {
        let (from, mut to) = UnixStream::pair()?;
        from.set_nonblocking(true)?;
        let mut again = false;
        on_signals(move |number| {
            if again {
                process::exit(128 + number);
            }
            again = true;
            // The write fails only if this process is ending. A signal's number fits into a byte.
            let _ = to.write_all(&[number as u8]);
        })?;
        Ok(Self(from))
    }

    /// The number of the signal, if one has come.
    pub(super) fn taken(&self) -> Option<u8> {
        let mut number = [0];
        matches!((&self.0).read(&mut number), Ok(1)).then_some(number[0])
    }
}

impl AsFd for Signals {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
