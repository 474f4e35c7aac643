//! The protocol and the controller as a host and a finger meet them: bytes in, lines and bytes out.

/// A shell around the controller that plays it tick by tick and writes down what the lines did.
mod bench;
/// The bytes of version 1.
mod golden;
/// Sequence numbers, epochs, sessions and reports on a bad line.
mod link;
/// Anything a host or the world may do, in any order.
mod properties;
/// The table of the specification, row by row, at every phase of a stroke.
mod table;
