//! The whole daemon on a bench: what it answers, plays and records, in virtual time.
//!
//! With the feature `bench` other packages can run [`seeds`], too.

#![expect(clippy::unwrap_used, reason = "a test that panics has failed, and so has a run of seeds")]
#![cfg_attr(not(test), expect(dead_code, reason = "seeds use less of the bench than tests do"))]

#[cfg(test)]
mod api;
#[cfg(test)]
mod arrays;
mod bench;
#[cfg(test)]
mod calibration;
#[cfg(test)]
mod drift;
#[cfg(test)]
mod edges;
#[cfg(test)]
mod export;
#[cfg(test)]
mod live;
#[cfg(test)]
mod lower_stop;
#[cfg(test)]
mod motions;
#[cfg(test)]
mod network;
#[cfg(test)]
mod now;
#[cfg(test)]
mod participant;
#[cfg(test)]
mod rails;
#[cfg(test)]
mod record;
#[cfg(test)]
mod rights;
pub(super) mod seeds;
#[cfg(test)]
mod sequences;
#[cfg(test)]
mod sessions;
#[cfg(test)]
mod stimuli;
