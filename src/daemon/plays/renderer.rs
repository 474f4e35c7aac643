//! Renders live targets: a thread for each turns the newest pose of its shape into drives, within a time.
//!
//! The thread has [`NICE`], and so have the threads that it searches with; the streamer has real-time priority or nice 0, and waits
//! for none of them. While it renders, the pins play on; only the newest of the poses that come meanwhile is rendered next. When
//! the play is over, some of its poses are [compared](crate::daemon::plays::live_contrast) with searches without a deadline.
//!
//! Bounds: one pose waits (`poses`). Invariant: the thread renders until the end of its play.

use crate::daemon::engine::Engine;
use crate::daemon::plays::live_contrast::PlayedPoses;
use crate::daemon::state::poses::Poses;
use crate::search::{Compare, Job as SearchJob, live_brief};
use meissner_api::LiveRequest;
use meissner_array::pattern::Drive;
use meissner_design::{Limit, LiveBrief, Pose, RenderError, Renderer, Target};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::io;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

/// Lower priority than everything that clients wait for, but higher than the predictor, because a person waits.
const NICE: i32 = 5;
/// Threads that search, at most.
const THREADS: usize = 4;
/// How long the search for the drives of a pose may take, ms, without `budget_ms`.
const BUDGET_MS: f64 = 15.0;
/// The part of an update's time that is reserved for the steps after rendering.
const SPARE: Duration = Duration::from_millis(1);

/// A renderer and the threads that it searches with, before its play begins.
#[derive(Debug)]
pub(in crate::daemon) struct Prepared {
    renderer: Renderer,
    pool: ThreadPool,
    budget: Duration,
    request: LiveRequest,
    played: PlayedPoses,
}

impl Prepared {
    /// A renderer for a target. Takes tens of milliseconds.
    ///
    /// # Errors
    /// If the target cannot be rendered, or the system gives no threads.
    pub(in crate::daemon) fn new(target: &Target, request: &LiveRequest) -> Result<Self, PrepareError> {
        let threads = thread::available_parallelism().map_or(1, usize::from).min(THREADS);
        let start = |_| {
            // If the system refuses, the threads have nice 0, still below the streamer.
            let _ = rustix::process::nice(NICE);
        };
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|_| "render".into())
            .start_handler(start);
        let pool = pool.build().map_err(io::Error::other)?;
        // The API's bound is 300 Hz.
        let most_decihertz = Some((request.most_hz() * 10.0).floor() as u16);
        let brief =
            LiveBrief { most_decihertz, ..live_brief(request.objective, request.model, request.setting) };
        let renderer = pool.install(|| Renderer::new(target, brief))?;
        let budget = Duration::from_secs_f64(request.budget_ms.unwrap_or(BUDGET_MS) / 1000.0);
        Ok(Self { renderer, pool, budget, request: request.clone(), played: PlayedPoses::new() })
    }

    /// The drives at a pose, searched for ten times as long as an update takes.
    ///
    /// # Errors
    /// If the pose is out of its range.
    pub(in crate::daemon) fn first(&mut self, pose: Pose) -> Result<Vec<Drive>, RenderError> {
        let Self { renderer, pool, budget, played, .. } = self;
        let limit = Limit::Until(Instant::now() + 10 * *budget);
        let drives = pool.install(|| renderer.render(pose, limit))?.drives;
        played.add(pose, &drives);
        Ok(drives)
    }

    /// Starts the thread for the play of this id.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub(in crate::daemon) fn start(self, engine: Arc<Engine>, id: u64, poses: Arc<Poses>) -> io::Result<()> {
        let Self { mut renderer, pool, budget, request, mut played } = self;
        let work = move || {
            let _ = rustix::process::nice(NICE);
            let ends_play = EndsPlay { engine: Arc::clone(&engine), id };
            while let Some(job) = poses.take() {
                let limit = Limit::Until(Instant::now() + budget.saturating_sub(SPARE));
                let rendered =
                    pool.install(|| renderer.render(job.pose, limit)).map(|rendered| rendered.drives);
                let is_sent = engine.lock().live_rendered(id, &job, rendered.as_deref());
                if let (Ok(drives), true) = (&rendered, is_sent) {
                    played.add(job.pose, drives);
                }
            }
            drop(ends_play);
            let compare = SearchJob::compare(Compare::new(&request, played.into_kept()), renderer.target());
            drop((renderer, pool));
            engine.compare_live(id, &compare);
        };
        thread::Builder::new().name("renderer".into()).spawn(work).map(|_| ())
    }
}

/// Ends the play when dropped, for example if the thread panics while its client is still active.
struct EndsPlay {
    engine: Arc<Engine>,
    id: u64,
}

impl Drop for EndsPlay {
    fn drop(&mut self) {
        self.engine.end_live(self.id);
    }
}

/// Why a target cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub(in crate::daemon) enum PrepareError {
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error("the threads that search cannot start: {0}")]
    Threads(#[from] io::Error),
}

#[cfg(test)]
mod tests {
    use meissner_api::LIVE_TARGET_LEAST_HZ;
    use meissner_design::LIVE_LEAST_DECIHERTZ;

    #[test]
    fn the_lowest_frequency_is_that_of_the_api() {
        assert_eq!(f64::from(LIVE_LEAST_DECIHERTZ) / 10.0, LIVE_TARGET_LEAST_HZ);
    }
}
