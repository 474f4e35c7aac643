//! Begins plays: prepares a request without the lock, then sends it under the lock.
//!
//! [`PreparedPlay::new`] compiles the pattern and evaluates its bandwidth; [`State::begin`] gives the play an id and a receipt and
//! sends it. This module refuses invalid requests, and plays that push a lower stop too much; the streamer refuses plays that the device cannot take.
//!
//! Invariant: a play is in the receipts before the streamer reports anything about it; the id of a refused play goes to the next.

use super::engine::{Engine, TIMEOUT, answer};
use super::runtime::PLAYS;
use super::state::{NewPlay, PlayMode, Plays, Reply, SessionTrial, State};
use crate::exposure::Vibration;
use crate::receipts::{Order, counts, fit};
use crate::session_record::Peer;
use crate::store::Stored;
use firmware_protocol::limits::MAX_DENSE;
use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_api::{Code, OrderedCounts, PlayAccepted, PlayRequest, Problem, TriggerRequest, TriggerShape};
use meissner_array::power::{Group, TooMany};
use meissner_array::strokes::{StrokeOptions, Strokes, Surplus};
use meissner_array::units::{ms_in_ticks, ticks_to_seconds};
use meissner_stream::queues::{At, Command, Item, Play};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Dense, Overpush, Settings, find_dense, find_overpush, find_too_many};
use std::sync::Arc;

/// A play that still needs an id.
#[derive(Debug)]
pub(super) struct PreparedPlay {
    play: Play,
    /// The settings that it was compiled for.
    settings: Settings,
    stored: Stored,
    options: StrokeOptions,
    order: Order,
    counts: Option<OrderedCounts>,
    pub(super) vibration: Vibration,
    trial: SessionTrial,
}

impl PreparedPlay {
    /// Compiles the pattern of a request.
    pub(super) async fn new(
        request: &PlayRequest,
        stored: Stored,
        settings: Settings,
        surplus: Surplus,
    ) -> Result<Self, Problem> {
        let scale = request.scale.unwrap_or(1.0);
        let options = StrokeOptions {
            surplus,
            fit: fit(request.fit),
            scale,
            ..StrokeOptions::lasting(request.seconds)
        };
        let bad = |error| Problem::new(Code::BadRequest, format!("`seconds`: {error}"));
        let strokes = Strokes::new(&stored.pattern, &options).map_err(bad)?;
        let order = Order::of(&stored.pattern, &options).map_err(bad)?;
        // Refuse an empty play: it would begin at the same tick as the next one, and their results could not be told apart.
        if let Some(why) = order.empty() {
            let name = stored.pattern.name();
            return Err(Problem::new(Code::Empty, format!("`{name}`: no stroke would be played: {why}")));
        }
        // Count on another thread: a long pattern has a hundred thousand strokes, and other commands must not wait.
        let (pattern, counted) = (Arc::clone(&stored.pattern), options.clone());
        let (fits, bandwidth, vibration, counts, strokes) = PLAYS
            .computing(move || {
                let end_s = strokes.end().map(ticks_to_seconds);
                let vibration = Vibration::of(&pattern, end_s);
                let bandwidth = Bandwidth::of(&strokes, &settings);
                let fits = check_limits(&strokes, &settings);
                (fits, bandwidth, vibration, counts(&pattern, &counted), strokes)
            })
            .await?;
        fits?;
        let at = onset(request.at_tick, request.at_ms, request.at_monotonic_ns);
        let PlayRequest { late, replace, open_loop, .. } = *request;
        let items = vec![Item::new(trigger(request.trigger))];
        let strokes = strokes.into();
        let play = Play { id: 0, strokes, items, at, late, replace, open_loop, live: None, bandwidth };
        let trial = SessionTrial {
            session: request.session.clone(),
            number: request.trial,
            labels: request.labels.clone(),
        };
        Ok(Self { play, settings, stored, options, order, counts, vibration, trial })
    }
}

impl State {
    /// Gives a play its id and receipt, and sends it to the streamer. Returns the client's answer, and where the
    /// streamer's arrives.
    pub(super) fn begin(
        &mut self,
        prepared: PreparedPlay,
        client: Peer,
    ) -> Result<(PlayAccepted, Reply), Problem> {
        let PreparedPlay { play, settings, stored, options, order, counts, trial, .. } = prepared;
        let Order { ordered_ms, compiled_ms, .. } = order;
        let mode = PlayMode { late: play.late, open_loop: play.open_loop };
        let new = NewPlay { stored, options, order, counts, mode, trial, client };
        let (id, reply) = self.send_play(play, &settings, |plays| plays.add(new))?;
        Ok((PlayAccepted { id, ordered_ms, compiled_ms }, reply))
    }

    /// Refuses a play during a calibration, or for another session than the one that it was prepared for.
    pub(super) fn check_before_play(&mut self, session: Option<&str>) -> Result<(), Problem> {
        self.forget_unanswered();
        self.check_not_calibrating()?;
        if self.session_of_play(session)?.as_deref() == session {
            return Ok(());
        }
        Err(Problem::new(Code::SessionRunning, "a session has begun meanwhile: send the play again"))
    }

    /// Sends a play that was compiled for `compiled_for` under the id that `add` gives it with a receipt. Returns the id and where
    /// the answer arrives.
    pub(super) fn send_play(
        &mut self,
        play: Play,
        compiled_for: &Settings,
        add: impl FnOnce(&mut Plays) -> u64,
    ) -> Result<(u64, Reply), Problem> {
        if !self.publisher.session_record.takes_plays() {
            let detail = "the session record keeps every play and has no room for more at this rate: play less often; see \
                          docs/reference/session-record.md";
            return Err(Problem::new(Code::TooManyPlays, detail));
        }
        if self.settings != *compiled_for {
            return Err(Problem::new(
                Code::Busy,
                "the configuration has changed meanwhile: send the play again",
            ));
        }
        let id = add(&mut self.plays);
        self.rights.add_play(id);
        let sent = self.send(Command::Play(Box::new(Play { id, ..play })), Some(id));
        if sent.is_err() {
            self.settle_play(id, false);
        }
        Ok((id, sent?))
    }
}

impl Engine {
    /// Begins a play and waits until the streamer accepts it.
    pub(super) async fn play(
        &self,
        request: &PlayRequest,
        stored: Stored,
        client: Peer,
    ) -> Result<PlayAccepted, Problem> {
        self.check_boot(request.boot)?;
        let (settings, surplus) = {
            let state = self.lock();
            (state.settings, state.surplus())
        };
        let (sha256, text) = (stored.sha256.clone(), Arc::clone(&stored.text));
        let prepared = PreparedPlay::new(request, stored, settings, surplus).await?;
        let held = self.hold(|state| {
            state.check_before_play(request.session.as_deref())?;
            state.hold_play(request, &prepared.stored.pattern, &prepared.vibration, prepared.play.at)
        });
        let held = held.await?;
        let (accepted, reply) = {
            let mut state = self.lock();
            held.check(&state)?;
            state.check_before_play(request.session.as_deref())?;
            let (accepted, reply) = state.begin(prepared, client)?;
            held.begin(&mut state, accepted.id);
            (accepted, reply)
        };
        // If the streamer refuses a play that replaces others, they go on, so the next order waits for its answer.
        let held = request.replace.then_some(held);
        self.session_record().keep_text(&sha256, &text);
        let answered = answer(reply, TIMEOUT).await;
        drop(held);
        answered?;
        Ok(accepted)
    }

    pub(super) fn check_boot(&self, asked: Option<u32>) -> Result<(), Problem> {
        let now = self.lock().plays.receipts.device().map(|device| device.boot);
        match (asked, now) {
            (Some(asked), Some(now)) if asked != now => {
                let detail =
                    format!("`boot` is {asked}, but the device has restarted as {now}: read its tick again");
                Err(Problem::new(Code::StaleBoot, detail))
            }
            _ => Ok(()),
        }
    }
}

/// Refuses a play with strokes that the controller would refuse.
pub(super) fn check_limits(strokes: &Strokes, settings: &Settings) -> Result<(), Problem> {
    check_density(strokes)?;
    check_pushing(strokes, settings)?;
    check_at_once(strokes, settings)
}

fn check_density(strokes: &Strokes) -> Result<(), Problem> {
    let Some(Dense { at_s }) = find_dense(strokes) else { return Ok(()) };
    let detail = format!(
        "more than {MAX_DENSE} strokes of all motors would begin within 10 ms, first after {at_s:.4} s; the controller allows no more: \
         make drives, repeats or items longer, or drive fewer motors"
    );
    Err(Problem::new(Code::TooDense, detail))
}

/// Refuses a play that would push the lower stop more than the controller allows.
fn check_pushing(strokes: &Strokes, settings: &Settings) -> Result<(), Problem> {
    let Some(limit) = settings.lower_stop.map(|stop| stop.pulses_per_s) else { return Ok(()) };
    let Some(Overpush { motor, at_s }) = find_overpush(strokes, limit) else { return Ok(()) };
    let detail = format!(
        "motor {motor} would push the lower stop with more than {limit} pulses per second, from {at_s:.2} s on: play at a lower \
         frequency, or configure a smaller `surplus_um` or a larger `limits.stop_pulses_per_s`"
    );
    Err(Problem::new(Code::PushLimit, detail))
}

/// Refuses a play in which more motors would have pulses at once than the limits allow.
fn check_at_once(strokes: &Strokes, settings: &Settings) -> Result<(), Problem> {
    let Some(TooMany { group, tick, at_once }) = find_too_many(strokes, settings.limits) else {
        return Ok(());
    };
    let at_s = ticks_to_seconds(tick);
    Err(too_many(group, &format!("{at_once} motors with pulses at once, first after {at_s:.4} s"), settings))
}

/// The problem of a rail or chip that would have too many motors with pulses at once.
pub(super) fn too_many(group: Group, has: &str, settings: &Settings) -> Problem {
    let (key, most) = match group {
        Group::Rail(_) => ("rail", settings.limits.rail_at_once),
        Group::Chip(_) => ("chip", settings.limits.chip_at_once),
    };
    let detail = format!(
        "{group} would have {has}; `array.{key}_motors_at_once` allows {most}: play fewer motors of it, smaller amplitudes or other \
         phases (docs/how-to/power.md)"
    );
    Problem::new(Code::PowerLimit, detail)
}

/// The onset that a request asks for; at most one of these keys is set.
pub(super) fn onset(tick: Option<u64>, ms: Option<f64>, monotonic_ns: Option<u64>) -> At {
    match (tick, ms, monotonic_ns) {
        (Some(tick), ..) => At::Tick(Tick(tick)),
        (_, Some(ms), _) => At::After(nanoseconds(ms)),
        (.., Some(ns)) => At::Monotonic(HostInstant::from_ns(ns)),
        (None, None, None) => At::Next,
    }
}

/// The trigger output's pulse for a request.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: half a second at most")]
pub(super) fn trigger(request: Option<TriggerRequest>) -> Option<Trigger> {
    let shape = match request {
        Some(TriggerRequest::Off) => return None,
        Some(TriggerRequest::On(shape)) => shape,
        None => TriggerShape::default(),
    };
    let width = ms_in_ticks(shape.width_ms()).round() as u16;
    Some(Trigger { width, code: shape.code.unwrap_or(0) })
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: 0 to an hour")]
fn nanoseconds(ms: f64) -> u64 {
    (ms * 1e6) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::runtime;
    use crate::daemon::state::{Asker, Caller};
    use crate::session_record::{Location, SessionRecord};
    use crate::store::Store;
    use meissner_api::{Realtime, Route, SessionRequest};
    use meissner_stream::queues::{Emit, StreamEvent, queues};
    use std::path::PathBuf;
    use std::sync::Arc;
    use std::time::Duration;

    /// The client has given up, but the play is played, so the session counts it.
    #[test]
    fn a_session_counts_a_play_whose_answer_comes_late() {
        let (mut port, commands, mut events) = queues().unwrap();
        let engine = Engine::new(commands, Settings::default(), "mock".to_owned(), None);
        let session = SessionRequest { participant: "P07".to_owned(), ..SessionRequest::default() };
        let id = engine.lock().start_session(session, None).unwrap().id;
        let stored = Store::new(None, false).unwrap().library("pin-60").unwrap().clone();
        let request = PlayRequest {
            pattern: "pin-60".to_owned(),
            endless: true,
            session: Some(id),
            ..PlayRequest::default()
        };
        let played = engine.play(&request, stored, Peer::local(1, 0));
        assert_eq!(runtime().unwrap().block_on(played).unwrap_err().code, "timeout");
        let ticket = port.pop().unwrap().ticket;
        port.event(StreamEvent::Answer { ticket, result: Ok(()) });
        engine.lock().apply(events.pop().unwrap());
        assert_eq!(engine.lock().session().unwrap().plays, 1);
    }

    /// A stop also refuses a play whose request came before the stop and is still being read.
    #[test]
    fn a_stop_refuses_a_play_whose_request_came_before() {
        let (mut port, commands, _events) = queues().unwrap();
        let engine = Engine::new(commands, Settings::default(), "mock".to_owned(), None);
        let stored = Store::new(None, false).unwrap().library("pin-60").unwrap().clone();
        let pattern = "pin-60".to_owned();
        let request = PlayRequest { pattern, endless: true, ..PlayRequest::default() };
        let client = Peer::local(1, 0);
        let caller = Caller::new(client, None, None, None);
        let breaks = engine.lock().commands.breaks();
        let asker = Asker { caller, access: Route::Play.access(), breaks };
        // A stop comes while the play's body or file is still being read.
        engine.lock().commands.send_unanswered(Command::Stop).unwrap();
        let played = asker.ask(engine.play(&request, stored, client));
        assert_eq!(runtime().unwrap().block_on(played).unwrap_err().code, "busy");
        assert!(matches!(port.pop().unwrap().command, Command::Stop) && port.pop().is_none());
    }

    #[test]
    fn a_play_is_refused_while_the_session_record_has_no_room_for_it() {
        let dir = tempfile::tempdir().unwrap();
        let record = SessionRecord::start(
            Some(Location { dir: dir.path().join("logbook"), days: 1, make_parents: false }),
            Arc::default(),
        );
        let record = record.unwrap();
        let (mut port, commands, _events) = queues().unwrap();
        let engine = Engine::new(commands, Settings::default(), "mock".to_owned(), None);
        let engine = engine.with(record.clone(), Realtime::default(), PathBuf::new());
        let stored = Store::new(None, false).unwrap().library("pin-60").unwrap().clone();
        let mut play = || {
            let request =
                PlayRequest { pattern: "pin-60".to_owned(), endless: true, ..PlayRequest::default() };
            let played = engine.play(&request, stored.clone(), Peer::local(1, 0));
            let problem = runtime().unwrap().block_on(played).unwrap_err();
            (problem.code, port.pop().is_some())
        };
        // No streamer answers.
        assert_eq!(play(), ("timeout".to_owned(), true));
        record.use_up_plays();
        assert_eq!(play(), ("too-many-plays".to_owned(), false));
        record.close(Duration::from_secs(10));
    }
}
