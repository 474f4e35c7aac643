//! Progress of work that has several parts.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts finished parts, on any thread.
pub(crate) struct Parts<'a> {
    all: usize,
    done: AtomicUsize,
    progress: &'a (dyn Fn(f64) + Sync),
}

impl<'a> Parts<'a> {
    pub(crate) fn new(all: usize, progress: &'a (dyn Fn(f64) + Sync)) -> Self {
        Self { all, done: AtomicUsize::new(0), progress }
    }

    pub(crate) fn done(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        (self.progress)(done as f64 / self.all as f64);
    }
}
