//! The event loop: processes the streamer's events, and starts the fit of a calibration whose play has ended.
//!
//! Under the engine's lock, streamer events become answers, receipts and published events, in their order; then the loop logs them.
//!
//! Invariant: no event waits for the log, a listener or the disk.

use crate::daemon::calibration::apply;
use crate::daemon::core::engine::Engine;
use crate::daemon::core::log_lines;
use crate::daemon::core::service::StatusReporter;
use crate::exposure::{Account, Now};
use meissner_api::Event;
use meissner_stream::queues::{EventQueue, StreamEvent};
use meissner_stream::time::HostInstant;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::time::Instant;

/// How long after a calibration's end the loop wakes the streamer: by then the device has measured the last bursts.
const MEASURED_AFTER: Duration = Duration::from_millis(300);
/// How long after that the streamer has read the measurements.
const READ_AFTER: Duration = Duration::from_millis(50);

/// The least time between two events that more entries of the session record are lost.
const LOSSES_APART: Duration = Duration::from_secs(1);

/// The play of a calibration that waits for its last measurements.
struct Due {
    at: Instant,
    play: u64,
    /// Whether the streamer was woken for its last measurements.
    woken: bool,
}

impl Engine {
    /// Runs until the streamer ends.
    pub(in crate::daemon) async fn event_loop(
        self: Arc<Self>,
        mut events: EventQueue,
        mut status: StatusReporter,
    ) -> io::Result<()> {
        let readable = readable(&events)?;
        let mut due: Option<Due> = None;
        let mut told = (None, 0, Instant::now());
        let mut untold: Option<Instant> = None;
        loop {
            let record = self.record().changed();
            let next = due.as_ref().map(|due| due.at).into_iter().chain(untold).min();
            let wait = async {
                match next {
                    Some(at) => tokio::time::sleep_until(at).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                ready = readable.readable() => ready?.clear_ready(),
                () = self.changed.notified() => {}
                () = record.notified() => {}
                () = wait => {}
            }
            {
                let mut state = self.lock();
                while let Some(burst) = events.pop_measured() {
                    state.calibration.add(burst);
                }
            }
            while let Some(streamed) = events.pop() {
                if matches!(streamed, StreamEvent::ThreadEnded) {
                    return Ok(());
                }
                let (event, is_new) = self.lock().apply(streamed);
                match &event {
                    // Until the clock is known, the status does not show the device as connected.
                    Some(Event::State { tick, .. }) if *tick > 0 => self.set_first_device_known(),
                    Some(Event::Ended { receipt }) => {
                        let play = receipt.id;
                        if self.lock().calibration.is_running(play) {
                            due = Some(Due { at: Instant::now() + MEASURED_AFTER, play, woken: false });
                        }
                        self.play_ended.notify_waiters();
                    }
                    _ => {}
                }
                // Log after publishing and outside the lock, because the log may be slow.
                if let Some(event) = event.filter(|_| is_new) {
                    log_lines::log(&self, &event);
                }
            }
            untold = self.tell_record(&mut told);
            status.update(&self);
            let now = Instant::now();
            if let Some(over) = due.take_if(|due| due.at <= now) {
                if over.woken {
                    apply::finish_calibration(&self, over.play);
                } else {
                    due = Some(Due { at: now + READ_AFTER, woken: true, ..over });
                    self.lock().commands.wake_streamer();
                }
            }
        }
    }

    /// Publishes a new problem of the session record, its end, and that it has lost entries: what was `told` last, and when it may be
    /// told again that more are lost. Returns when there may be more to tell.
    fn tell_record(&self, told: &mut (Option<String>, u64, Instant)) -> Option<Instant> {
        let mut state = self.lock();
        let record = &state.publisher.record;
        let (is_written, lost) = (record.problem().is_none(), record.lost());
        let sums = || Account::problem(&state.exposure, Now::read());
        let problem = record.problem().or_else(sums).or_else(|| record.found());
        let is_more = is_written && lost > told.1;
        // The disk may stand still without a further notice.
        let now = HostInstant::now();
        let stalls = record.stalls_at().map(|at| Instant::now() + at.since(now));
        if problem == told.0 && !(is_more && Instant::now() >= told.2) {
            return is_more.then_some(told.2).into_iter().chain(stalls).min();
        }
        *told = (problem.clone(), lost, Instant::now() + LOSSES_APART);
        state.publish(&Event::RecordProblem { problem, lost });
        stalls
    }
}

/// A queue's descriptor, which tokio watches.
#[expect(
    deprecated,
    reason = "the other constructor is unsafe; an owned descriptor stays open while it is watched"
)]
pub(in crate::daemon) fn readable(queue: impl AsFd) -> io::Result<AsyncFd<OwnedFd>> {
    AsyncFd::with_interest(queue.as_fd().try_clone_to_owned()?, Interest::READABLE)
}
