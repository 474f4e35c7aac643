//! A participant's answer to a play: what was said, whether that is right, how fast, and to which level and factors.
//!
//! `POST /v1/plays/{id}/answer` takes it. The session record keeps it, and exports have it in the row of the play.
//!
//! Invariant: texts have no control characters, and at most the characters stated here.

use crate::body::{MAX_LABELS, MAX_NAME, bad, check_text_within, read};
use crate::problem::Problem;
use meissner_input::document::given;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Characters of a response, at most.
const MAX_RESPONSE: usize = 200;
/// The longest response time, ms: an hour.
const MAX_RT_MS: f64 = 3_600_000.0;

/// What a participant answered to a play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({
    "response": "left", "correct": true, "rt_ms": 512.3, "level": 0.4, "factors": {"block": "2"}
})))]
pub struct PlayAnswer {
    /// The response, 1 to 200 characters.
    #[schema(min_length = 1, max_length = 200)]
    pub response: String,
    /// Whether it is right; null: there is no right or wrong.
    #[serde(default)]
    pub correct: Option<bool>,
    /// Response time, ms; left out: not measured.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0.0, maximum = 3600000.0)]
    pub rt_ms: Option<f64>,
    /// The level of the stimulus, such as a staircase's; left out: none.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub level: Option<f64>,
    /// Up to 16 factors of the trial, of 1 to 100 characters.
    #[serde(default, deserialize_with = "crate::body::null_as_default")]
    pub factors: BTreeMap<String, String>,
}

/// The daemon has taken an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({})))]
pub struct AnswerTaken {}

impl PlayAnswer {
    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let answer: Self = read(body)?;
        check_text_within("response", &answer.response, MAX_RESPONSE)?;
        if let Some(ms) = answer.rt_ms.filter(|ms| !(0.0..=MAX_RT_MS).contains(ms)) {
            return Err(bad(format!("`rt_ms` is {ms}: must be 0 to {MAX_RT_MS} ms")));
        }
        if answer.factors.len() > MAX_LABELS {
            let detail =
                format!("`factors` has {} factors: at most {MAX_LABELS} are kept", answer.factors.len());
            return Err(bad(detail));
        }
        for text in answer.factors.iter().flat_map(|(key, value)| [key, value]) {
            check_text_within("factors", text, MAX_NAME)?;
        }
        Ok(answer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_bounded() {
        let read = |text: &str| PlayAnswer::parse(text.as_bytes());
        let whole =
            read(r#"{"response":"left","correct":false,"rt_ms":512.3,"level":-0.4,"factors":{"block":"2"}}"#);
        let whole = whole.unwrap();
        assert_eq!(
            (&*whole.response, whole.correct, whole.rt_ms, whole.level),
            ("left", Some(false), Some(512.3), Some(-0.4))
        );
        let null = read(r#"{"response":"7","correct":null,"factors":null}"#).unwrap();
        assert_eq!(null, PlayAnswer { response: "7".to_owned(), ..PlayAnswer::default() });
        assert!(read(&format!("{{\"response\":\"{}\"}}", "é".repeat(200))).is_ok());
        let many: BTreeMap<_, _> = (0..17).map(|n| (n.to_string(), "x")).collect();
        for (text, says) in [
            (r#"{"correct":true}"#.to_owned(), "`response`"),
            (r#"{"response":""}"#.to_owned(), "`response` is ``: must be 1 to 200 characters"),
            (format!("{{\"response\":\"{}\"}}", "x".repeat(201)), "must be 1 to 200 characters"),
            (r#"{"response":"a\nb"}"#.to_owned(), "without line breaks"),
            (r#"{"response":"a","rt_ms":-1}"#.to_owned(), "`rt_ms` is -1: must be 0 to 3600000 ms"),
            (r#"{"response":"a","rt_ms":1e999}"#.to_owned(), "out of range"),
            (r#"{"response":"a","level":"high"}"#.to_owned(), "`level`"),
            (r#"{"response":"a","factors":{"":"x"}}"#.to_owned(), "`factors` is ``"),
            (
                format!("{{\"response\":\"a\",\"factors\":{}}}", serde_json::to_string(&many).unwrap()),
                "17 factors",
            ),
            (r#"{"response":"a","rt":1}"#.to_owned(), "did you mean `rt_ms`?"),
        ] {
            let problem = read(&text).unwrap_err();
            assert!(problem.detail.contains(says), "{text}: {}", problem.detail);
            assert!(!problem.detail.contains('\n') && problem.status == 400);
        }
    }
}
