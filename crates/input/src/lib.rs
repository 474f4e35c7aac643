//! Reads documents that people write, and words what is wrong with them.
//!
//! [`document`] reads TOML and JSON with serde; its errors name the file, the line and the key, and say what to do.
//! [`message`] makes foreign text fit for one line of a message. Patterns, scenes, targets, calibrations, the configuration
//! and the bodies of API requests are all read through this crate.
//!
//! Invariant: no message made here contains a line break.

pub mod document;
pub mod message;
