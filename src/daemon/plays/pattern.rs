//! Plays of one pattern: compiles the pattern of a request, and begins the play.

use crate::daemon::engine::Engine;
use crate::daemon::plays::begin::{Basis, Compiled};
use crate::daemon::plays::terms::{Terms, trigger};
use crate::daemon::state::NewPlay;
use crate::daemon::state::limits::check_limits;
use crate::daemon::system::runtime::Lane;
use crate::exposure::Vibration;
use crate::receipts::{Order, counts, fit, motions, too_slow};
use crate::session_record::Peer;
use crate::store::Stored;
use meissner_api::{Code, PlayAccepted, PlayRequest, Problem, Receipt};
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_stream::queues::{HOLD_ALWAYS, Item};
use meissner_stream::{Bandwidth, Hold, Settings, find_longest_hold};

impl Compiled {
    /// Compiles the pattern of a request, on another thread: a pattern may have millions of moves, and other commands must not wait.
    pub(super) async fn of_pattern(
        request: &PlayRequest,
        terms: &Terms,
        stored: Stored,
        basis: Basis,
        client: Peer,
        lane: &'static Lane,
    ) -> Result<Self, Problem> {
        // Its pattern is a name by now.
        let request = request.clone();
        let receipt = terms.receipt(stored.pattern.name(), &stored.sha256, request.seconds);
        lane.computing(move || compile(&request, receipt, stored, basis, client)).await?
    }
}

fn compile(
    asked: &PlayRequest,
    receipt: Receipt,
    stored: Stored,
    (settings, surplus, reach): Basis,
    client: Peer,
) -> Result<Compiled, Problem> {
    stored.check_array(settings.array)?;
    let scale = asked.scale.unwrap_or(1.0);
    let options =
        StrokeOptions { surplus, fit: fit(asked.fit), scale, ..StrokeOptions::lasting(asked.seconds) };
    let bad = |error| Problem::new(Code::BadRequest, format!("`seconds`: {error}"));
    let (pattern, name) = (&*stored.pattern, stored.pattern.name());
    let order = Order::of(pattern, &options).map_err(bad)?;
    // Refuse an empty play: it would begin at the same tick as the next one, and their results could not be told apart.
    let empty = |why| Problem::new(Code::Empty, format!("`{name}`: no stroke would be played: {why}"));
    if let Some(why) = order.empty() {
        return Err(empty(why));
    }
    let strokes = Strokes::new(pattern, &options).map_err(bad)?;
    if strokes.is_over() {
        return Err(empty("its motions are too low, or begin after its end"));
    }
    let array = settings.array;
    let mut receipt = Receipt { scale: Some(scale), motions: motions(&strokes.followed()), ..receipt };
    let slow: Vec<String> = receipt.motions.iter().filter_map(|motion| too_slow(motion, array)).collect();
    if let Some(line) = slow.first().filter(|_| asked.strict) {
        return Err(Problem::new(Code::TooSlow, format!("`{name}`: {line}, or play it without `strict`")));
    }
    check_limits(&strokes, &settings)?;
    let (hold, unchecked, vibration) = hold(asked.hold_ms, &strokes, &settings)?;
    order.enter(&mut receipt, asked.fit, counts(pattern, &options, &strokes));
    let lines = unchecked.into_iter().chain(slow.into_iter().take(MAX_LINES));
    receipt.warnings.splice(0..0, lines);
    let largest = (largest_um(pattern, scale, &reach), name.to_owned());
    let bandwidth = Bandwidth::of(&strokes, &settings);
    let Stored { pattern, sha256, text, .. } = stored;
    let bytes = pattern.motion_bytes();
    let endless = receipt.ordered.is_none().then_some((pattern, options));
    Ok(Compiled {
        strokes: strokes.into(),
        items: vec![Item::new(trigger(asked.trigger, array.rate()))],
        live: None,
        bandwidth,
        hold,
        settings,
        vibration,
        endless: asked.endless,
        reach,
        largest,
        memory: vec![(sha256.clone(), bytes)],
        new: NewPlay { receipt, items: None, endless, client },
        texts: vec![(sha256, text)],
    })
}

/// Motors that are too slow have so many lines among the warnings, at most; `motions` has all.
const MAX_LINES: usize = 4;

/// A pin may stay above rest without a pulse for so much longer than planned, ms: moves may be corrected or lost.
const SPARE_MS: u64 = 500;

/// The largest amplitude that a pattern orders at a scale, and how far pins may go for it, µm.
pub(super) fn largest_um(pattern: &Pattern, scale: f64, reach: &[f64]) -> [f64; 2] {
    let reach = |motor| reach.get(usize::from(motor)).copied().unwrap_or(1.0);
    [pattern.largest_um(), pattern.largest_reached_um(reach)].map(|um| um * scale)
}

/// How long the device may let a pin stay above rest without a pulse, ticks: as asked, or as long as the plan needs. A line if the play is
/// too long for the checks before it begins. And when it vibrates.
pub(super) fn hold(
    asked_ms: Option<f64>,
    strokes: &Strokes,
    settings: &Settings,
) -> Result<(u32, Option<String>, Vibration), Problem> {
    let rate = strokes.array().rate();
    let found = find_longest_hold(strokes);
    let vibration = Vibration::of(&found, strokes.end(), settings);
    let Hold { longest: needed, counted_until, .. } = found;
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

impl Engine {
    /// Begins a play of a pattern and waits until the streamer accepts it.
    pub(in crate::daemon) async fn play(
        &self,
        request: &PlayRequest,
        stored: Stored,
        client: Peer,
        lane: &'static Lane,
    ) -> Result<PlayAccepted, Problem> {
        let basis = self.compiles_for(request.boot, request.open_loop)?;
        let terms = Terms::from(request);
        let compiled = Compiled::of_pattern(request, &terms, stored, basis, client, lane).await?;
        let session = request.session.as_deref();
        self.begin(&terms, compiled, |state| state.check_before_play(session), |_, _| {}).await
    }
}
