//! Reads the link in both directions: what has come from the host, and what the device has reported.
//!
//! It shares only the frames with host and device. It counts repetitions once and widens ticks. It reads at the device's end of the
//! line: what the line loses is not in it until the host has repeated it.

use firmware_protocol::batch::{self, Amendment, Amendments, Unpacked};
use firmware_protocol::board::{Board, SelfTestState};
use firmware_protocol::frame::{self, Decoder};
use firmware_protocol::message::{
    DeviceHello, DeviceMessage, HostMessage, Mark, Op, Report, Status, Trigger, Withdraw,
};
use firmware_protocol::tick::{Tick, WireTick};

/// A frame of the ordered stream.
#[derive(Clone, Debug)]
pub struct Batch {
    /// The epoch it belongs to.
    pub epoch: u16,
    /// Its number within the epoch.
    pub seq: u16,
    /// Whether it begins a play at `base`.
    pub mark: Option<Mark>,
    /// Whose queued moves it replaces, from `base` on.
    pub withdraw: Option<Withdraw>,
    /// The tick from which its moves count.
    pub base: Tick,
    /// Its moves; none if the list cannot be read.
    pub moves: Vec<Unpacked>,
}

/// What went over the link.
#[derive(Clone, Debug)]
pub enum Event {
    /// The host opened a session.
    Opened(u32),
    /// The host gave a command, which begins this epoch.
    Control(u16, Op),
    /// The host sent moves.
    Batch(Batch),
    /// The host sent amendments.
    Amend(Vec<Amendment>),
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
    /// The device has no session.
    NoSession,
}

/// Everything that went over the link in one boot of the device.
#[derive(Debug, Default)]
pub struct Tap {
    /// Events, with the cycle at which they came to the device or from it. Moves are in the order of their frames' numbers, which is
    /// that in which the device takes them.
    pub events: Vec<(u64, Event)>,
    host: Decoder,
    device: Decoder,
    session: Option<u32>,
    /// The newest epoch that the host has begun.
    epoch: Option<u16>,
    seen: Vec<(u16, u16)>,
    reported: Vec<u16>,
    last: Tick,
    /// Frames of the device that could not be read.
    pub unreadable: u64,
}

/// Whether a number that repeats after 65 536 comes after another.
fn is_after(number: u16, other: u16) -> bool {
    number.wrapping_sub(other).cast_signed() > 0
}

impl Tap {
    /// Takes bytes that come from the host.
    pub fn from_host(&mut self, cycle: u64, mut bytes: &[u8]) {
        let mut decoder = std::mem::take(&mut self.host);
        while let Some(body) = decoder.next(&mut bytes) {
            if let Ok(message) = frame::read(body) {
                self.sent(cycle, message);
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
    #[must_use]
    pub fn epoch(&self) -> u16 {
        self.epoch.unwrap_or(0)
    }

    /// Number of the last report that the host has read.
    #[must_use]
    pub fn reports_read(&self) -> u16 {
        self.reported.last().copied().or_else(|| self.hello().map(|hello| hello.reports)).unwrap_or(0)
    }

    /// What the host wanted of the trigger output at this onset.
    #[must_use]
    pub fn trigger_at(&self, onset: Tick) -> Option<Trigger> {
        self.events.iter().rev().find_map(|(_, event)| match event {
            Event::Batch(batch) if batch.base == onset => batch.mark?.trigger,
            _ => None,
        })
    }

    /// The device's last status.
    #[must_use]
    pub fn status(&self) -> Option<Status> {
        self.events.iter().rev().find_map(|(_, event)| match event {
            Event::Status(status, _) => Some(*status),
            _ => None,
        })
    }

    /// The last handshake.
    #[must_use]
    pub fn hello(&self) -> Option<DeviceHello> {
        self.events.iter().rev().find_map(|(_, event)| match event {
            Event::Greeted(hello) => Some(*hello),
            _ => None,
        })
    }

    fn near(&self, tick: WireTick) -> Tick {
        tick.near(self.last.max(Tick::BOOT))
    }

    fn sent(&mut self, cycle: u64, message: HostMessage<'_>) {
        let event = match message {
            HostMessage::Hello { session } if self.session == Some(session) => return,
            HostMessage::Hello { session } => {
                (self.session, self.epoch) = (Some(session), None);
                self.seen.clear();
                self.reported.clear();
                Event::Opened(session)
            }
            HostMessage::Ping { .. } | HostMessage::Board { .. } | HostMessage::SelfTest { .. } => return,
            // Repeated, or overtaken by a newer one.
            HostMessage::Control { epoch, .. }
                if self.epoch.is_some_and(|present| !is_after(epoch, present)) =>
            {
                return;
            }
            HostMessage::Control { epoch, op, .. } => {
                self.epoch = Some(epoch);
                Event::Control(epoch, op)
            }
            HostMessage::Moves { epoch, seq, .. } if self.seen.contains(&(epoch, seq)) => return,
            // Frames of another epoch, which a session sends to measure the line, are ignored.
            HostMessage::Moves { epoch, .. } if self.epoch.is_some_and(|present| present != epoch) => {
                return;
            }
            HostMessage::Moves { epoch, seq, mark, withdraw, base, batch, .. } => {
                // Numbers repeat after 65 536 frames.
                if self.seen.len() > 64 {
                    self.seen.remove(0);
                }
                self.seen.push((epoch, seq));
                self.epoch.get_or_insert(epoch);
                let base = self.near(base);
                Event::Batch(Batch {
                    epoch,
                    seq,
                    mark,
                    withdraw,
                    base,
                    moves: batch::moves(base, batch).map(|moves| moves.to_vec()).unwrap_or_default(),
                })
            }
            HostMessage::Amend { base, items, .. } => {
                Event::Amend(Amendments::new(self.near(base), items).flatten().collect())
            }
        };
        let at = self.place_of(&event);
        self.events.insert(at, (cycle, event));
    }

    /// Where an event from the host belongs: moves belong before those of later frames that have overtaken theirs.
    fn place_of(&self, event: &Event) -> usize {
        let mut at = self.events.len();
        let Event::Batch(batch) = event else { return at };
        for (place, (_, event)) in self.events.iter().enumerate().rev() {
            match event {
                Event::Batch(other) if other.epoch == batch.epoch && is_after(other.seq, batch.seq) => {
                    at = place;
                }
                Event::Batch(_) | Event::Control(..) | Event::Opened(_) => break,
                _ => {}
            }
        }
        at
    }

    fn said(&mut self, cycle: u64, message: DeviceMessage) {
        let event = match message {
            DeviceMessage::Hello(hello) => {
                self.last = Tick(hello.tick);
                self.epoch.get_or_insert(hello.epoch);
                Event::Greeted(hello)
            }
            DeviceMessage::NoSession => Event::NoSession,
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
            DeviceMessage::Telemetry { .. } => return,
        };
        self.events.push((cycle, event));
    }

    /// Widens the tick of a report.
    #[must_use]
    pub fn tick(&self, tick: WireTick) -> Tick {
        self.near(tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::frame::{MAX_FRAME, encode};

    #[test]
    fn frames_that_overtake_each_other_are_in_the_order_of_their_numbers() {
        let mut tap = Tap::default();
        let mut send = |message: &HostMessage<'_>| {
            let mut frame = [0; MAX_FRAME];
            let len = encode(message, &mut frame).unwrap();
            tap.from_host(0, &frame[..len]);
        };
        let moves = |seq| HostMessage::Moves {
            epoch: 7,
            seq,
            seen: 0,
            mark: None,
            withdraw: None,
            base: Tick::BOOT.wire(),
            batch: &[],
        };
        send(&HostMessage::Control { epoch: 7, seen: 0, op: Op::Stop });
        [1, 3, 4, 2, 3, 0].into_iter().for_each(|seq| send(&moves(seq)));
        // Older than the newest command.
        send(&HostMessage::Control { epoch: 6, seen: 0, op: Op::EStop });
        let numbers: Vec<_> = tap
            .events
            .iter()
            .map(|(_, event)| match event {
                Event::Batch(batch) => Some(batch.seq),
                _ => None,
            })
            .collect();
        assert_eq!(numbers, [None, Some(0), Some(1), Some(2), Some(3), Some(4)]);
    }
}
