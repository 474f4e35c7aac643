//! Comparisons behind the figures of the book, which a user of the display does not need. `main` prints them.
//!
//! - `lead`: [`lead_tradeoff`] compares leads of the streamer under recorded stalls.
//! - `control`: [`control_tradeoff`] measures rest errors under position control against the least possible.
//! - `stop`: [`stop_tradeoff`] measures rest errors above a lower stop against the theory.
//! - `motions`: [`motion_figures`] says what motors reach of ramps, bursts, chirps, noise and a texture; [`drift_figures`] compares drift
//!   without telemetry with its theory.
//! - `rendering`: [`rendering_figures`] compares the work of a rendering with its error.
//! - `textures`: [`texture_figures`] compares textures with what the motors can carry of them.
//! - `sixty_hertz` has the drives that `lead` and `control` play.
//!
//! Every comparison is on the array of the shipped patterns and scenes that it plays.
//!
//! Simulation methods are compared by `meissner tradeoff`, which users need to choose one.
//!
//! Invariant: results depend on the request alone. Only the times of renderings depend on the machine.
//!
//! ```
//! use meissner_research::{Trace, lead_tradeoff};
//!
//! // In this second a thread due at 500 ms woke up 25 ms late: a lead of 50 ms is enough.
//! let trace = Trace::read("seconds 1\n500000 25000\n", "trace.txt")?;
//! assert_eq!(lead_tradeoff(&trace, &[50.0]).rows[0].late_bursts, 0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod control;
mod lead;
mod motions;
mod rendering;
mod sixty_hertz;
mod stop;
mod textures;

pub use control::{
    ControlGrid, ControlRow, ControlSummary, ControlTradeoff, Verdict, Wire, WireRow, Worst, control_tradeoff,
};
pub use lead::{
    LEADS_MS, LeadRow, LeadTradeoff, MAX_TRACE_BYTES, STALLS, Summary, Trace, TraceError, lead_tradeoff,
};
pub use motions::{
    DriftFigures, DriftRow, HarmonicRow, Held, MotionFigures, StimulusRow, drift_figures, motion_figures,
};
pub use rendering::{RenderingFigures, RenderingRow, rendering_figures};
pub use stop::{
    Contrasts, StopCell, StopCount, StopError, StopGrid, StopReason, StopRow, StopSurplus, StopTradeoff,
    stop_tradeoff,
};
pub use textures::{TextureFigures, TextureRow, texture_figures};

/// The mean; 0 of no numbers.
fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = numbers.fold((0.0, 0.0), |(count, sum), number| (count + 1.0, sum + number));
    sum / f64::max(count, 1.0)
}
