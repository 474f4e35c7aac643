//! Sessions: plays that are recorded together, and whether one client owns the display meanwhile.
//!
//! [`SessionRequest`] starts a session, and [`SessionStarted`] answers with its id and the owner's token. The client sends the
//! token as `Authorization: Bearer TOKEN`. One session runs at a time; every play meanwhile belongs to it.
//!
//! Invariant: names and labels have no control characters, and at most the characters stated here.

use crate::answer::PlayAnswer;
use crate::body::{check_labels, check_text, read};
use crate::end_cause::EndCause;
use crate::live_record::LiveRecord;
use crate::order::{Fit, LatePolicy};
use crate::problem::Problem;
use crate::receipt::{BurstCounts, EdgeRecord, MAX_LISTED, OrderedCounts, PulseCounts};
use crate::trigger::TriggerRecord;
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
    /// Why the daemon does not record the session: it keeps no session record. Null if it records it; if it cannot, no session
    /// starts.
    pub record_problem: Option<String>,
}

/// A session, as it stands or as it was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": "edges", "labels": {"block": "2"}, "seed": 42,
    "exclusive": true, "owner": "ada", "started": "2026-11-22T09:30:00.123456+01:00", "ended": null, "reason": null,
    "plays": 12, "vibration_s": 24.0, "released": false, "release_in_s": 97.5, "lost": 0, "plays_lost": 0
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
    /// Entries of the session that the record is known to have lost: the disk did not take them, or they were removed. 0 too without a
    /// record.
    pub lost: u64,
    /// Plays of the session whose ends the record is known to have lost.
    pub plays_lost: u64,
    /// In the status: whether the client that asks shows the token of this session. Missing elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mine: Option<bool>,
}

impl Session {
    /// Whether only the owner may change anything now.
    #[must_use]
    pub const fn is_closed_to_others(&self) -> bool {
        self.exclusive && !self.released && self.reason.is_none()
    }
}

/// The recorded sessions, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"sessions": [], "unreadable": 1, "problems": ["/var/lib/meissner/logbook/2026-11-20.jsonl:17: not a line of JSON"]})))]
pub struct SessionList {
    /// The sessions.
    pub sessions: Vec<Session>,
    /// Gaps in the numbers of the record's entries, where whole sessions may be missing, and lines and files that cannot be read.
    pub unreadable: u64,
    /// The first 100 of them, one line each.
    #[schema(max_items = 100)]
    pub problems: Vec<String>,
}

/// Rows of a session's plays in one answer, at most, items of sequences included: with the longest labels and
/// answers they fit into 16 MiB.
pub const MAX_ROWS: usize = 1000;

/// A recorded play of a session, or an item of a sequence. A sequence has a row as a whole, with what the items have not; its items
/// follow.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RecordedPlay {
    /// The play's id: its number since the daemon's start.
    #[schema(minimum = 1)]
    pub play: u64,
    /// The user who ordered it; null: not known.
    pub user: Option<String>,
    /// The trial's number; null if none was given.
    pub trial: Option<u64>,
    /// The trial's labels.
    pub labels: BTreeMap<String, String>,
    /// The pattern's name.
    pub pattern: String,
    /// SHA-256 of the pattern's file, in hexadecimal; null if the play's end is missing.
    pub pattern_sha256: Option<String>,
    /// The array that was driven.
    pub array: String,
    /// Rate of its device's ticks, Hz: the row's ticks count in them.
    #[schema(minimum = 20000, maximum = 200_000)]
    pub tick_hz: u32,
    /// Requested duration, s; null: as long as the pattern lasts.
    pub seconds: Option<f64>,
    /// `done`, `stopped` or `aborted`; `unknown` if its end is missing from the record.
    pub state: String,
    /// Why it ended; null if it is done or that is not known.
    #[schema(value_type = Option<String>)]
    pub cause: Option<EndCause>,
    /// The tick at which the play began, ticks; null if it never began.
    pub onset_tick: Option<u64>,
    /// The onset on the host's `CLOCK_MONOTONIC`, ns.
    pub onset_monotonic_ns: Option<u64>,
    /// Uncertainty of the onset on the host's clock, ns.
    pub onset_uncertainty_ns: Option<u64>,
    /// The onset on the host's wall clock as of the record's line, Unix time, ns.
    pub onset_wall_ns: Option<i64>,
    /// Time from the onset to the report of the end, s: some 10 ms more than the play.
    pub reported_after_s: Option<f64>,
    /// What happened to the bursts; null if the end is missing.
    pub bursts: Option<BurstCounts>,
    /// The pulses; null if the end is missing.
    pub pulses: Option<PulseCounts>,
    /// Whether what was played is an estimate, because the link was lost.
    pub estimated: bool,
    /// By how much the latest stroke came late, ms; 0 if none did.
    pub worst_late_ms: Option<f64>,
    /// Largest estimated offset of a pin from rest at the end, µm.
    pub rest_error_max_um: Option<f32>,
    /// The item's number in its sequence, from 0; null of a play as a whole.
    pub item: Option<u64>,
    /// Of a sequence as a whole: how many rows of items follow. Otherwise 0.
    pub items: u64,
    /// Of a sequence as a whole: how many items it was to play. Rows of items that never began, or whose lines the record lost, are
    /// missing. Null of other plays.
    #[schema(minimum = 1, maximum = 4096)]
    pub items_planned: Option<u64>,
    /// The largest amplitude of its drives as ordered, µm; null if that is not recorded.
    pub ordered_um: Option<f64>,
    /// The largest amplitude that they reach in whole pulses, µm.
    pub reached_um: Option<f64>,
    /// The factor of the amplitudes; null of a sequence as a whole.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: Option<f64>,
    /// Which strokes were to be played at the end.
    pub fit: Fit,
    /// What was to happen to late strokes.
    pub late_policy: LatePolicy,
    /// Whether it was to play without corrections from telemetry.
    pub open_loop: bool,
    /// Duration as ordered, ms; null: without end, or not recorded.
    pub ordered_ms: Option<f64>,
    /// Duration as played, from onset to offset, ms.
    pub played_ms: Option<f64>,
    /// Time from the onset to the cut that ended the play, ms; null if it was not cut.
    pub cut_after_ms: Option<f64>,
    /// When the last pulse was over, ticks.
    pub offset_tick: Option<u64>,
    /// The same on the host's `CLOCK_MONOTONIC`, ns.
    pub offset_monotonic_ns: Option<u64>,
    /// What the trigger output gave at the onset; null: nothing.
    pub trigger: Option<TriggerRecord>,
    /// What pattern and order say; null of an item, or if it was not counted.
    pub ordered: Option<OrderedCounts>,
    /// When the item was to begin, ticks from the sequence's onset; null of a play as a whole.
    pub planned_onset_ticks: Option<u64>,
    /// Number of strokes that came late; null if the end is missing.
    pub late_strokes: Option<u64>,
    /// Number of the item's strokes that the device refused; null of a play as a whole, which counts bursts.
    pub refused_strokes: Option<u64>,
    /// The boot of the device whose ticks these are; null if the record does not tell.
    pub boot: Option<u32>,
    /// Whether the daemon has the pattern's text still, stored or in the session record, so that it can play it again. Of a sequence as
    /// a whole and of a blank item: true.
    pub pattern_kept: bool,
    /// The first pulse of a pin, ticks; null if no pin moved, or if that is not recorded.
    pub first_pulse_tick: Option<u64>,
    /// The edge of the trigger input after which the play began; null: it waited for none. The items of a sequence repeat it.
    pub start_edge: Option<EdgeRecord>,
    /// The edge that stopped the play; null: none did. The items of a sequence repeat it.
    pub stop_edge: Option<EdgeRecord>,
    /// What became of the updates of a live play; null of other plays. The record has their counts, not the moves.
    pub live: Option<LiveRecord>,
    /// What the participant answered; null: nothing was recorded. The items of a sequence repeat its answer.
    pub answer: Option<PlayAnswer>,
}

/// A session and its recorded plays, in the order of their ends.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "session": {
        "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": "edges", "labels": {}, "seed": 42, "exclusive": true,
        "owner": "ada", "started": "2026-11-22T09:30:00.123456+01:00", "ended": null, "reason": null, "plays": 1,
        "vibration_s": 2.0, "released": false, "release_in_s": null, "lost": 0, "plays_lost": 0
    },
    "plays": [{
        "play": 7, "user": "ada", "trial": 12, "labels": {"condition": "a"}, "pattern": "edge-45",
        "pattern_sha256": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08", "array": "tula35-6x4", "tick_hz": 85000,
        "seconds": 2.0, "state": "done",
        "cause": null, "onset_tick": 6442460000_u64, "onset_monotonic_ns": 75793647058823_u64, "onset_uncertainty_ns": 9600,
        "onset_wall_ns": 1795336200123456000_u64, "reported_after_s": 2.01,
        "bursts": {"planned": 1240, "played": 1240, "late": 0, "dropped": 0, "refused": 0, "replaced": 0, "amended": 1221, "shortened": 0},
        "pulses": {"planned": 86800, "played": 86790}, "estimated": false, "worst_late_ms": 0.0, "rest_error_max_um": 0.4,
        "item": null, "items": 0, "items_planned": null, "ordered_um": 80.0, "reached_um": 69.2, "scale": 1.0, "fit": "whole", "late_policy": "drop",
        "open_loop": false, "ordered_ms": 2000.0, "played_ms": 1998.8, "cut_after_ms": null, "offset_tick": 6442629900_u64,
        "offset_monotonic_ns": 75795645882352_u64, "trigger": {"tick": 6442460000_u64, "width_ms": 10.0, "code": null},
        "ordered": {"bursts": 1240, "pulses": 86800}, "planned_onset_ticks": null, "late_strokes": 0, "refused_strokes": null,
        "boot": 305419896, "pattern_kept": true, "first_pulse_tick": 6442460000_u64, "start_edge": null, "stop_edge": null, "live": null,
        "answer": {"response": "left", "correct": true, "rt_ms": 512.3, "level": 0.4, "factors": {"block": "2"}}
    }],
    "more": false, "complete": false, "missing": ["the session still runs: end it first"], "plays_missing": 0, "lost": 0, "left_out": 0,
    "unreadable": 0, "problems": []
})))]
pub struct SessionPlays {
    /// The session.
    pub session: Session,
    /// Its rows from number `from` on, counted from 0: plays, each sequence followed by its items.
    #[schema(max_items = 2000)]
    pub plays: Vec<RecordedPlay>,
    /// Whether there are more plays: ask again, `from` the next one.
    pub more: bool,
    /// Whether the record has the whole session: its start, its end, the end of every play, and all entries between.
    pub complete: bool,
    /// What is missing, one line each; empty if it is complete.
    #[schema(max_items = 100)]
    pub missing: Vec<String>,
    /// Plays whose ends are missing, of the session's `plays`. Those of a session that runs may be under way.
    pub plays_missing: u64,
    /// Entries that the record lost during the session: the disk or the queue was full, or a file was removed. Plays may be among them.
    pub lost: u64,
    /// Entries that the record left out during the session, to stay within its bound: commands and what devices did, never plays.
    pub left_out: u64,
    /// As in the list of sessions: of the whole record.
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
