//! Compares the simulation methods: time against error on one scene, measured on this machine.
//!
//! The first model has methods and steps. [`tradeoff()`] runs a scene by each of them, and compares it with the exact one
//! (`compare`): by spikes, by rates and by the contrast on the target [`YARDSTICK`](meissner_design::YARDSTICK). `label` names a
//! method, [`plot()`] draws the result, and [`reasons()`] explains why skipped work does not change the result. The second model
//! has one method with one step; `afferents` measures its time.

mod afferents;
mod compare;
mod label;
mod plot;
mod reasons;
mod tradeoff;

pub use afferents::{AfferentsRow, AfferentsTradeoff, Extreme, tradeoff as afferents_tradeoff};
pub use compare::{Difference, MATCH_S, matching};
pub use label::MethodLabel;
pub use plot::plot;
pub use reasons::{Count, Reason, reasons};
pub use tradeoff::{LeftOut, MOST_STEPS, MethodTradeoff, Row, STEPS_US, tradeoff};
