//! The host's end of the link, sans-IO: instants, bytes and strokes in; bytes and [`Event`]s out.
//!
//! A [`Session`] makes the ordered, reliable stream of strokes out of frames that may be lost, repeated,
//! delayed or damaged: handshake, epochs, retransmission, credits, verdicts. It knows nothing of plays or
//! patterns, reads no clock and touches no port. What the device must do is specified in `firmware_protocol`.
//! Invariant: each stroke taken by [`Session::push`] is answered by exactly one [`Event::Stroke`], unless
//! a control began a new epoch or the session ended before.

mod clock;
mod session;

pub use clock::Clock;
pub use session::{Budget, Event, LineRate, LostReason, RoundTrip, Session, Traffic, Verdict};
