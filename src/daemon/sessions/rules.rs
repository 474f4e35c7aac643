//! Begins and ends sessions, takes answers, and decides what a client may do; ends what it may not do any more.
//!
//! Invariant: at most one session runs; it begins and ends while no play runs or waits, unless the daemon ends.

use crate::clock;
use crate::daemon::core::state::State;
use crate::daemon::net::refusal::{NOT_VALID, READS_ONLY};
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::sessions::rights::{NoRight, going_on};
use crate::daemon::sessions::state::{Running, no_play, no_session, random_hex};
use crate::record::Entry;
use meissner_api::access::{Access, SessionRule};
use meissner_api::{
    Code, EndCause, Event, PlayAnswer, PlayState, Problem, Receipt, RecordNeed, Role, Route, Session,
    SessionRequest, SessionStarted,
};
use meissner_input::message;
use meissner_stream::queues::Command;
use meissner_stream::time::HostInstant;
use std::collections::BTreeSet;
use tokio::sync::oneshot;
use tracing::info;

/// The error that no session starts, because its start is not recorded.
fn no_session_without_record(why: &str) -> Problem {
    let detail = format!(
        "no session was started: {why}; let the daemon write there, or start it with --no-record to play without a record"
    );
    Problem::new(Code::Store, detail)
}

/// Characters of a warning about the record in a receipt, at most.
const MAX_WARNING: usize = 160;

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
        let is_required = request.record == RecordNeed::Required;
        if is_required && let Some(why) = self.publisher.record.problem() {
            return Err(no_session_without_record(&why));
        }
        let no_numbers = || Problem::new(Code::Store, "the system gives no random numbers for the token");
        let (token, unique) =
            (random_hex::<16>().ok_or_else(no_numbers)?, random_hex::<3>().ok_or_else(no_numbers)?);
        let now = clock::now().1;
        let SessionRequest { participant, experiment, labels, seed, exclusive, record } = request;
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
            record_problem: self.record_problem(),
        };
        self.exposure.start_session(&session.participant);
        self.sessions.running =
            Some(Running { session, record, token, heard: HostInstant::now(), answered: BTreeSet::new() });
        self.rights_changed();
        let (version, device) = (env!("CARGO_PKG_VERSION"), self.plays.receipts.device());
        let session = Box::new(self.session().unwrap_or_default());
        let (record, entry) = (&self.publisher.record, Entry::SessionStarted { session, version, device });
        if is_required && record.dir().is_some() {
            return Ok((started, Some(record.add_told(entry))));
        }
        record.add(entry);
        Ok((started, None))
    }

    /// Announces a session whose start has a line, or needs none. Otherwise ends it, as if it had never
    /// begun.
    pub(in crate::daemon) fn session_recorded(&mut self, id: &str, is_recorded: bool) -> Result<(), Problem> {
        let session = self.session().filter(|session| session.id == id);
        if is_recorded {
            if let Some(session) = session.map(Box::new) {
                self.publisher.announce(&Event::SessionStarted { session });
            }
            return Ok(());
        }
        let why =
            self.record_problem().unwrap_or_else(|| "the disk of the session record is too slow".to_owned());
        if session.is_some() {
            self.exposure.end_session();
            self.sessions.running = None;
            self.rights_changed();
            self.publisher.record.forget_session(id);
        }
        Err(no_session_without_record(&why))
    }

    /// Refuses a play of a session whose record is required and cannot be written.
    pub(in crate::daemon) fn check_record(&self) -> Result<(), Problem> {
        let running = self.sessions.running.as_ref();
        let needs = running.filter(|running| running.record == RecordNeed::Required);
        let Some((Running { session, .. }, why)) = needs.zip(self.publisher.record.problem()) else {
            return Ok(());
        };
        let detail = format!(
            "session {} takes no plays: {why}; free space there or let the daemon write there, which it tries every second; sessions \
             started with `\"record\": \"optional\"` go on without it",
            session.id
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
        let record = &self.publisher.record;
        let none = || "this daemon keeps no session record: start it without --no-record".to_owned();
        record.problem().or_else(|| record.dir().is_none().then(none))
    }

    /// What the session record lacks that concerns a play: entries of its session, or all that comes now.
    pub(in crate::daemon) fn record_warning(&self, receipt: &Receipt) -> Option<String> {
        let record = &self.publisher.record;
        let lost = receipt.order.terms.session.as_ref().map_or(0, |session| record.lost_of(session).entries);
        let told = (lost > 0).then(|| format!("the session record has lost {lost} entries of this session"));
        Some(message::cut(&record.problem().or(told)?, MAX_WARNING))
    }

    /// Takes the answer to a play back, because it is not recorded.
    pub(in crate::daemon) fn unrecorded(&mut self, play: u64) -> Problem {
        if let Some(running) = &mut self.sessions.running {
            running.answered.remove(&play);
        }
        let slow = || "the disk of the session record has not taken it in time".to_owned();
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
        running.answered.insert(play);
        let session = running.session.id.clone();
        Ok(self.publisher.record.add_told(Entry::Answered { session, play, answer }))
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
        let lost = self.publisher.record.lost_of(&session.id);
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

    /// What this client may do, and whether it shows the token of the running session. The daemon itself may do anything.
    pub(in crate::daemon) fn role_of(&self, by: Option<&Asker>) -> (Role, bool) {
        let Some(Asker { caller, .. }) = by else { return (Role::Operate, false) };
        let role = caller.access.map_or(Some(Role::Operate), |id| self.rights.tokens.role(id));
        (role.unwrap_or(Role::Observe), self.sessions.is_owner(caller.session()))
    }

    /// Refuses a change by a client that may no longer make it: since its request came, a session may have begun, or its token may
    /// have been revoked. The daemon itself may do anything.
    pub(in crate::daemon) fn check_asker(&self, by: Option<&Asker>) -> Result<(), Problem> {
        let Some(Asker { caller, access, .. }) = by else { return Ok(()) };
        self.check_right(caller, *access).map_err(|no| no.problem)
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

    /// Call this when a right may have ended: ends the work that it had allowed.
    pub(in crate::daemon) fn rights_changed(&mut self) {
        self.end_forbidden();
        self.rights.changed.send_replace(());
    }

    /// Ends the plays, the edges to come, the homing and the rendering of clients that may not order them any more. What does not fit
    /// into the queue of commands is tried again with the streamer's next report.
    pub(in crate::daemon) fn end_forbidden(&mut self) {
        let needs = going_on(Route::Play.access());
        let forbidden = |caller: &Caller| self.check_right(caller, needs).err().map(|no| no.cause.clone());
        let plays: Vec<_> =
            self.rights.plays.iter().filter_map(|(&id, caller)| Some((id, forbidden(caller)?))).collect();
        let ends_rendering = self.renderings.caller().and_then(forbidden).is_some();
        let stops_homing = self.rights.homing.as_ref().and_then(|(_, caller)| forbidden(caller));
        let orders = Route::Edge.access();
        let lost = |(_, caller): &&(u64, Caller)| self.check_right(caller, orders).is_err();
        let edges: Vec<u64> = self.rights.edges.iter().filter(lost).map(|(number, _)| *number).collect();
        for (id, cause) in plays {
            self.cancel_play(id, cause);
        }
        if ends_rendering {
            self.cancel_rendering();
        }
        if let Some(cause) = stops_homing
            && self.commands.send_unanswered(Command::Stop).is_ok()
        {
            self.rights.homing = None;
            info!("homing was stopped: {cause}");
        }
        for number in edges {
            if self.commands.send_unanswered(Command::WithdrawEdges(number)).is_ok() {
                self.rights.edges.retain(|(of, _)| *of != number);
            }
        }
    }

    /// Ends a play for this cause. If too many commands wait, the streamer's next report orders it again.
    pub(in crate::daemon) fn cancel_play(&mut self, id: u64, cause: EndCause) {
        let _ = self.commands.send_unanswered(Command::Cancel { id, cause });
    }
}
