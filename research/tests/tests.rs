//! The integration tests, one binary, a module per theme.
#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

/// Position control: a corner of its grid within the limits, the same bytes on any cores.
mod control;
/// The lead under recorded stalls, traces that are refused.
mod lead;
