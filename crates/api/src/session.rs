//! Sessions: plays that are recorded together, and whether one client owns the display meanwhile.
//!
//! [`SessionRequest`] starts a session, and [`SessionStarted`] answers with its id and the owner's token. The client sends the
//! token as `Authorization: Bearer TOKEN`. One session runs at a time; every play meanwhile belongs to it.
//!
//! Invariant: names and labels have no control characters, and at most the characters stated here.

use crate::answer::PlayAnswer;
use crate::body::{check_labels, check_text, read};
use crate::problem::Problem;
use crate::receipt::{MAX_LISTED, Receipt};
use meissner_input::document::given;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Who takes part in which experiment, and whether one client owns the display.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({
    "participant": "P07", "experiment": "edges", "labels": {"block": "2"}, "seed": 42, "exclusive": true
})))]
pub struct SessionRequest {
    /// A pseudonym, 1 to 100 characters. Limits for participants are counted by it.
    #[schema(min_length = 1, max_length = 100)]
    pub participant: String,
    /// The experiment, 1 to 100 characters.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 100)]
    pub experiment: Option<String>,
    /// Up to 16 labels of 1 to 100 characters.
    #[serde(default, deserialize_with = "crate::body::null_as_default")]
    pub labels: BTreeMap<String, String>,
    /// The seed of the experiment's random numbers. The daemon only records it.
    #[serde(default, deserialize_with = "given", skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Whether only this session's owner may change anything. Others may read, stop, disarm, and order emergency stops.
    #[serde(default, deserialize_with = "crate::body::null_as_default")]
    pub exclusive: bool,
    /// Whether plays of the session need a record that can be written.
    #[serde(default, deserialize_with = "crate::body::null_as_default")]
    pub record: RecordNeed,
}

/// Whether a session goes on while its record cannot be written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum RecordNeed {
    /// It takes no plays meanwhile.
    #[default]
    Required,
    /// It goes on; answers are refused.
    Optional,
}

impl SessionRequest {
    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let mut request: Self = read(body)?;
        // Invisible spaces must not make a name another person's.
        let words = request.participant.split(|c: char| c.is_whitespace() && !c.is_control());
        request.participant = words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ");
        check_text("participant", &request.participant)?;
        if let Some(experiment) = &request.experiment {
            check_text("experiment", experiment)?;
        }
        check_labels(&request.labels)?;
        Ok(request)
    }
}

/// A session that has begun.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": "20261122T083000Z-9f3c", "token": "b1946ac92492d2347c6235b4d2611184", "record_problem": null
})))]
pub struct SessionStarted {
    /// The session's id: begins with its start in UTC, so ids sort by time.
    pub id: String,
    /// The owner's secret for `Authorization: Bearer TOKEN`. Every request with it shows that the owner is there. Once the session is
    /// over, the daemon refuses changes with it.
    pub token: String,
    /// Why the daemon does not record the session: it keeps no session record, or cannot write it now. Null if it records it. If the
    /// record is required and cannot be written, no session starts.
    pub record_problem: Option<String>,
}

/// A session, as it stands or as it was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": "edges", "labels": {"block": "2"}, "seed": 42,
    "exclusive": true, "owner": "ada", "started": "2026-11-22T09:30:00.123456+01:00", "ended": null, "reason": null,
    "plays": 12, "vibration_s": 24.0, "released": false, "release_in_s": 97.5, "lost": {"entries": 0, "plays": 0}
})))]
pub struct Session {
    /// The session's id.
    pub id: String,
    /// The participant's pseudonym.
    pub participant: String,
    /// The experiment; null if none was named.
    pub experiment: Option<String>,
    /// The session's labels.
    pub labels: BTreeMap<String, String>,
    /// The seed that was recorded; null if there was none.
    pub seed: Option<u64>,
    /// Whether the session began as an exclusive one.
    pub exclusive: bool,
    /// The user who started it; null: not known.
    pub owner: Option<String>,
    /// When it began, local time with the offset from UTC.
    pub started: String,
    /// When it ended; null while it runs, or if the record does not tell.
    pub ended: Option<String>,
    /// Why it ended: `request`, `daemon-ended`, or `unknown` (the daemon was killed, or could not write it); null while it runs.
    pub reason: Option<String>,
    /// Plays that were accepted.
    pub plays: u64,
    /// Vibration in the session, s.
    pub vibration_s: f64,
    /// Whether an exclusive session's owner was silent for so long that others may act.
    pub released: bool,
    /// When others may act unless the owner sends a request, s from now; null: they may, or the session is over.
    pub release_in_s: Option<f64>,
    /// What the record is known to have lost of it.
    pub lost: Losses,
    /// In the status: whether the client that asks shows the token of this session. Missing elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mine: Option<bool>,
}

/// What the session record is known to have lost of a session: the disk did not take it, or it was removed. Without a record nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Losses {
    /// Number of entries.
    pub entries: u64,
    /// Number of plays whose ends are lost.
    pub plays: u64,
}

impl Losses {
    /// Whether anything is lost.
    pub const fn any(self) -> bool {
        self.entries > 0 || self.plays > 0
    }
}

impl Session {
    /// Whether only the owner may change anything now.
    pub const fn is_closed_to_others(&self) -> bool {
        self.exclusive && !self.released && self.reason.is_none()
    }
}

/// The recorded sessions, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"sessions": [], "unreadable": 1, "problems": ["/var/lib/meissner/logbook/sessions/notes.txt: is no session's file"]})))]
pub struct SessionList {
    /// The sessions.
    pub sessions: Vec<Session>,
    /// Lines and files that are missing, cannot be read, or should not be there.
    pub unreadable: u64,
    /// The first 100 of them, one line each.
    #[schema(max_items = 100)]
    pub problems: Vec<String>,
}

/// A recorded play of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RecordedPlay {
    /// What became of it, with the items that have begun and whose lines the record has. If its end is missing, the state is `unknown`, and
    /// there is no more than its order.
    pub receipt: Receipt,
    /// The user who ordered it; null: not known.
    pub user: Option<String>,
    /// The onset on the host's wall clock as of the record's line, Unix time, ns; null if it never began.
    pub onset_wall_ns: Option<i64>,
    /// Time from the onset to the report of the end, s: some 10 ms more than the play.
    pub reported_after_s: Option<f64>,
    /// Whether the daemon has the texts of its patterns still, stored or in the session record, so that it can play it again.
    pub patterns_kept: bool,
    /// What the participant answered; null: nothing was recorded.
    pub answer: Option<PlayAnswer>,
}

/// A session and its recorded plays, in the order of their ends.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "session": {
        "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": "edges", "labels": {}, "seed": 42, "exclusive": true,
        "owner": "ada", "started": "2026-11-22T09:30:00.123456+01:00", "ended": null, "reason": null, "plays": 1,
        "vibration_s": 2.0, "released": false, "release_in_s": null, "lost": {"entries": 0, "plays": 0}
    },
    "plays": [],
    "more": false, "complete": false, "missing": ["the session still runs: end it first"], "plays_missing": 0, "lost": 0, "left_out": 0,
    "unreadable": 0, "problems": []
})))]
pub struct SessionPlays {
    /// The session.
    pub session: Session,
    /// Its plays from number `from` on, counted from 0: as many as have 4 MiB of text in the record, and at least one.
    pub plays: Vec<RecordedPlay>,
    /// Whether there are more plays: ask again, `from` the next one.
    pub more: bool,
    /// Whether the record has the whole session: its start, its end, the end of every play, and all lines between.
    pub complete: bool,
    /// What is missing, one line each; empty if it is complete.
    #[schema(max_items = 100)]
    pub missing: Vec<String>,
    /// Plays whose ends are missing, of the session's `plays`. Those of a session that runs may be under way.
    pub plays_missing: u64,
    /// Entries that the record lost during the session: the disk or the queue was full, or lines were removed. Plays may be among them.
    pub lost: u64,
    /// Entries that the record left out during the session, to stay within its bound: commands and what devices did, never plays.
    pub left_out: u64,
    /// As in the list of sessions: of this session's file.
    pub unreadable: u64,
    /// The first 100 of them, one line each.
    #[schema(max_items = 100)]
    pub problems: Vec<String>,
}

impl SessionPlays {
    /// Adds something that is missing.
    pub fn lack(&mut self, what: String) {
        self.missing.insert(0, what);
        self.missing.truncate(MAX_LISTED);
        self.complete = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_labels_are_bounded() {
        let read = |text: &str| SessionRequest::parse(text.as_bytes());
        let good = read(r#"{"participant":"P07","labels":{"block":"2"},"seed":3,"exclusive":null}"#).unwrap();
        assert_eq!((good.labels["block"].as_str(), good.seed, good.exclusive), ("2", Some(3), false));
        for (text, says) in [
            (r#"{"experiment":"e"}"#.to_owned(), "`participant` is missing"),
            (r#"{"participant":""}"#.to_owned(), "`participant` is ``: must be 1 to 100 characters"),
            (r#"{"participant":"a\nb"}"#.to_owned(), "must be 1 to 100 characters, without line breaks"),
            (format!(r#"{{"participant":"{}"}}"#, "x".repeat(101)), "must be 1 to 100 characters"),
            (r#"{"participant":"P","labels":{"":"2"}}"#.to_owned(), "`labels` is ``"),
            (r#"{"participant":"P","label":{}}"#.to_owned(), "did you mean `labels`?"),
        ] {
            let problem = read(&text).unwrap_err();
            assert!(
                problem.detail.contains(says) && problem.code == "bad-request",
                "{text}: {}",
                problem.detail
            );
        }
        let many: crate::body::Labels = (0..17).map(|n| (n.to_string(), String::from("x"))).collect();
        assert!(check_labels(&many).unwrap_err().detail.contains("17 labels"));
    }
}
