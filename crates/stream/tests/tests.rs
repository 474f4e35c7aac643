//! The tests of this crate, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// Other arrays than the paper's.
mod arrays;
/// `calibrate`: plans, fitted gains of simulated motors, files and their mistakes.
mod calibrate;
mod capacity;
mod closed_loop;
/// Drift without telemetry: estimate, limit, what calibration and `home` do about it.
mod drift;
/// Edges of the trigger input.
mod edges;
/// What a play's account says of its end: offset, cut, rest errors.
mod endings;
/// Faults by script.
mod faults;
/// A device that lies: undamaged messages that cannot be true.
mod lies;
/// Live plays: updates replace strokes on the device.
mod live;
mod lower_stop;
/// A line that loses bytes.
mod motions;
/// What the pins do now, in snapshots.
mod movements;
mod noise;
mod on_time;
mod races;
/// Sequences: many patterns at exact ticks, and the trigger output.
mod sequences;
/// A session and a controller over a line that loses: one verdict per stroke.
mod session;
/// Pins that a cut has left above rest.
mod standing;
mod streaming;

/// Lets `assert_no_alloc` see every allocation of the tests.
#[cfg(debug_assertions)]
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
