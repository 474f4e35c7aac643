//! Entries: the content of a line of the record, without the time.
//!
//! Most are the daemon's events as clients see them. Events that come ten times a second or once per
//! stroke have no entry, because receipts sum them up.
//!
//! A command keeps at most [`MAX_TEXT`] characters of each text that its client sent, and
//! [`MAX_ITEMS`] items of a list.
//!
//! Invariant: the `event` key of a line determines which other keys it has, each once.

use meissner_api::{DeviceInfo, EdgeEffect, EdgeRecord, Event, MAX_DETAIL, PlayAnswer, Session};
use meissner_input::message;
use serde::{Serialize, Serializer};
use serde_json::Value;
use std::fmt;
use std::net::IpAddr;
use std::sync::Arc;

/// Characters kept of a text among a command's arguments: more than any name has.
const MAX_TEXT: usize = 100;
/// Items kept of a list among them: as many as a calibration takes.
const MAX_ITEMS: usize = 100;

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
    pub const fn local(pid: i32, uid: u32) -> Self {
        Self { pid, uid, network: None }
    }

    /// A client that came over the network.
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
    /// Whether its client shows the token of the running session.
    #[serde(skip)]
    pub is_of_owner: bool,
}

impl CommandEntry {
    /// A command that is not answered yet.
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
            is_of_owner: false,
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

/// The content of a line.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Entry {
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
    /// The first line of a session's file.
    SessionStarted {
        /// The session.
        session: Box<Session>,
        /// The daemon's version.
        version: &'static str,
        /// The device; null without one.
        device: Option<DeviceInfo>,
    },
    /// The last line of a session's file.
    SessionEnded {
        /// The session.
        session: Box<Session>,
        /// How many lines the file has. The record sets it.
        lines: u64,
    },
    /// A session has begun, or ended: in `daemon.jsonl`, so that a missing file is noticed.
    Session {
        /// Its id.
        id: String,
        /// Whether it has ended.
        ended: bool,
    },
    /// A client's command.
    Command(CommandEntry),
    /// The text of a pattern that the session plays.
    Pattern {
        /// Its hash.
        sha256: String,
        /// The text.
        #[serde(serialize_with = "as_text")]
        text: Arc<[u8]>,
    },
    /// A participant's answer to a play.
    Answered {
        /// The session of the play.
        session: String,
        /// The play.
        play: u64,
        /// The answer.
        answer: PlayAnswer,
    },
    /// An edge of the trigger input. It has a number and an instant of its own.
    Edge {
        /// The edge.
        edge: EdgeRecord,
        /// As in the event.
        play: Option<u64>,
        /// As in the event.
        effect: EdgeEffect,
    },
    /// Entries are missing before this line.
    Lost {
        /// How many.
        entries: u64,
        /// The ends of plays among them.
        plays: u64,
    },
    /// Clients or devices made more entries than the record takes.
    LeftOut {
        /// How many entries were left out since the last such line.
        entries: u64,
    },
    /// An event as clients see it, and the user whose play it is about.
    #[serde(untagged)]
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

/// Entries that share a bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// About a session, an accepted play, or a participant's answer: never left out.
    Play,
    /// An emergency stop.
    EStop,
    /// Another command, an edge of the trigger input, or an event of the daemon and its device.
    Other,
}

/// Texts of patterns are UTF-8: [`Record::add_text`](super::Record::add_text) takes no others.
fn as_text<S: Serializer>(text: &Arc<[u8]>, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(str::from_utf8(text).unwrap_or_default())
}

impl Entry {
    /// The entry for an event, if the record keeps it; `client` is the owner of the play that it is
    /// about.
    pub fn of(event: &Event, client: Option<Peer>) -> Option<Self> {
        Some(match event {
            Event::State { .. }
            | Event::Late { .. }
            | Event::Refused { .. }
            | Event::Lagged { .. }
            | Event::Lost { .. }
            | Event::RecordProblem { .. }
            | Event::SessionStarted { .. }
            | Event::Rendering { .. } => return None,
            &Event::Edge { edge, play, effect } => Self::Edge { edge, play, effect },
            Event::SessionEnded { session } => Self::SessionEnded { session: session.clone(), lines: 0 },
            event => Self::Event {
                event: Box::new(event.clone()),
                uid: client.map(|client| client.uid),
                user: None,
            },
        })
    }

    /// Sets the user's name.
    pub(super) fn name_user(&mut self, name: impl FnOnce(u32) -> Option<String>) {
        if let Self::Command(CommandEntry { user, uid, .. }) | Self::Event { user, uid, .. } = self {
            *user = uid.and_then(name);
        }
    }

    /// The bound that it falls under, and whether it belongs to the running session, if this is its id.
    pub(super) fn kind(&self, running: &str) -> (Kind, bool) {
        match self {
            Self::SessionStarted { session, .. } | Self::SessionEnded { session, .. } => {
                (Kind::Play, session.id == running)
            }
            Self::Command(CommandEntry { play: Some(_), .. })
            | Self::Pattern { .. }
            | Self::Answered { .. } => (Kind::Play, true),
            Self::Command(CommandEntry { command: "estop", is_of_owner, .. }) => (Kind::EStop, *is_of_owner),
            Self::Command(CommandEntry { is_of_owner, .. }) => (Kind::Other, *is_of_owner),
            Self::Edge { .. } => (Kind::Other, true),
            Self::Event { event, .. } => match &**event {
                Event::Queued { .. } | Event::Began { .. } | Event::SessionReleased { .. } => {
                    (Kind::Play, true)
                }
                Event::Items { session, .. } => (Kind::Play, session.as_deref() == Some(running)),
                Event::Ended { receipt } => (Kind::Play, receipt.session() == Some(running)),
                _ => (Kind::Other, false),
            },
            _ => (Kind::Other, false),
        }
    }

    /// Whether a session lacks something without this entry of its file. Commands that begin no play
    /// do not count: what they do has entries of its own.
    pub(super) fn counts(&self) -> bool {
        self.kind("").0 == Kind::Play || matches!(self, Self::Edge { .. })
    }

    /// Whether it is the end of a play.
    pub(super) fn ends_play(&self) -> bool {
        matches!(self, Self::Event { event, .. } if matches!(**event, Event::Ended { .. }))
    }
}
