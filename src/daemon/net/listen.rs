//! Where the daemon listens for network clients: the address of the configuration key `listen` for the API, and the port after it for
//! emergency stops. Without the key nothing listens.

use crate::config::Listen;
use rustix::io::Errno;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpListener};
use tracing::{info, warn};

/// The result of binding the address in `listen`.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Bound {
    /// For the API, and for emergency stops.
    pub(in crate::daemon) listeners: Option<[TcpListener; 2]>,
    /// With the port that the system has chosen for port 0.
    pub(in crate::daemon) listen: Option<Listen>,
    /// Why the daemon does not listen.
    pub(in crate::daemon) problem: Option<String>,
}

/// How often a pair of free ports is looked for when the system chooses.
const TRIES: u32 = 100;

/// Binds the address of the configuration. If that fails, the daemon still works: a missing address, or a port in use, must not
/// keep the socket's clients from the display. Without the port for emergency stops it does not serve the network at all.
pub(in crate::daemon) fn listen(listen: Option<&Listen>) -> Bound {
    let Some(listen) = listen else { return Bound::default() };
    let bind = |address: SocketAddr| {
        let listener = TcpListener::bind(address).map_err(|error| (address.port(), error))?;
        listener.set_nonblocking(true).map_err(|error| (address.port(), error))?;
        let address = listener.local_addr().map_err(|error| (address.port(), error))?;
        Ok((listener, address))
    };
    let both = || {
        let (api, address) = bind(listen.address)?;
        // The configuration allows no port without a successor, but the system may choose it.
        let next = address.port().checked_add(1).ok_or((address.port(), ErrorKind::AddrInUse.into()))?;
        let (estops, _) = bind(SocketAddr::new(address.ip(), next))?;
        Ok(([api, estops], Listen { address, ..listen.clone() }))
    };
    let tries = if listen.address.port() == 0 { TRIES } else { 1 };
    let bound = (1..tries).find_map(|_| both().ok()).map_or_else(both, Ok);
    match bound {
        Ok((listeners, listen)) => {
            let estops = listen.address.port() + 1;
            info!(
                "listening on http://{}/ for the page and network clients, and on port {estops} for their emergency stops",
                listen.address
            );
            Bound { listeners: Some(listeners), listen: Some(listen), problem: None }
        }
        Err((port, error)) => {
            let port = match port == listen.address.port() {
                true => String::new(),
                false => format!("port {port}, for emergency stops: "),
            };
            let problem = format!("`listen` = \"{}\": {port}{error}: {}", listen.address, advice(&error));
            warn!("{problem}");
            Bound { listeners: None, listen: Some(listen.clone()), problem: Some(problem) }
        }
    }
}

fn advice(error: &io::Error) -> &'static str {
    match Errno::from_io_error(error) {
        // systemd's RestrictAddressFamilies= causes this error.
        Some(Errno::AFNOSUPPORT) => {
            "the service's unit forbids the network: docs/lab-pc.md says how to allow it"
        }
        _ => "choose an address of this machine, with two free ports in a row, and restart the daemon",
    }
}
