//! The axes of plans: the quantities that a sweep can vary, their values, and the commands that use them.
//!
//! [`Axis::ALL`] is the order of columns and of nested loops: the last axis varies fastest.
//!
//! Invariant: a [`Value`] of a plan is in the [`Domain`] of its axis.

use meissner_array::spec::{self, Array};
use meissner_design::{GOALS, Goal};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;

/// The command that every cell runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Command {
    /// Finds a pattern for a target.
    Optimise,
    /// Simulates a pattern on a finger, and judges how well it renders its target.
    Simulate,
    /// Predicts whether a finger tells two patterns apart.
    Discriminate,
}

impl Command {
    /// Its name in plans.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Optimise => "optimise",
            Self::Simulate => "simulate",
            Self::Discriminate => "discriminate",
        }
    }
}

/// A quantity that a sweep can vary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(missing_docs, reason = "`Axis::about` says it")]
pub enum Axis {
    Target,
    Pattern,
    Other,
    AmplitudeUm,
    Scale,
    Model,
    Objective,
    Setting,
    Robust,
    Evaluations,
    Gain,
    ShiftXMm,
    ShiftYMm,
    Finger,
    Trials,
    IntervalS,
    ResolutionMs,
    Efficiency,
    Seed,
}

/// A kind of documents that values name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Document {
    /// Target files, and the shipped targets.
    Target,
    /// Pattern files, and the patterns of the library.
    Pattern,
}

impl Document {
    /// Its name in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Target => "target",
            Self::Pattern => "pattern",
        }
    }
}

/// The values that an axis may have.
#[derive(Clone, Debug)]
pub enum Domain {
    /// Names and files of documents.
    Document(Document),
    /// One of these words.
    Choice(Vec<&'static str>),
    /// Numbers of a range.
    Number(RangeInclusive<f64>),
    /// Whole numbers of a range.
    Whole(RangeInclusive<i64>),
    /// True or false.
    Flag,
}

impl fmt::Display for Domain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Document(kind) => write!(f, "the name of a {0} or of a {0} file, in quotes", kind.name()),
            Self::Choice(words) => write!(f, "\"{}\"", words.join("\", \"")),
            Self::Number(range) => write!(f, "a number, {} to {}", range.start(), range.end()),
            Self::Whole(range) if *range.end() == i64::MAX => {
                write!(f, "a whole number, {} or more", range.start())
            }
            Self::Whole(range) => write!(f, "a whole number, {} to {}", range.start(), range.end()),
            Self::Flag => f.write_str("true or false"),
        }
    }
}

/// A value of an axis.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Value {
    /// True or false.
    Flag(bool),
    /// A whole number.
    Whole(i64),
    /// A finite number.
    Number(f64),
    /// A word, or the name of a document.
    Text(String),
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag(flag) => flag.fmt(f),
            Self::Whole(number) => number.fmt(f),
            Self::Number(number) => number.fmt(f),
            Self::Text(text) => f.write_str(text),
        }
    }
}

impl Axis {
    /// All axes.
    pub const ALL: [Self; 19] = [
        Self::Target,
        Self::Pattern,
        Self::Other,
        Self::AmplitudeUm,
        Self::Scale,
        Self::Model,
        Self::Objective,
        Self::Setting,
        Self::Robust,
        Self::Evaluations,
        Self::Gain,
        Self::ShiftXMm,
        Self::ShiftYMm,
        Self::Finger,
        Self::Trials,
        Self::IntervalS,
        Self::ResolutionMs,
        Self::Efficiency,
        Self::Seed,
    ];

    /// Its key in plans, and its column's name: with the unit, if it has one.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Target => "target",
            Self::Pattern => "pattern",
            Self::Other => "other",
            Self::AmplitudeUm => "amplitude_um",
            Self::Scale => "scale",
            Self::Model => "model",
            Self::Objective => "objective",
            Self::Setting => "setting",
            Self::Robust => "robust",
            Self::Evaluations => "evaluations",
            Self::Gain => "gain",
            Self::ShiftXMm => "shift_x_mm",
            Self::ShiftYMm => "shift_y_mm",
            Self::Finger => "finger",
            Self::Trials => "trials",
            Self::IntervalS => "interval_s",
            Self::ResolutionMs => "resolution_ms",
            Self::Efficiency => "efficiency",
            Self::Seed => "seed",
        }
    }

    /// The axes of a command, in order.
    pub fn of(command: Command) -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(move |axis| axis.is_of(command))
    }

    /// Whether a command takes it.
    #[must_use]
    pub const fn is_of(self, command: Command) -> bool {
        match self {
            Self::Model | Self::Finger | Self::Seed => true,
            Self::AmplitudeUm | Self::Objective | Self::Setting | Self::Robust | Self::Evaluations => {
                matches!(command, Command::Optimise)
            }
            Self::Target => matches!(command, Command::Optimise | Command::Simulate),
            Self::Pattern | Self::Scale => matches!(command, Command::Simulate | Command::Discriminate),
            Self::Gain | Self::ShiftXMm | Self::ShiftYMm => matches!(command, Command::Simulate),
            Self::Other | Self::Trials | Self::IntervalS | Self::ResolutionMs | Self::Efficiency => {
                matches!(command, Command::Discriminate)
            }
        }
    }

    /// Whether a plan for this command must name it.
    #[must_use]
    pub const fn is_required(self, command: Command) -> bool {
        match self {
            Self::Target => matches!(command, Command::Optimise),
            Self::Pattern | Self::Other => true,
            _ => false,
        }
    }

    /// Whether it is an external condition, and not a choice of the person who makes or plays the pattern.
    #[must_use]
    pub const fn is_condition(self, command: Command) -> bool {
        match self {
            Self::Gain | Self::ShiftXMm | Self::ShiftYMm => true,
            Self::Finger | Self::Seed => !matches!(command, Command::Optimise),
            _ => false,
        }
    }

    /// The values that it may have.
    #[must_use]
    pub fn domain(self, command: Command) -> Domain {
        match self {
            Self::Target => Domain::Document(Document::Target),
            Self::Pattern | Self::Other => Domain::Document(Document::Pattern),
            Self::AmplitudeUm => Domain::Number(0.0..=largest_amplitude_um()),
            Self::Scale => Domain::Number(0.0..=1.0),
            Self::Model if matches!(command, Command::Optimise) => {
                Domain::Choice(vec!["both", "membrane", "afferents"])
            }
            Self::Model => Domain::Choice(vec!["membrane", "afferents"]),
            Self::Objective => Domain::Choice(GOALS.map(Goal::name).to_vec()),
            Self::Setting => Domain::Choice(vec!["default", "always_on"]),
            Self::Robust => Domain::Flag,
            Self::Evaluations => Domain::Whole(0..=i64::MAX),
            Self::Gain => Domain::Number(0.0..=2.0),
            Self::ShiftXMm | Self::ShiftYMm => Domain::Number(-10.0..=10.0),
            Self::Finger | Self::Seed => Domain::Whole(0..=i64::MAX),
            Self::Trials => Domain::Whole(8..=1000),
            Self::IntervalS => Domain::Number(0.001..=20.0),
            Self::ResolutionMs => Domain::Number(0.01..=20_000.0),
            Self::Efficiency => Domain::Number(1e-9..=1.0),
        }
    }

    /// Its description, with its default in a plan that does not name it.
    #[must_use]
    pub const fn about(self, command: Command) -> &'static str {
        match self {
            Self::Target if matches!(command, Command::Simulate) => {
                "judge the pattern by this target [default: the one it was made for]"
            }
            Self::Target => "find a pattern for this target",
            Self::Pattern => "play this pattern",
            Self::Other => "compare it with this pattern",
            Self::AmplitudeUm => "amplitude, um peak to peak [default: the target's]",
            Self::Scale => "multiply the amplitude of every drive [default: 1]",
            Self::Model => match command {
                Command::Optimise => {
                    "search under this model [default: both; for the objective contrast membrane]"
                }
                Command::Simulate => "model of skin and afferents [default: membrane]",
                Command::Discriminate => "model of skin and afferents [default: afferents]",
            },
            Self::Objective => "maximise this [default: off-rms-twice]",
            Self::Setting => "search space [default: default]",
            Self::Robust => "maximise the mean over eight fingers [default: false]",
            Self::Evaluations => "end after about so many per frame; 0: when nothing improves [default: 0]",
            Self::Gain => "travel of all motors, 1 as designed [default: 1]",
            Self::ShiftXMm => "finger off along x, mm [default: 0]",
            Self::ShiftYMm => "finger off along y, mm [default: 0]",
            Self::Finger => match command {
                Command::Discriminate => "seed of the finger's afferents [default: 0]",
                _ => "seed of the finger's afferents [default: the target's]",
            },
            Self::Trials => "trials of each pattern [default: 24]",
            Self::IntervalS => "duration of an interval, s [default: 1]",
            Self::ResolutionMs => "width of a bin of spike times, ms [default: 5]",
            Self::Efficiency => "efficiency of the observer, 1 is ideal [default: 1]",
            Self::Seed => match command {
                Command::Optimise => "seed of the search [default: 0]",
                Command::Simulate => "seed of the threshold noise [default: the finger's]",
                Command::Discriminate => "seed of the noise [default: 0]",
            },
        }
    }
}

/// The largest amplitude of any known array, µm. A target's own array may have a smaller one.
fn largest_amplitude_um() -> f64 {
    let arrays = spec::names().into_iter().filter_map(|name| Array::named(name).ok());
    arrays.map(|array| array.motor().travel_um).fold(0.0, f64::max)
}
