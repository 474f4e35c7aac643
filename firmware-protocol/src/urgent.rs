//! Finds an e-stop in a byte stream or a USB control request, before the device reads the bytes that came earlier.
//!
//! A firmware gives each packet to [`Watch::e_stop`] in its USB interrupt, before it queues the packet. So an e-stop takes
//! effect while the device still reads earlier frames. Version, CRC and message are checked as in any frame. A frame
//! that is missed here is still read in order later.
//!
//! Behind a flood, packets wait in the device. So a device on USB also takes an e-stop by a control request on endpoint 0
//! ([`e_stop_request`]), which waits for nothing else: the device looks at the request in the interrupt of its SETUP packet.

use crate::frame::{self, MAX_SHORT, decode_cobs};
use crate::message::{HostMessage, Op};

/// The vendor request of an e-stop (`bRequest`).
const E_STOP_REQUEST: u8 = b'E';
/// Host to device, vendor, recipient device (`bmRequestType`): no driver that holds an interface stands in its way.
const TO_DEVICE: u8 = 0x40;

/// The SETUP packet of an e-stop that begins `epoch`: it has no data. The host sends it besides the frame, which the device then
/// takes for a repetition. A device that does not know it answers with STALL.
pub const fn e_stop_request(epoch: u16) -> [u8; 8] {
    let [low, high] = epoch.to_le_bytes();
    [TO_DEVICE, E_STOP_REQUEST, low, high, 0, 0, 0, 0]
}

/// The epoch of the e-stop in a SETUP packet, if it is one.
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
    pub const fn new() -> Self {
        Self { frame: [0; MAX_SHORT], len: 0 }
    }

    /// Takes `bytes` up to the end of the next e-stop whose epoch is `wanted`, and returns that epoch. Returns `None` when
    /// `bytes` is used up; call it until then. It may miss an e-stop whose varints are longer than necessary.
    ///
    /// Made for an interrupt, which may bring 64 bytes. Whatever they are, their time is bounded: one pass over the bytes, and a
    /// CRC only for frames with the length, the fixed bytes and the epoch of an e-stop. 64 bytes hold five such frames.
    pub fn e_stop(&mut self, bytes: &mut &[u8], wanted: impl Fn(u16) -> bool) -> Option<u16> {
        self.find(bytes, |frame| e_stop(frame).filter(|&epoch| wanted(epoch) && frame::crc_fits(frame)))
    }

    /// Takes the next bytes of the stream and returns the last urgent message that ends in them.
    pub fn look(&mut self, mut bytes: &[u8]) -> Option<Urgent> {
        let mut last = None;
        while let Some(message) = self.find(&mut bytes, urgent) {
            last = Some(message);
        }
        last
    }

    /// Takes `bytes` up to the end of the next frame for which `read` returns something, and returns that.
    #[inline(always)]
    fn find<T>(&mut self, bytes: &mut &[u8], read: impl Fn(&[u8]) -> Option<T>) -> Option<T> {
        if self.len > 0 {
            // The rest of a frame that began in earlier bytes.
            let zero = bytes.iter().position(|&byte| byte == 0);
            let (end, rest) = bytes.split_at(zero.unwrap_or(bytes.len()));
            *bytes = rest.get(1..).unwrap_or_default();
            self.keep(end);
            zero?;
            let len = core::mem::take(&mut self.len);
            if let Some(found) = self.frame.get(..len).and_then(&read) {
                return Some(found);
            }
        }
        loop {
            let (frame, rest) = next(bytes);
            let Some(frame) = frame else {
                *bytes = &[];
                self.keep(rest);
                return None;
            };
            *bytes = rest;
            if let Some(found) = read(frame) {
                return Some(found);
            }
        }
    }

    /// Keeps bytes of a frame. Once the frame gets too long, it keeps only this fact.
    fn keep(&mut self, bytes: &[u8]) {
        let len = (self.len + bytes.len()).min(MAX_SHORT + 1);
        if let Some(place) = self.frame.get_mut(self.len..len) {
            place.copy_from_slice(&bytes[..place.len()]);
        }
        self.len = len;
    }
}

/// Least bytes of an urgent frame without its delimiter: code byte, version, variant, a number of one byte and the CRC.
const MIN_SHORT: usize = 8;

/// The first frame that is long enough to be urgent, and the bytes behind its delimiter. Without one, the bytes of a frame that has
/// only begun. A frame is long enough if its first bytes have no zero; the last zero among them tells where the next one begins. So zeros
/// and short frames take less time than their bytes.
#[inline(never)]
fn next(mut bytes: &[u8]) -> (Option<&[u8]>, &[u8]) {
    while let Some((first, more)) = bytes.split_first_chunk::<MIN_SHORT>() {
        if let Some(zero) = first.iter().rposition(|&byte| byte == 0) {
            bytes = bytes.get(zero + 1..).unwrap_or_default();
        } else if let Some(at) = delimiter(more) {
            let (frame, rest) = bytes.split_at(MIN_SHORT + at);
            return (Some(frame), rest.get(1..).unwrap_or_default());
        } else {
            return (None, bytes);
        }
    }
    let zero = bytes.iter().rposition(|&byte| byte == 0);
    (None, bytes.get(zero.map_or(0, |zero| zero + 1)..).unwrap_or_default())
}

/// The position of the first zero, four bytes at a time.
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

/// The variant of a [`HostMessage::Control`], and the op of an e-stop.
const CONTROL: u8 = 2;
const E_STOP: u8 = 3;

/// The epoch of an encoded e-stop, if the frame is one apart from its CRC, which is not checked. It reads the frame as it is
/// encoded: COBS changes only zeros, each into the distance to the next, and the first byte tells where the first is.
fn e_stop(frame: &[u8]) -> Option<u16> {
    let [first, frame::PROTOCOL, CONTROL, numbers @ .., E_STOP, _, _, _, _] = frame else { return None };
    // Two varints of one to three bytes. One that is longer than necessary ends with a zero, which would not be read as a zero
    // here.
    let (epoch, seen) = match *numbers {
        [_, ref seen @ ..] if *first == 3 => (0, seen),
        [a, ref seen @ ..] if a < 0x80 => (a.into(), seen),
        [a, b, ref seen @ ..] if b < 0x80 && *first != 4 => (u16::from(a & 0x7f) | u16::from(b) << 7, seen),
        [a, b, c, ref seen @ ..] if b >= 0x80 && c < 4 && *first != 5 => {
            (u16::from(a & 0x7f) | u16::from(b & 0x7f) << 7 | u16::from(c) << 14, seen)
        }
        _ => return None,
    };
    let is_number = match *seen {
        [a] => a < 0x80,
        [a, b] => a >= 0x80 && b < 0x80,
        [a, b, c] => a >= 0x80 && b >= 0x80 && c < 4,
        _ => false,
    };
    // Version, variant and op are none of the zeros.
    let mut zero = usize::from(*first);
    let op = 3 + numbers.len();
    while zero < op {
        zero += usize::from(*frame.get(zero)?);
    }
    (is_number && *first > 2 && zero != op).then_some(epoch)
}

/// Whether an encoded frame may be a `Hello` (0): COBS turns the zero of its variant into the end of the block that the first
/// byte begins.
fn may_be_hello(frame: &[u8]) -> bool {
    matches!(*frame, [2, frame::PROTOCOL, _, ..] if frame.len() <= MAX_SHORT)
}

fn urgent(frame: &[u8]) -> Option<Urgent> {
    if e_stop(frame).is_none() && !may_be_hello(frame) {
        return None;
    }
    let mut copy = [0; MAX_SHORT];
    let copy = copy.get_mut(..frame.len())?;
    copy.copy_from_slice(frame);
    match frame::read(frame::body(decode_cobs(copy)?)) {
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
        bytes(&HostMessage::Moves { epoch: 1, seq: 2, seen: 3, mark: None, withdraw: None, base, batch })
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
                // In the same way with other messages after and before it.
                let epochs = |bytes: &[u8], packet: usize| {
                    let (mut watch, mut epochs) = (Watch::new(), Vec::new());
                    for mut packet in bytes.chunks(packet) {
                        while let Some(epoch) = watch.e_stop(&mut packet, |other| other == epoch) {
                            epochs.push(epoch);
                        }
                    }
                    epochs
                };
                let other = bytes(&HostMessage::Control { epoch: !epoch, seen, op: Op::EStop });
                let both = [&stream[..], &other, &stream, &other].concat();
                let twice = if want == Urgent::EStop(epoch) { 2 } else { 0 };
                prop_assert_eq!(epochs(&both, packet), std::vec![epoch; twice]);
                // The first half of a frame behind an urgent one does not make its second half urgent.
                stream.extend(&urgent[..3]);
                stream.push(0);
                prop_assert_eq!(watch.look(&stream), Some(want));
                prop_assert_eq!(watch.look(&urgent[3..]), None);
            }
        }

        /// Bodies near that of an e-stop, also with numbers that are too long or too large. An e-stop is found only where there is one, and
        /// always if it is as this program writes it.
        #[test]
        fn an_e_stop_is_what_the_decoder_reads(
            numbers in prop::collection::vec(prop_oneof![Just(0u8), Just(3), Just(0x80), 0u8..5, any::<u8>()], 1..7), op in prop_oneof![Just(3u8), 0u8..5],
            tail in prop_oneof![Just(0usize), 0usize..3],
        ) {
            let body = [&[CONTROL], &numbers[..], &[op], &[3, 0, 3][..tail]].concat();
            let mut out = [0; MAX_FRAME];
            let len = encode(&frame::tests::Raw(&body), &mut out).unwrap();
            let mut decoder = frame::Decoder::new();
            let message = frame::read(decoder.next(&mut &out[..len]).unwrap());
            let found = Watch::new().e_stop(&mut &out[..len], |_| true);
            prop_assert_eq!(found.map(Urgent::EStop), Watch::new().look(&out[..len]));
            let mut shortest = [0; MAX_FRAME];
            match message {
                Ok(message @ HostMessage::Control { epoch, op: Op::EStop, .. }) => {
                    let own = encode(&message, &mut shortest).unwrap();
                    let is_shortest = shortest[..own] == out[..len];
                    prop_assert!(found == Some(epoch) || (found.is_none() && !is_shortest), "{found:?}, {message:?}");
                }
                _ => prop_assert_eq!(found, None),
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
