//! What every play goes through: its terms are read, its strokes are compiled, and it begins.
//!
//! [`order`] compiles an order, [`live`] a play that its client moves, [`calibrate`] that of a calibration. All of them share their [`terms`]
//! and [`begin`]. [`check`] compiles an order that is not played.

mod begin;
mod calibrate;
mod check;
mod live;
mod order;
mod terms;

pub(in crate::daemon) use terms::edge_at;
