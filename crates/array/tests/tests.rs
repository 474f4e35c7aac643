//! The tests of this crate, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// The motor model and the plant against the reference figures.
mod models;
/// Pattern files: what is refused and how it is said; the shipped library.
mod patterns;
/// The simulated shafts: scatter, end stops, telemetry, and times a month away.
mod plant;
/// From patterns to strokes: exact ticks, repeats and cuts, invariants on random patterns.
mod strokes;

/// Lets `assert_no_alloc` see every allocation of the tests.
#[cfg(debug_assertions)]
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
