//! The plan of a replay: the orders for each recorded play, and their times. It is pure: it only reads rows.
//!
//! [`Planner::plan`] takes the plays in order and returns a [`Step`] for each, or the reason why it cannot be played again. Times
//! are ticks from the onset of the first play; within one boot of the device they are exact.
//!
//! Invariant: a step orders the recorded play, at the recorded distance from the step before.

use crate::receipts::BLANK;
use meissner_api::{
    Fit, Mapping, PlayRequest, RecordedPlay, SequenceItem, SequenceRequest, TriggerRequest, TriggerShape,
};
use meissner_array::units::{TickRate, ns_to_ms};

/// Items in one order: with the SHA-256 of each they fit into a request.
const MAX_ITEMS: usize = 2000;

/// A recorded play, and its items if it was a sequence.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Recorded {
    pub(super) play: RecordedPlay,
    pub(super) items: Vec<RecordedPlay>,
}

/// A request without its onset.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Order {
    Play(Box<PlayRequest>),
    Sequence(Box<SequenceRequest>),
}

/// A play to repeat.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub(super) recorded: Recorded,
    /// Its onset, ticks from that of the first step.
    pub(super) start: u64,
    /// Whether the start is known to the tick; otherwise it follows the host's clock.
    pub(super) is_exact: bool,
    /// The orders with their onsets, ticks from this step's: one, or several for a long sequence.
    pub(super) orders: Vec<(u64, Order)>,
    /// Whether the recorded play came to its end. Otherwise the replay lasts as long as the recorded play did, and its counts are
    /// not compared.
    pub(super) is_whole: bool,
    /// A known difference from the recorded play, in words.
    pub(super) note: Option<String>,
}

/// Why a play cannot be played again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Skip {
    #[error("its end is missing from the record")]
    NoEnd,
    #[error("it never began")]
    NeverBegan,
    #[error(
        "its items are not recorded: an older daemon recorded it, the record lost them, or it was cut in its first item"
    )]
    NoItems,
    #[error("the record does not tell how long it lasted")]
    NoDuration,
    #[error(
        "the text of `{pattern}` (sha256 {sha256}) is not kept: an older daemon recorded the play, and the stored pattern is another \
         one or gone; import the pattern as it was, or leave the play out with --from and --to"
    )]
    NoText { pattern: String, sha256: String },
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Planner {
    /// The step before: its start, and its onset by boot, tick and the host's clock, ns.
    last: Option<(u64, Option<u32>, u64, Option<u64>)>,
}

impl Planner {
    /// The step for the next play of the session.
    pub(super) fn plan(&mut self, recorded: Recorded) -> Result<Step, Skip> {
        let play = &recorded.play;
        if play.state == "unknown" {
            return Err(Skip::NoEnd);
        }
        let onset = play.onset_tick.ok_or(Skip::NeverBegan)?;
        let is_whole = play.state == "done";
        let mut notes = Vec::new();
        let is_sequence = play.items_planned.is_some() || play.items > 0 || play.pattern_sha256.is_none();
        let orders = if play.scale.is_none() && is_sequence {
            sequence(&recorded, &mut notes)?
        } else {
            vec![(0, Order::Play(Box::new(single(play, is_whole, &mut notes)?)))]
        };
        let boots = self.last.map(|(_, boot, ..)| boot.zip(play.boot));
        let (start, is_exact) = match self.last {
            None => (0, true),
            Some((start, boot, tick, _)) if boot == play.boot && tick <= onset => {
                (start + onset - tick, true)
            }
            Some((start, _, _, ns)) => {
                let ns = ns.zip(play.onset_monotonic_ns).map_or(0, |(last, now)| now.saturating_sub(last));
                (start + whole(rate(play).ms_in_ticks(ns_to_ms(ns))), false)
            }
        };
        if !is_exact {
            let why = match boots.flatten() {
                Some((before, now)) if before != now => "the device has restarted before it",
                Some(_) => "its tick is before that of the play before it",
                None => "the record does not tell whether the device has restarted before it",
            };
            notes.push(format!("{why}: the gap is by the host's clock"));
        }
        self.last = Some((start, play.boot, onset, play.onset_monotonic_ns));
        let note = (!notes.is_empty()).then(|| notes.join("; "));
        Ok(Step { recorded, start, is_exact, orders, is_whole, note })
    }
}

/// The tick rate of a recorded play.
pub(super) const fn rate(play: &RecordedPlay) -> TickRate {
    TickRate::new(play.tick_hz)
}

/// How a recorded play's pattern came to its array.
fn map(play: &RecordedPlay) -> Option<Mapping> {
    play.mapped_from.as_ref().map(|_| Mapping::Nearest)
}

/// A whole number of ticks.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to the length of a session")]
fn whole(ticks: f64) -> u64 {
    ticks.round() as u64
}

/// The trigger that was given.
fn trigger(play: &RecordedPlay) -> Option<TriggerRequest> {
    Some(play.trigger.map_or(TriggerRequest::Off, |trigger| {
        TriggerRequest::On(TriggerShape { width_ms: Some(trigger.width_ms), code: trigger.code })
    }))
}

/// The SHA-256 of a play's text, if the daemon has that.
fn text(play: &RecordedPlay) -> Result<Option<String>, Skip> {
    let sha256 = play.pattern_sha256.clone();
    if play.pattern_kept {
        return Ok(sha256);
    }
    Err(Skip::NoText { pattern: play.pattern.clone(), sha256: sha256.unwrap_or_default() })
}

fn single(play: &RecordedPlay, is_whole: bool, notes: &mut Vec<String>) -> Result<PlayRequest, Skip> {
    let seconds = if is_whole {
        play.seconds
    } else {
        let ms = play.cut_after_ms.or(play.played_ms).ok_or(Skip::NoDuration)?;
        notes.push(format!("it was cut after {ms:.1} ms: it lasts as long, and its counts are not compared"));
        Some(ms / 1e3)
    };
    Ok(PlayRequest {
        pattern: play.pattern.as_str().into(),
        pattern_sha256: text(play)?,
        seconds,
        scale: play.scale,
        // `Fit::Cover` would add the rest of the strokes that the cut ended.
        fit: if is_whole { play.fit } else { Fit::Whole },
        late: play.late_policy,
        open_loop: play.open_loop,
        trial: play.trial,
        labels: play.labels.clone(),
        trigger: trigger(play),
        map: map(play),
        ..PlayRequest::default()
    })
}

/// The orders of a sequence: the items that were played to their ends.
fn sequence(recorded: &Recorded, notes: &mut Vec<String>) -> Result<Vec<(u64, Order)>, Skip> {
    let Recorded { play, items } = recorded;
    let ended: Vec<&RecordedPlay> = items.iter().filter(|item| has_ended(item)).collect();
    // Some items of a cut sequence may not have begun.
    let known = if play.state == "done" {
        play.items_planned
    } else {
        items.last().and_then(|last| last.item).map(|last| last + 1)
    };
    if let lost @ 1.. = known.unwrap_or(0).saturating_sub(items.len() as u64) {
        notes.push(format!("{lost} of its items are lost from the record: they are left out"));
    }
    if let left_out @ 1.. = items.len() - ended.len() {
        notes.push(format!("{left_out} items that were cut are left out"));
    }
    let order = |items: &[&RecordedPlay]| {
        // The first part keeps the sequence's onset.
        let first = items.first().and_then(|item| item.item).unwrap_or(0);
        let start =
            if first == 0 { 0 } else { items.first().and_then(|item| item.planned_onset_ticks).unwrap_or(0) };
        let items = items.iter().map(|item| {
            let onset = item.planned_onset_ticks.unwrap_or(0).saturating_sub(start);
            let is_blank = item.pattern == BLANK && item.pattern_sha256.as_deref() == Some("");
            Ok(SequenceItem {
                pattern: (!is_blank).then(|| item.pattern.as_str().into()),
                pattern_sha256: if is_blank { None } else { text(item)? },
                seconds: item.seconds,
                scale: item.scale.filter(|_| !is_blank),
                gap_ms: None,
                start_ms: Some(rate(play).ticks_to_ms(onset)),
                trigger: trigger(item),
            })
        });
        let request = SequenceRequest {
            items: items.collect::<Result<_, Skip>>()?,
            name: Some(play.pattern.clone()),
            map: map(play),
            late: play.late_policy,
            open_loop: play.open_loop,
            trial: play.trial,
            labels: play.labels.clone(),
            ..SequenceRequest::default()
        };
        Ok((start, Order::Sequence(Box::new(request))))
    };
    let orders: Vec<_> = ended.chunks(MAX_ITEMS).map(order).collect::<Result<_, Skip>>()?;
    if orders.is_empty() { Err(Skip::NoItems) } else { Ok(orders) }
}

/// Whether an item was played to its end.
pub(super) fn has_ended(item: &RecordedPlay) -> bool {
    matches!(item.state.as_str(), "played" | "incomplete")
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use meissner_api::TriggerRecord;
    use meissner_array::pattern::Pattern;
    use meissner_array::spec::Array;
    use meissner_array::strokes::{Sequence, Start, StrokeOptions};

    const RATE: TickRate = TickRate::new(85_000);

    pub(in crate::cli::replay) fn play(play: u64, onset: u64) -> Recorded {
        let play = RecordedPlay {
            play,
            pattern: "pin-60".to_owned(),
            pattern_sha256: Some("0".repeat(64)),
            pattern_kept: true,
            tick_hz: 85_000,
            seconds: Some(0.5),
            scale: Some(0.5),
            state: "done".to_owned(),
            onset_tick: Some(onset),
            onset_monotonic_ns: Some(onset * 1_000_000 / 85),
            trigger: Some(TriggerRecord { tick: onset, width_ms: 4.0, code: Some(7) }),
            boot: Some(1),
            ..RecordedPlay::default()
        };
        Recorded { play, items: Vec::new() }
    }

    pub(in crate::cli::replay) fn with_items(play: u64, onset: u64, items: u64, step: u64) -> Recorded {
        let mut recorded = self::play(play, onset);
        (recorded.play.scale, recorded.play.items) = (None, items);
        let item = |number| RecordedPlay {
            item: Some(number),
            items: 0,
            state: "played".to_owned(),
            planned_onset_ticks: Some(number * step),
            onset_tick: Some(onset + number * step),
            trigger: Some(TriggerRecord { tick: onset + number * step, width_ms: 4.0, code: Some(7) }),
            scale: Some(1.0),
            seconds: Some(0.02),
            ..recorded.play.clone()
        };
        let items = (0..items).map(item).collect();
        Recorded { items, ..recorded }
    }

    #[test]
    fn a_play_is_ordered_as_it_was_at_its_distance() {
        let mut planner = Planner::default();
        let first = planner.plan(play(3, 1 << 40)).unwrap();
        let (start, Order::Play(request)) = &first.orders[0] else { panic!("{first:?}") };
        assert_eq!((first.start, *start, request.seconds, request.scale), (0, 0, Some(0.5), Some(0.5)));
        let shape = TriggerShape { width_ms: Some(4.0), code: Some(7) };
        assert_eq!(request.trigger, Some(TriggerRequest::On(shape)));
        assert_eq!(request.pattern_sha256, Some("0".repeat(64)));
        // Ten minutes and a tick.
        let later = (1 << 40) + 600 * 85_000 + 1;
        let second = planner.plan(play(4, later)).unwrap();
        assert_eq!((second.start, second.note), (600 * 85_000 + 1, None));
        // A play that never began does not change the distances.
        let mut never = play(5, 0);
        never.play.onset_tick = None;
        assert_eq!(planner.plan(never).unwrap_err(), Skip::NeverBegan);
        assert_eq!(planner.plan(play(6, later + 7)).unwrap().start, 600 * 85_000 + 8);
        // Ticks of different boots cannot be compared.
        let mut restarted = play(7, 5);
        (restarted.play.boot, restarted.play.onset_monotonic_ns) =
            (Some(2), Some((later + 7) * 1_000_000 / 85 + 1_000_000_000));
        let restarted = planner.plan(restarted).unwrap();
        assert_eq!((restarted.start, restarted.is_exact), (600 * 85_000 + 8 + 85_000, false));
        let note = restarted.note.unwrap();
        assert!(note.contains("has restarted") && note.contains("by the host's clock"), "{note}");
        // An older daemon did not record the boot with each play, so the device may have restarted.
        let mut unknown = play(8, 6);
        (unknown.play.boot, unknown.play.onset_monotonic_ns) = (None, None);
        let unknown = planner.plan(unknown).unwrap();
        assert!(!unknown.is_exact && unknown.note.unwrap().contains("does not tell whether"));
    }

    #[test]
    fn a_play_that_was_cut_lasts_as_long_and_an_old_record_is_told() {
        let mut cut = play(3, 100);
        (cut.play.state, cut.play.cut_after_ms, cut.play.seconds) = ("stopped".to_owned(), Some(123.4), None);
        cut.play.fit = Fit::Cover;
        let step = Planner::default().plan(cut).unwrap();
        let (_, Order::Play(request)) = &step.orders[0] else { panic!("{step:?}") };
        assert!(!step.is_whole && (request.seconds.unwrap() - 0.1234).abs() < 1e-12);
        assert_eq!(request.fit, Fit::Whole, "no stroke of it may begin that the cut ended");
        let mut old = play(4, 100);
        old.play.pattern_kept = false;
        let told = Planner::default().plan(old).unwrap_err().to_string();
        assert!(told.contains("the text of `pin-60` (sha256 000") && told.contains("import"), "{told}");
        let mut lost = play(5, 100);
        lost.play.state = "unknown".to_owned();
        assert_eq!(Planner::default().plan(lost).unwrap_err(), Skip::NoEnd);
    }

    /// The code that compiles sequences gives the items their recorded ticks again, even if the orders come in several parts.
    #[test]
    fn items_get_their_ticks_back() {
        let drive = meissner_array::pattern::Drive {
            motor: 5,
            frequency_hz: 100.0,
            amplitude_um: 20.0,
            phase: 0.0,
            start_s: None,
            stop_s: None,
        };
        let pattern = Pattern::new(Array::paper(), "pin-60", None, vec![drive], toml::Table::new()).unwrap();
        for (items, step) in [(40, 2_551), (4_096, 2_833)] {
            let mut recorded = with_items(3, 1 << 40, items, step);
            for item in &mut recorded.items {
                item.seconds = Some(RATE.ticks_to_ms(1_701) / 1e3);
            }
            let planned = Planner::default().plan(recorded).unwrap();
            assert_eq!(planned.orders.len() as u64, items.div_ceil(MAX_ITEMS as u64));
            let mut spans = Vec::new();
            for (start, order) in &planned.orders {
                let Order::Sequence(request) = order else { panic!("{order:?}") };
                assert!(serde_json::to_vec(request).unwrap().len() < meissner_api::MAX_BODY * 9 / 10);
                let mut sequence = Sequence::new(Array::paper());
                let run = sequence.compile(&pattern, &StrokeOptions::default()).unwrap();
                for item in &request.items {
                    sequence.add(run, item.seconds, Start::At(item.start_ms.unwrap())).unwrap();
                }
                spans.extend(sequence.spans().map(|(from, to)| (start + from, start + to)));
            }
            let wanted: Vec<_> = (0..items).map(|n| (n * step, n * step + 1_701)).collect();
            assert_eq!(spans, wanted);
        }
        // Items whose lines are lost leave a gap.
        let mut holed = with_items(3, 100, 5, 3_000);
        holed.play.items_planned = Some(5);
        holed.items.drain(0..2);
        let planned = Planner::default().plan(holed.clone()).unwrap();
        assert!(planned.note.unwrap().contains("2 of its items are lost"));
        let (start, Order::Sequence(request)) = &planned.orders[0] else { panic!() };
        assert_eq!(
            (*start, request.items.len(), request.items[1].start_ms),
            (6_000, 3, Some(RATE.ticks_to_ms(3_000)))
        );
        (holed.play.items, holed.play.state) = (0, "stopped".to_owned());
        holed.items.clear();
        assert_eq!(Planner::default().plan(holed).unwrap_err(), Skip::NoItems);
        // The cut item is left out; without any item there is nothing to play.
        let mut cut = with_items(3, 100, 3, 3_000);
        cut.play.state = "stopped".to_owned();
        cut.items[2].state = "cut".to_owned();
        let planned = Planner::default().plan(cut.clone()).unwrap();
        assert!(planned.note.unwrap().contains("1 items that were cut"));
        cut.items.truncate(0);
        assert_eq!(Planner::default().plan(cut).unwrap_err(), Skip::NoItems);
    }
}
