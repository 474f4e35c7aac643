//! Reads the link in both directions: what has come from the host, and what the device has reported.
//!
//! It shares only the frames with host and device. It counts repetitions once and widens ticks. It reads at the device's end of the
//! line: what the line loses is not in it until the host has repeated it.

use firmware_protocol::board::{Board, SelfTestState};
use firmware_protocol::frame::{self, Decoder};
use firmware_protocol::message::{Cut, DeviceHello, DeviceMessage, HostMessage, Op, Report, Status};
use firmware_protocol::tick::{Tick, WireTick};

/// What went over the link. Moves are not in it.
#[derive(Clone, Debug)]
pub enum Event {
    /// The host opened a session.
    Opened(u32),
    /// The host gave a command, which begins this epoch.
    Control(u16, Op),
    /// The device answered the handshake.
    Greeted(DeviceHello),
    /// The device sent its status, at this tick.
    Status(Status, Tick),
    /// The device sent a report.
    Report(Report),
    /// The device sent a board report.
    Board(Board),
    /// The device said how far a self-test is.
    SelfTest(u16, SelfTestState),
}

/// Everything that went over the link in one boot of the device.
#[derive(Debug, Default)]
pub struct Tap {
    /// Events, with the cycle at which they came to the device or from it.
    pub events: Vec<(u64, Event)>,
    host: Decoder,
    device: Decoder,
    session: Option<u32>,
    /// The newest epoch that the host has begun.
    epoch: Option<u16>,
    reported: Vec<u16>,
    last: Tick,
    /// Frames of the device that could not be read.
    pub unreadable: u64,
}

impl Tap {
    /// Takes bytes that come from the host.
    pub fn from_host(&mut self, cycle: u64, mut bytes: &[u8]) {
        let mut decoder = std::mem::take(&mut self.host);
        while let Some(body) = decoder.next(&mut bytes) {
            if let Ok(message) = frame::read(body) {
                self.sent(cycle, &message);
            }
        }
        self.host = decoder;
    }

    /// Takes bytes that the device sends.
    pub fn from_device(&mut self, cycle: u64, mut bytes: &[u8]) {
        let mut decoder = std::mem::take(&mut self.device);
        while let Some(body) = decoder.next(&mut bytes) {
            match frame::read(body) {
                Ok(message) => self.said(cycle, message),
                Err(_) => self.unreadable += 1,
            }
        }
        self.device = decoder;
    }

    /// Forgets frames that have begun, because the line was cut.
    pub fn broken(&mut self) {
        self.host.reset();
        self.device.reset();
    }

    /// The epoch of the host's frames.
    pub fn epoch(&self) -> u16 {
        self.epoch.unwrap_or(0)
    }

    /// Number of the last report that the host has read.
    pub fn reports_read(&self) -> u16 {
        self.reported.last().copied().or_else(|| self.hello().map(|hello| hello.reports)).unwrap_or(0)
    }

    /// The device's last status.
    pub fn status(&self) -> Option<Status> {
        self.events.iter().rev().find_map(|(_, event)| match event {
            Event::Status(status, _) => Some(*status),
            _ => None,
        })
    }

    /// The last handshake.
    pub fn hello(&self) -> Option<DeviceHello> {
        self.events.iter().rev().find_map(|(_, event)| match event {
            Event::Greeted(hello) => Some(*hello),
            _ => None,
        })
    }

    /// The onsets of the plays that have begun, in order.
    pub fn onsets(&self) -> Vec<Tick> {
        let onsets = self.events.iter().filter_map(|(_, event)| match event {
            Event::Report(Report::Onset { tick, .. }) => Some(self.near(*tick)),
            _ => None,
        });
        onsets.collect()
    }

    /// The cuts, in order: a handshake repeats the last one.
    pub fn cuts(&self) -> Vec<(Tick, Cut)> {
        let mut cuts: Vec<(Tick, Cut)> = Vec::new();
        for (_, event) in &self.events {
            let cut = match event {
                Event::Report(Report::Cut(cut)) => Some(*cut),
                Event::Greeted(hello) => hello.last_cut,
                _ => None,
            };
            let cut = cut.map(|cut| (self.near(cut.at), cut));
            cuts.extend(cut.filter(|(at, _)| cuts.iter().all(|(known, _)| known != at)));
        }
        cuts
    }

    /// A tick that the device has sent.
    pub fn near(&self, tick: WireTick) -> Tick {
        tick.near(self.last.max(Tick::BOOT))
    }

    fn sent(&mut self, cycle: u64, message: &HostMessage<'_>) {
        let event = match *message {
            HostMessage::Hello { session } if self.session != Some(session) => {
                (self.session, self.epoch) = (Some(session), None);
                self.reported.clear();
                Event::Opened(session)
            }
            // Not repeated, nor overtaken by a newer one.
            HostMessage::Control { epoch, op, .. }
                if self.epoch.is_none_or(|present| epoch.wrapping_sub(present).cast_signed() > 0) =>
            {
                self.epoch = Some(epoch);
                Event::Control(epoch, op)
            }
            _ => return,
        };
        self.events.push((cycle, event));
    }

    fn said(&mut self, cycle: u64, message: DeviceMessage) {
        let event = match message {
            DeviceMessage::Hello(hello) => {
                self.last = Tick(hello.tick);
                self.epoch.get_or_insert(hello.epoch);
                Event::Greeted(hello)
            }
            DeviceMessage::Status(status) => {
                self.last = self.near(status.tick);
                Event::Status(status, self.last)
            }
            DeviceMessage::Report { number, .. } if self.reported.contains(&number) => return,
            DeviceMessage::Report { number, report } => {
                self.reported.push(number);
                Event::Report(report)
            }
            DeviceMessage::Board(board) => Event::Board(board),
            DeviceMessage::SelfTest { run, state } => Event::SelfTest(run, state),
            DeviceMessage::Telemetry { .. } | DeviceMessage::NoSession => return,
        };
        self.events.push((cycle, event));
    }
}
