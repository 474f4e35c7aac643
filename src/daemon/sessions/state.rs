//! The running session: which plays are recorded in it, and who may act meanwhile.
//!
//! A client is the owner if it sends the session's token. During an exclusive session every other client may only read, stop and
//! disarm, until the owner has been silent for [`Sessions::silence`]. A client that shows the token of a session that is over may
//! not change anything either, because it believes that its plays are recorded there. Emergency stops are not checked here.
//! [`rules`](super::rules) begin and end sessions.

use crate::receipts::KEPT;
use crate::store::hexadecimal;
use meissner_api::{Code, Problem, RecordNeed, Session};
use meissner_stream::time::{HostInstant, random};
use std::collections::BTreeSet;
use std::time::Duration;

/// The running session.
#[derive(Debug)]
pub(super) struct Running {
    pub(super) session: Session,
    /// Whether it goes on while it cannot be recorded.
    pub(super) record: RecordNeed,
    pub(super) token: String,
    /// When the last request with the token came.
    pub(super) heard: HostInstant,
    /// The plays that have an answer.
    pub(super) answered: BTreeSet<u64>,
}

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Sessions {
    pub(super) running: Option<Running>,
    /// How long an owner may be silent.
    silence: Duration,
}

impl Sessions {
    pub(in crate::daemon) const fn set_silence(&mut self, silence: Duration) {
        self.silence = silence;
    }

    /// Notes a request with this token, which is a sign of life if it is the owner's. An owner that comes back after its silence is
    /// the owner again; returns whether others might have acted meanwhile.
    pub(in crate::daemon) fn hear(&mut self, token: Option<&str>) -> bool {
        let silence = self.silence;
        let running = self.running.as_mut().filter(|running| token == Some(&*running.token));
        running.is_some_and(|running| {
            let Running { session, heard, .. } = running;
            // The timer may be late.
            let was_open = session.released || HostInstant::now().since(*heard) >= silence;
            (*heard, session.released) = (HostInstant::now(), false);
            session.exclusive && was_open
        })
    }

    /// If a client with this token must leave the display to the owner of an exclusive session: that session, and how long it must.
    fn closed_to(&self, token: Option<&str>) -> Option<(&Session, Duration)> {
        let running = self.running.as_ref().filter(|running| token != Some(&*running.token))?;
        let left = self.silence.saturating_sub(HostInstant::now().since(running.heard));
        (running.session.is_closed_to_others() && !left.is_zero()).then_some((&running.session, left))
    }

    /// Refuses a change by a client that does not own the exclusive session.
    pub(in crate::daemon) fn check_owner(&self, token: Option<&str>) -> Result<(), Problem> {
        let Some((session, left)) = self.closed_to(token) else { return Ok(()) };
        let Session { id, participant, owner, started, .. } = session;
        let by = owner.as_ref().map_or_else(String::new, |owner| format!(" by {owner}"));
        let detail = format!(
            "session {id} with participant `{participant}` is exclusive since {started}{by}: only its owner may do that; others may \
             read, stop, disarm, and order emergency stops, and may act once the owner has been silent for {:.0} s more",
            left.as_secs_f64().ceil()
        );
        Err(Problem::new(Code::SessionExclusive, detail))
    }

    /// Refuses a change by a client that shows the token of another session than the running one.
    pub(in crate::daemon) fn check_running(&self, token: Option<&str>) -> Result<(), Problem> {
        let running = self.running.as_ref();
        if token.is_none_or(|token| running.is_some_and(|running| *running.token == *token)) {
            return Ok(());
        }
        let now = running.map_or("no session runs".to_owned(), |Running { session, .. }| {
            format!("session {} with participant `{}` runs", session.id, session.participant)
        });
        let detail = format!(
            "the session of your token is over: it was ended, or the daemon has restarted; {now}: start a session, or send no token"
        );
        Err(Problem::new(Code::SessionRunning, detail))
    }

    /// The exclusive session that this client does not own.
    pub(in crate::daemon) fn foreign(&self, token: Option<&str>) -> Option<String> {
        self.closed_to(token).map(|(session, _)| session.id.clone())
    }

    /// Whether this is the token of the running session.
    pub(in crate::daemon) fn is_owner(&self, token: Option<&str>) -> bool {
        self.running.as_ref().is_some_and(|running| token == Some(&*running.token))
    }

    /// Counts an accepted play of the running session.
    pub(in crate::daemon) fn count_play(&mut self, session: Option<&str>) {
        if let Some(running) = self.running.as_mut().filter(|running| session == Some(&running.session.id)) {
            running.session.plays += 1;
        }
    }

    /// The shortest time until the owner can have been silent for too long; none if the session is over or not exclusive.
    pub(in crate::daemon) fn until_release(&self, id: &str) -> Option<Duration> {
        let running = self.running.as_ref().filter(|running| running.session.id == id)?;
        Some(self.silence.saturating_sub(HostInstant::now().since(running.heard)))
    }
}

/// The error that there is no such play.
pub(in crate::daemon) fn no_play(id: &str) -> Problem {
    let detail =
        format!("there is no play {id}: only the last {KEPT} that ended are kept; see `meissner receipt`");
    Problem::new(Code::NotFound, detail)
}

/// The error that no such session runs.
pub(in crate::daemon) fn no_session(id: &str) -> Problem {
    let detail = if id == "running" {
        "no session runs: `meissner session list` shows the recorded ones".to_owned()
    } else {
        let id: String = id.chars().take(100).collect();
        format!("session {id} does not run: `meissner session list` shows all")
    };
    Problem::new(Code::NotFound, detail)
}

/// Random bytes in hexadecimal.
pub(in crate::daemon) fn random_hex<const BYTES: usize>() -> Option<String> {
    let mut bytes = [0; BYTES];
    random(&mut bytes).then(|| hexadecimal(&bytes))
}
