//! Status, sessions and patterns as text; `receipt` has receipts.
//!
//! Every number is also in the JSON. Invariant: no line depends on the terminal; units are ASCII (`um`, `us`).

mod motions;
mod receipt;

pub(super) use motions::motions;
pub(super) use receipt::{LARGEST_OFFSET, accepted, receipt, receipt_lines};

use crate::doctor::device::{NO_TELEMETRY, ON_NO_BOARD, SHORT_PLAYS};
use crate::doctor::rights::SLOW_ESTOP;
use comfy_table::Table;
use comfy_table::presets::NOTHING;
use firmware_protocol::board::{Counter, Counts};
use meissner_api::{
    ArmedStatus, BoardStatus, ClockSample, EndCause, ErrorSource, NO_DEVICE, ParticipantStatus, Session,
    Status,
};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Two columns: labels and values.
pub(super) fn pairs(pairs: &[(&str, String)]) -> String {
    let width = pairs.iter().map(|(name, _)| name.len()).max().unwrap_or_default();
    let lines = pairs.iter().map(|(name, value)| format!("{name:<width$}  {value}"));
    lines.collect::<Vec<_>>().join("\n")
}

/// A table without rules; the head may be empty.
pub(super) fn columns(head: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING).add_rows(rows);
    if !head.is_empty() {
        table.set_header(head);
    }
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table.trim_fmt()
}

/// A number with `digits` digits after the point; `-` if there is none.
pub(super) fn number(number: Option<f64>, digits: usize) -> String {
    number.map_or_else(|| "-".to_owned(), |number| format!("{number:.digits$}"))
}

/// State and cause, and pins that stand above rest.
pub(super) fn state(status: &Status) -> String {
    let Status { state, cause, daemon, .. } = status;
    let mut text = match cause.as_str() {
        _ if state == NO_DEVICE => "no device".to_owned(),
        cause if cause == EndCause::HostTimeout.text() => {
            format!("{state}: the PC was silent for more than {} ms", daemon.lease_ms)
        }
        cause => format!("{state} ({cause})"),
    };
    if let Some(standing) = &status.standing {
        text = format!("{text}; {}", standing.text());
    }
    text
}

/// How far pins may be from rest by dead reckoning: the largest estimate, and the number of motors that have one.
pub(super) fn drift(status: &Status) -> Option<String> {
    let (um, count) = largest_offset(status, ErrorSource::DeadReckoning)?;
    let limit_um = status.daemon.drift_limit_um;
    let full = if um > limit_um { ": no play drives such a pin until it is home or level" } else { "" };
    Some(format!("up to {um:.0} um from rest (estimated), {count}; limit {limit_um} um{full}"))
}

/// How far pins are from rest by telemetry and by the lower stop.
fn offset(status: &Status) -> Option<String> {
    let offsets: Vec<_> = [ErrorSource::Telemetry, ErrorSource::LowerStop]
        .into_iter()
        .filter_map(|source| Some((source.name(), largest_offset(status, source)?)))
        .map(|(source, (um, count))| format!("up to {um:.1} um from rest ({source}), {count}"))
        .collect();
    (!offsets.is_empty()).then(|| offsets.join("; "))
}

/// The largest offset from rest that comes from `source`, um, and how many pins have one.
fn largest_offset(status: &Status, source: ErrorSource) -> Option<(f32, String)> {
    let offsets =
        || status.motors.iter().filter(|motor| motor.source == source).map(|motor| motor.rest_error_um.abs());
    let um = offsets().reduce(f32::max)?;
    Some((um, format!("{} of {} pins", offsets().count(), status.motors.len())))
}

/// The motors whose telemetry is not trusted, each with its reason.
fn sensor_faults(status: &Status) -> Option<String> {
    let faults: Vec<_> = (0..)
        .zip(&status.motors)
        .filter_map(|(motor, of): (u8, _)| Some(format!("pin {motor}: {}", of.sensor_fault?.text())))
        .collect();
    (!faults.is_empty()).then(|| faults.join("; "))
}

pub(super) fn status(status: &Status) -> String {
    let none = || match &status.link.missing {
        Some(missing) => format!("none: {missing}"),
        None => format!("none yet: the daemon looks for `{}`", status.link.wanted),
    };
    let device = status.device.as_ref().map_or_else(none, |device| {
        format!("{}, firmware {} ({})", device.kind, device.firmware, device.build)
    });
    let play = status.play.as_ref().map_or_else(
        || "nothing".to_owned(),
        |play| format!("{} of {}, {:.1} s", play.id, play.name, play.played_s),
    );
    let mut lines = vec![
        ("state", state(status)),
        ("position", status.position.clone()),
        ("device", device),
        ("array", status.daemon.array.clone()),
        ("playing", play),
    ];
    if let Some(ArmedStatus { by, for_s, left_s, .. }) = &status.armed {
        let until = left_s.map_or("unattended, until `meissner disarm`".to_owned(), |left_s| {
            format!("disarms in {left_s:.0} s unless somebody arms, plays or homes, or a program that did so asks something")
        });
        lines.push(("armed by", format!("{by} for {for_s:.0} s; {until}")));
    }
    if let Some(age_s) = status.estop.age_s.filter(|_| status.cause == "estop") {
        let by = status.estop.by.as_deref().unwrap_or("an unknown client");
        lines.push(("e-stop", format!("{age_s:.0} s ago by {by}")));
    }
    if !status.queued.is_empty() {
        let waiting = status.queued.iter().map(|play| {
            let waits = if play.waits_for_edge { ", which waits for an edge" } else { "" };
            format!("{} of {}{waits}", play.id, play.name)
        });
        lines.push(("queued", waiting.collect::<Vec<_>>().join(", ")));
    }
    match &status.device {
        Some(device) if !device.telemetry => {
            lines.push(("telemetry", format!("{NO_TELEMETRY}; {SHORT_PLAYS}")));
        }
        Some(device) if device.simulated => lines.push(("telemetry", ON_NO_BOARD.to_owned())),
        _ => {}
    }
    if status.device.as_ref().is_some_and(|device| device.trigger_input) {
        lines.push(("input", "edges of the trigger input can start and stop plays".to_owned()));
    }
    lines.extend(offset(status).map(|offset| ("offset", offset)));
    lines.extend(drift(status).map(|drift| ("drift", drift)));
    lines.extend(sensor_faults(status).map(|faults| ("sensor faults", faults)));
    if !status.daemon.realtime.fifo {
        lines.push(("emergency stop", format!("{SLOW_ESTOP}; see `meissner doctor`")));
    }
    if status.daemon.logbook_problem.is_some() || status.daemon.logbook_lost > 0 {
        let lost = (status.daemon.logbook_lost > 0)
            .then(|| format!("{} entries are lost", status.daemon.logbook_lost));
        let told: Vec<_> = status.daemon.logbook_problem.iter().cloned().chain(lost).collect();
        lines.push(("session record", told.join("; ")));
    }
    if let Some(date) = &status.daemon.calibrated {
        let count = status.motors.iter().filter(|motor| motor.calibrated).count();
        lines.push(("calibrated", format!("{count} of {} motors, {date}", status.motors.len())));
    }
    if let Some(session) = &status.session {
        let closed = if session.is_closed_to_others() { ", exclusive" } else { "" };
        lines.push(("session", format!("{}{closed}", session_name(session))));
    }
    lines.extend(participant(&status.participant));
    if let Some(ClockSample { tick, uncertainty_us, .. }) = status.clock {
        lines.push(("clock", format!("synchronised to +-{uncertainty_us:.1} us, at tick {tick}")));
    }
    if let Some(bytes) = status.link.bytes_per_s {
        lines.push(("line", format!("{:.1} kB/s", f64::from(bytes) / 1000.0)));
    }
    if let Some(board) = &status.link.board {
        lines.push(("board", self::board(board)));
    }
    if status.link.contradictions > 0 {
        lines.push((
            "doubt",
            format!("{} messages of the device cannot be true; see the log", status.link.contradictions),
        ));
    }
    lines.push(("daemon", format!("{}, pid {}", status.daemon.socket, status.daemon.pid)));
    lines.push((
        "lead",
        format!("{} ms, host watchdog timeout {} ms", status.daemon.lead_ms, status.daemon.lease_ms),
    ));
    pairs(&lines)
}

/// A device's start and its counters.
pub(super) fn board(board: &BoardStatus) -> String {
    let up = match board.uptime_s {
        s if s < 600 => format!("{s} s"),
        s => format!("{} min", s / 60),
    };
    let mut parts = vec![format!("up for {up} since {}", board.reset)];
    parts.extend(counters(board.slack_ticks, &board.counters));
    if let Some(high) = board.high_at_boot.as_deref().filter(|high| !high.is_empty()) {
        parts.push(format!("outputs {high:?} were high at its start: run `meissner doctor --board`"));
    }
    parts.join(", ")
}

/// The device's slack, and the counters that it measures. A zero of one that every device has says nothing.
fn counters(
    slack_ticks: Option<u8>,
    counters: &BTreeMap<String, Option<u32>>,
) -> impl Iterator<Item = String> {
    let slack = slack_ticks.map(|ticks| format!("least time to render {ticks} ticks"));
    let measured = Counts::ALL.iter().filter_map(|Counter { name, label, optional }| {
        let count = (*counters.get(*name)?)?;
        (*optional || count > 0).then(|| format!("{count} {label}"))
    });
    slack.into_iter().chain(measured)
}

/// A participant's limits, and what is used.
fn participant(limits: &ParticipantStatus) -> [(&'static str, String); 2] {
    let ParticipantStatus { continuous_used_s, max_continuous_s, day_used_s, max_day_s, .. } = limits;
    let whose = limits.participant.as_ref().map_or_else(String::new, |name| format!("{name}: "));
    let session = limits.session_used_s.map_or_else(String::new, |used_s| {
        format!("{used_s:.1} of {} s in the session, ", limits.max_session_s)
    });
    let used = format!(
        "{whose}{continuous_used_s:.1} of {max_continuous_s} s without a pause of {} s, {session}{day_used_s:.1} of {max_day_s} s \
         today",
        limits.pause_s
    );
    [("vibration", used), ("amplitude", format!("at most {} um", limits.max_amplitude_um))]
}

/// A session's id and participant.
fn session_name(session: &Session) -> String {
    format!("{} with {}", session.id, session.participant)
}

/// A session in full.
pub(super) fn session(session: &Session) -> String {
    let Session { experiment, labels, seed, ended, reason, .. } = session;
    let mut lines = vec![("session", session.id.clone()), ("participant", session.participant.clone())];
    lines.extend(experiment.iter().map(|experiment| ("experiment", experiment.clone())));
    lines.extend(labels.iter().map(|(key, value)| ("label", format!("{key}={value}"))));
    lines.extend(seed.iter().map(|seed| ("seed", seed.to_string())));
    let by = session.owner.as_ref().map_or_else(String::new, |owner| format!(" by {owner}"));
    lines.push(("began", format!("{}{by}", session.started)));
    lines.push((
        "ended",
        match (ended, reason.as_deref()) {
            (Some(ended), reason) => format!("{ended} ({})", reason.unwrap_or("request")),
            (None, None) => "it runs".to_owned(),
            (None, Some(_)) => "not recorded: the daemon was killed, or could not write".to_owned(),
        },
    ));
    if session.exclusive {
        lines.push((
            "exclusive",
            match session.release_in_s {
                Some(left) => format!("yes; open to others if its owner is silent for {left:.0} s more"),
                None if session.released => "was open to others at last: its owner was silent".to_owned(),
                None => "yes".to_owned(),
            },
        ));
    }
    lines.push(("plays", format!("{}, {:.1} s of vibration", session.plays, session.vibration_s)));
    lines.extend(lost(session).map(|lost| ("lost", lost)));
    pairs(&lines)
}

/// The number of a session's entries that the record has lost, if any.
pub(super) fn lost(session: &Session) -> Option<String> {
    let Session { plays, lost, .. } = session;
    lost.any()
        .then(|| format!("{} of {plays} plays, {} entries of the session record", lost.plays, lost.entries))
}

/// A pattern from the daemon, for this array: its drives, what its rails draw, its warnings.
pub(super) fn pattern(shown: &Value, array: &str) -> String {
    let pattern = &shown["pattern"];
    let none = Vec::new();
    let drives = pattern["drive"].as_array().unwrap_or(&none);
    let mut text = pattern["name"].as_str().unwrap_or_default().to_owned();
    let duration_s = pattern["duration_s"].as_f64();
    // Writing to a string does not fail.
    let duration = duration_s.map_or_else(|| "endless".to_owned(), |seconds| format!("{seconds} s"));
    let whole = shown["compiled_ms"].as_f64();
    let whole = whole.map_or_else(String::new, |ms| format!(" ({ms:.1} ms in whole strokes)"));
    let _ = writeln!(text, ", {duration}{whole}, {} drives, for {array}", drives.len());
    let head =
        ["motor", "frequency_hz", "amplitude_um", "reached_um", "strokes", "phase", "start_s", "stop_s"];
    let row = |(at, drive): (usize, &Value)| {
        let reached = &shown["drives"][at];
        let cell = |key: &&str| match *key {
            "reached_um" => number(reached["reached_um"].as_f64(), 1),
            "strokes" if reached["strokes"].is_null() => "endless".to_owned(),
            "strokes" => reached["strokes"].to_string(),
            key => figure(&drive[key]),
        };
        head.iter().map(cell).collect::<Vec<_>>()
    };
    text.push_str(&columns(&head, drives.iter().enumerate().map(row)));
    let rails = shown["rails"].as_array().unwrap_or(&none);
    let load = |rail: &Value| {
        let cell = |key, digits| number(rail[key].as_f64(), digits);
        vec![
            rail["rail"].to_string(),
            rail["most_at_once"].to_string(),
            cell("mean_at_once", 2),
            cell("most_ma", 0),
            cell("mean_ma", 0),
        ]
    };
    if !rails.is_empty() {
        // docs/board.md explains the current that a supply can give.
        let head = ["rail", "motors at once, most", "mean", "mA at 3 nF, most", "mean"];
        let _ = write!(text, "\n\n{}", columns(&head, rails.iter().map(load)));
    }
    for warning in shown["warnings"].as_array().unwrap_or(&none) {
        let _ = write!(text, "\nwarning: {}", warning.as_str().unwrap_or_default());
    }
    text
}

fn figure(value: &Value) -> String {
    if value.is_null() { "-".to_owned() } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::MotorStatus;

    #[test]
    fn a_status_shows_the_offsets_of_each_source() {
        let document = meissner_api::openapi::document();
        let example = document["components"]["schemas"]["Status"]["examples"][0].clone();
        let mut status: Status = serde_json::from_value(example).unwrap();
        let motor = status.motors[0];
        let mut shown = |sources: &[(f32, ErrorSource)]| {
            status.motors = sources
                .iter()
                .map(|&(rest_error_um, source)| MotorStatus { rest_error_um, source, ..motor })
                .collect();
            let text = super::status(&status);
            text.lines().filter(|line| line.contains("um from rest")).map(str::to_owned).collect::<Vec<_>>()
        };
        let (seen, stop, reckoned) =
            (ErrorSource::Telemetry, ErrorSource::LowerStop, ErrorSource::DeadReckoning);
        assert_eq!(shown(&[(0.0, ErrorSource::None)]), [""; 0]);
        let lines = shown(&[(0.4, seen), (-15.38, seen), (2.0, stop), (30.2, reckoned)]);
        let [offset, drift] = &lines[..] else { panic!("{lines:?}") };
        assert!(offset.starts_with("offset "), "{offset}");
        let found = "  up to 15.4 um from rest (telemetry), 2 of 4 pins; up to 2.0 um from rest (lower-stop), 1 of 4 pins";
        assert!(offset.ends_with(found), "{offset}");
        assert!(drift.ends_with("  up to 30 um from rest (estimated), 1 of 4 pins; limit 150 um"), "{drift}");
    }
}
