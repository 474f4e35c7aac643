//! Plays of many patterns: compiles the patterns of a sequence one by one, and begins all items as one play.
//!
//! [`Compiled::of_sequence`] finds each pattern, compiles it once for each scale, and drops it again. A sequence holds strokes, not patterns;
//! until it is accepted, it also holds some texts for the session record.
//!
//! Invariant: a sequence is accepted as a whole or refused, with the number of the item that is wrong.

use crate::daemon::engine::Engine;
use crate::daemon::plays::begin::Compiled;
use crate::daemon::plays::terms::{Terms, trigger};
use crate::daemon::state::NewPlay;
use crate::daemon::state::limits::check_limits;
use crate::daemon::system::runtime::PLAYS;
use crate::exposure::Vibration;
use crate::receipts::{NoPrediction, Order, PlannedItem};
use crate::session_record::Peer;
use crate::store::{MappedFrom, Stored, hash};
use firmware_protocol::tick::Tick;
use meissner_api::{Code, Fit, OrderedCounts, PlayAccepted, Problem, SequenceItem, SequenceRequest};
use meissner_array::strokes::{
    CompiledItem, Sequence, SequenceError, Start, StrokeOptions, Strokes, Surplus,
};
use meissner_array::units::TickRate;
use meissner_stream::queues::Item;
use meissner_stream::{Bandwidth, Settings};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::future::Future;
use std::sync::Arc;

/// The name of a sequence without one.
const NAME: &str = "sequence";
/// The part of an item that is used to compute its bandwidth, s.
const COUNTED_S: f64 = 60.0;
/// The most strokes that are counted for the receipt; for a longer sequence it has no counts.
const COUNTED: usize = 1 << 20;
/// Bytes of texts that a sequence holds for the session record, at most. Further ones are kept with a later play.
const MAX_TEXTS: usize = 4 << 20;

/// A pattern of a sequence while it is prepared.
struct Used {
    sha256: Arc<str>,
    name: Arc<str>,
    /// Its strokes and its largest amplitude, as ordered and as reached, µm, by scale.
    compiled: HashMap<u64, (CompiledItem, [f64; 2])>,
}

/// The state of a request while it is prepared.
struct Preparing {
    sequence: Sequence,
    bandwidth: Bandwidth,
    warnings: Vec<String>,
    largest: (f64, String),
    surplus: Surplus,
}

impl Compiled {
    /// Compiles a sequence; `find` finds a pattern, which is dropped before the next.
    async fn of_sequence<P, F: Future<Output = Result<(Stored, P), Problem>>>(
        request: &SequenceRequest,
        terms: &Terms,
        (settings, surplus): (Settings, Surplus),
        client: Peer,
        find: impl Fn(String, Option<String>) -> F,
    ) -> Result<Self, Problem> {
        let mut preparing = Preparing {
            sequence: Sequence::new(settings.array),
            bandwidth: Bandwidth::default(),
            warnings: Vec::new(),
            largest: (0.0, String::new()),
            surplus,
        };
        let mut by_text: HashMap<_, Vec<SequenceItem>> = HashMap::new();
        for item in &request.items {
            by_text.entry(text(item)).or_default().push(item.clone());
        }
        let mut used: HashMap<(&str, Option<&str>), Used> = HashMap::new();
        let (mut planned, mut placed) = (Vec::new(), Vec::new());
        let (mut texts, mut held, mut mapped_from) = (Vec::new(), 0, None);
        for (number, item) in request.items.iter().enumerate() {
            let at = |problem| at_item(number, problem);
            let text = text(item);
            if let Entry::Vacant(new) = used.entry(text) {
                let found = find(item.pattern.clone(), item.pattern_sha256.clone()).await;
                let (stored, _place) = found.map_err(at)?;
                let (stored, mapped) =
                    stored.on(settings.array, request.map).map_err(|error| at(error.into()))?;
                if let Some(MappedFrom { array, warnings }) = mapped {
                    let of_pattern =
                        warnings.into_iter().map(|warning| format!("`{}`: {warning}", item.pattern));
                    preparing.warnings.extend(of_pattern);
                    mapped_from.get_or_insert(array);
                }
                let items = by_text.remove(&text).unwrap_or_default();
                let (sha256, name) = (stored.sha256.as_str().into(), item.pattern.as_str().into());
                if held + stored.text.len() <= MAX_TEXTS {
                    held += stored.text.len();
                    texts.push((stored.sha256.clone(), Arc::clone(&stored.text)));
                }
                let (back, compiled) = PLAYS
                    .computing(move || {
                        let compiled = preparing.compile(&stored, &items, &settings);
                        (preparing, compiled)
                    })
                    .await?;
                preparing = back;
                let compiled = compiled.map_err(|error| at(refused(&error)))?;
                new.insert(Used { sha256, name, compiled });
            }
            let (Some(Used { sha256, name, compiled }), scale) = (used.get(&text), scale(item)) else {
                continue;
            };
            let start = match (item.gap_ms, item.start_ms) {
                (_, Some(ms)) => Start::At(ms),
                (gap_ms, None) => Start::Gap(gap_ms.unwrap_or(0.0)),
            };
            let Some(&(compiled, amplitude_um)) = compiled.get(&scale.to_bits()) else { continue };
            placed.push((compiled, item.seconds, start));
            let (pattern, sha256) = (Arc::clone(name), Arc::clone(sha256));
            planned.push(PlannedItem { pattern, sha256, scale, amplitude_um, span: (0, 0) });
        }
        // Adding an item takes a while for a pattern with many drives.
        let (preparing, added) = PLAYS
            .computing(move || {
                let mut items = placed.into_iter().enumerate();
                let added = items.try_for_each(|(number, (compiled, seconds, start))| {
                    let added = preparing.sequence.add(compiled, seconds, start);
                    added.map_err(|error| at_item(number, refused(&error)))
                });
                (preparing, added)
            })
            .await?;
        added?;
        let Preparing { sequence, bandwidth, warnings, largest, .. } = preparing;
        let rate = settings.array.rate();
        let items: Vec<Item> =
            request.items.iter().map(|item| Item::new(trigger(item.trigger, rate))).collect();
        for (item, span) in planned.iter_mut().zip(sequence.spans()) {
            item.span = span;
        }
        let spans: Vec<(f64, f64)> = sequence
            .spans()
            .map(|(start, end)| (rate.ticks_to_seconds(start), rate.ticks_to_seconds(end)))
            .collect();
        // A checked request has at least one item.
        let strokes = sequence
            .strokes()
            .ok_or_else(|| Problem::new(Code::BadRequest, "`items` is empty: add an item"))?;
        check_triggers(&strokes, &items, rate)?;
        let (fits, bandwidth, counts, strokes) = PLAYS
            .computing(move || {
                let bandwidth = Bandwidth::of(&strokes, &settings).max(bandwidth);
                let fits = check_limits(&strokes, &settings);
                (fits, bandwidth, counts(&strokes), strokes)
            })
            .await?;
        fits?;
        let length_ms = strokes.end().map(|end| rate.ticks_to_ms(end));
        let order = Order { ordered_ms: length_ms, compiled_ms: length_ms, drives: Vec::new(), warnings };
        let name = request.name.as_deref().unwrap_or(NAME);
        let mut receipt = terms.receipt(name, &sha256(&request.items), length_ms.map(|ms| ms / 1e3));
        receipt.mapped_from = mapped_from;
        order.enter(&mut receipt, Fit::Whole, counts);
        receipt.prediction.unknown = Some(NoPrediction::Sequence.to_string());
        Ok(Self {
            strokes: strokes.into(),
            items,
            live: None,
            bandwidth,
            settings,
            vibration: Vibration::of_spans(spans),
            endless: false,
            largest,
            new: NewPlay { receipt, items: Some(planned.into()), predicted: None, client },
            texts,
        })
    }
}

impl Preparing {
    fn options(&self, scale: f64, seconds: Option<f64>) -> StrokeOptions {
        StrokeOptions { scale, surplus: self.surplus.clone(), ..StrokeOptions::lasting(seconds) }
    }

    /// Compiles a pattern for each scale of the items that play it.
    fn compile(
        &mut self,
        stored: &Stored,
        items: &[SequenceItem],
        settings: &Settings,
    ) -> Result<HashMap<u64, (CompiledItem, [f64; 2])>, SequenceError> {
        let (name, pattern) = (stored.pattern.name(), &*stored.pattern);
        let mut compiled = HashMap::new();
        for scale in items.iter().map(scale) {
            let options = self.options(scale, None);
            if let Entry::Vacant(new) = compiled.entry(scale.to_bits()) {
                let amplitude_um = Order::of(pattern, &options)?.largest_um();
                new.insert((self.sequence.compile(pattern, &options)?, amplitude_um));
            }
        }
        let most = items.iter().map(scale).fold(0.0, f64::max);
        let amplitudes = pattern.drives().iter().map(|drive| drive.amplitude_um * most);
        let largest_um = amplitudes.fold(0.0, f64::max);
        if largest_um > self.largest.0 {
            self.largest = (largest_um, name.to_owned());
        }
        // The bandwidth of the longest item at the largest amplitude suffices, because no items of other patterns play meanwhile.
        let lasting = |item: &SequenceItem| item.seconds.or(pattern.duration_s()).unwrap_or(COUNTED_S);
        let longest_s = items.iter().map(lasting).fold(0.0, f64::max).min(COUNTED_S);
        let options = self.options(most, Some(longest_s));
        self.bandwidth = Bandwidth::of(&Strokes::new(pattern, &options)?, settings).max(self.bandwidth);
        let order = Order::of(pattern, &options)?;
        self.warnings.extend(order.listed_warnings().iter().map(|warning| format!("`{name}`: {warning}")));
        Ok(compiled)
    }
}

/// The problem of an item.
fn at_item(number: usize, problem: Problem) -> Problem {
    Problem { detail: format!("`items[{number}]`: {}", problem.detail), ..problem }
}

/// The key by which the texts of items differ.
fn text(item: &SequenceItem) -> (&str, Option<&str>) {
    (&item.pattern, item.pattern_sha256.as_deref())
}

fn scale(item: &SequenceItem) -> f64 {
    item.scale.unwrap_or(1.0)
}

fn refused(error: &SequenceError) -> Problem {
    let code = if *error == SequenceError::Empty { Code::Empty } else { Code::BadRequest };
    Problem::new(code, error.to_string())
}

/// Refuses a trigger that would still be on its way when the next one begins.
fn check_triggers(strokes: &Strokes, items: &[Item], rate: TickRate) -> Result<(), Problem> {
    let mut strokes = strokes.clone();
    strokes.begin(Tick(0));
    let mut before: Option<(usize, u64)> = None;
    for (number, (onset, item)) in strokes.onsets().zip(items).enumerate() {
        let Some(trigger) = item.trigger else { continue };
        if let Some((earlier, end)) = before
            && onset.0 <= end
        {
            let over_ms = rate.ticks_to_ms(end - onset.0 + 1);
            let detail = format!(
                "`items[{earlier}]`: its trigger lasts {over_ms:.2} ms too long for that of `items[{number}]`: give it a smaller \
                 `width_ms`, or one of both `\"trigger\": false`"
            );
            return Err(Problem::new(Code::BadRequest, detail));
        }
        let cells = if trigger.code > 0 { 10 } else { 1 };
        before = Some((number, onset.0 + cells * u64::from(trigger.width)));
    }
    Ok(())
}

/// Bursts and pulses; `None` if counting them would take too long.
fn counts(strokes: &Strokes) -> Option<OrderedCounts> {
    let (mut bursts, mut pulses) = (0, 0);
    for stroke in strokes.clone().map_while(Result::ok) {
        (bursts, pulses) = (bursts + 2, pulses + u64::from(stroke.pulses()));
        if bursts > 2 * COUNTED as u64 {
            return None;
        }
    }
    Some(OrderedCounts { bursts, pulses: Some(pulses) })
}

/// Identifies sequences of the same name: the SHA-256 of the items as JSON.
fn sha256(items: &[SequenceItem]) -> String {
    // Parsed items can be written.
    let json = serde_json::to_vec(items).unwrap_or_default();
    hash(&json)
}

impl Engine {
    /// Begins a sequence and waits until the streamer accepts it.
    pub(in crate::daemon) async fn sequence<P, F: Future<Output = Result<(Stored, P), Problem>>>(
        &self,
        request: &SequenceRequest,
        client: Peer,
        find: impl Fn(String, Option<String>) -> F,
    ) -> Result<PlayAccepted, Problem> {
        let basis = self.compiles_for(request.boot)?;
        let terms = Terms::from(request);
        let compiled = Compiled::of_sequence(request, &terms, basis, client, find).await?;
        let session = request.session.as_deref();
        self.begin(&terms, compiled, |state| state.check_before_play(session), |_, _| {}).await
    }
}
