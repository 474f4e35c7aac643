//! Targets as the API lists, shows and stores them.
//!
//! The target itself has the same keys here as in its TOML file; `meissner-design` reads and checks that file. [`TargetFile`] and its
//! parts only describe its JSON form for the API reference.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// One target in a list.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct TargetSummary {
    /// The target's name: a-z, 0-9 and `-`, at most 64 characters.
    pub name: String,
    /// Whether the target is built in and cannot be overwritten.
    pub library: bool,
    /// `segment`, `polyline`, `disc`, `dots` or `grating`; a Braille character is `dots`.
    pub shape: String,
    /// Whether the shape moves.
    pub moves: bool,
    /// SHA-256 of the target's file, in hexadecimal.
    pub sha256: String,
}

/// Every target that the daemon knows.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "targets": [{
        "name": "edge-45", "library": true, "shape": "segment", "moves": false,
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
    }],
    "errors": []
})))]
pub struct TargetList {
    /// The targets, sorted by name.
    pub targets: Vec<TargetSummary>,
    /// One line for each file that cannot be read as a target: the first 100, and how many more there are.
    pub errors: Vec<String>,
}

/// One target in full.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "target": {
        "name": "my-edge", "shape": "segment", "points": [[-4.0, 0.0], [4.0, 0.0]], "reach_mm": 1.5, "amplitude_um": 80.0,
        "duration_s": 5.0, "population": {"seed": 0}
    },
    "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "library": false,
    "outline": [[[-4.0, 0.0], [4.0, 0.0]]],
    "warnings": []
})))]
pub struct TargetDetails {
    /// The target with all keys of its file; a Braille character as its dots.
    #[schema(value_type = TargetFile)]
    pub target: Value,
    /// SHA-256 of the target's file, in hexadecimal.
    pub sha256: String,
    /// Whether the target is built in.
    pub library: bool,
    /// Lines that draw the shape, of a moving one in the middle of its motion: places in mm from the array's middle, x across the finger
    /// and y towards the fingertip. A dot is a line of one place.
    pub outline: Vec<Vec<[f64; 2]>>,
    /// One line for each detail that the array cannot show.
    pub warnings: Vec<String>,
}

/// A target's JSON form, for the API reference. The shape decides which of the keys there may be.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetFile {
    /// The target's name: a-z, 0-9 and `-`, at most 64 characters.
    pub name: String,
    /// The name of the array that it is for; without it the paper's.
    pub array: Option<String>,
    /// `segment`, `polyline`, `disc`, `dots`, `braille` or `grating`.
    pub shape: String,
    /// Of a segment its 2 ends, of a polyline 2 to 64 points, of dots 1 to 64: places on the pad, mm.
    #[schema(max_items = 64)]
    pub points: Option<Vec<[f64; 2]>>,
    /// Of a disc or a Braille cell: its centre, mm; without it the array's middle.
    pub center_mm: Option<[f64; 2]>,
    /// Of a disc: its radius, mm.
    #[schema(minimum = 0.0, maximum = 24.0)]
    pub radius_mm: Option<f64>,
    /// Of Braille: a letter a to z, or a six-dot character of Unicode.
    pub character: Option<String>,
    /// Of Braille: the pitch of the dots, mm; without it 5.8.
    #[schema(minimum = 0.1, maximum = 24.0)]
    pub dot_pitch_mm: Option<f64>,
    /// Of a grating: the distance from line to line, mm.
    #[schema(minimum = 0.1, maximum = 1000.0)]
    pub period_mm: Option<f64>,
    /// Of a grating: the direction of its lines, degrees anticlockwise from x; without it 0.
    #[schema(minimum = -360.0, maximum = 360.0)]
    pub angle_deg: Option<f64>,
    /// Of a grating: the distance of a line from the array's middle, to the left of that direction, mm; without it 0.
    #[schema(minimum = -1000.0, maximum = 1000.0)]
    pub offset_mm: Option<f64>,
    /// The distance from the shape within which an afferent should fire, mm; without it 1.5.
    #[schema(minimum = 0.0, maximum = 24.0)]
    pub reach_mm: Option<f64>,
    /// The amplitude of all motors, peak to peak, µm; without it 80.
    #[schema(minimum = 0.0, maximum = 5000.0)]
    pub amplitude_um: Option<f64>,
    /// The duration of a pattern for it, s; without it 5. Not with `motion`.
    #[schema(minimum = 0.001, maximum = 1e8)]
    pub duration_s: Option<f64>,
    /// The simulated finger.
    pub population: Option<TargetPopulation>,
    /// Parameters of the first afferent model, as in a scene.
    #[serde(default)]
    pub afferent: Map<String, Value>,
    /// How the shape moves; without it, it is at rest.
    pub motion: Option<TargetMotion>,
}

/// The simulated finger of a target.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetPopulation {
    /// The seed of its afferents; without it 0.
    #[schema(minimum = 0)]
    pub seed: Option<u64>,
}

/// The motion of a target.
#[derive(Clone, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetMotion {
    /// How long it moves, s.
    #[schema(minimum = 0.01, maximum = 20.0)]
    pub duration_s: f64,
    /// Speed, mm/s; without it 0.
    #[schema(minimum = -1000.0, maximum = 1000.0)]
    pub speed_mm_s: Option<f64>,
    /// Direction, degrees anticlockwise from x; without it 0.
    #[schema(minimum = -360.0, maximum = 360.0)]
    pub direction_deg: Option<f64>,
    /// Rotation about the array's middle, degrees/s anticlockwise; without it 0.
    #[schema(minimum = -36000.0, maximum = 36000.0)]
    pub turn_deg_s: Option<f64>,
    /// The number of frames in which the shape stands still; without it as many as keep each step within half a pitch.
    #[schema(minimum = 1, maximum = 64)]
    pub frames: Option<u8>,
}

/// A target that was stored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "name": "my-edge",
    "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "replaced_sha256": null,
    "warnings": []
})))]
pub struct StoredTarget {
    /// The target's name.
    pub name: String,
    /// SHA-256 of the bytes that were sent, in hexadecimal.
    pub sha256: String,
    /// SHA-256 of the file that this one has replaced, in hexadecimal; null if the name was new.
    #[schema(required)]
    pub replaced_sha256: Option<String>,
    /// One line for each detail that the array cannot show.
    pub warnings: Vec<String>,
}

/// A target that was removed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "name": "my-edge", "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
})))]
pub struct RemovedTarget {
    /// The target's name.
    pub name: String,
    /// SHA-256 of the file that was removed, in hexadecimal.
    pub sha256: String,
}
