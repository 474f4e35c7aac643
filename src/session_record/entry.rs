//! Entries: the content of a line of the session record, without the time.
//!
//! Most are the daemon's events as clients see them; the others are commands, and the daemon's start and end. Events that
//! come ten times a second or once per stroke are left out, because receipts sum them up.
//!
//! A command keeps at most [`MAX_TEXT`] characters of each text that its client sent, and [`MAX_ITEMS`] items of a list.
//!
//! Invariant: the `event` key of a line determines which other keys it has.

use super::json;
use meissner_api::{EdgeEffect, EdgeRecord, Event, MAX_DETAIL, PlayAnswer, Session};
use meissner_input::message;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::net::IpAddr;

/// Characters kept of a text among a command's arguments: more than any name has.
const MAX_TEXT: usize = 100;
/// Items kept of a list among them: as many as a calibration takes.
const MAX_ITEMS: usize = 100;
/// Bytes of a line beside its entry: the times, and the user's name, which is added later.
const LINE: u64 = 192;

/// A client, as the kernel identifies it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Its process; -1 if unknown.
    pub pid: i32,
    /// Its user; the highest number if unknown.
    pub uid: u32,
    /// Set if it came over the network; then process and user are not known.
    pub network: Option<NetworkPeer>,
}

/// A client that came over the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NetworkPeer {
    /// Its address, or that of its proxy.
    pub address: IpAddr,
    /// The id of its access token, once that was checked.
    pub token: Option<TokenId>,
}

/// The id of an access token. It identifies the token without revealing it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TokenId(pub u32);

impl fmt::Display for TokenId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:08x}", self.0)
    }
}

impl Peer {
    /// A client about which nothing is known.
    pub const UNKNOWN: Self = Self::local(-1, u32::MAX);

    /// A client on a Unix socket.
    #[must_use]
    pub const fn local(pid: i32, uid: u32) -> Self {
        Self { pid, uid, network: None }
    }

    /// A client that came over the network.
    #[must_use]
    pub const fn network(network: NetworkPeer) -> Self {
        Self { network: Some(network), ..Self::UNKNOWN }
    }
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
    /// The network address it came from; absent on a Unix socket.
    #[serde(skip_serializing_if = "Option::is_none")]
    address: Option<IpAddr>,
    /// The id of its access token; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    token: Option<String>,
    /// Its arguments, cut; null: none.
    asked: Value,
    /// The play it began.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub play: Option<u64>,
    /// `ok`, the problem's code, or `hung-up` if the client did not wait for the answer.
    pub answer: String,
    /// The problem, in one line, cut.
    #[serde(skip_serializing_if = "Option::is_none")]
    detail: Option<String>,
}

impl CommandEntry {
    /// A command that is not answered yet.
    #[must_use]
    pub fn new(command: &'static str, client: Peer) -> Self {
        Self {
            command,
            pid: (client.pid > 0).then_some(client.pid),
            uid: (client.uid != u32::MAX).then_some(client.uid),
            user: None,
            address: client.network.map(|network| network.address),
            token: client.network.and_then(|network| network.token).map(|token| token.to_string()),
            asked: Value::Null,
            play: None,
            answer: "hung-up".to_owned(),
            detail: None,
        }
    }

    /// Sets the arguments.
    pub fn set_arguments(&mut self, mut asked: Value) {
        cut(&mut asked);
        self.asked = asked;
    }

    /// Sets the problem.
    pub fn set_detail(&mut self, detail: &str) {
        self.detail = Some(message::cut(detail, MAX_DETAIL));
    }

    /// The problem.
    #[must_use]
    pub fn detail(&self) -> Option<&str> {
        self.detail.as_deref()
    }
}

/// Cuts long texts and lists.
fn cut(value: &mut Value) {
    match value {
        Value::String(text) => {
            if let Some((at, _)) = text.char_indices().nth(MAX_TEXT) {
                text.truncate(at);
                text.push_str("...");
            }
        }
        Value::Array(items) => {
            items.truncate(MAX_ITEMS);
            items.iter_mut().for_each(cut);
        }
        Value::Object(keys) => keys.values_mut().for_each(cut),
        _ => {}
    }
}

/// An entry that is not an event of the API.
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
    /// The daemon has ended normally, or because of a problem that it could report.
    DaemonEnded {
        /// The problem; null: a signal or a request ended it.
        problem: Option<String>,
    },
    /// A client's command.
    Command(CommandEntry),
    /// A participant's answer to a play.
    Answered {
        /// The session of the play.
        session: String,
        /// The play.
        play: u64,
        /// The answer.
        answer: PlayAnswer,
    },
    /// An edge of the trigger input. It has a number and an instant of its own, beside those of the line.
    Edge {
        /// The edge.
        edge: EdgeRecord,
        /// As in the event.
        play: Option<u64>,
        /// As in the event.
        effect: EdgeEffect,
    },
    /// Entries are missing here. The line has the number of the last of them.
    Lost {
        /// How many.
        entries: u64,
        /// The missing entries that this daemon knows of, without those of an earlier daemon.
        of: Vec<LostOf>,
        /// The sessions whose start or end is among them.
        sessions: Vec<Session>,
    },
    /// Clients or devices made more entries than the record takes.
    LeftOut {
        /// How many entries were left out since the last such entry.
        entries: u64,
        /// Their clients and kinds.
        of: Vec<LeftOut>,
    },
}

/// Lost entries of a session.
#[derive(Clone, Debug, Serialize)]
pub struct LostOf {
    /// The session; null: they belong to none.
    pub(super) session: Option<String>,
    /// How many, by command or event.
    pub(super) kinds: BTreeMap<&'static str, u64>,
}

/// Entries of one kind that were left out.
#[derive(Clone, Debug, Serialize)]
pub struct LeftOut {
    /// The client's user; null: not known, or none.
    pub(super) uid: Option<u32>,
    /// That user's name; null: not known.
    pub(super) user: Option<String>,
    /// The command, or the event without a client.
    pub(super) what: &'static str,
    /// How many.
    pub(super) entries: u64,
}

/// Entries that share a bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// An accepted play, its result, and its participant's answer.
    Play,
    /// An emergency stop.
    EStop,
    /// An edge of the trigger input.
    Edge,
    /// Another command.
    Command,
    /// Events of the daemon and its device.
    Daemon,
}

/// The content of a line.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Entry {
    /// An entry that is not an event.
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
    /// The entry for an event, if the session record keeps it; `client` is the owner of the play that it is about.
    #[must_use]
    pub fn of(event: &Event, client: Option<Peer>) -> Option<Self> {
        match event {
            Event::State { .. }
            | Event::Late { .. }
            | Event::Refused { .. }
            | Event::Lagged { .. }
            | Event::RecordProblem { .. }
            | Event::Rendering { .. } => None,
            &Event::Edge { edge, play, effect } => Some(Note::Edge { edge, play, effect }.into()),
            event => Some(Self::Event {
                event: Box::new(event.clone()),
                uid: client.map(|client| client.uid),
                user: None,
            }),
        }
    }

    /// Sets the names of users.
    pub(super) fn name_users(&mut self, mut name: impl FnMut(u32) -> Option<String>) {
        match self {
            Self::Note(Note::Command(CommandEntry { user, uid, .. })) | Self::Event { user, uid, .. } => {
                *user = uid.and_then(name);
            }
            Self::Note(Note::LeftOut { of, .. }) => {
                for row in of {
                    row.user = row.uid.and_then(&mut name);
                }
            }
            Self::Note(_) => {}
        }
    }

    /// Its kind, its client's user, and the command or event.
    pub(super) fn kind(&self) -> (Kind, Option<u32>, &'static str) {
        let daemon = |name| (Kind::Daemon, None, name);
        match self {
            Self::Note(Note::Command(CommandEntry { command, uid, play, .. })) => {
                let kind = match (*command, play) {
                    (_, Some(_)) => Kind::Play,
                    ("estop", _) => Kind::EStop,
                    _ => Kind::Command,
                };
                (kind, *uid, command)
            }
            Self::Note(Note::DaemonStarted { .. }) => daemon("daemon-started"),
            Self::Note(Note::DaemonEnded { .. }) => daemon("daemon-ended"),
            // A play has one at most, so the room for plays bounds them.
            Self::Note(Note::Answered { .. }) => (Kind::Play, None, "answered"),
            Self::Note(Note::Edge { .. }) => (Kind::Edge, None, "edge"),
            Self::Note(Note::Lost { .. }) => daemon("lost"),
            Self::Note(Note::LeftOut { .. }) => daemon("left-out"),
            Self::Event { event, .. } => match **event {
                Event::Queued { .. }
                | Event::Began { .. }
                | Event::Items { .. }
                | Event::Ended { .. }
                | Event::SessionStarted { .. }
                | Event::SessionReleased { .. }
                | Event::SessionEnded { .. }
                | Event::Calibrated { .. } => (Kind::Play, None, event.name()),
                _ => daemon(event.name()),
            },
        }
    }

    /// Whether the running session lacks something without this entry. Requests do not count, not even the owner's: what they
    /// do to the session has entries of its own.
    pub(super) fn is_of_session(&self) -> bool {
        match self {
            Self::Event { event, .. } => !matches!(**event, Event::Intervened { .. }),
            Self::Note(_) => matches!(self.kind().0, Kind::Play | Kind::EStop | Kind::Edge),
        }
    }

    /// The session that begins or ends with this entry, if any.
    pub(super) fn bounds_session(&self) -> Option<&Session> {
        let Self::Event { event, .. } = self else { return None };
        match &**event {
            Event::SessionStarted { session } | Event::SessionEnded { session } => Some(session),
            _ => None,
        }
    }

    /// The bytes of its line, at most.
    pub(super) fn bytes(&self) -> u64 {
        LINE + json::bytes(self)
    }
}

impl From<Note> for Entry {
    fn from(note: Note) -> Self {
        Self::Note(note)
    }
}
