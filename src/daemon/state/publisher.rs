//! Events on their way to listeners and to the session record.
//!
//! Bounds: a listener may be [`EVENTS`] behind, then it gets [`Event::Lagged`].

use crate::session_record::{Entry, Peer, SessionRecord};
use meissner_api::Event;
use tokio::sync::broadcast;

/// Events a listener may be behind.
const EVENTS: usize = 1024;

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Publisher {
    pub(in crate::daemon) session_record: SessionRecord,
    /// None once the daemon ends: listeners get what was published before, then the end.
    listeners: Option<broadcast::Sender<Event>>,
}

impl Publisher {
    pub(in crate::daemon) fn new(session_record: SessionRecord) -> Self {
        Self { session_record, listeners: Some(broadcast::channel(EVENTS).0) }
    }

    /// Publishes an event; `client`: whose play it is about.
    pub(super) fn publish(&self, event: &Event, client: Option<Peer>) {
        if let Some(entry) = Entry::of(event, client) {
            self.session_record.add(entry);
        }
        if let Some(listeners) = &self.listeners {
            // An error means that there is no listener.
            let _ = listeners.send(event.clone());
        }
    }

    /// A listener to everything from now on; none once the daemon ends.
    pub(in crate::daemon) fn subscribe(&self) -> Option<broadcast::Receiver<Event>> {
        Some(self.listeners.as_ref()?.subscribe())
    }

    /// Ends the streams of all listeners.
    pub(in crate::daemon) fn close(&mut self) {
        self.listeners = None;
    }
}
