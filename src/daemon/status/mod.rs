//! What the daemon tells about itself: status, events, metrics, the doctor's report.

pub(in crate::daemon) mod doctor;
pub(in crate::daemon) mod events;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod metrics;
pub(in crate::daemon) mod report;
