//! The tests of this crate, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// The library: made again byte for byte, and worth what it says.
mod library;
/// What was felt of a play whose bursts travelled otherwise than designed, beside what should have been felt.
mod prediction;
/// The search: the paper's frequencies, a coordinate search's price, threads, budgets, flat places, its space.
mod search;
/// Shapes and partition against slow ways to the same: samples of an outline, pairs of receptors.
mod shapes;
/// Target files: the messages of refused files, and the shipped targets.
mod targets;
