//! A participant's answer to a play: what was said, whether that is right, how fast, and to which level and factors.
//!
//! `POST /v1/plays/{id}/answer` takes it. The session record keeps it, and exports have it in the row of the play.
//!
//! Invariant: a text is kept as it was given, whatever its characters; an answer has 8 KiB as JSON at most.

use crate::body::{bad, read};
use crate::problem::Problem;
use meissner_input::document::given;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The most bytes of an answer as JSON, so that the rows of [`MAX_ROWS`](crate::MAX_ROWS) plays fit into one answer of the daemon.
const MAX_ANSWER: usize = 8 << 10;

/// What a participant answered to a play.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({
    "response": "left", "correct": true, "rt_ms": 512.3, "level": 0.4, "factors": {"block": "2"}
})))]
pub struct PlayAnswer {
    /// The response: any text. The whole answer has at most 8 KiB as JSON.
    pub response: String,
    /// Whether it is right; null: there is no right or wrong.
    #[serde(default)]
    pub correct: Option<bool>,
    /// Response time, ms, below 0 if it came before the onset; left out: not measured.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub rt_ms: Option<f64>,
    /// The level of the stimulus, such as a staircase's; left out: none.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub level: Option<f64>,
    /// Factors of the trial: any texts.
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
    /// A `bad-request` that names the key, or how long the answer is.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let answer: Self = read(body)?;
        let bytes = serde_json::to_vec(&answer).map_or(usize::MAX, |json| json.len());
        if bytes > MAX_ANSWER {
            let detail = format!("the answer has {bytes} bytes as JSON: at most {MAX_ANSWER} are kept");
            return Err(bad(detail));
        }
        Ok(answer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_kept_as_it_was_given() {
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
        let odd =
            ["", "\t", "a\r\nb", "\0\u{1b}[2J", "\u{2028}\u{202e}", &"é".repeat(1000)].map(str::to_owned);
        for text in odd {
            let factors = [(text.clone(), text.clone())].into();
            let given =
                PlayAnswer { response: text, rt_ms: Some(-1e7), level: Some(1e300), correct: None, factors };
            assert_eq!(read(&serde_json::to_string(&given).unwrap()).unwrap(), given);
        }
        let many: BTreeMap<_, _> = (0..100).map(|n| (n.to_string(), "x".to_owned())).collect();
        let given = PlayAnswer { factors: many, ..PlayAnswer::default() };
        assert_eq!(read(&serde_json::to_string(&given).unwrap()).unwrap(), given);
        for (text, says) in [
            (r#"{"correct":true}"#.to_owned(), "`response`"),
            (format!("{{\"response\":\"{}\"}}", "x".repeat(8192)), "at most 8192 are kept"),
            (r#"{"response":"a","rt_ms":1e999}"#.to_owned(), "out of range"),
            (r#"{"response":"a","level":"high"}"#.to_owned(), "`level`"),
            (r#"{"response":"a","rt":1}"#.to_owned(), "did you mean `rt_ms`?"),
        ] {
            let problem = read(&text).unwrap_err();
            assert!(problem.detail.contains(says), "{text}: {}", problem.detail);
            assert!(!problem.detail.contains('\n') && problem.status == 400);
        }
    }
}
