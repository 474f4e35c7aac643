//! Compiles an order: finds its patterns one by one, compiles each once for each scale, and places its items.
//!
//! A play holds strokes, not patterns; until it is accepted, it also holds some texts for the session record.
//!
//! Invariant: an order is accepted as a whole or refused, with the number of the item that is wrong.

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::Lane;
use crate::daemon::exposure::limits::check_limits;
use crate::daemon::plays::begin;
use crate::daemon::plays::begin::{Basis, Compiled};
use crate::daemon::plays::state::{NewPlay, check_samples};
use crate::daemon::sessions::caller::Asker;
use crate::exposure::Vibration;
use crate::receipts::{Outline, PlannedItem, fit, motions, motions_of_items, too_slow};
use crate::record::Peer;
use crate::store::{Stored, hash};
use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_api::{
    Code, FollowedMotion, Item, Order, OrderedCounts, PlayAccepted, Problem, Receipt, TriggerRequest,
    TriggerShape,
};
use meissner_array::motion::TRIED_S;
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::{
    self, CompiledItem, Sequence, SequenceError, Start, StrokeOptions, Strokes, Surplus,
};
use meissner_array::units::TickRate;
use meissner_stream::queues::{HOLD_ALWAYS, Item as Played, Play};
use meissner_stream::{Bandwidth, Hold, Settings, dry_run};
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::future::Future;
use std::sync::Arc;

/// The name of a play of several items without one.
const NAME: &str = "sequence";
/// The part of an item that is used to compute its bandwidth, s.
const COUNTED_S: f64 = 60.0;
/// So many patterns, each with a scale, are tried and measured as far as that of a single play; more of them share the time.
const MOST_TRIED: f64 = 16.0;
/// Bytes of texts that a play of several items holds for the session record, at most. Further ones are kept with a later play.
const MAX_TEXTS: usize = 4 << 20;
/// Motors that are too slow have so many lines among the warnings, at most; `motions` has all.
const MAX_LINES: usize = 4;
/// A pin may stay above rest without a pulse for so much longer than planned, ms: moves may be corrected or lost.
const SPARE_MS: u64 = 500;

/// A pattern of an order while it is prepared.
struct Used {
    sha256: Arc<str>,
    name: Arc<str>,
    /// What the play has of it, by scale.
    compiled: HashMap<u64, OfScale>,
    /// What its longest item requires at the largest amplitude.
    bandwidth: Bandwidth,
}

/// A pattern compiled for a scale.
struct OfScale {
    compiled: CompiledItem,
    /// Its largest amplitudes, as [`Outline::largest_um`] has them.
    amplitude_um: [f64; 2],
    /// How its motors follow their motions.
    motions: Arc<[FollowedMotion]>,
}

/// The state of an order while it is prepared.
struct Preparing {
    settings: Settings,
    sequence: Sequence,
    /// Of the one pattern of a play whose receipt lists no items.
    one: Option<Outline>,
    is_one: bool,
    warnings: Vec<String>,
    /// A line for each motor that is too slow.
    slow: Vec<String>,
    largest: ([f64; 2], String),
    reach: PerMotor<f64>,
    surplus: Surplus,
    fit: strokes::Fit,
    /// How much of the motions of a pattern is tried, s.
    tried_s: f64,
}

/// The strokes of all items, and what they need.
struct Placed {
    strokes: Strokes,
    items: Vec<Played>,
    spans: Vec<(u64, u64)>,
    bandwidth: Bandwidth,
    hold: u32,
    unchecked: Option<String>,
    vibration: Vibration,
    counts: Option<OrderedCounts>,
}

impl Compiled {
    /// Compiles an order; `find` finds a pattern, which is dropped before the next.
    pub(in crate::daemon) async fn of_order<P, F: Future<Output = Result<(Stored, P), Problem>>>(
        order: &Order,
        (settings, surplus, reach): Basis,
        client: Peer,
        lane: &'static Lane,
        find: impl Fn(String, Option<String>) -> F,
    ) -> Result<Self, Problem> {
        let Order { name, items: asked, terms } = order;
        let one = order.one();
        let scales: HashSet<_> = asked.iter().map(|item| (text(item), scale(item).to_bits())).collect();
        let mut preparing = Preparing {
            settings,
            sequence: Sequence::new(settings.array),
            one: None,
            is_one: one.is_some(),
            warnings: Vec::new(),
            slow: Vec::new(),
            largest: ([0.0; 2], String::new()),
            reach,
            surplus,
            fit: fit(terms.fit),
            tried_s: TRIED_S * (MOST_TRIED / scales.len().max(1) as f64).min(1.0),
        };
        let mut by_text: HashMap<_, Vec<(usize, Item)>> = HashMap::new();
        for (number, item) in asked.iter().enumerate() {
            by_text.entry(text(item)).or_default().push((number, item.clone()));
        }
        let mut used: HashMap<(&str, Option<&str>), Used> = HashMap::new();
        let (mut memory, mut required) = (Vec::new(), Vec::new());
        let (mut planned, mut placed, mut followed) = (Vec::new(), Vec::new(), Vec::new());
        let (mut texts, mut held) = (Vec::new(), 0);
        for (number, item) in asked.iter().enumerate() {
            let at = |problem| order.at(number, problem);
            let Some(text) = text(item) else {
                placed.push(None);
                required.push(Bandwidth::default());
                planned.push(PlannedItem::blank());
                continue;
            };
            if let Entry::Vacant(new) = used.entry(text) {
                let found = find(text.0.to_owned(), item.pattern_sha256.clone()).await;
                let (stored, _place) = found.map_err(at)?;
                stored.check_array(settings.array).map_err(|error| at(error.into()))?;
                memory.push((stored.sha256.clone(), stored.pattern.motion_bytes()));
                check_samples(memory.iter().map(|(_, bytes)| bytes).sum())?;
                let items = by_text.remove(&Some(text)).unwrap_or_default();
                let (sha256, name) = (stored.sha256.as_str().into(), stored.pattern.name().into());
                if preparing.is_one || held + stored.text.len() <= MAX_TEXTS {
                    held += stored.text.len();
                    texts.push((stored.sha256.clone(), Arc::clone(&stored.text)));
                }
                let (back, compiled) = lane
                    .computing(move || {
                        let compiled = preparing.compile(&stored, &items);
                        (preparing, compiled)
                    })
                    .await?;
                preparing = back;
                let (compiled, bandwidth) =
                    compiled.map_err(|(number, problem)| order.at(number, problem))?;
                new.insert(Used { sha256, name, compiled, bandwidth });
            }
            let Some(Used { sha256, name, compiled, bandwidth }) = used.get(&text) else { continue };
            let scale = scale(item);
            let Some(of) = compiled.get(&scale.to_bits()) else { continue };
            if terms.strict
                && let Some(line) = of.motions.iter().find_map(|motion| too_slow(motion, settings.array))
            {
                let detail = format!("`{name}`: {line}, or play it without `strict`");
                return Err(at(Problem::new(Code::TooSlow, detail)));
            }
            placed.push(Some(of.compiled));
            followed.push((number, Arc::clone(&of.motions)));
            required.push(*bandwidth);
            let (pattern, sha256) = (Arc::clone(name), Arc::clone(sha256));
            planned.push(PlannedItem {
                pattern,
                sha256,
                scale,
                amplitude_um: Some(of.amplitude_um),
                span: (0, None),
            });
        }
        let (items, hold_ms) = (asked.clone(), terms.hold_ms);
        let (preparing, placed) = lane
            .computing(move || {
                let placed = preparing.place(&items, &placed, required, hold_ms);
                placed.map(|placed| (preparing, placed))
            })
            .await?
            .map_err(|(number, problem)| {
                number.map_or(problem.clone(), |number| order.at(number, problem))
            })?;
        let Preparing { one: prepared, warnings, slow, largest, reach, .. } = preparing;
        let Placed { strokes, items, spans, bandwidth, hold, unchecked, vibration, counts } = placed;
        let rate = settings.array.rate();
        for (item, span) in planned.iter_mut().zip(&spans) {
            item.span = (span.0, Some(span.1).filter(|_| strokes.end().is_some()));
        }
        let mut receipt = match (one, planned.first()) {
            (Some(_), Some(of)) => Receipt::new(&of.pattern, &of.sha256, 1, terms),
            _ => Receipt::new(name.as_deref().unwrap_or(NAME), &sha256(asked), asked.len(), terms),
        };
        let of_items = followed.iter().map(|(number, motions)| {
            (rate.ticks_to_seconds(spans.get(*number).map_or(0, |span| span.0)), &**motions)
        });
        receipt.reach.motions = motions_of_items(of_items);
        let whole = || {
            let length_ms = strokes.end().map(|end| rate.ticks_to_ms(end));
            Outline { ordered_ms: length_ms, compiled_ms: length_ms, ..Outline::default() }
        };
        let outline = prepared.unwrap_or_else(whole);
        Outline { warnings, ..outline }.enter(&mut receipt, counts);
        receipt.reach.warnings.splice(0..0, unchecked.into_iter().chain(slow.into_iter().take(MAX_LINES)));
        Ok(Self {
            play: Play { items, bandwidth, hold, ..begin::ordered(strokes, terms) },
            settings,
            vibration,
            endless: terms.endless,
            reach,
            largest,
            memory,
            new: NewPlay { receipt, items: planned.into(), client },
            texts,
        })
    }
}

impl Preparing {
    fn options(&self, scale: f64, seconds: Option<f64>) -> StrokeOptions {
        let Self { fit, tried_s, .. } = *self;
        let surplus = self.surplus.clone();
        StrokeOptions { scale, surplus, fit, tried_s, ..StrokeOptions::lasting(seconds) }
    }

    /// Compiles a pattern for each scale of the items that play it.
    fn compile(
        &mut self,
        stored: &Stored,
        items: &[(usize, Item)],
    ) -> Result<(HashMap<u64, OfScale>, Bandwidth), (usize, Problem)> {
        let (name, pattern, array) = (stored.pattern.name(), &*stored.pattern, self.settings.array);
        let own_s = items.first().filter(|_| self.is_one).and_then(|(_, item)| item.seconds);
        let mut compiled: HashMap<u64, OfScale> = HashMap::new();
        for (number, item) in items {
            let bad = |error: SequenceError| (*number, refused(&error));
            let scale = scale(item);
            let options = self.options(scale, own_s);
            if let Entry::Vacant(new) = compiled.entry(scale.to_bits()) {
                let outline = Outline::of(pattern, &options).map_err(|error| bad(error.into()))?;
                // An empty play would begin at the same tick as the next one, and their results could not be told apart.
                if let Some(why) = outline.empty() {
                    let detail = format!("`{name}`: no stroke would be played: {why}");
                    return Err((*number, Problem::new(Code::Empty, detail)));
                }
                let amplitude_um = outline.largest_um();
                let compiled = self.sequence.compile(pattern, &options).map_err(bad)?;
                let motions: Arc<[_]> = motions(&self.sequence.followed(compiled)).into();
                let prefix = if self.is_one { String::new() } else { format!("`{name}`: ") };
                let slow = motions.iter().filter_map(|motion| too_slow(motion, array));
                self.slow.extend(slow.map(|line| format!("{prefix}{line}")));
                let lines = if self.is_one { outline.warnings.clone() } else { outline.listed_warnings() };
                self.warnings.extend(lines.iter().map(|line| format!("{prefix}{line}")));
                new.insert(OfScale { compiled, amplitude_um, motions });
                if self.is_one {
                    self.one = Some(outline);
                }
            }
        }
        let most = items.iter().map(|(_, item)| scale(item)).fold(0.0, f64::max);
        let largest_um = largest_um(pattern, most, &self.reach);
        if largest_um[1] > self.largest.0[1] || self.largest.1.is_empty() {
            self.largest = (largest_um, name.to_owned());
        }
        if self.is_one {
            return Ok((compiled, Bandwidth::default()));
        }
        // The bandwidth of the longest item at the largest amplitude suffices for each of them.
        let lasting = |(_, item): &(usize, Item)| item.seconds.or(pattern.duration_s()).unwrap_or(COUNTED_S);
        let longest_s = items.iter().map(lasting).fold(0.0, f64::max).min(COUNTED_S);
        let strokes = Strokes::new(pattern, &self.options(most, Some(longest_s)));
        let strokes = strokes.map_err(|error| (items[0].0, refused(&error.into())))?;
        Ok((compiled, Bandwidth::of(&strokes, &self.settings)))
    }

    /// Places the items, and checks the whole. An error has the number of its item, if it is of one.
    fn place(
        &mut self,
        items: &[Item],
        compiled: &[Option<CompiledItem>],
        required: Vec<Bandwidth>,
        hold_ms: Option<f64>,
    ) -> Result<Placed, (Option<usize>, Problem)> {
        let (rate, settings) = (self.settings.array.rate(), self.settings);
        let mut sequence = std::mem::replace(&mut self.sequence, Sequence::new(settings.array));
        for (number, (item, compiled)) in items.iter().zip(compiled).enumerate() {
            let start = match (item.gap_ms, item.start_ms) {
                (_, Some(ms)) => Start::At(ms),
                (gap_ms, None) => Start::Gap(gap_ms.unwrap_or(0.0)),
            };
            let added = match compiled {
                Some(compiled) => sequence.add(*compiled, item.seconds, start),
                None => sequence.add_blank(item.seconds.unwrap_or(0.0), start),
            };
            added.map_err(|error| (Some(number), refused(&error)))?;
        }
        let spans: Vec<_> = sequence.spans().collect();
        // A checked order has at least one item.
        let strokes = sequence
            .strokes()
            .ok_or_else(|| (None, Problem::new(Code::BadRequest, "`items` is empty: add an item")))?;
        let items: Vec<_> = triggers(items.iter().map(|item| item.trigger), &spans, rate);
        let whole = |problem| (None, problem);
        check_triggers(&strokes, &items, rate).map_err(whole)?;
        let found = dry_run(&strokes, &settings);
        check_limits(&found, &settings).map_err(whole)?;
        let (hold, unchecked, vibration) = hold(hold_ms, &strokes, &found.hold, &settings).map_err(whole)?;
        let bandwidth = Bandwidth::of(&strokes, &settings).max(peak(spans.iter().copied().zip(required)));
        let counts = found.counts.map(|(bursts, pulses)| OrderedCounts { bursts, pulses });
        Ok(Placed { strokes, items, spans, bandwidth, hold, unchecked, vibration, counts })
    }
}

/// The trigger output's pulse for a request.
pub(in crate::daemon) fn trigger(request: Option<TriggerRequest>, rate: TickRate) -> Option<Trigger> {
    let shape = match request {
        Some(TriggerRequest::Off) => return None,
        Some(TriggerRequest::On(shape)) => shape,
        None => TriggerShape::default(),
    };
    let width = rate.ms_in_ticks(shape.width_ms()).round() as u16;
    Some(Trigger { width, code: shape.code.unwrap_or(0) })
}

/// The items as the streamer plays them. A pulse by default ends before the next item.
fn triggers(
    asked: impl Iterator<Item = Option<TriggerRequest>>,
    spans: &[(u64, u64)],
    rate: TickRate,
) -> Vec<Played> {
    let item = |(number, asked): (usize, Option<TriggerRequest>)| {
        let mut pulse = trigger(asked, rate);
        if asked.is_none()
            && let (Some(pulse), [(onset, _), (next, _), ..]) = (&mut pulse, &spans[number..])
        {
            pulse.width = pulse.width.min(u16::try_from((next - onset) / 2).unwrap_or(u16::MAX));
        }
        Played::new(pulse)
    };
    asked.enumerate().map(item).collect()
}

/// Refuses a trigger that would still be on its way when the next one begins.
fn check_triggers(strokes: &Strokes, items: &[Played], rate: TickRate) -> Result<(), Problem> {
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

/// The largest amplitude that a pattern orders at a scale, and how far pins may go for it, µm.
fn largest_um(pattern: &Pattern, scale: f64, reach: &[f64]) -> [f64; 2] {
    let reach = |motor| reach.get(usize::from(motor)).copied().unwrap_or(1.0);
    [pattern.largest_um(), pattern.largest_reached_um(reach)].map(|um| um * scale)
}

/// How long the device may let a pin stay above rest without a pulse, ticks: as asked, or as long as the plan needs. A line if the play is
/// too long for the checks before it begins. And when it vibrates.
fn hold(
    asked_ms: Option<f64>,
    strokes: &Strokes,
    found: &Hold,
    settings: &Settings,
) -> Result<(u32, Option<String>, Vibration), Problem> {
    let rate = strokes.array().rate();
    let vibration = Vibration::of(found, strokes.end(), settings);
    let Hold { longest: needed, counted_until, .. } = *found;
    let unchecked = counted_until.map(|until| {
        format!(
            "the limits on pulses, moves and holds are checked for the first {:.1} s, as far as the daemon counts moves before a play; \
             the device refuses what breaks them later",
            rate.ticks_to_seconds(until.0)
        )
    });
    let most = u64::from(strokes.array().layout().longest_hold());
    if needed > most {
        let (needed_s, most_s) = (rate.ticks_to_seconds(needed), rate.ticks_to_seconds(most));
        let detail = format!(
            "a pin would stay at one height above rest for {needed_s:.1} s, and the device lets it for {most_s:.0} s: let it move or rest in between"
        );
        return Err(Problem::new(Code::BadPattern, detail));
    }
    let Some(ms) = asked_ms else {
        let enough = u32::try_from(needed + rate.of_ms(SPARE_MS)).unwrap_or(HOLD_ALWAYS);
        return Ok((if unchecked.is_some() { HOLD_ALWAYS } else { enough }, unchecked, vibration));
    };
    let asked = rate.ms_in_ticks(ms) as u32;
    if u64::from(asked) < needed {
        let needed_ms = rate.ticks_to_ms(needed).ceil();
        let detail =
            format!("`hold_ms` is {ms}: the play keeps a pin above rest for {needed_ms} ms without a pulse");
        return Err(Problem::new(Code::BadRequest, detail));
    }
    Ok((asked, unchecked, vibration))
}

/// The key by which the texts of items differ; `None` for a blank item.
fn text(item: &Item) -> Option<(&str, Option<&str>)> {
    Some((item.pattern.as_ref()?.name(), item.pattern_sha256.as_deref()))
}

fn scale(item: &Item) -> f64 {
    item.scale.unwrap_or(1.0)
}

fn refused(error: &SequenceError) -> Problem {
    let code = if *error == SequenceError::Empty { Code::Empty } else { Code::BadRequest };
    Problem::new(code, error.to_string())
}

/// Identifies plays of several items of the same name: the SHA-256 of the items as JSON.
fn sha256(items: &[Item]) -> String {
    // Parsed items can be written.
    hash(&serde_json::to_vec(items).unwrap_or_default())
}

/// Begins a play and waits until the streamer accepts it.
pub(in crate::daemon) async fn play<P, F: Future<Output = Result<(Stored, P), Problem>>>(
    engine: &Engine,
    by: &Asker,
    order: &Order,
    lane: &'static Lane,
    find: impl Fn(String, Option<String>) -> F,
) -> Result<PlayAccepted, Problem> {
    let basis = begin::compiles_for(engine, order.terms.boot, order.terms.open_loop)?;
    let compiled = Compiled::of_order(order, basis, by.peer(), lane, find).await?;
    let session = order.terms.session.as_deref();
    begin::begin(engine, by, compiled, |state| begin::check(state, session), |_, _| {}).await
}
