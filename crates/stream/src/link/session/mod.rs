//! One session with one device.
//!
//! The streamer pushes strokes, amendments and commands into a [`Session`] (`state`). `outbound` writes the frame that is due,
//! `inbound` reads what the device says, within its `bounds`; the session reports both as [`Event`]s. `board` asks for the board
//! report and the self-test. `probe` measures the line.

mod board;
mod bounds;
mod contradiction;
mod event;
mod inbound;
mod line;
mod outbound;
mod probe;
mod state;

pub use contradiction::{Contradiction, Contradictions};
pub use event::{Event, LostReason, Verdict};
pub use line::{BadFrames, LineRate, RoundTrip, Traffic};
pub use probe::Budget;
pub use state::Session;
