//! Receipts: turns the streamer's events into receipts, totals, the device's state, and the API's events.
//!
//! The daemon adds each play before it sends it ([`Receipts::add`]), applies each [`StreamEvent`] ([`Receipts::apply`]), and publishes
//! the events that this returns. Nothing here reads a clock or sends anything.
//!
//! A new field of a receipt needs three edits: the field (`crates/api/src/receipt.rs`), the code that fills it
//! (`began`, `complete` or [`Receipts::apply`] here), and the code that prints it (`src/cli/text/receipt.rs`).
//!
//! Invariant: every accepted play has exactly one receipt, until [`KEPT`] later plays have ended. The receipts of queued and
//! running plays are all kept; the streamer bounds their number.

mod convert;
mod items;
mod live;
mod outline;

pub use convert::{
    board_status, calibration_plan, device_info, end_text, fit, outputs, refusal, reset_name, state_name,
};
pub use items::{BLANK, PlannedItem};
pub use outline::{Outline, largest_um, motion_heights, motions, motions_of_items, too_slow};

use firmware_protocol::message::{DeviceHello, State};
use firmware_protocol::tick::Tick;
use live::LiveAccount;
use meissner_api::{
    BurstCounts, DeviceInfo, EdgeEffect, Event, LateCounts, LateStroke, LinkTraffic, LoweredPin,
    LoweredReason, MAX_LISTED, MotorRestError, MovedPin, NO_DEVICE, PlayDevice, PlayEdges, PlayPins,
    PlayState, PulseCounts, Receipt, RefusedStroke, RunningPlay,
};
use meissner_array::spec::Array;
use meissner_array::units::TickRate;
use meissner_stream::end_cause;
use meissner_stream::queues::Onset;
use meissner_stream::queues::{Outcome, Snapshot, StreamEvent, refusal_text};
use meissner_stream::time::HostInstant;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// Receipts kept of ended plays, at most.
pub const KEPT: usize = 1000;

/// Items of sequences in these receipts, at most: older receipts give way. They take 8 MB.
pub const KEPT_ITEMS: usize = 1 << 15;

/// Sums since the daemon's start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Totals {
    /// Plays that ended: done, stopped, aborted.
    pub plays: [u64; 3],
    /// Bursts of ended plays.
    pub bursts: BurstCounts,
    /// Pulses of ended plays.
    pub pulses: PulseCounts,
    /// Late strokes of ended plays.
    pub lateness: LateCounts,
    /// Bytes sent while plays ran.
    pub wire_bytes: u64,
    /// Events lost because the daemon was too slow.
    pub lost: u64,
    /// Devices connected.
    pub connects: u64,
}

/// The device's state as the API names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceState {
    /// The controller's state, or `no-device`.
    pub state: &'static str,
    /// Why.
    pub cause: String,
    /// `known` or `unknown`.
    pub position: &'static str,
}

/// See the module.
#[derive(Debug)]
pub struct Receipts {
    array: Array,
    kind: String,
    hello: Option<DeviceHello>,
    snapshot: Option<Snapshot>,
    /// Plays sent to the streamer, but not answered yet.
    sent: Vec<Receipt>,
    /// Queued and running plays, in order of acceptance.
    live: Vec<Receipt>,
    finished: VecDeque<Receipt>,
    /// The plans of the items of sequences that are not over.
    planned: HashMap<u64, Arc<[PlannedItem]>>,
    /// The updates of live plays that are not over.
    updates: HashMap<u64, LiveAccount>,
    totals: Totals,
}

impl Receipts {
    /// No plays yet, on this array.
    pub fn new(array: Array) -> Self {
        Self {
            array,
            kind: String::new(),
            hello: None,
            snapshot: None,
            sent: Vec::new(),
            live: Vec::new(),
            finished: VecDeque::new(),
            planned: HashMap::new(),
            updates: HashMap::new(),
            totals: Totals::default(),
        }
    }

    /// Adds a play that is about to be sent to the streamer, and the plan of its items.
    pub fn add(&mut self, receipt: Receipt, items: Arc<[PlannedItem]>) {
        if receipt.live.is_some() {
            self.updates.insert(receipt.id, LiveAccount::default());
        }
        self.planned.insert(receipt.id, items);
        let (array, tick_hz) = (self.array.name().to_owned(), self.array.rate().hz());
        let device = PlayDevice { array, tick_hz, ..PlayDevice::default() };
        self.sent.push(Receipt { device, ..receipt });
    }

    /// Takes the streamer's answer to a play.
    pub fn settle(&mut self, id: u64, accepted: bool) -> Option<Event> {
        let at = self.sent.iter().position(|receipt| receipt.id == id)?;
        let mut receipt = self.sent.remove(at);
        // A play belongs to one connection, so the current boot is the play's.
        receipt.device.boot = self.hello.map(|hello| hello.boot);
        let event = Event::Queued { id, name: receipt.name.clone(), ordered_ms: receipt.duration_ms.ordered };
        if !accepted {
            self.planned.remove(&id);
        }
        accepted.then(|| self.live.push(receipt))?;
        Some(event)
    }

    /// Sets how the next device is reached.
    pub fn set_device_kind(&mut self, kind: String) {
        self.kind = kind;
    }

    /// How the last device was reached, as in [`DeviceInfo::kind`].
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// Applies an event of the streamer. Other parts of the daemon handle answers and returned memory.
    pub fn apply(&mut self, event: &StreamEvent) -> Option<Event> {
        match event {
            StreamEvent::Answer { .. }
            | StreamEvent::PlayRejected(_)
            | StreamEvent::GainsApplied(_)
            | StreamEvent::ThreadEnded => None,
            StreamEvent::SensorFault { motor, fault } => {
                Some(Event::SensorFault { motor: *motor, fault: *fault })
            }
            StreamEvent::Contradiction(how) => Some(Event::Contradiction { kind: how.name().to_owned() }),
            StreamEvent::DriftWarning { um } => Some(Event::Drifted { um: *um }),
            StreamEvent::Connected(hello) => {
                self.totals.connects += 1;
                self.hello = Some(*hello);
                Some(Event::Connected { device: device_info(&self.kind, hello) })
            }
            StreamEvent::Disconnected { reason, .. } => {
                self.hello = None;
                Some(Event::Disconnected { reason: reason.clone() })
            }
            StreamEvent::Snapshot(snapshot) => {
                self.snapshot = Some(*snapshot);
                Some(self.state_event(snapshot.at))
            }
            StreamEvent::PlayStarted { id, onset } => {
                began(self.live_mut(*id)?, *onset);
                Some(Event::Began { id: *id, onset: (*onset).into() })
            }
            StreamEvent::StrokeLate { id, motor, up, late_ms, cause, counts } => {
                let stroke = LateStroke { motor: *motor, tick: up.0, late_ms: *late_ms, cause: *cause };
                if let Some(receipt) = self.live_mut(*id) {
                    receipt.counts.lateness.counts = *counts;
                    list(&mut receipt.counts.lateness.strokes, stroke);
                }
                Some(Event::Late { id: *id, stroke })
            }
            StreamEvent::StrokeRefused { id, motor, up, reason } => {
                let reason = refusal_text(*reason).to_owned();
                let stroke = RefusedStroke { motor: *motor, tick: up.0, reason };
                if let Some(receipt) = self.live_mut(*id) {
                    list(&mut receipt.counts.refusals, stroke.clone());
                }
                Some(Event::Refused { id: *id, stroke })
            }
            StreamEvent::PinsLowered { id, tick, late, held } => {
                let pins = [(late, LoweredReason::Late), (held, LoweredReason::Held)].into_iter();
                let pins = pins.flat_map(|(of, reason)| of.iter().map(move |motor| (motor, reason)));
                if let Some(receipt) = self.live_mut(*id) {
                    for (motor, reason) in pins {
                        receipt.counts.lowered.add(LoweredPin { motor, tick: tick.0, reason });
                    }
                }
                None
            }
            StreamEvent::Edge { edge, play, effect } => {
                if *effect == EdgeEffect::Start
                    && let Some(receipt) = play.and_then(|id| self.live_mut(id))
                {
                    receipt.edges.start = Some((*edge).into());
                }
                Some(Event::Edge { edge: (*edge).into(), play: *play, effect: *effect })
            }
            StreamEvent::LiveUpdated(update) => {
                if let Some(account) = self.updates.get_mut(&update.id) {
                    account.add(update, self.array.rate());
                }
                None
            }
            StreamEvent::PlayEnded { id, outcome } => self.ended(*id, outcome),
            StreamEvent::EventsLost(events) => {
                self.totals.lost += events;
                Some(Event::Lost { events: *events })
            }
        }
    }

    fn live_mut(&mut self, id: u64) -> Option<&mut Receipt> {
        self.live.iter_mut().find(|receipt| receipt.id == id)
    }

    fn ended(&mut self, id: u64, outcome: &Outcome) -> Option<Event> {
        let at = self.live.iter().position(|receipt| receipt.id == id)?;
        let mut receipt = self.live.remove(at);
        let rate = self.array.rate();
        complete(&mut receipt, outcome, rate);
        if let (Some(live), Some(account)) = (&mut receipt.live, self.updates.remove(&id)) {
            *live = account.record();
        }
        self.totals.add(outcome);
        let planned = self.planned.remove(&id).unwrap_or_default();
        receipt.items = Some(items::records(&planned, &outcome.play.items, rate));
        // An event must be short.
        let items = receipt.items.clone().filter(|items| items.len() <= 1);
        let event = Event::Ended { receipt: Box::new(Receipt { items, ..receipt.clone() }) };
        let count = |receipt: &Receipt| receipt.items.as_ref().map_or(0, |items| items.len());
        let mut kept = count(&receipt) + self.finished.iter().map(count).sum::<usize>();
        while self.finished.len() >= KEPT || kept > KEPT_ITEMS {
            let Some(oldest) = self.finished.pop_front() else { break };
            kept -= count(&oldest);
        }
        self.finished.push_back(receipt);
        Some(event)
    }

    /// The receipt of a play.
    pub fn receipt(&self, id: u64) -> Option<&Receipt> {
        self.live.iter().chain(&self.finished).find(|receipt| receipt.id == id)
    }

    /// The receipt of the last play.
    pub fn last(&self) -> Option<&Receipt> {
        self.live.iter().chain(&self.finished).max_by_key(|receipt| receipt.id)
    }

    /// Queued plays, in order.
    pub fn queued(&self) -> impl Iterator<Item = &Receipt> {
        self.live.iter().filter(|receipt| receipt.state == PlayState::Queued)
    }

    /// Whether no play was sent, waits or runs.
    pub fn is_idle(&self) -> bool {
        self.sent.is_empty() && self.live.is_empty()
    }

    /// The connected device.
    pub fn device(&self) -> Option<DeviceInfo> {
        self.hello.as_ref().map(|hello| device_info(&self.kind, hello))
    }

    /// The last snapshot.
    pub const fn snapshot(&self) -> Option<&Snapshot> {
        self.snapshot.as_ref()
    }

    /// Sums since the start.
    pub const fn totals(&self) -> &Totals {
        &self.totals
    }

    /// The device's clock at `now` and its uncertainty, µs: from the last snapshot's estimate, because an idle streamer publishes
    /// one a second.
    pub fn clock(&self, now: HostInstant) -> Option<(Tick, f64)> {
        let snapshot = self.snapshot.as_ref().filter(|snapshot| snapshot.connected)?;
        let clock = snapshot.clock?;
        Some((clock.tick_at(now), clock.uncertainty(now).as_nanos() as f64 / 1000.0))
    }

    /// The device's state as the API names it.
    pub fn device_state(&self) -> DeviceState {
        match &self.snapshot {
            Some(at) if at.connected || at.state == State::Faulted => {
                let position = if at.connected && at.position_known { "known" } else { "unknown" };
                DeviceState { state: state_name(at.state), cause: end_cause(at.cause).to_string(), position }
            }
            _ => DeviceState { state: NO_DEVICE, cause: NO_DEVICE.to_owned(), position: "unknown" },
        }
    }

    /// The running play.
    pub fn running(&self) -> Option<RunningPlay> {
        let receipt = self.live.iter().find(|receipt| receipt.state == PlayState::Running)?;
        let played = self.snapshot.as_ref().and_then(|snapshot| snapshot.play);
        let played_s = played.filter(|(id, _)| *id == receipt.id).map_or(0.0, |(_, played_s)| played_s);
        Some(RunningPlay { id: receipt.id, name: receipt.name.clone(), played_s })
    }

    /// The state as an event.
    pub fn state_event(&self, now: HostInstant) -> Event {
        let DeviceState { state, cause, position } = self.device_state();
        Event::State {
            state: state.to_owned(),
            cause,
            position: position.to_owned(),
            tick: self.clock(now).map_or(0, |(tick, _)| tick.0),
            play: self.running(),
        }
    }
}

fn began(receipt: &mut Receipt, onset: Onset) {
    receipt.state = PlayState::Running;
    receipt.onset = Some(onset.into());
}

/// Adds a stroke to a receipt's list while there is room.
fn list<T>(strokes: &mut Vec<T>, stroke: T) {
    if strokes.len() < MAX_LISTED {
        strokes.push(stroke);
    }
}

fn complete(receipt: &mut Receipt, outcome: &Outcome, rate: TickRate) {
    if let Some(onset) = outcome.onset {
        began(receipt, onset);
    }
    receipt.state = outcome.end.into();
    receipt.cause = outcome.cause.clone();
    let counts = &mut receipt.counts;
    counts.bursts = Some(outcome.bursts);
    counts.pulses = Some(outcome.pulses);
    counts.estimated = outcome.estimated;
    counts.lateness.counts = outcome.lateness;
    receipt.device.wire = Some(LinkTraffic::new(outcome.wire_bytes, outcome.bursts.planned));
    receipt.device.board = outcome.board.map(convert::board_record);
    receipt.edges =
        PlayEdges { start: outcome.started_by.map(Into::into), stop: outcome.stopped_by.map(Into::into) };
    receipt.offset = outcome.offset.map(Into::into);
    receipt.duration_ms.cut_after = outcome.cut_after.map(|ticks| rate.ticks_to_ms(ticks));
    receipt.duration_ms.played =
        outcome.offset.zip(outcome.onset).map(|(offset, onset)| rate.ticks_to_ms(offset.tick - onset.actual));
    let pins = (0..).zip(outcome.play.pins);
    let pins = pins.filter_map(|(motor, moved)| {
        let [first, offset] = moved?;
        Some(MovedPin { motor, first_pulse_tick: first.0, offset_tick: offset.0 })
    });
    let (onset, end) = (&outcome.rest_at_onset, &outcome.rest_at_end);
    let driven = (0..).zip(end.um).zip(end.source);
    let driven = driven.filter(|((motor, _), _)| outcome.play.strokes.drives(*motor));
    let rest_errors = driven.map(|((motor, offset_um), offset_source)| MotorRestError {
        motor,
        onset_um: onset.map(|onset| onset.um[usize::from(motor)]),
        onset_source: onset.map(|onset| onset.source[usize::from(motor)]),
        offset_um,
        offset_source,
    });
    receipt.pins = Some(PlayPins {
        rest_error_um: end.um.to_vec(),
        rest_errors: rest_errors.collect(),
        moved: pins.collect(),
    });
}

impl Totals {
    fn add(&mut self, outcome: &Outcome) {
        self.plays[outcome.end as usize] += 1;
        let (sum, bursts) = (&mut self.bursts, &outcome.bursts);
        sum.planned += bursts.planned;
        sum.played += bursts.played;
        sum.late += bursts.late;
        sum.dropped += bursts.dropped;
        sum.refused += bursts.refused;
        sum.replaced += bursts.replaced;
        sum.amended += bursts.amended;
        sum.shortened += bursts.shortened;
        self.pulses.planned += outcome.pulses.planned;
        self.pulses.played += outcome.pulses.played;
        let (sum, lateness) = (&mut self.lateness, &outcome.lateness);
        sum.host += lateness.host;
        sum.link += lateness.link;
        sum.device += lateness.device;
        sum.worst_ms = sum.worst_ms.max(lateness.worst_ms);
        self.wire_bytes += outcome.wire_bytes;
    }
}

#[cfg(test)]
pub(crate) mod tests;
