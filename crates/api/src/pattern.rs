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
    /// The array that the pattern is for.
    #[serde(default)]
    #[schema(required)]
    pub array: String,
    /// Whether the pattern belongs to the built-in library, which cannot be overwritten.
    pub library: bool,
    /// Duration of one run, s; null: the pattern has no end.
    #[schema(required, minimum = 0.0, maximum = 1e8)]
    pub duration_s: Option<f64>,
    /// Number of drives.
    #[schema(maximum = 4096)]
    pub drives: usize,
    /// Number of drives that give a stroke in one run: the others never move their motor.
    #[serde(default)]
    #[schema(required, maximum = 4096)]
    pub drives_moving: usize,
    /// Number of motions.
    #[serde(default)]
    #[schema(required, maximum = 4096)]
    pub motions: usize,
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
    /// When the last whole stroke of one run ends, ms; null: the pattern has no end, or no stroke.
    #[serde(default)]
    #[schema(required, minimum = 0.0)]
    pub compiled_ms: Option<f64>,
    /// The smallest amplitude that a drive reaches, peak to peak, µm; null without drives.
    #[serde(default)]
    #[schema(required, minimum = 0.0)]
    pub reached_min_um: Option<f64>,
    /// The largest amplitude that a drive reaches, peak to peak, µm; null without drives.
    #[serde(default)]
    #[schema(required, minimum = 0.0)]
    pub reached_max_um: Option<f64>,
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
    #[schema(minimum = 0.0)]
    pub ordered_um: f64,
    /// Amplitude that an ideal motor reaches in the steady state, peak to peak, µm: in whole pulses, as many as fit, which
    /// the motor follows as the array's description says. 0: the drive gives no stroke.
    #[schema(minimum = 0.0)]
    pub reached_um: f64,
    /// By how much its down bursts are longer than its up bursts, µm; a lower stop takes that.
    #[schema(minimum = 0.0)]
    pub surplus_um: f64,
    /// Number of its strokes; null: without end.
    #[schema(required)]
    pub strokes: Option<u64>,
}

/// How an ideal motor follows its motions in one run of a pattern, computed before anything is played.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FollowedMotion {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// The highest displacement asked, µm above rest.
    #[schema(minimum = 0.0)]
    pub highest_um: f64,
    /// Root mean square of what the pin does less what was asked, µm: the motor's speed, its lag and smoothing, and the steps count.
    #[schema(minimum = 0.0)]
    pub error_um: f64,
    /// It as a share of the RMS of what was asked about its mean; 0 if that does not move.
    #[schema(minimum = 0.0)]
    pub error_share: f64,
    /// The largest difference from what a motor of this speed would do without steps, µm.
    #[schema(minimum = 0.0)]
    pub step_error_um: f64,
    /// From when on the motor is too slow for it first, s; null: it is fast enough throughout.
    #[schema(required, minimum = 0.0)]
    pub too_slow_from_s: Option<f64>,
    /// Moves per second.
    #[schema(minimum = 0.0)]
    pub moves_per_s: f64,
    /// How much of it the errors and the moves are of, from its beginning, s: the motors of a pattern share four minutes.
    #[schema(minimum = 0.0)]
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
    #[schema(minimum = 0.0)]
    pub most_ma: f64,
    /// Mean current, mA.
    #[schema(minimum = 0.0)]
    pub mean_ma: f64,
}

/// Every pattern the daemon can play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "patterns": [{
        "name": "edge-45", "array": "tula35-6x4", "library": true, "duration_s": null, "drives": 12, "drives_moving": 12, "motions": 0,
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
        "compiled_ms": null, "reached_min_um": 69.2, "reached_max_um": 69.2
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
    #[schema(value_type = PatternFile)]
    pub pattern: Value,
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
    /// Whether the pattern belongs to the built-in library.
    pub library: bool,
    /// When the last whole stroke of one run ends, ms; null: the pattern has no end, or no stroke.
    #[serde(default)]
    #[schema(required, minimum = 0.0)]
    pub compiled_ms: Option<f64>,
    /// What each drive reaches in one run.
    #[serde(default)]
    #[schema(required, max_items = 4096)]
    pub drives: Vec<ReachedDrive>,
    /// What each rail draws.
    #[serde(default)]
    #[schema(required, max_items = 64)]
    pub rails: Vec<RailLoad>,
    /// One line for each thing that may not be meant, for example a drive that does not reach its amplitude: the first 100, and how many more.
    pub warnings: Vec<String>,
}

/// A pattern's JSON form, for the API reference.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternFile {
    /// Version of the file format.
    #[schema(minimum = 1, maximum = 2)]
    pub format: u8,
    /// The pattern's name: a-z, 0-9 and `-`, at most 64 characters.
    pub name: String,
    /// The array that the pattern is for; without it `tula35-6x4`, the paper's.
    #[serde(default)]
    pub array: Option<String>,
    /// Duration of one run, s; without it the pattern has no end.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub duration_s: Option<f64>,
    /// The square waves, each on one motor.
    #[serde(default)]
    #[schema(max_items = 4096)]
    pub drive: Vec<PatternDrive>,
    /// The samples of displacement, each on one motor; format 2.
    #[serde(default)]
    #[schema(max_items = 4096)]
    pub wave: Vec<PatternWave>,
    /// The ramps; format 2.
    #[serde(default)]
    #[schema(max_items = 4096)]
    pub ramp: Vec<PatternRamp>,
    /// The tones and chirps; format 2.
    #[serde(default)]
    #[schema(max_items = 4096)]
    pub tone: Vec<PatternTone>,
    /// The noises; format 2.
    #[serde(default)]
    #[schema(max_items = 4096)]
    pub noise: Vec<PatternNoise>,
    /// What made the pattern: target, seed, settings, method. Any keys, at most 16384 with the items of lists.
    #[serde(default)]
    pub provenance: Map<String, Value>,
}

/// A square wave on one motor.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternDrive {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// Frequency, Hz.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub frequency_hz: f64,
    /// Amplitude peak to peak, µm; 0 is off.
    #[schema(minimum = 0.0, maximum = 5000.0)]
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

/// Samples of displacement on one motor, packed.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternWave {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// When the first sample is, in pattern time, s.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub start_s: f64,
    /// Rate of the samples, Hz.
    #[schema(minimum = 1.0, maximum = 8000.0)]
    pub rate_hz: f64,
    /// What the samples were made from.
    pub source: Option<String>,
    /// The samples, µm above rest: base64 of 32-bit floating-point numbers, least significant byte first.
    pub samples: String,
}

/// From rest to a level, held, and back, on one motor.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternRamp {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// When it begins, in pattern time, s.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub start_s: f64,
    /// The level, µm above rest.
    #[schema(minimum = 0.0)]
    pub to_um: f64,
    /// How long the way up lasts, s.
    #[schema(minimum = 0.0)]
    pub rise_s: f64,
    /// How long the level is held, s.
    #[schema(minimum = 0.0)]
    pub hold_s: f64,
    /// How long the way down lasts, s; without it as long as the way up.
    #[schema(minimum = 0.0)]
    pub fall_s: Option<f64>,
    /// `linear` or `cosine`.
    pub shape: String,
}

/// A sine or a linear chirp on one motor.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternTone {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// When it begins, in pattern time, s.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub start_s: f64,
    /// How long it lasts, s.
    #[schema(minimum = 0.001)]
    pub duration_s: f64,
    /// Frequency at its beginning, Hz.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub frequency_hz: f64,
    /// Frequency at its end, Hz; without it that at its beginning.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub end_hz: Option<f64>,
    /// Amplitude peak to peak, µm.
    #[schema(minimum = 0.0)]
    pub amplitude_um: f64,
    /// The level that it swings about, µm; without it half the amplitude.
    #[schema(minimum = -1e6)]
    pub about_um: Option<f64>,
    /// Phase at its beginning, cycles.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub phase: f64,
    /// `hann`, or `attack_s` and `release_s`.
    pub envelope: Option<PatternEnvelope>,
}

/// How a tone or noise begins and ends.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum PatternEnvelope {
    /// `hann`.
    Named(String),
    /// It rises at the beginning and falls at the end.
    Edges(PatternEdges),
}

/// The edges of an envelope.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternEdges {
    /// How long it rises, s.
    #[schema(minimum = 0.0)]
    pub attack_s: f64,
    /// How long it falls, s.
    #[schema(minimum = 0.0)]
    pub release_s: f64,
}

/// Gaussian noise of a band on one motor.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PatternNoise {
    /// The motor's number.
    #[schema(minimum = 0, maximum = 63)]
    pub motor: u8,
    /// When it begins, in pattern time, s.
    #[schema(minimum = 0.0, maximum = 1e8)]
    pub start_s: f64,
    /// How long it lasts, s.
    #[schema(minimum = 0.001)]
    pub duration_s: f64,
    /// Lower edge of the band, Hz.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub low_hz: f64,
    /// Upper edge of the band, Hz.
    #[schema(minimum = 0.1, maximum = 300.0)]
    pub high_hz: f64,
    /// Its root mean square, µm.
    #[schema(minimum = 0.0)]
    pub rms_um: Option<f64>,
    /// Its largest value, µm.
    #[schema(minimum = 0.0)]
    pub peak_um: Option<f64>,
    /// The level that it swings about, µm; without it its largest value.
    #[schema(minimum = -1e6)]
    pub about_um: Option<f64>,
    /// Equal seeds give equal noise.
    #[schema(minimum = 0)]
    pub seed: i64,
    /// `hann`, or `attack_s` and `release_s`.
    pub envelope: Option<PatternEnvelope>,
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
    #[serde(default)]
    #[schema(required)]
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
