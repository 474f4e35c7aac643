//! What one motor does in a scene: made when somebody first asks for it, and kept for whoever asks next.
//!
//! Who evaluates a scene again and again with other drives of a few motors does not make the other motors' breaks,
//! samples and charges again. They are kept only up to [`MOST_KEPT`] bytes for all motors; beyond, who asks is told
//! that there is none, and makes them as he goes.
//!
//! Making one of them uses one thread, so that nobody who waits for it is waited for.
//!
//! Invariant: a track depends on its motor's drives or ramps, the scene's duration and membrane, and the method.

use super::breaks::{Break, Breaks, end};
use super::lanes::Number;
use super::sampler::Sampler;
use super::silent::Bound;
use super::stepped::TILE;
use super::{Method, Scene, horizon};
use firmware_protocol::stroke::MOTORS;
use meissner_array::motor::Ramp;
use meissner_array::pattern::Drive;
use meissner_array::units::HALF_TICKS_PER_S;
use std::sync::{Arc, OnceLock};

/// Bytes of what is kept of all the motors of a scene: a minute of fast strokes or of steps. An evaluator keeps no more of
/// its receptors, either.
pub(super) const MOST_KEPT: usize = 16 << 20;

/// The tracks of a scene's motors; none: it never moves.
pub(super) type Tracks = [Option<Arc<Track>>; MOTORS];

/// What one motor does.
#[derive(Debug)]
pub(super) struct Track {
    motor: u8,
    moved_by: MovedBy,
    duration_s: f64,
    /// At most about so many breaks in a second.
    per_s: f64,
    method: Method,
    list: OnceLock<Vec<Break>>,
    samples: Samples,
    charge: OnceLock<f64>,
}

/// What moves it, in order of time.
#[derive(Debug)]
enum MovedBy {
    Drives(Vec<Drive>),
    /// Ramps, and the speed that counts as full.
    Ramps(Arc<Vec<Ramp>>, f64),
}

/// A motor's samples of all steps, in one precision or the other.
#[derive(Debug, Default)]
pub(super) struct Samples {
    pub(super) single: OnceLock<Vec<f32>>,
    pub(super) double: OnceLock<Vec<f64>>,
}

/// All of a scene.
pub(super) fn of_scene(scene: &Scene, method: Method) -> Tracks {
    std::array::from_fn(|motor| Track::new(scene, method, motor as u8).map(Arc::new))
}

impl Track {
    /// A motor's, if it moves.
    pub(super) fn new(scene: &Scene, method: Method, motor: u8) -> Option<Self> {
        let moves = |drive: &&Drive| drive.wave().is_ok_and(|wave| wave.wanted_pulses() > 0);
        let of_motor = scene.drives().iter().filter(|drive| drive.motor == motor);
        let mut drives: Vec<_> = of_motor.filter(moves).copied().collect();
        drives.sort_by(|a, b| a.start().total_cmp(&b.start()));
        // One at a time: the fastest bounds them all.
        let per_s = drives.iter().map(|drive| 8.0 * drive.frequency_hz).fold(0.0, f64::max);
        let moved_by = MovedBy::Drives(drives);
        (per_s > 0.0).then(|| Self::moved(motor, moved_by, per_s, scene.duration_s(), method))
    }

    /// A motor's that made some ramps, for the exact method.
    pub(super) fn of_ramps(
        motor: u8,
        ramps: &Arc<Vec<Ramp>>,
        full_um_per_tick: f64,
        duration_s: f64,
    ) -> Self {
        // Four breaks each, in time that is watched and the window after it.
        let per_s = 4.0 * ramps.len() as f64 / duration_s.max(1.0 / HALF_TICKS_PER_S);
        let moved_by = MovedBy::Ramps(Arc::clone(ramps), full_um_per_tick);
        Self::moved(motor, moved_by, per_s, duration_s, Method::Exact)
    }

    fn moved(motor: u8, moved_by: MovedBy, per_s: f64, duration_s: f64, method: Method) -> Self {
        let (list, samples, charge) = (OnceLock::new(), Samples::default(), OnceLock::new());
        Self { motor, moved_by, duration_s, per_s, method, list, samples, charge }
    }

    pub(super) const fn motor(&self) -> u8 {
        self.motor
    }

    /// At most about so many breaks in a second.
    pub(super) const fn per_s(&self) -> f64 {
        self.per_s
    }

    /// All its breaks, made as they are asked for.
    pub(super) fn breaks(&self) -> Breaks<'_> {
        let end = end(self.duration_s);
        match &self.moved_by {
            MovedBy::Drives(drives) => Breaks::new(self.motor, drives, end),
            MovedBy::Ramps(ramps, full_um_per_tick) => {
                Breaks::of_ramps(self.motor, ramps, *full_um_per_tick, end)
            }
        }
    }

    /// All its breaks, if they are few enough.
    pub(super) fn list(&self) -> Option<&[Break]> {
        let few = self.per_s * self.duration_s * size_of::<Break>() as f64 <= (MOST_KEPT / MOTORS) as f64;
        few.then(|| &**self.list.get_or_init(|| self.breaks().collect()))
    }

    /// None for a method without steps.
    pub(super) fn sampler(&self) -> Option<Sampler<'_>> {
        Sampler::new(self.breaks(), self.method)
    }

    /// The samples of all steps, in whole tiles, if they are few enough.
    pub(super) fn samples<T: Number>(&self) -> Option<&[T]> {
        let mut sampler = self.sampler()?;
        let steps = sampler.steps(self.duration_s);
        let few = steps * size_of::<T>() as u64 <= (MOST_KEPT / MOTORS) as u64;
        few.then(|| {
            &**T::kept(&self.samples).get_or_init(|| {
                let mut samples = Vec::with_capacity((steps as usize).next_multiple_of(TILE));
                sampler.fill(0, steps as usize, &mut samples);
                samples
            })
        })
    }

    /// The highest charge it leaves on a membrane at weight 1, as far as the first `breaks` breaks say, or more.
    pub(super) fn charge(&self, bound: &Bound, breaks: usize) -> f64 {
        let horizon = horizon(self.duration_s, self.method);
        let all = breaks as f64 >= self.per_s * self.duration_s;
        let before = self.breaks().take_while(|found| found.at < horizon);
        match self.charge.get() {
            Some(&charge) => charge,
            None if all => *self.charge.get_or_init(|| bound.charge(before, Some(horizon))),
            None => bound.charge(before.take(breaks), None),
        }
    }
}

/// A motor's samples, a block of steps at a time.
pub(super) enum Column<'c, T> {
    /// All of them, and those of the block.
    Kept(&'c [T], &'c [T]),
    /// There are too many to be kept: those of the block.
    Made(Sampler<'c>, Vec<T>),
}

impl<'c, T: Number> Column<'c, T> {
    /// None if the motor is not stepped.
    pub(super) fn of(track: &'c Track) -> Option<Self> {
        match track.samples() {
            Some(samples) => Some(Self::Kept(samples, &[])),
            None => Some(Self::Made(track.sampler()?, Vec::new())),
        }
    }

    /// To the block of so many steps from number `first` on. Blocks are asked for in their order.
    pub(super) fn go_to(&mut self, first: u64, steps: usize) {
        match self {
            Self::Kept(all, now) => *now = &all[first as usize..][..steps.next_multiple_of(TILE)],
            Self::Made(sampler, now) => sampler.fill(first, steps, now),
        }
    }

    /// The samples of the block, in whole tiles.
    pub(super) fn now(&self) -> &[T] {
        match self {
            Self::Kept(_, now) => now,
            Self::Made(_, now) => now,
        }
    }
}
