//! The records of a play's items, made from the plan and the streamer's counts.
//!
//! Invariant: a record says `played` only if the device has reported the item's onset, accepted all its strokes and come to their
//! end, and no stroke was late or refused.

use meissner_api::{ItemRecord, ItemState, TriggerRecord};
use meissner_array::units::TickRate;
use meissner_stream::queues::Item;
use std::sync::Arc;

/// What a record calls an item in which nothing is played.
pub const BLANK: &str = "blank";

/// The plan of an item.
#[derive(Clone, Debug)]
pub struct PlannedItem {
    /// The pattern's name; [`BLANK`] if nothing is played.
    pub pattern: Arc<str>,
    /// SHA-256 of its file; empty if nothing is played.
    pub sha256: Arc<str>,
    /// The factor of its amplitudes.
    pub scale: f64,
    /// The largest amplitude of its drives, as ordered and as reached, µm; `None`: it changes.
    pub amplitude_um: Option<[f64; 2]>,
    /// When it begins, and ends if it does, ticks from the play's onset.
    pub span: (u64, Option<u64>),
}

impl PlannedItem {
    /// An item in which nothing is played.
    pub fn blank() -> Self {
        Self {
            pattern: BLANK.into(),
            sha256: "".into(),
            scale: 1.0,
            amplitude_um: Some([0.0; 2]),
            span: (0, None),
        }
    }
}

/// The records of all items.
pub(super) fn records(planned: &[PlannedItem], items: &[Item], rate: TickRate) -> Arc<[ItemRecord]> {
    (0..)
        .zip(planned)
        .zip(items)
        .map(|((number, planned), item)| record(number, planned, item, rate))
        .collect()
}

fn record(number: u64, planned: &PlannedItem, item: &Item, rate: TickRate) -> ItemRecord {
    let state = match (item.began, item.ended) {
        (Some(_), Some(_)) if item.late == 0 && item.refused == 0 => ItemState::Played,
        (_, Some(_)) => ItemState::Incomplete,
        (Some(_), None) => ItemState::Cut,
        (None, None) => ItemState::NotBegun,
    };
    ItemRecord {
        item: number,
        pattern: Arc::clone(&planned.pattern),
        pattern_sha256: Arc::clone(&planned.sha256),
        scale: planned.scale,
        ordered_um: planned.amplitude_um.map(|[ordered, _]| ordered),
        reached_um: planned.amplitude_um.map(|[_, reached]| reached),
        planned_onset_ticks: planned.span.0,
        ordered_ms: planned.span.1.map(|end| rate.ticks_to_ms(end - planned.span.0)),
        state,
        onset: item.began.map(Into::into),
        first_pulse_tick: item.first_up.filter(|_| state != ItemState::NotBegun).map(|tick| tick.0),
        offset: item.ended.filter(|_| item.first_up.is_some()).map(Into::into),
        trigger: trigger(item, rate),
        late_strokes: item.late,
        refused_strokes: item.refused,
    }
}

/// The trigger output's pulse at an item's onset, once the device has reported it.
fn trigger(item: &Item, rate: TickRate) -> Option<TriggerRecord> {
    let (tick, trigger) = (item.began?.tick.0, item.trigger?);
    let code = (trigger.code > 0).then_some(trigger.code);
    Some(TriggerRecord { tick, width_ms: rate.ticks_to_ms(trigger.width.into()), code })
}
