//! Events on their way to listeners and to the session record.
//!
//! An event is written once, as the bytes of its server-sent event; all listeners share them.
//!
//! Bounds: a listener may be up to [`EVENTS`] events behind; beyond that it gets [`Event::Lagged`]. Waiting events take at most 34
//! MB, because a receipt has at most 32 KiB, and so have 32 items of a sequence.

use crate::record::{Entry, Peer, Record};
use axum::body::Bytes;
use meissner_api::Event;
use tokio::sync::broadcast;

/// Events a listener may be behind.
const EVENTS: usize = 1024;

/// An event as listeners get it: one server-sent event, whose data is one line.
pub(in crate::daemon) fn frame(event: &Event) -> Bytes {
    let mut frame = format!("event: {}\ndata: ", event.name()).into_bytes();
    // Writing to a vector does not fail, and events can be serialized.
    let _ = serde_json::to_writer(&mut frame, event);
    frame.extend_from_slice(b"\n\n");
    frame.into()
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Publisher {
    pub(in crate::daemon) record: Record,
    /// None once the daemon ends: listeners get what was published before, then the end.
    listeners: Option<broadcast::Sender<Bytes>>,
}

impl Publisher {
    pub(in crate::daemon) fn new(record: Record) -> Self {
        Self { record, listeners: Some(broadcast::channel(EVENTS).0) }
    }

    /// Publishes an event; `client` is the owner of the play that it is about.
    pub(in crate::daemon) fn publish(&self, event: &Event, client: Option<Peer>) {
        if let Some(entry) = Entry::of(event, client) {
            self.record.add(entry);
        }
        if let Event::Lost { events } = event {
            self.record.lose(*events);
        }
        self.announce(event);
    }

    /// Publishes an event to the listeners alone.
    pub(in crate::daemon) fn announce(&self, event: &Event) {
        if let Some(listeners) = self.listeners.as_ref().filter(|listeners| listeners.receiver_count() > 0) {
            // An error means that the last listener has gone.
            let _ = listeners.send(frame(event));
        }
    }

    /// A listener to everything from now on; none once the daemon ends.
    pub(in crate::daemon) fn subscribe(&self) -> Option<broadcast::Receiver<Bytes>> {
        Some(self.listeners.as_ref()?.subscribe())
    }

    /// Ends the streams of all listeners.
    pub(in crate::daemon) fn close(&mut self) {
        self.listeners = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn listeners_share_the_bytes_of_an_event() {
        let publisher = Publisher::new(Record::none());
        let mut listeners = [(); 2].map(|()| publisher.subscribe().unwrap());
        publisher.publish(&Event::Lost { events: 3 }, None);
        let [first, second] = listeners.each_mut().map(|listener| listener.try_recv().unwrap());
        assert_eq!(&*first, b"event: lost\ndata: {\"event\":\"lost\",\"notices\":3}\n\n");
        assert_eq!(first.as_ptr(), second.as_ptr());
    }

    #[test]
    fn the_longest_event_is_bounded() {
        let receipt = crate::receipts::tests::longest();
        let frame = frame(&Event::Ended { receipt: Box::new(receipt) });
        assert!((34 << 10..41 << 10).contains(&frame.len()), "{} bytes", frame.len());
    }
}
