//! Scenario files: what the host does, what fails, and what must be the result, for mock and chip.
//!
//! Times are those of the device's clock since its boot; after a failure of the core, since the next boot. Onsets are
//! converted to ticks, so both benches use the same. Unknown keys are errors.
//!
//! `play` plays a scenario and holds what its boots put on the pins until they are judged. `outcome` checks the plays, and `compare` the
//! mock against the chip.

mod compare;
mod outcome;
mod play;

use crate::bench::{CpuEvent, Function};
use crate::rig::Faults;
pub use compare::compare;
use meissner_array::pattern::{Drive, Pattern, PatternError};
use meissner_array::spec::Array;
use meissner_stream::queues::End;
use meissner_test_support::paper::MOTORS;
pub use outcome::compiled;
pub use play::{Ran, run};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A scenario.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Name, as that of its file.
    pub name: String,
    /// What it shows.
    pub description: String,
    /// The USB function the host uses.
    #[serde(default)]
    pub function: Function,
    /// Faults of the line for the host's frames.
    #[serde(default)]
    pub faults: Faults,
    /// Most ticks between a cut on the mock and on the chip, because the chip takes bytes some ticks later.
    #[serde(default)]
    pub slack_ticks: u64,
    /// End of the scenario.
    pub end_ms: f64,
    /// The steps.
    #[serde(rename = "step")]
    pub steps: Vec<Step>,
    /// Results of the plays that are not refused, in the order of their commands.
    #[serde(default)]
    pub plays: Vec<PlayEnd>,
    /// Expected causes of all cuts, in order.
    #[serde(default)]
    pub cuts: Vec<String>,
    /// Whether the device must have counted bad frames.
    #[serde(default)]
    pub bad_frames: bool,
}

/// A step.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Time on the device's clock.
    pub at_ms: f64,
    /// This many ticks later.
    #[serde(default)]
    pub ticks: u64,
    /// And this many cycles: the phase within the tick.
    #[serde(default)]
    pub cycles: u64,
    /// The action.
    pub act: Act,
    /// From this many ticks later, all lines must be low until the next `arm` or onset.
    pub low_within_ticks: Option<u64>,
    /// The command must be refused.
    #[serde(default)]
    pub refused: bool,
}

/// An action.
#[expect(missing_docs, reason = "the keys of the file say what they are")]
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Act {
    /// Arm the motors, with or without `assume_rest`.
    Arm { assume_rest: bool },
    /// Play a pattern, open loop.
    Play {
        /// A shipped one, or `full-load`.
        pattern: String,
        /// Duration.
        seconds: f64,
        /// Its onset.
        onset_ms: f64,
    },
    /// Stop the play.
    Stop,
    /// Emergency stop.
    Estop,
    /// Reset after an e-stop or a fault.
    Reset,
    /// Disarm the motors.
    Disarm,
    /// Amend the n-th stroke sent to a motor, from 0, by a message besides the streamer's.
    Amend { motor: u8, stroke: usize, up: Option<u16>, down: Option<u16> },
    /// Stall the host's process for this many ms.
    Stall(f64),
    /// Stop the host's process for ever.
    Kill,
    /// Start another host process in its place.
    Revive,
    /// Have another host take over, through this function.
    TakeOver(Function),
    /// Unplug the cable.
    Unplug,
    /// Plug the cable in.
    Plug,
    /// Close the tty.
    Close,
    /// Open the tty.
    Open,
    /// Send the first half of a frame.
    HalfFrame,
    /// Send bytes between frames, as hex digits.
    Raw(String),
    /// Send bytes to the function that the host does not use.
    Stray(String),
    /// Set the faults of the line.
    Faults(Faults),
    /// Make the core fail.
    Cpu(CpuEvent),
    /// Check the device's status.
    Check(Check),
}

/// Expected status of the device.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Check {
    /// `armed`, `disarmed`, `returning` or `faulted`.
    pub state: Option<String>,
    /// The cause, as events name it.
    pub cause: Option<String>,
    /// The cause on the chip, if it differs: the firmware knows why it started, the mock does not.
    pub chip_cause: Option<String>,
    /// Whether the device knows where the pins are.
    pub position_known: Option<bool>,
    /// Whether return pulses are outstanding.
    pub outstanding: Option<bool>,
    /// Whether USB is configured.
    pub connected: Option<bool>,
    /// Number of boots so far.
    pub boots: Option<usize>,
}

/// Expected result of a play.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlayEnd {
    /// How it ends.
    pub end: End,
    /// Whether all planned bursts are played, or some, or none.
    pub played: Share,
    /// Whether strokes are late.
    #[serde(default)]
    pub late: bool,
    /// Number of bursts with an amended count.
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

/// Why a scenario cannot be read or played.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("{0}: {1}")]
    File(PathBuf, #[source] std::io::Error),
    /// The file is not a scenario.
    #[error("{0}: {1}")]
    Toml(PathBuf, #[source] toml::de::Error),
    /// Its name is not that of its file.
    #[error("{0}: is named `{1}` inside")]
    Name(PathBuf, String),
    /// The pattern cannot be played.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The pattern cannot be compiled to strokes.
    #[error(transparent)]
    Strokes(#[from] meissner_array::strokes::StrokesError),
    /// The bench failed.
    #[error(transparent)]
    Rig(#[from] crate::rig::RigError),
    /// Not hex digits.
    #[error("`{0}`: no hex digits")]
    Hex(String),
    /// The stroke to amend was not sent.
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
    /// If their folder is missing.
    pub fn names() -> Result<Vec<String>, ScenarioError> {
        let mut names: Vec<_> = files("../scenarios")?.iter().map(|path| stem(path)).collect();
        names.sort();
        Ok(names)
    }

    /// Reads a scenario by its name.
    ///
    /// # Errors
    /// If it is missing or not valid.
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
/// If their folder is missing.
pub fn pattern_names() -> Result<Vec<String>, ScenarioError> {
    Ok(files("../../library/patterns")?.iter().map(|path| stem(path)).collect())
}

/// A shipped pattern, or `full-load`: all motors reverse 600 times a second, each with its own phase.
///
/// # Errors
/// If it is missing or not valid.
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
        return Ok(Pattern::new(
            Array::paper(),
            name,
            None,
            (0..MOTORS as u8).map(drive).collect(),
            toml::Table::new(),
        )?);
    }
    let folder = if name.ends_with("-paper") { "library/patterns/paper" } else { "library/patterns" };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../{folder}/{name}.toml"));
    let text = std::fs::read_to_string(&path).map_err(|error| ScenarioError::File(path.clone(), error))?;
    Ok(Pattern::parse(&text, name)?)
}
