//! The tests of the protocol and the controller, one binary, a module per theme: bytes in, lines and bytes out.

/// Corrections of queued moves.
mod amendments;
/// A shell around the controller that plays it tick by tick and records the lines.
mod bench;
/// The board report and the self-test.
mod board;
/// Edges of the trigger input.
mod edges;
/// The bytes of every message.
mod golden;
/// Stops, e-stops and silent hosts.
mod interruptions;
/// Moves to levels: up in time only, down at once.
mod levels;
/// The stream over a bad line.
mod link;
/// Pushes against a lower stop.
mod lower_stop;
/// Onsets and the trigger output.
mod onsets;
/// Frames taken in pieces.
mod pieces;
/// Random requests, faults and noise.
mod properties;
/// Frames that replace queued moves.
mod replacement;
/// The plain rule that lines follow.
mod rule;
/// Shifts of rest, and on-time.
mod shifts;
/// The effect of each event in each state.
mod states;
/// Which moves the controller takes, and that it plays them as sent.
mod taking;
