//! Computes cells: all of a plan, or those of a shard that no run has computed yet.
//!
//! [`Run::begin`] reads which cells are done and makes the run's file, [`Run::work`] computes the rest on some threads,
//! [`Run::stop`] ends it from another thread with every finished cell kept. Each thread takes one cell after the other, and
//! computes it alone.
//!
//! Invariant: a cell's row does not depend on threads, shards or earlier runs.

use crate::command::{Outcome, compute};
use crate::directory::{Directory, SweepError};
use crate::plan::Plan;
use crate::run_file::{self, HEARTBEAT, Line, Writer};
use crate::shard::Shard;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

/// The progress of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Cells that were done before.
    pub before: u64,
    /// Cells that this run has computed, including those that failed.
    pub done: u64,
    /// Cells that failed, including those of earlier runs.
    pub failed: u64,
    /// Cells of the shard.
    pub cells: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Run {
    plan: Arc<Plan>,
    missing: Vec<u64>,
    before: u64,
    failed_before: u64,
    /// None if nothing is missing.
    writer: Mutex<Option<Writer>>,
}

impl Run {
    /// Finds the missing cells of a shard. `log` is the log of a job array's task, in the directory.
    ///
    /// # Errors
    /// If files of the directory cannot be read, or the run's own cannot be made.
    pub fn begin(
        directory: &Directory,
        plan: Arc<Plan>,
        shard: Shard,
        log: Option<String>,
    ) -> Result<Self, SweepError> {
        let cells = plan.cells();
        let (mut done, mut failed) = (vec![false; cells as usize], 0);
        for path in directory.run_files()? {
            if is_of_another(&path.file_name().unwrap_or_default().to_string_lossy(), shard) {
                continue;
            }
            run_file::read(directory, &path, |found| {
                let Some(is_done) = done.get_mut(found.cell as usize).filter(|_| shard.has(found.cell))
                else {
                    return;
                };
                if !*is_done {
                    *is_done = true;
                    failed += u64::from(found.error.is_some());
                }
            })?;
        }
        let own = (0..cells).filter(|&cell| shard.has(cell));
        let missing: Vec<u64> = own.clone().filter(|&cell| !done[cell as usize]).collect();
        let before = own.count() as u64 - missing.len() as u64;
        let writer = if missing.is_empty() { None } else { Some(Writer::new(directory, shard, log)?) };
        Ok(Self { plan, missing, before, failed_before: failed, writer: Mutex::new(writer) })
    }

    /// How many of its cells were done before.
    #[must_use]
    pub const fn before(&self) -> u64 {
        self.before
    }

    /// How many cells are missing.
    #[must_use]
    pub fn missing(&self) -> u64 {
        self.missing.len() as u64
    }

    fn writer(&self) -> MutexGuard<'_, Option<Writer>> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the run: finished cells are kept, unfinished ones are dropped. `why` is one line.
    pub fn stop(&self, why: &str) {
        if let Some(writer) = self.writer().as_mut() {
            // Ignore an error: if the disk is full, the line before has already reported it.
            let _ = writer.end(why);
        }
    }

    /// Computes the missing cells on `threads` threads. `watch` is called after each.
    ///
    /// # Errors
    /// If a line cannot be written: the run ends, and all lines before are kept.
    pub fn work(&self, threads: usize, watch: &(dyn Fn(Progress) + Sync)) -> Result<Progress, SweepError> {
        let (next, done) = (AtomicUsize::new(0), AtomicU64::new(0));
        let failed = AtomicU64::new(self.failed_before);
        let progress = || Progress {
            before: self.before,
            done: done.load(Ordering::Relaxed),
            failed: failed.load(Ordering::Relaxed),
            cells: self.before + self.missing(),
        };
        let work = || -> Result<(), SweepError> {
            while let Some(&cell) = self.missing.get(next.fetch_add(1, Ordering::Relaxed)) {
                let line = self.line(cell);
                let has_failed = line.error.is_some();
                match self.writer().as_mut() {
                    Some(writer) if !writer.has_ended() => writer.append(&line)?,
                    _ => return Ok(()),
                }
                done.fetch_add(1, Ordering::Relaxed);
                failed.fetch_add(u64::from(has_failed), Ordering::Relaxed);
                watch(progress());
            }
            Ok(())
        };
        let (finished, waiting) = channel::<()>();
        let worked = thread::scope(|scope| {
            let workers: Vec<_> = (0..threads.clamp(1, self.missing.len().max(1)))
                .map(|_| scope.spawn(|| alone(work).unwrap_or_else(|why| Err(SweepError::Internal(why)))))
                .collect();
            scope.spawn(move || {
                while waiting.recv_timeout(HEARTBEAT) == Err(RecvTimeoutError::Timeout) {
                    if let Some(writer) = self.writer().as_ref() {
                        writer.beat();
                    }
                }
            });
            let worked: Result<Vec<()>, SweepError> = workers
                .into_iter()
                .map(|worker| {
                    worker.join().unwrap_or_else(|_| Err(SweepError::Internal("a thread ended".to_owned())))
                })
                .collect();
            drop(finished);
            worked
        });
        worked?;
        if let Some(writer) = self.writer().as_mut() {
            writer.end("done")?;
        }
        Ok(progress())
    }

    fn line(&self, cell: u64) -> Line {
        match attempt(&self.plan, cell) {
            Ok(Outcome { row, pattern }) => {
                let json = |value: Option<crate::axis::Value>| {
                    value.map_or(serde_json::Value::Null, |value| serde_json::json!(value))
                };
                Line { cell, row: Some(row.into_iter().map(json).collect()), error: None, pattern }
            }
            Err(error) => Line { cell, row: None, error: Some(error), pattern: None },
        }
    }
}

/// Computes a cell; a panic is an error of the cell, not the end of the sweep.
pub(crate) fn attempt(plan: &Plan, cell: u64) -> Result<Outcome, String> {
    let computed = catch_unwind(AssertUnwindSafe(|| compute(plan, &plan.cell(cell))));
    computed.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Err(format!("internal error: {}", meissner_input::message::cut(text, 200)))
    })
}

/// Runs work in a thread pool of one thread, so that its parallel parts stay there: other threads have their own cells.
pub(crate) fn alone<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T, String> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    pool.map(|pool| pool.install(work)).map_err(|error| error.to_string())
}

/// Whether a run file, by its name, belongs to another shard of the same number of shards.
fn is_of_another(name: &str, shard: Shard) -> bool {
    let mut parts = name.splitn(4, '-');
    let number = parts.next().and_then(|number| number.parse().ok());
    let of = parts.nth(1).and_then(|of| of.parse().ok());
    number.zip(of).is_some_and(|(number, of): (u64, u64)| of == shard.of && number != shard.number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_a_part_from_1() {
        assert_eq!("3/7".parse(), Ok(Shard { number: 3, of: 7 }));
        for text in ["", "3", "0/7", "8/7", "a/7", "3/", "-1/2", "1/0"] {
            assert!(text.parse::<Shard>().is_err(), "{text}");
        }
        let shards = [1, 2, 3].map(|number| Shard { number, of: 3 });
        assert!((0..30).all(|cell| shards.iter().filter(|shard| shard.has(cell)).count() == 1));
    }

    #[test]
    fn the_files_of_other_shards_are_skipped() {
        let shard = Shard { number: 3, of: 7 };
        for (name, other) in [
            ("3-of-7-host-12-34.jsonl", false),
            ("4-of-7-host-12-34.jsonl", true),
            ("4-of-8-host-12-34.jsonl", false),
            ("copied.jsonl", false),
        ] {
            assert_eq!(is_of_another(name, shard), other, "{name}");
        }
    }
}
