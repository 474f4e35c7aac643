//! `session export`: the recorded plays of a session as CSV, one row per stimulus, or as one JSON document.
//!
//! A stimulus is a play, or an item of a sequence. The JSON also has a row for each sequence as a whole.
//!
//! `docs/reference/session-export.md` describes the columns. A file is replaced atomically, after everything was read.
//!
//! Invariant: columns are only added, at the end; a value that is not known is an empty field.

use super::arguments::ClientOptions;
use super::output::{say_file, tell};
use super::session::warn_unreadable;
use crate::file::dir_of;
use crate::session_record::json;
use anyhow::{Context, Result, bail};
use csv::Writer;
use meissner_api::{Fit, Labels, RecordedPlay, Session, SessionPlays};
use meissner_client::{Client, escape};
use std::mem;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

/// How long to wait while the daemon reads its record.
pub(super) const TIMEOUT: Duration = Duration::from_secs(60);

/// The columns.
pub(super) const COLUMNS: [&str; 47] = [
    "session",
    "participant",
    "experiment",
    "seed",
    "session_labels",
    "trial",
    "labels",
    "play",
    "user",
    "pattern",
    "pattern_sha256",
    "seconds",
    "state",
    "cause",
    "onset_tick",
    "onset_monotonic_ns",
    "onset_uncertainty_ns",
    "onset_wall_ns",
    "reported_after_s",
    "bursts_planned",
    "bursts_played",
    "bursts_late",
    "bursts_dropped",
    "bursts_refused",
    "bursts_amended",
    "pulses_planned",
    "pulses_played",
    "worst_late_ms",
    "rest_error_max_um",
    "session_started",
    "session_ended",
    "item",
    "scale",
    "ordered_um",
    "reached_um",
    "ordered_ms",
    "played_ms",
    "cut_after_ms",
    "offset_tick",
    "offset_monotonic_ns",
    "trigger_tick",
    "trigger_code",
    "trigger_ms",
    "late_strokes",
    "refused_strokes",
    "fit",
    "estimated",
];

pub(super) fn run(
    options: &ClientOptions,
    id: &str,
    output: Option<&Path>,
    incomplete: bool,
) -> Result<ExitCode> {
    let exported = read(&mut options.client()?, id)?;
    if let Some(lacks) = lacks(&exported).filter(|_| !incomplete) {
        let id = &exported.session.id;
        bail!("session {id} is not whole in the record: {lacks}; --incomplete exports what there is");
    }
    warn_incomplete(&exported);
    let text = if options.output.json { json_line(&exported)? } else { table(&exported)? };
    match output {
        None => say_file(text.trim_end_matches('\n'))?,
        Some(path) => {
            let write = || {
                let mut file = tempfile::NamedTempFile::new_in(dir_of(path))?;
                std::io::Write::write_all(&mut file, text.as_bytes())?;
                // The file stays readable for its user only, because it holds personal data.
                file.persist(path)?;
                Ok::<_, std::io::Error>(())
            };
            write().with_context(|| {
                format!("{}: cannot be written; name another file with -o", path.display())
            })?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn json_line(exported: &SessionPlays) -> Result<String> {
    let mut line = Vec::new();
    json::write(&mut line, exported)?;
    line.push(b'\n');
    Ok(String::from_utf8(line)?)
}

/// Says on stderr what is missing.
pub(super) fn warn_incomplete(exported: &SessionPlays) {
    warn_unreadable(exported.unreadable, &exported.problems);
    let left_out = format!(
        "the record left out {} entries that are no plays, to stay within its bound",
        exported.left_out
    );
    let left_out = (exported.left_out > 0).then_some(&left_out);
    for line in exported.missing.iter().chain(left_out) {
        tell(&format!("warning: {line}"));
    }
}

/// The missing parts, in one line; none if the record has the whole session.
pub(super) fn lacks(exported: &SessionPlays) -> Option<String> {
    let unknown = || "the daemon is an older one, and does not say what is missing".to_owned();
    let missing = || if exported.missing.is_empty() { unknown() } else { exported.missing.join("; ") };
    (!exported.complete).then(missing)
}

/// All plays of a session, answer by answer.
fn read(client: &mut Client, id: &str) -> Result<SessionPlays> {
    let mut all: Option<SessionPlays> = None;
    loop {
        let from = all.as_ref().map_or(0, |all| all.plays.len());
        let path = format!("/v1/sessions/{}/plays?from={from}", escape(id));
        let next: SessionPlays = client.get_within(TIMEOUT, &path)?;
        let more = next.more && !next.plays.is_empty();
        match &mut all {
            None => all = Some(next),
            Some(all) => {
                all.plays.extend(next.plays);
                *all = SessionPlays { plays: mem::take(&mut all.plays), ..next };
            }
        }
        if let Some(all) = all.take_if(|_| !more) {
            return Ok(all);
        }
    }
}

fn table(exported: &SessionPlays) -> Result<String> {
    let mut csv = Writer::from_writer(Vec::new());
    csv.write_record(COLUMNS)?;
    // A sequence as a whole is not a stimulus. A sequence without items keeps its row, to show that it was ordered.
    for play in exported.plays.iter().filter(|play| play.items == 0) {
        csv.write_record(row(&exported.session, play))?;
    }
    Ok(String::from_utf8(csv.into_inner()?)?)
}

fn row(session: &Session, play: &RecordedPlay) -> [String; COLUMNS.len()] {
    fn field(value: Option<impl ToString>) -> String {
        value.map_or_else(String::new, |value| value.to_string())
    }
    let labels = |labels: &Labels| {
        labels.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(";")
    };
    let (bursts, pulses) = (play.bursts, play.pulses);
    [
        session.id.clone(),
        session.participant.clone(),
        field(session.experiment.as_ref()),
        field(session.seed),
        labels(&session.labels),
        field(play.trial),
        labels(&play.labels),
        play.play.to_string(),
        field(play.user.as_ref()),
        play.pattern.clone(),
        field(play.pattern_sha256.as_ref()),
        field(play.seconds),
        play.state.clone(),
        field(play.cause.as_ref()),
        field(play.onset_tick),
        field(play.onset_monotonic_ns),
        field(play.onset_uncertainty_ns),
        field(play.onset_wall_ns),
        field(play.reported_after_s),
        field(bursts.map(|bursts| bursts.planned)),
        field(bursts.map(|bursts| bursts.played)),
        field(bursts.map(|bursts| bursts.late)),
        field(bursts.map(|bursts| bursts.dropped)),
        field(bursts.map(|bursts| bursts.refused)),
        field(bursts.map(|bursts| bursts.amended)),
        field(pulses.map(|pulses| pulses.planned)),
        field(pulses.map(|pulses| pulses.played)),
        field(play.worst_late_ms),
        field(play.rest_error_max_um),
        session.started.clone(),
        field(session.ended.as_ref()),
        field(play.item),
        field(play.scale),
        field(play.ordered_um),
        field(play.reached_um),
        field(play.ordered_ms),
        field(play.played_ms),
        field(play.cut_after_ms),
        field(play.offset_tick),
        field(play.offset_monotonic_ns),
        field(play.trigger.map(|trigger| trigger.tick)),
        field(play.trigger.and_then(|trigger| trigger.code)),
        field(play.trigger.map(|trigger| trigger.width_ms)),
        field(play.late_strokes),
        field(play.refused_strokes),
        match play.fit {
            Fit::Whole => "whole",
            Fit::Cover => "cover",
        }
        .to_owned(),
        if play.estimated { "true" } else { "false" }.to_owned(),
    ]
}
