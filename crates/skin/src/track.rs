//! One motor's part in a scene: its breakpoints, its samples, and its highest charge.
//!
//! A [`Track`] computes each of them at first use, and keeps it. So an evaluator that changes some motors again and again does not
//! compute the others again. Tracks keep at most [`MAX_KEPT_BYTES`] for all motors; larger data is computed as it is read.
//!
//! The computation uses one thread, so there is no deadlock.
//!
//! Invariant: a track depends on its motor's drives or ramps, the scene's duration and membrane, and the method.

use crate::breakpoints::{Breakpoint, Breakpoints, InOrder, ramps_before, ramps_of};
use crate::membrane::silence::Bound;
use crate::method::{Method, Stepping};
use crate::sampler::{Sampler, TILE};
use crate::scene::Scene;
use crate::time::end;
use meissner_array::motor::Ramp;
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use std::sync::{Arc, OnceLock};

/// The most bytes that all tracks of a scene keep: a minute of fast strokes or of steps. An evaluator keeps the same amount for its
/// afferents.
pub(crate) const MAX_KEPT_BYTES: usize = 16 << 20;

/// The tracks of a scene's motors; none if the motor never moves.
pub(crate) type Tracks = Vec<Option<Arc<Track>>>;

/// One motor's part in a scene.
#[derive(Debug)]
pub(crate) struct Track {
    array: Array,
    motor: u8,
    moved_by: MovedBy,
    duration_s: f64,
    /// Approximate upper bound of breakpoints per second.
    breakpoints_per_s: f64,
    method: Method,
    list: OnceLock<Vec<Breakpoint>>,
    /// The samples of all steps, if they are few enough to keep.
    samples: OnceLock<Vec<f64>>,
    charge: OnceLock<f64>,
}

/// The motor's drives or ramps, in order of time.
#[derive(Debug)]
enum MovedBy {
    Drives(Vec<Drive>),
    /// Ramps, and the speed that counts as full, µm per tick.
    Ramps(Arc<Vec<Ramp>>, f64),
}

/// The tracks of a scene.
pub(crate) fn of_scene(scene: &Scene, method: Method) -> Tracks {
    of_drives(scene.array(), scene.drives(), scene.duration_s(), method)
}

/// The tracks of an array whose motors have these drives.
pub(crate) fn of_drives(array: Array, drives: &[Drive], duration_s: f64, method: Method) -> Tracks {
    let track = |motor| Track::of_drives(array, motor, drives, duration_s, method).map(Arc::new);
    array.numbers().map(track).collect()
}

impl Track {
    /// A motor's track, if it moves.
    pub(crate) fn of_drives(
        array: Array,
        motor: u8,
        drives: &[Drive],
        duration_s: f64,
        method: Method,
    ) -> Option<Self> {
        let moves = |drive: &&Drive| drive.wave(array).is_ok_and(|wave| wave.moves());
        let of_motor = drives.iter().filter(|drive| drive.motor == motor);
        let mut drives: Vec<_> = of_motor.filter(moves).copied().collect();
        drives.sort_by(|a, b| a.start().total_cmp(&b.start()));
        // A motor's drives do not overlap, so the fastest gives the bound.
        let breakpoints_per_s = drives.iter().map(|drive| 8.0 * drive.frequency_hz).fold(0.0, f64::max);
        let moved_by = MovedBy::Drives(drives);
        (breakpoints_per_s > 0.0)
            .then(|| Self::moved(array, motor, moved_by, breakpoints_per_s, duration_s, method))
    }

    /// The track of a motor that made some ramps.
    pub(crate) fn of_ramps(
        array: Array,
        motor: u8,
        ramps: &Arc<Vec<Ramp>>,
        full_um_per_tick: f64,
        duration_s: f64,
    ) -> Self {
        // A ramp has four breakpoints, within the scene or the window after it.
        let breakpoints_per_s =
            4.0 * ramps.len() as f64 / duration_s.max(1.0 / array.rate().half_ticks_per_s());
        let moved_by = MovedBy::Ramps(Arc::clone(ramps), full_um_per_tick);
        Self::moved(array, motor, moved_by, breakpoints_per_s, duration_s, Method::Exact)
    }

    fn moved(
        array: Array,
        motor: u8,
        moved_by: MovedBy,
        breakpoints_per_s: f64,
        duration_s: f64,
        method: Method,
    ) -> Self {
        let (list, samples, charge) = (OnceLock::new(), OnceLock::new(), OnceLock::new());
        Self { array, motor, moved_by, duration_s, breakpoints_per_s, method, list, samples, charge }
    }

    pub(crate) const fn motor(&self) -> u8 {
        self.motor
    }

    /// Approximate upper bound of breakpoints per second.
    pub(crate) const fn breakpoints_per_s(&self) -> f64 {
        self.breakpoints_per_s
    }

    /// All breakpoints, made as they are read.
    pub(crate) fn breakpoints(&self) -> Breakpoints<'_> {
        let (ramps, full_um_per_tick) = self.ramps();
        Breakpoints::of(self.array, self.motor, ramps, full_um_per_tick)
    }

    /// All ramps, and the speed that counts as full, µm per tick.
    fn ramps(&self) -> (InOrder<'_>, f64) {
        let end = end(self.duration_s, self.array.rate());
        match &self.moved_by {
            MovedBy::Drives(drives) => (ramps_of(self.array, drives, end), self.array.motor().um_per_pulse),
            MovedBy::Ramps(ramps, full_um_per_tick) => (ramps_before(ramps, end), *full_um_per_tick),
        }
    }

    /// All breakpoints as a list, if they are few enough to keep.
    pub(crate) fn list(&self) -> Option<&[Breakpoint]> {
        let few = self.breakpoints_per_s * self.duration_s * size_of::<Breakpoint>() as f64
            <= self.most_kept_bytes() as f64;
        few.then(|| &**self.list.get_or_init(|| self.breakpoints().collect()))
    }

    /// Its share of the bytes that all tracks keep.
    fn most_kept_bytes(&self) -> usize {
        MAX_KEPT_BYTES / self.array.motors()
    }

    /// None for a method without steps.
    pub(crate) fn sampler(&self) -> Option<Sampler<'_>> {
        let Method::Stepped(stepping) = self.method else { return None };
        Some(self.sampled(stepping))
    }

    /// The samples of these steps.
    pub(crate) fn sampled(&self, stepping: Stepping) -> Sampler<'_> {
        Sampler::new(self.breakpoints(), stepping, self.array.rate())
    }

    /// The samples of all steps, in whole tiles, if they are few enough to keep.
    pub(crate) fn samples(&self) -> Option<&[f64]> {
        let mut sampler = self.sampler()?;
        let steps = sampler.steps(end(self.duration_s, self.array.rate()));
        let few = steps * size_of::<f64>() as u64 <= self.most_kept_bytes() as u64;
        few.then(|| {
            &**self.samples.get_or_init(|| {
                let mut samples = Vec::with_capacity((steps as usize).next_multiple_of(TILE));
                sampler.fill(0, steps as usize, &mut samples);
                samples
            })
        })
    }

    /// The highest charge on a membrane at weight 1 within at least the first `count` breakpoints.
    pub(crate) fn charge(&self, bound: &Bound, count: usize) -> f64 {
        let horizon = self.method.horizon(self.duration_s, self.array.rate());
        let all = count as f64 >= self.breakpoints_per_s * self.duration_s;
        let before = self.breakpoints().take_while(|found| found.at < horizon);
        match self.charge.get() {
            Some(&charge) => charge,
            None if all => *self.charge.get_or_init(|| bound.charge(before, Some(horizon))),
            None => bound.charge(before.take(count), None),
        }
    }
}

/// A motor's samples, a block of steps at a time.
pub(crate) enum Column<'c> {
    /// The kept samples of all steps, and those of the block.
    Kept(&'c [f64], &'c [f64]),
    /// Too many to keep: their source, and those of the block.
    Made(Sampler<'c>, Vec<f64>),
}

impl<'c> Column<'c> {
    /// None for a method without steps.
    pub(crate) fn of(track: &'c Track) -> Option<Self> {
        match track.samples() {
            Some(samples) => Some(Self::Kept(samples, &[])),
            None => Some(Self::Made(track.sampler()?, Vec::new())),
        }
    }

    /// Goes to the block of `steps` steps from number `first` on. Blocks must be requested in order.
    pub(crate) fn go_to(&mut self, first: u64, steps: usize) {
        match self {
            Self::Kept(all, now) => *now = &all[first as usize..][..steps.next_multiple_of(TILE)],
            Self::Made(sampler, now) => sampler.fill(first, steps, now),
        }
    }

    /// The samples of the block, in whole tiles.
    pub(crate) fn now(&self) -> &[f64] {
        match self {
            Self::Kept(_, now) => now,
            Self::Made(_, now) => now,
        }
    }
}
