//! Finds an e-stop before what came earlier is read: in a byte stream, or in a USB control request.
//!
//! A firmware gives each packet to [`Watch::look`] in its USB interrupt, before it queues the packet. So an e-stop takes
//! effect while the device still reads earlier frames. Version, CRC and message are checked as in any frame. A frame
//! that is missed here is still read in order later.
//!
//! Behind a flood, packets wait in the device. So a device on USB also takes an e-stop by a control request on endpoint 0
//! ([`e_stop_request`]), which waits for nothing else: it looks at it in the interrupt of the SETUP packet.

use crate::frame::{self, MAX_SHORT, decode_cobs};
use crate::message::{HostMessage, Op};

/// The vendor request of an e-stop (`bRequest`).
const E_STOP_REQUEST: u8 = b'E';
/// Host to device, vendor, recipient device (`bmRequestType`): no driver that holds an interface stands in its way.
const TO_DEVICE: u8 = 0x40;

/// The SETUP packet of an e-stop that begins `epoch`: it has no data. The host sends it besides the frame, which the device then
/// takes for a repetition. A device that does not know it answers with STALL.
#[must_use]
pub const fn e_stop_request(epoch: u16) -> [u8; 8] {
    let [low, high] = epoch.to_le_bytes();
    [TO_DEVICE, E_STOP_REQUEST, low, high, 0, 0, 0, 0]
}

/// The epoch of the e-stop in a SETUP packet, if it is one.
#[must_use]
pub const fn e_stop_requested(setup: [u8; 8]) -> Option<u16> {
    match setup {
        [TO_DEVICE, E_STOP_REQUEST, low, high, 0, 0, 0, 0] => Some(u16::from_le_bytes([low, high])),
        _ => None,
    }
}

/// An urgent message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Urgent {
    /// An e-stop that begins this epoch.
    EStop(u16),
    /// A host opens this session.
    Hello(u32),
}

/// Watches one stream.
#[derive(Debug, Default)]
pub struct Watch {
    /// The bytes since the last delimiter, up to the length of an urgent frame.
    frame: [u8; MAX_SHORT],
    len: usize,
}

impl Watch {
    /// A watch at the start of a stream.
    #[must_use]
    pub const fn new() -> Self {
        Self { frame: [0; MAX_SHORT], len: 0 }
    }

    /// Takes the next bytes of the stream and returns the last urgent message that ends in them. It does not look at the
    /// bytes after an e-stop, to save time.
    pub fn look(&mut self, mut bytes: &[u8]) -> Option<Urgent> {
        let mut seen = None;
        // An interrupt may bring 64 bytes: this looks for delimiters only, and at frames only that may be urgent.
        while let Some(at) = delimiter(bytes) {
            let (end, rest) = bytes.split_at(at);
            bytes = rest.get(1..).unwrap_or_default();
            if self.len == 0 && !may_be_urgent(end) {
                continue;
            }
            self.keep(end);
            let len = core::mem::take(&mut self.len);
            if let Some(message) = self.frame.get_mut(..len).and_then(urgent) {
                seen = Some(message);
                if matches!(message, Urgent::EStop(_)) {
                    // The bytes left may begin a frame; mark it as too long.
                    self.len = if bytes.is_empty() { 0 } else { MAX_SHORT + 1 };
                    return seen;
                }
            }
        }
        self.keep(bytes);
        seen
    }

    /// Keeps bytes of a frame. Of one that gets too long it keeps only that.
    fn keep(&mut self, bytes: &[u8]) {
        let len = (self.len + bytes.len()).min(MAX_SHORT + 1);
        if let Some(place) = self.frame.get_mut(self.len..len) {
            place.copy_from_slice(&bytes[..place.len()]);
        }
        self.len = len;
    }
}

/// The position of the first zero. Four bytes at a time: the loop takes most of an interrupt's time.
#[inline(never)]
fn delimiter(bytes: &[u8]) -> Option<usize> {
    let mut at = 0;
    while let Some(&[a, b, c, d]) = bytes.get(at..at + 4).and_then(|four| four.first_chunk()) {
        if a == 0 {
            return Some(at);
        }
        if b == 0 {
            return Some(at + 1);
        }
        if c == 0 {
            return Some(at + 2);
        }
        if d == 0 {
            return Some(at + 3);
        }
        at += 4;
    }
    while let Some(&byte) = bytes.get(at) {
        if byte == 0 {
            return Some(at);
        }
        at += 1;
    }
    None
}

/// Whether an encoded frame may be a `Hello` (0) or a `Control` (2): by its length, version and variant. COBS makes a zero
/// of the variant to the end of the block that its first byte begins.
fn may_be_urgent(frame: &[u8]) -> bool {
    match *frame {
        [code, frame::PROTOCOL, variant, ..] if frame.len() <= MAX_SHORT => {
            code == 2 || (code > 2 && variant == 2)
        }
        _ => false,
    }
}

/// Not inlined: the loop over the bytes needs the registers.
#[inline(never)]
fn urgent(frame: &mut [u8]) -> Option<Urgent> {
    if !may_be_urgent(frame) {
        return None;
    }
    match frame::read(frame::body(decode_cobs(frame)?)) {
        Ok(HostMessage::Control { epoch, op: Op::EStop, .. }) => Some(Urgent::EStop(epoch)),
        Ok(HostMessage::Hello { session }) => Some(Urgent::Hello(session)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::frame::{MAX_FRAME, encode};
    use crate::tick::WireTick;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn bytes(message: &HostMessage<'_>) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let len = encode(message, &mut out).unwrap();
        out[..len].to_vec()
    }

    fn strokes(batch: &[u8]) -> Vec<u8> {
        let base = WireTick([1, 2, 3, 4]);
        bytes(&HostMessage::Strokes { epoch: 1, seq: 2, seen: 3, mark: None, withdraw: None, base, batch })
    }

    proptest! {
        /// With any bytes before them, in packets of any size.
        #[test]
        fn an_e_stop_and_a_hello_are_seen_in_any_stream(
            epoch: u16, seen: u16, session: u32, before in prop::collection::vec(any::<u8>(), 0..200),
            batch in prop::collection::vec(any::<u8>(), 0..60), packet in 1usize..64,
        ) {
            let estop = bytes(&HostMessage::Control { epoch, seen, op: Op::EStop });
            let hello = bytes(&HostMessage::Hello { session });
            prop_assert!(estop.len() <= MAX_SHORT + 1 && hello.len() <= MAX_SHORT + 1);
            for (urgent, want) in [(estop, Urgent::EStop(epoch)), (hello, Urgent::Hello(session))] {
                let mut stream = before.clone();
                stream.push(0);
                stream.extend(strokes(&batch));
                stream.extend(&urgent);
                let mut watch = Watch::new();
                let found: Vec<_> = stream.chunks(packet).filter_map(|packet| watch.look(packet)).collect();
                prop_assert_eq!(found.last(), Some(&want));
                // The first half of a frame behind an urgent one does not make its second half urgent.
                stream.extend(&urgent[..3]);
                stream.push(0);
                prop_assert_eq!(watch.look(&stream), Some(want));
                prop_assert_eq!(watch.look(&urgent[3..]), None);
            }
        }

        #[test]
        fn a_setup_packet_is_an_e_stop_only_as_a_whole(epoch: u16, at in 0usize..8, bit in 0u8..8) {
            let setup = e_stop_request(epoch);
            prop_assert_eq!(e_stop_requested(setup), Some(epoch));
            let mut other = setup;
            other[at] ^= 1 << bit;
            let changed = u16::from_le_bytes([other[2], other[3]]);
            prop_assert_eq!(e_stop_requested(other), matches!(at, 2 | 3).then_some(changed));
        }

        #[test]
        fn nothing_else_is_urgent(batch in prop::collection::vec(any::<u8>(), 0..60), token: u16, at: usize) {
            let mut watch = Watch::new();
            let ordinary = [strokes(&batch), bytes(&HostMessage::Ping { token, seen: 0 }),
                bytes(&HostMessage::Control { epoch: token, seen: 0, op: Op::Stop })];
            for frame in ordinary {
                prop_assert_eq!(watch.look(&frame), None);
            }
            let mut damaged = bytes(&HostMessage::Control { epoch: token, seen: 0, op: Op::EStop });
            let at = at % (damaged.len() - 1);
            damaged[at] ^= 0x10;
            prop_assert_eq!(watch.look(&damaged), None);
        }
    }
}
