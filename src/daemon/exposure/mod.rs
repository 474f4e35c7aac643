//! What a participant may get: the vibration's sums and limits, and the strokes that the controller takes.

pub(in crate::daemon) mod limits;
pub(in crate::daemon) mod rules;
pub(in crate::daemon) mod state;
pub(in crate::daemon) mod sums;
