//! Begins a compiled play of any kind: reserves its time, checks, sends it, and waits for the streamer's answer.
//!
//! The callers compile without the engine's lock ([`Compiled`]); [`begin`] sends under it. The streamer refuses plays that the device
//! cannot take.
//!
//! Invariants: a play is in the receipts before the streamer reports anything about it; the id of a refused play goes to the next. Before a
//! play reaches the streamer, its time is in the sums on the disk, so a kill at any moment never leaves a smaller sum. A disk that does not
//! answer for [`DISK`] does not stop plays.

use crate::daemon::core::commands::Reply;
use crate::daemon::core::engine::{DISK, Engine, TIMEOUT, answer};
use crate::daemon::core::state::State;
use crate::daemon::plays::state::NewPlay;
use crate::daemon::sessions::caller::Asker;
use crate::exposure::{Now, Vibration};
use firmware_protocol::tick::Tick;
use meissner_api::{Code, PlayAccepted, Problem, Terms};
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::Surplus;
use meissner_stream::queues::{At, Command, Play};
use meissner_stream::time::HostInstant;
use meissner_stream::{Settings, Source};
use std::sync::Arc;
use tokio::sync::MutexGuard;
use tracing::warn;

/// A play that is compiled, and what the daemon checks and keeps of it.
#[derive(Debug)]
pub(in crate::daemon) struct Compiled {
    /// The play as the streamer gets it; its id is 0 until it is sent.
    pub(in crate::daemon) play: Play,
    /// The settings that it was compiled for.
    pub(in crate::daemon) settings: Settings,
    pub(in crate::daemon) vibration: Vibration,
    /// Whether its client knows that it has no end.
    pub(in crate::daemon) endless: bool,
    /// How many times as far as ordered pins may go, with the calibration that it was compiled for.
    pub(in crate::daemon) reach: PerMotor<f64>,
    /// The largest amplitude that is ordered, and how far pins may go for it, µm, and what asks for it.
    pub(in crate::daemon) largest: ([f64; 2], String),
    /// The SHA-256 of each pattern with motions, and what their samples take in memory, bytes.
    pub(in crate::daemon) memory: Vec<(String, usize)>,
    pub(in crate::daemon) new: NewPlay,
    /// Texts of its patterns by their SHA-256, for the session record.
    pub(in crate::daemon) texts: Vec<(String, Arc<[u8]>)>,
}

/// The reserved time of a play that the streamer does not have yet. If this is dropped before [`Self::begin`], the time is given
/// back; do not drop it under the engine's lock. Only one order is handled at a time, so that each is judged after those before it.
#[derive(Debug)]
struct Held<'e> {
    engine: &'e Engine,
    number: u64,
    breaks: u64,
    _turn: MutexGuard<'e, ()>,
}

impl Held<'_> {
    /// Refuses a play if a stop came after its request, while the request was read, compiled or waited.
    fn check(&self, state: &State) -> Result<(), Problem> {
        if state.commands.breaks() == self.breaks {
            return Ok(());
        }
        Err(Problem::new(
            Code::Busy,
            "the display was stopped after the play was asked for: send the play again",
        ))
    }

    /// Notes that the streamer has the play, under this id.
    fn begin(&self, state: &mut State, id: u64) {
        state.exposure.begin(self.number, id, Now::read());
    }
}

impl Drop for Held<'_> {
    fn drop(&mut self) {
        self.engine.lock().forget_exposure(self.number);
    }
}

/// A play of these strokes by these terms, without an id; at most one of the keys for its onset is set.
pub(in crate::daemon) fn ordered(strokes: impl Into<Source>, terms: &Terms) -> Play {
    let &Terms { late, replace, open_loop, stop_on_edge, .. } = terms;
    let at = match (terms.at_tick, terms.at_ms, terms.at_monotonic_ns, terms.on_edge_ms) {
        (Some(tick), ..) => At::Tick(Tick(tick)),
        (_, Some(ms), ..) => At::After(nanoseconds(ms)),
        (_, _, Some(ns), _) => At::Monotonic(HostInstant::from_ns(ns)),
        (.., Some(ms)) => At::Edge(nanoseconds(ms)),
        (None, None, None, None) => At::Next,
    };
    Play { at, late, replace, open_loop, stop_on_edge, ..Play::new(0, strokes) }
}

pub(in crate::daemon) fn nanoseconds(ms: f64) -> u64 {
    (ms * 1e6).round() as u64
}

/// What a play is compiled for: the settings, and what follows from the calibration.
pub(in crate::daemon) type Basis = (Settings, Surplus, PerMotor<f64>);

/// The settings, the surplus and the reach to compile a play for. Refuses a play for another boot than the device's.
pub(in crate::daemon) fn compiles_for(
    engine: &Engine,
    boot: Option<u32>,
    open_loop: bool,
) -> Result<Basis, Problem> {
    let state = engine.lock();
    match (boot, state.plays.receipts.device().map(|device| device.boot)) {
        (Some(asked), Some(now)) if asked != now => {
            let detail =
                format!("`boot` is {asked}, but the device has restarted as {now}: read its tick again");
            Err(Problem::new(Code::StaleBoot, detail))
        }
        _ => Ok((state.settings, state.surplus(), state.reach(open_loop))),
    }
}

/// Begins a play that `check` accepts, before its time is reserved and again after, and waits until the streamer accepts it. `sent` gets
/// the play's id before the streamer reports anything about it.
pub(in crate::daemon) async fn begin(
    engine: &Engine,
    by: &Asker,
    compiled: Compiled,
    check: impl Fn(&mut State) -> Result<(), Problem> + Send,
    sent: impl FnOnce(&mut State, u64) + Send,
) -> Result<PlayAccepted, Problem> {
    let held = hold(engine, by, &compiled, &check).await?;
    let Compiled { play, settings, memory, new, texts, .. } = compiled;
    let replace = play.replace;
    let (duration, motions) = (new.receipt.duration_ms, new.receipt.reach.motions.clone());
    let (id, reply) = {
        let mut state = engine.lock();
        held.check(&state)?;
        check(&mut state)?;
        let (id, reply) = send(&mut state, by, play, &settings, new)?;
        for (sha256, text) in texts {
            state.publisher.record.add_text(&sha256, &text);
        }
        state.plays.hold_memory(id, memory);
        held.begin(&mut state, id);
        sent(&mut state, id);
        (id, reply)
    };
    // If the streamer refuses a play that replaces others, they go on, so the next order waits for its answer.
    let held = replace.then_some(held);
    let answered = answer(reply, TIMEOUT).await;
    drop(held);
    answered?;
    Ok(PlayAccepted { id, ordered_ms: duration.ordered, compiled_ms: duration.compiled, motions })
}

/// Reserves the time of a play that `check` accepts, and waits until it is in the sums on the disk.
async fn hold<'e>(
    engine: &'e Engine,
    by: &Asker,
    compiled: &Compiled,
    check: &(impl Fn(&mut State) -> Result<(), Problem> + Send),
) -> Result<Held<'e>, Problem> {
    let (turn, play) = (engine.orders.lock().await, &compiled.play);
    let (held, saved) = {
        let mut state = engine.lock();
        check(&mut state)?;
        if *state.reach(play.open_loop) != *compiled.reach {
            let detail = "the calibration has changed meanwhile: send the play again";
            return Err(Problem::new(Code::Busy, detail));
        }
        let (largest_um, what) = &compiled.largest;
        state.exposure.check_amplitude(what, *largest_um)?;
        state.check_end(what, compiled.vibration.is_endless() && !compiled.endless)?;
        state.plays.check_memory(&compiled.memory)?;
        let number = state.hold_vibration(&compiled.vibration, play.replace, play.at)?;
        let saved = state.save_exposure(Now::read());
        let waits = !state.exposure.is_disk_silent();
        (Held { engine, number, breaks: by.breaks, _turn: turn }, saved.filter(|_| waits))
    };
    if let Some(mut saved) = saved
        && tokio::time::timeout(DISK, &mut saved).await.is_err()
    {
        warn!(
            "the disk of the session record has not taken the vibration's sums for {DISK:?}; playing goes on"
        );
        engine.lock().exposure.disk_is_silent(saved);
    }
    Ok(held)
}

/// Refuses a play during a calibration, or for another session than the one that it was prepared for.
pub(in crate::daemon) fn check(state: &mut State, session: Option<&str>) -> Result<(), Problem> {
    state.forget_unanswered();
    state.check_not_calibrating()?;
    if state.session_of_play(session)?.as_deref() == session {
        return Ok(());
    }
    Err(Problem::new(Code::SessionRunning, "a session has begun meanwhile: send the play again"))
}

/// Sends a play that was compiled for these settings, under the id that it gets with its receipt. Returns the id and where the answer
/// arrives.
fn send(
    state: &mut State,
    by: &Asker,
    play: Play,
    compiled_for: &Settings,
    new: NewPlay,
) -> Result<(u64, Reply), Problem> {
    state.check_record()?;
    if state.settings != *compiled_for {
        let detail = "the configuration has changed meanwhile: send the play again";
        return Err(Problem::new(Code::Busy, detail));
    }
    let id = state.plays.add(new);
    state.rights.add_play(id, by.caller.clone());
    let sent = state.send(Some(by), Command::Play(Box::new(Play { id, ..play })), Some(id));
    if sent.is_err() {
        state.settle_play(id, false);
    }
    Ok((id, sent?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::core::runtime::{CHECKS, OTHERS, PLAYS, STORED};
    use crate::daemon::plays::order;
    use crate::daemon::runtime;
    use crate::daemon::sessions::caller::DAEMON;
    use crate::store::{Store, Stored};
    use meissner_api::{Item, Order, SessionRequest};
    use meissner_stream::queues::{Emit, StreamEvent, queues};

    /// A play without end.
    fn pin(session: Option<String>) -> Order {
        Order::new(Item::of("pin-60"), Terms { endless: true, session, ..Terms::default() })
    }

    /// Finds a pattern of the library.
    async fn find(name: String, _: Option<String>) -> Result<(Stored, ()), Problem> {
        Ok((Store::new(None, false).unwrap().library(&name).unwrap().clone(), ()))
    }

    /// The client has given up, but the play is played, so the session counts it.
    #[test]
    fn a_session_counts_a_play_whose_answer_comes_late() {
        let (mut port, commands, mut events) = queues().unwrap();
        let engine = Engine::of_paper(commands);
        let session = SessionRequest { participant: "P07".to_owned(), ..SessionRequest::default() };
        let id = engine.lock().start_session(DAEMON, session, None).unwrap().0.id;
        let order = pin(Some(id));
        let by = Asker::operator();
        let played = order::play(&engine, &by, &order, &STORED, find);
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
        let engine = Engine::of_paper(commands);
        let order = pin(None);
        let by = Asker::operator();
        // A stop comes while the play's body or file is still being read.
        engine.lock().commands.send_unanswered(Command::Stop).unwrap();
        let played = order::play(&engine, &by, &order, &STORED, find);
        assert_eq!(runtime().unwrap().block_on(played).unwrap_err().code, "busy");
        assert!(matches!(port.pop().unwrap().command, Command::Stop) && port.pop().is_none());
    }

    /// Readers, and plays of other sorts, compute without an end, in every place that there is.
    #[test]
    fn a_play_of_a_stored_pattern_waits_for_nobody_elses_computation() {
        let (mut port, commands, _events) = queues().unwrap();
        let settings = Settings::of(meissner_array::spec::Array::paper());
        let engine = Engine::new(commands, settings, "mock".to_owned(), None);
        runtime().unwrap().block_on(async {
            let (end, ended) = crossbeam_channel::bounded::<()>(0);
            let mut others = tokio::task::JoinSet::new();
            for lane in [&CHECKS, &PLAYS, &OTHERS] {
                for _ in 0..30 {
                    let ended = ended.clone();
                    others.spawn(lane.computing(move || assert!(ended.recv().is_err())));
                }
            }
            tokio::task::yield_now().await;
            let order = pin(None);
            let by = Asker::operator();
            let played = order::play(&engine, &by, &order, &STORED, find);
            // It reaches the streamer, of which there is none here.
            assert_eq!(played.await.unwrap_err().code, "timeout");
            assert!(matches!(port.pop().unwrap().command, Command::Play(_)));
            assert!(others.try_join_next().is_none(), "they compute");
            drop(end);
            while others.join_next().await.is_some() {}
        });
    }
}
