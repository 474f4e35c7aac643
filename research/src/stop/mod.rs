//! Compares the rest error of pins above a lower stop, without a sensor, with the theory, over a grid of frequency, amplitude, scatter,
//! asymmetry and surplus.
//!
//! [`stop_tradeoff`] plays every cell of a [`StopGrid`] (`grid`) on simulated motors with a lower stop. Each cell gives a
//! [`StopRow`] (`row`). It holds the rest error beside that of [`ReflectedWalk`](meissner_array::reflected_walk::ReflectedWalk),
//! and the reason for a difference; the amplitude reached; and the predicted response to an edge, with and without the stop
//! (`response`). `edge` is the pattern for that.

mod edge;
mod grid;
mod response;
mod row;
mod tradeoff;
#[cfg(test)]
mod trials;

pub use grid::{StopCell, StopGrid, StopSurplus};
pub use response::{Contrasts, StopError};
pub use row::{StopReason, StopRow};
pub use tradeoff::{StopCount, StopTradeoff, stop_tradeoff};
