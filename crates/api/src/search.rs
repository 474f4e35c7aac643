//! Searches for a pattern: the request, the progress and the result.
//!
//! [`SearchRequest`] starts a search. [`Search`] shows it, with its [`SearchResult`] once it is done; the event `search` reports its
//! [`SearchProgress`]. Play the found pattern by the name `search:ID`, or store its text.
//!
//! Invariant: a search that is over does not change.

#![expect(unused_qualifications, reason = "in code that utoipa makes for `Search`")]

use crate::body::{bad, null_as_default, problem, read};
use crate::problem::Problem;
use crate::target::TargetFile;
use meissner_input::document::{given, in_range};
use serde::{Deserialize, Serialize};
use serde_json::Value;
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

/// A target, and how to search for a pattern for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({
    "target": {"name": "my-edge", "shape": "segment", "points": [[-4.0, 0.0], [4.0, 0.0]]}, "seconds": 1.0
})))]
pub struct SearchRequest {
    /// The name of a target, or the target itself.
    #[schema(schema_with = target_schema)]
    pub target: Value,
    /// What it maximises; without it `off-rms-twice`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub objective: SearchObjective,
    /// Under which models; without it `both`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub model: SearchModel,
    /// What it may choose; without it `default`.
    #[serde(default, deserialize_with = "null_as_default")]
    pub setting: SearchSetting,
    /// The seed of the search; without it 0.
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
pub(crate) fn object_schema() -> Schema {
    let name =
        ObjectBuilder::new().schema_type(Type::String).description(Some("The name of a target at rest."));
    let keys = ObjectBuilder::new()
        .schema_type(Type::Object)
        .description(Some("The keys of an object file without files."))
        .additional_properties(Some(AdditionalProperties::FreeForm(true)));
    OneOfBuilder::new().item(name).item(keys).into()
}

impl SearchRequest {
    /// Reads a body. The target itself is not checked.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let request: Self = read(body)?;
        if !request.target.is_string() && !request.target.is_object() {
            return Err(bad(
                "`target` must be the name of a target, or an object with the keys of a target file",
            ));
        }
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
    "robust": false,
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
    }
})))]
pub struct Search {
    /// Its id; the found pattern plays as `search:ID`.
    pub id: u64,
    /// How it stands.
    pub state: SearchState,
    /// The target's name, which the found pattern bears, too.
    pub target: String,
    /// What it maximises.
    pub objective: SearchObjective,
    /// Under which models.
    pub model: SearchModel,
    /// What it may choose.
    pub setting: SearchSetting,
    /// The seed of the search.
    pub seed: u64,
    /// Whether it maximises the mean over eight populations.
    pub robust: bool,
    /// How far it is, or was at its end.
    pub progress: SearchProgress,
    /// Why it failed, in one line; null if it did not.
    #[schema(required)]
    pub problem: Option<String>,
    /// What it has found; null unless it is `done`.
    #[schema(required)]
    pub result: Option<Box<SearchResult>>,
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
        assert_eq!(SearchRequest::parse(&serde_json::to_vec(&request).unwrap()).unwrap(), request);
        for (text, says) in [
            (r#"{"seconds":2}"#, "`target` is missing: add the name of a target, or a target"),
            (r#"{"target":3}"#, "`target` must be the name of a target"),
            (r#"{"target":null}"#, "`target` must be the name of a target"),
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
