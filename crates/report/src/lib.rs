//! Figures and comparisons of the models, the search and position control, as SVG, CSV and HTML.
//!
//! A caller computes a result, serialises it or draws it, and writes the files itself: this crate opens none.
//!
//! - [`figures`]: [`report`](figures::report) makes an HTML page with the paper's figures and a section per pattern.
//! - `methods`: [`tradeoff`] compares the simulation methods on a scene, time against error; [`plot`] draws it, and [`reasons`]
//!   explains why skipped work does not change the result. [`afferents_tradeoff`] does the same for the second model.
//! - `lead`: [`lead_tradeoff`] compares leads of the streamer under recorded stalls; [`plot_lead`] draws it.
//! - `control`: [`control_tradeoff`] measures rest errors under position control against the least possible;
//!   [`plot_control`] draws it.
//! - `laser`: [`plot_laser`] draws a recording of a pin beside the motor's fit.
//! - `objectives`: [`objective_tradeoff`] compares the objectives of a search with each other and with the naive rules.
//! - `stop`: [`stop_tradeoff`] measures rest errors above a lower stop against the theory; [`plot_stop`] draws it.
//! - `sweep`: [`sweep_page`] shows the marginals and the Pareto front of a sweep.
//! - `validate`: [`validate()`] compares both models of the skin with published figures.
//! - `chart` draws lines and points on axes, `sixty_hertz` is the standard scene, `progress` and `statistics` are small
//!   helpers of all parts.
//!
//! Invariant: results depend on the request alone. Only wall times, and figures derived from them, depend on the machine.
//!
//! ```
//! use meissner_report::{Trace, lead_tradeoff, plot_lead};
//!
//! // In this second a thread due at 500 ms woke up 25 ms late: a lead of 50 ms is enough.
//! let trace = Trace::read("seconds 1\n500000 25000\n", "trace.txt")?;
//! let found = lead_tradeoff(&trace, &[50.0], &|_| ());
//! assert_eq!(found.rows[0].late_bursts, 0);
//! assert!(plot_lead(&found)?.starts_with("<svg"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod chart;
mod control;
pub mod figures;
mod laser;
mod lead;
mod methods;
mod objectives;
mod progress;
mod sixty_hertz;
mod statistics;
mod stop;
mod sweep;
mod validate;

pub use chart::PlotError;
pub use control::{
    Bias, ControlGrid, ControlRow, ControlSummary, ControlTradeoff, Verdict, Wire, WireRow, Worst,
    control_tradeoff, plot_control,
};
pub use laser::plot_laser;
pub use lead::{
    LEADS_MS, LeadRow, LeadTradeoff, MAX_TRACE_BYTES, STALLS, Summary, Trace, TraceError, lead_tradeoff,
    plot_lead,
};
pub use methods::{
    AfferentsRow, AfferentsTradeoff, Count, Difference, Extreme, LeftOut, MATCH_S, MOST_STEPS, MethodLabel,
    MethodTradeoff, Reason, Row, STEPS_US, afferents_tradeoff, matching, plot, reasons, tradeoff,
};
pub use objectives::{
    BelowNaive, CellOfClass, ClassRow, ObjectiveCell, ObjectiveMeans, ObjectiveRow, ObjectiveTradeoff,
    objective_tradeoff,
};
pub use sixty_hertz::SIXTY_HERTZ;
pub use stop::{
    Contrasts, StopCell, StopCount, StopError, StopGrid, StopReason, StopRow, StopSurplus, StopTradeoff,
    plot_stop, stop_tradeoff,
};
pub use sweep::{Choice, Front, Marginal, Ordinate, Spread, SweepPage, sweep_page};
pub use validate::{Case, Curve, Finding, Published, Validation, ValidationVerdict, validate};
