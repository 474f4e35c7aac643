//! Renderings of objects, and previews of patterns.
//!
//! [`RenderingRequest`] starts the rendering of an object. [`Rendering`] shows it, with its [`Rendered`] pattern, judged on one finger, once it
//! is done. Play the pattern by the name `rendering:ID`, or store its text. A [`PatternPreview`] shows what pins and afferents do under any
//! pattern.
//!
//! Invariants: lists of afferents have one item for each afferent of the finger, always in the same order; a rendering that is over does not
//! change.

#![expect(unused_qualifications, reason = "in code that utoipa makes for `Rendering`")]

use crate::body::{bad, null_as_default, problem, read};
use crate::problem::Problem;
use meissner_input::document::in_range;
use meissner_input::message::{is_plain, quote};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use utoipa::openapi::schema::{AdditionalProperties, ObjectBuilder, OneOfBuilder, Schema, Type};

/// How the name of a rendered pattern begins; the rendering's id follows.
pub const FOUND_PREFIX: &str = "rendering:";
/// Ended renderings that are kept.
pub const KEPT_RENDERINGS: usize = 4;
/// The largest body of a rendering, with the files of its object, bytes.
pub const MAX_RENDERING_BODY: usize = 4 << 20;
/// Files of an object, at most.
const MAX_OBJECT_FILES: usize = 8;
/// The longest preview, s.
pub const MAX_PREVIEW_S: f64 = 2.0;
/// The latest beginning of a preview, s.
pub const MAX_PREVIEW_FROM_S: f64 = 60.0;

/// How the heights of the pins are found: `rule` (a press at full speed, graded by the distance from the object, which it follows), `stroke` (one
/// stroke of each pin whenever the object passes; a press, if it stays in place), `field` (the skin's shape), `rate` (skin and rates of afferents, from strokes), `auto` (what simulated
/// fingers find nearest to the object) or `trace` (a press that moves along the object's lines).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum RenderMethod {
    #[default]
    Auto,
    Rate,
    Field,
    Rule,
    Stroke,
    Trace,
}

/// An object, and how to render it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"object": "edge-45", "method": "field"})))]
pub struct RenderingRequest {
    /// The object whose response the pattern has to give: the name of a shipped one, or the keys of an [object file](object.md).
    #[schema(schema_with = rendered_object_schema)]
    pub object: Value,
    /// The files that the object names, in base64, by name: PNG, NPY or CSV. At most 8.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
    /// How the object's heights are found; without it `auto`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub method: RenderMethod,
    /// The seed of the noise; without it 0.
    #[serde(default)]
    pub seed: u64,
}

/// The keys of an object file are in `docs/reference/object.md`.
fn object_schema_of(keys: &str) -> Schema {
    let name =
        ObjectBuilder::new().schema_type(Type::String).description(Some("The name of a shipped object."));
    let keys = ObjectBuilder::new()
        .schema_type(Type::Object)
        .description(Some(keys))
        .additional_properties(Some(AdditionalProperties::FreeForm(true)));
    OneOfBuilder::new().item(name).item(keys).into()
}

/// The object of a live play.
pub(crate) fn object_schema() -> Schema {
    object_schema_of("The keys of an object file without files.")
}

fn rendered_object_schema() -> Schema {
    object_schema_of("The keys of an object file.")
}

impl RenderingRequest {
    /// Reads a body. The object itself is not checked, nor are its files.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let request: Self = read(body)?;
        if !request.object.is_string() && !request.object.is_object() {
            return Err(bad(
                "`object` must be the name of an object, or an object with the keys of an object file",
            ));
        }
        request.check_files()?;
        let whole = i64::try_from(request.seed).is_ok();
        in_range("seed", request.seed as f64, whole, "0 to 9223372036854775807").map_err(problem)?;
        Ok(request)
    }

    fn check_files(&self) -> Result<(), Problem> {
        let count = self.files.len();
        if count > MAX_OBJECT_FILES {
            let detail = format!("`files` has {count} files: an object has at most {MAX_OBJECT_FILES}");
            return Err(bad(detail));
        }
        let is_name = |name: &&String| {
            (1..=100).contains(&name.len())
                && *name != "."
                && *name != ".."
                && !name.contains('/')
                && name.chars().all(is_plain)
        };
        match self.files.keys().find(|name| !is_name(name)) {
            Some(name) => {
                let name = quote(name);
                Err(bad(format!(
                    "`files` has {name}: must be the name of a file, at most 100 bytes, without a folder"
                )))
            }
            None => Ok(()),
        }
    }
}

/// How a rendering stands: `running`, `done` (there is a result), `cancelled` or `failed`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum RenderingState {
    Running,
    Done,
    Cancelled,
    Failed,
}

/// A rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": 3, "state": "running", "object": "my-edge", "method": "auto", "seed": 0, "found": false, "seconds": 0.4, "problem": null,
    "rendered": null
})))]
pub struct Rendering {
    /// Its id; the pattern plays as `rendering:ID`.
    pub id: u64,
    /// How it stands.
    pub state: RenderingState,
    /// The name of the object, which the pattern bears, too.
    pub object: String,
    /// How the object is rendered.
    pub method: RenderMethod,
    /// The seed of the noise.
    pub seed: u64,
    /// Whether the pattern can be played as `rendering:ID`: already while the rendering runs.
    pub found: bool,
    /// Time since its start, at most up to its end, s.
    pub seconds: f64,
    /// Why it failed, in one line; null if it did not.
    pub problem: Option<String>,
    /// The pattern, judged; null unless it is `done`.
    pub rendered: Option<Box<Rendered>>,
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
    pub duration_s: f64,
    /// The greatest height of a pin, µm.
    pub highest_um: f64,
    /// Lines that draw the object where its touch begins, mm; none for a height map or a profile.
    pub outline: Vec<Vec<[f64; 2]>>,
    /// The keys of the object's file.
    #[schema(value_type = BTreeMap<String, Value>)]
    pub object: Value,
    /// The found pattern, and those that it has to beat: `rule`, for an object that moves `stroke`, and `vibrate-60` (the pins within 1.5 mm of the object vibrate at 60 Hz).
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
    #[schema(minimum = -1.0, maximum = 1.0)]
    pub r: Option<f64>,
    /// The size of their difference over the size of the object's.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_key() {
        let read = |text: &str| RenderingRequest::parse(text.as_bytes());
        let request = read(r#"{"object":"dot","method":"field","files":null,"seed":3}"#).unwrap();
        assert_eq!((request.method, request.seed), (RenderMethod::Field, 3));
        assert_eq!(RenderingRequest::parse(&serde_json::to_vec(&request).unwrap()).unwrap(), request);
        for (text, says) in [
            (r#"{"seed":2}"#, "`object` is missing"),
            (r#"{"object":[]}"#, "`object` must be the name of an object"),
            (r#"{"object":null}"#, "`object` must be the name of an object"),
            (r#"{"object":"dot","mehtod":"rule"}"#, "unknown key `mehtod`: did you mean `method`?"),
            (
                r#"{"object":"dot","method":"best"}"#,
                "`method`: unknown variant `best`, expected one of `auto`",
            ),
            (
                r#"{"object":"dot","files":{"a/b.png":""}}"#,
                "`files` has `a/b.png`: must be the name of a file",
            ),
            (r#"{"object":"dot","files":{"..":""}}"#, "`files` has `..`: must be the name of a file"),
            (
                r#"{"object":"dot","seed":9223372036854775808}"#,
                "`seed` is 9.223372036854776e18: must be 0 to",
            ),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.detail.contains(says) && problem.code == "bad-request", "{text}: {problem}");
        }
    }
}
