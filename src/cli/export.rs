//! `session export`: the recorded plays of a session as CSV, one row per stimulus, or as one JSON document.
//!
//! A stimulus is a play, or an item of a sequence. The JSON also has a row for each sequence as a whole.
//!
//! `docs/reference/session-export.md` describes the columns. A file is replaced atomically, after everything was read.
//!
//! Invariant: columns are only added, at the end, before those of the answers' factors, which depend on the session; a value that is not
//! known is an empty field.

use super::arguments::ClientOptions;
use super::files;
use super::output::{say_file, tell};
use crate::file::{PRIVATE, replace};
use crate::session_record::json;
use anyhow::{Context, Result, bail};
use csv::Writer;
use meissner_api::{Fit, Labels, PlayAnswer, RecordedPlay, Session, SessionPlays};
use meissner_client::{Client, DISK_TIMEOUT, escape};
use std::collections::BTreeSet;
use std::mem;
use std::path::Path;
use std::process::ExitCode;

/// A column: its name, and its field in the row of a play.
type Column = (&'static str, fn(&Session, &RecordedPlay) -> String);

/// The columns.
const COLUMNS: [Column; 58] = [
    ("session", |session, _| session.id.clone()),
    ("participant", |session, _| session.participant.clone()),
    ("experiment", |session, _| field(session.experiment.as_ref())),
    ("seed", |session, _| field(session.seed)),
    ("session_labels", |session, _| labels(&session.labels)),
    ("trial", |_, play| field(play.trial)),
    ("labels", |_, play| labels(&play.labels)),
    ("play", |_, play| play.play.to_string()),
    ("user", |_, play| field(play.user.as_ref())),
    ("pattern", |_, play| play.pattern.clone()),
    ("pattern_sha256", |_, play| field(play.pattern_sha256.as_ref())),
    ("seconds", |_, play| field(play.seconds)),
    ("state", |_, play| play.state.clone()),
    ("cause", |_, play| field(play.cause.as_ref())),
    ("onset_tick", |_, play| field(play.onset_tick)),
    ("onset_monotonic_ns", |_, play| field(play.onset_monotonic_ns)),
    ("onset_uncertainty_ns", |_, play| field(play.onset_uncertainty_ns)),
    ("onset_wall_ns", |_, play| field(play.onset_wall_ns)),
    ("reported_after_s", |_, play| field(play.reported_after_s)),
    ("bursts_planned", |_, play| field(play.bursts.map(|bursts| bursts.planned))),
    ("bursts_played", |_, play| field(play.bursts.map(|bursts| bursts.played))),
    ("bursts_late", |_, play| field(play.bursts.map(|bursts| bursts.late))),
    ("bursts_dropped", |_, play| field(play.bursts.map(|bursts| bursts.dropped))),
    ("bursts_refused", |_, play| field(play.bursts.map(|bursts| bursts.refused))),
    ("bursts_amended", |_, play| field(play.bursts.map(|bursts| bursts.amended))),
    ("pulses_planned", |_, play| field(play.pulses.map(|pulses| pulses.planned))),
    ("pulses_played", |_, play| field(play.pulses.map(|pulses| pulses.played))),
    ("worst_late_ms", |_, play| field(play.worst_late_ms)),
    ("rest_error_max_um", |_, play| field(play.rest_error_max_um)),
    ("session_started", |session, _| session.started.clone()),
    ("session_ended", |session, _| field(session.ended.as_ref())),
    ("item", |_, play| field(play.item)),
    ("scale", |_, play| field(play.scale)),
    ("ordered_um", |_, play| field(play.ordered_um)),
    ("reached_um", |_, play| field(play.reached_um)),
    ("ordered_ms", |_, play| field(play.ordered_ms)),
    ("played_ms", |_, play| field(play.played_ms)),
    ("cut_after_ms", |_, play| field(play.cut_after_ms)),
    ("offset_tick", |_, play| field(play.offset_tick)),
    ("offset_monotonic_ns", |_, play| field(play.offset_monotonic_ns)),
    ("trigger_tick", |_, play| field(play.trigger.map(|trigger| trigger.tick))),
    ("trigger_code", |_, play| field(play.trigger.and_then(|trigger| trigger.code))),
    ("trigger_ms", |_, play| field(play.trigger.map(|trigger| trigger.width_ms))),
    ("late_strokes", |_, play| field(play.late_strokes)),
    ("refused_strokes", |_, play| field(play.refused_strokes)),
    ("fit", |_, play| {
        match play.fit {
            Fit::Whole => "whole",
            Fit::Cover => "cover",
        }
        .to_owned()
    }),
    ("estimated", |_, play| play.estimated.to_string()),
    ("array", |_, play| play.array.clone()),
    ("tick_hz", |_, play| play.tick_hz.to_string()),
    ("first_pulse_tick", |_, play| field(play.first_pulse_tick)),
    // An empty response is an answer, too.
    ("response", |_, play| {
        answered(play, |answer| Some(if answer.response.is_empty() { "\"\"" } else { &answer.response }))
    }),
    ("correct", |_, play| answered(play, |answer| answer.correct)),
    ("response_time", |_, play| answered(play, |answer| answer.rt_ms.map(|ms| ms / 1e3))),
    ("level", |_, play| answered(play, |answer| answer.level)),
    ("start_edge", |_, play| field(play.start_edge.map(|edge| edge.number))),
    ("start_edge_tick", |_, play| field(play.start_edge.map(|edge| edge.tick))),
    ("stop_edge", |_, play| field(play.stop_edge.map(|edge| edge.number))),
    ("stop_edge_tick", |_, play| field(play.stop_edge.map(|edge| edge.tick))),
];

/// The field of a part of the participant's answer.
fn answered<'p, T: ToString>(
    play: &'p RecordedPlay,
    part: impl FnOnce(&'p PlayAnswer) -> Option<T>,
) -> String {
    field(play.answer.as_ref().and_then(part))
}

/// The field of a value that may not be known.
fn field(value: Option<impl ToString>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// Labels as `KEY=VALUE;KEY=VALUE`. A backslash stands before each `;`, `=` and backslash of a key or value.
fn labels(labels: &Labels) -> String {
    let escaped = |text: &str| text.replace('\\', "\\\\").replace(';', "\\;").replace('=', "\\=");
    let label = |(key, value): (&String, &String)| format!("{}={}", escaped(key), escaped(value));
    labels.iter().map(label).collect::<Vec<_>>().join(";")
}

pub(super) fn run(
    options: &ClientOptions,
    id: &str,
    output: Option<&Path>,
    incomplete: bool,
) -> Result<ExitCode> {
    // Tells at once of a link or of a folder that is not there.
    output.map(files::beside).transpose()?;
    let exported = read(&mut options.client()?, id)?;
    if !exported.complete && !incomplete {
        let (id, lacks) = (&exported.session.id, exported.missing.join("; "));
        bail!("session {id} is not whole in the record: {lacks}; --incomplete exports what there is");
    }
    warn_incomplete(&exported);
    let text = if options.output.json { json_line(&exported)? } else { table(&exported)? };
    match output {
        None => say_file(text.trim_end_matches('\n'))?,
        // The file is readable for its user only, because it holds personal data.
        Some(path) => replace(path, text.as_bytes(), PRIVATE)
            .with_context(|| format!("{}: cannot be written; name another file with -o", path.display()))?,
    }
    Ok(ExitCode::SUCCESS)
}

fn json_line(exported: &SessionPlays) -> Result<String> {
    let mut line = Vec::new();
    json::write(&mut line, exported)?;
    line.push(b'\n');
    Ok(String::from_utf8(line)?)
}

/// Says on stderr which parts of the record cannot be read.
pub(super) fn warn_unreadable(count: u64, problems: &[String]) {
    for problem in problems {
        tell(&format!("warning: {problem}"));
    }
    if let more @ 1.. = count.saturating_sub(problems.len() as u64) {
        tell(&format!("warning: {more} more lines of the session record are missing or cannot be read"));
    }
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

/// All plays of a session, answer by answer.
fn read(client: &mut Client, id: &str) -> Result<SessionPlays> {
    let mut all: Option<SessionPlays> = None;
    loop {
        let from = all.as_ref().map_or(0, |all| all.plays.len());
        let path = format!("/v1/sessions/{}/plays?from={from}", escape(id));
        let next: SessionPlays = client.get_within(DISK_TIMEOUT, &path)?;
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

/// The table of stimuli, as CSV.
pub(crate) fn table(exported: &SessionPlays) -> Result<String> {
    let mut csv = Writer::from_writer(Vec::new());
    let factors: BTreeSet<&String> = exported
        .plays
        .iter()
        .flat_map(|play| &play.answer)
        .flat_map(|answer| answer.factors.keys())
        .collect();
    let names = factors.iter().map(|key| format!("factor_{key}"));
    csv.write_record(COLUMNS.map(|(name, _)| name.to_owned()).into_iter().chain(names))?;
    // A sequence as a whole is not a stimulus. A sequence without items keeps its row, to show that it was ordered.
    for play in exported.plays.iter().filter(|play| play.items == 0) {
        let of = |key: &&String| answered(play, |answer| answer.factors.get(*key));
        let fields = COLUMNS.map(|(_, field)| field(&exported.session, play)).into_iter();
        csv.write_record(fields.chain(factors.iter().map(of)))?;
    }
    Ok(String::from_utf8(csv.into_inner()?)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_sets_of_labels_make_the_same_cell() {
        let cell = |of: &[(&str, &str)]| {
            labels(&of.iter().map(|&(key, value)| (key.to_owned(), value.to_owned())).collect())
        };
        assert_eq!(cell(&[("block", "2"), ("side", "left")]), "block=2;side=left");
        assert_eq!(cell(&[("a", r"1;b=2\")]), r"a=1\;b\=2\\");
    }
}
