//! The system around the daemon: its socket's file, signals, threads, names of users, and what may be wrong with any of them.
//!
//! Nothing here knows the daemon's state. [`check`] finds at the start what would keep the daemon from working.

pub(in crate::daemon) mod check;
pub(in crate::daemon) mod error;
pub(in crate::daemon) mod gzip;
pub(in crate::daemon) mod names;
pub(in crate::daemon) mod panics;
pub(in crate::daemon) mod runtime;
pub(in crate::daemon) mod signals;
pub(in crate::daemon) mod socket;
pub(in crate::daemon) mod sums;
