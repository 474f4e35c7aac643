//! Clients' requests as lines of the log and entries of the session record.
//!
//! A handler makes a [`LoggedRequest`] first and passes its result through [`LoggedRequest::result`]; the request is written when it
//! is dropped. The log has each command but `play`, whose line comes at the play's end.
//!
//! Invariant: a request is in the session record's queue before its client has the answer.

use crate::daemon::core::engine::Engine;
use crate::daemon::sessions::caller::Asker;
use crate::record::{CommandEntry, Entry, Peer};
use meissner_api::Problem;
use serde::Serialize;
use std::sync::Arc;
use tracing::{debug, info};

/// A request under way. If it is dropped without a result, its client has hung up.
#[derive(Debug)]
pub(in crate::daemon) struct LoggedRequest {
    engine: Arc<Engine>,
    entry: CommandEntry,
    client: Peer,
    /// The session token that its client shows.
    token: Option<String>,
    /// The command's name in the log.
    title: String,
}

impl LoggedRequest {
    pub(in crate::daemon) fn new(engine: &Arc<Engine>, command: &'static str, client: Peer) -> Self {
        Self {
            engine: Arc::clone(engine),
            entry: CommandEntry::new(command, client),
            client,
            token: None,
            title: command.to_owned(),
        }
    }

    /// A request of this client, who may own the running session.
    pub(in crate::daemon) fn of(engine: &Arc<Engine>, command: &'static str, by: &Asker) -> Self {
        let mut request = Self::new(engine, command, by.peer());
        request.token = by.caller.session().map(str::to_owned);
        request
    }

    /// Sets the arguments of the command.
    pub(in crate::daemon) fn set_arguments(&mut self, arguments: &impl Serialize) {
        // Parsed arguments can be serialized.
        self.entry.set_arguments(serde_json::to_value(arguments).unwrap_or_default());
    }

    /// Sets the command's name in the log, if its own name is too short.
    pub(in crate::daemon) fn set_title(&mut self, title: String) {
        self.title = title;
    }

    /// Sets the play that the command has begun.
    pub(in crate::daemon) const fn set_play(&mut self, play: u64) {
        self.entry.play = Some(play);
    }

    /// Notes the result, and passes it on.
    pub(in crate::daemon) fn result<T, E: AsRef<Problem>>(mut self, result: Result<T, E>) -> Result<T, E> {
        let problem = result.as_ref().err().map(AsRef::as_ref);
        self.entry.answer = problem.map_or_else(|| "ok".to_owned(), |problem| problem.code.clone());
        if let Some(problem) = problem {
            self.entry.set_detail(&problem.detail);
        }
        result
    }
}

impl Drop for LoggedRequest {
    fn drop(&mut self) {
        let (title, client) = (&self.title, self.engine.names.client(self.client));
        let answer = match (self.entry.detail(), &*self.entry.answer) {
            (Some(detail), code) => format!("refused ({code}): {detail}"),
            (None, "ok") => "done".to_owned(),
            (None, _) => "the client hung up before the answer".to_owned(),
        };
        // A play has a line at its end, and refused plays may come by the thousand.
        let kind = self.entry.command;
        match (kind, &*self.entry.answer) {
            ("play" | "answer", _) => {
                debug!("{title} by {client}: {answer}");
            }
            ("estop", _) => info!(always = true, "{title} by {client}: {answer}"),
            // Refusals are bounded separately, so that they do not displace lines about carried-out commands.
            (_, "ok") => info!(kind, "{title} by {client}: {answer}"),
            _ => info!(kind, "{title} by {client}: {answer}"),
        }
        let state = self.engine.lock();
        self.entry.is_of_owner = state.sessions.is_owner(self.token.as_deref());
        state.publisher.record.add(Entry::Command(self.entry.clone()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{Location, Record};

    use meissner_stream::queues::queues;
    use serde_json::Value;
    use std::fs;

    use std::time::Duration;

    #[test]
    fn a_client_that_hangs_up_is_recorded() {
        let dir = tempfile::tempdir().unwrap();
        let (_port, commands, _events) = queues().unwrap();
        let folder = dir.path().join("logbook");
        let location = Location { dir: folder.clone(), make_parents: false };
        let record = Record::start(Some(location), Arc::default()).unwrap();
        let engine = Engine::of_paper(commands);
        let engine = Arc::new(engine.recording(record.clone(), Arc::default()));
        drop(LoggedRequest::new(&engine, "home", Peer::local(7, 0)));
        record.close(Duration::from_secs(300));
        let text = fs::read_to_string(folder.join("daemon.jsonl")).unwrap();
        let line: Value = serde_json::from_str(&text).unwrap();
        let said = ["event", "command", "user", "answer"].map(|key| line[key].as_str().unwrap());
        assert_eq!(said, ["command", "home", "root", "hung-up"]);
    }
}
