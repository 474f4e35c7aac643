//! Figures and comparisons of the models of motors and skin, as SVG, CSV and HTML.
//!
//! A caller computes a result, serialises it or draws it, and writes the files itself: this crate opens none.
//!
//! - [`figures`]: [`report`](figures::report) makes an HTML page with the paper's figures and a section per pattern.
//! - `methods`: [`tradeoff`] compares the simulation methods on a scene, time against error; [`plot`] draws it, and [`reasons`]
//!   explains why skipped work does not change the result. [`afferents_tradeoff`] does the same for the second model.
//! - `motions`: [`Motions`] says what motors do with the motions of a pattern before it is played; [`motion_tradeoff`] compares grids of
//!   moves, error against moves per second.
//! - `sweep`: [`sweep_page`] shows the marginals and the Pareto front of a sweep.
//! - `validate`: [`validate()`] compares both models of the skin with published figures.
//! - `svg` writes drawings, [`chart`] draws lines and points on axes, `sixty_hertz` is the standard scene, `progress` and `statistics` are small
//!   helpers of all parts.
//!
//! Invariant: results depend on the request alone. Only wall times, and figures derived from them, depend on the machine.

pub mod chart;
pub mod figures;
mod methods;
mod motions;
mod progress;
mod sixty_hertz;
mod statistics;
mod svg;
mod sweep;
mod validate;

pub use methods::{
    AfferentsRow, AfferentsTradeoff, Count, Difference, Extreme, LeftOut, MATCH_S, MOST_STEPS, MethodLabel,
    MethodTradeoff, Reason, Row, STEPS_US, afferents_tradeoff, matching, plot, reasons, tradeoff,
};
pub use motions::{
    FollowedMotor, FollowingError, GridRow, MotionOptions, MotionTradeoff, Motions, MotionsError,
    motion_tradeoff, steps_of,
};
pub use sixty_hertz::SIXTY_HERTZ;
pub use sweep::{Choice, Front, Marginal, Ordinate, Spread, SweepPage, sweep_page};
pub use validate::{Case, Curve, Finding, Published, Validation, ValidationVerdict, validate};
