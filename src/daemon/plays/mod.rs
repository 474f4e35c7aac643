//! What every play goes through: its strokes are compiled, and it begins.
//!
//! [`order`] compiles an order; live plays and calibrations have compilers of their own. All of them share [`begin`]. [`check`] compiles
//! an order that is not played. [`state`] keeps the receipts.

pub(in crate::daemon) mod begin;
pub(in crate::daemon) mod check;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod order;
pub(in crate::daemon) mod state;
