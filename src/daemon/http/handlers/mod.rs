//! The handlers, a file for each resource.

pub(super) mod calibration;
pub(super) mod events;
pub(super) mod live;
pub(super) mod metrics;
pub(super) mod motors;
pub(super) mod patterns;
pub(super) mod plays;
pub(super) mod previews;
pub(super) mod renderings;
pub(super) mod sessions;
pub(super) mod status;
pub(super) mod tokens;
