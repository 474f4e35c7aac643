//! A part of a plan that one run computes.
//!
//! Invariant: each cell belongs to one of the `of` shards.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// One of equal parts of a plan: every `of`-th cell, so that expensive cells are spread over the shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Its number, 1 to `of`.
    pub number: u64,
    /// How many there are.
    pub of: u64,
}

impl Shard {
    /// The whole plan.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Whether a cell belongs to it.
    #[must_use]
    pub const fn has(self, cell: u64) -> bool {
        cell % self.of == self.number - 1
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = "must be I/N: the number of the part, from 1, and how many parts there are";
        let (number, of) = text.split_once('/').ok_or(wrong)?;
        let (number, of): (u64, u64) = number.parse().ok().zip(of.parse().ok()).ok_or(wrong)?;
        if (1..=of).contains(&number) { Ok(Self { number, of }) } else { Err(wrong) }
    }
}
