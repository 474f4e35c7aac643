//! The tests of the protocol and the controller, one binary, a module per theme: bytes in, lines and bytes out.

mod amendments;
mod at_once;
/// A shell around the controller that plays it tick by tick and records the lines.
mod bench;
/// Board reports and self-tests.
mod board;
/// The bytes of version 6.
mod golden;
mod interruptions;
/// Sequence numbers, epochs, sessions and reports on a bad line.
mod link;
mod lower_stop;
mod moves;
mod onsets;
/// Frames taken in pieces, with events in between.
mod pieces;
/// Random requests and faults in any order.
mod properties;
mod replacement;
mod states;
mod strokes;
