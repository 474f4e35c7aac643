//! Plays of one pattern: compiles the pattern of a request, and begins the play.

use crate::daemon::engine::Engine;
use crate::daemon::plays::begin::Compiled;
use crate::daemon::plays::terms::{Terms, trigger};
use crate::daemon::state::NewPlay;
use crate::daemon::state::limits::check_limits;
use crate::daemon::system::runtime::PLAYS;
use crate::exposure::Vibration;
use crate::receipts::{Order, counts, fit};
use crate::session_record::Peer;
use crate::store::Stored;
use meissner_api::{Code, PlayAccepted, PlayRequest, Problem, Receipt};
use meissner_array::strokes::{StrokeOptions, Strokes, Surplus};
use meissner_array::units::ticks_to_seconds;
use meissner_stream::queues::Item;
use meissner_stream::{Bandwidth, Settings};
use std::sync::Arc;

impl Compiled {
    /// Compiles the pattern of a request.
    pub(super) async fn of_pattern(
        request: &PlayRequest,
        terms: &Terms,
        stored: Stored,
        (settings, surplus): (Settings, Surplus),
        client: Peer,
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
        let name = stored.pattern.name();
        // Refuse an empty play: it would begin at the same tick as the next one, and their results could not be told apart.
        if let Some(why) = order.empty() {
            return Err(Problem::new(Code::Empty, format!("`{name}`: no stroke would be played: {why}")));
        }
        let receipt = terms.receipt(name, &stored.sha256, request.seconds);
        let mut receipt = Receipt { scale: Some(scale), ..receipt };
        let amplitudes = stored.pattern.drives().iter().map(|drive| drive.amplitude_um * scale);
        let largest = (amplitudes.fold(0.0, f64::max), request.pattern.clone());
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
        order.enter(&mut receipt, request.fit, counts);
        let Stored { pattern, sha256, text, .. } = stored;
        Ok(Self {
            strokes: strokes.into(),
            items: vec![Item::new(trigger(request.trigger))],
            live: None,
            bandwidth,
            settings,
            vibration,
            endless: request.endless,
            largest,
            new: NewPlay { receipt, items: None, predicted: Some((pattern, options)), client },
            texts: vec![(sha256, text)],
        })
    }
}

impl Engine {
    /// Begins a play of a pattern and waits until the streamer accepts it.
    pub(in crate::daemon) async fn play(
        &self,
        request: &PlayRequest,
        stored: Stored,
        client: Peer,
    ) -> Result<PlayAccepted, Problem> {
        let basis = self.compiles_for(request.boot)?;
        let terms = Terms::from(request);
        let compiled = Compiled::of_pattern(request, &terms, stored, basis, client).await?;
        let session = request.session.as_deref();
        self.begin(&terms, compiled, |state| state.check_before_play(session), |_, _| {}).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::runtime;
    use crate::daemon::state::{Asker, Caller};
    use crate::session_record::{Location, SessionRecord};
    use crate::store::Store;
    use meissner_api::{Realtime, Route, SessionRequest};
    use meissner_stream::queues::{Command, Emit, StreamEvent, queues};
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
