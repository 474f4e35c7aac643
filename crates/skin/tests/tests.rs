//! The tests of this crate, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// A method chosen for an allowed error keeps to it.
mod choose;
/// The stepped methods come to the exact one as the step shrinks.
mod convergence;
/// Trials and changes of single motors against fresh simulations.
mod evaluator;
/// Scenes at the edges of what a scene may be, by every method: each has one right answer.
mod extremes;
/// Motors that move by more or less than they should.
mod gains;
/// The same bits whatever the threads, the order of receptors, the blocks, and what is skipped.
mod independence;
/// Scene files: what is refused and how it is said.
mod scenes;
/// Simulated spikes against another program's and the oracle's.
mod simulate;
