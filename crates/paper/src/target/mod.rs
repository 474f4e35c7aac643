//! Targets: a shape on the skin, its motion, and the population of afferents for which a pattern is made.
//!
//! [`Target::read`] reads and checks an object file. It gives a shape, the reach within which afferents should fire, the
//! amplitude of all motors, a population and its afferent model, and perhaps a motion. A motion is cut into frames in
//! which the shape stands still; the file gives the shape as it is in the middle of the motion. A target is for an array; a file that
//! names none is for the paper's.
//!
//! The modules: `limits` and `error`; `motion` makes [`Frame`]s; `checked` is the [`Target`], `warnings` its doubtful
//! details; `file` reads and writes it.

mod checked;
mod error;
mod file;
mod limits;
mod motion;
mod warnings;

pub use checked::Target;
pub use error::{Problem, TargetError};
pub(crate) use file::DEFINITION;
pub(crate) use limits::LONGEST_S;
pub use limits::{MAX_FRAMES, MAX_POINTS};
pub use motion::Frame;
