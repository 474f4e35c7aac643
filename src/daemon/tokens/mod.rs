//! Access tokens: their file, and their handlers.

pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod store;
