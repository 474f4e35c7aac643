//! Patterns that make receptors feel a shape: what is to be felt, the search for it, and what the outcome is worth.
//!
//! A [`Target`] is a [`Shape`] on the skin, read from a TOML file (`target`): an edge, a disc, dots, a Braille character
//! (`braille`), a grating, each at rest or in motion; a moving one is cut into [`Frame`]s. [`Partition`] parts a population's
//! receptors into those that should fire, because they lie within reach of the shape, and the others. The cost is the
//! difference of the two mean rates; a pattern is the better, the higher it is.
//!
//! What may be chosen is a [`Point`] of a [`Space`]: who vibrates, how fast, and when. An [`Objective`] scores points by
//! simulation; [`search()`] goes from one to better ones (`moves` says where to). [`make()`] does so for every frame
//! and writes the pattern; [`judge()`] and [`robustness()`] say what it is worth, also where it was not made for;
//! [`predict_response()`], what was left of it when it was really played.
//!
//! Some targets are [`shipped`]; the one called [`YARDSTICK`] is what methods are compared on.
//!
//! Invariant: which receptors are on a shape, and which pattern is made for it, depends on what is asked alone, bit for
//! bit on every machine.

mod braille;
mod judge;
mod make;
mod moves;
mod objective;
mod partition;
mod point;
mod prediction;
mod search;
mod shape;
mod target;

pub use judge::{Circumstances, HELD_OUT, Robustness, WATCHED_S, judge, pulses_per_s, robustness};
pub use make::{Budget, Made, MakeError, Progress, ROBUST_POPULATIONS, Request, make, populations};
pub use objective::{Fidelity, Objective, Score, Standing, Tried};
pub use partition::{Partition, Verdict};
pub use point::{Point, Space, Vibration};
pub use prediction::{MOST_OBSERVED_S, Play, PredictedResponse, PredictionError, Rates, predict_response};
pub use search::{Brief, Ended, Found, Limit, Spent, Step, resume, search};
pub use shape::Shape;
pub use target::{Frame, MAX_BYTES, MAX_FRAMES, MAX_POINTS, Problem, Target, TargetError};

use include_dir::{Dir, include_dir};
use serde::{Deserialize, Serialize};

/// The shipped target files, as they are.
static LIBRARY: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../../targets");

/// The shipped target by which patterns are commonly judged: an edge at 45°, 12 mm long, through the array's middle.
pub const YARDSTICK: &str = "edge-45";

/// What a search may choose from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Setting {
    /// Motors may be off; 5 to 150 Hz.
    #[default]
    Default,
    /// The paper's: every motor vibrates; 5 to 300 Hz.
    AlwaysOn,
}

/// The shipped target of that name.
#[must_use]
#[expect(clippy::missing_panics_doc, reason = "it does not happen: a test reads them all")]
pub fn shipped(name: &str) -> Option<Target> {
    let file = LIBRARY.get_file(format!("{name}.toml"))?;
    let text = file.contents_utf8().expect("targets are text");
    Some(Target::read(text, &file.path().to_string_lossy()).expect("shipped targets are good"))
}

/// What the shipped targets are called, in order.
#[must_use]
pub fn shipped_names() -> Vec<&'static str> {
    let paths = LIBRARY.files().map(include_dir::File::path);
    let toml = paths.filter(|path| path.extension().is_some_and(|extension| extension == "toml"));
    let mut names: Vec<_> = toml.filter_map(|path| path.file_stem()?.to_str()).collect();
    names.sort_unstable();
    names
}
