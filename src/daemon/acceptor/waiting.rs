//! Connections that the acceptor reads: those that have not sent their first line, and those for emergency stops.

use super::head::{MAX_LINE, check, is_estop};
use crate::daemon::estop::{EStops, Origin};
use crate::daemon::network::Gate;
use crate::daemon::stream::Stream;
use crate::receipts::refusal;
use crate::session_record::Peer;
use meissner_api::Problem;
use meissner_client::STOPPED;
use std::io::{self, ErrorKind, Read, Write};
use std::task::Poll;
use std::time::Instant;

/// The most bytes that are read of a request before it is handed over. A browser's headers fit; of a longer request the server decides
/// whether it is an emergency stop.
const MAX_HEAD: usize = 2048;

/// A connection to the API that waits for the rest of its first line, or of the headers of a network client's emergency stop.
#[derive(Debug)]
pub(super) struct Silent {
    pub(super) stream: Stream,
    /// Who is at its other end.
    pub(super) peer: Peer,
    pub(super) head: heapless::Vec<u8, MAX_HEAD>,
    pub(super) since: Instant,
    /// It has sent something that is not read.
    pub(super) ready: bool,
}

impl Silent {
    /// Reads what has come; ready when it is known whether the request is an emergency stop that may be ordered, or when the connection
    /// has ended.
    pub(super) fn read(&mut self, gate: &Gate) -> Poll<Result<bool, ()>> {
        let mut bytes = [0; MAX_LINE];
        loop {
            let free = MAX_LINE.min(MAX_HEAD - self.head.len());
            match (&self.stream).read(&mut bytes[..free]) {
                Ok(0) => return Poll::Ready(Err(())),
                // There is room for so many.
                Ok(len) => drop(self.head.extend_from_slice(&bytes[..len])),
                Err(error) if may_go_on(&error) => return Poll::Pending,
                Err(_) => return Poll::Ready(Err(())),
            }
            let is_estop = match (is_estop(&self.head), self.peer.network) {
                (Some(true), Some(client)) => check(&self.head, client, gate),
                (is_estop, _) => is_estop,
            };
            if let Some(is_estop) = is_estop {
                return Poll::Ready(Ok(is_estop));
            }
            if self.head.is_full() {
                return Poll::Ready(Ok(false));
            }
        }
    }
}

/// A connection to the socket for emergency stops.
#[derive(Debug)]
pub(super) struct Stopping {
    pub(super) stream: Stream,
    pub(super) since: Instant,
    /// Its emergency stop, once its byte has come.
    pub(super) number: Option<u64>,
}

impl Stopping {
    /// Orders the emergency stop when the byte has come; returns its number then. An error: the connection has ended before.
    pub(super) fn read(&mut self, estops: &EStops) -> Result<Option<u64>, ()> {
        match (&self.stream).read(&mut [0; 16]) {
            Ok(0) => Err(()),
            Ok(_) => {
                self.number = Some(estops.request(Origin::of(self.stream.peer())));
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
        let _ = (&self.stream).write_all(line.as_bytes());
        true
    }
}

fn may_go_on(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
