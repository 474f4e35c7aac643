//! From a socket to a room's handler: connections, who may pass, HTTP.
//!
//! [`acceptor`] accepts connections on a thread of its own, reads the head of their first request ([`first_request`]) and orders emergency
//! stops. A [`connection`] then reads ahead of the server: [`framing`] finds where requests begin and end, and [`orders`] the emergency
//! stops among them. [`activity`] says whether the daemon works for a client or waits for it.
//!
//! The [`server`] gives each request to the router. It passes [`admission`] (the [`gate`] decides by host, origin, token and role; then
//! sessions and rights), then its handler. A handler reads the [`body`], makes the request a command to the engine, and the result
//! an [`answer`], which [`compress`] shortens; [`request_log`] records it.

pub(in crate::daemon) mod acceptor;
pub(in crate::daemon) mod activity;
pub(in crate::daemon) mod admission;
pub(in crate::daemon) mod answer;
pub(in crate::daemon) mod app;
pub(in crate::daemon) mod body;
pub(in crate::daemon) mod compress;
pub(in crate::daemon) mod connection;
pub(in crate::daemon) mod estop;
pub(in crate::daemon) mod first_request;
pub(in crate::daemon) mod framing;
pub(in crate::daemon) mod gate;
pub(in crate::daemon) mod gzip;
pub(in crate::daemon) mod head;
pub(in crate::daemon) mod listen;
pub(in crate::daemon) mod orders;
pub(in crate::daemon) mod refusal;
pub(in crate::daemon) mod request_log;
pub(in crate::daemon) mod server;
pub(in crate::daemon) mod socket;
pub(in crate::daemon) mod stream;
