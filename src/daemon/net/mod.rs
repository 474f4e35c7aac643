//! From a socket to a room's handler: connections, who may pass, HTTP.
//!
//! [`estop`] is the real-time thread for emergency stops, with listeners of its own. The [`server`] is the API: it accepts connections,
//! and hyper gives each request to the router; [`client`] says whether the daemon works for a client or waits for it.
//!
//! A request passes [`admission`] (the [`gate`] decides by host, origin, token and role; then sessions and rights), then its handler. A
//! handler reads the [`body`], makes the request a command to the engine, and the result an [`answer`]; [`request_log`] records it.

pub(in crate::daemon) mod admission;
pub(in crate::daemon) mod answer;
pub(in crate::daemon) mod app;
pub(in crate::daemon) mod body;
pub(in crate::daemon) mod bounds;
pub(in crate::daemon) mod client;
pub(in crate::daemon) mod estop;
pub(in crate::daemon) mod gate;
pub(in crate::daemon) mod head;
pub(in crate::daemon) mod listen;
pub(in crate::daemon) mod refusal;
pub(in crate::daemon) mod request_log;
pub(in crate::daemon) mod server;
pub(in crate::daemon) mod socket;
