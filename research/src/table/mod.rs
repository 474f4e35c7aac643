//! Prints comparisons as tables and sentences.

pub(crate) mod motions;
pub(crate) mod rendering;
