//! The tests of this crate, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// `calibrate`: what a plan plays, gains found again on the plant, files and what is refused in them.
mod calibrate;
/// What a line carries: measured, compared with what plays bandwidth, on lines that carry it just so.
mod capacity;
mod closed_loop;
/// CommandQueue that cross each other, the device's word, and the end of a lease: nothing comes to life that is over.
mod races;
/// A session and a controller over a line that loses: one verdict per stroke.
mod session;
/// The streamer against the mock: tick for tick, over bad lines, through stalls, stops and pulled cables.
mod streaming;

/// Lets `assert_no_alloc` see every allocation of the tests.
#[cfg(debug_assertions)]
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
