//! Prints comparisons as tables and sentences.

pub(crate) mod control;
pub(crate) mod lead;
pub(crate) mod motions;
pub(crate) mod rendering;
pub(crate) mod stop;
