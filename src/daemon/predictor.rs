//! What was felt of plays is computed here, on a thread of its own: one play at a time, the rest waits.
//!
//! The thread yields to all others, and nobody waits for it: a play's `ended` comes before, the daemon's end does not.
//!
//! Invariant: no more than [`WAITING`] plays wait; of any more it is said that they were not looked at.

use super::engine::Engine;
use crate::receipts::{NoPrediction, PlayedPattern};
use meissner_api::Receipt;
use meissner_array::pattern::Pattern;
use meissner_stream::queues::MeasuredBurst;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tracing::error;

/// Plays that wait, with the one that is looked at: as many as may be queued. Each holds up to a minute of bursts.
const WAITING: usize = 16;
/// A ninth of other threads' claim on the processor: at 19 a busy machine would hardly get to it.
const NICE: i32 = 10;

/// A play to be looked at.
#[derive(Debug)]
pub(super) struct Asked {
    pub(super) pattern: Arc<Pattern>,
    pub(super) receipt: Receipt,
    /// Whether its device measured anything.
    pub(super) telemetry: bool,
}

/// The thread, and how many plays it has before it.
#[derive(Debug)]
pub(super) struct Predictor {
    pool: ThreadPool,
    waiting: Arc<AtomicUsize>,
}

impl Predictor {
    pub(super) fn new() -> Result<Self, ThreadPoolBuildError> {
        let start = |_| {
            // Of the calling thread, on Linux. If it may not, it is as urgent as any thread but the streamer's.
            let _ = rustix::process::nice(NICE);
        };
        let pool = ThreadPoolBuilder::new()
            .panic_handler(|_| error!("internal error: what was felt of a play could not be computed"))
            .num_threads(1)
            .thread_name(|_| "felt".into())
            .start_handler(start);
        Ok(Self { pool: pool.build()?, waiting: Arc::default() })
    }

    /// Has something else computed that nobody waits for.
    pub(super) fn compute(&self, work: impl FnOnce() + Send + 'static) {
        self.pool.spawn(work);
    }

    /// Looks at a play when those before it are done, and tells the engine.
    pub(super) fn look(&self, engine: &Arc<Engine>, asked: Asked, bursts: Vec<MeasuredBurst>) {
        let id = asked.receipt.id;
        if !asked.telemetry {
            engine.felt(id, Err(NoPrediction::NoTelemetry));
        } else if self.waiting.fetch_add(1, Ordering::Relaxed) >= WAITING {
            self.waiting.fetch_sub(1, Ordering::Relaxed);
            engine.felt(id, Err(NoPrediction::Busy));
        } else {
            let (engine, waiting) = (Arc::clone(engine), Arc::clone(&self.waiting));
            self.pool.spawn(move || {
                if !engine.is_closing() {
                    let Asked { pattern, receipt, .. } = asked;
                    engine.felt(
                        id,
                        PlayedPattern::at(&receipt, &pattern).and_then(|look| look.response(&bursts)),
                    );
                }
                waiting.fetch_sub(1, Ordering::Relaxed);
            });
        }
    }
}
