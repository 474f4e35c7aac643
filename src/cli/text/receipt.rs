//! Receipts as text: the order, what was played of it, and how accurately.
//!
//! Invariant: every number is one of the receipt's JSON, rounded.

use super::{counters, pairs};
use crate::receipts::end_text;
use meissner_api::{
    BoardRecord, BurstCounts, DurationRecord, ErrorSource, ItemState, LiveRecord, MotorRestError,
    OrderedCounts, PlayAccepted, PulseCounts, ReachedDrive, Receipt, UpdateTimes,
};

pub(in crate::cli) fn receipt(receipt: &Receipt) -> String {
    pairs(&receipt_lines(receipt))
}

/// Labels and values.
pub(in crate::cli) fn receipt_lines(receipt: &Receipt) -> Vec<(&'static str, String)> {
    let mut lines = vec![
        ("play", format!("{} of {}", receipt.id, receipt.name)),
        ("state", end_text(receipt.state.name(), receipt.cause.as_ref(), receipt.duration_ms.cut_after)),
    ];
    if let Some(onset) = &receipt.onset {
        let text = format!("tick {}, {:.2} ms after the request", onset.actual_tick, onset.latency_ms);
        lines.push(("onset", text));
    }
    for (edge, does) in [(&receipt.edges.start, "started"), (&receipt.edges.stop, "stopped")] {
        lines.extend(edge.map(|edge| ("edge", format!("{} at tick {} {does} it", edge.number, edge.tick))));
    }
    if let Some(offset) = &receipt.offset {
        lines.push(("offset", format!("tick {}", offset.tick)));
    }
    if receipt.duration_ms != DurationRecord::default() {
        lines.push(("duration", duration(&receipt.duration_ms)));
    }
    if !receipt.reach.drives.is_empty() {
        lines.push(("amplitude", amplitudes(&receipt.reach.drives)));
    }
    if let Some(bursts) = &receipt.counts.bursts {
        lines.push(("bursts", burst_counts(receipt.counts.ordered.as_ref(), bursts)));
    }
    if let Some(pulses) = &receipt.counts.pulses {
        lines.push(("pulses", pulse_counts(receipt.counts.ordered.as_ref(), pulses)));
    }
    if receipt.counts.estimated {
        lines.push((
            "estimated",
            "what was played, because the link was lost before the device said it".to_owned(),
        ));
    }
    let late = &receipt.counts.lateness.counts;
    if late.host + late.link + late.device > 0 {
        let text = format!(
            "{} by the host, {} by the link, {} by the device; by {:.1} ms at most",
            late.host, late.link, late.device, late.worst_ms
        );
        lines.push(("late strokes", text));
    }
    if let Some(live) = &receipt.live {
        lines.push(("updates", updates(live)));
    }
    let items = receipt.items.as_deref().unwrap_or_default();
    if items.len() > 1 {
        let count = |state| items.iter().filter(|item| item.state == state).count();
        let [played, incomplete, cut, not_begun] =
            [ItemState::Played, ItemState::Incomplete, ItemState::Cut, ItemState::NotBegun].map(count);
        let text = format!(
            "{}: {played} played, {incomplete} incomplete, {cut} cut, {not_begun} not begun; --json lists each",
            items.len()
        );
        lines.push(("items", text));
    }
    if let Some(trigger) = items.first().and_then(|item| item.trigger) {
        let code = trigger.code.map_or_else(|| "pulse".to_owned(), |code| format!("code {code}"));
        lines.push(("trigger", format!("{code} of {:.2} ms at tick {}", trigger.width_ms, trigger.tick)));
    }
    if let Some(wire) = &receipt.device.wire {
        let per_burst =
            wire.bytes_per_burst.map_or_else(String::new, |bytes| format!(", {bytes:.2} per burst"));
        lines.push(("wire", format!("{} bytes to the device{per_burst}", wire.bytes_to_device)));
    }
    if let Some(board) = receipt.device.board.as_ref().and_then(board) {
        lines.push(("board", board));
    }
    if let Some(pins) = &receipt.pins {
        lines.extend(rest_error(&pins.rest_errors).map(|text| ("rest error", text)));
    }
    lines.extend(receipt.reach.warnings.iter().map(|warning| ("warning", warning.clone())));
    lines
}

/// The device's counters during the play, if it measures any or something failed.
fn board(board: &BoardRecord) -> Option<String> {
    let text = counters(board.slack_ticks, &board.counters).collect::<Vec<_>>().join(", ");
    (!text.is_empty()).then_some(text)
}

/// The results of a live play's updates.
fn updates(live: &LiveRecord) -> String {
    let LiveRecord { updates, applied, merged, repeats, decided, first_motor, .. } = live;
    let times = |times: &Option<UpdateTimes>, what: &str| {
        times.map_or_else(String::new, |UpdateTimes { p50_ms, p99_ms, .. }| {
            format!("; {what} p50 {p50_ms:.1} ms, p99 {p99_ms:.1} ms")
        })
    };
    format!(
        "{updates}: {applied} applied, {merged} merged, {repeats} sent again{}{}",
        times(decided, "decided"),
        times(first_motor, "first new stroke")
    )
}

/// The largest rest errors of driven pins, at onset and end, and where each comes from.
fn rest_error(errors: &[MotorRestError]) -> Option<String> {
    let worst = |of: &dyn Fn(&MotorRestError) -> Option<(f32, ErrorSource)>| {
        errors.iter().filter_map(of).max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
    };
    let text = |(um, source): (f32, ErrorSource)| format!("{um:.2} um ({})", source.name());
    let onset = worst(&|error| error.onset_um.zip(error.onset_source));
    let end = worst(&|error| Some((error.offset_um, error.offset_source)))?;
    let onset = onset.map_or_else(String::new, |onset| format!("{} at the onset, ", text(onset)));
    Some(format!("{LARGEST_OFFSET} {onset}{} at the end", text(end)))
}

/// A duration as ordered, in whole strokes, and as played.
fn duration(duration: &DurationRecord) -> String {
    let ms = |ms: Option<f64>| ms.map_or_else(|| "endless".to_owned(), |ms| format!("{ms:.1} ms"));
    let DurationRecord { ordered, compiled, played, .. } = duration;
    let played = played.map_or_else(String::new, |played| format!(", {played:.1} ms played"));
    format!("{} ordered, {} in whole strokes{played}", ms(*ordered), ms(*compiled))
}

/// The amplitudes of drives; equal ones are grouped.
fn amplitudes(drives: &[ReachedDrive]) -> String {
    let mut kinds: Vec<(String, usize)> = Vec::new();
    for ReachedDrive { ordered_um, reached_um, surplus_um, .. } in drives {
        let surplus = if *surplus_um > 0.0 { format!(", surplus {surplus_um:.1} um") } else { String::new() };
        let kind = format!("{reached_um:.1} of {ordered_um:.1} um reached{surplus}");
        match kinds.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, count)) => *count += 1,
            None => kinds.push((kind, 1)),
        }
    }
    let shown = kinds.iter().take(KINDS).map(|(kind, count)| match count {
        1 => kind.clone(),
        count => format!("{kind} by {count} drives"),
    });
    let more = kinds.len().saturating_sub(KINDS);
    let more = (more > 0).then(|| format!("and {more} more, see --json"));
    shown.chain(more).collect::<Vec<_>>().join("; ")
}

/// The most groups of amplitudes that are shown.
const KINDS: usize = 4;

pub(in crate::cli) const LARGEST_OFFSET: &str = "largest offset from rest, driven pins:";

fn burst_counts(ordered: Option<&OrderedCounts>, bursts: &BurstCounts) -> String {
    let BurstCounts { planned, played, late, dropped, refused, replaced, amended, shortened } = bursts;
    let replaced = if *replaced > 0 { format!(", {replaced} replaced") } else { String::new() };
    let shortened =
        if *shortened > 0 { format!(", {shortened} cut short by the next move") } else { String::new() };
    let ordered = ordered.map_or_else(String::new, |ordered| format!("{} ordered, ", ordered.bursts));
    format!(
        "{ordered}{planned} planned: {played} played, {late} late, {dropped} dropped, {refused} refused{replaced}; {amended} \
         corrected by feedback{shortened}"
    )
}

fn pulse_counts(ordered: Option<&OrderedCounts>, pulses: &PulseCounts) -> String {
    let ordered = ordered.map_or_else(String::new, |ordered| format!("{} ordered, ", ordered.pulses));
    format!("{ordered}{} planned, {} played", pulses.planned, pulses.played)
}

/// A play that was queued, with its duration in whole strokes.
pub(in crate::cli) fn accepted(accepted: &PlayAccepted, pattern: &str) -> String {
    let PlayAccepted { id, ordered_ms, compiled_ms, .. } = accepted;
    let duration =
        DurationRecord { ordered: *ordered_ms, compiled: *compiled_ms, ..DurationRecord::default() };
    // An endless play has none.
    let told = ordered_ms.map_or_else(String::new, |_| format!(", {}", self::duration(&duration)));
    format!("play {id}: {pattern}{told}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::Terms;

    #[test]
    fn a_receipt_that_has_not_begun_shows_no_figures() {
        let text = receipt(&Receipt { id: 3, ..Receipt::new("edge-45", "", 1, &Terms::default()) });
        assert_eq!(text, "play   3 of edge-45\nstate  queued");
    }

    #[test]
    fn amplitudes_of_many_kinds_are_cut() {
        let drive = |drive: u8| ReachedDrive {
            drive: drive.into(),
            motor: drive,
            ordered_um: 10.0 * f64::from(drive),
            reached_um: 9.5 * f64::from(drive),
            surplus_um: 0.0,
            strokes: None,
        };
        let text = amplitudes(&(1..=6).map(drive).collect::<Vec<_>>());
        assert!(text.starts_with("9.5 of 10.0 um reached; 19.0 of 20.0 um reached; "), "{text}");
        assert!(text.ends_with("38.0 of 40.0 um reached; and 2 more, see --json"), "{text}");
    }
}
