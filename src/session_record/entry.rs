//! Entries: the content of a line of the session record, besides the time.
//!
//! Most are the daemon's events as clients see them; the others are commands, and the daemon's start, reloads and end. Events that
//! come ten times a second or once per stroke are left out: receipts sum them up.
//!
//! Invariant: the `event` key of a line determines its other keys.

use meissner_api::Event;
use serde::Serialize;
use serde_json::Value;

/// A client, as the kernel identifies it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Its process; -1: not known.
    pub pid: i32,
    /// Its user; the highest number: not known.
    pub uid: u32,
}

/// A command and its answer.
#[derive(Clone, Debug, Serialize)]
pub struct CommandEntry {
    /// Its name, as in the API's address.
    pub command: &'static str,
    /// The client's process; null: not known.
    pid: Option<i32>,
    /// The client's user; null: not known.
    uid: Option<u32>,
    /// That user's name; null: not known.
    user: Option<String>,
    /// Its arguments; null: none.
    pub asked: Value,
    /// The play it began.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub play: Option<u64>,
    /// `ok`, the problem's code, or `hung-up` if the client did not wait for the answer.
    pub answer: String,
    /// The problem, in one line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
}

impl CommandEntry {
    /// A command that is not answered yet.
    #[must_use]
    pub fn new(command: &'static str, client: Peer, asked: Value) -> Self {
        Self {
            command,
            pid: (client.pid > 0).then_some(client.pid),
            uid: (client.uid != u32::MAX).then_some(client.uid),
            user: None,
            asked,
            play: None,
            answer: "hung-up".to_owned(),
            detail: None,
        }
    }
}

/// An entry that is no event of the API.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Note {
    /// A daemon has started.
    DaemonStarted {
        /// Its version.
        version: &'static str,
        /// Its process.
        pid: u32,
        /// The requested device.
        wanted: String,
    },
    /// The daemon has ended in good order, or because of a problem it could report.
    DaemonEnded {
        /// The problem; null: a signal or a request ended it.
        problem: Option<String>,
    },
    /// The configuration was read again.
    Reloaded {
        /// What changed, and from when on, in words.
        changed: Vec<String>,
        /// What could not change, and why; null if everything could.
        problem: Option<String>,
    },
    /// A client's command.
    Command(CommandEntry),
    /// Entries are missing here.
    Lost {
        /// How many.
        entries: u64,
    },
}

/// The content of a line.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Entry {
    /// An entry that is no event.
    Note(Note),
    /// An event as clients see it, and the user whose play it is about.
    Event {
        /// The event.
        #[serde(flatten)]
        event: Box<Event>,
        /// The user who ordered the play.
        #[serde(skip_serializing_if = "Option::is_none")]
        uid: Option<u32>,
        /// That user's name.
        #[serde(skip_serializing_if = "Option::is_none")]
        user: Option<String>,
    },
}

impl Entry {
    /// The entry for an event, if the session record keeps it; `client`: whose play it is about.
    #[must_use]
    pub fn of(event: &Event, client: Option<Peer>) -> Option<Self> {
        match event {
            Event::State { .. } | Event::Late { .. } | Event::Refused { .. } | Event::Lagged { .. } => None,
            event => Some(Self::Event {
                event: Box::new(event.clone()),
                uid: client.map(|client| client.uid),
                user: None,
            }),
        }
    }

    /// The user whose name is not set yet.
    pub(super) fn unnamed_user(&self) -> Option<u32> {
        match self {
            Self::Note(Note::Command(CommandEntry { user: None, uid, .. }))
            | Self::Event { user: None, uid, .. } => *uid,
            _ => None,
        }
    }

    pub(super) fn set_user(&mut self, name: Option<String>) {
        match self {
            Self::Note(Note::Command(CommandEntry { user, .. })) | Self::Event { user, .. } => *user = name,
            Self::Note(_) => {}
        }
    }
}

impl From<Note> for Entry {
    fn from(note: Note) -> Self {
        Self::Note(note)
    }
}
