//! A blocking client of the daemon: HTTP/1.1 over its Unix socket or over TCP, and streams of events.
//!
//! A [`Client`] keeps one connection open and sends JSON; `meissner-api` has the types of requests and answers, and
//! `GET /v1/openapi.json` describes the routes. In the order of a call:
//!
//! - [`Endpoint`]: where to connect to.
//! - [`Client`]: calls that wait for their answer, by default for [`ANSWER_TIMEOUT`]. Each client has its own small async runtime.
//! - [`Events`]: the daemon's events, on a separate connection.
//! - [`estop_at`]: an emergency stop, on both of the daemon's paths at once.
//! - [`ClientError`]: the errors, each one line that says what to do.
//!
//! ```no_run
//! use meissner_api::{ArmRequest, Event, Item, Order, PlayAccepted, Status, Terms};
//! use meissner_client::{Client, Endpoint};
//!
//! let mut client = Client::at(Endpoint::find())?;
//! let mut events = client.events()?;
//! let _: Status = client.post("/v1/arm", &ArmRequest { assume_rest: true, ..ArmRequest::default() })?;
//! let order = Order::new(Item { seconds: Some(2.0), ..Item::of("edge-45") }, Terms::default());
//! let PlayAccepted { id, .. } = client.play(&order)?;
//! while let Some(event) = events.next(None)? {
//!     if let Event::Ended { receipt } = event
//!         && receipt.id == id
//!     {
//!         println!("{}: {:?}", receipt.state.name(), receipt.counts.bursts);
//!         break;
//!     }
//! }
//! # Ok::<(), meissner_client::ClientError>(())
//! ```
//!
//! Invariant: the client sends a request that may change something only once. It may repeat an emergency stop.

mod access;
mod client;
mod connection;
mod endpoint;
mod error;
mod estop;
mod events;

pub use client::{Client, DISK_TIMEOUT, HOME_TIMEOUT};
pub use connection::{ANSWER_TIMEOUT, escape};
pub use endpoint::{
    Endpoint, MAX_SOCKET_PATH, Place, SERVICE_SOCKET, default_socket, estop_socket, is_installed, make_dir,
};

pub use error::ClientError;
pub use estop::{STOPPED, estop, estop_at};
pub use events::Events;

#[cfg(test)]
mod tests;
