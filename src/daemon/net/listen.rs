//! Where the daemon listens for network clients: the address of the configuration key `listen`; without it nothing listens.

use crate::config::Listen;
use rustix::io::Errno;
use std::io;
use std::net::TcpListener;
use tracing::{info, warn};

/// The result of binding the address in `listen`.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Bound {
    pub(in crate::daemon) listener: Option<TcpListener>,
    /// With the port that the system has chosen for port 0.
    pub(in crate::daemon) listen: Option<Listen>,
    /// Why the daemon does not listen.
    pub(in crate::daemon) problem: Option<String>,
}

/// Binds the address of the configuration. If that fails, the daemon still works: a missing address, or a port in use, must not
/// keep the socket's clients from the display.
pub(in crate::daemon) fn listen(listen: Option<&Listen>) -> Bound {
    let Some(listen) = listen else { return Bound::default() };
    let bind = || -> io::Result<(TcpListener, Listen)> {
        let listener = TcpListener::bind(listen.address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok((listener, Listen { address, ..listen.clone() }))
    };
    match bind() {
        Ok((listener, listen)) => {
            info!("listening on http://{}/ for the page and network clients", listen.address);
            Bound { listener: Some(listener), listen: Some(listen), problem: None }
        }
        Err(error) => {
            let problem = format!("`listen` = \"{}\": {error}: {}", listen.address, advice(&error));
            warn!("{problem}");
            Bound { listener: None, listen: Some(listen.clone()), problem: Some(problem) }
        }
    }
}

fn advice(error: &io::Error) -> &'static str {
    match Errno::from_io_error(error) {
        // systemd's RestrictAddressFamilies= causes this error.
        Some(Errno::AFNOSUPPORT) => {
            "the service's unit forbids the network: docs/lab-pc.md says how to allow it"
        }
        _ => "choose an address of this machine and a free port, and restart the daemon",
    }
}
