//! The motors' calibration: [`play`] plays a plan, [`apply`] fits, stores and applies it, [`stored`] is its file.

pub(in crate::daemon) mod apply;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod play;
pub(in crate::daemon) mod state;
pub(in crate::daemon) mod stored;
