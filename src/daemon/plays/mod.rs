//! What every play goes through: its terms are read, its strokes are compiled, and it begins.
//!
//! [`pattern`] compiles a play of one pattern, [`sequence`] one of many, [`live`] one that its client moves, [`calibrate`] that of a
//! calibration. All of them share their [`terms`] and [`begin`].

mod begin;
mod calibrate;
mod live;
mod pattern;
mod sequence;
mod terms;

pub(in crate::daemon) use terms::edge_at;
