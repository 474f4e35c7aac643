//! The tests of this crate: one binary, one module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// The second model: reference spikes, scene files, independence, extremes.
mod afferents;
/// The stepped methods converge to the exact one as the step shrinks.
mod convergence;
/// Candidates and changes of single motors against fresh simulations.
mod evaluator;
/// Extreme scenes, by every method: each has one right answer.
mod extremes;
/// Motors with gains.
mod gains;
/// The same bits with any threads, order of afferents and blocks, and with and without skipping.
mod independence;
/// Scene files: accepted keys, and the messages of refused files.
mod scenes;
/// Simulated spikes against another program's and the oracle's.
mod simulate;
