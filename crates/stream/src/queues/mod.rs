//! The bounded queues between the streamer's thread and its callers: requests in, events out.
//!
//! [`queues`] makes both ends. A caller puts a [`Request`] into the [`CommandQueue`] and takes each [`StreamEvent`] from
//! the [`EventQueue`]; the thread holds [`ThreadQueues`]. Emergency stops have a way of their own, [`EStopSwitch`], and so have the
//! [`Heights`] of the pins.
//!
//! Invariant: the thread never waits. A full command queue hands the request back to the caller. A nearly full event
//! queue drops single late strokes, refused strokes and snapshots first, and counts what it drops
//! ([`StreamEvent::EventsLost`] follows when there is room); the accounts of plays stay complete.
//! Whatever owns memory leaves through the event queue, to be dropped outside the thread.

mod error;
mod estop;
mod heights;
mod live;
mod message;
mod outcome;
mod play;

use crate::sync::{Doorbell, ring};
use crate::time::HostInstant;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use rustix::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
// A count alone: it tells nothing about other data.
use std::sync::atomic::{AtomicU64, Ordering};

pub use crate::control::MeasuredBurst;
pub use error::{CommandError, MAX_QUEUED_PLAYS, refusal_text};
pub use estop::{ESTOP_TICKETS, EStopSwitch};
pub use heights::{Heights, LATELY_MS, LatelyHeights};
pub use live::{Applied, LiveResult, LiveUpdate};
pub use message::{Command, Emit, Request, StreamEvent};
pub use outcome::{End, Movement, Onset, Outcome, Pins, RestErrors, Snapshot};
pub use play::{At, Edge, HOLD_ALWAYS, Item, Play, Stamp};

/// Most requests that wait. The model checker has small queues, so that they become full.
const COMMANDS: usize = if cfg!(loom) { 2 } else { 64 };
/// Most events that wait.
const EVENTS: usize = if cfg!(loom) { 4 } else { 4096 };
/// Most measured bursts that wait: the paper's motors at 300 Hz for two seconds.
const MEASURED_BURSTS: usize = if cfg!(loom) { 1 } else { 1 << 15 };
/// Late strokes, refused strokes and snapshots leave so many places free for answers and the ends of plays.
const RESERVED: usize = if cfg!(loom) { 2 } else { 1024 };

/// The caller's end of the command queue.
#[derive(Debug)]
pub struct CommandQueue {
    ring: ring::Producer<Request>,
    wake: Arc<Doorbell>,
    estop: EStopSwitch,
    heights: Heights,
    loops: Arc<AtomicU64>,
}

impl CommandQueue {
    /// Sends a request to the thread and wakes it.
    ///
    /// # Errors
    /// Hands the request back if the queue is full.
    pub fn send(&mut self, request: Request) -> Result<(), Request> {
        self.ring.push(request).map_err(|ring::PushError::Full(request)| request)?;
        self.wake_thread();
        Ok(())
    }

    /// The switch for emergency stops.
    pub fn estop_switch(&self) -> EStopSwitch {
        self.estop.clone()
    }

    /// The heights of the pins lately.
    pub fn heights(&self) -> Heights {
        self.heights.clone()
    }

    /// Wakes the thread: it reads what the device has sent meanwhile, and reports it.
    pub fn wake_thread(&self) {
        self.wake.ring();
    }

    /// How often the thread's loop has run. Each [`Self::wake_thread`] makes it run, unless the thread hangs.
    pub fn loop_count(&self) -> u64 {
        self.loops.load(Ordering::Relaxed)
    }
}

/// The caller's end of the event queue. Its descriptor is readable when there are events.
#[derive(Debug)]
pub struct EventQueue {
    ring: ring::Consumer<StreamEvent>,
    measured: ring::Consumer<MeasuredBurst>,
    wake: Arc<Doorbell>,
}

impl EventQueue {
    /// Takes the oldest event. Without one the descriptor is unreadable until there are more.
    pub fn pop(&mut self) -> Option<StreamEvent> {
        let event = self.ring.pop().or_else(|_| {
            // Clear, then look again: what comes in between rings again.
            self.wake.clear();
            self.ring.pop()
        });
        event.ok()
    }

    /// Takes the oldest measured burst. These do not wake the caller: snapshots do, ten times a second.
    pub fn pop_measured(&mut self) -> Option<MeasuredBurst> {
        self.measured.pop().ok()
    }

    /// Waits for events, however long that takes: in the model, which has no descriptors.
    #[cfg(loom)]
    pub fn wait(&self) {
        self.wake.wait(std::time::Duration::MAX);
    }
}

impl AsFd for EventQueue {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.wake.as_fd()
    }
}

/// The thread's ends of both queues.
#[derive(Debug)]
pub struct ThreadQueues {
    requests: ring::Consumer<Request>,
    events: ring::Producer<StreamEvent>,
    measured: ring::Producer<MeasuredBurst>,
    requests_wake: Arc<Doorbell>,
    events_wake: Arc<Doorbell>,
    estop: EStopSwitch,
    heights: Heights,
    /// The newest emergency stop that the thread has executed.
    last_estop: u64,
    /// After how many more requests an emergency stop is due, if one is.
    estop_after: Option<usize>,
    loops: Arc<AtomicU64>,
    lost: u64,
    must_wake: bool,
}

/// Makes both queues and returns their ends.
///
/// # Errors
/// If the kernel gives no event descriptors.
pub fn queues() -> std::io::Result<(ThreadQueues, CommandQueue, EventQueue)> {
    let (requests_wake, events_wake) = (Arc::new(Doorbell::new()?), Arc::new(Doorbell::new()?));
    let estop = EStopSwitch::new(Arc::clone(&requests_wake), Doorbell::new()?);
    let heights = Heights::new(Some(Arc::clone(&requests_wake)));
    let (request_in, requests) = ring::RingBuffer::new(COMMANDS);
    // Both event rings are touched once: memory is locked page by page, and the first touch must not fall into a play.
    let (mut events, mut event_out) = ring::RingBuffer::new(EVENTS);
    while events.push(StreamEvent::ThreadEnded).is_ok() {}
    while event_out.pop().is_ok() {}
    let (mut measured, mut measured_out) = ring::RingBuffer::new(MEASURED_BURSTS);
    let blank = MeasuredBurst {
        motor: 0,
        start: Tick(0),
        direction: Direction::Up,
        pulses: 0,
        travel_um: 0.0,
        sd_um: 0.0,
        rested: false,
    };
    while measured.push(blank).is_ok() {}
    while measured_out.pop().is_ok() {}
    let loops = Arc::default();
    let commands = CommandQueue {
        ring: request_in,
        wake: Arc::clone(&requests_wake),
        estop: estop.clone(),
        heights: heights.clone(),
        loops: Arc::clone(&loops),
    };
    let listener = EventQueue { ring: event_out, measured: measured_out, wake: Arc::clone(&events_wake) };
    let thread = ThreadQueues {
        requests,
        events,
        measured,
        requests_wake,
        events_wake,
        estop,
        heights,
        last_estop: 0,
        estop_after: None,
        loops,
        lost: 0,
        must_wake: false,
    };
    Ok((thread, commands, listener))
}

impl ThreadQueues {
    /// Takes the oldest request, or the newest emergency stop: after the requests that waited when it was seen, before all others.
    /// Without any, [`Self::wake_fd`] is unreadable until there are more.
    pub fn pop(&mut self) -> Option<Request> {
        self.take().or_else(|| {
            // Clear, then look again: what is sent in between rings again.
            self.requests_wake.clear();
            self.take()
        })
    }

    fn take(&mut self) -> Option<Request> {
        if self.estop_after.is_none() {
            // First the emergency stop, then the requests: those sent before it are seen with it.
            let newest = self.estop.newest();
            if newest != self.last_estop {
                (self.last_estop, self.estop_after) = (newest, Some(self.requests.slots()));
            }
        }
        match &mut self.estop_after {
            Some(0) => {
                self.estop_after = None;
                let ticket = ESTOP_TICKETS + self.last_estop;
                Some(Request { ticket, issued_at: HostInstant::now(), command: Command::EStop })
            }
            Some(before) => {
                *before -= 1;
                self.requests.pop().ok()
            }
            None => self.requests.pop().ok(),
        }
    }

    /// Counts one run of the thread's loop.
    pub fn count_loop(&self) {
        self.loops.fetch_add(1, Ordering::Relaxed);
    }

    /// Readable when there are requests; [`Self::pop`] makes it unreadable.
    pub fn wake_fd(&self) -> BorrowedFd<'_> {
        self.requests_wake.as_fd()
    }

    /// Waits for requests, however long that takes: in the model, which has no descriptors.
    #[cfg(loom)]
    pub fn wait(&self) {
        self.requests_wake.wait(std::time::Duration::MAX);
    }

    /// Wakes the caller if there are new events.
    pub fn wake_listener(&mut self) {
        if std::mem::take(&mut self.must_wake) {
            self.events_wake.ring();
        }
    }
}

impl Emit for ThreadQueues {
    /// Queues an event; [`Self::wake_listener`] then wakes the caller.
    fn event(&mut self, event: StreamEvent) {
        if let StreamEvent::Answer { ticket: ticket @ ESTOP_TICKETS.., result } = event {
            self.estop.set_answer(ticket - ESTOP_TICKETS, result);
        }
        // Frequent events must not displace those that come once.
        let frequent = matches!(
            event,
            StreamEvent::StrokeLate { .. }
                | StreamEvent::StrokeRefused { .. }
                | StreamEvent::PinsLowered { .. }
                | StreamEvent::Edge { .. }
                | StreamEvent::Snapshot(_)
        );
        let room = self.events.slots() > if frequent { RESERVED } else { 1 };
        if room && self.lost > 0 && self.events.push(StreamEvent::EventsLost(self.lost)).is_ok() {
            self.lost = 0;
        }
        if !room || self.events.push(event).is_err() {
            self.lost += 1;
        }
        self.must_wake = true;
    }

    /// Queues a measured burst. If the caller does not keep up, the newest are lost.
    fn measured(&mut self, burst: MeasuredBurst) {
        let _ = self.measured.push(burst);
    }

    fn heights(&self) -> Option<&Heights> {
        Some(&self.heights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frequent_events_leave_room_for_others_and_each_lost_one_is_counted() {
        let (mut thread, _commands, mut events) = queues().unwrap();
        let none = firmware_protocol::array::MotorSet::EMPTY;
        for _ in 0..EVENTS {
            thread.event(StreamEvent::PinsLowered { id: 1, tick: Tick(0), late: none, held: none });
        }
        thread.event(StreamEvent::ThreadEnded);
        let came: Vec<_> = std::iter::from_fn(|| events.pop()).collect();
        let lowered = came.iter().filter(|event| matches!(event, StreamEvent::PinsLowered { .. })).count();
        assert_eq!(lowered, EVENTS - RESERVED);
        let [.., StreamEvent::EventsLost(lost), StreamEvent::ThreadEnded] = came[..] else {
            panic!("{came:?}")
        };
        assert_eq!((lost as usize, came.len()), (RESERVED, lowered + 2));
    }
}
