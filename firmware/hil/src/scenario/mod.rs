//! Scenario files: what the host does, what goes wrong, and what has to come of it; the same for mock and chip.
//!
//! Times are of the device's clock, from its boot; after a failure of the core those of the next boot. Onsets are
//! given as ticks, so that both benches choose the same. Unknown keys are errors.

mod compare;
mod outcome;
mod play;

use crate::bench::{CpuEvent, Function};
use crate::rig::Faults;
pub use compare::compare;
use meissner_array::pattern::{Drive, Pattern, PatternError};
use meissner_stream::queues::End;
pub use outcome::compiled;
pub use play::{Ran, run};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A scenario.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// As its file.
    pub name: String,
    /// What it shows.
    pub description: String,
    /// The USB function the host uses.
    #[serde(default)]
    pub function: Function,
    /// What the line does to the host's frames.
    #[serde(default)]
    pub faults: Faults,
    /// How far cuts may lie apart on mock and chip: the chip takes bytes some ticks later. All else is equal.
    #[serde(default)]
    pub slack_ticks: u64,
    /// When it ends.
    pub end_ms: f64,
    /// What happens.
    #[serde(rename = "step")]
    pub steps: Vec<Step>,
    /// What has to come of the plays that are not refused, in the order in which they were ordered.
    #[serde(default)]
    pub plays: Vec<PlayEnd>,
    /// Causes of all cuts, in order.
    #[serde(default)]
    pub cuts: Vec<String>,
    /// Whether the device has to have counted frames that it could not read.
    #[serde(default)]
    pub bad_frames: bool,
}

/// Something that happens.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// When, on the device's clock.
    pub at_ms: f64,
    /// So many ticks later.
    #[serde(default)]
    pub ticks: u64,
    /// And so many cycles: the phase in the tick.
    #[serde(default)]
    pub cycles: u64,
    /// What.
    pub act: Act,
    /// From so many ticks later on all lines have to be low, until the next `arm` or onset.
    pub low_within_ticks: Option<u64>,
    /// The order has to be refused.
    #[serde(default)]
    pub refused: bool,
}

/// What happens.
#[expect(missing_docs, reason = "the keys of the file say what they are")]
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Act {
    /// The motors are armed; all pins are at rest, or nobody says so.
    Arm { assume_rest: bool },
    /// A pattern is played, open loop.
    Play {
        /// A shipped one, or `full-load`.
        pattern: String,
        /// How long.
        seconds: f64,
        /// Its onset.
        onset_ms: f64,
    },
    /// The play is stopped.
    Stop,
    /// Emergency stop.
    Estop,
    /// The latch is left.
    Reset,
    /// The motors are disarmed.
    Disarm,
    /// A stroke of a motor gets new counts, by a message beside the streamer's: the n-th sent, from 0.
    Amend { motor: u8, stroke: usize, up: Option<u16>, down: Option<u16> },
    /// The host's process is held up for so many ms.
    Stall(f64),
    /// The host's process does nothing any more.
    Kill,
    /// Another host's process begins in its place.
    Revive,
    /// Another host takes over, through this function.
    TakeOver(Function),
    /// The cable is pulled.
    Unplug,
    /// It is plugged in.
    Plug,
    /// The tty is closed.
    Close,
    /// It is opened.
    Open,
    /// The first half of a frame is sent.
    HalfFrame,
    /// Bytes between frames, as hex digits.
    Raw(String),
    /// Bytes for the function that the host does not use.
    Stray(String),
    /// From now on the line does this.
    Faults(Faults),
    /// The core fails.
    Cpu(CpuEvent),
    /// How the device has to stand, by its own word.
    Check(Check),
}

/// How the device has to stand.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Check {
    /// `armed`, `disarmed`, `returning` or `faulted`.
    pub state: Option<String>,
    /// As events name it.
    pub cause: Option<String>,
    /// The same on the chip, whose firmware knows why it started; the mock just starts.
    pub chip_cause: Option<String>,
    /// Whether it knows where pins are.
    pub position_known: Option<bool>,
    /// Whether pins are owed something.
    pub outstanding: Option<bool>,
    /// Whether a host can talk to it.
    pub connected: Option<bool>,
    /// Boots so far.
    pub boots: Option<usize>,
}

/// What has to come of a play.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayEnd {
    /// How it ends.
    pub end: End,
    /// Whether each planned burst is played, or some, or none.
    pub played: Share,
    /// Whether strokes come late.
    #[serde(default)]
    pub late: bool,
    /// Bursts with an amended count.
    #[serde(default)]
    pub amended: u64,
}

/// How much of a play is played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Share {
    /// Everything.
    All,
    /// Something, not everything.
    Some,
    /// Nothing.
    None,
}

/// Why there is no scenario.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("{0}: {1}")]
    File(PathBuf, #[source] std::io::Error),
    /// Not a scenario.
    #[error("{0}: {1}")]
    Toml(PathBuf, #[source] toml::de::Error),
    /// Its name is not its file's.
    #[error("{0}: is named `{1}` inside")]
    Name(PathBuf, String),
    /// A pattern that cannot be played.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// Strokes that cannot be made.
    #[error(transparent)]
    Strokes(#[from] meissner_array::strokes::StrokesError),
    /// The run broke off.
    #[error(transparent)]
    Rig(#[from] crate::rig::RigError),
    /// Digits that are none.
    #[error("`{0}`: no hex digits")]
    Hex(String),
    /// A stroke to amend that was not sent.
    #[error("motor {0} has no stroke {1} to amend yet")]
    NoStroke(u8, usize),
}

/// Files of a folder beside this crate with this ending, sorted.
fn files(folder: &str) -> Result<Vec<PathBuf>, ScenarioError> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let failed = |error| ScenarioError::File(folder.clone(), error);
    let entries = std::fs::read_dir(&folder).map_err(failed)?;
    let mut files: Vec<_> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|path| path.extension().is_some_and(|end| end == "toml"));
    files.sort();
    Ok(files)
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

impl Scenario {
    /// The names of all scenarios.
    ///
    /// # Errors
    /// If their folder is not there.
    pub fn names() -> Result<Vec<String>, ScenarioError> {
        let mut names: Vec<_> = files("../scenarios")?.iter().map(|path| stem(path)).collect();
        names.sort();
        Ok(names)
    }

    /// Reads one by its name.
    ///
    /// # Errors
    /// If it is not there, or none.
    pub fn read(name: &str) -> Result<Self, ScenarioError> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../scenarios/{name}.toml"));
        let text =
            std::fs::read_to_string(&path).map_err(|error| ScenarioError::File(path.clone(), error))?;
        let scenario: Self =
            toml::from_str(&text).map_err(|error| ScenarioError::Toml(path.clone(), error))?;
        if scenario.name == name { Ok(scenario) } else { Err(ScenarioError::Name(path, scenario.name)) }
    }
}

/// The shipped patterns' names.
///
/// # Errors
/// If their folder is not there.
pub fn pattern_names() -> Result<Vec<String>, ScenarioError> {
    Ok(files("../../patterns")?.iter().map(|path| stem(path)).collect())
}

/// A shipped pattern, or `full-load`: all motors reversing 600 times a second, each at a phase of its own.
///
/// # Errors
/// If it is not there, or none.
pub fn pattern(name: &str) -> Result<Pattern, ScenarioError> {
    if name == "full-load" {
        let drive = |motor: u8| Drive {
            motor,
            frequency_hz: 300.0,
            amplitude_um: 17.0,
            phase: f64::from(motor * 7 % 24) / 24.0,
            start_s: None,
            stop_s: None,
        };
        return Ok(Pattern::new(name, None, (0..24).map(drive).collect(), toml::Table::new())?);
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../patterns/{name}.toml"));
    let text = std::fs::read_to_string(&path).map_err(|error| ScenarioError::File(path.clone(), error))?;
    Ok(Pattern::parse(&text, name)?)
}
