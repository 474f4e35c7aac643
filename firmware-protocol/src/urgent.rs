//! Finds an e-stop or a host's hello in a byte stream before the stream is read in order.
//!
//! A firmware gives each packet to [`Watch::look`] in its USB interrupt, before it queues the packet. So an e-stop takes
//! effect while the device still reads earlier frames. Version, CRC and message are checked as in any frame. A frame
//! that is missed here is still read in order later.

use crate::frame::{self, MAX_SHORT, decode_cobs};
use crate::message::{HostMessage, Op};

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
    pub fn look(&mut self, bytes: &[u8]) -> Option<Urgent> {
        // Written for few cycles per byte: an interrupt may bring 64 bytes.
        let (mut seen, mut len) = (None, self.len);
        for (at, &byte) in bytes.iter().enumerate() {
            if byte == 0 {
                if let Some(frame) = self.frame.get_mut(..len) {
                    seen = urgent(frame).or(seen);
                    if matches!(seen, Some(Urgent::EStop(_))) {
                        // The bytes left may begin a frame; mark it as too long.
                        len = if at + 1 == bytes.len() { 0 } else { MAX_SHORT + 1 };
                        break;
                    }
                }
                len = 0;
            } else {
                if let Some(place) = self.frame.get_mut(len) {
                    *place = byte;
                }
                len += 1;
            }
        }
        self.len = len.min(MAX_SHORT + 1);
        seen
    }
}

/// Not inlined: the loop over the bytes needs the registers.
#[inline(never)]
fn urgent(frame: &mut [u8]) -> Option<Urgent> {
    let message = decode_cobs(frame)?;
    // Skip the CRC of what is neither `Hello` nor `Control`.
    if !matches!(message.get(1), Some(0 | 2)) {
        return None;
    }
    match frame::read(frame::body(message)) {
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
        bytes(&HostMessage::Strokes { epoch: 1, seq: 2, seen: 3, mark: None, base, batch })
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
