//! Sends an emergency stop on both paths that the daemon offers, at once.
//!
//! The daemon serves [`estop_socket`], and on the network the port after the API's, on a real-time thread of its own, whatever its
//! other clients do. A firewall may block that port, so the API gets the same request.
//!
//! Invariant: the first good answer counts. Sending an emergency stop twice does no harm.

use crate::client::Client;
use crate::connection::host;
use crate::endpoint::{Endpoint, Place, estop_socket};
use crate::error::ClientError;
use meissner_api::{Code, Problem, Status};
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

/// How long the daemon's line may take.
const TIMEOUT: Duration = Duration::from_millis(1500);
/// How long a good answer is kept back until the other path has answered, too: an order that is still under way must not come after
/// the caller's next command, which may be a reset.
const OTHER: Duration = Duration::from_millis(250);
/// Length of the daemon's line, at most, bytes.
const MAX_LINE: u64 = 4096;
/// The beginning of the daemon's line after the device has confirmed an emergency stop; the rest says when.
pub const STOPPED: &str = "stopped";

/// Stops at once, switches the motors off and latches the fault; waits for the device's confirmation.
///
/// # Errors
/// [`ClientError::Problem`] if the device did not confirm it; with the code `no-device` the daemon has latched it. Else see
/// [`ClientError`].
pub fn estop_at(place: &Place) -> Result<(), ClientError> {
    let (tell, answers) = mpsc::channel();
    for is_api in [false, true] {
        let (place, tell) = (place.clone(), tell.clone());
        // On a thread, because connecting to a hung daemon may block.
        let order = move || {
            let answer = if is_api { by_api(&place) } else { by_listener(&place) };
            // The send fails only if the caller has stopped waiting.
            let _ = tell.send((is_api, answer));
        };
        // Without a thread there is no answer.
        let _ = thread::Builder::new().spawn(order);
    }
    drop(tell);
    let mut failed = None;
    while let Ok((is_api, answer)) = answers.recv() {
        let Err(error) = answer else {
            // The order under way may end as it likes.
            let _ = answers.recv_timeout(OTHER);
            return Ok(());
        };
        // The daemon's word counts more than a path that is blocked, and the API's more than that of the other path.
        let rank = (matches!(error, ClientError::Problem(_)), is_api);
        if failed.as_ref().is_none_or(|(before, _)| *before < rank) {
            failed = Some((rank, error));
        }
    }
    failed.map_or_else(|| by_api(place), |(_, error)| Err(error))
}

/// [`estop_at`] a socket.
///
/// # Errors
/// As of [`estop_at`].
pub fn estop(socket: &Path) -> Result<(), ClientError> {
    estop_at(&Place::Socket(socket.to_owned()))
}

fn by_api(place: &Place) -> Result<(), ClientError> {
    let endpoint = match place {
        Place::Socket(socket) => Endpoint::at(socket),
        Place::Network(url) => Endpoint::on_network(url),
    };
    by_http(endpoint)
}

fn by_http(endpoint: Endpoint) -> Result<(), ClientError> {
    let status: Status = Client::at(endpoint)?.estop()?;
    if status.is_connected() {
        return Ok(());
    }
    let detail = "the emergency stop is latched, but no device is connected";
    Err(Problem::new(Code::NoDevice, detail).into())
}

/// Stops on the listener for emergency stops alone.
fn by_listener(place: &Place) -> Result<(), ClientError> {
    match place {
        Place::Network(url) => {
            let (host, port) = host(url)?;
            let host = if host.contains(':') { format!("[{host}]") } else { host };
            by_http(Endpoint::on_network(&format!("http://{host}:{}", u32::from(port) + 1)))
        }
        Place::Socket(socket) => {
            let connect = |source| ClientError::Connect { place: place.clone(), source };
            let line = ask(&estop_socket(socket)).map_err(connect)?;
            match line.split_once(": ").unwrap_or((&line, "")) {
                (STOPPED, _) => Ok(()),
                (name, detail) => {
                    let code = Code::ALL.iter().copied().find(|code| code.parts().0 == name);
                    let strange = || ClientError::BadAnswer { place: place.clone(), what: line.clone() };
                    Err(code.map_or_else(strange, |code| Problem::new(code, detail).into()))
                }
            }
        }
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
