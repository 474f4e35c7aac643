//! A play as the daemon hands it to the streamer, and what became of each of its items.
//!
//! Invariant: a play has as many [`Item`]s as its strokes. The streamer fills them without an allocation.

use crate::bandwidth::Bandwidth;
use crate::link::ClockEstimate;
use crate::source::Source;
use crate::time::HostInstant;
use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_api::LatePolicy;
use meissner_array::per_motor::PerMotor;
use std::time::Duration;

/// When a play begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// As soon as possible, or without a gap after the play before it.
    Next,
    /// At this tick of the device's present boot.
    Tick(Tick),
    /// At the tick nearest to this instant of the host's clock, by the estimate when the streamer takes the command.
    Monotonic(HostInstant),
    /// So many nanoseconds after the streamer takes the command.
    After(u64),
    /// So many nanoseconds, to the nearest tick, after an edge of the trigger input: the first that comes when the play is taken and the
    /// plays before it are over.
    Edge(u64),
}

/// A device tick, and when it came on the host's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// The tick.
    pub tick: Tick,
    /// The same on `CLOCK_MONOTONIC`.
    pub at: HostInstant,
    /// Its uncertainty, ns.
    pub uncertainty_ns: u64,
}

impl Stamp {
    pub(crate) fn new(tick: Tick, clock: &ClockEstimate) -> Self {
        let at = clock.instant_of(tick);
        Self { tick, at, uncertainty_ns: clock.uncertainty(at).as_nanos() as u64 }
    }
}

/// A rising edge of the trigger input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Its number since the device started.
    pub number: u32,
    /// When it came.
    pub at: Stamp,
}

/// An item of a play: one pattern of a sequence, or the pattern of a play of one. What the daemon asks for, and the account that
/// the streamer keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Item {
    /// What the trigger output gives at the onset; `None`: nothing.
    pub trigger: Option<Trigger>,
    /// Its onset, once the play has one.
    pub(crate) onset: Tick,
    /// The end of its last stroke that the device has accepted.
    pub(crate) last_end: Tick,
    /// Its strokes so far, sent or too late to be sent, and those without a verdict.
    pub(crate) planned: u32,
    pub(crate) undecided: u32,
    /// The onset, once the device has reported it: the trigger was given at this tick.
    pub began: Option<Stamp>,
    /// The end of its last stroke that the device accepted (its onset without one), once the device is known to have come so far;
    /// `None` if the play was cut before.
    pub ended: Option<Stamp>,
    /// Start of its first stroke that the device accepted.
    pub first_up: Option<Tick>,
    /// Strokes that came too late.
    pub late: u32,
    /// Strokes that the device refused.
    pub refused: u32,
}

impl Item {
    /// An item with this trigger.
    pub const fn new(trigger: Option<Trigger>) -> Self {
        Self {
            trigger,
            onset: Tick(0),
            last_end: Tick(0),
            planned: 0,
            undecided: 0,
            began: None,
            ended: None,
            first_up: None,
            late: 0,
            refused: 0,
        }
    }
}

/// A compiled pattern or sequence, ready to be played.
#[derive(Debug)]
pub struct Play {
    /// Identifies the play in events.
    pub id: u64,
    /// Its strokes.
    pub strokes: Source,
    /// Its items.
    pub items: Vec<Item>,
    /// When it begins.
    pub at: At,
    /// What to do when strokes are late.
    pub late: LatePolicy,
    /// Stop the running play and clear the queue first.
    pub replace: bool,
    /// Do not correct from telemetry.
    pub open_loop: bool,
    /// The first edge of the trigger input after the onset stops it, as [`Command::Stop`](super::Command::Stop) does.
    pub stop_on_edge: bool,
    /// Of a live play: it ends when its client is silent for so long.
    pub live: Option<Duration>,
    /// The bandwidth it requires; [`Bandwidth::default`] requires none.
    pub bandwidth: Bandwidth,
    /// How long a pin may stay above rest without a pulse, ticks: the device then lowers it. [`HOLD_ALWAYS`]: as long as the device allows.
    pub hold: u32,
    /// The pulses of each motor that the device accepted: the first, and the first tick after the last; `None`: it did not move.
    pub pins: PerMotor<Option<[Tick; 2]>>,
}

/// A pin may stay above rest without a pulse for as long as the device allows.
pub const HOLD_ALWAYS: u32 = u32::MAX;

impl Play {
    /// A play of one item as soon as possible, with corrections: late strokes are dropped, the trigger output gives a pulse, and
    /// the play requires no bandwidth.
    pub fn new(id: u64, strokes: impl Into<Source>) -> Self {
        let strokes = strokes.into();
        Self {
            pins: PerMotor::all(strokes.array(), None),
            hold: HOLD_ALWAYS,
            id,
            items: vec![Item::new(Some(strokes.array().layout().trigger_pulse()))],
            strokes,
            at: At::Next,
            late: LatePolicy::Drop,
            replace: false,
            open_loop: false,
            stop_on_edge: false,
            live: None,
            bandwidth: Bandwidth::default(),
        }
    }
}
