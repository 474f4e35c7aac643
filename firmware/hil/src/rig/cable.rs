//! The two ways of bytes between host and device: each may be bad, and the device may lie.
//!
//! The ways are those of the simulation in virtual time ([`meissner_stream::faulty`]), so a fault means the same on all benches.
//! What reaches the device reaches it in the step after it was sent; what reaches the host, in the step in which it was sent.

use firmware_protocol::message::DeviceMessage;
use meissner_stream::faulty::{Direction, Liar, Line};
use meissner_stream::time::HostInstant;

/// Shares of the host's frames with a fault, as a scenario gives them.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Faults {
    /// Lost.
    pub loss: f64,
    /// Sent twice.
    pub repeat: f64,
    /// Damaged by a flipped bit.
    pub corrupt: f64,
}

impl Faults {
    /// The line towards the device.
    pub(super) fn line(self) -> Line {
        Line { loss: self.loss, repeat: self.repeat, corrupt: self.corrupt, ..Line::default() }
    }
}

/// Bytes under way. Instants are those of a clock that is right, not of the host's.
#[derive(Debug)]
pub(super) struct Cable {
    to_device: Direction,
    to_host: Direction,
    liar: Option<Liar>,
    /// The frame that the device has begun to send: the line harms whole frames.
    begun: Vec<u8>,
}

impl Cable {
    pub(super) fn new(to_device: Line, seed: u64) -> Self {
        Self {
            to_device: Direction::new(to_device, seed),
            to_host: Direction::new(Line::default(), !seed),
            liar: None,
            begun: Vec::new(),
        }
    }

    pub(super) fn set(&mut self, to_device: Line, to_host: Line) {
        (self.to_device.line, self.to_host.line) = (to_device, to_host);
    }

    /// Whether what the host sends arrives at once and whole.
    pub(super) fn reaches_device(&self) -> bool {
        self.to_device.line == Line::default()
    }

    pub(super) fn lie(&mut self, lie: Option<impl FnMut(&mut DeviceMessage) + Send + 'static>) {
        self.liar = lie.map(Liar::new);
    }

    /// Frames harmed so far, both ways.
    pub(super) fn harmed(&self) -> u64 {
        self.to_device.harmed() + self.to_host.harmed()
    }

    /// The host sends a frame.
    pub(super) fn send(&mut self, now: HostInstant, frame: &[u8]) {
        self.to_device.send(now, frame);
    }

    /// Bytes between the host's frames, which the line does not harm.
    pub(super) fn push(&mut self, now: HostInstant, bytes: &[u8]) {
        let line = std::mem::take(&mut self.to_device.line);
        self.to_device.send(now, bytes);
        self.to_device.line = line;
    }

    /// Takes what has reached the device.
    pub(super) fn for_device(&mut self, now: HostInstant) -> Vec<u8> {
        self.to_device.arrived(now)
    }

    /// The device has sent these bytes.
    pub(super) fn hear(&mut self, now: HostInstant, bytes: &[u8]) {
        for &byte in bytes {
            self.begun.push(byte);
            if byte == 0 {
                let frame = std::mem::take(&mut self.begun);
                let Self { to_host, liar, .. } = self;
                match liar {
                    Some(liar) => liar.change(&frame, |frame| to_host.send(now, frame)),
                    None => to_host.send(now, &frame),
                }
            }
        }
    }

    /// Bytes come as if from the device, between two of its frames.
    pub(super) fn inject(&mut self, now: HostInstant, bytes: &[u8]) {
        self.to_host.send(now, bytes);
    }

    /// Takes what has reached the host.
    pub(super) fn for_host(&mut self, now: HostInstant) -> Vec<u8> {
        self.to_host.arrived(now)
    }

    /// Loses everything that is under way.
    pub(super) fn clear(&mut self) {
        self.to_device.clear();
        self.to_host.clear();
        self.begun.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::frame::{MAX_FRAME, encode};

    const NOW: HostInstant = HostInstant::from_ns(1_000_000);

    #[test]
    fn a_frame_that_comes_in_pieces_is_lost_as_a_whole() {
        let mut cable = Cable::new(Line::default(), 1);
        cable.hear(NOW, &[3, 1]);
        assert!(cable.for_host(NOW).is_empty());
        cable.set(Line::default(), Line { loss: 1.0, ..Line::default() });
        cable.hear(NOW, &[2, 0, 2, 9]);
        cable.set(Line::default(), Line::default());
        cable.hear(NOW, &[0]);
        assert_eq!(cable.for_host(NOW), [2, 9, 0]);
        assert_eq!(cable.harmed(), 1);
    }

    #[test]
    fn bytes_between_frames_are_not_harmed() {
        let mut cable = Cable::new(Line { loss: 1.0, ..Line::default() }, 1);
        cable.send(NOW, &[2, 7, 0]);
        cable.push(NOW, &[2, 8, 0]);
        assert_eq!(cable.for_device(NOW), [2, 8, 0]);
        assert!(!cable.reaches_device());
    }

    #[test]
    fn a_lie_is_a_whole_frame() {
        let mut frame = [0; MAX_FRAME];
        let len = encode(&DeviceMessage::NoSession, &mut frame).unwrap();
        let mut cable = Cable::new(Line::default(), 1);
        cable.lie(Some(|message: &mut DeviceMessage| {
            *message =
                DeviceMessage::SelfTest { run: 7, state: firmware_protocol::board::SelfTestState::Refused };
        }));
        cable.hear(NOW, &frame[..len]);
        let changed = cable.for_host(NOW);
        assert!(changed.ends_with(&[0]) && changed != frame[..len]);
    }
}
