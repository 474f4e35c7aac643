//! What the streamer tells comes in here: notices become answers, the record and events, and plays that are over are looked at.
//!
//! It decides nothing. Events are published under the engine's lock, in the order of the notices; the log hears of them after it.
//!
//! Invariant: no notice waits for the log, a listener or the disk.

use super::connect::Word;
use super::engine::{Engine, Inner};
use super::predictor::{Asked, Predictor};
use super::service::Teller;
use crate::receipts::PlayedPattern;
use meissner_api::Event;
use meissner_design::MOST_OBSERVED_S;
use meissner_stream::queues::{EventQueue, StreamEvent};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// So long after a play the streamer is woken: by then the device has told what its last bursts came to.
const MEASURED: Duration = Duration::from_millis(300);
/// So long after that it is looked at.
const READ: Duration = Duration::from_millis(50);

impl Engine {
    /// Takes in notices until the streamer ends, and has plays looked at when their bursts have been measured.
    pub(super) async fn pump(
        self: Arc<Self>,
        mut notices: EventQueue,
        feeler: Predictor,
        mut teller: Teller,
    ) -> io::Result<()> {
        let bell = bell(&notices)?;
        // When to look at which play, and whether the streamer has been woken for it.
        let mut due: Vec<(Instant, u64, bool)> = Vec::new();
        loop {
            let next = due.iter().map(|(at, ..)| *at).min();
            let wait = async {
                match next {
                    Some(at) => tokio::time::sleep_until(at.into()).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                ready = bell.readable() => ready?.clear_ready(),
                () = self.stirred.notified() => {}
                () = wait => {}
            }
            // Silenced before it is drained: what comes in between rings again.
            notices.clear_wake();
            {
                let mut inner = self.lock();
                while let Some(traveled) = notices.pop_measured() {
                    inner.travels.add(traveled);
                    if let Some(calibrating) = &mut inner.calibrating {
                        calibrating.add(traveled);
                    }
                }
            }
            while let Some(notice) = notices.pop() {
                if matches!(notice, StreamEvent::ThreadEnded) {
                    return Ok(());
                }
                let (event, quiet) = self.lock().take(notice);
                match &event {
                    Some(Event::Connected { .. }) => self.settle_down(),
                    // Later its first minute is forgotten.
                    Some(Event::Began { id, .. }) => {
                        due.push((
                            Instant::now() + Duration::from_secs_f64(MOST_OBSERVED_S) + MEASURED,
                            *id,
                            false,
                        ));
                    }
                    Some(Event::Ended { receipt }) => {
                        due.retain(|(_, id, _)| *id != receipt.id);
                        due.push((Instant::now() + MEASURED, receipt.id, false));
                    }
                    _ => {}
                }
                // After it is passed on, and outside of the lock: the log may be slow.
                if let Some(event) = event.filter(|_| !quiet) {
                    self.log(&event);
                }
            }
            teller.look(&self);
            let now = Instant::now();
            for (at, id, woken) in due.iter_mut().filter(|(at, ..)| *at <= now) {
                if *woken {
                    self.look(&feeler, *id);
                } else {
                    (*at, *woken) = (now + READ, true);
                    self.lock().orders.wake_thread();
                }
            }
            due.retain(|(at, ..)| *at > now);
        }
    }

    /// Has a play looked at, if that was not done yet.
    fn look(self: &Arc<Self>, feeler: &Predictor, id: u64) {
        self.fit(feeler, id);
        let (asked, bursts) = {
            let mut inner = self.lock();
            let Some((pattern, telemetry)) = inner.unseen.remove(&id) else { return };
            let Some(receipt) = inner.receipts.receipt(id).cloned() else { return };
            let look = PlayedPattern::at(&receipt, &pattern);
            let bursts = look.map(|look| inner.travels.within(look.onset, look.until()).copied().collect());
            let bursts: Vec<_> = bursts.unwrap_or_default();
            (Asked { pattern, receipt, telemetry }, bursts)
        };
        feeler.look(self, asked, bursts);
    }
}

impl Inner {
    /// What is to be told of a notice, and whether it is no news for the log.
    pub(super) fn take(&mut self, notice: StreamEvent) -> (Option<Event>, bool) {
        let event = match &notice {
            StreamEvent::Answer { ticket, result } => self.answered(*ticket, *result),
            StreamEvent::Connected(_) => {
                (self.lost, self.missing) = (None, None);
                self.travels.clear();
                self.receipts.take(&notice)
            }
            // A port that is no board is opened again and again: that is no news.
            StreamEvent::Disconnected { reason, .. } => {
                self.missing = Some(format!("{}: {reason}", self.receipts.kind()));
                let event = self.receipts.take(&notice);
                event.filter(|_| self.lost.replace(reason) != Some(*reason))
            }
            other => self.receipts.take(other),
        };
        if let Some(event) = &event {
            self.publish(event);
        }
        if let StreamEvent::Disconnected { device, .. } = notice {
            // Gone once per connection, and the connector empties its channel: it cannot be full.
            if let Some(connector) = &self.connector {
                let _ = connector.try_send(Word::Gone(device));
            }
        }
        // At the end it is the daemon that lets go.
        let quiet = self.closing && matches!(event, Some(Event::Disconnected { .. }));
        (event, quiet)
    }
}

/// The notices' descriptor, as tokio watches it.
#[expect(
    deprecated,
    reason = "the other constructor is unsafe; an owned descriptor stays open while it is watched"
)]
fn bell(notices: &EventQueue) -> io::Result<AsyncFd<OwnedFd>> {
    AsyncFd::with_interest(notices.as_fd().try_clone_to_owned()?, Interest::READABLE)
}
