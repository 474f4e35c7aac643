//! The strokes of one drive: which there are, and at which ticks.
//!
//! The streamer's lanes, the skin simulation and the simulated runs of one motor all take a drive's strokes from
//! [`DriveStrokes`], so what is simulated is what is sent. A stroke belongs to a drive if its down burst has ended by
//! the drive's `stop_s`. Later strokes end later, so the first stroke that does not fit ends the sequence.
//!
//! Invariant: strokes are in order of time and do not overlap.

use crate::motor::{Excursion, Excursions, MotorError};
use crate::pattern::Drive;
use crate::units::seconds_to_ticks;

/// A tick that does not come.
pub(super) const NEVER: u64 = u64::MAX;

/// The strokes of one drive in order of time, in ticks of pattern time.
#[derive(Clone, Debug)]
pub struct DriveStrokes {
    start: u64,
    stop: u64,
    excursions: Excursions,
}

impl DriveStrokes {
    /// The strokes of a drive; none if its amplitude is less than half a pulse.
    ///
    /// # Errors
    /// If a number is out of the motor's range, which in a checked pattern none is.
    pub fn of(drive: &Drive) -> Result<Self, MotorError> {
        let wave = drive.wave()?;
        let stop = drive.stop_s.map_or(NEVER, seconds_to_ticks);
        Ok(Self {
            start: seconds_to_ticks(drive.start()),
            stop: if wave.moves() { stop } else { 0 },
            excursions: wave.excursions(),
        })
    }

    /// The same strokes `ticks` later, as far as they have ended by `end`.
    #[must_use]
    pub fn shifted(&self, ticks: u64, end: u64) -> Self {
        Self {
            start: self.start.saturating_add(ticks),
            stop: if self.stop == 0 { 0 } else { self.stop.saturating_add(ticks).min(end) },
            excursions: self.excursions.clone(),
        }
    }

    /// When the drive begins.
    pub(super) const fn start(&self) -> u64 {
        self.start
    }
}

impl Iterator for DriveStrokes {
    type Item = Excursion;

    #[inline]
    fn next(&mut self) -> Option<Excursion> {
        let Excursion { up, down, pulses } = self.excursions.next()?;
        let (up, down) = (self.start.saturating_add(up), self.start.saturating_add(down));
        let stroke = Excursion { up, down, pulses };
        if stroke.end() > self.stop {
            self.stop = 0;
            return None;
        }
        Some(stroke)
    }
}
