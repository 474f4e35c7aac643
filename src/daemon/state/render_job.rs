//! A pose that a client of a live target has sent, on its way to the renderer.

use meissner_api::LivePose;
use meissner_design::Pose;
use meissner_stream::time::HostInstant;

/// A pose to render.
#[derive(Debug)]
pub(in crate::daemon) struct Job {
    /// The client's number of the message.
    pub(in crate::daemon) seq: u64,
    pub(in crate::daemon) received_at: HostInstant,
    pub(in crate::daemon) pose: Pose,
    /// A new scale, and the number of the message that had it.
    pub(in crate::daemon) scale: Option<(u64, f64)>,
}

/// Converts a pose to the search's type.
pub(in crate::daemon) const fn pose(of: LivePose) -> Pose {
    let LivePose { x_mm, y_mm, angle_deg, .. } = of;
    Pose { x_mm, y_mm, angle_deg }
}
