//! Searches for a pattern: the request, the progress and the result.
//!
//! [`SearchRequest`] starts a search for a target, or the rendering of an object. [`Search`] shows it, with its [`SearchResult`] or [`Rendered`]
//! pattern once it is done; the event `search` reports its [`SearchProgress`]. Play the found pattern by the name `search:ID`, or store its text.
//!
//! Invariant: a search that is over does not change.

#![expect(unused_qualifications, reason = "in code that utoipa makes for `Search`")]

use crate::body::{bad, null_as_default, problem, read};
use crate::problem::Problem;
use crate::rendering::{MAX_OBJECT_FILES, RenderMethod, Rendered};
use crate::target::TargetFile;
use meissner_input::document::{given, in_range};
use meissner_input::message::{is_plain, quote};
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use utoipa::openapi::schema::{AdditionalProperties, ObjectBuilder, OneOfBuilder, Ref, Schema, Type};

/// How the name of a found pattern begins; the search's id follows.
pub const FOUND_PREFIX: &str = "search:";
/// How long a search may take, s: without a request, at least and at most.
pub const SEARCH_S: (f64, f64, f64) = (10.0, 0.1, 600.0);
/// Evaluations of each frame, at most.
pub const MAX_EVALUATIONS: u64 = 1_000_000;
/// Ended searches that are kept.
pub const KEPT_SEARCHES: usize = 4;
/// The largest body of a search, with the files of its object, bytes.
pub const MAX_SEARCH_BODY: usize = 4 << 20;

/// Keys that are of a target's search alone.
const OF_TARGETS: [&str; 6] = ["objective", "model", "setting", "robust", "seconds", "evaluations"];
/// Keys that are of an object's rendering alone.
const OF_OBJECTS: [&str; 2] = ["files", "method"];

/// What a search maximises. ON afferents lie within reach of the shape, OFF are all others: `contrast` (mean rate of ON minus mean rate
/// of OFF), `off-rms` and `off-rms-twice` (mean of ON minus once or twice the RMS of OFF), `near-off` (as `contrast`; OFF afferents near
/// the target weigh more), `auc` (chance that an ON afferent fires faster than an OFF one), `correlation` (of the rates with the ON set)
/// or `rivals` (distance from the most similar shape).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum SearchObjective {
    Contrast,
    OffRms,
    #[default]
    OffRmsTwice,
    NearOff,
    Auc,
    Correlation,
    Rivals,
}

/// The models whose RA afferents are ON or OFF: `membrane` (as in the paper), `afferents` (skin mechanics, fitted to recordings) or
/// `both` (the gain over the rule of thumb, under the model in which it is less).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum SearchModel {
    #[default]
    Both,
    Membrane,
    Afferents,
}

/// What a search may choose: `default` (motors may be off; 5 to 150 Hz) or `always_on` (all motors vibrate, as in the paper; 5 to 300 Hz).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum SearchSetting {
    #[default]
    Default,
    AlwaysOn,
}

/// A target, and how to search for a pattern for it; or an object, and how to render it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({
    "target": {"name": "my-edge", "shape": "segment", "points": [[-4.0, 0.0], [4.0, 0.0]]}, "seconds": 1.0
})))]
pub struct SearchRequest {
    /// The name of a target, or the target itself. Excludes `object`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = target_schema)]
    pub target: Option<Value>,
    /// The object whose response the pattern has to give: the name of a shipped one or of a target at rest, or the keys of an
    /// [object file](object.md). Excludes `target` and the keys `objective`, `model`, `setting`, `robust`, `seconds` and `evaluations`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(schema_with = search_object_schema)]
    pub object: Option<Value>,
    /// The files that the object names, in base64, by name: PNG, NPY or CSV. At most 8. Only with `object`.
    #[serde(default, deserialize_with = "null_as_default", skip_serializing_if = "BTreeMap::is_empty")]
    pub files: BTreeMap<String, String>,
    /// How the object's heights are found; without it `auto`. Only with `object`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub method: Option<RenderMethod>,
    /// What it maximises; without it `off-rms-twice`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub objective: SearchObjective,
    /// Under which models; without it `both`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub model: SearchModel,
    /// What it may choose; without it `default`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub setting: SearchSetting,
    /// The seed of the search, or of the noise when an object is rendered; without it 0.
    #[serde(default)]
    pub seed: u64,
    /// Whether it maximises the mean over eight populations of afferents, not one.
    #[serde(default, deserialize_with = "null_as_default")]
    pub robust: bool,
    /// About how long to search, s; the judgement of the result comes on top. Without it 10. Excludes `evaluations`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.1, maximum = 600.0)]
    pub seconds: Option<f64>,
    /// About how many evaluations to make for each frame: the same number finds the same pattern. Excludes `seconds`.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 1, maximum = 1_000_000)]
    pub evaluations: Option<u64>,
}

pub(crate) fn target_schema() -> Schema {
    let name = ObjectBuilder::new().schema_type(Type::String).description(Some("The name of a target."));
    OneOfBuilder::new().item(name).item(Ref::from_schema_name("TargetFile")).into()
}

/// The keys of an object file are in `docs/reference/object.md`.
fn object_schema_of(name: &str, keys: &str) -> Schema {
    let name = ObjectBuilder::new().schema_type(Type::String).description(Some(name));
    let keys = ObjectBuilder::new()
        .schema_type(Type::Object)
        .description(Some(keys))
        .additional_properties(Some(AdditionalProperties::FreeForm(true)));
    OneOfBuilder::new().item(name).item(keys).into()
}

/// The object of a live play.
pub(crate) fn object_schema() -> Schema {
    object_schema_of("The name of a target at rest.", "The keys of an object file without files.")
}

/// The object of a search.
fn search_object_schema() -> Schema {
    object_schema_of("The name of a shipped object or of a target at rest.", "The keys of an object file.")
}

impl SearchRequest {
    /// Reads a body. The target or the object itself is not checked, nor are its files.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let request: Self = read(body)?;
        request.check_keys(body)?;
        request.check_files()?;
        if request.seconds.is_some() && request.evaluations.is_some() {
            return Err(bad("`seconds` and `evaluations` exclude each other: leave one out"));
        }
        let whole = i64::try_from(request.seed).is_ok();
        in_range("seed", request.seed as f64, whole, "0 to 9223372036854775807").map_err(problem)?;
        if let Some(seconds) = request.seconds {
            let (_, least, most) = SEARCH_S;
            in_range("seconds", seconds, (least..=most).contains(&seconds), "0.1 to 600 s")
                .map_err(problem)?;
        }
        if let Some(count) = request.evaluations {
            let good = (1..=MAX_EVALUATIONS).contains(&count);
            in_range("evaluations", count as f64, good, "1 to 1000000").map_err(problem)?;
        }
        Ok(request)
    }

    /// Refuses all but one of a target and an object, and keys of the other.
    fn check_keys(&self, body: &[u8]) -> Result<(), Problem> {
        let is_choice = |of: &Value| of.is_string() || of.is_object();
        let (foreign, advice) = match (&self.target, &self.object) {
            (Some(target), None) if is_choice(target) => (&OF_OBJECTS[..], "render an `object`"),
            (None, Some(object)) if is_choice(object) => (&OF_TARGETS[..], "search for a `target`"),
            (Some(_), None) => {
                return Err(bad(
                    "`target` must be the name of a target, or an object with the keys of a target file",
                ));
            }
            (None, Some(_)) => {
                return Err(bad(
                    "`object` must be the name of an object, or an object with the keys of an object file",
                ));
            }
            (Some(_), Some(_)) => {
                return Err(bad("`target` and `object` exclude each other: leave one out"));
            }
            (None, None) => {
                return Err(bad("`target` or `object` is missing: add the name of one, or its keys"));
            }
        };
        // Null means that a key is absent.
        let keys: BTreeMap<String, Option<IgnoredAny>> = serde_json::from_slice(body).unwrap_or_default();
        match foreign.iter().find(|key| keys.get(**key).is_some_and(Option::is_some)) {
            Some(key) => {
                let of = if self.object.is_some() { "a target's search" } else { "an object's rendering" };
                Err(bad(format!("`{key}` is a key of {of}: leave it out, or {advice}")))
            }
            None => Ok(()),
        }
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

/// How a search stands: `running`, `done` (there is a result), `cancelled` or `failed`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "the type describes each")]
pub enum SearchState {
    Running,
    Done,
    Cancelled,
    Failed,
}

/// How far a search is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SearchProgress {
    /// Time since its start, s.
    #[schema(minimum = 0.0)]
    pub seconds: f64,
    /// The frame that is searched, from 1.
    #[schema(minimum = 0, maximum = 64)]
    pub frame: usize,
    /// The number of frames: 1 for a target at rest.
    #[schema(minimum = 0, maximum = 64)]
    pub frames: usize,
    /// Evaluations for this frame.
    #[schema(minimum = 0)]
    pub evaluations: u64,
    /// The best value of the objective for this frame, at the search's present fidelity; null: none yet.
    #[schema(required)]
    pub value: Option<f64>,
}

/// A search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": 3, "state": "done", "target": "my-edge", "objective": "off-rms-twice", "model": "both", "setting": "default", "seed": 0,
    "robust": false, "method": null, "found": true,
    "progress": {"seconds": 1.2, "frame": 1, "frames": 1, "evaluations": 412, "value": 0.04},
    "problem": null,
    "result": {
        "ended": "limit", "pattern": "format = 1\nname = \"my-edge\"\n",
        "sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
        "value": 0.04, "value_naive_reach": 0.0, "value_naive_pitch": -0.7, "pulses_per_s": 31000.0,
        "models": [{
            "model": "membrane",
            "found": {"on": 61.0, "off": 3.0, "contrast": 58.0, "auc": 0.99},
            "naive_reach": {"on": 60.0, "off": 3.5, "contrast": 56.5, "auc": 0.99},
            "naive_pitch": {"on": 60.0, "off": 9.0, "contrast": 51.0, "auc": 0.97}
        }],
        "definition": {"name": "my-edge", "shape": "segment", "points": [[-4.0, 0.0], [4.0, 0.0]]},
        "outline": [[[-4.0, 0.0], [4.0, 0.0]]],
        "response": {
            "model": "membrane", "places_mm": [[0.1, 0.2]], "on": [1.0], "found": [60.0], "naive_reach": [60.0], "naive_pitch": [60.0]
        },
        "warnings": []
    },
    "rendered": null
})))]
pub struct Search {
    /// Its id; the found pattern plays as `search:ID`.
    pub id: u64,
    /// How it stands.
    pub state: SearchState,
    /// The name of the target or object, which the found pattern bears, too.
    pub target: String,
    /// What it maximises.
    pub objective: SearchObjective,
    /// Under which models.
    pub model: SearchModel,
    /// What it may choose.
    pub setting: SearchSetting,
    /// The seed of the search, or of the noise when an object is rendered.
    pub seed: u64,
    /// Whether it maximises the mean over eight populations.
    pub robust: bool,
    /// How an object is rendered; null for a target's search.
    #[schema(required)]
    pub method: Option<RenderMethod>,
    /// Whether the pattern can be played as `search:ID`: for an object already while the search runs.
    pub found: bool,
    /// How far it is, or was at its end. Of a rendering only the time is known.
    pub progress: SearchProgress,
    /// Why it failed, in one line; null if it did not.
    #[schema(required)]
    pub problem: Option<String>,
    /// What it has found for a target; null unless it is `done`.
    #[schema(required)]
    pub result: Option<Box<SearchResult>>,
    /// What it has found for an object; null unless it is `done`.
    #[schema(required)]
    pub rendered: Option<Box<Rendered>>,
}

/// What a search has found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SearchResult {
    /// Why it ended: `converged` (nothing improves any more) or `limit` (of time or evaluations).
    pub ended: String,
    /// The pattern file with its provenance, as `PUT /v1/patterns/{name}` takes it.
    pub pattern: String,
    /// SHA-256 of that text, in hexadecimal.
    pub sha256: String,
    /// The value of the objective for the pattern.
    #[schema(minimum = -1e9)]
    pub value: f64,
    /// The value for all pins within the target's reach of the shape at 60 Hz, in phase.
    #[schema(minimum = -1e9)]
    pub value_naive_reach: f64,
    /// The value for all pins at most one pin pitch of the array from the shape, at 60 Hz, in phase.
    #[schema(minimum = -1e9)]
    pub value_naive_pitch: f64,
    /// Pulses per second that it asks of the drivers.
    #[schema(minimum = 0.0)]
    pub pulses_per_s: f64,
    /// Pattern and naive rules under each model.
    pub models: Vec<SearchVerdicts>,
    /// The target with all keys of its file.
    #[schema(value_type = TargetFile)]
    pub definition: Value,
    /// Lines that draw the target's shape.
    pub outline: Vec<Vec<[f64; 2]>>,
    /// The predicted rate of each afferent.
    pub response: SearchResponse,
    /// One line for each detail of the target that the array cannot show.
    pub warnings: Vec<String>,
}

/// The found pattern and both naive rules under a model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SearchVerdicts {
    /// The model.
    pub model: String,
    /// The found pattern.
    pub found: SearchVerdict,
    /// All pins within the target's reach of the shape at 60 Hz, in phase.
    pub naive_reach: SearchVerdict,
    /// All pins at most one pin pitch of the array from the shape, at 60 Hz, in phase.
    pub naive_pitch: SearchVerdict,
}

/// How well rates separate the shape from its surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SearchVerdict {
    /// Mean rate of the ON afferents, impulses/s.
    #[schema(minimum = 0.0)]
    pub on: f64,
    /// Mean rate of the OFF afferents, impulses/s.
    #[schema(minimum = 0.0)]
    pub off: f64,
    /// Their difference, impulses/s.
    pub contrast: f64,
    /// The chance that an ON afferent fires faster than an OFF one.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub auc: f64,
}

/// The predicted response of the 306 RA afferents of the target's population, one item for each in every list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SearchResponse {
    /// The model.
    pub model: String,
    /// Places in mm from the array's middle, x across the finger and y towards the fingertip.
    pub places_mm: Vec<[f64; 2]>,
    /// Share of the frames in which the afferent should fire, 0 to 1.
    pub on: Vec<f64>,
    /// Mean rate for the found pattern, impulses/s.
    pub found: Vec<f64>,
    /// Mean rate for all pins within the target's reach, impulses/s.
    pub naive_reach: Vec<f64>,
    /// Mean rate for all pins within one pitch, impulses/s.
    pub naive_pitch: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_key() {
        let read = |text: &str| SearchRequest::parse(text.as_bytes());
        let request = read(r#"{"target":"edge-45","seconds":2,"objective":"auc","model":null}"#).unwrap();
        assert_eq!((request.objective, request.model), (SearchObjective::Auc, SearchModel::Both));
        let object =
            read(r#"{"object":"dot","target":null,"model":null,"method":"field","seed":3}"#).unwrap();
        assert_eq!((object.target, object.method, object.seed), (None, Some(RenderMethod::Field), 3));
        assert_eq!(SearchRequest::parse(&serde_json::to_vec(&request).unwrap()).unwrap(), request);
        for (text, says) in [
            (r#"{"seconds":2}"#, "`target` or `object` is missing: add the name of one, or its keys"),
            (r#"{"target":null}"#, "`target` or `object` is missing"),
            (r#"{"target":3}"#, "`target` must be the name of a target"),
            (r#"{"object":[]}"#, "`object` must be the name of an object"),
            (r#"{"object":"dot","target":"dot"}"#, "`target` and `object` exclude each other"),
            (r#"{"object":"dot","model":"both"}"#, "`model` is a key of a target's search: leave it out"),
            (r#"{"object":"dot","seconds":1}"#, "`seconds` is a key of a target's search"),
            (r#"{"target":"dot","method":"rule"}"#, "`method` is a key of an object's rendering"),
            (r#"{"target":"dot","files":{}}"#, "`files` is a key of an object's rendering"),
            (
                r#"{"object":"dot","method":"best"}"#,
                "`method`: unknown variant `best`, expected one of `auto`",
            ),
            (
                r#"{"object":"dot","files":{"a/b.png":""}}"#,
                "`files` has `a/b.png`: must be the name of a file",
            ),
            (r#"{"object":"dot","files":{"..":""}}"#, "`files` has `..`: must be the name of a file"),
            (r#"{"target":"a","seconds":601}"#, "`seconds` is 601: must be 0.1 to 600 s"),
            (r#"{"target":"a","evaluations":0}"#, "`evaluations` is 0: must be 1 to 1000000"),
            (
                r#"{"target":"a","seconds":1,"evaluations":9}"#,
                "`seconds` and `evaluations` exclude each other",
            ),
            (r#"{"target":"a","seed":9223372036854775808}"#, "`seed` is 9.223372036854776e18: must be 0 to"),
            (r#"{"target":"a","objetcive":"auc"}"#, "unknown key `objetcive`: did you mean `objective`?"),
            (r#"{"target":"a","model":"x"}"#, "`model`: unknown variant `x`, expected one of `both`"),
        ] {
            let problem = read(text).unwrap_err();
            assert!(problem.detail.contains(says) && problem.code == "bad-request", "{problem}");
        }
    }
}
