//! What goes into the streamer's thread and what comes out: orders and notices, through bounded rings.
//!
//! The thread never waits for either side. A full order ring gives the order back to the caller; a notice ring
//! that is nearly full loses single late strokes and snapshots first, and counts what it lost
//! ([`Notice::Lost`] follows when there is room). Receipts count every burst all the same.
//! Everything that owns memory goes back out to be dropped.

use crate::device::Device;
use crate::strokes::Strokes;
use crate::units::HostInstant;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, DeviceHello, State};
use firmware_protocol::stroke::MOTORS;
use firmware_protocol::tick::Tick;
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;

/// Plays that wait behind the running one, at the most.
pub const QUEUE: usize = 16;
/// Orders and notices that wait, at the most.
const ORDERS: usize = 64;
const NOTICES: usize = 4096;
/// Places that single late strokes, refusals and snapshots leave free for answers and the ends of plays.
const RESERVED: usize = 1024;

/// Something to do; the answer comes as [`Notice::Answer`] with the same ticket.
#[derive(Debug)]
pub struct Order {
    /// Names the answer; 0 if none is wanted.
    pub ticket: u64,
    /// When it was given: a play, an arm or a reset that waited for a second is not carried out any more.
    pub given: HostInstant,
    /// What to do.
    pub job: Job,
}

/// What an [`Order`] asks for.
#[derive(Debug)]
pub enum Job {
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

/// What to do when strokes come late.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LatePolicy {
    /// Drop them whole and go on.
    #[default]
    Drop,
    /// End the play: return, disarm.
    Abort,
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
}

/// Why an order was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// No device is connected.
    #[error("no device is connected: plug it in, or see `meissner status`")]
    NoDevice,
    /// The controller is not armed.
    #[error("the motors are disarmed: run `meissner arm` first")]
    Disarmed,
    /// Emergency stop or fault is latched.
    #[error("an emergency stop or fault is latched: find out why, then `meissner reset` and `meissner arm`")]
    Faulted,
    /// Pins are being returned.
    #[error("pins are being returned: try again in a moment")]
    Returning,
    /// `QUEUE` plays wait.
    #[error("16 plays are queued already: wait, or `meissner stop`")]
    QueueFull,
    /// The play before it has no end.
    #[error("the play before it has no end: stop it, or use --replace")]
    BehindEndless,
    /// The onset asked for cannot be kept.
    #[error("the onset asked for is too soon or already past: choose a later one")]
    TooSoon,
    /// The onset asked for is further ahead than the protocol reaches.
    #[error("the onset asked for is more than an hour and a half ahead: choose a sooner one")]
    TooFar,
    /// The onset asked for lies within the play before it.
    #[error(
        "the onset asked for lies before the end of the plays queued: choose a later one, or use --replace"
    )]
    Overlaps,
    /// The device refused the command.
    #[error("the device refused: {}", refusal_text(*.0))]
    Device(Refusal),
    /// The device did not answer in time.
    #[error("the device does not answer: check its cable and power")]
    Timeout,
}

/// A refusal in words for a person.
#[must_use]
pub fn refusal_text(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::NotArmed => "it is not armed",
        Refusal::Motor => "there is no such motor",
        Refusal::UpPulses => "a stroke of no or more than 3000 pulses",
        Refusal::Bursts => "a stroke's bursts overlap",
        Refusal::Unbalanced => "a stroke does not come back to rest",
        Refusal::Overlap => "two strokes of one motor overlap",
        Refusal::TooFar => "it lies too far ahead",
        Refusal::PoolFull => "no free stroke slot",
        Refusal::MotorOnTime => "a motor's on-time limit",
        Refusal::RailOnTime => "a rail's on-time limit",
        Refusal::PositionUnknown => {
            "it does not know where the pins are; see that all are at rest, then `meissner arm --assume-rest`"
        }
        Refusal::State => "not in its present state",
        Refusal::Travel => "a move beyond the travel limit",
        Refusal::Malformed => "it could not read it",
    }
}

/// What came of a play: how its bursts (halves of strokes) ended.
/// At the end `planned = played + late + dropped + refused`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Bursts {
    /// Handed to the link, or late before they could be.
    pub planned: u64,
    /// Played, whole or cut.
    pub played: u64,
    /// Too late to be played.
    pub late: u64,
    /// Flushed by a stop, a fault or a lost link.
    pub dropped: u64,
    /// Against a limit.
    pub refused: u64,
    /// Played with a corrected count.
    pub amended: u64,
}

/// Pulses of a play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Pulses {
    /// Of the planned bursts.
    pub planned: u64,
    /// As the device counted them.
    pub played: u64,
}

/// Where a late stroke lost its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LateCause {
    /// The streamer woke up too late.
    Host,
    /// Sent in time, but it took the link too long.
    Link,
    /// The device gave no credits in time.
    Device,
}

/// The late strokes of a play.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Lateness {
    /// Strokes by cause.
    pub host: u64,
    /// Strokes by cause.
    pub link: u64,
    /// Strokes by cause.
    pub device: u64,
    /// The latest, ms.
    pub worst_ms: f64,
}

/// How a play ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum End {
    /// All of it was streamed and is over.
    Done,
    /// By a stop, replace, disarm, e-stop, lost link.
    Stopped,
    /// By late strokes under [`LatePolicy::Abort`], or an onset that could not be kept.
    Aborted,
}

/// When a play began.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Onset {
    /// The tick first asked for.
    pub requested: Tick,
    /// The tick at which the device began it.
    pub actual: Tick,
    /// The same on `CLOCK_MONOTONIC`.
    pub at: HostInstant,
    /// How well that is known, ns.
    pub uncertainty_ns: u64,
    /// From the order to the onset, ns.
    pub latency_ns: u64,
}

/// A finished play.
#[derive(Debug)]
pub struct Outcome {
    /// How it ended.
    pub end: End,
    /// Why, unless it is done.
    pub cause: Option<&'static str>,
    /// When it began; `None` if it never did.
    pub onset: Option<Onset>,
    /// Its bursts.
    pub bursts: Bursts,
    /// Its pulses.
    pub pulses: Pulses,
    /// Its late strokes.
    pub lateness: Lateness,
    /// Bytes of the frames sent to the device while it ran, all overhead included.
    pub wire_bytes: u64,
    /// Estimated rest error of each motor at the end, µm.
    pub rest_error_um: [f32; MOTORS],
    /// The play itself, to be dropped outside the thread.
    pub play: Box<Play>,
}

/// Where the estimate of a rest error comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ErrorSource {
    /// Nothing is known.
    #[default]
    None,
    /// Measured by telemetry.
    Telemetry,
    /// Dead reckoning from the bursts played.
    DeadReckoning,
}

/// How everything stands, published on change and ten times a second while something is played.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot {
    /// When this was true.
    pub at: HostInstant,
    /// Whether a device answers.
    pub connected: bool,
    /// The controller's state; [`State::Faulted`] also when the daemon latched an e-stop without a device.
    pub state: State,
    /// Why.
    pub cause: Cause,
    /// Whether the device knows where the pins are.
    pub position_known: bool,
    /// Down pulses owed.
    pub owed: u32,
    /// The device's clock, estimated for `at`.
    pub tick: Tick,
    /// How well it is known, µs.
    pub clock_uncertainty_us: f64,
    /// The running play's id and how long it has played, s.
    pub play: Option<(u64, f64)>,
    /// Lead that is really reached, ms: less than asked for if the device's credits do not allow it.
    pub lead_ms: f64,
    /// Estimated rest error per motor, µm.
    pub rest_error_um: [f32; MOTORS],
    /// Where the estimate comes from.
    pub source: ErrorSource,
    /// Bytes sent to and received from the device since it was connected.
    pub bytes_out: u64,
    /// Bytes received.
    pub bytes_in: u64,
    /// Frames sent again.
    pub retransmitted: u64,
}

/// What happened.
#[derive(Debug)]
pub enum Notice {
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
    /// A play is over.
    Ended {
        /// Which.
        id: u64,
        /// What came of it.
        outcome: Outcome,
    },
    /// So many notices were lost before this one.
    Lost(u64),
    /// The thread ends.
    Bye,
}

/// The caller's end of the order ring.
#[derive(Debug)]
pub struct Orders {
    ring: rtrb::Producer<Order>,
    wake: Arc<OwnedFd>,
}

impl Orders {
    /// Hands an order to the thread and wakes it.
    ///
    /// # Errors
    /// Gives the order back if the ring is full. An emergency stop always finds a place that others may not take.
    pub fn send(&mut self, order: Order) -> Result<(), Order> {
        if self.ring.slots() <= 1 && !matches!(order.job, Job::EStop) {
            return Err(order);
        }
        self.ring.push(order).map_err(|rtrb::PushError::Full(order)| order)?;
        ring_bell(&self.wake);
        Ok(())
    }
}

/// The caller's end of the notice ring. Its descriptor is readable when there are notices.
#[derive(Debug)]
pub struct Notices {
    ring: rtrb::Consumer<Notice>,
    wake: Arc<OwnedFd>,
}

impl Notices {
    /// The oldest notice.
    pub fn pop(&mut self) -> Option<Notice> {
        self.ring.pop().ok()
    }

    /// Makes the descriptor unreadable until there are more.
    pub fn silence(&self) {
        silence_bell(&self.wake);
    }
}

impl AsFd for Notices {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.wake.as_fd()
    }
}

/// The thread's ends of both rings.
#[derive(Debug)]
pub struct Port {
    orders: rtrb::Consumer<Order>,
    notices: rtrb::Producer<Notice>,
    orders_wake: Arc<OwnedFd>,
    notices_wake: Arc<OwnedFd>,
    lost: u64,
    unannounced: bool,
}

/// Both ends, connected.
///
/// # Errors
/// If the kernel gives no event descriptors.
pub fn port() -> std::io::Result<(Port, Orders, Notices)> {
    let flags = EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK;
    let (orders_wake, notices_wake) = (Arc::new(eventfd(0, flags)?), Arc::new(eventfd(0, flags)?));
    let (to_thread, orders) = rtrb::RingBuffer::new(ORDERS);
    let (mut notices, mut from_thread) = rtrb::RingBuffer::new(NOTICES);
    // Touched once: memory is locked page by page, and the first touch must not fall into a play.
    for _ in 0..NOTICES {
        let _ = notices.push(Notice::Bye);
    }
    while from_thread.pop().is_ok() {}
    let caller = Orders { ring: to_thread, wake: Arc::clone(&orders_wake) };
    let listener = Notices { ring: from_thread, wake: Arc::clone(&notices_wake) };
    let port = Port { orders, notices, orders_wake, notices_wake, lost: 0, unannounced: false };
    Ok((port, caller, listener))
}

impl Port {
    /// The oldest order.
    pub fn pop(&mut self) -> Option<Order> {
        self.orders.pop().ok()
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
    pub fn tell(&mut self, notice: Notice) {
        // What comes in crowds must not push out what comes once.
        let crowd =
            matches!(notice, Notice::Late { .. } | Notice::StrokeRefused { .. } | Notice::Snapshot(_));
        let room = self.notices.slots() > if crowd { RESERVED } else { 1 };
        if room && self.lost > 0 && self.notices.push(Notice::Lost(self.lost)).is_ok() {
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
