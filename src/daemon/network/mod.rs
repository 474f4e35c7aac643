//! Network clients: where the daemon listens for them, and which of their requests it admits.
//!
//! [`listen`] binds the address of the configuration key `listen`; without it nothing listens. [`Gate::check`] decides about each
//! request by its [`Head`]: the acceptor calls it before it orders an emergency stop, and `http::admission` calls it before every route.
//! [`TokenStore`] holds the access tokens.
//!
//! Invariant: a request reaches a handler only after the gate let it through.

mod gate;
mod head;
mod refusal;
mod tokens;

pub(super) use gate::{Checked, Gate};
pub(super) use head::Head;
pub(super) use refusal::{NOT_VALID, READS_ONLY, Refusal};
pub(super) use tokens::TokenStore;

use crate::config::Listen;
use rustix::io::Errno;
use std::io;
use std::net::TcpListener;
use tracing::{info, warn};

/// The result of binding the address in `listen`.
#[derive(Debug, Default)]
pub(super) struct Bound {
    pub(super) listener: Option<TcpListener>,
    /// With the port that the system has chosen for port 0.
    pub(super) listen: Option<Listen>,
    /// Why the daemon does not listen.
    pub(super) problem: Option<String>,
}

/// Binds the address of the configuration. If that fails, the daemon still works: a missing address, or a port in use, must not
/// keep the socket's clients from the display.
pub(super) fn listen(listen: Option<&Listen>) -> Bound {
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
