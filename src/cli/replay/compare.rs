//! Compares a recorded play with the receipts of its replay. Pure.
//!
//! [`compare`] names each [`Difference`]; [`Summary`] counts them over a session.
//!
//! Bound: [`MAX_LISTED`] plays are listed, all are counted.

use super::plan::{Step, has_ended};
use crate::receipts::largest_um;
use meissner_api::{ItemRecord, ItemState, Receipt, TriggerRecord};
use serde::Serialize;

/// Plays in a list of the summary, at most.
pub(super) const MAX_LISTED: usize = 1000;
/// Amplitudes that differ by less are the same: a pulse moves a pin by 0.14 µm.
const SAME_UM: f64 = 0.2;

/// A difference from the record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Difference {
    pub(super) what: &'static str,
    pub(super) recorded: String,
    pub(super) replayed: String,
}

/// A play that differs.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Differing {
    /// The recorded play.
    pub(super) play: u64,
    pub(super) pattern: String,
    /// Its replay.
    pub(super) replayed_as: Vec<u64>,
    pub(super) differences: Vec<Difference>,
}

/// A play that was not played again.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Skipped {
    pub(super) play: u64,
    pub(super) why: String,
}

/// The result of a replay.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Summary {
    pub(super) session: String,
    /// Plays that were to be replayed.
    pub(super) plays: u64,
    pub(super) replayed: u64,
    /// Plays that were not played again.
    pub(super) skipped: u64,
    /// The number of skipped plays that had not begun in the record either.
    pub(super) never_began: u64,
    pub(super) differing: u64,
    /// The largest difference of a gap between two onsets, ticks.
    pub(super) gap_error_max_ticks: u64,
    /// Gaps that the record does not give to the tick; they follow the host's clock.
    pub(super) gaps_by_host_clock: u64,
    /// The largest rest error of a play, µm.
    pub(super) rest_error_recorded_max_um: f32,
    pub(super) rest_error_replayed_max_um: f32,
    /// Why the replay ended early.
    pub(super) ended_early: Option<String>,
    /// The parts of the session that the record lacks, which may include plays.
    pub(super) missing: Option<String>,
    /// The first ones.
    pub(super) differences: Vec<Differing>,
    pub(super) skips: Vec<Skipped>,
}

/// An onset of the replay beside the planned one, ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Onset {
    pub(super) planned: u64,
    pub(super) replayed: u64,
}

impl Summary {
    /// Whether everything was played as recorded.
    pub(super) fn is_same(&self) -> bool {
        self.differing == 0
            && self.skipped == self.never_began
            && self.ended_early.is_none()
            && self.missing.is_none()
    }

    /// Adds a skipped play. `never_began`: it had not begun in the record either.
    pub(super) fn skip(&mut self, skipped: Skipped, never_began: bool) {
        self.skipped += 1;
        self.never_began += u64::from(never_began);
        if self.skips.len() < MAX_LISTED {
            self.skips.push(skipped);
        }
    }

    /// Adds a play that was replayed. Returns it if it differs.
    pub(super) fn add(
        &mut self,
        step: &Step,
        receipts: &[Receipt],
        differences: Vec<Difference>,
    ) -> Option<Differing> {
        let play = &step.recorded.play;
        self.replayed += 1;
        self.gaps_by_host_clock += u64::from(!step.is_exact);
        let recorded = play.rest_error_max_um.unwrap_or(0.0);
        self.rest_error_recorded_max_um = self.rest_error_recorded_max_um.max(recorded);
        self.rest_error_replayed_max_um =
            self.rest_error_replayed_max_um.max(rest_um(receipts).unwrap_or(0.0));
        if differences.is_empty() {
            return None;
        }
        self.differing += 1;
        let replayed_as = receipts.iter().map(|receipt| receipt.id).collect();
        let differing =
            Differing { play: play.play, pattern: play.pattern.clone(), replayed_as, differences };
        if self.differences.len() < MAX_LISTED {
            self.differences.push(differing.clone());
        }
        Some(differing)
    }
}

impl Differing {
    /// One line.
    pub(super) fn line(&self) -> String {
        let parts = self.differences.iter().map(|difference| {
            format!("{} {} -> {}", difference.what, difference.recorded, difference.replayed)
        });
        format!("play {} ({}): {}", self.play, self.pattern, parts.collect::<Vec<_>>().join("; "))
    }
}

fn rest_um(receipts: &[Receipt]) -> Option<f32> {
    let errors = receipts.last()?.rest_error_um.as_ref()?.iter();
    errors.map(|error| error.abs()).reduce(f32::max)
}

/// The differences between a play and its replay. `last` and `now` are the onsets of the step before and of this one. A rest error
/// may be `rest_tolerance_um` larger than the recorded one.
pub(super) fn compare(
    step: &Step,
    receipts: &[Receipt],
    (last, now): (Option<Onset>, Option<Onset>),
    rest_tolerance_um: f32,
) -> Vec<Difference> {
    let play = &step.recorded.play;
    let mut found = Vec::new();
    let mut differ = |what, recorded: Option<String>, replayed: Option<String>| {
        let shown = |value: Option<String>| value.unwrap_or_else(|| "none".to_owned());
        if recorded.is_some() && recorded != replayed {
            found.push(Difference { what, recorded: shown(recorded), replayed: shown(replayed) });
        }
    };
    let gap = |of: fn(Onset) -> u64| Some(of(now?).abs_diff(of(last?)).to_string());
    match now {
        Some(_) => differ("gap (ticks)", gap(|at| at.planned), gap(|at| at.replayed)),
        None => differ("onset", Some("began".to_owned()), Some("never began".to_owned())),
    }
    let ended = |receipt: &Receipt| receipt.state.name();
    let state = receipts.iter().map(ended).find(|state| *state != "done").unwrap_or("done");
    differ("state", Some("done".to_owned()), Some(state.to_owned()));
    if step.is_whole {
        let count = |of: fn(&meissner_api::BurstCounts) -> u64| {
            let replayed =
                receipts.iter().map(|receipt| receipt.bursts.as_ref().map(of)).sum::<Option<u64>>();
            (play.bursts.as_ref().map(of).map(|n| n.to_string()), replayed.map(|n| n.to_string()))
        };
        let (recorded, replayed) = count(|bursts| bursts.planned);
        differ("bursts planned", recorded, replayed);
        let (recorded, replayed) = count(|bursts| bursts.played);
        differ("bursts played", recorded, replayed);
        let (recorded, replayed) = count(|bursts| bursts.refused);
        differ("bursts refused", recorded, replayed);
        let late = |receipt: &Receipt| {
            let late = receipt.lateness.counts;
            late.host + late.link + late.device
        };
        let recorded = play.late_strokes.map(|n| n.to_string());
        differ("late strokes", recorded, Some(receipts.iter().map(late).sum::<u64>().to_string()));
        let ordered = receipts.iter().map(|receipt| receipt.ordered?.pulses).sum::<Option<u64>>();
        let recorded = play.ordered.and_then(|ordered| ordered.pulses);
        differ("pulses ordered", recorded.map(|n| n.to_string()), ordered.map(|n| n.to_string()));
    }
    if let (0, Some(onset), [Receipt { onset: Some(other), trigger, .. }]) =
        (play.items, play.onset_tick, receipts)
    {
        let replayed = output(*trigger, other.actual_tick);
        differ("trigger", Some(output(play.trigger, onset)), Some(replayed));
    }
    let um = |um: f64| format!("{um:.1} um");
    if let (Some(recorded), [receipt]) = (play.reached_um, receipts) {
        let [_, replayed] = largest_um(&receipt.drives);
        if (recorded - replayed).abs() > SAME_UM {
            differ("amplitude", Some(um(recorded)), Some(um(replayed)));
        }
    }
    if let Some((recorded, replayed)) = play.rest_error_max_um.zip(rest_um(receipts))
        && replayed > recorded + rest_tolerance_um
    {
        differ("rest error", Some(um(recorded.into())), Some(um(replayed.into())));
    }
    if play.items > 0 {
        compare_items(step, receipts, &mut differ);
    }
    found
}

/// Describes the pulse of the trigger output, and its time after the onset.
fn output(trigger: Option<TriggerRecord>, onset: u64) -> String {
    let Some(TriggerRecord { tick, width_ms, code }) = trigger else { return "none".to_owned() };
    let code = code.map_or_else(String::new, |code| format!(" code {code}"));
    let after = i128::from(tick) - i128::from(onset);
    format!("{width_ms} ms{code} at {after} ticks")
}

/// Compares the items of a sequence; returns the first that differs, and how many do.
fn compare_items(
    step: &Step,
    receipts: &[Receipt],
    differ: &mut impl FnMut(&'static str, Option<String>, Option<String>),
) {
    // Onsets count from that of the whole sequence, even if the replay plays it in several parts.
    let replayed: Vec<(&ItemRecord, u64)> = receipts
        .iter()
        .zip(&step.orders)
        .flat_map(|(receipt, (start, _))| {
            let onset = receipt.onset.map_or(0, |onset| onset.actual_tick);
            let items = receipt.items.as_deref().unwrap_or_default().iter();
            items.map(move |item| (item, item.onset.map_or(0, |at| start + at.tick.saturating_sub(onset))))
        })
        .collect();
    let recorded: Vec<_> = step.recorded.items.iter().filter(|item| has_ended(item)).collect();
    // This number includes items whose lines the record has lost.
    let planned = step.recorded.play.items_planned.filter(|_| step.is_whole);
    let count = planned.unwrap_or(recorded.len() as u64);
    differ("items", Some(count.to_string()), Some(replayed.len().to_string()));
    let (mut first, mut count) = (None, 0u64);
    for (item, (other, tick)) in recorded.iter().zip(replayed) {
        let of_item = |what: &str| format!("{what} of item {}", item.item.unwrap_or(0));
        let planned = item.planned_onset_ticks.unwrap_or(0);
        let reached_um = item.reached_um.unwrap_or(other.reached_um);
        let outputs = item
            .onset_tick
            .zip(other.onset)
            .map(|(onset, at)| (output(item.trigger, onset), output(other.trigger, at.tick)));
        let failed = |late: u64, refused: u64| format!("{late} late, {refused} refused");
        let recorded_failed = failed(item.late_strokes.unwrap_or(0), item.refused_strokes.unwrap_or(0));
        let replayed_failed = failed(other.late_strokes.into(), other.refused_strokes.into());
        let sha256 = item.pattern_sha256.as_deref().unwrap_or_default();
        let difference = if sha256 != &*other.pattern_sha256 {
            Some((of_item("pattern"), sha256.to_owned(), other.pattern_sha256.to_string()))
        } else if item.state == "played" && other.state != ItemState::Played {
            Some((of_item("state"), item.state.clone(), other.state.name().to_owned()))
        } else if planned != tick && other.onset.is_some() {
            Some((of_item("onset"), format!("{planned} ticks"), format!("{tick} ticks")))
        } else if (reached_um - other.reached_um).abs() > SAME_UM {
            Some((of_item("amplitude"), format!("{reached_um:.1} um"), format!("{:.1} um", other.reached_um)))
        } else if let Some((recorded, replayed)) = outputs.filter(|(recorded, replayed)| recorded != replayed)
        {
            Some((of_item("trigger"), recorded, replayed))
        } else if recorded_failed != replayed_failed {
            Some((of_item("strokes"), recorded_failed, replayed_failed))
        } else {
            None
        };
        count += u64::from(difference.is_some());
        first = first.or(difference);
    }
    if let Some((what, recorded, replayed)) = first {
        let more = if count > 1 { format!(" (and {} more items)", count - 1) } else { String::new() };
        differ("items:", Some(format!("{what} {recorded}")), Some(format!("{replayed}{more}")));
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::Planner;
    use super::super::plan::tests::{play, with_items};
    use super::*;
    use meissner_api::{BurstCounts, InstantRecord, OnsetRecord, OrderedCounts, PlayState};

    fn receipt(onset: u64) -> Receipt {
        let onset = Some(OnsetRecord {
            requested_tick: onset,
            actual_tick: onset,
            monotonic_ns: 1,
            uncertainty_ns: 1,
        });
        Receipt {
            state: PlayState::Done,
            onset,
            bursts: Some(BurstCounts { planned: 60, played: 60, ..BurstCounts::default() }),
            ordered: Some(OrderedCounts { bursts: 60, pulses: Some(4000) }),
            rest_error_um: Some(vec![1.0, -3.0]),
            trigger: onset.map(|onset| TriggerRecord {
                tick: onset.actual_tick,
                width_ms: 4.0,
                code: Some(7),
            }),
            ..Receipt::new(9, "pin-60", &"0".repeat(64), Some(0.5))
        }
    }

    fn step() -> Step {
        let mut recorded = play(3, 1000);
        recorded.play.bursts = receipt(0).bursts;
        recorded.play.ordered = receipt(0).ordered;
        recorded.play.rest_error_max_um = Some(2.0);
        Planner::default().plan(recorded).unwrap()
    }

    fn at(planned: u64, replayed: u64) -> Option<Onset> {
        Some(Onset { planned, replayed })
    }

    #[test]
    fn a_replay_that_is_the_same_says_nothing_and_each_difference_is_told() {
        let onsets = (at(100, 5_000_100), at(700, 5_000_700));
        assert_eq!(compare(&step(), &[receipt(5)], onsets, 20.0), []);
        let mut other = receipt(5);
        other.bursts = Some(BurstCounts { planned: 60, played: 58, late: 2, ..BurstCounts::default() });
        other.ordered = Some(OrderedCounts { bursts: 60, pulses: Some(4001) });
        other.rest_error_um = Some(vec![-25.0]);
        other.state = PlayState::Aborted;
        let found = compare(&step(), &[other.clone()], (at(100, 5_000_100), at(700, 5_000_701)), 20.0);
        let mut summary = Summary::default();
        let line = summary.add(&step(), &[other], found).unwrap().line();
        assert_eq!(
            line,
            "play 3 (pin-60): gap (ticks) 600 -> 601; state done -> aborted; bursts played 60 -> 58; pulses ordered 4000 -> 4001; \
             rest error 2.0 um -> 25.0 um"
        );
        assert!(!summary.is_same() && summary.rest_error_replayed_max_um == 25.0);
        // For a cut play, only comparable figures are compared.
        let mut cut = step();
        cut.is_whole = false;
        let mut short = receipt(5);
        short.bursts = Some(BurstCounts { planned: 2, played: 2, ..BurstCounts::default() });
        assert_eq!(compare(&cut, &[short.clone()], onsets, 20.0), []);
        short.onset = None;
        let found = compare(&cut, &[short], (None, None), 20.0);
        assert!(found.iter().any(|difference| difference.what == "onset"), "{found:?}");
    }

    #[test]
    fn a_trigger_and_strokes_that_did_not_come_are_compared() {
        let onsets = (at(100, 5_000_100), at(700, 5_000_700));
        let mut recorded = step();
        recorded.recorded.play.late_strokes = Some(0);
        assert_eq!(compare(&recorded, &[receipt(5)], onsets, 20.0), []);
        let mut other = receipt(5);
        other.trigger = Some(TriggerRecord { tick: 6, width_ms: 4.0, code: Some(8) });
        other.bursts = Some(BurstCounts { planned: 60, played: 60, refused: 4, ..BurstCounts::default() });
        other.lateness.counts.link = 2;
        let found = compare(&recorded, &[other.clone()], onsets, 20.0);
        let found: Vec<_> =
            found.iter().map(|d| (d.what, d.recorded.as_str(), d.replayed.as_str())).collect();
        assert_eq!(
            found,
            [
                ("bursts refused", "0", "4"),
                ("late strokes", "0", "2"),
                ("trigger", "4 ms code 7 at 0 ticks", "4 ms code 8 at 1 ticks")
            ]
        );
        // A trigger that was not given is compared, too.
        recorded.recorded.play.trigger = None;
        other = Receipt { trigger: receipt(5).trigger, ..receipt(5) };
        let found = compare(&recorded, &[other], onsets, 20.0);
        assert_eq!((found[0].what, found[0].recorded.as_str()), ("trigger", "none"));
    }

    #[test]
    fn only_a_play_that_had_not_begun_may_be_left_out() {
        let skipped = || Skipped { play: 3, why: String::new() };
        let mut summary = Summary::default();
        summary.skip(skipped(), true);
        assert!(summary.is_same());
        summary.skip(skipped(), false);
        assert!(!summary.is_same() && summary.skipped == 2);
    }

    #[test]
    fn items_are_compared_one_by_one_also_in_parts() {
        let step = Planner::default().plan(with_items(3, 1000, 4000, 850)).unwrap();
        assert_eq!(step.orders.len(), 2);
        let item = |tick: u64| ItemRecord {
            pattern: "pin-60".into(),
            pattern_sha256: "0".repeat(64).into(),
            scale: 1.0,
            ordered_um: 0.0,
            reached_um: 0.0,
            planned_onset_ticks: 0,
            ordered_ms: 20.0,
            state: ItemState::Played,
            onset: Some(InstantRecord { tick, monotonic_ns: 1, uncertainty_ns: 1 }),
            first_pulse_tick: None,
            offset: None,
            trigger: Some(TriggerRecord { tick, width_ms: 4.0, code: Some(7) }),
            late_strokes: 0,
            refused_strokes: 0,
        };
        let of = |part: u64| {
            let onset = 10_000 + 2000 * 850 * part;
            let items: Vec<_> = (0..2000).map(|n| item(onset + n * 850)).collect();
            Receipt { items: Some(items.into()), bursts: None, ordered: None, ..receipt(onset) }
        };
        let mut receipts = [of(0), of(1)];
        assert_eq!(compare(&step, &receipts, (None, at(0, 10_000)), 20.0), []);
        let mut holed = step.clone();
        holed.recorded.play.items_planned = Some(4001);
        let found = compare(&holed, &receipts, (None, at(0, 10_000)), 20.0);
        assert_eq!((found[0].what, found[0].recorded.as_str()), ("items", "4001"));
        let changed = |change: fn(&mut ItemRecord)| {
            let mut items = receipts[1].items.clone().unwrap().to_vec();
            change(&mut items[5]);
            let receipts =
                [receipts[0].clone(), Receipt { items: Some(items.into()), ..receipts[1].clone() }];
            compare(&step, &receipts, (None, at(0, 10_000)), 20.0).remove(0)
        };
        let other = changed(|item| item.pattern_sha256 = "1".into());
        assert!(other.recorded.starts_with("pattern of item 2005 000") && other.replayed == "1");
        let other = changed(|item| item.trigger = None);
        assert_eq!(other.recorded, "trigger of item 2005 4 ms code 7 at 0 ticks");
        let other = changed(|item| item.late_strokes = 2);
        assert_eq!((other.what, other.replayed.as_str()), ("items:", "2 late, 0 refused"));
        let mut items = receipts[1].items.clone().unwrap().to_vec();
        items[7].onset.as_mut().unwrap().tick += 1;
        items[8].state = ItemState::Incomplete;
        items.pop();
        receipts[1].items = Some(items.into());
        let found = compare(&step, &receipts, (None, at(0, 10_000)), 20.0);
        assert_eq!((found[0].recorded.as_str(), found[0].replayed.as_str()), ("4000", "3999"));
        assert_eq!(found[1].recorded, format!("onset of item 2007 {} ticks", 2007 * 850));
        assert!(found[1].replayed.ends_with("ticks (and 1 more items)"), "{found:?}");
    }
}
