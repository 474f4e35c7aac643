//! Renders live targets: a thread for each turns the newest pose of its shape into drives, within a time.
//!
//! The thread has [`NICE`], and so have the threads that it searches with: the streamer has real-time priority or nice 0, and waits for
//! none of them. While it renders, the pins play on; of the poses that come meanwhile the newest wins.
//!
//! Bounds: one pose waits. Invariant: the thread ends with its play.

use super::engine::Engine;
use meissner_api::LivePose;
use meissner_design::{Limit, LiveBrief, Pose, RenderError, Renderer, Target};
use meissner_stream::time::HostInstant;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Below everything that clients wait for, above the predictor: a finger waits.
const NICE: i32 = 5;
/// Threads that search, at most.
const THREADS: usize = 4;
/// What is left of an update's time for the rest of its way.
const SPARE: Duration = Duration::from_millis(1);

/// A pose to render.
#[derive(Debug)]
pub(super) struct Job {
    /// The client's number of the message.
    pub(super) seq: u64,
    pub(super) received_at: HostInstant,
    pub(super) pose: Pose,
    /// A new scale, and the number of the message that had it.
    pub(super) scale: Option<(u64, f64)>,
}

#[derive(Debug, Default)]
struct Slot {
    job: Option<Job>,
    closed: bool,
}

/// The pose that waits.
#[derive(Debug, Default)]
pub(super) struct Poses {
    slot: Mutex<Slot>,
    changed: Condvar,
}

/// A pose as the search has it.
pub(super) const fn pose(of: LivePose) -> Pose {
    let LivePose { x_mm, y_mm, angle_deg } = of;
    Pose { x_mm, y_mm, angle_deg }
}

impl Poses {
    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Puts a pose in the place of the one that waits, and returns that one. Its scale stays.
    pub(super) fn put(&self, mut job: Job) -> Option<Job> {
        let mut slot = self.lock();
        let before = slot.job.take();
        job.scale = job.scale.or(before.as_ref().and_then(|before| before.scale));
        slot.job = Some(job);
        drop(slot);
        self.changed.notify_one();
        before
    }

    /// The play is over.
    pub(super) fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_one();
    }

    /// Waits for a pose; none once the play is over.
    fn take(&self) -> Option<Job> {
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

/// A renderer and the threads that it searches with, before its play begins.
#[derive(Debug)]
pub(super) struct Prepared {
    renderer: Renderer,
    pool: ThreadPool,
    budget: Duration,
}

impl Prepared {
    /// A renderer for a target. Takes tens of milliseconds.
    ///
    /// # Errors
    /// If the target cannot be rendered, or the system gives no threads.
    pub(super) fn new(target: &Target, brief: LiveBrief, budget: Duration) -> Result<Self, PrepareError> {
        let threads = thread::available_parallelism().map_or(1, usize::from).min(THREADS);
        let start = |_| {
            // If the system refuses, they have nice 0, still below the streamer.
            let _ = rustix::process::nice(NICE);
        };
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|_| "render".into())
            .start_handler(start);
        let pool = pool.build().map_err(io::Error::other)?;
        let renderer = pool.install(|| Renderer::new(target, brief))?;
        Ok(Self { renderer, pool, budget })
    }

    /// The drives at a pose, searched for ten times as long as an update takes.
    ///
    /// # Errors
    /// If the pose is out of its range.
    pub(super) fn first(&mut self, pose: Pose) -> Result<Vec<meissner_array::pattern::Drive>, RenderError> {
        let Self { renderer, pool, budget } = self;
        let limit = Limit::Until(Instant::now() + 10 * *budget);
        pool.install(|| renderer.render(pose, limit)).map(|rendered| rendered.drives)
    }

    /// Starts the thread for the play of this id.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(super) fn start(self, engine: Arc<Engine>, id: u64, poses: Arc<Poses>) -> io::Result<()> {
        let Self { mut renderer, pool, budget } = self;
        let work = move || {
            let _ = rustix::process::nice(NICE);
            while let Some(job) = poses.take() {
                let limit = Limit::Until(Instant::now() + budget.saturating_sub(SPARE));
                // Poses are checked when they come.
                if let Ok(rendered) = pool.install(|| renderer.render(job.pose, limit)) {
                    engine.lock().live_rendered(id, &job, &rendered.drives);
                }
            }
        };
        thread::Builder::new().name("renderer".into()).spawn(work).map(|_| ())
    }
}

/// Why a target is not rendered.
#[derive(Debug, thiserror::Error)]
pub(super) enum PrepareError {
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("the threads that search cannot start: {0}")]
    Threads(#[from] io::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

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
