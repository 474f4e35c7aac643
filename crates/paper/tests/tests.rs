//! The tests of this crate, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// Frames of moving targets that are too short for one stroke.
mod frames;
/// The library's patterns: made again byte for byte, with the figures that they state.
mod library;
/// The naive rules.
mod rules;
/// The search: the paper's frequencies, its work against a coordinate search's, threads, limits, flat objectives, its space.
mod search;
/// Shapes and partitions against slow computations: samples of an outline, pairs of afferents.
mod shapes;
/// Objects that a search takes: the messages of refused files, and the shipped ones.
mod targets;
