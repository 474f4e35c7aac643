//! Renderings of objects, and previews of patterns.
//!
//! A search for an `object` ends with a [`Rendered`] pattern, judged on one finger. A [`PatternPreview`] shows what pins and afferents do under
//! any pattern.
//!
//! Invariant: lists of afferents have one item for each afferent of the finger, always in the same order.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

/// Files of an object, at most.
pub const MAX_OBJECT_FILES: usize = 8;
/// The longest preview, s.
pub const MAX_PREVIEW_S: f64 = 2.0;
/// The latest beginning of a preview, s.
pub const MAX_PREVIEW_FROM_S: f64 = 60.0;

/// How the heights of the pins are found: `rule` (a press graded by the distance from the object), `field` (the skin's shape), `rate` (skin and
/// rates of afferents, from strokes), `auto` (the same; for a press from the skin's shape) or `trace` (a press that moves along the object's lines).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum RenderMethod {
    #[default]
    Auto,
    Rate,
    Field,
    Rule,
    Trace,
}

/// The pattern that was rendered for an object, and how near its response is to the object's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Rendered {
    /// How heights were found.
    pub method: RenderMethod,
    /// The pattern file with its provenance, as `PUT /v1/patterns/{name}` takes it.
    pub pattern: String,
    /// SHA-256 of that text, in hexadecimal.
    pub sha256: String,
    /// Its duration, s.
    #[schema(minimum = 0.0)]
    pub duration_s: f64,
    /// The greatest height of a pin, µm.
    #[schema(minimum = 0.0)]
    pub highest_um: f64,
    /// Lines that draw the object where its touch begins, mm; none for a height map or a profile.
    pub outline: Vec<Vec<[f64; 2]>>,
    /// The keys of the object's file.
    #[schema(value_type = BTreeMap<String, Value>)]
    pub object: Value,
    /// The found pattern, and those that it has to beat: `rule`, and `vibrate-60` (the pins within 1.5 mm of the object vibrate at 60 Hz).
    pub judged: Vec<JudgedPattern>,
    /// Spikes of one finger under the object and under the patterns.
    pub response: ObjectResponse,
    /// One line for each thing that people should know of the pattern.
    pub warnings: Vec<String>,
}

/// How near the response to a pattern is to that to the object, on one finger, as `meissner judge` computes it. A number is null if the object
/// gives no spikes that it could be compared with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct JudgedPattern {
    /// The method, or `vibrate-60`.
    pub name: String,
    /// The correlation of the responses in space and time, in bins of 10 ms; 1 is the object itself.
    #[schema(required, minimum = -1.0, maximum = 1.0)]
    pub r: Option<f64>,
    /// The size of their difference over the size of the object's.
    #[schema(required, minimum = 0.0)]
    pub error: Option<f64>,
    /// By class, SA1, RA and PC: `r` in bins of 36 ms.
    pub r_by_class: [Option<f64>; 3],
    /// By class: `error` in bins of 36 ms.
    pub error_by_class: [Option<f64>; 3],
    /// By class: spikes over those under the object.
    pub spikes: [Option<f64>; 3],
}

/// Spikes of the afferents of one finger: 306 RA, 200 SA1 and 60 PC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ObjectResponse {
    /// How much of the touch the spikes cover from its beginning, s: at most 3, and at most 150000 spikes.
    #[schema(minimum = 0.0)]
    pub seconds: f64,
    /// By afferent: its place in mm from the array's middle, x across the finger and y towards the fingertip.
    pub places_mm: Vec<[f64; 2]>,
    /// By afferent: `SA1`, `RA` or `PC`.
    pub class: Vec<String>,
    /// By afferent: its spikes under the object, s, to 0.1 ms.
    pub real_s: Vec<Vec<f64>>,
    /// By afferent: its spikes under the found pattern, s.
    pub found_s: Vec<Vec<f64>>,
    /// By afferent: its spikes under the pattern of the method `rule`, s.
    pub rule_s: Vec<Vec<f64>>,
}

/// What pins and afferents do under a piece of a pattern.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08", "from_s": 0.0, "seconds": 0.003, "step_ms": 1.0,
    "heights_um": [[0.0, 0.0, 0.0], [0.0, 4.2, 8.4]],
    "spikes": {"places_mm": [[0.1, 0.2], [-3.0, 1.0]], "class": ["RA", "SA1"], "times_s": [[0.0021], []]}
})))]
pub struct PatternPreview {
    /// SHA-256 of the pattern's file, in hexadecimal.
    pub sha256: String,
    /// The pattern's time at which the piece begins, s.
    #[schema(minimum = 0.0, maximum = 60.0)]
    pub from_s: f64,
    /// Its length, s.
    #[schema(minimum = 0.0, maximum = 2.0)]
    pub seconds: f64,
    /// The time between two heights, ms.
    #[schema(minimum = 0.0)]
    pub step_ms: f64,
    /// By motor of the pattern's array: the heights of its pin above rest by the motor model, µm, to 0.1. After the pattern's end pins rest.
    pub heights_um: Vec<Vec<f64>>,
    /// The spikes of one finger.
    pub spikes: PreviewSpikes,
}

/// Spikes of the finger that also judges renderings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PreviewSpikes {
    /// By afferent: its place in mm from the array's middle, x across the finger and y towards the fingertip.
    pub places_mm: Vec<[f64; 2]>,
    /// By afferent: `SA1`, `RA` or `PC`.
    pub class: Vec<String>,
    /// By afferent: the pattern's times of its spikes within the piece, s, to 0.1 ms.
    pub times_s: Vec<Vec<f64>>,
}
