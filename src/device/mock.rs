//! PLACEHOLDER
use crate::plant::RestStats;

/// The plant's truth.
#[derive(Debug)]
pub struct Truth;

impl Truth {
    /// Figures so far.
    pub fn rest(&self) -> RestStats {
        RestStats::default()
    }
}
