//! What people look at: figures, made of what the models say.
//!
//! [`tradeoff`] says what each way to simulate a scene costs and by how much it errs, on this machine (`tradeoff`);
//! [`lead_tradeoff`] says what the streamer's lead is worth under a machine's recorded stalls (`lead`);
//! [`control_tradeoff`] says how far pins rest off with the closed loop, against the least there can be (`hold`);
//! [`reasons`] says why what was skipped need not be computed. [`figures`] draws what the paper drew and a section for
//! each pattern: what its motors do, and what the skin makes of it. All is computed by the models and the search; nothing is
//! read or written.
//!
//! Invariant: errors and figures depend on what is asked alone; only times, and what follows from them, on the machine.

mod control;
pub mod figures;
mod lead;
mod methods;

pub use control::{
    Bias, ControlGrid, ControlRow, ControlSummary, ControlTradeoff, Verdict, Wire, WireRow, Worst,
    control_tradeoff, plot_control,
};
pub use lead::{
    LEADS_MS, LeadRow, LeadTradeoff, MAX_TRACE_BYTES, STALLS, Summary, Trace, TraceError, lead_tradeoff,
    plot_lead,
};
pub use methods::{
    Count, LeftOut, MATCH_S, MOST_STEPS, MethodLabel, MethodTradeoff, PlotError, Reason, Row, SIXTY_HERTZ,
    STEPS_US, matching, plot, reasons, tradeoff,
};
