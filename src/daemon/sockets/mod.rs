//! A connection, from the moment it is accepted to its bytes, which the HTTP server reads.
//!
//! [`acceptor`] accepts connections on a thread of its own, reads the head of their first request ([`first_request`]) and orders emergency
//! stops. A [`connection`] then reads ahead of the server: [`framing`] finds where requests begin and end, and [`orders`] the emergency
//! stops among them. [`activity`] says whether the daemon works for a client or waits for it.

pub(in crate::daemon) mod acceptor;
pub(in crate::daemon) mod activity;
pub(in crate::daemon) mod connection;
pub(in crate::daemon) mod first_request;
pub(in crate::daemon) mod framing;
pub(in crate::daemon) mod orders;
pub(in crate::daemon) mod stream;
