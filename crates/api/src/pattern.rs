//! Patterns as the API lists, shows and stores them.
//!
//! The pattern itself has the same keys here as in its TOML file; `meissner-array` reads and checks that file. [`PatternFile`]
//! and [`PatternDrive`] only describe its JSON form for the API reference.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// One pattern in a list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PatternSummary {
    /// The pattern's name: a-z, 0-9 and `-`, at most 64 characters.
    pub name: String,
    /// Whether the pattern belongs to the built-in library, which cannot be overwritten.
    pub library: bool,
    /// Duration of one run, s; null: the pattern has no end.
    #[schema(required, minimum = 0.0, maximum = 1e8)]
    pub duration_s: Option<f64>,
    /// Number of drives.
    #[schema(maximum = 4096)]
    pub drives: usize,
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
}

/// Every pattern the daemon can play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "patterns": [{
        "name": "edge-45", "library": true, "duration_s": null, "drives": 12,
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
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
    "warnings": []
})))]
pub struct PatternDetails {
    /// The pattern, with the keys of its file.
    #[schema(value_type = PatternFile)]
    pub pattern: Value,
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
    /// Whether the pattern belongs to the built-in library.
    pub library: bool,
    /// One line for each thing that may not be meant, for example a saturated drive: the first 100, and how many more.
    pub warnings: Vec<String>,
}

/// A pattern's JSON form, for the API reference.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternFile {
    /// Version of the file format.
    #[schema(minimum = 1, maximum = 1)]
    pub format: u8,
    /// The pattern's name: a-z, 0-9 and `-`, at most 64 characters.
    pub name: String,
    /// Duration of one run, s; without it the pattern has no end.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub duration_s: Option<f64>,
    /// The square waves, each on one motor.
    #[serde(default)]
    #[schema(max_items = 4096)]
    pub drive: Vec<PatternDrive>,
    /// What made the pattern: target, seed, settings, method. Any keys, at most 16384 with the items of lists.
    #[serde(default)]
    pub provenance: Map<String, Value>,
}

/// A square wave on one motor.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternDrive {
    /// The motor's number, 4 × row + column.
    #[schema(minimum = 0, maximum = 23)]
    pub motor: u8,
    /// Frequency, Hz.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub frequency_hz: f64,
    /// Amplitude peak to peak, µm; 0 is off.
    #[schema(minimum = 0.0, maximum = 400.0)]
    pub amplitude_um: f64,
    /// Delay of the first upward edge after the drive's start, cycles.
    #[schema(minimum = 0.0, exclusive_maximum = 1.0)]
    pub phase: f64,
    /// Start of the drive in pattern time, s; without it the drive starts with the pattern.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub start_s: Option<f64>,
    /// End of the drive in pattern time, s: its last stroke has ended by then. Without it the drive ends with the pattern.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub stop_s: Option<f64>,
}

/// A pattern that was stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "name": "two-pins",
    "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "warnings": []
})))]
pub struct ImportedPattern {
    /// The pattern's name.
    pub name: String,
    /// SHA-256 of the bytes that were sent, in hexadecimal.
    pub sha256: String,
    /// One line for each thing that may not be meant, for example a saturated drive: the first 100, and how many more.
    pub warnings: Vec<String>,
}
