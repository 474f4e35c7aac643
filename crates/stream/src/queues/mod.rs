//! What goes into the streamer's thread and what comes out: orders and notices, through bounded rings.
//!
//! The thread never waits for either side. A full order ring gives the order back to the caller; a notice ring
//! that is nearly full loses single late strokes and snapshots first, and counts what it lost
//! ([`StreamEvent::Lost`] follows when there is room). Receipts count every burst all the same.
//! Everything that owns memory goes back out to be dropped.

mod outcome;
mod refused;

use crate::device::Device;
use crate::time::HostInstant;
use crate::{Bandwidth, Gains, Settings};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::DeviceHello;
use firmware_protocol::stroke::{Direction, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_api::{LateCause, LatePolicy};
use meissner_array::strokes::Strokes;
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

pub use outcome::{End, MeasuredBurst, Onset, Outcome, Snapshot};
pub use refused::{Refused, refusal_text};

/// Plays that wait behind the running one, at the most.
pub const QUEUE: usize = 16;
/// CommandQueue and notices that wait, at the most.
const ORDERS: usize = 64;
const NOTICES: usize = 4096;
/// Measured bursts that wait, at the most: 24 motors at 300 Hz for two seconds.
const TRAVELS: usize = 1 << 15;
/// Places that single late strokes, refusals and snapshots leave free for answers and the ends of plays.
const RESERVED: usize = 1024;

/// Something to do; the answer comes as [`StreamEvent::Answer`] with the same ticket.
#[derive(Debug)]
pub struct Request {
    /// Names the answer; 0 if none is wanted.
    pub ticket: u64,
    /// When it was given: a play, an arm or a reset that waited for a second is not carried out any more.
    pub given: HostInstant,
    /// What to do.
    pub job: Command,
}

/// What an [`Request`] asks for.
#[derive(Debug)]
pub enum Command {
    /// Use this device from now on.
    Connect(Box<Device>),
    /// Play a pattern: now, at a tick, or behind what is queued.
    Play(Box<Play>),
    /// End the running play, clear the queue, stay armed.
    Stop,
    /// All lines off, latched; also without a device.
    EStop,
    /// Leave the latch: disarmed.
    Reset,
    /// Take strokes from now on.
    Arm {
        /// Take every pin as being at rest.
        assume_rest: bool,
    },
    /// Move pins to where they ought to rest. Answered when they are there.
    Home,
    /// Go by these gains from now on.
    Calibrate(Box<[Gains; MOTORS]>),
    /// Go by these settings from the next `arm` on; at once while disarmed.
    Configure(Settings),
    /// Return pins, motors off.
    Disarm,
    /// Return pins, motors off, end the thread. Answered when the device is off, or after a second.
    Shutdown,
}

/// When a play begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// As soon as can be, or gaplessly behind the play before it.
    Next,
    /// At a tick of the device's present boot.
    Tick(Tick),
    /// So long after the order was taken, ns.
    After(u64),
}

/// A compiled pattern on its way to the pins.
#[derive(Debug)]
pub struct Play {
    /// Names it in notices.
    pub id: u64,
    /// Its strokes.
    pub strokes: Strokes,
    /// When it begins.
    pub at: At,
    /// What to do when strokes come late.
    pub late: LatePolicy,
    /// Stop what runs and clear the queue first.
    pub replace: bool,
    /// No corrections from telemetry.
    pub open_loop: bool,
    /// What it needs of the line; [`Bandwidth::default`] is not checked.
    pub bandwidth: Bandwidth,
}

/// What happened.
#[derive(Debug)]
pub enum StreamEvent {
    /// The answer to an order.
    Answer {
        /// The order's.
        ticket: u64,
        /// What came of it.
        result: Result<(), Refused>,
    },
    /// A device answered the handshake.
    Connected(DeviceHello),
    /// The device is gone; the box is to be dropped.
    Disconnected {
        /// Why, in words.
        reason: &'static str,
        /// To be dropped outside the thread.
        device: Option<Box<Device>>,
    },
    /// How everything stands.
    Snapshot(Snapshot),
    /// A play has begun.
    Began {
        /// Which.
        id: u64,
        /// When.
        onset: Onset,
    },
    /// A stroke came late and was dropped whole.
    Late {
        /// Whose.
        id: u64,
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: Tick,
        /// How late, ms.
        late_ms: f64,
        /// Why.
        cause: LateCause,
    },
    /// A stroke was refused.
    StrokeRefused {
        /// Whose.
        id: u64,
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: Tick,
        /// Why.
        reason: Refusal,
    },
    /// A play that was refused, to be dropped outside the thread.
    Returned(Box<Play>),
    /// Gains that were taken over, to be dropped outside the thread.
    Freed(Box<[Gains; MOTORS]>),
    /// A play is over.
    Ended {
        /// Which.
        id: u64,
        /// What came of it.
        outcome: Outcome,
    },
    /// A burst was measured.
    MeasuredBurst(MeasuredBurst),
    /// The telemetry of a motor is not believed any more: it plays on in open loop until the next `arm`.
    SensorFault {
        /// Its motor.
        motor: u8,
        /// Why.
        fault: SensorFault,
    },
    /// Dead reckoning's error has grown beyond [`Settings::drift_warning_um`](crate::Settings).
    Drifted {
        /// The largest of all motors, one standard deviation, µm.
        um: f32,
    },
    /// So many notices were lost before this one.
    Lost(u64),
    /// The thread ends.
    Bye,
}

/// The caller's end of the order ring.
#[derive(Debug)]
pub struct CommandQueue {
    ring: rtrb::Producer<Request>,
    wake: Arc<OwnedFd>,
    turns: Arc<AtomicU64>,
}

impl CommandQueue {
    /// Hands an order to the thread and wakes it.
    ///
    /// # Errors
    /// Gives the order back if the ring is full. An emergency stop always finds a place that others may not take.
    pub fn send(&mut self, order: Request) -> Result<(), Request> {
        if self.ring.slots() <= 1 && !matches!(order.job, Command::EStop) {
            return Err(order);
        }
        self.ring.push(order).map_err(|rtrb::PushError::Full(order)| order)?;
        self.nudge();
        Ok(())
    }

    /// Wakes the thread: what the device has said meanwhile is read and told.
    pub fn nudge(&self) {
        ring_bell(&self.wake);
    }

    /// How often the thread has come round. It does so at each [`Self::nudge`], unless it hangs.
    #[must_use]
    pub fn turns(&self) -> u64 {
        self.turns.load(Ordering::Relaxed)
    }
}

/// The caller's end of the notice ring. Its descriptor is readable when there are notices.
#[derive(Debug)]
pub struct EventQueue {
    ring: rtrb::Consumer<StreamEvent>,
    travels: rtrb::Consumer<MeasuredBurst>,
    wake: Arc<OwnedFd>,
}

impl EventQueue {
    /// The oldest notice.
    pub fn pop(&mut self) -> Option<StreamEvent> {
        self.ring.pop().ok()
    }

    /// The oldest measured burst. They ring no bell: snapshots do, ten times a second.
    pub fn pop_measured(&mut self) -> Option<MeasuredBurst> {
        self.travels.pop().ok()
    }

    /// Makes the descriptor unreadable until there are more.
    pub fn silence(&self) {
        silence_bell(&self.wake);
    }
}

impl AsFd for EventQueue {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.wake.as_fd()
    }
}

/// The thread's ends of both rings.
#[derive(Debug)]
pub struct ThreadQueues {
    orders: rtrb::Consumer<Request>,
    notices: rtrb::Producer<StreamEvent>,
    travels: rtrb::Producer<MeasuredBurst>,
    orders_wake: Arc<OwnedFd>,
    notices_wake: Arc<OwnedFd>,
    turns: Arc<AtomicU64>,
    lost: u64,
    unannounced: bool,
}

/// Both ends, connected.
///
/// # Errors
/// If the kernel gives no event descriptors.
pub fn queues() -> std::io::Result<(ThreadQueues, CommandQueue, EventQueue)> {
    let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
    let (orders_wake, notices_wake) = (Arc::new(eventfd(0, flags)?), Arc::new(eventfd(0, flags)?));
    let (to_thread, orders) = rtrb::RingBuffer::new(ORDERS);
    let (mut notices, mut from_thread) = rtrb::RingBuffer::new(NOTICES);
    // Touched once: memory is locked page by page, and the first touch must not fall into a play.
    for _ in 0..NOTICES {
        let _ = notices.push(StreamEvent::Bye);
    }
    while from_thread.pop().is_ok() {}
    let (mut travels, mut traveled) = rtrb::RingBuffer::new(TRAVELS);
    let nothing = MeasuredBurst {
        motor: 0,
        start: Tick(0),
        direction: Direction::Up,
        pulses: 0,
        travel_um: 0.0,
        sd_um: 0.0,
        rested: false,
    };
    while travels.push(nothing).is_ok() {}
    while traveled.pop().is_ok() {}
    let turns = Arc::default();
    let caller = CommandQueue { ring: to_thread, wake: Arc::clone(&orders_wake), turns: Arc::clone(&turns) };
    let listener = EventQueue { ring: from_thread, travels: traveled, wake: Arc::clone(&notices_wake) };
    let thread = ThreadQueues {
        orders,
        notices,
        travels,
        orders_wake,
        notices_wake,
        turns,
        lost: 0,
        unannounced: false,
    };
    Ok((thread, caller, listener))
}

impl ThreadQueues {
    /// The oldest order.
    pub fn pop(&mut self) -> Option<Request> {
        self.orders.pop().ok()
    }

    /// Counts a turn of the thread.
    pub fn turn(&self) {
        self.turns.fetch_add(1, Ordering::Relaxed);
    }

    /// Readable when there are orders; [`Self::silence`] makes it unreadable.
    #[must_use]
    pub fn wake(&self) -> BorrowedFd<'_> {
        self.orders_wake.as_fd()
    }

    /// Makes [`Self::wake`] unreadable until there are more orders.
    pub fn silence(&self) {
        silence_bell(&self.orders_wake);
    }

    /// Tells the listener, who is woken by [`Self::announce`].
    pub fn tell(&mut self, notice: StreamEvent) {
        if let StreamEvent::MeasuredBurst(traveled) = notice {
            // What nobody takes is of no use later.
            let _ = self.travels.push(traveled);
            return;
        }
        // What comes in crowds must not push out what comes once.
        let crowd = matches!(
            notice,
            StreamEvent::Late { .. } | StreamEvent::StrokeRefused { .. } | StreamEvent::Snapshot(_)
        );
        let room = self.notices.slots() > if crowd { RESERVED } else { 1 };
        if room && self.lost > 0 && self.notices.push(StreamEvent::Lost(self.lost)).is_ok() {
            self.lost = 0;
        }
        if !room || self.notices.push(notice).is_err() {
            self.lost += 1;
        }
        self.unannounced = true;
    }

    /// Wakes the listener if it was told something.
    pub fn announce(&mut self) {
        if std::mem::take(&mut self.unannounced) {
            ring_bell(&self.notices_wake);
        }
    }
}

/// An event counter can only be full after 2^64 rings: nothing to handle.
fn ring_bell(bell: &OwnedFd) {
    let _ = rustix::io::write(bell, &1u64.to_ne_bytes());
}

fn silence_bell(bell: &OwnedFd) {
    let _ = rustix::io::read(bell, &mut [0; 8]);
}
