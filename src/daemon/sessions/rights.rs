//! Rights of clients. They are checked at each use, and when one ends, the plays and renderings that it allowed end, too.
//!
//! Work that outlives its request holds the request's [`Caller`]: plays, edges to come, homing and renderings here, and event streams,
//! live connections and waiting requests through [`Right`](crate::daemon::sessions::right::Right). A right ends in four cases: its access
//! token is revoked or gets a lesser role; an exclusive session begins; its owner comes back after others were allowed to act; or
//! the session that the caller shows is over. Then [`State::rights_changed`](crate::daemon::core::state::State::rights_changed) ends the work here, and wakes the others, which check
//! their rights again.
//!
//! Invariant: no caller stores the answer of [`State::check_right`](crate::daemon::core::state::State::check_right).

use crate::daemon::sessions::caller::Caller;
use crate::daemon::tokens::store::TokenStore;
use meissner_api::access::{Access, SessionRule};
use meissner_api::{EndCause, Problem};
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::watch;

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Rights {
    pub(super) tokens: Arc<TokenStore>,
    /// For each play that is not over, the client by whose right it was ordered.
    pub(super) plays: HashMap<u64, Caller>,
    /// The clients that have ordered edges of a simulated array, and may still order some.
    pub(super) edges: Vec<(u64, Caller)>,
    last_edges: u64,
    /// The ticket of the homing under way, and the client that has ordered it.
    pub(super) homing: Option<(u64, Caller)>,
    pub(super) changed: watch::Sender<()>,
}

impl Default for Rights {
    fn default() -> Self {
        let tokens = Arc::new(TokenStore::open(None));
        let (plays, edges, last_edges, homing) = Default::default();
        Self { tokens, plays, edges, last_edges, homing, changed: watch::Sender::new(()) }
    }
}

impl Rights {
    pub(in crate::daemon) fn set_tokens(&mut self, tokens: Arc<TokenStore>) {
        self.tokens = tokens;
    }

    /// Resolves whenever a right may have ended.
    pub(in crate::daemon) fn subscribe(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }

    /// The client that has ordered this play.
    pub(in crate::daemon) fn of_play(&self, id: u64) -> Option<&Caller> {
        self.plays.get(&id)
    }

    /// The plays of this client that are not over.
    pub(in crate::daemon) fn plays_of(&self, caller: &Caller) -> Vec<u64> {
        self.plays.iter().filter(|(_, by)| by.is_same(caller)).map(|(&id, _)| id).collect()
    }

    /// Notes that a play is about to be sent for this client.
    pub(in crate::daemon) fn add_play(&mut self, id: u64, caller: Caller) {
        self.plays.insert(id, caller);
    }

    /// The number by which the edges of a client can be withdrawn: the same for all with its rights.
    pub(in crate::daemon) fn edges_of(&mut self, caller: Caller) -> u64 {
        if let Some((number, _)) = self.edges.iter().find(|(_, by)| by.has_rights_of(&caller)) {
            return *number;
        }
        self.last_edges += 1;
        self.edges.push((self.last_edges, caller));
        self.last_edges
    }

    /// Notes that homing is about to begin for a client.
    pub(in crate::daemon) fn set_homing(&mut self, ticket: u64, caller: Caller) {
        self.homing = Some((ticket, caller));
    }

    /// Notes that the command of this ticket was answered.
    pub(in crate::daemon) fn answered(&mut self, ticket: u64) {
        self.homing.take_if(|(of, _)| *of == ticket);
    }

    /// Forgets a play that is over, or was not accepted.
    pub(in crate::daemon) fn forget_play(&mut self, id: u64) {
        self.plays.remove(&id);
    }
}

/// A right that a client does not have, or no longer has.
#[derive(Debug)]
pub(in crate::daemon) struct NoRight {
    pub(in crate::daemon) problem: Problem,
    /// The cause in the receipt of a play that ends for this reason.
    pub(in crate::daemon) cause: &'static EndCause,
}

/// The access that a play or rendering needs to go on: a client may let it go on even when its own session is over.
pub(in crate::daemon) const fn going_on(access: Access) -> Access {
    match access.session {
        SessionRule::Owner => Access { session: SessionRule::Starts, ..access },
        SessionRule::Open | SessionRule::Starts => access,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::core::engine::Engine;
    use crate::daemon::core::runtime::blocking;
    use crate::daemon::runtime;
    use crate::daemon::sessions::caller::{Asker, DAEMON};
    use crate::daemon::sessions::right;
    use crate::record::Peer;
    use meissner_api::{Route, SessionRequest};
    use meissner_array::spec::Array;
    use meissner_stream::Settings;
    use meissner_stream::queues::{Command, StreamEvent, ThreadQueues, queues};
    use std::future::ready;
    use std::pin::pin;
    use std::sync::mpsc;
    use std::time::Duration;

    fn engine() -> (Arc<Engine>, ThreadQueues) {
        let (port, commands, events) = queues().unwrap();
        // The events of the streamer are passed on by the tests.
        drop(events);
        let engine = Engine::new(commands, Settings::of(Array::paper()), "mock".to_owned(), None);
        engine.lock().sessions.set_silence(Duration::from_secs(3600));
        (Arc::new(engine), port)
    }

    /// A client that shows this session token.
    fn client(session: Option<&str>) -> Caller {
        Caller::new(Peer::local(1, 0), None, session, None)
    }

    fn asker(caller: Caller, route: Route) -> Asker {
        Asker { caller, access: route.access(), breaks: 0 }
    }

    /// Sends a command for a client, which then hangs up.
    fn order(engine: &Engine, caller: Caller, route: Route, command: Command) {
        drop(engine.send(Some(&asker(caller, route)), command).unwrap());
    }

    fn exclusive(engine: &Engine) -> String {
        let request =
            SessionRequest { participant: "P07".to_owned(), exclusive: true, ..SessionRequest::default() };
        engine.lock().start_session(DAEMON, request, None).unwrap().0.token
    }

    fn commands(port: &mut ThreadQueues) -> Vec<String> {
        std::iter::from_fn(|| port.pop()).map(|request| format!("{:?}", request.command)).collect()
    }

    /// Also when the client has hung up meanwhile.
    #[test]
    fn homing_is_stopped_with_the_right_of_who_ordered_it() {
        let (engine, mut port) = engine();
        order(&engine, client(None), Route::Home, Command::Home);
        let token = exclusive(&engine);
        assert_eq!(commands(&mut port), ["Home", "Stop"]);
        order(&engine, client(Some(&token)), Route::Home, Command::Home);
        engine.lock().rights_changed();
        let home = port.pop().unwrap();
        assert!(matches!(home.command, Command::Home) && port.pop().is_none(), "the owner's goes on");
        // What is over is not stopped.
        engine.lock().apply(StreamEvent::Answer { ticket: home.ticket, result: Ok(()) });
        engine.lock().close_session("request").unwrap();
        exclusive(&engine);
        assert_eq!(commands(&mut port), Vec::<String>::new());
    }

    #[test]
    fn a_change_that_waits_for_the_disk_asks_again_when_its_turn_comes() {
        let (engine, _port) = engine();
        runtime().unwrap().block_on(async {
            let (end, ended) = crossbeam_channel::bounded::<()>(0);
            let stuck = || {
                let ended = ended.clone();
                blocking(move || assert!(ended.recv().is_err()))
            };
            // All threads for disks are taken.
            let readers: Vec<_> = (0..8).map(|_| tokio::spawn(stuck())).collect();
            tokio::task::yield_now().await;
            let (changed, changes) = mpsc::channel();
            let by = asker(client(None), Route::Import);
            let mut change = pin!(right::changing(&engine, &by, move || changed.send(()).unwrap()));
            tokio::select! {
                biased;
                _ = &mut change => panic!("it waits"),
                () = ready(()) => {}
            }
            exclusive(&engine);
            drop(end);
            assert_eq!(change.await.unwrap_err().code, "session-exclusive");
            assert!(changes.recv().is_err(), "nothing was changed");
            for reader in readers {
                reader.await.unwrap().unwrap();
            }
        });
    }
}
