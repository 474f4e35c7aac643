//! Predicts the afferent response to plays from their measured bursts: one play at a time, on its own thread.
//!
//! Only this module and the renderer of live targets run the skin model (crates/skin and crates/paper) in the streaming
//! process. That is safe:
//! - The thread has nice [`NICE`]; the streamer has real-time priority or nice 0, and its own memory and queues. They share no lock.
//! - The work is bounded: only a play's first minute counts, at most [`WAITING`] plays wait with at most [`WAITING_BURSTS`] bursts,
//!   and further plays get [`NoPrediction::Busy`].
//! - Nothing waits for a prediction: a play's `ended` event comes before it, and the daemon ends without it.
//!
//! Fitting a calibration uses the same thread ([`Predictor::compute`]).

use crate::daemon::state::MeasuredPlay;
use crate::receipts::{NoPrediction, PlayedPattern};
use meissner_api::PredictedResponse;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tracing::error;

/// The most waiting plays, including the current one: as many as may be queued.
const WAITING: usize = 16;
/// The most bursts of all waiting plays: more than a minute of the paper's motors at 300 Hz, 25 MB.
const WAITING_BURSTS: usize = 1 << 20;
/// The thread gets a ninth of the processor time of a thread with nice 0. At 19 a busy machine would hardly run it.
const NICE: i32 = 10;

/// The response to a play.
fn response(play: MeasuredPlay) -> Result<PredictedResponse, NoPrediction> {
    PlayedPattern::of(&play.receipt, &play.pattern, play.options)?.response(&play.bursts)
}

/// The thread, and how many plays wait for it.
#[derive(Debug)]
pub(in crate::daemon) struct Predictor {
    pool: ThreadPool,
    waiting: Arc<Waiting>,
}

#[derive(Debug, Default)]
struct Waiting {
    plays: AtomicUsize,
    bursts: AtomicUsize,
}

impl Waiting {
    /// Counts a play, if there is a place for it.
    fn add(&self, bursts: usize) -> bool {
        let plays = self.plays.fetch_add(1, Ordering::Relaxed);
        let waiting = self.bursts.fetch_add(bursts, Ordering::Relaxed);
        let fits = plays < WAITING && waiting + bursts <= WAITING_BURSTS;
        if !fits {
            self.remove(bursts);
        }
        fits
    }

    fn remove(&self, bursts: usize) {
        self.plays.fetch_sub(1, Ordering::Relaxed);
        self.bursts.fetch_sub(bursts, Ordering::Relaxed);
    }
}

impl Predictor {
    pub(in crate::daemon) fn new() -> Result<Self, ThreadPoolBuildError> {
        let start = |_| {
            // On Linux this applies to the calling thread only. If the system refuses, the thread has nice 0, still below the
            // streamer.
            let _ = rustix::process::nice(NICE);
        };
        let pool = ThreadPoolBuilder::new()
            .panic_handler(|_| error!("internal error: the response to a play could not be predicted"))
            .num_threads(1)
            .thread_name(|_| "predictor".into())
            .start_handler(start);
        Ok(Self { pool: pool.build()?, waiting: Arc::default() })
    }

    /// Runs work for which nothing waits.
    pub(in crate::daemon) fn compute(&self, work: impl FnOnce() + Send + 'static) {
        self.pool.spawn(work);
    }

    /// Predicts the response to a play after the waiting ones, and reports the result, unless `cancelled` returns true by then.
    pub(in crate::daemon) fn predict(
        &self,
        play: MeasuredPlay,
        cancelled: impl FnOnce() -> bool + Send + 'static,
        report: impl FnOnce(Result<PredictedResponse, NoPrediction>) + Send + 'static,
    ) {
        let bursts = play.bursts.len();
        if !play.telemetry {
            report(Err(NoPrediction::NoTelemetry));
        } else if !self.waiting.add(bursts) {
            report(Err(NoPrediction::Busy));
        } else {
            let waiting = Arc::clone(&self.waiting);
            self.pool.spawn(move || {
                if !cancelled() {
                    report(response(play));
                }
                waiting.remove(bursts);
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_stream::queues::MeasuredBurst;

    #[test]
    fn plays_that_wait_are_bounded_in_number_and_in_bursts() {
        let waiting = Waiting::default();
        assert!((0..WAITING).all(|_| waiting.add(0)) && !waiting.add(0));
        (0..WAITING).for_each(|_| waiting.remove(0));
        assert!(waiting.add(WAITING_BURSTS) && !waiting.add(1) && waiting.add(0));
        assert_eq!(size_of::<MeasuredBurst>(), 24, "25 MB for those that wait");
        waiting.remove(WAITING_BURSTS);
        assert!(waiting.add(WAITING_BURSTS - 1) && waiting.add(1));
    }
}
