//! Status, events and patterns as text; `receipt` has receipts.
//!
//! Every number is also in the JSON. Invariant: no line depends on the terminal; units are ASCII (`um`, `us`).

mod motions;
mod receipt;
mod segments;

pub(super) use motions::{measured, motions};
pub(super) use receipt::{LARGEST_OFFSET, accepted, burst_counts, duration, pulse_counts, receipt};

use crate::doctor::device::{NO_TELEMETRY, ON_NO_BOARD, SHORT_PLAYS};
use crate::doctor::rights::SLOW_ESTOP;
use crate::receipts::end_text;
use comfy_table::presets::{NOTHING, UTF8_FULL};
use comfy_table::{CellAlignment, Table};
use meissner_api::{
    ArmedStatus, ArrayDetails, ArrayGrid, BoardRecord, BoardStatus, EdgeEffect, EndCause, ErrorSource, Event,
    ItemState, NO_DEVICE, ParticipantStatus, Receipt, RenderingState, Session, Status,
};
use meissner_array::pattern::Drive;
use meissner_array::units::TickRate;
use segments::segments;
use serde_json::Value;
use std::fmt::Write;

/// Two columns: labels and values.
pub(super) fn pairs(pairs: &[(&str, String)]) -> String {
    let width = pairs.iter().map(|(name, _)| name.len()).max().unwrap_or_default();
    let lines = pairs.iter().map(|(name, value)| format!("{name:<width$}  {value}"));
    lines.collect::<Vec<_>>().join("\n")
}

/// A table without rules; the head may be empty.
#[must_use]
pub fn columns(head: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
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
#[must_use]
pub fn number(number: Option<f64>, digits: usize) -> String {
    number.map_or_else(|| "-".to_owned(), |number| format!("{number:.digits$}"))
}

/// State and cause, and pins that stand above rest.
pub(super) fn state(status: &Status) -> String {
    let Status { state, cause, lease_ms, .. } = status;
    let mut text = match cause.as_str() {
        _ if state == NO_DEVICE => "no device".to_owned(),
        cause if cause == EndCause::HostTimeout.text() => {
            format!("{state}: the PC was silent for more than {lease_ms} ms")
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
    let limit_um = status.drift_limit_um;
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
    let none = || match &status.no_device_reason {
        Some(missing) => format!("none: {missing}"),
        None => format!("none yet: the daemon looks for `{}`", status.requested_device),
    };
    let device = status.device.as_ref().map_or_else(none, |device| {
        format!("{}, firmware {} ({})", device.kind, device.firmware, device.build)
    });
    let play = status.play.as_ref().map_or_else(
        || "nothing".to_owned(),
        |play| format!("{} of {}, {:.1} s", play.id, play.pattern, play.played_s),
    );
    let mut lines = vec![
        ("state", state(status)),
        ("position", status.position.clone()),
        ("device", device),
        ("array", status.array.clone()),
        ("playing", play),
    ];
    if let Some(ArmedStatus { by, left_s, .. }) = &status.armed {
        let until = left_s.map_or("unattended, until `meissner disarm`".to_owned(), |left_s| {
            format!("disarms in {left_s:.0} s unless somebody arms, plays or homes, or a program that did so asks something")
        });
        lines.push(("armed by", format!("{by}; {until}")));
    }
    if !status.queued.is_empty() {
        let waiting = status.queued.iter().map(|play| {
            let waits = if play.waits_for_edge { ", which waits for an edge" } else { "" };
            format!("{} of {}{waits}", play.id, play.pattern)
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
    if !status.realtime.fifo {
        lines.push(("emergency stop", format!("{SLOW_ESTOP}; see `meissner doctor`")));
    }
    if status.logbook_problem.is_some() || status.logbook_lost > 0 {
        let lost = (status.logbook_lost > 0).then(|| format!("{} entries are lost", status.logbook_lost));
        let told: Vec<_> = status.logbook_problem.iter().cloned().chain(lost).collect();
        lines.push(("session record", told.join("; ")));
    }
    if let Some(date) = &status.calibrated {
        let count = status.motors.iter().filter(|motor| motor.calibrated).count();
        lines.push(("calibrated", format!("{count} of {} motors, {date}", status.motors.len())));
    }
    if let Some(session) = &status.session {
        let closed = if session.is_closed_to_others() { ", exclusive" } else { "" };
        lines.push(("session", format!("{}{closed}", session_name(session))));
    }
    lines.extend(participant(&status.participant));
    if let (Some(tick), Some(uncertainty_us)) = (status.tick, status.clock_uncertainty_us) {
        lines.push(("clock", format!("synchronised to +-{uncertainty_us:.1} us, at tick {tick}")));
    }
    if let Some(bytes) = status.line_bytes_per_s {
        lines.push(("line", format!("{:.1} kB/s", f64::from(bytes) / 1000.0)));
    }
    if let Some(board) = &status.board {
        lines.push(("board", self::board(board)));
    }
    if status.contradictions > 0 {
        lines.push((
            "doubt",
            format!("{} messages of the device cannot be true; see the log", status.contradictions),
        ));
    }
    lines.push(("daemon", format!("{}, pid {}", status.socket, status.pid)));
    lines.push(("lead", format!("{} ms, host watchdog timeout {} ms", status.lead_ms, status.lease_ms)));
    pairs(&lines)
}

/// A device's start and its counters.
pub(super) fn board(board: &BoardStatus) -> String {
    let up = match board.uptime_s {
        s if s < 600 => format!("{s} s"),
        s => format!("{} min", s / 60),
    };
    let BoardStatus { slack_ticks, stalls, usb_recoveries, output_faults, .. } = *board;
    let mut parts = vec![format!("up for {up} since {}", board.reset)];
    parts.extend(counters(BoardRecord { slack_ticks, stalls, usb_recoveries, output_faults }));
    if let Some(high) = board.high_at_boot.as_deref().filter(|high| !high.is_empty()) {
        parts.push(format!("outputs {high:?} were high at its start: run `meissner doctor --board`"));
    }
    parts.join(", ")
}

/// The device's counters: each figure that it measures, and output faults if there were any.
fn counters(board: BoardRecord) -> impl Iterator<Item = String> {
    let BoardRecord { slack_ticks, stalls, usb_recoveries, output_faults } = board;
    let parts = [
        slack_ticks.map(|ticks| format!("least time to render {ticks} ticks")),
        stalls.map(|count| format!("{count} stalls")),
        usb_recoveries.map(|count| format!("{count} USB recoveries")),
        (output_faults > 0).then(|| format!("{output_faults} output faults")),
    ];
    parts.into_iter().flatten()
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
    let Session { plays, plays_lost, lost, .. } = session;
    (*lost > 0 || *plays_lost > 0)
        .then(|| format!("{plays_lost} of {plays} plays, {lost} entries of the session record"))
}

/// An event on one line.
pub(super) fn event(event: &Event) -> String {
    match event {
        Event::State { state, cause, position, tick, play } => {
            let play = play
                .as_ref()
                .map_or_else(String::new, |play| format!(", play {} {:.1} s", play.id, play.played_s));
            format!("state: {state} ({cause}), position {position}, tick {tick}{play}")
        }
        Event::Connected { device } => format!("connected: {}, firmware {}", device.kind, device.firmware),
        Event::Disconnected { reason } => format!("disconnected: {reason}"),
        Event::Queued { id, pattern, .. } => format!("queued: {id} of {pattern}"),
        Event::Began { id, onset } => format!("began: {id} at tick {}", onset.actual_tick),
        Event::Late { id, stroke } => {
            format!("late: {id}, motor {}, by {:.1} ms, {:?}", stroke.motor, stroke.late_ms, stroke.cause)
        }
        Event::Refused { id, stroke } => format!("refused: {id}, motor {}, {}", stroke.motor, stroke.reason),
        Event::Edge { edge, play, effect } => {
            let play = play.map_or_else(String::new, |id| match effect {
                EdgeEffect::Start => format!(", starts play {id}"),
                EdgeEffect::Stop => format!(", stops play {id}"),
                EdgeEffect::Mark => format!(", during play {id}"),
            });
            format!("edge: {} at tick {}{play}", edge.number, edge.tick)
        }
        Event::Items { id, first, items, .. } => {
            let played = items.iter().filter(|item| item.state == ItemState::Played).count();
            format!("items: {id}, {first} to {}: {played} played", first + items.len().saturating_sub(1))
        }
        Event::Ended { receipt } => {
            let Receipt { id, state, cause, cut_after_ms, .. } = &**receipt;
            format!("ended: {id} {}", end_text(state.name(), cause.as_ref(), *cut_after_ms))
        }
        Event::Calibrated { id, motors, problem: None } => {
            format!("calibrated: {} motors by play {id}", motors.len())
        }
        Event::Calibrated { id, problem: Some(problem), .. } => format!("not calibrated: {id}, {problem}"),
        Event::SensorFault { motor, fault } => {
            format!("sensor fault: motor {motor}, {}; it plays in open loop until the next arm", fault.text())
        }
        Event::Contradiction { kind } => {
            format!("contradiction: the device sent a {kind} that cannot be true")
        }
        Event::Drifted { um } => {
            format!(
                "drifted: pins may be {um:.0} um off; `meissner home` between plays, or level them by hand"
            )
        }
        Event::Rendering { id, state, object, found, seconds, problem } => {
            let problem = problem.as_ref().map_or_else(String::new, |problem| format!(": {problem}"));
            let state = match (state, found) {
                (RenderingState::Running, true) => "found".into(),
                _ => serde_json::to_value(state).unwrap_or_default(),
            };
            let state = state.as_str().unwrap_or_default();
            format!("rendering: {id} of {object}, {state} after {seconds:.1} s{problem}")
        }
        Event::SessionStarted { session } => format!("session: {} began", session_name(session)),
        Event::SessionReleased { session } => {
            format!("session: {session} is open to others, its owner was silent")
        }
        Event::Intervened { command, by, session } => {
            format!("intervened: {command} by {by}, who does not own session {session}")
        }
        Event::OwnerSilent { by, silence_s } => {
            format!(
                "owner silent: nothing was heard for {silence_s} s since {by} armed; the motors are disarmed"
            )
        }
        Event::RecordProblem { problem, lost } => {
            let problem = problem.as_ref().map_or_else(String::new, |problem| format!("{problem}; "));
            format!("session record: {problem}{lost} entries are lost")
        }
        Event::SessionEnded { session } => format!("session: {} ended", session_name(session)),
        Event::Lost { events } => format!("lost: {events} events of the streamer"),
        Event::Lagged { events } => format!("lagged: this client missed {events} events"),
    }
}

/// The most maps of a pattern; the list of drives has the rest.
const MAPS: usize = 4;

/// A pattern from the daemon: the array seen from above, fingertip up, if it has rows and columns; then the drives.
pub(super) fn pattern(shown: &Value, array: &ArrayDetails) -> String {
    let (grid, rate) = (array.grid, TickRate::new(array.tick_hz));
    let pattern = &shown["pattern"];
    let none = Vec::new();
    let drives = pattern["drive"].as_array().unwrap_or(&none);
    let mut text = pattern["name"].as_str().unwrap_or_default().to_owned();
    let duration_s = pattern["duration_s"].as_f64();
    // Writing to a string does not fail.
    let duration = duration_s.map_or_else(|| "endless".to_owned(), |seconds| format!("{seconds} s"));
    let whole = shown["compiled_ms"].as_f64();
    let whole = whole.map_or_else(String::new, |ms| format!(" ({ms:.1} ms in whole strokes)"));
    let _ = writeln!(text, ", {duration}{whole}, {} drives, for {}", drives.len(), array.name);
    // The maps show what moves: each drive with the amplitude that it reaches, none without a stroke.
    let moving: Vec<Drive> =
        drives.iter().zip(0..).filter_map(|(file, at)| drive(file, &shown["drives"][at])).collect();
    let segments = segments(rate, &moving, duration_s);
    for segment in segments.iter().take(MAPS) {
        let Some(grid) = grid else { break };
        let when = match (segments.len(), segment.stop_s) {
            (1, _) => String::new(),
            (_, Some(stop_s)) => format!(", {} to {stop_s} s", segment.start_s),
            (_, None) => format!(", from {} s on", segment.start_s),
        };
        let _ = writeln!(text, "fingertip{when}\n{}", map(&segment.drives, grid));
    }
    if let more @ 1.. = segments.len().saturating_sub(MAPS)
        && grid.is_some()
    {
        let _ = writeln!(text, "and {more} more segments, see below");
    }
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

/// The array with each motor's frequency and reached amplitude in its cell; `.` does not move.
fn map(drives: &[Drive], grid: ArrayGrid) -> String {
    let cell = |motor: u8| match drives.iter().find(|drive| drive.motor == motor) {
        Some(drive) => format!("{motor}\n{:?} Hz\n{:.1} um", drive.frequency_hz, drive.amplitude_um),
        None => format!("{motor}\n.\n"),
    };
    let mut table = Table::new();
    table.load_style(UTF8_FULL);
    let ArrayGrid { rows, columns, .. } = grid;
    for row in 0..rows {
        table.add_row((0..columns).map(|column| cell(columns * row + column)));
    }
    for column in table.column_iter_mut() {
        column.set_cell_alignment(CellAlignment::Center);
    }
    table.to_string()
}

/// Reads a drive from the daemon's JSON, with the amplitude that it reaches; none if it gives no stroke.
fn drive(shown: &Value, reached: &Value) -> Option<Drive> {
    if reached["strokes"] == 0 {
        return None;
    }
    let reached_um = reached["reached_um"].as_f64();
    Some(Drive {
        motor: shown["motor"].as_u64()?.try_into().ok()?,
        frequency_hz: shown["frequency_hz"].as_f64()?,
        amplitude_um: reached_um.or(shown["amplitude_um"].as_f64())?,
        phase: shown["phase"].as_f64()?,
        start_s: shown["start_s"].as_f64(),
        stop_s: shown["stop_s"].as_f64(),
    })
}

fn figure(value: &Value) -> String {
    if value.is_null() { "-".to_owned() } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::MotorStatus;
    use serde_json::json;

    fn shown(drives: &Value) -> String {
        pattern(
            &json!({"pattern": {"name": "a", "duration_s": 5.0, "drive": drives}, "warnings": ["w"]}),
            &crate::array::details(meissner_array::spec::Array::paper()),
        )
    }

    #[test]
    fn a_pattern_shows_every_motor_and_every_drive() {
        let drive =
            |motor: u8| json!({"motor": motor, "frequency_hz": 60.0, "amplitude_um": 80.0, "phase": 0.25});
        let text = shown(&json!([drive(9), drive(10)]));
        for part in ["a, 5", " s, 2 drives, for tula35-6x4\nfingertip\n", "0.25", "warning: w"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let count = |what: &str| text.matches(what).count();
        assert_eq!((count("60.0 Hz"), count("80.0 um"), count(" . ")), (2, 2, 22), "{text}");
        let at = |what: &str| text.find(what).unwrap();
        assert!(at(" 0 ") < at(" 23 ") && at(" 23 ") < at("0.25"), "the map, then the drives: {text}");
    }

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

    #[test]
    fn a_pattern_of_many_segments_shows_the_first_ones_and_says_so() {
        let drive = |n: u8| {
            let start_s = f64::from(n) / 2.0;
            json!({"motor": n, "frequency_hz": 60.0, "amplitude_um": 80.0, "phase": 0.0, "start_s": start_s,
                   "stop_s": start_s + 0.5})
        };
        let text = shown(&(0..6).map(drive).collect());
        assert!(text.contains("fingertip, 0 to 0.5 s") && text.contains("fingertip, 1.5 to 2 s"), "{text}");
        assert_eq!(text.matches("fingertip").count(), 4);
        // Six drives, and nothing after them.
        assert!(text.contains("and 3 more segments, see below"), "{text}");
    }
}
