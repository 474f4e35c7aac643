//! Connections that the acceptor reads: those that have not sent their first line, and those for emergency stops.

use super::head::{MAX_LINE, is_estop};
use super::listeners::peer;
use crate::daemon::estop::{EStops, Origin};
use crate::receipts::refusal;
use meissner_api::Problem;
use meissner_client::STOPPED;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::task::Poll;
use std::time::Instant;

/// A connection to the API's socket whose first line is not complete.
#[derive(Debug)]
pub(super) struct Silent {
    pub(super) stream: UnixStream,
    pub(super) head: heapless::Vec<u8, { 2 * MAX_LINE }>,
    pub(super) since: Instant,
    /// It has sent something that is not read.
    pub(super) ready: bool,
}

impl Silent {
    /// Reads what has come; ready when it is known whether the request is an emergency stop, or when the connection has ended.
    pub(super) fn read(&mut self) -> Poll<Result<bool, ()>> {
        let mut bytes = [0; MAX_LINE];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return Poll::Ready(Err(())),
                Ok(len) => {
                    if self.head.extend_from_slice(&bytes[..len]).is_err() {
                        return Poll::Ready(Err(()));
                    }
                }
                Err(error) if may_go_on(&error) => return Poll::Pending,
                Err(_) => return Poll::Ready(Err(())),
            }
            if let Some(is_estop) = is_estop(&self.head) {
                return Poll::Ready(Ok(is_estop));
            }
        }
    }
}

/// A connection to the socket for emergency stops.
#[derive(Debug)]
pub(super) struct Stopping {
    pub(super) stream: UnixStream,
    pub(super) since: Instant,
    /// Its emergency stop, once its byte has come.
    pub(super) number: Option<u64>,
}

impl Stopping {
    /// Orders the emergency stop when the byte has come; returns its number then. An error: the connection has ended before.
    pub(super) fn read(&mut self, estops: &EStops) -> Result<Option<u64>, ()> {
        match self.stream.read(&mut [0; 16]) {
            Ok(0) => Err(()),
            Ok(_) => {
                self.number = Some(estops.request(Origin::of(peer(&self.stream))));
                Ok(self.number)
            }
            Err(error) if may_go_on(&error) => Ok(None),
            Err(_) => Err(()),
        }
    }

    /// Writes the answer, if there is one; returns whether there was.
    pub(super) fn answer(&mut self, estops: &EStops) -> bool {
        let Some(answer) = self.number.and_then(|number| estops.switch.answer(number)) else { return false };
        let line = match answer.map_err(refusal) {
            Ok(()) => format!("{STOPPED}\n"),
            Err(Problem { code, detail, .. }) => format!("{code}: {detail}\n"),
        };
        // The client may be gone.
        let _ = self.stream.write_all(line.as_bytes());
        true
    }
}

fn may_go_on(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
