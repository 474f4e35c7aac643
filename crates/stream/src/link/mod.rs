//! The host's end of the link, sans-IO: instants, bytes and strokes in; bytes and [`Event`]s out.
//!
//! A [`Session`] turns frames that may be lost, repeated, delayed or damaged into an ordered, reliable stream of
//! strokes: handshake, epochs, acknowledgements with credits, retransmission (selective repeat), verdicts. It measures
//! the line's bandwidth once (the link probe) and keeps the [`Clock`] model. It knows no plays and no patterns, reads no
//! clock and touches no port. `firmware_protocol` specifies the device's side.
//!
//! Invariant: [`Session::push`] accepts a step, then exactly one [`Event::Step`] answers it, unless a command began a
//! new epoch or the session ended before.

mod clock;
mod session;

pub use clock::{Clock, ClockEstimate};
pub use session::{
    AnotherArray, BadFrames, Budget, Contradiction, Contradictions, Event, LineRate, LostReason, RoundTrip,
    Session, Traffic, Verdict,
};
