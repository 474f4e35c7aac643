//! The deciding part of the streamer: orders, controls, what the device says, and the ends of plays.
//!
//! CommandQueue are taken in `orders`, what the device says in `events`, strokes are fed ahead in `feed`, and plays end
//! in `ends`. Invariant: each play that was taken ends with exactly one
//! [`StreamEvent::PlayEnded`], and each order that asks for an answer gets exactly one.

mod commands;
mod ends;
mod events;
mod feed;
mod homing;

use crate::Settings;
use crate::active::{Active, Phase};
use crate::control::PositionControl;
use crate::link::{Event, LineRate, Session};
use crate::queues::{CommandError, End, MAX_QUEUED_PLAYS, Snapshot, StreamEvent};
use crate::time::HostInstant;
use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::{Cause, Counters, Op, State, Status};
use firmware_protocol::stroke::MOTORS;
use firmware_protocol::tick::Tick;
use homing::Homing;
use meissner_array::units::{ticks_to_ms, ticks_to_seconds};
use std::collections::VecDeque;
use std::time::Duration;

/// Controls that wait for the one before them, at the most.
const CONTROLS: usize = 8;
/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);
/// While something is going on the streamer looks this often.
const BUSY_EVERY: Duration = Duration::from_millis(1);
const SNAPSHOT_EVERY: Duration = Duration::from_millis(100);
/// Keep-alives when nothing is armed.
const IDLE_PING: Duration = Duration::from_secs(1);

/// Says what happened.
pub(super) type Tell<'a> = &'a mut dyn FnMut(StreamEvent);

/// What an order came to: refused or done at once, or waiting for the device.
type Taken = Result<Option<Op>, CommandError>;

#[derive(Clone, Copy, Debug)]
struct Waiting {
    ticket: u64,
    op: Op,
    since: HostInstant,
}

/// Why a device is disconnected when another takes its place.
pub const ANOTHER_DEVICE: &str = "another device was opened";

/// The streamer of one device.
#[derive(Debug)]
pub struct Streamer {
    pub(super) settings: Settings,
    /// Those to go by from the next `arm` on.
    next_settings: Settings,
    pub(super) session: Option<Session>,
    events: VecDeque<Event>,
    /// The device's last word and the tick of it.
    status: Option<(Status, Tick)>,
    /// An e-stop was ordered and not reset: also kept for a device that comes later.
    latched: bool,
    /// The device sends telemetry.
    telemetry: bool,
    /// Controls to send, the first is being sent.
    controls: VecDeque<Waiting>,
    in_flight: bool,
    /// What the last command leads to: armed or not.
    wants_armed: bool,
    lost: Option<&'static str>,
    pub(super) plays: VecDeque<Active>,
    pub(super) control: PositionControl,
    /// Up to where the device is fed.
    pub(super) fed: Tick,
    /// The last stroke had to wait for credits.
    pub(super) short_of_credits: bool,
    homing: Option<Homing>,
    /// The last move, if it went up: motor, pulses, when it is over.
    last_move: Option<(u8, u16, Tick)>,
    /// Motors whose telemetry was told not to be believed.
    told_doubts: [bool; MOTORS],
    told_drift: bool,
    closing: Option<(u64, HostInstant)>,
    closed: bool,
    snapshot_due: HostInstant,
    /// Whether the last snapshot said that a device is there.
    told_there: bool,
    /// And what the line carries.
    told_line: Option<u32>,
}

impl Streamer {
    /// A streamer without a device.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            next_settings: settings,
            session: None,
            events: VecDeque::with_capacity(4096),
            status: None,
            latched: false,
            telemetry: false,
            controls: VecDeque::with_capacity(CONTROLS),
            in_flight: false,
            wants_armed: false,
            lost: None,
            plays: VecDeque::with_capacity(2 * MAX_QUEUED_PLAYS + 2),
            control: PositionControl::new(&settings.limits),
            fed: Tick(0),
            short_of_credits: false,
            homing: None,
            last_move: None,
            told_doubts: [false; MOTORS],
            told_drift: false,
            closing: None,
            closed: false,
            snapshot_due: HostInstant::default(),
            told_there: false,
            told_line: None,
        }
    }

    /// A device was opened; `id` is a random number.
    pub fn connect(&mut self, now: HostInstant, id: u32, rate: LineRate, tell: Tell<'_>) {
        self.disconnect(now, ANOTHER_DEVICE, tell);
        self.session = Some(Session::new(id, rate, now));
    }

    /// The device is gone: plays end, with what is known of them.
    pub fn disconnect(&mut self, now: HostInstant, cause: &'static str, tell: Tell<'_>) {
        let Some(session) = self.session.take() else { return };
        self.lost = Some(cause);
        self.wants_armed = false;
        self.cut_all(End::Stopped, cause);
        let counters = self.status.map(|(status, tick)| {
            let lost = session.clock().tick_at(now).unwrap_or(tick);
            let (bursts, pulses) = self.control.played_unheard(tick, lost);
            let counters = status.counters;
            Counters { played: counters.played + bursts, pulses: counters.pulses + pulses, ..counters }
        });
        let wire = session.traffic().bytes_out;
        let tick = self.status.map_or(Tick(0), |(_, tick)| tick);
        let rest_um = self.control.rest_error_um(tick).map(|(um, _)| um);
        self.close_all(counters, wire, rest_um, tell);
        while let Some(waiting) = self.controls.pop_front() {
            answer(waiting.ticket, Err(CommandError::NoDevice), tell);
        }
        self.end_homing(Err(CommandError::NoDevice), tell);
        self.in_flight = false;
        self.status = None;
        self.control.cut();
        (self.fed, self.short_of_credits) = (Tick(0), false);
        if let Some((ticket, _)) = self.closing.take() {
            self.closed = true;
            answer(ticket, Ok(()), tell);
        }
        self.snapshot_due = now;
    }

    /// Whether the order to shut down has been carried out.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Why the device was lost, once.
    pub fn take_lost(&mut self) -> Option<&'static str> {
        self.lost.take()
    }

    /// The device's tick at `now`.
    #[must_use]
    pub fn tick_at(&self, now: HostInstant) -> Option<Tick> {
        self.session.as_ref().and_then(|session| session.clock().tick_at(now))
    }

    /// Whether a device has said how it stands.
    fn is_there(&self) -> bool {
        self.status.is_some() && self.session.as_ref().is_some_and(Session::can_command)
    }

    pub(super) fn state(&self) -> State {
        match &self.status {
            _ if self.latched => State::Faulted,
            Some((status, _)) => status.state,
            None => State::Disarmed,
        }
    }

    /// Does what is due at `now`. Call it after [`Self::receive`] and [`Self::execute`], before [`Self::transmit`].
    pub fn step(&mut self, now: HostInstant, tell: Tell<'_>) {
        if let Some(session) = &mut self.session {
            let events = &mut self.events;
            session.check_silence(now, &mut |event| events.push_back(event));
        }
        self.drain(now, tell);
        self.next_control();
        self.expire(now, tell);
        if let Some(tick) = self.tick_at(now) {
            self.go_home(now, tick, tell);
            self.feed(now, tick, tell);
            self.correct(tick);
            self.finish(tick, tell);
        } else if self.session.is_none() {
            self.close_all(None, 0, [0.0; MOTORS], tell);
        }
        self.close(now, tell);
        let there = self.is_there();
        let line = self.session.as_ref().and_then(Session::capacity);
        if now >= self.snapshot_due || there != self.told_there || line != self.told_line {
            (self.told_there, self.told_line) = (there, line);
            let playing = !self.plays.is_empty() || self.state() == State::Returning;
            let far = if playing { SNAPSHOT_EVERY } else { IDLE_PING };
            self.snapshot_due = now + far;
            self.warn(now, tell);
            tell(StreamEvent::Snapshot(self.snapshot(now)));
        }
    }

    fn correct(&mut self, tick: Tick) {
        let idle = self.in_flight || self.state() != State::Armed;
        let Some(session) = self.session.as_mut().filter(|_| !idle) else { return };
        // Plays are fed in order: what is not sent yet belongs to the last one that is being fed, or comes after it.
        let fed =
            self.plays.iter().rev().find(|active| active.cut.is_none() && active.phase != Phase::Waiting);
        let free = |motor| fed.map_or(tick, |active| active.free_until(motor));
        self.control.correct(tick, free, |item| session.amend(item));
    }

    /// Tells of motors whose telemetry is not believed, and of drift.
    fn warn(&mut self, now: HostInstant, tell: Tell<'_>) {
        for ((told, fault), motor) in self.told_doubts.iter_mut().zip(self.control.faults()).zip(0..) {
            if let Some(fault) = fault.filter(|_| !*told) {
                tell(StreamEvent::SensorFault { motor, fault });
            }
            *told = fault.is_some();
        }
        let um = self.control.reckoned_um(self.tick_at(now).unwrap_or_default());
        let drifted = um > self.settings.drift_warning_um;
        if drifted && !self.told_drift {
            tell(StreamEvent::DriftWarning { um });
        }
        self.told_drift = drifted;
    }

    fn snapshot(&self, now: HostInstant) -> Snapshot {
        let open = self.session.as_ref().filter(|session| session.is_open());
        let tick = self.tick_at(now).unwrap_or_default();
        let traffic = self.session.as_ref().map(Session::traffic).unwrap_or_default();
        let rest = self.control.rest_error_um(tick);
        let status = self.status.map(|(status, _)| status);
        let running = self.plays.iter().rev().find(|active| {
            active.cut.is_none() && active.started().is_some_and(|onset| onset.actual <= tick)
        });
        let played = |active: &Active| {
            let since = active.onset.map_or(0, |onset| tick - onset);
            (active.play.id, ticks_to_seconds(since))
        };
        let lead = ticks_to_ms(self.fed - tick);
        Snapshot {
            at: now,
            connected: self.is_there(),
            state: self.state(),
            cause: if self.latched {
                Cause::EStop
            } else {
                status.map_or(Cause::Boot, |status| status.cause)
            },
            position_known: status.is_some_and(|status| status.position_known),
            tick,
            clock_uncertainty_us: open
                .and_then(|session| session.clock().uncertainty(now))
                .map_or(f64::INFINITY, |uncertainty| uncertainty.as_nanos() as f64 / 1000.0),
            play: running.map(played),
            lead_ms: if self.short_of_credits && running.is_some() { lead } else { self.settings.lead_ms },
            lease_ms: self.settings.lease_ms,
            rest_error_um: rest.map(|(um, _)| um),
            source: rest.map(|(_, source)| source),
            line_bytes_per_s: self.session.as_ref().and_then(Session::capacity),
            bytes_out: traffic.bytes_out,
            bytes_in: traffic.bytes_in,
            retransmitted: traffic.retransmitted,
            bad_frames: traffic.bad,
            device_bad_frames: status.map_or(0, |status| status.counters.bad_frames),
        }
    }

    /// Writes the next frame that is due into `out` and returns its length; 0 when none is.
    pub fn transmit(&mut self, now: HostInstant, out: &mut [u8; MAX_FRAME], tell: Tell<'_>) -> usize {
        let Some(session) = &mut self.session else { return 0 };
        let events = &mut self.events;
        let len = session.transmit(now, out, &mut |event| events.push_back(event));
        self.drain(now, tell);
        len
    }

    /// When [`Self::step`] is due, if nothing happens before.
    #[must_use]
    pub fn wake_at(&self, now: HostInstant) -> HostInstant {
        let quiet = self.plays.is_empty()
            && self.controls.is_empty()
            && self.homing.is_none()
            && self.closing.is_none()
            && self.state() != State::Returning;
        let Some(session) = &self.session else {
            // That it is gone is still to be told.
            let far = if self.told_there { Duration::ZERO } else { Duration::from_secs(3600) };
            return now + far;
        };
        let next = session.wake_at(now).min(self.snapshot_due);
        if quiet && session.is_open() { next } else { next.min(now + BUSY_EVERY) }
    }
}

fn answer(ticket: u64, result: Result<(), CommandError>, tell: Tell<'_>) {
    if ticket != 0 {
        tell(StreamEvent::Answer { ticket, result });
    }
}

/// Whether a command ends what is played.
const fn cuts(op: &Op) -> bool {
    matches!(op, Op::Stop | Op::Disarm(_) | Op::EStop)
}

/// A cause as events, receipts and the API name it.
#[must_use]
pub fn cause_text(cause: Cause) -> &'static str {
    match cause {
        Cause::Boot => "boot",
        Cause::Request => "request",
        Cause::Stop => "stop",
        Cause::Shutdown => "shutdown",
        Cause::Abort => "abort",
        Cause::EStop => "estop",
        Cause::HostTimeout => "lease",
        Cause::LinkLost => "link-lost",
        Cause::NewHost => "new-host",
        Cause::Starved => "starved",
        Cause::Panic => "panic",
        Cause::Watchdog => "watchdog",
    }
}
