//! Plays: their receipts, clients and measured bursts.
//!
//! Bounds: those of [`Receipts`] and [`MeasuredBursts`]; patterns and clients are kept only while a play is not over or its
//! response is not predicted.

use crate::daemon::predictor::MeasuredPlay;
use crate::receipts::{MeasuredBursts, NoPrediction, Order, PlannedItem, PlayedPattern, Receipts, fit_name};
use crate::session_record::Peer;
use crate::store::{Stored, hash};
use meissner_api::{Event, Fit, Labels, LatePolicy, LiveRecord, LiveRequest, OrderedCounts, Receipt};
use meissner_array::pattern::Pattern;
use meissner_array::strokes::StrokeOptions;
use std::collections::HashMap;
use std::sync::Arc;

/// The pattern name of a live play in its receipt.
const LIVE: &str = "live";

/// A play that is about to be sent to the streamer.
#[derive(Debug)]
pub(in crate::daemon) struct NewPlay {
    pub(in crate::daemon) stored: Stored,
    /// How it differs from its pattern.
    pub(in crate::daemon) options: StrokeOptions,
    pub(in crate::daemon) order: Order,
    /// Its ordered bursts and pulses; `None` if it has no end.
    pub(in crate::daemon) counts: Option<OrderedCounts>,
    pub(in crate::daemon) mode: PlayMode,
    pub(in crate::daemon) trial: SessionTrial,
    pub(in crate::daemon) client: Peer,
}

/// How a play is played.
#[derive(Clone, Copy, Debug)]
pub(in crate::daemon) struct PlayMode {
    pub(in crate::daemon) late: LatePolicy,
    pub(in crate::daemon) open_loop: bool,
}

/// What a play belongs to.
#[derive(Debug)]
pub(in crate::daemon) struct SessionTrial {
    pub(in crate::daemon) session: Option<String>,
    pub(in crate::daemon) number: Option<u64>,
    pub(in crate::daemon) labels: Labels,
}

/// A sequence that is about to be sent to the streamer.
#[derive(Debug)]
pub(in crate::daemon) struct NewSequence {
    pub(in crate::daemon) name: String,
    pub(in crate::daemon) sha256: String,
    pub(in crate::daemon) order: Order,
    pub(in crate::daemon) counts: Option<OrderedCounts>,
    pub(in crate::daemon) items: Arc<[PlannedItem]>,
    pub(in crate::daemon) mode: PlayMode,
    pub(in crate::daemon) trial: SessionTrial,
    pub(in crate::daemon) client: Peer,
}

/// A live play that is about to be sent to the streamer.
#[derive(Debug)]
pub(in crate::daemon) struct NewLive<'r> {
    pub(in crate::daemon) request: &'r LiveRequest,
    pub(in crate::daemon) mode: PlayMode,
    pub(in crate::daemon) trial: SessionTrial,
    pub(in crate::daemon) client: Peer,
}

/// The data of a play that its prediction needs.
#[derive(Debug)]
struct Unpredicted {
    pattern: Arc<Pattern>,
    options: StrokeOptions,
    /// Whether the device measures bursts.
    telemetry: bool,
}

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Plays {
    pub(in crate::daemon) receipts: Receipts,
    pub(in crate::daemon) measured: MeasuredBursts,
    /// Plays without a prediction.
    unpredicted: HashMap<u64, Unpredicted>,
    /// The clients of the plays that are not over.
    clients: HashMap<u64, Peer>,
    last_id: u64,
}

impl Plays {
    /// Gives a play an id and a receipt.
    pub(in crate::daemon) fn add(&mut self, play: NewPlay) -> u64 {
        let NewPlay { stored: Stored { pattern, sha256, .. }, options, order, counts, mode, trial, client } =
            play;
        let telemetry = self.receipts.device().is_some_and(|device| device.telemetry);
        self.last_id += 1;
        let id = self.last_id;
        let SessionTrial { session, number, labels } = trial;
        let receipt = Receipt::new(id, pattern.name(), &sha256, options.seconds);
        let scale = Some(options.scale);
        let PlayMode { late: late_policy, open_loop } = mode;
        let mut receipt =
            Receipt { session, trial: number, labels, scale, late_policy, open_loop, ..receipt };
        order.enter(&mut receipt, fit_name(options.fit), counts);
        self.receipts.add(receipt);
        self.clients.insert(id, client);
        self.unpredicted.insert(id, Unpredicted { pattern, options, telemetry });
        id
    }

    /// Gives a sequence an id and a receipt.
    pub(in crate::daemon) fn add_sequence(&mut self, sequence: NewSequence) -> u64 {
        let NewSequence { name, sha256, order, counts, items, mode, trial, client } = sequence;
        let SessionTrial { session, number, labels } = trial;
        self.last_id += 1;
        let id = self.last_id;
        let seconds = order.ordered_ms.map(|ms| ms / 1e3);
        let receipt = Receipt::new(id, &name, &sha256, seconds);
        let PlayMode { late: late_policy, open_loop } = mode;
        let mut receipt = Receipt { session, trial: number, labels, late_policy, open_loop, ..receipt };
        order.enter(&mut receipt, Fit::Whole, counts);
        receipt.prediction.unknown = Some(NoPrediction::Sequence.to_string());
        self.receipts.add(receipt);
        self.receipts.plan(id, items);
        self.clients.insert(id, client);
        id
    }

    /// Gives a live play an id and a receipt.
    pub(in crate::daemon) fn add_live(&mut self, live: NewLive<'_>) -> u64 {
        let NewLive { request, mode, trial: SessionTrial { session, number, labels }, client } = live;
        self.last_id += 1;
        let id = self.last_id;
        // Plain data can be written.
        let sha256 = hash(&serde_json::to_vec(request).unwrap_or_default());
        let receipt = Receipt::new(id, LIVE, &sha256, None);
        let PlayMode { late: late_policy, open_loop } = mode;
        let mut receipt = Receipt {
            session,
            trial: number,
            labels,
            scale: request.scale,
            late_policy,
            open_loop,
            ..receipt
        };
        receipt.prediction.unknown = Some(NoPrediction::Live.to_string());
        receipt.live = Some(LiveRecord::default());
        self.receipts.add(receipt);
        self.clients.insert(id, client);
        id
    }

    /// Takes the streamer's answer to a play. The id of a play that was not accepted goes to the next one.
    pub(super) fn settle(&mut self, id: u64, accepted: bool) -> Option<Event> {
        if accepted {
            return self.receipts.settle(id, true);
        }
        if id == self.last_id {
            self.last_id -= 1;
        }
        self.forget(id);
        None
    }

    /// Drops a play that was never accepted.
    pub(super) fn forget(&mut self, id: u64) {
        self.receipts.settle(id, false);
        self.unpredicted.remove(&id);
        self.clients.remove(&id);
    }

    /// The client of a play that is not over.
    pub(super) fn client(&self, id: u64) -> Option<Peer> {
        self.clients.get(&id).copied()
    }

    /// Takes the client of a play, at its end.
    pub(in crate::daemon) fn take_client(&mut self, id: u64) -> Option<Peer> {
        self.clients.remove(&id)
    }

    /// An endless play that is not over: its pattern and options.
    pub(in crate::daemon) fn endless(&self, id: u64) -> Option<(Arc<Pattern>, StrokeOptions)> {
        self.receipts.receipt(id).filter(|receipt| receipt.ordered.is_none())?;
        let Unpredicted { pattern, options, .. } = self.unpredicted.get(&id)?;
        Some((Arc::clone(pattern), options.clone()))
    }

    /// A play with its measured bursts, once.
    pub(in crate::daemon) fn take_measured(&mut self, id: u64) -> Option<MeasuredPlay> {
        let Unpredicted { pattern, options, telemetry } = self.unpredicted.remove(&id)?;
        let receipt = self.receipts.receipt(id)?.clone();
        let played = PlayedPattern::of(&receipt, &pattern, options.clone());
        let bursts = played.map(|play| self.measured.within(play.onset, play.until()).copied().collect());
        let bursts = bursts.unwrap_or_default();
        Some(MeasuredPlay { pattern, options, receipt, telemetry, bursts })
    }
}
