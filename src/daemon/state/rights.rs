//! Rights of clients. They are checked at each use, and when one ends, the plays and searches that it allowed end, too.
//!
//! Work that outlives its request holds the request's [`Caller`]: plays and searches here, and event streams, live connections and
//! waiting requests through [`Right`](crate::daemon::engine::right::Right). A right ends in three cases: its access token is revoked or
//! gets a lesser role; the owner of an exclusive session comes back after others were allowed to act; or the session that the
//! caller shows is over. Then [`State::rights_changed`] ends plays and searches, and wakes the others, which check their rights
//! again.
//!
//! Invariant: no caller stores the answer of [`State::check_right`].

use crate::daemon::network::{NOT_VALID, READS_ONLY, TokenStore};
use crate::daemon::state::{Asker, Caller, State};
use meissner_api::{
    EndCause,
    access::{Access, SessionRule},
};
use meissner_api::{Problem, Role, Route};
use meissner_stream::queues::Command;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::watch;

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Rights {
    tokens: Arc<TokenStore>,
    /// For each play that is not over, the client by whose right it was ordered.
    plays: HashMap<u64, Caller>,
    changed: watch::Sender<()>,
}

impl Default for Rights {
    fn default() -> Self {
        let tokens = Arc::new(TokenStore::open(None));
        Self { tokens, plays: HashMap::new(), changed: watch::Sender::new(()) }
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
    pub(super) fn of_play(&self, id: u64) -> Option<&Caller> {
        self.plays.get(&id)
    }

    /// The plays of this client that are not over.
    pub(super) fn plays_of(&self, caller: &Caller) -> Vec<u64> {
        self.plays.iter().filter(|(_, by)| by.is_same(caller)).map(|(&id, _)| id).collect()
    }

    /// Notes that a play is about to be sent for the requesting client.
    pub(in crate::daemon) fn add_play(&mut self, id: u64) {
        if let Some(Asker { caller, .. }) = Asker::find() {
            self.plays.insert(id, caller);
        }
    }

    /// Forgets a play that is over, or was not accepted.
    pub(super) fn forget_play(&mut self, id: u64) {
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

/// The access that a play or search needs to go on: a client may let it go on even when its own session is over.
pub(in crate::daemon) const fn going_on(access: Access) -> Access {
    match access.session {
        SessionRule::Owner => Access { session: SessionRule::Starts, ..access },
        SessionRule::Open | SessionRule::Starts => access,
    }
}

impl State {
    /// Refuses an action that this client may not, or may no longer, take.
    pub(in crate::daemon) fn check_right(&self, caller: &Caller, access: Access) -> Result<(), NoRight> {
        let lost = |problem: Problem| NoRight { problem, cause: &EndCause::Revoked };
        match caller.access.map(|id| self.rights.tokens.role(id)) {
            Some(None) => return Err(lost(NOT_VALID.into())),
            Some(Some(Role::Observe)) if access.role == Role::Operate => return Err(lost(READS_ONLY.into())),
            _ => {}
        }
        let session = caller.session();
        let checked = match access.session {
            SessionRule::Open => Ok(()),
            SessionRule::Starts => self.sessions.check_owner(session),
            SessionRule::Owner => {
                self.sessions.check_owner(session).and_then(|()| self.sessions.check_running(session))
            }
        };
        checked.map_err(|problem| NoRight { problem, cause: &EndCause::OwnerReturned })
    }

    /// What the requesting client may do, and whether it shows the token of the running session. The daemon itself may do anything.
    pub(in crate::daemon) fn asker(&self) -> (Role, bool) {
        let Some(Asker { caller, .. }) = Asker::find() else { return (Role::Operate, false) };
        let role = caller.access.map_or(Some(Role::Operate), |id| self.rights.tokens.role(id));
        (role.unwrap_or(Role::Observe), self.sessions.is_owner(caller.session()))
    }

    /// Refuses a change by a client that may no longer make it: since its request came, a session may have begun, or its token may
    /// have been revoked. Outside a request the daemon itself acts, which may do anything.
    pub(in crate::daemon) fn check_asker(&self) -> Result<(), Problem> {
        let Some(Asker { caller, access, .. }) = Asker::find() else { return Ok(()) };
        self.check_right(&caller, access).map_err(|no| no.problem)
    }

    /// Notes that a request or message of this client came.
    pub(in crate::daemon) fn hear(&mut self, caller: &Caller) {
        if self.check_right(caller, Route::Stop.access()).is_ok() {
            self.armed.hear(caller);
        }
        if self.sessions.hear(caller.session()) {
            self.rights_changed();
        }
    }

    /// Call this when a right may have ended: ends the plays and searches that it had allowed.
    pub(in crate::daemon) fn rights_changed(&mut self) {
        self.end_forbidden();
        self.rights.changed.send_replace(());
    }

    /// Ends the plays and the search of clients that may not order them any more.
    pub(super) fn end_forbidden(&mut self) {
        let needs = going_on(Route::Play.access());
        let forbidden = |caller: &Caller| self.check_right(caller, needs).err().map(|no| no.cause.clone());
        let plays: Vec<_> =
            self.rights.plays.iter().filter_map(|(&id, caller)| Some((id, forbidden(caller)?))).collect();
        let ends_search = self.searches.caller().and_then(forbidden).is_some();
        for (id, cause) in plays {
            self.cancel_play(id, cause);
        }
        if ends_search {
            self.cancel_running_search();
        }
    }

    /// Ends a play for this cause. If too many commands wait, the streamer's next report orders it again.
    pub(in crate::daemon) fn cancel_play(&mut self, id: u64, cause: EndCause) {
        let _ = self.commands.send_unanswered(Command::Cancel { id, cause });
    }
}
