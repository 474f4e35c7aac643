//! The tests of this crate: one binary, one module per theme.

/// Contact against closed solutions, and convergence.
mod contact;
/// Object files, images and paths, good and bad.
mod files;
/// Spikes: against the second model's pins, moving objects, extremes.
mod response;
