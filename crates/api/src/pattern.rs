//! Patterns as the API lists, shows and stores them.
//!
//! The pattern itself has the same keys here as in its TOML file (docs/reference/pattern.md); `meissner-array` reads and checks that file.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

/// One pattern in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PatternSummary {
    /// The pattern's name: a-z, 0-9 and `-`, at most 64 characters.
    pub name: String,
    /// The array that the pattern is for.
    pub array: String,
    /// Whether the pattern belongs to the built-in library, which cannot be overwritten.
    pub library: bool,
    /// Duration of one run, s; null: the pattern has no end.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub duration_s: Option<f64>,
    /// Number of drives.
    #[schema(maximum = 4096)]
    pub drives: usize,
    /// Number of drives that give a stroke in one run: the others never move their motor.
    #[schema(maximum = 4096)]
    pub drives_moving: usize,
    /// Number of motions.
    #[schema(maximum = 4096)]
    pub motions: usize,
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
    /// When the last whole stroke of one run ends, ms; null: the pattern has no end, or no stroke.
    pub compiled_ms: Option<f64>,
    /// The greatest height of a pin above rest, as in the pattern's details, µm; 0: no pin moves.
    pub highest_um: f64,
}

/// The amplitude of a drive, as ordered and as an ideal motor reaches it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReachedDrive {
    /// The drive's place in the pattern, from 1.
    #[schema(minimum = 1, maximum = 4096)]
    pub drive: usize,
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Amplitude as ordered, peak to peak, µm.
    pub ordered_um: f64,
    /// Amplitude that an ideal motor reaches in the steady state, peak to peak, µm: in whole pulses, as many as fit, which
    /// the motor follows as the array's description says. 0: the drive gives no stroke.
    pub reached_um: f64,
    /// By how much its down bursts are longer than its up bursts, µm; a lower stop takes that.
    pub surplus_um: f64,
    /// Number of its strokes; null: without end.
    pub strokes: Option<u64>,
}

/// How an ideal motor follows its motions in one run of a pattern, computed before anything is played.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FollowedMotion {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// The highest displacement asked, µm above rest.
    pub highest_um: f64,
    /// Root mean square of what the pin does less what was asked, µm: the motor's speed, its lag and smoothing, and the steps count.
    pub error_um: f64,
    /// It as a share of the RMS of what was asked about its mean; 0 if that does not move.
    pub error_share: f64,
    /// The largest difference from what a motor of this speed would do without steps, µm.
    pub step_error_um: f64,
    /// From when on the motor is too slow for it first, s; null: it is fast enough throughout.
    pub too_slow_from_s: Option<f64>,
    /// Moves per second.
    pub moves_per_s: f64,
    /// How much of it the errors and the moves are of, from its beginning, s: the motors of a pattern share four minutes.
    pub measured_s: f64,
}

/// What the motors of a 30 V rail draw in a pattern's first ten seconds, for motors of 3 nF; the current is proportional to the
/// capacitance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RailLoad {
    /// The rail's number, from 0: its place in `rails` of the array.
    #[schema(minimum = 0, maximum = 63)]
    pub rail: u8,
    /// Most motors that have pulses at once.
    #[schema(minimum = 0, maximum = 64)]
    pub most_at_once: u8,
    /// Mean number of motors that have pulses.
    #[schema(minimum = 0.0, maximum = 64.0)]
    pub mean_at_once: f64,
    /// Highest current, mA.
    pub most_ma: f64,
    /// Mean current, mA.
    pub mean_ma: f64,
}

/// Every pattern the daemon can play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "patterns": [{
        "name": "edge-45", "array": "tula35-6x4", "library": true, "duration_s": null, "drives": 12, "drives_moving": 12, "motions": 0,
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
        "compiled_ms": null, "highest_um": 69.2
    }],
    "errors": ["/var/lib/meissner/patterns/draft.toml:2: unknown key `nane`: did you mean `name`?"]
})))]
pub struct PatternList {
    /// The patterns, sorted by name.
    pub patterns: Vec<PatternSummary>,
    /// One line for each file that cannot be read as a pattern: the first 100, and how many more there are.
    pub errors: Vec<String>,
}

/// One pattern in full.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "pattern": {
        "format": 1, "name": "two-pins", "duration_s": 1.0,
        "drive": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0, "phase": 0.0, "stop_s": 0.5}]
    },
    "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "library": false,
    "compiled_ms": 495.1,
    "drives": [
        {"drive": 1, "motor": 9, "ordered_um": 40.0, "reached_um": 39.9, "surplus_um": 0.0, "strokes": 30}
    ],
    "highest_um": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 39.9],
    "rails": [
        {"rail": 0, "most_at_once": 0, "mean_at_once": 0.0, "most_ma": 0.0, "mean_ma": 0.0},
        {"rail": 1, "most_at_once": 1, "mean_at_once": 0.2, "most_ma": 30.6, "mean_ma": 6.2},
        {"rail": 2, "most_at_once": 0, "mean_at_once": 0.0, "most_ma": 0.0, "mean_ma": 0.0},
        {"rail": 3, "most_at_once": 0, "mean_at_once": 0.0, "most_ma": 0.0, "mean_ma": 0.0}
    ],
    "warnings": []
})))]
pub struct PatternDetails {
    /// The pattern, with the keys of its file.
    #[schema(value_type = std::collections::BTreeMap<String, Value>)]
    pub pattern: Value,
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
    /// Whether the pattern belongs to the built-in library.
    pub library: bool,
    /// When the last whole stroke of one run ends, ms; null: the pattern has no end, or no stroke.
    pub compiled_ms: Option<f64>,
    /// What each drive reaches in one run.
    #[schema(max_items = 4096)]
    pub drives: Vec<ReachedDrive>,
    /// By motor, the greatest height above rest in one run, µm: as drives reach it, and as motions ask it. 0: the pin does not move.
    #[schema(max_items = 64)]
    pub highest_um: Vec<f64>,
    /// What each rail draws.
    #[schema(max_items = 64)]
    pub rails: Vec<RailLoad>,
    /// One line for each thing that may not be meant, for example a drive that does not reach its amplitude: the first 100, and how many more.
    pub warnings: Vec<String>,
}

/// A pattern that was stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "name": "two-pins",
    "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "replaced_sha256": null,
    "warnings": []
})))]
pub struct ImportedPattern {
    /// The pattern's name.
    pub name: String,
    /// SHA-256 of the bytes that were sent, in hexadecimal.
    pub sha256: String,
    /// SHA-256 of the file that this one has replaced, in hexadecimal; null if the name was new.
    pub replaced_sha256: Option<String>,
    /// One line for each thing that may not be meant, for example a drive that does not reach its amplitude: the first 100, and how many more.
    pub warnings: Vec<String>,
}

/// A pattern that was removed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "name": "two-pins", "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
})))]
pub struct RemovedPattern {
    /// The pattern's name.
    pub name: String,
    /// SHA-256 of the file that was removed, in hexadecimal.
    pub sha256: String,
}
