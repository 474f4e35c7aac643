//! The streamer's lead against late bursts, onsets and bytes, under the stalls of a real machine.
//!
//! For each lead, [`lead_tradeoff`] plays under a recorded [`Trace`] of stalls, in virtual time (`replay`): a long play with
//! position control and one without, on all motors at 60 Hz, and many short plays. A real line
//! adds losses and delays.

mod replay;
mod trace;
mod tradeoff;

pub use trace::{MAX_TRACE_BYTES, STALLS, Summary, Trace, TraceError};
pub use tradeoff::{LEADS_MS, LeadRow, LeadTradeoff, lead_tradeoff};
