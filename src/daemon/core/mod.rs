//! What all rooms share: the state's one lock, the one way of commands to the streamer, and what runs beside the requests.
//!
//! [`engine`] holds the lock over the [`state`], of which every room has its part, and sends [`commands`]. [`event_loop`] processes the streamer's
//! events, [`publisher`] passes them on to listeners and the session record, [`log_lines`] to the log. [`connector`] opens devices for the
//! [`connection`]; [`service`] speaks with the service manager. [`check`] finds at the start what would keep the daemon from working.

pub(in crate::daemon) mod check;
pub(in crate::daemon) mod commands;
pub(in crate::daemon) mod connection;
pub(in crate::daemon) mod connector;
pub(in crate::daemon) mod engine;
pub(in crate::daemon) mod error;
pub(in crate::daemon) mod event_loop;
pub(in crate::daemon) mod log_lines;
pub(in crate::daemon) mod names;
pub(in crate::daemon) mod panics;
pub(in crate::daemon) mod publisher;
pub(in crate::daemon) mod runtime;
pub(in crate::daemon) mod service;
pub(in crate::daemon) mod signals;
pub(in crate::daemon) mod state;
