//! Plays of many patterns: compiles the patterns of a sequence one by one, and begins all items as one play.
//!
//! [`Compiled::of_sequence`] finds each pattern, compiles it once for each scale, and drops it again. A sequence holds strokes, not patterns;
//! until it is accepted, it also holds some texts for the session record.
//!
//! Invariant: a sequence is accepted as a whole or refused, with the number of the item that is wrong.

use crate::daemon::engine::Engine;
use crate::daemon::plays::begin::{Basis, Compiled};
use crate::daemon::plays::pattern::{hold, largest_um};
use crate::daemon::plays::terms::{Terms, trigger};
use crate::daemon::state::limits::check_limits;
use crate::daemon::state::{NewPlay, check_samples};
use crate::daemon::system::runtime::{CHECKS, Lane, PLAYS};
use crate::receipts::{BLANK, Order, PlannedItem, motions, motions_of_items, too_slow, walk};
use crate::session_record::Peer;
use crate::store::{Stored, hash};
use firmware_protocol::tick::Tick;
use meissner_api::{
    Code, Fit, FollowedMotion, PlanCheck, PlanStop, PlayAccepted, Problem, SequenceItem, SequenceRequest,
};
use meissner_array::motion::TRIED_S;
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::{
    CompiledItem, Sequence, SequenceError, Start, StrokeOptions, Strokes, Surplus,
};
use meissner_array::units::TickRate;
use meissner_stream::queues::Item;
use meissner_stream::{Bandwidth, Drift, Settings, Source, forecast_drift};
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::future::Future;
use std::sync::Arc;

/// The name of a sequence without one.
const NAME: &str = "sequence";
/// The part of an item that is used to compute its bandwidth, s.
const COUNTED_S: f64 = 60.0;
/// So many patterns, each with a scale, are tried and measured as far as that of a single play; more of them share the time.
const MOST_TRIED: f64 = 16.0;
/// Bytes of texts that a sequence holds for the session record, at most. Further ones are kept with a later play.
const MAX_TEXTS: usize = 4 << 20;

/// A pattern of a sequence while it is prepared.
struct Used {
    sha256: Arc<str>,
    name: Arc<str>,
    /// What the sequence plays of it, by scale.
    compiled: HashMap<u64, OfScale>,
    /// What its longest item requires at the largest amplitude.
    bandwidth: Bandwidth,
}

/// The state of a request while it is prepared.
struct Preparing {
    sequence: Sequence,
    warnings: Vec<String>,
    largest: ([f64; 2], String),
    reach: PerMotor<f64>,
    surplus: Surplus,
    /// How much of the motions of a pattern is tried, s.
    tried_s: f64,
}

impl Compiled {
    /// Compiles a sequence; `find` finds a pattern, which is dropped before the next.
    async fn of_sequence<P, F: Future<Output = Result<(Stored, P), Problem>>>(
        request: &SequenceRequest,
        terms: &Terms,
        (settings, surplus, reach): Basis,
        client: Peer,
        lane: &'static Lane,
        find: impl Fn(String, Option<String>) -> F,
    ) -> Result<Self, Problem> {
        let mut preparing = Preparing {
            sequence: Sequence::new(settings.array),
            warnings: Vec::new(),
            largest: ([0.0; 2], String::new()),
            reach,
            surplus,
            tried_s: TRIED_S,
        };
        let mut by_text: HashMap<_, Vec<SequenceItem>> = HashMap::new();
        for item in &request.items {
            if let Some(text) = text(item) {
                by_text.entry(text).or_default().push(item.clone());
            }
        }
        let scales: HashSet<_> =
            request.items.iter().map(|item| (text(item), scale(item).to_bits())).collect();
        preparing.tried_s *= (MOST_TRIED / scales.len().max(1) as f64).min(1.0);
        let mut used: HashMap<(&str, Option<&str>), Used> = HashMap::new();
        let (blank, no_sha256): (Arc<str>, Arc<str>) = (BLANK.into(), "".into());
        let (mut memory, mut required) = (Vec::new(), Vec::new());
        let (mut planned, mut placed, mut followed) = (Vec::new(), Vec::new(), Vec::new());
        let (mut texts, mut held) = (Vec::new(), 0);
        for (number, item) in request.items.iter().enumerate() {
            let at = |problem| at_item(number, problem);
            let start = match (item.gap_ms, item.start_ms) {
                (_, Some(ms)) => Start::At(ms),
                (gap_ms, None) => Start::Gap(gap_ms.unwrap_or(0.0)),
            };
            let Some(text) = text(item) else {
                placed.push((None, item.seconds, start));
                required.push(Bandwidth::default());
                let (pattern, sha256) = (Arc::clone(&blank), Arc::clone(&no_sha256));
                planned.push(PlannedItem {
                    pattern,
                    sha256,
                    scale: 1.0,
                    amplitude_um: [0.0; 2],
                    span: (0, 0),
                });
                continue;
            };
            let name = text.0;
            if let Entry::Vacant(new) = used.entry(text) {
                let found = find(name.to_owned(), item.pattern_sha256.clone()).await;
                let (stored, _place) = found.map_err(at)?;
                stored.check_array(settings.array).map_err(|error| at(error.into()))?;
                memory.push((stored.sha256.clone(), stored.pattern.motion_bytes()));
                check_samples(memory.iter().map(|(_, bytes)| bytes).sum())?;
                let items = by_text.remove(&text).unwrap_or_default();
                let (sha256, name) = (stored.sha256.as_str().into(), name.into());
                if held + stored.text.len() <= MAX_TEXTS {
                    held += stored.text.len();
                    texts.push((stored.sha256.clone(), Arc::clone(&stored.text)));
                }
                let (back, compiled) = lane
                    .computing(move || {
                        let compiled = preparing.compile(&stored, &items, &settings);
                        (preparing, compiled)
                    })
                    .await?;
                preparing = back;
                let (compiled, bandwidth) = compiled.map_err(|error| at(refused(&error)))?;
                new.insert(Used { sha256, name, compiled, bandwidth });
            }
            let (Some(Used { sha256, name, compiled, bandwidth }), scale) = (used.get(&text), scale(item))
            else {
                continue;
            };
            let Some(OfScale { compiled, amplitude_um, motions }) = compiled.get(&scale.to_bits()) else {
                continue;
            };
            let (compiled, amplitude_um) = (*compiled, *amplitude_um);
            if request.strict
                && let Some(line) = motions.iter().find_map(|motion| too_slow(motion, settings.array))
            {
                let detail = format!("`{name}`: {line}, or play the sequence without `strict`");
                return Err(at(Problem::new(Code::TooSlow, detail)));
            }
            placed.push((Some(compiled), item.seconds, start));
            followed.push((number, Arc::clone(motions)));
            required.push(*bandwidth);
            let (pattern, sha256) = (Arc::clone(name), Arc::clone(sha256));
            planned.push(PlannedItem { pattern, sha256, scale, amplitude_um, span: (0, 0) });
        }
        // Adding an item takes a while for a pattern with many drives.
        let (preparing, added) = lane
            .computing(move || {
                let mut items = placed.into_iter().enumerate();
                let added = items.try_for_each(|(number, (compiled, seconds, start))| {
                    let added = match compiled {
                        Some(compiled) => preparing.sequence.add(compiled, seconds, start),
                        None => preparing.sequence.add_blank(seconds.unwrap_or(0.0), start),
                    };
                    added.map_err(|error| at_item(number, refused(&error)))
                });
                (preparing, added)
            })
            .await?;
        added?;
        let Preparing { sequence, warnings, largest, .. } = preparing;
        let bandwidth = peak(sequence.spans().zip(required));
        let rate = settings.array.rate();
        let onsets: Vec<u64> = sequence.spans().map(|(start, _)| start).collect();
        let item = |(number, item): (usize, &SequenceItem)| {
            let mut pulse = trigger(item.trigger, rate);
            // A pulse by default ends before the next item.
            if item.trigger.is_none()
                && let (Some(pulse), [onset, next, ..]) = (&mut pulse, &onsets[number..])
            {
                pulse.width = pulse.width.min(u16::try_from((next - onset) / 2).unwrap_or(u16::MAX));
            }
            Item::new(pulse)
        };
        let items: Vec<Item> = request.items.iter().enumerate().map(item).collect();
        for (item, span) in planned.iter_mut().zip(sequence.spans()) {
            item.span = span;
        }
        // A checked request has at least one item.
        let strokes = sequence
            .strokes()
            .ok_or_else(|| Problem::new(Code::BadRequest, "`items` is empty: add an item"))?;
        check_triggers(&strokes, &items, rate)?;
        let hold_ms = request.hold_ms;
        let (fits, bandwidth, hold, counts, strokes) = lane
            .computing(move || {
                let bandwidth = Bandwidth::of(&strokes, &settings).max(bandwidth);
                let fits = check_limits(&strokes, &settings);
                (fits, bandwidth, hold(hold_ms, &strokes, &settings), walk(&strokes), strokes)
            })
            .await?;
        fits?;
        let length_ms = strokes.end().map(|end| rate.ticks_to_ms(end));
        let order = Order { ordered_ms: length_ms, compiled_ms: length_ms, warnings, ..Order::default() };
        let name = request.name.as_deref().unwrap_or(NAME);
        let mut receipt = terms.receipt(name, &sha256(&request.items), length_ms.map(|ms| ms / 1e3));
        let of_items = followed.iter().map(|(number, motions)| {
            (rate.ticks_to_seconds(planned.get(*number).map_or(0, |item| item.span.0)), &**motions)
        });
        receipt.motions = motions_of_items(of_items);
        order.enter(&mut receipt, Fit::Whole, counts);
        let (hold, unchecked, vibration) = hold?;
        receipt.warnings.splice(0..0, unchecked);
        Ok(Self {
            strokes: strokes.into(),
            items,
            live: None,
            bandwidth,
            hold,
            settings,
            vibration,
            endless: false,
            reach,
            largest,
            memory,
            new: NewPlay { receipt, items: Some(planned.into()), endless: None, client },
            texts,
        })
    }
}

/// A pattern compiled for a scale.
struct OfScale {
    compiled: CompiledItem,
    /// Its largest amplitudes, as [`Order::largest_um`] has them.
    amplitude_um: [f64; 2],
    /// How its motors follow their motions.
    motions: Arc<[FollowedMotion]>,
}

impl Preparing {
    fn options(&self, scale: f64, seconds: Option<f64>) -> StrokeOptions {
        let (surplus, tried_s) = (self.surplus.clone(), self.tried_s);
        StrokeOptions { scale, surplus, tried_s, ..StrokeOptions::lasting(seconds) }
    }

    /// Compiles a pattern for each scale of the items that play it.
    fn compile(
        &mut self,
        stored: &Stored,
        items: &[SequenceItem],
        settings: &Settings,
    ) -> Result<(HashMap<u64, OfScale>, Bandwidth), SequenceError> {
        let (name, pattern) = (stored.pattern.name(), &*stored.pattern);
        let mut compiled: HashMap<u64, OfScale> = HashMap::new();
        for scale in items.iter().map(scale) {
            let options = self.options(scale, None);
            if let Entry::Vacant(new) = compiled.entry(scale.to_bits()) {
                let amplitude_um = Order::of(pattern, &options)?.largest_um();
                let compiled = self.sequence.compile(pattern, &options)?;
                let motions = motions(&self.sequence.followed(compiled)).into();
                new.insert(OfScale { compiled, amplitude_um, motions });
            }
        }
        let most = items.iter().map(scale).fold(0.0, f64::max);
        let largest_um = largest_um(pattern, most, &self.reach);
        if largest_um[1] > self.largest.0[1] {
            self.largest = (largest_um, name.to_owned());
        }
        // The bandwidth of the longest item at the largest amplitude suffices for each of them.
        let lasting = |item: &SequenceItem| item.seconds.or(pattern.duration_s()).unwrap_or(COUNTED_S);
        let longest_s = items.iter().map(lasting).fold(0.0, f64::max).min(COUNTED_S);
        let options = self.options(most, Some(longest_s));
        let strokes = Strokes::new(pattern, &options)?;
        let largest = compiled.get(&most.to_bits()).map_or(&[][..], |of| &of.motions);
        let slow = largest.iter().filter_map(|motion| too_slow(motion, settings.array));
        let lines = Order::of(pattern, &options)?.listed_warnings().into_iter().chain(slow);
        self.warnings.extend(lines.map(|warning| format!("`{name}`: {warning}")));
        Ok((compiled, Bandwidth::of(&strokes, settings)))
    }
}

/// The most that items at once require: they begin in order of time.
fn peak(items: impl Iterator<Item = ((u64, u64), Bandwidth)>) -> Bandwidth {
    let (mut at_once, mut peak): (Vec<(u64, Bandwidth)>, _) = (Vec::new(), Bandwidth::default());
    for ((start, end), required) in items {
        at_once.retain(|(until, _)| *until > start);
        at_once.push((end, required));
        let sum = at_once.iter().map(|(_, required)| *required).reduce(Bandwidth::plus);
        peak = sum.unwrap_or_default().max(peak);
    }
    peak
}

/// The problem of an item.
fn at_item(number: usize, problem: Problem) -> Problem {
    Problem { detail: format!("`items[{number}]`: {}", problem.detail), ..problem }
}

/// The key by which the texts of items differ; `None` for a blank item.
fn text(item: &SequenceItem) -> Option<(&str, Option<&str>)> {
    Some((item.pattern.as_ref()?.name(), item.pattern_sha256.as_deref()))
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

/// Identifies sequences of the same name: the SHA-256 of the items as JSON.
fn sha256(items: &[SequenceItem]) -> String {
    // Parsed items can be written.
    let json = serde_json::to_vec(items).unwrap_or_default();
    hash(&json)
}

impl Engine {
    /// Tells how far a sequence would let pins drift on a device without telemetry.
    pub(in crate::daemon) async fn check_sequence<P, F: Future<Output = Result<(Stored, P), Problem>>>(
        &self,
        request: &SequenceRequest,
        client: Peer,
        find: impl Fn(String, Option<String>) -> F,
    ) -> Result<PlanCheck, Problem> {
        let basis = self.compiles_for(request.boot, request.open_loop)?;
        let (gains, calibrated) = {
            let state = self.lock();
            (state.gains(), state.calibration.in_use().is_some())
        };
        let settings = basis.0;
        let compiled =
            Compiled::of_sequence(request, &Terms::from(request), basis, client, &CHECKS, find).await?;
        let Source::Compiled(strokes) = compiled.strokes else {
            return Err(Problem::new(Code::BadRequest, "internal error: a sequence is not live"));
        };
        let (rate, end) = (settings.array.rate(), strokes.end().unwrap_or(0));
        let drift = CHECKS.computing(move || forecast_drift(*strokes, &settings, &gains)).await?;
        let Drift { um, motor, stopped_at, followed_until } =
            drift.map_err(|error| Problem::new(Code::BadRequest, error.to_string()))?;
        let planned = compiled.new.items.unwrap_or_default();
        let stopped_at = stopped_at.map(|at| {
            let item = planned.partition_point(|item| item.span.0 <= at).saturating_sub(1);
            let pattern = planned.get(item).map(|item| item.pattern.to_string()).unwrap_or_default();
            PlanStop { item, pattern, after_ms: rate.ticks_to_ms(at) }
        });
        Ok(PlanCheck {
            items: request.items.len(),
            ordered_ms: rate.ticks_to_ms(end),
            drift_um: um,
            drift_limit_um: settings.drift_limit_um,
            motor,
            lower_stop: settings.lower_stop.is_some(),
            calibrated,
            stopped_at,
            followed_ms: followed_until.map(|at| rate.ticks_to_ms(at)),
        })
    }

    /// Begins a sequence and waits until the streamer accepts it.
    pub(in crate::daemon) async fn sequence<P, F: Future<Output = Result<(Stored, P), Problem>>>(
        &self,
        request: &SequenceRequest,
        client: Peer,
        find: impl Fn(String, Option<String>) -> F,
    ) -> Result<PlayAccepted, Problem> {
        let basis = self.compiles_for(request.boot, request.open_loop)?;
        let terms = Terms::from(request);
        let compiled = Compiled::of_sequence(request, &terms, basis, client, &PLAYS, find).await?;
        let session = request.session.as_deref();
        self.begin(&terms, compiled, |state| state.check_before_play(session), |_, _| {}).await
    }
}
