//! Live plays, which a client moves by messages over a connection.

pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod play;
pub(in crate::daemon) mod state;
