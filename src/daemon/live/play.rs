//! Live plays: begins one, whose client then moves it by messages, and carries out the messages.
//!
//! A message goes under the engine's lock to the streamer ([`LivePlays::change`](crate::daemon::live::state::LivePlays::change)).
//!
//! Invariant: a message changes nothing if its client may not operate at that moment.

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::PLAYS;
use crate::daemon::core::state::State;
use crate::daemon::live::state::LivePlay;
use crate::daemon::plays::begin;
use crate::daemon::plays::begin::Compiled;
use crate::daemon::plays::order::trigger;
use crate::daemon::plays::state::NewPlay;
use crate::daemon::sessions::caller::Asker;
use crate::daemon::sessions::right::Right;
use crate::exposure::Vibration;
use crate::receipts::PlannedItem;
use crate::store::hash;
use meissner_api::{
    Code, LIVE_TIMEOUT_MS, LIVE_UPDATES_HZ, LiveAccepted, LiveAnswer, LiveMessage, LivePose, LiveRecord,
    LiveRequest, Problem, Receipt,
};
use meissner_array::motor::MotorError;
use meissner_array::spec::Array;
use meissner_array::strokes::{LiveStrokes, StrokeOptions};
use meissner_render::Poses;
use meissner_stream::queues::{Command, Item, Play};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Source};
use meissner_touch::{Object, Pose as TouchPose};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

/// The pattern name of a live play in its receipt.
const LIVE: &str = "live";
/// How soon the daemon again orders the end of a play, if it could not do so before.
const END_AGAIN: Duration = Duration::from_millis(100);

/// Begins a live play and waits until the streamer accepts it.
pub(in crate::daemon) async fn start_live(
    engine: &Engine,
    by: &Asker,
    request: &LiveRequest,
    object: Option<Object>,
) -> Result<LiveAccepted, Problem> {
    let (settings, surplus, reach) = begin::compiles_for(engine, None, request.terms.open_loop)?;
    let options = StrokeOptions { scale: request.scale.unwrap_or(1.0), surplus, ..StrokeOptions::default() };
    let most_hz = request.most_hz();
    let mut live = LivePlay::new(settings.array, &request.drives, options, most_hz)?;
    live = live.with_levels(request.levels).with_open_loop(request.terms.open_loop);
    let levels = request.levels || object.is_some();
    live = live.with_heights(heights(engine, settings.array, object, &reach).await?);
    live.check_at_once(&settings)?;
    let waves = live.waves()?;
    let updates_hz = request.updates_hz.unwrap_or(LIVE_UPDATES_HZ);
    // This iterates over a minute of strokes.
    let bandwidth = PLAYS
        .computing(move || {
            let drives = Bandwidth::of_live(most_hz, updates_hz, &settings)?;
            Ok::<_, MotorError>(if levels { drives.with_levels(settings.array) } else { drives })
        })
        .await?
        .map_err(|error| Problem::new(Code::BadRequest, error.to_string()))?;
    let timeout = Duration::from_secs_f64(request.timeout_ms.unwrap_or(LIVE_TIMEOUT_MS) / 1000.0);
    let terms = &request.terms;
    // Plain data can be written.
    let sha256 = hash(&serde_json::to_vec(request).unwrap_or_default());
    let receipt = Receipt::new(LIVE, &sha256, 1, terms);
    let receipt = Receipt { live: Some(LiveRecord::default()), ..receipt };
    let item = PlannedItem {
        pattern: LIVE.into(),
        sha256: sha256.into(),
        scale: request.scale.unwrap_or(1.0),
        amplitude_um: None,
        span: (0, None),
    };
    let compiled = Compiled {
        play: Play {
            items: vec![Item::new(trigger(request.trigger, settings.array.rate()))],
            live: Some(timeout),
            bandwidth,
            ..begin::ordered(Source::Live(Box::new(LiveStrokes::new(waves))), terms)
        },
        settings,
        vibration: Vibration::without_end(&settings),
        endless: true,
        reach,
        memory: Vec::new(),
        largest: (live.largest_um(&reach), "the live play".to_owned()),
        new: NewPlay { receipt, items: [item].into(), client: by.peer() },
        texts: Vec::new(),
    };
    let path = format!("/v1/live/{}", live.key());
    let session = terms.session.as_deref();
    let sent = |state: &mut State, id| state.live.add(id, live);
    let accepted = begin::begin(engine, by, compiled, |state| begin::check(state, session), sent).await?;
    Ok(LiveAccepted { id: accepted.id, path })
}

/// Solves the contact of an object. Plays of stored patterns do not wait for it. No pin goes above what participants may get.
async fn heights(
    engine: &Engine,
    array: Array,
    object: Option<Object>,
    reach: &[f64],
) -> Result<Option<Arc<Poses>>, Problem> {
    let Some(object) = object else { return Ok(None) };
    let most_mm =
        engine.lock().exposure.most_amplitude_um() / reach.iter().copied().fold(1.0, f64::max) / 1000.0;
    let made = PLAYS.computing(move || Poses::new(array, &object)).await?;
    made.map(|heights| Some(Arc::new(heights.at_most(most_mm))))
        .map_err(|error| Problem::new(Code::BadRequest, error.to_string()))
}

/// Carries out a message, if its client still may send it; returns the answer if it is known at once.
pub(in crate::daemon) fn live_message(
    engine: &Engine,
    right: &Right,
    id: u64,
    text: &[u8],
    received_at: HostInstant,
) -> Option<LiveAnswer> {
    let message = match LiveMessage::parse(text) {
        Ok(message) => message,
        Err(problem) => return Some(LiveAnswer::refused(LiveMessage::seq(text), problem)),
    };
    // Without the lock: a pose takes some tens of microseconds.
    let heights = engine.lock().live.heights(id);
    let seq = message.seq;
    let message = match heights.map_or(Ok(message.clone()), |heights| touched(message, &heights)) {
        Ok(message) => message,
        Err(problem) => return Some(LiveAnswer::refused(Some(seq), problem)),
    };
    if message.end {
        end_live(engine, id);
        return None;
    }
    let mut state = engine.lock();
    let allowed = state.check_right(&right.caller, right.access).map_err(|no| no.problem);
    let result = allowed.and_then(|()| {
        state.hear(&right.caller);
        let reach = [false, true].map(|open_loop| state.reach(open_loop));
        let State { live, commands, settings, exposure, .. } = &mut *state;
        let check = |play: &LivePlay| {
            exposure.check_amplitude("the live play", play.largest_um(&reach[usize::from(play.open_loop)]))
        };
        live.change(id, &message, received_at, settings, check, commands)
    });
    result.err().map(|problem| LiveAnswer::refused(Some(message.seq), problem))
}

/// Ends a live play once the client of its connection may not move it any more. The future never completes; drop it to stop.
pub(in crate::daemon) async fn end_with(engine: &Engine, right: &Right, id: u64) -> Infallible {
    let lost = right.ended().await;
    loop {
        // Repeat, in case too many commands waited before.
        engine.lock().cancel_play(id, lost.cause.clone());
        tokio::time::sleep(END_AGAIN).await;
    }
}

/// Ends a live play. If too many commands wait, its client counts as silent soon.
pub(in crate::daemon) fn end_live(engine: &Engine, id: u64) {
    let _ = engine.lock().commands.send_unanswered(Command::EndLive(id));
}

/// A message to a live object: its pose becomes levels of all pins.
fn touched(message: LiveMessage, heights: &Poses) -> Result<LiveMessage, Problem> {
    let bad = |detail: String| Problem::new(Code::BadRequest, detail);
    if message.drives.is_some() || !message.um.is_empty() {
        return Err(bad(
            "`drives` and `um`: this live play has an object, whose poses decide: send `pose`".into()
        ));
    }
    let Some(LivePose { x_mm, y_mm, angle_deg, depth_um }) = message.pose else { return Ok(message) };
    let depth_mm = depth_um.map_or(heights.depth_mm(), |um| um / 1000.0);
    let heights_mm = heights
        .heights_mm(&TouchPose { x_mm, y_mm, angle_deg, depth_mm })
        .map_err(|error| bad(error.to_string()))?;
    // Whole hundredths, rounded down: none is above the travel by a last bit.
    let um = heights_mm.into_iter().map(|mm| (mm * 1e5).floor() / 100.0);
    Ok(LiveMessage { pose: None, um: (0..).zip(um).collect(), ..message })
}
