//! Reads documents that people write, with errors that name the place and the remedy.
//!
//! A reader derives a serde struct for the keys, reads it, checks ranges, and adds text and file to an error. All documents are
//! read this way: patterns, scenes, targets, calibrations, configurations and bodies of API requests.
//!
//! - [`document`] reads TOML and JSON with serde. Its errors name the file, the line and the key, and what to do.
//! - [`message`] formats foreign text for a message of one line.
//!
//! Invariant: no message from this crate contains a line break.
//!
//! ```
//! use meissner_input::document::{DocumentError, KeyError, Table, from_toml, in_range};
//! use serde::Deserialize;
//!
//! #[derive(Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct Lamp {
//!     power_w: f64,
//! }
//!
//! #[derive(Debug, thiserror::Error)]
//! enum Problem {}
//!
//! fn read(text: &str) -> Result<Lamp, KeyError<Problem>> {
//!     let Table(lamp): Table<Lamp> = from_toml(text, |_| "power_w = 40.0")?;
//!     in_range("power_w", lamp.power_w, (0.0..=100.0).contains(&lamp.power_w), "0 to 100 W")?;
//!     Ok(lamp)
//! }
//!
//! let message = |text: &str| {
//!     let error: DocumentError<Problem> = read(text).err().unwrap().in_text(text).in_file(Some("lamp.toml"));
//!     error.to_string()
//! };
//! assert_eq!(message("power_w = 400"), "lamp.toml:1: `power_w` is 400: must be 0 to 100 W");
//! assert_eq!(message("powr_w = 40"), "lamp.toml:1: unknown key `powr_w`: did you mean `power_w`?");
//! ```

pub mod document;
pub mod message;
