//! The messages of the queues: requests to the streamer, and the events that it reports.

use crate::control::{Gains, MeasuredBurst};
use crate::device::Device;
use crate::link::Contradiction;
use crate::queues::error::CommandError;
use crate::queues::heights::Heights;
use crate::queues::live::LiveUpdate;
use crate::queues::outcome::{Onset, Outcome, Snapshot};
use crate::queues::play::{At, Edge, Play};
use crate::time::HostInstant;
use firmware_protocol::array::MotorSet;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::DeviceHello;
use firmware_protocol::tick::Tick;
use meissner_api::{EdgeEffect, EndCause, LateCause, LateCounts, SensorFault};
use meissner_array::per_motor::PerMotor;

/// A command with a ticket; [`StreamEvent::Answer`] carries the same ticket.
#[derive(Debug)]
pub struct Request {
    /// Identifies the answer; 0 asks for none.
    pub ticket: u64,
    /// When the client issued it. The streamer refuses a play, an arm or a reset that is a second old.
    pub issued_at: HostInstant,
    /// What to do.
    pub command: Command,
}

/// What a [`Request`] asks for.
#[derive(Debug)]
pub enum Command {
    /// Use this device from now on.
    Connect(Box<Device>),
    /// Play a pattern.
    Play(Box<Play>),
    /// Change the drives of a live play, or show that its client is there.
    UpdateLive(Box<LiveUpdate>),
    /// End this live play, if it runs, and clear the queue; stay armed.
    EndLive(u64),
    /// End this play, for this cause. If nothing of it was sent, the others stay; else as [`Self::Stop`].
    Cancel {
        /// Which play.
        id: u64,
        /// Its cause in the receipt.
        cause: EndCause,
    },
    /// Take this play out of the queue; the others stay. Refused once it runs.
    Withdraw(u64),
    /// End the running play and clear the queue; stay armed.
    Stop,
    /// Switch all lines off and latch; works without a device too.
    EStop,
    /// Leave the latched state: disarmed. Pins that stand above rest are returned before the answer comes. Refused if an emergency stop
    /// was executed that its client does not know.
    Reset {
        /// The newest emergency stop when the client's order was checked ([`super::EStopSwitch::newest`]).
        estops_seen: u64,
        /// Leave pins where they stand: the next `arm` returns them.
        keep: bool,
    },
    /// Enable the motors.
    Arm {
        /// Take every pin as being at rest: somebody has looked.
        assume_rest: bool,
    },
    /// Enable the motors before a person has checked the pins. A device that knows where they are returns those that stand; another
    /// one takes every pin as being at rest. The estimates stay, and heights add to them, until a person checks the pins; the
    /// streamer refuses once they are large.
    ArmUnchecked,
    /// Move all pins to their rest position. The answer comes when they are there.
    Home,
    /// Make an edge of a simulated array's trigger input: now ([`At::Next`]), at a tick, or after some time. Refused by a board.
    Edge {
        /// When.
        at: At,
        /// The client that orders it, for [`Self::WithdrawEdges`].
        by: u64,
    },
    /// Forget the edges to come that this client has ordered.
    WithdrawEdges(u64),
    /// Use these gains of the motors.
    SetGains(Box<PerMotor<Gains>>),
    /// Return the pins and disable the motors.
    Disarm,
    /// Disarm and end the thread. The answer comes when the device is off, or after a second.
    Shutdown,
}

/// What happened.
#[expect(clippy::large_enum_variant, reason = "the thread that makes them must not allocate")]
#[derive(Debug)]
pub enum StreamEvent {
    /// The answer to a request.
    Answer {
        /// The request's.
        ticket: u64,
        /// Done, or why not.
        result: Result<(), CommandError>,
    },
    /// A device answered the handshake.
    Connected(DeviceHello),
    /// The device is gone.
    Disconnected {
        /// Why.
        reason: EndCause,
        /// To be dropped outside the thread.
        device: Option<Box<Device>>,
    },
    /// The state of the streamer and the device.
    Snapshot(Snapshot),
    /// A play has begun.
    PlayStarted {
        /// Which play.
        id: u64,
        /// When.
        onset: Onset,
    },
    /// What became of an update: to be dropped outside the thread.
    LiveUpdated(Box<LiveUpdate>),
    /// A stroke was late and dropped whole.
    StrokeLate {
        /// Its play.
        id: u64,
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: Tick,
        /// How late, ms.
        late_ms: f64,
        /// Why.
        cause: LateCause,
        /// Late strokes of the play, this one included.
        counts: LateCounts,
    },
    /// The device refused a stroke.
    StrokeRefused {
        /// Its play.
        id: u64,
        /// Its motor.
        motor: u8,
        /// Its up tick.
        up: Tick,
        /// Why.
        reason: Refusal,
    },
    /// The device has brought pins down by itself.
    PinsLowered {
        /// The play.
        id: u64,
        /// The first tick in which it may have done so.
        tick: Tick,
        /// Motors of which a move down was late.
        late: MotorSet,
        /// Motors whose pins were held for too long.
        held: MotorSet,
    },
    /// A rising edge of the trigger input.
    Edge {
        /// Which.
        edge: Edge,
        /// The play that it started or stopped, or that ran when it came.
        play: Option<u64>,
        /// What it did.
        effect: EdgeEffect,
    },
    /// The streamer did not take this play: to be dropped outside the thread.
    PlayRejected(Box<Play>),
    /// The streamer has copied these gains: to be dropped outside the thread.
    GainsApplied(Box<PerMotor<Gains>>),
    /// A play is over.
    PlayEnded {
        /// Which play.
        id: u64,
        /// How it ended.
        outcome: Outcome,
    },
    /// The telemetry of a motor is implausible: it plays on in open loop until the next `arm`.
    SensorFault {
        /// Its motor.
        motor: u8,
        /// Why.
        fault: SensorFault,
    },
    /// The device contradicted itself, in this way for the first time since it was connected. The link ignored the message.
    Contradiction(Contradiction),
    /// The error of dead reckoning exceeds [`crate::Settings::drift_warning_um`].
    DriftWarning {
        /// The largest of all motors, one standard deviation, µm.
        um: f32,
    },
    /// So many events were lost before this one.
    EventsLost(u64),
    /// The thread ends.
    ThreadEnded,
}

/// Takes what the streamer reports: events, and measured bursts, which are far more frequent and have a queue of their own.
pub trait Emit {
    /// Takes an event.
    fn event(&mut self, event: StreamEvent);
    /// Takes a burst that telemetry has measured.
    fn measured(&mut self, burst: MeasuredBurst);
    /// Where the heights of the pins are written, for those who ask.
    fn heights(&self) -> Option<&Heights> {
        None
    }
}

/// Keeps the events, ignores measured bursts.
impl Emit for Vec<StreamEvent> {
    fn event(&mut self, event: StreamEvent) {
        self.push(event);
    }

    fn measured(&mut self, _: MeasuredBurst) {}
}
