//! Sessions and rights: who acts ([`caller`]), what they may do ([`rights`], [`right`]), and the running session ([`state`]);
//! [`rules`] decide.

pub(in crate::daemon) mod caller;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod right;
pub(in crate::daemon) mod rights;
pub(in crate::daemon) mod rules;
pub(in crate::daemon) mod state;
