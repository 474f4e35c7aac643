//! The strokes of one drive: which there are, and at which ticks.
//!
//! The streamer's lanes, the skin simulation and the simulated runs of one motor all take a drive's strokes from [`DriveStrokes`],
//! so what is simulated is what is sent. A stroke belongs to a drive if its down burst has ended by the drive's `stop_s`. Later
//! strokes end later, so the first stroke that does not fit ends the sequence. Each stroke is computed from its number, so strokes
//! are counted without iterating over them.
//!
//! Invariant: strokes are in order of time and do not overlap.

use super::options::StrokeOptions;
use crate::motor::{Excursion, MotorError, SquareWave};
use crate::pattern::Drive;
use crate::spec::Array;

/// A tick that does not come.
pub(super) const NEVER: u64 = u64::MAX;

/// The strokes of one drive in order of time, in ticks of pattern time.
#[derive(Clone, Debug)]
pub struct DriveStrokes {
    start: u64,
    stop: u64,
    wave: SquareWave,
    /// The number of the next stroke.
    next: u64,
}

impl DriveStrokes {
    /// The strokes of a drive; none if its amplitude is less than half a pulse.
    ///
    /// # Errors
    /// If a number is out of the motor's range, which in a checked pattern none is.
    pub fn of(array: Array, drive: &Drive) -> Result<Self, MotorError> {
        Ok(Self::playing(drive, drive.wave(array)?))
    }

    /// The strokes of a drive with the scale and the surplus of these options.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn with(array: Array, drive: &Drive, options: &StrokeOptions) -> Result<Self, MotorError> {
        let wave =
            SquareWave::new(array, drive.frequency_hz, drive.amplitude_um * options.scale, drive.phase)?;
        let gain = wave.mean_gain();
        let surplus = |pulses| options.surplus.pulses(array, drive.motor, pulses, gain);
        Ok(Self::playing(drive, wave.with_surplus(surplus)))
    }

    fn playing(drive: &Drive, wave: SquareWave) -> Self {
        let rate = wave.array().rate();
        let stop = drive.stop_s.map_or(NEVER, |stop_s| rate.seconds_to_ticks(stop_s));
        Self {
            start: rate.seconds_to_ticks(drive.start()),
            stop: if wave.moves() { stop } else { 0 },
            wave,
            next: 0,
        }
    }

    /// The same strokes `ticks` later, as far as they have ended by `end`.
    pub fn shifted(&self, ticks: u64, end: u64) -> Self {
        Self {
            start: self.start.saturating_add(ticks),
            stop: if self.stop == 0 { 0 } else { self.stop.saturating_add(ticks).min(end) },
            ..*self
        }
    }

    /// Their wave, in ticks of the drive's own time.
    pub const fn wave(&self) -> &SquareWave {
        &self.wave
    }

    /// When the drive begins.
    pub(super) const fn start(&self) -> u64 {
        self.start
    }

    /// Pulses by which the down burst of a stroke is longer than its up burst of so many pulses.
    pub(super) fn surplus(&self, pulses: u16) -> u16 {
        // The controller's bound is far below.
        u16::try_from(self.wave.surplus(pulses.into())).unwrap_or(u16::MAX)
    }

    /// The stroke of this number, counted from the beginning of the drive, whether or not it has ended by its end.
    pub(super) fn number(&self, number: u64) -> Excursion {
        let Excursion { up, down, pulses, surplus } = self.wave.excursion(number);
        let [up, down] = [up, down].map(|tick| self.start.saturating_add(tick));
        Excursion { up, down, pulses, surplus }
    }

    /// How many of the strokes begin before this tick. Takes some 100 steps.
    pub(super) fn begun_before(&self, before: u64) -> u64 {
        let is_one = |number| {
            let stroke = self.number(number);
            stroke.up < before && stroke.end() <= self.stop
        };
        if !is_one(0) {
            return 0;
        }
        // A number whose stroke begins before the tick, and one whose stroke does not; at 2^62 every edge is saturated.
        let (mut one, mut none) = (0, 1);
        while none < 1 << 62 && is_one(none) {
            (one, none) = (none, 2 * none);
        }
        while one + 1 < none {
            let middle = u64::midpoint(one, none);
            if is_one(middle) { one = middle } else { none = middle }
        }
        none
    }
}

impl Iterator for DriveStrokes {
    type Item = Excursion;

    #[inline]
    fn next(&mut self) -> Option<Excursion> {
        let stroke = self.number(self.next);
        self.next += 1;
        if stroke.end() > self.stop {
            self.stop = 0;
            return None;
        }
        Some(stroke)
    }
}
