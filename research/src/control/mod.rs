//! Measures position control: the rest error of pins against the least possible, over a grid of settings.
//!
//! [`control_tradeoff`] runs one simulated motor with its burst controller ([`MotorRun`](meissner_stream::MotorRun)) for every cell
//! of a [`ControlGrid`] (`grid`). Each cell gives a [`ControlRow`] (`row`): the rest error beside its bound
//! ([`rest_bound_um`](meissner_stream::rest_bound_um)), the error of the mean amplitude, and whether both are within their limits.
//! `wire` measures the bytes of corrections on the line, `summary` counts the cells.

mod grid;
mod row;
mod summary;
mod tradeoff;
mod wire;

pub use grid::ControlGrid;
pub use row::{ControlRow, Verdict};
pub use summary::{ControlSummary, Worst};
pub use tradeoff::{ControlTradeoff, control_tradeoff};
pub use wire::{Wire, WireRow};
