//! The motors' calibration: [`play`] plays a plan, [`apply`] fits, stores and applies it, [`stored`] is its file.
//!
//! [`Calibration`] is the one in use, its file, and the one that is being measured. Invariant: gains are those of the connected device, or
//! none.

pub(in crate::daemon) mod apply;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod play;
pub(in crate::daemon) mod stored;

use crate::daemon::calibration::stored::{CalibrationRun, StoredCalibration};
use meissner_stream::queues::MeasuredBurst;
use std::path::PathBuf;

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Calibration {
    /// Where it is stored.
    pub(in crate::daemon) file: Option<PathBuf>,
    /// The stored calibration, or why there is none.
    pub(in crate::daemon) stored: Result<StoredCalibration, String>,
    /// The identity of the device that was connected last.
    pub(in crate::daemon) identity: String,
    /// A plan that is being played, measured or fitted: no play is accepted meanwhile.
    pub(in crate::daemon) running: Option<CalibrationRun>,
    /// Whether the streamer has gains.
    pub(in crate::daemon) gains_set: bool,
}

impl Calibration {
    pub(in crate::daemon) fn new(file: Option<PathBuf>) -> Self {
        Self { file, stored: Err(String::new()), identity: String::new(), running: None, gains_set: false }
    }

    /// The stored calibration, if it is the connected device's.
    pub(in crate::daemon) fn in_use(&self) -> Option<&StoredCalibration> {
        self.stored.as_ref().ok().filter(|stored| stored.unused.is_none())
    }

    /// Adds a measured burst to the plan that is being played.
    pub(in crate::daemon) fn add(&mut self, burst: MeasuredBurst) {
        if let Some(running) = &mut self.running {
            running.add(burst);
        }
    }

    /// Whether this play is being measured.
    pub(in crate::daemon) fn is_running(&self, play: u64) -> bool {
        self.running.as_ref().is_some_and(|running| running.id == play)
    }

    /// Cancels the calibration that this play was to measure.
    pub(in crate::daemon) fn cancel(&mut self, play: u64) {
        self.running.take_if(|running| running.id == play);
    }
}
