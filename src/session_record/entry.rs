//! Entries: what a line of the logbook says, besides when.
//!
//! Most are the daemon's events as clients see them; the others are commands and the daemon's own story. What comes ten times a second
//! or once per stroke is left out: receipts sum it up.
//!
//! Invariant: the `event` key of a line tells what its other keys are.

use meissner_api::Event;
use serde::Serialize;
use serde_json::Value;

/// Peer gave a command, as the kernel says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Their process; -1: not known.
    pub pid: i32,
    /// Their user; the highest number: not known.
    pub uid: u32,
}

/// A command and what came of it.
#[derive(Clone, Debug, Serialize)]
pub struct CommandEntry {
    /// Its name, as in the API's address.
    pub command: &'static str,
    /// Peer gave it: their process; null: not known.
    pid: Option<i32>,
    /// Their user; null: not known.
    uid: Option<u32>,
    /// Their user's name; null: not known.
    user: Option<String>,
    /// What it was asked with; null: with nothing.
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
    /// A command that somebody gave, not answered yet.
    #[must_use]
    pub fn new(command: &'static str, who: Peer, asked: Value) -> Self {
        Self {
            command,
            pid: (who.pid > 0).then_some(who.pid),
            uid: (who.uid != u32::MAX).then_some(who.uid),
            user: None,
            asked,
            play: None,
            answer: "hung-up".to_owned(),
            detail: None,
        }
    }
}

/// What is no event of the API.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Note {
    /// A daemon has begun.
    DaemonStarted {
        /// Its version.
        version: &'static str,
        /// Its process.
        pid: u32,
        /// The device it looks for.
        wanted: String,
    },
    /// It has ended as it should.
    DaemonEnded {
        /// Why; null: it was told to.
        problem: Option<String>,
    },
    /// It was told to read its configuration again.
    Reloaded {
        /// What was taken, and from when on, in words.
        changed: Vec<String>,
        /// What was not taken, and why; null if everything was.
        problem: Option<String>,
    },
    /// Somebody asked for something.
    Command(CommandEntry),
    /// Here entries are missing.
    Lost {
        /// How many.
        entries: u64,
    },
}

/// What a line says.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Entry {
    /// Something of ours.
    Note(Note),
    /// An event as clients see it, and whose play it is about.
    Event {
        /// The event.
        #[serde(flatten)]
        event: Box<Event>,
        /// Peer ordered the play, by number.
        #[serde(skip_serializing_if = "Option::is_none")]
        uid: Option<u32>,
        /// By name.
        #[serde(skip_serializing_if = "Option::is_none")]
        user: Option<String>,
    },
}

impl Entry {
    /// An event, if it is one for the logbook, and who ordered the play it is about.
    #[must_use]
    pub fn of(event: &Event, who: Option<Peer>) -> Option<Self> {
        match event {
            Event::State { .. } | Event::Late { .. } | Event::Refused { .. } | Event::Lagged { .. } => None,
            told => {
                Some(Self::Event { event: Box::new(told.clone()), uid: who.map(|who| who.uid), user: None })
            }
        }
    }

    /// The user whose name is still to be found.
    pub(super) fn nameless(&self) -> Option<u32> {
        match self {
            Self::Note(Note::Command(CommandEntry { user: None, uid, .. }))
            | Self::Event { user: None, uid, .. } => *uid,
            _ => None,
        }
    }

    pub(super) fn give_name(&mut self, name: Option<String>) {
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
