//! The paper's search: finds vibration patterns for target shapes, and predicts how well they work.
//!
//! A [`Target`] is a shape on the skin. Afferents within its reach should fire (ON), the others should not (OFF). The contrast,
//! mean rate of ON minus mean rate of OFF in impulses/s, is what the search maximises; files call it `cost`. [`make()`] does all
//! steps from a target to a pattern; its parts can be used alone.
//!
//! The modules, each after those it uses:
//!
//! 1. `partition`: a [`Partition`] of afferents into ON and OFF; rates give its [`Verdict`].
//! 2. `target`: reads what a search needs of object files; cuts a moving target into [`Frame`]s.
//! 3. `shipped`: the objects that are built in, the files of `library/objects/`, among them the [`YARDSTICK`].
//! 4. `point`: a [`Point`] says how each motor vibrates. `space`: a [`Space`] is the set of points that a search may choose.
//! 5. `objective`: an [`Objective`] simulates the contrast of points. `moves`: the points to try next.
//! 6. `search`: [`search()`] goes from a start to better points.
//! 7. `judge`: [`judge()`] simulates a pattern exactly; [`robustness()`] does so in other conditions.
//! 8. `make`: [`make()`] searches frame by frame, judges the result and writes the pattern.
//!
//! Invariant: results depend on the request alone, bit for bit on every machine. Only if a clock or the caller ends a search, the
//! result also depends on when that happens.
//!
//! ```
//! use meissner_paper::{Brief, Conditions, Limit, Setting, judge, search, shipped};
//! use std::ops::ControlFlow;
//!
//! let target = shipped("dot").unwrap();
//! let space = Setting::Default.space(target.array());
//! let start = space.random(0);
//! let brief =
//!     Brief { target: &target, frame: &target.frames()[0], populations: &[0], noise_seed: 0, space, seed: 0 };
//! let found = search(&brief, start, Limit::Evaluations(50), &mut |_, _| ControlFlow::Continue(()))?;
//!
//! let drives = found.point.drives(target.amplitude_um(), None, None);
//! let verdict = judge(&target, &drives, &Conditions::plain(vec![0], 0))?.unwrap();
//! assert!(verdict.on_hz > verdict.off_hz);
//! # Ok::<(), meissner_skin::MethodError>(())
//! ```

mod judge;
mod make;
mod moves;
mod naive;
mod objective;
mod partition;
mod point;
mod search;
mod shipped;
mod space;
mod target;

pub use judge::{Conditions, HELD_OUT, Robustness, STEADY_S, judge, pulses_per_s, robustness};
pub use make::{
    Baseline, Budget, MODEL, Made, MakeError, Progress, ROBUST_POPULATIONS, Request, make, populations,
};
pub use naive::Rule;
pub use objective::{Fidelity, Incumbent, Objective, Score, Tried};
pub use partition::{Partition, Verdict};
pub use point::{Point, Vibration};
pub use search::{Brief, Ended, Found, Limit, Spent, Step, resume, search};
pub use shipped::{YARDSTICK, shipped, shipped_names, shipped_text};
pub use space::{Setting, Space, Window};
pub use target::{Frame, MAX_FRAMES, MAX_POINTS, Problem, Target, TargetError};
