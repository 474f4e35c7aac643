//! The running session: which plays are recorded in it, and who may act meanwhile.
//!
//! A client is the owner if it sends the session's token. During an exclusive session every other client may only read, stop and
//! disarm, until the owner has been silent for [`Sessions::silence`]. A client that shows the token of a session that is over may
//! not change anything either, because it believes that its plays are recorded there. Emergency stops are not checked here.
//!
//! Invariant: at most one session runs; it begins and ends while no play runs or waits, unless the daemon ends.

use crate::clock;
use crate::daemon::core::state::State;
use crate::daemon::sessions::caller::Asker;
use crate::receipts::KEPT;
use crate::session_record::{Entry, Note};
use crate::store::hexadecimal;
use meissner_api::{
    Code, Event, PlayAnswer, PlayState, Problem, Receipt, Session, SessionRequest, SessionStarted,
};
use meissner_input::message;
use meissner_stream::time::{HostInstant, random};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::oneshot;

/// Characters of a warning about the record in a receipt, at most.
const MAX_WARNING: usize = 160;

/// The running session.
#[derive(Debug)]
struct Running {
    session: Session,
    token: String,
    /// When the last request with the token came.
    heard: HostInstant,
    /// The plays that have an answer.
    answered: BTreeSet<u64>,
}

/// See the module.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Sessions {
    running: Option<Running>,
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

impl State {
    /// Starts a session. `owner`: the user's name. If there is a record, the receiver gets its value when the start has a line, and
    /// fails if it has none; then call [`Self::session_recorded`].
    pub(in crate::daemon) fn start_session(
        &mut self,
        by: Option<&Asker>,
        request: SessionRequest,
        owner: Option<String>,
    ) -> Result<(SessionStarted, Option<oneshot::Receiver<()>>), Problem> {
        self.check_asker(by)?;
        if self.commands.is_closing() {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        if let Some(Running { session, .. }) = &self.sessions.running {
            let detail = format!(
                "session {} with participant `{}` runs since {}: end it first with `meissner session end`",
                session.id, session.participant, session.started
            );
            return Err(Problem::new(Code::SessionRunning, detail));
        }
        self.check_nothing_plays()?;
        if !self.publisher.session_record.takes_plays() {
            let detail = "the session record has no room for more at this rate: try again later";
            return Err(Problem::new(Code::TooManyPlays, detail));
        }
        let no_numbers = || Problem::new(Code::Store, "the system gives no random numbers for the token");
        let (token, unique) =
            (random_hex::<16>().ok_or_else(no_numbers)?, random_hex::<3>().ok_or_else(no_numbers)?);
        let now = clock::now().1;
        let SessionRequest { participant, experiment, labels, seed, exclusive } = request;
        let session = Session {
            id: format!("{}-{unique}", now.strftime("%Y%m%dT%H%M%SZ")),
            participant,
            experiment,
            labels,
            seed,
            exclusive,
            owner,
            started: clock::local_text(),
            ..Session::default()
        };
        let started = SessionStarted {
            id: session.id.clone(),
            token: token.clone(),
            record_problem: self.record_problem().filter(|_| self.publisher.session_record.dir().is_none()),
        };
        self.exposure.start_session(&session.participant);
        self.sessions.running =
            Some(Running { session, token, heard: HostInstant::now(), answered: BTreeSet::new() });
        self.rights_changed();
        let event = self.session().map(|session| Event::SessionStarted { session: Box::new(session) });
        let entry = event.as_ref().and_then(|event| Entry::of(event, None));
        let record = &self.publisher.session_record;
        let recorded = entry.filter(|_| record.dir().is_some()).map(|entry| record.add_told(entry));
        Ok((started, recorded))
    }

    /// Announces a session whose start has a line, or that is not recorded at all (`Some(true)`). Otherwise ends it: as if it had
    /// never begun if the start has no line, with an end in the record if the line may yet come (`None`).
    pub(in crate::daemon) fn session_recorded(
        &mut self,
        id: &str,
        is_recorded: Option<bool>,
    ) -> Result<(), Problem> {
        let session = self.session().filter(|session| session.id == id);
        if is_recorded == Some(true) {
            if let Some(session) = session.map(Box::new) {
                self.publisher.announce(&Event::SessionStarted { session });
            }
            return Ok(());
        }
        let why =
            self.record_problem().unwrap_or_else(|| "the disk of the session record is too slow".to_owned());
        if session.is_some() && is_recorded.is_none() {
            self.close_session("not-recorded");
        } else if session.is_some() {
            self.exposure.end_session();
            self.sessions.running = None;
            self.rights_changed();
            self.publisher.session_record.forget_session(id);
        }
        let detail = format!(
            "no session was started: {why}; let the daemon write there, or start it with --no-record to play without a record"
        );
        Err(Problem::new(Code::Store, detail))
    }

    /// Ends the running session, which a client named by its id or as `running`.
    pub(in crate::daemon) fn end_session(
        &mut self,
        by: Option<&Asker>,
        id: &str,
    ) -> Result<Session, Problem> {
        self.check_asker(by)?;
        self.check_session(id)?;
        self.check_nothing_plays()?;
        self.close_session("request").ok_or_else(|| no_session(id))
    }

    /// Ends the running session, even if a play runs.
    pub(in crate::daemon) fn close_session(&mut self, reason: &str) -> Option<Session> {
        let mut session = self.session()?;
        session.vibration_s = self.exposure.end_session();
        (session.ended, session.reason) = (Some(clock::local_text()), Some(reason.to_owned()));
        session.release_in_s = None;
        self.sessions.running = None;
        self.rights_changed();
        self.publish(&Event::SessionEnded { session: Box::new(session.clone()) });
        Some(session)
    }

    /// Why nothing is recorded now.
    fn record_problem(&self) -> Option<String> {
        let record = &self.publisher.session_record;
        let none = || "this daemon keeps no session record: start it without --no-record".to_owned();
        record.problem().or_else(|| record.dir().is_none().then(none))
    }

    /// What the session record lacks that concerns a play: entries of its session, or all that comes now.
    pub(in crate::daemon) fn record_warning(&self, receipt: &Receipt) -> Option<String> {
        let record = &self.publisher.session_record;
        let lost = receipt.order.terms.session.as_ref().map_or(0, |session| record.lost_of(session).entries);
        let told = (lost > 0).then(|| format!("the session record has lost {lost} entries of this session"));
        Some(message::cut(&record.problem().or(told)?, MAX_WARNING))
    }

    /// Takes the answer to a play back, because it is not recorded.
    pub(in crate::daemon) fn unrecorded(&mut self, play: u64) -> Problem {
        if let Some(running) = &mut self.sessions.running {
            running.answered.remove(&play);
        }
        let slow = || "the disk of the session record has not taken it, and may still do so".to_owned();
        let why = self.record_problem().unwrap_or_else(slow);
        Problem::new(Code::Store, format!("the answer to play {play} is not recorded: {why}; send it again"))
    }

    /// Records the participant's answer to a play of the running session. The receiver gets its value when the answer has a line, and
    /// fails if it has none.
    pub(in crate::daemon) fn answer(
        &mut self,
        by: Option<&Asker>,
        play: u64,
        answer: PlayAnswer,
    ) -> Result<oneshot::Receiver<()>, Problem> {
        self.check_asker(by)?;
        let receipt = self.plays.receipts.receipt(play).ok_or_else(|| no_play(&play.to_string()))?;
        let running = self.sessions.running.as_mut();
        let Some(running) =
            running.filter(|running| receipt.order.terms.session.as_ref() == Some(&running.session.id))
        else {
            let detail = format!(
                "play {play} is not of a session that runs: answers are kept in the session of their play"
            );
            return Err(Problem::new(Code::SessionRunning, detail));
        };
        if receipt.onset.is_none() {
            let detail = match receipt.state {
                PlayState::Queued => format!("play {play} has not begun: send the answer when it has"),
                _ => format!("play {play} never began: nobody felt it"),
            };
            return Err(Problem::new(Code::BadRequest, detail));
        }
        if running.answered.contains(&play) {
            let detail = format!("play {play} has an answer already: a play has one at most");
            return Err(Problem::new(Code::Exists, detail));
        }
        if !self.publisher.session_record.takes_plays() {
            let detail = "the session record has no room for more at this rate: try again later";
            return Err(Problem::new(Code::TooManyPlays, detail));
        }
        running.answered.insert(play);
        let session = running.session.id.clone();
        Ok(self.publisher.session_record.add_told(Note::Answered { session, play, answer }))
    }

    /// Opens an exclusive session to others, if its owner has been silent for too long.
    pub(in crate::daemon) fn release_session(&mut self, id: &str) {
        let silent = self.sessions.until_release(id).is_some_and(|left| left.is_zero());
        let running =
            self.sessions.running.as_mut().filter(|running| silent && running.session.is_closed_to_others());
        if let Some(running) = running {
            running.session.released = true;
            self.publish(&Event::SessionReleased { session: id.to_owned() });
        }
    }

    /// The running session.
    pub(in crate::daemon) fn session(&self) -> Option<Session> {
        let Running { session, .. } = self.sessions.running.as_ref()?;
        let left = self.sessions.until_release(&session.id).filter(|_| session.is_closed_to_others());
        let lost = self.publisher.session_record.lost_of(&session.id);
        Some(Session {
            lost,
            vibration_s: self.exposure.session_s(),
            release_in_s: left.map(|left| left.as_secs_f64()),
            ..session.clone()
        })
    }

    /// The session of a play that names session `asked`, or names none.
    pub(in crate::daemon) fn session_of_play(&self, asked: Option<&str>) -> Result<Option<String>, Problem> {
        let running = self.sessions.running.as_ref().map(|running| running.session.id.clone());
        match (asked, &running) {
            (Some(asked), Some(running)) if asked != running => {
                let detail =
                    format!("`session` is not the running one, {running}: name that, or leave the key out");
                Err(Problem::new(Code::SessionRunning, detail))
            }
            (Some(_), None) => {
                let detail =
                    "no session runs: start one with `meissner session start`, or leave out `session`";
                Err(Problem::new(Code::SessionRunning, detail))
            }
            _ => Ok(running),
        }
    }

    fn check_session(&self, id: &str) -> Result<(), Problem> {
        let running = self.sessions.running.as_ref().map(|running| running.session.id.as_str());
        if running.is_some_and(|running| id == "running" || id == running) {
            Ok(())
        } else {
            Err(no_session(id))
        }
    }

    fn check_nothing_plays(&self) -> Result<(), Problem> {
        if self.plays.receipts.is_idle() {
            return Ok(());
        }
        Err(Problem::new(Code::Playing, "a play runs or waits: wait for its end, or stop it first"))
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
