//! The tests of this crate: one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

mod models;
mod motions;
mod patterns;
mod samples;
mod simulated;
mod steps;
mod strokes;

/// Lets `assert_no_alloc` see every allocation of the tests.
#[cfg(debug_assertions)]
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
