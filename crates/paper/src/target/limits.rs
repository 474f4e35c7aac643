//! Limits of a target.

/// The most points of a shape.
pub const MAX_POINTS: usize = 64;
/// The most frames of a motion; each is optimised on its own.
pub const MAX_FRAMES: u8 = 64;
/// The longest motion, s. It is simulated as a whole, and every spike is kept.
pub(crate) const LONGEST_S: f64 = 20.0;
/// The finest detail that an array can show, in pin pitches: two vibrating pins need one at rest between them.
pub(super) const FINEST_PITCHES: f64 = 2.0;
/// Lengths that differ by less are equal, mm.
pub(super) const SAME_MM: f64 = 1e-9;
