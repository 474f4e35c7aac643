//! Finds vibration patterns for target shapes, and predicts how well they work.
//!
//! A [`Target`] is a shape on the skin. Afferents within its reach should fire (ON), the others should not (OFF). The contrast,
//! mean rate of ON minus mean rate of OFF in impulses/s, is what the search maximises; files call it `cost`. [`make()`] does all
//! steps from a target to a pattern; its parts can be used alone.
//!
//! The modules, each after those it uses:
//!
//! 1. `shape`: a [`Shape`], and the distance of a place from it. `braille`: the dots of a Braille character.
//! 2. `partition`: a [`Partition`] of afferents into ON and OFF; rates give its [`Verdict`].
//! 3. `target`: reads and checks target files; cuts a moving target into [`Frame`]s.
//! 4. `shipped`: reads the targets that are built in, the files of `targets/`, among them the [`YARDSTICK`].
//! 5. `point`: a [`Point`] says how each motor vibrates. `space`: a [`Space`] is the set of points that a search may choose. `at_once`: an
//!    [`AtOnce`] keeps points within a limit on the motors of a rail that have pulses at once.
//! 6. `objective`: an [`Objective`] simulates the value of points under one model. `aim`: what a search maximises, under
//!    one model or both. `moves`: the points to try next.
//! 7. `search`: [`search()`] goes from a start to better points.
//! 8. `judge`: [`judge()`] simulates a pattern exactly; [`robustness()`] does so in other conditions.
//! 9. `make`: [`make()`] searches frame by frame, judges the result and writes the pattern.
//! 10. `prediction`: [`predict_response()`] compares the bursts of a play with those of its pattern.
//! 11. `discriminate`: [`discriminate()`] says how well an ideal observer of the spikes tells two patterns apart, [`confusion()`] which
//!     of a set it names.
//!
//! Invariant: results depend on the request alone, bit for bit on every machine. Only if a clock or the caller ends a search, the
//! result also depends on when that happens.
//!
//! ```
//! use meissner_design::{Brief, Conditions, Goal, Limit, Models, Setting, judge, search, shipped};
//! use std::ops::ControlFlow;
//!
//! let target = shipped("dot").unwrap();
//! let space = Setting::Default.space(target.array());
//! let start = space.random(0);
//! let brief =
//!     Brief { models: Models::Membrane, goal: Goal::Contrast, target: &target, frame: &target.frames()[0], populations: &[0], noise_seed: 0, space, seed: 0 };
//! let found = search(&brief, start, Limit::Evaluations(50), &mut |_, _| ControlFlow::Continue(()))?;
//!
//! let drives = found.point.drives(target.amplitude_um(), None, None);
//! let verdict = judge(&target, &drives, &Conditions::plain(vec![0], 0))?.unwrap();
//! assert!(verdict.on_hz > verdict.off_hz);
//! # Ok::<(), meissner_skin::MethodError>(())
//! ```

mod aim;
mod at_once;
mod braille;
mod discriminate;
mod goal;
mod judge;
mod make;
mod moves;
mod naive;
mod objective;
mod partition;
mod point;
mod prediction;
mod quality;
mod search;
mod shape;
mod shipped;
mod space;
mod target;

pub use aim::Models;
pub use at_once::AtOnce;
pub use braille::dots as braille_dots;
pub use discriminate::{
    ClassReadings, Confusion, LEAST_TRIALS, MOST_TRIALS, Plan, Reading, Sensitivity, confusion,
    correct_of_two, discriminate, efficiency,
};
pub use goal::{GOALS, Goal, neighbours, rivals};
pub use judge::{Conditions, HELD_OUT, Robustness, STEADY_S, judge, pulses_per_s, robustness};
pub use make::{
    Baseline, Budget, ByModel, MODEL, Made, MakeError, Progress, ROBUST_POPULATIONS, Request, RuleVerdict,
    make, populations,
};
pub use naive::Rule;
pub use objective::{Fidelity, Incumbent, Objective, Score, Task, Tried};
pub use partition::{Partition, Verdict};
pub use point::{Point, Vibration};
pub use prediction::{
    ClassResponse, MOST_OBSERVED_S, Play, PredictedResponse, PredictionError, Rates, predict_response,
};
pub use quality::{Named, OfClass, Quality, name_targets, quality, skin_model};
pub use search::{Brief, Ended, Found, Limit, SEARCH_MIN_SHARES, Spent, Step, resume, search};
pub use shape::{Shape, to_segment};
pub use shipped::{YARDSTICK, shipped, shipped_names};
pub use space::{Setting, Space, Window};
pub use target::{Frame, MAX_BYTES, MAX_FRAMES, MAX_POINTS, Problem, Target, TargetError};
