//! Connections that the acceptor reads: those whose first request's head is not complete, and those for emergency stops.

use crate::daemon::arm::estop::{EStops, Origin};
use crate::daemon::net::first_request::{First, MAX_LINE, first};
use crate::daemon::net::framing::HEAD;
use crate::daemon::net::gate::Gate;
use crate::daemon::net::stream::Stream;
use crate::receipts::refusal;
use crate::record::Peer;
use meissner_api::Problem;
use meissner_client::STOPPED;
use std::io::{self, ErrorKind, Read, Write};
use std::task::Poll;
use std::time::{Duration, Instant};

/// The most bytes that are read of a request before it is handed over. A browser's headers fit; the server checks longer requests
/// for emergency stops.
const MAX_HEAD: usize = 2048;
/// How long a client may send nothing.
const SILENT: Duration = Duration::from_secs(30);

/// A connection to the API that waits for the rest of its first head. It does not occupy a place of the server.
#[derive(Debug)]
pub(super) struct Silent {
    pub(super) stream: Stream,
    /// Who is at its other end.
    pub(super) peer: Peer,
    pub(super) head: heapless::Vec<u8, MAX_HEAD>,
    pub(super) since: Instant,
    /// When its first byte was read.
    pub(super) begun: Option<Instant>,
    /// It has sent something that is not read.
    pub(super) ready: bool,
}

impl Silent {
    /// When the acceptor ends the connection.
    pub(super) fn due(&self) -> Instant {
        self.begun.map_or(self.since + SILENT, |begun| begun + HEAD)
    }

    /// Reads the available bytes; ready when the kind of request is known, or when the connection has ended.
    pub(super) fn read(&mut self, gate: &Gate) -> Poll<Result<First, ()>> {
        let mut bytes = [0; MAX_LINE];
        loop {
            let free = MAX_LINE.min(MAX_HEAD - self.head.len());
            match (&self.stream).read(&mut bytes[..free]) {
                Ok(0) if self.head.is_empty() => return Poll::Ready(Err(())),
                // The server answers a request that broke off, and records it.
                Ok(0) => return Poll::Ready(Ok(First::other(self.peer.network.is_none()))),
                // The buffer has room for these bytes.
                Ok(len) => drop(self.head.extend_from_slice(&bytes[..len])),
                Err(error) if may_go_on(&error) => return Poll::Pending,
                Err(_) => return Poll::Ready(Err(())),
            }
            self.begun.get_or_insert_with(Instant::now);
            if let Some(first) = first(&self.head, self.peer, gate) {
                return Poll::Ready(Ok(first));
            }
            if self.head.is_full() {
                return Poll::Ready(Ok(First::other(self.peer.network.is_none())));
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
    /// Orders the emergency stop if the byte has come, and returns its number. An error: the connection has ended before.
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
            Ok(()) => {
                let after = estops.switch.confirmed_after().unwrap_or_default();
                format!("{STOPPED}: lines off within {:.1} ms of the order\n", after.as_secs_f64() * 1e3)
            }
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
