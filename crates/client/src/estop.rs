//! The emergency stop, on the fastest way that the daemon offers.
//!
//! The daemon serves [`estop_socket`] on a real-time thread of its own, whatever its other clients do. If that socket does not answer,
//! [`estop`] sends `POST /v1/estop` to the API's socket.
//!
//! Invariant: an emergency stop is sent until the daemon answers, or no way is left: sending it twice does no harm.

use crate::client::{ANSWER_TIMEOUT, Client};
use crate::endpoint::estop_socket;
use crate::error::ClientError;
use meissner_api::{Code, Problem, Status};
use serde_json::json;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;

/// Tries on the socket for emergency stops.
const TRIES: usize = 3;
/// Length of the daemon's line, at most, bytes.
const MAX_LINE: u64 = 4096;
/// The daemon's line after the device has confirmed an emergency stop.
pub const STOPPED: &str = "stopped";

/// Stops at once, switches the motors off and latches the fault; waits for the device's confirmation.
///
/// # Errors
/// [`ClientError::Problem`] if the device did not confirm it; else see [`ClientError`].
pub fn estop(socket: &Path) -> Result<(), ClientError> {
    let line = (0..TRIES).find_map(|_| ask(&estop_socket(socket)).ok());
    match line.as_deref().map(|line| line.split_once(": ").unwrap_or((line, ""))) {
        Some((STOPPED, _)) => Ok(()),
        Some((name, detail))
            if let Some(code) = Code::ALL.into_iter().find(|code| code.parts().0 == name) =>
        {
            Err(Problem::new(code, detail).into())
        }
        _ => Client::new(socket)?.post::<Status>("/v1/estop", &json!({})).map(drop),
    }
}

/// Sends a byte; returns the daemon's line.
fn ask(socket: &Path) -> io::Result<String> {
    let mut stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(ANSWER_TIMEOUT))?;
    stream.set_write_timeout(Some(ANSWER_TIMEOUT))?;
    stream.write_all(b"!")?;
    let mut line = String::new();
    stream.take(MAX_LINE).read_to_string(&mut line)?;
    line.strip_suffix('\n').map(str::to_owned).ok_or_else(|| io::ErrorKind::UnexpectedEof.into())
}
