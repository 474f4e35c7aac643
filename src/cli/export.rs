//! `session export`: the recorded plays of a session as CSV, one row per stimulus, or as one JSON document.
//!
//! A stimulus is a play of one item, or an item of several; [`Row`] makes its row of the receipt, the item and the answer.
//!
//! `docs/reference/session-export.md` describes the columns. A file is replaced atomically, after everything was read.
//!
//! Invariant: columns are only added, at the end, before those of the answers' factors, which depend on the session; a value that is not
//! known is an empty field.

use super::arguments::ClientOptions;
use super::files;
use super::output::{say_file, tell};
use crate::file::{PRIVATE, replace};
use crate::record::json;
use anyhow::{Context, Result, bail};
use csv::Writer;
use meissner_api::{
    BurstCounts, Fit, InstantRecord, ItemRecord, ItemState, Labels, PlayAnswer, PulseCounts, Receipt,
    RecordedPlay, Session, SessionPlays, TriggerRecord,
};
use meissner_array::units::TickRate;
use meissner_client::{Client, DISK_TIMEOUT, escape};
use std::collections::BTreeSet;
use std::mem;
use std::path::Path;
use std::process::ExitCode;

/// A stimulus: a play of one item, or an item of several.
struct Row<'p> {
    session: &'p Session,
    play: &'p RecordedPlay,
    item: Option<&'p ItemRecord>,
    /// The receipt, if what it says of the play is true of the stimulus.
    whole: Option<&'p Receipt>,
}

impl<'p> Row<'p> {
    /// The rows of a play. One whose items are not known has a row, to show that it was ordered.
    fn of(session: &'p Session, play: &'p RecordedPlay) -> Vec<Self> {
        let receipt = &play.receipt;
        let row = |item: Option<&'p ItemRecord>| {
            let whole = (receipt.order.items <= 1 || item.is_none()).then_some(receipt);
            Row { session, play, item, whole }
        };
        let items = receipt.items.iter().flat_map(|items| items.iter());
        let rows: Vec<_> = items.map(|item| row(Some(item))).collect();
        if rows.is_empty() { vec![row(None)] } else { rows }
    }

    /// The item, if the play has several.
    fn part(&self) -> Option<&'p ItemRecord> {
        self.item.filter(|_| self.whole.is_none())
    }

    fn onset(&self) -> Option<InstantRecord> {
        match self.item {
            Some(item) if self.whole.is_none() || item.planned_onset_ticks > 0 => item.onset,
            _ => self.play.receipt.onset.map(|onset| InstantRecord {
                tick: onset.actual_tick,
                monotonic_ns: onset.monotonic_ns,
                uncertainty_ns: onset.uncertainty_ns,
            }),
        }
    }

    fn onset_wall_ns(&self) -> Option<i64> {
        let (whole, own) = (self.play.receipt.onset?.monotonic_ns, self.onset()?.monotonic_ns);
        self.play.onset_wall_ns?.checked_add_unsigned(own.checked_sub(whole)?)
    }

    fn offset(&self) -> Option<InstantRecord> {
        self.part().map_or(self.play.receipt.offset, |item| item.offset)
    }

    fn ordered_ms(&self) -> Option<f64> {
        self.part().map_or(self.play.receipt.duration_ms.ordered, |item| item.ordered_ms)
    }

    fn played_ms(&self) -> Option<f64> {
        let ticks = self.offset()?.tick.checked_sub(self.onset()?.tick)?;
        Some(TickRate::new(self.play.receipt.device.tick_hz).ticks_to_ms(ticks))
    }

    fn cause(&self) -> Option<String> {
        let cuts = self.part().is_none_or(|item| item.state == ItemState::Cut);
        self.play.receipt.cause.as_ref().filter(|_| cuts).map(ToString::to_string)
    }

    fn state(&self) -> &'static str {
        self.part().map_or(self.play.receipt.state.name(), |item| item.state.name())
    }

    fn bursts(&self) -> Option<BurstCounts> {
        self.whole?.counts.bursts
    }

    fn pulses(&self) -> Option<PulseCounts> {
        self.whole?.counts.pulses
    }

    fn rest_error_max_um(&self) -> Option<f32> {
        self.whole?.pins.as_ref()?.rest_error_um.iter().map(|um| um.abs()).reduce(f32::max)
    }

    fn late_strokes(&self) -> Option<u64> {
        let whole = || self.bursts().map(|_| self.play.receipt.counts.lateness.counts);
        let whole = || whole().map(|late| late.host + late.link + late.device);
        self.part().map_or_else(whole, |item| Some(item.late_strokes.into()))
    }

    fn first_pulse_tick(&self) -> Option<u64> {
        let pins = || self.whole?.pins.as_ref()?.moved.iter().map(|pin| pin.first_pulse_tick).min();
        self.part().map_or_else(pins, |item| item.first_pulse_tick)
    }

    fn trigger(&self) -> Option<TriggerRecord> {
        self.item?.trigger
    }

    /// The field of a part of the participant's answer.
    fn answered<T: ToString>(&self, part: impl FnOnce(&'p PlayAnswer) -> Option<T>) -> String {
        field(self.play.answer.as_ref().and_then(part))
    }
}

/// A column: its name, and its field of a stimulus.
type Column = (&'static str, fn(&Row) -> String);

/// The columns.
const COLUMNS: [Column; 58] = [
    ("session", |row| row.session.id.clone()),
    ("participant", |row| row.session.participant.clone()),
    ("experiment", |row| field(row.session.experiment.as_ref())),
    ("seed", |row| field(row.session.seed)),
    ("session_labels", |row| labels(&row.session.labels)),
    ("trial", |row| field(row.play.receipt.order.terms.trial)),
    ("labels", |row| labels(&row.play.receipt.order.terms.labels)),
    ("play", |row| row.play.receipt.id.to_string()),
    ("user", |row| field(row.play.user.as_ref())),
    ("pattern", |row| {
        row.item.map_or_else(|| row.play.receipt.name.clone(), |item| item.pattern.to_string())
    }),
    ("pattern_sha256", |row| {
        row.item.map_or_else(|| row.play.receipt.sha256.clone(), |item| item.pattern_sha256.to_string())
    }),
    ("seconds", |row| field(row.ordered_ms().map(|ms| ms / 1e3))),
    ("state", |row| row.state().to_owned()),
    ("cause", |row| field(row.cause())),
    ("onset_tick", |row| field(row.onset().map(|onset| onset.tick))),
    ("onset_monotonic_ns", |row| field(row.onset().map(|onset| onset.monotonic_ns))),
    ("onset_uncertainty_ns", |row| field(row.onset().map(|onset| onset.uncertainty_ns))),
    ("onset_wall_ns", |row| field(row.onset_wall_ns())),
    ("reported_after_s", |row| field(row.whole.and(row.play.reported_after_s))),
    ("bursts_planned", |row| field(row.bursts().map(|bursts| bursts.planned))),
    ("bursts_played", |row| field(row.bursts().map(|bursts| bursts.played))),
    ("bursts_late", |row| field(row.bursts().map(|bursts| bursts.late))),
    ("bursts_dropped", |row| field(row.bursts().map(|bursts| bursts.dropped))),
    ("bursts_refused", |row| field(row.bursts().map(|bursts| bursts.refused))),
    ("bursts_amended", |row| field(row.bursts().map(|bursts| bursts.amended))),
    ("pulses_planned", |row| field(row.pulses().map(|pulses| pulses.planned))),
    ("pulses_played", |row| field(row.pulses().map(|pulses| pulses.played))),
    ("worst_late_ms", |row| field(row.bursts().map(|_| row.play.receipt.counts.lateness.counts.worst_ms))),
    ("rest_error_max_um", |row| field(row.rest_error_max_um())),
    ("session_started", |row| row.session.started.clone()),
    ("session_ended", |row| field(row.session.ended.as_ref())),
    ("item", |row| field(row.part().map(|item| item.item))),
    ("scale", |row| field(row.item.map(|item| item.scale))),
    ("ordered_um", |row| field(row.item.and_then(|item| item.ordered_um))),
    ("reached_um", |row| field(row.item.and_then(|item| item.reached_um))),
    ("ordered_ms", |row| field(row.ordered_ms())),
    ("played_ms", |row| field(row.played_ms())),
    ("cut_after_ms", |row| field(row.whole.and_then(|receipt| receipt.duration_ms.cut_after))),
    ("offset_tick", |row| field(row.offset().map(|offset| offset.tick))),
    ("offset_monotonic_ns", |row| field(row.offset().map(|offset| offset.monotonic_ns))),
    ("trigger_tick", |row| field(row.trigger().map(|trigger| trigger.tick))),
    ("trigger_code", |row| field(row.trigger().and_then(|trigger| trigger.code))),
    ("trigger_ms", |row| field(row.trigger().map(|trigger| trigger.width_ms))),
    ("late_strokes", |row| field(row.late_strokes())),
    ("refused_strokes", |row| field(row.part().map(|item| item.refused_strokes))),
    ("fit", |row| {
        match row.play.receipt.order.terms.fit {
            Fit::Whole => "whole",
            Fit::Cover => "cover",
        }
        .to_owned()
    }),
    ("estimated", |row| row.play.receipt.counts.estimated.to_string()),
    ("array", |row| row.play.receipt.device.array.clone()),
    ("tick_hz", |row| row.play.receipt.device.tick_hz.to_string()),
    ("first_pulse_tick", |row| field(row.first_pulse_tick())),
    // An empty response is an answer, too.
    ("response", |row| {
        row.answered(|answer| Some(if answer.response.is_empty() { "\"\"" } else { &answer.response }))
    }),
    ("correct", |row| row.answered(|answer| answer.correct)),
    ("response_time", |row| row.answered(|answer| answer.rt_ms.map(|ms| ms / 1e3))),
    ("level", |row| row.answered(|answer| answer.level)),
    ("start_edge", |row| field(row.play.receipt.edges.start.map(|edge| edge.number))),
    ("start_edge_tick", |row| field(row.play.receipt.edges.start.map(|edge| edge.tick))),
    ("stop_edge", |row| field(row.play.receipt.edges.stop.map(|edge| edge.number))),
    ("stop_edge_tick", |row| field(row.play.receipt.edges.stop.map(|edge| edge.tick))),
];

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
    for row in exported.plays.iter().flat_map(|play| Row::of(&exported.session, play)) {
        let of = |key: &&String| row.answered(|answer| answer.factors.get(*key));
        let fields = COLUMNS.map(|(_, field)| field(&row)).into_iter();
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
