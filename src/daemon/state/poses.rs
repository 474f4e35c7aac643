//! The pose that waits to be rendered: a newer one takes its place.
//!
//! The connection of a live play calls [`Poses::put`], the renderer's thread [`Poses::take`]. `tests/races` explores their interleavings.
//!
//! Invariant: the newest pose is rendered, unless the play ends first; no scale is lost.

use crate::daemon::state::render_job::Job;
use meissner_stream::sync::{Condvar, Mutex, MutexGuard};
use std::sync::PoisonError;

#[derive(Debug, Default)]
struct Slot {
    job: Option<Job>,
    closed: bool,
}

/// The pose that waits.
#[derive(Debug, Default)]
pub(crate) struct Poses {
    slot: Mutex<Slot>,
    changed: Condvar,
}

impl Poses {
    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces the waiting pose, and returns it. Its scale is kept.
    pub(crate) fn put(&self, mut job: Job) -> Option<Job> {
        let mut slot = self.lock();
        let before = slot.job.take();
        job.scale = job.scale.or(before.as_ref().and_then(|before| before.scale));
        slot.job = Some(job);
        drop(slot);
        self.changed.notify_one();
        before
    }

    /// The play is over.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }

    /// Waits for a pose; none once the play is over.
    pub(crate) fn take(&self) -> Option<Job> {
        let mut slot = self.lock();
        loop {
            if slot.closed {
                return None;
            }
            if let Some(job) = slot.job.take() {
                return Some(job);
            }
            slot = self.changed.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_design::Pose;
    use meissner_stream::time::HostInstant;
    use std::sync::Arc;
    use std::thread;

    #[test]
    fn the_newest_pose_wins_and_the_end_wakes() {
        let poses = Arc::new(Poses::default());
        let job = |seq| Job {
            seq,
            received_at: HostInstant::default(),
            pose: Pose::default(),
            scale: (seq == 1).then_some((1, 0.5)),
        };
        assert!(poses.put(job(1)).is_none());
        assert_eq!(poses.put(job(2)).unwrap().seq, 1);
        let taken = poses.take().unwrap();
        assert_eq!((taken.seq, taken.scale), (2, Some((1, 0.5))));
        let waiting = Arc::clone(&poses);
        let waits = thread::spawn(move || waiting.take().is_none());
        poses.close();
        assert!(waits.join().unwrap());
    }
}
