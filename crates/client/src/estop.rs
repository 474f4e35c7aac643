//! Sends an emergency stop on the fastest path that the daemon offers.
//!
//! The daemon serves [`estop_socket`] on a real-time thread of its own, whatever its other clients do. If that socket does not answer,
//! [`estop`] sends `POST /v1/estop` to the API's socket.
//!
//! Invariant: the client tries both paths until an answer comes. Sending an emergency stop twice does no harm.

use crate::client::Client;
use crate::endpoint::{Endpoint, Place, estop_socket};
use crate::error::ClientError;
use meissner_api::{Code, Problem};
use serde_json::{Value, json};
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

/// Tries on the socket for emergency stops.
const TRIES: usize = 3;
/// How long these tries may take.
const TIMEOUT: Duration = Duration::from_millis(1500);
/// Length of the daemon's line, at most, bytes.
const MAX_LINE: u64 = 4096;
/// The beginning of the daemon's line after the device has confirmed an emergency stop; the rest says when.
pub const STOPPED: &str = "stopped";

/// Stops at once, switches the motors off and latches the fault; waits for the device's confirmation. A daemon on the network gets the
/// request on a new connection, which its real-time thread reads.
///
/// # Errors
/// [`ClientError::Problem`] if the device did not confirm it; with the code `no-device` the daemon has latched it. Else see
/// [`ClientError`].
pub fn estop_at(place: &Place) -> Result<(), ClientError> {
    match place {
        Place::Socket(socket) => estop(socket),
        Place::Network(url) => by_api(Endpoint::on_network(url)),
    }
}

fn by_api(endpoint: Endpoint) -> Result<(), ClientError> {
    Client::at(endpoint)?.post::<Value>("/v1/estop", &json!({})).map(drop)
}

/// [`estop_at`] a socket.
///
/// # Errors
/// As of [`estop_at`].
pub fn estop(socket: &Path) -> Result<(), ClientError> {
    let (tell, line) = mpsc::channel();
    let path = estop_socket(socket);
    // On a thread, because connecting to a hung daemon may block.
    let order = move || {
        // The send fails only if the caller has stopped waiting.
        (0..TRIES).find_map(|_| ask(&path).ok()).map(|line| tell.send(line))
    };
    // If the thread cannot start, no line comes and the API's socket is used at once.
    let _ = thread::Builder::new().spawn(order);
    let line = line.recv_timeout(TIMEOUT).ok();
    match line.as_deref().map(|line| line.split_once(": ").unwrap_or((line, ""))) {
        Some((STOPPED, _)) => Ok(()),
        Some((name, detail))
            if let Some(code) = Code::ALL.iter().copied().find(|code| code.parts().0 == name) =>
        {
            Err(Problem::new(code, detail).into())
        }
        _ => by_api(Endpoint::at(socket)),
    }
}

/// Sends a byte; returns the daemon's line.
fn ask(socket: &Path) -> io::Result<String> {
    let mut stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    stream.set_write_timeout(Some(TIMEOUT))?;
    stream.write_all(b"!")?;
    let mut line = String::new();
    stream.take(MAX_LINE).read_to_string(&mut line)?;
    line.strip_suffix('\n').map(str::to_owned).ok_or_else(|| io::ErrorKind::UnexpectedEof.into())
}
