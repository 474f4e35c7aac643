//! What the daemon tells about itself: status, events, the doctor's report.

pub(in crate::daemon) mod events;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod report;
