//! Frames: turns a message into bytes that end with a zero, and back.
//!
//! [`encode`] writes a frame; [`Decoder`] cuts a byte stream into bodies; [`read`] reads a body as a message.
//!
//! ```text
//! message      version u8 | body (postcard) | CRC-32/ISO-HDLC of both, little-endian
//! on the wire  COBS(message) | 0x00                                  at most MAX_FRAME bytes
//! ```
//! The decoder takes chunks of any size. Whatever arrives, it returns a body or a [`FrameError`], and it is synchronised again
//! after the next zero.

use serde::{Deserialize, Serialize};

/// The protocol's version: the first byte of every message, in all versions.
pub const PROTOCOL: u8 = 7;
/// Most bytes of version, body and CRC: one COBS block.
const MAX_MESSAGE: usize = 254;
pub(crate) const CRC_LEN: usize = 4;
/// Most bytes of a body.
pub(crate) const MAX_BODY: usize = MAX_MESSAGE - 1 - CRC_LEN;
/// Most bytes of a frame: COBS code byte, message, delimiter.
pub const MAX_FRAME: usize = 1 + MAX_MESSAGE + 1;
/// Bytes of a frame besides its body.
pub const FRAME_OVERHEAD: usize = 1 + 1 + CRC_LEN + 1;

/// Most bytes of a `Hello` or an e-stop, without the delimiter: code byte, version, tags and numbers, CRC.
pub(crate) const MAX_SHORT: usize = 1 + 1 + 8 + CRC_LEN;

const FULL: postcard::Error = postcard::Error::SerializeBufferFull;

/// CRC-32/ISO-HDLC of each byte.
static CRC_TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let (mut crc, mut bit) = (byte as u32, 0);
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

/// What remains of CRC-32/ISO-HDLC after a message and its CRC.
const CRC_RESIDUE: u32 = 0xdebb_20e3;

/// Why the bytes between two zeros are not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// More than [`MAX_FRAME`] bytes, the zero included.
    TooLong,
    /// Not COBS, or shorter than a version and a CRC.
    Malformed,
    /// The CRC does not fit.
    Crc,
    /// Whole and of this version, but the body is no message: an unknown variant, or bytes missing or left over.
    Unknown,
    /// Whole, but of this other protocol version.
    Version(u8),
}

/// Writes `body` as a frame to the start of `out` and returns its length.
///
/// # Errors
/// If the body is too long for a frame, or `out` is shorter than the frame.
pub fn encode(body: &impl Serialize, out: &mut [u8]) -> Result<usize, postcard::Error> {
    // Write the message where it stays: COBS puts one byte before it and one behind it.
    let len = out.len().min(MAX_FRAME);
    let message = out[..len].get_mut(1..len.saturating_sub(1)).ok_or(FULL)?;
    *message.first_mut().ok_or(FULL)? = PROTOCOL;
    let room = message.len().checked_sub(CRC_LEN).ok_or(FULL)?;
    let end = 1 + postcard::to_slice(body, message.get_mut(1..room).ok_or(FULL)?)?.len();
    let check = crc(&message[..end]).to_le_bytes();
    message[end..end + CRC_LEN].copy_from_slice(&check);
    let len = 1 + end + CRC_LEN;
    encode_cobs(&mut out[..len]);
    out[len] = 0;
    Ok(len + 1)
}

/// CRC-32/ISO-HDLC. The library's function takes three times as long on the chip.
fn crc(bytes: &[u8]) -> u32 {
    !with_bytes(!0, bytes)
}

/// The state of a CRC after these bytes.
fn with_bytes(state: u32, bytes: &[u8]) -> u32 {
    bytes.iter().fold(state, |state, &byte| state >> 8 ^ CRC_TABLE[usize::from(state as u8 ^ byte)])
}

/// Whether an encoded frame is COBS and its CRC fits, without a copy of it.
pub(crate) fn crc_fits(mut encoded: &[u8]) -> bool {
    let mut state = !0;
    loop {
        let Some((&code, rest)) = encoded.split_first() else { return false };
        let Some((block, rest)) = rest.split_at_checked(usize::from(code).wrapping_sub(1)) else {
            return false;
        };
        state = with_bytes(state, block);
        if rest.is_empty() {
            return state == CRC_RESIDUE;
        }
        // The zero that the next code stands for.
        state = with_bytes(state, &[0]);
        encoded = rest;
    }
}

/// Encodes the message behind the first byte, which is free, as COBS in place: each zero becomes the distance to the next one.
/// The message has at most [`MAX_MESSAGE`] bytes, so one byte before it is enough.
fn encode_cobs(bytes: &mut [u8]) {
    let mut distance = 0;
    for byte in bytes.iter_mut().skip(1).rev() {
        distance += 1;
        if *byte == 0 {
            (*byte, distance) = (distance, 0);
        }
    }
    if let Some(first) = bytes.first_mut() {
        *first = distance + 1;
    }
}

/// Decodes COBS in place; `None` if the bytes are not COBS. There are at most [`MAX_FRAME`] - 1 bytes, none of them zero. It
/// follows the codes alone, because the chip has no time to look at each byte.
pub(crate) fn decode_cobs(bytes: &mut [u8]) -> Option<&[u8]> {
    let mut next = usize::from(*bytes.first()?);
    while let Some(code) = bytes.get_mut(next) {
        next += usize::from(core::mem::take(code));
    }
    if next == bytes.len() { bytes.get(1..) } else { None }
}

/// Reads a body that [`Decoder::next`] cut out as a message, to its last byte.
///
/// # Errors
/// The decoder's error, or [`FrameError::Unknown`] if the body is not exactly one message.
pub fn read<'a, M: Deserialize<'a>>(body: Result<&'a [u8], FrameError>) -> Result<M, FrameError> {
    match postcard::take_from_bytes(body?) {
        Ok((message, [])) => Ok(message),
        _ => Err(FrameError::Unknown),
    }
}

/// Cuts a byte stream into bodies.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME - 1],
    len: usize,
    overflow: bool,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, out: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooLong => out.write_str("a frame longer than the longest"),
            Self::Malformed => out.write_str("a frame that is not COBS, or too short"),
            Self::Crc => out.write_str("a frame whose CRC does not fit"),
            Self::Unknown => out.write_str("a frame that holds no message of this version"),
            Self::Version(version) => {
                write!(out, "a frame of protocol version {version}; this side has version {PROTOCOL}")
            }
        }
    }
}

impl core::error::Error for FrameError {}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the start of a frame.
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME - 1], len: 0, overflow: false }
    }

    /// Takes `bytes` up to the next delimiter and returns the body before it, or an error. Returns `None` when `bytes` is
    /// used up; call it until then. Two adjacent zeros are no error.
    pub fn next<'a>(&'a mut self, bytes: &mut &[u8]) -> Option<Result<&'a [u8], FrameError>> {
        loop {
            let zero = bytes.iter().position(|&byte| byte == 0);
            let (chunk, rest) = bytes.split_at(zero.unwrap_or(bytes.len()));
            *bytes = rest.get(1..).unwrap_or_default();
            let end = self.len + chunk.len();
            match self.buffer.get_mut(self.len..end) {
                Some(room) if !self.overflow => {
                    room.copy_from_slice(chunk);
                    self.len = end;
                }
                _ => self.overflow = true,
            }
            zero?;
            let (len, overflow) = (self.len, self.overflow);
            (self.len, self.overflow) = (0, false);
            if overflow {
                return Some(Err(FrameError::TooLong));
            }
            if len > 0 {
                return Some(message(&mut self.buffer[..len]));
            }
        }
    }

    /// Forgets a frame that has begun, because the line was cut.
    pub fn reset(&mut self) {
        *self = Self::new();
    }
}

fn message(encoded: &mut [u8]) -> Result<&[u8], FrameError> {
    body(decode_cobs(encoded).ok_or(FrameError::Malformed)?)
}

/// The body of a decoded message, if CRC and version are right.
pub(crate) fn body(message: &[u8]) -> Result<&[u8], FrameError> {
    let (message, check) = message.split_last_chunk::<CRC_LEN>().ok_or(FrameError::Malformed)?;
    let (&version, body) = message.split_first().ok_or(FrameError::Malformed)?;
    if crc(message) != u32::from_le_bytes(*check) {
        return Err(FrameError::Crc);
    }
    if version != PROTOCOL {
        return Err(FrameError::Version(version));
    }
    Ok(body)
}

#[cfg(test)]
pub(crate) mod tests {
    extern crate std;
    use super::*;
    use crate::message::HostMessage;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// A body of these bytes.
    pub(crate) struct Raw<'a>(pub(crate) &'a [u8]);

    impl Serialize for Raw<'_> {
        fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            use serde::ser::SerializeTuple as _;
            let mut tuple = serializer.serialize_tuple(self.0.len())?;
            for byte in self.0 {
                tuple.serialize_element(byte)?;
            }
            tuple.end()
        }
    }

    fn frame(body: &[u8]) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let len = encode(&body, &mut out).unwrap();
        out[..len].to_vec()
    }

    #[test]
    fn the_longest_body_fits_and_one_more_byte_does_not() {
        let mut out = [0; MAX_FRAME];
        // A byte slice is its length (2 bytes from 128 on) and its bytes.
        let longest = MAX_MESSAGE - 1 - CRC_LEN - 2;
        assert_eq!(encode(&&[7u8; 300][..longest], &mut out), Ok(MAX_FRAME));
        assert!(encode(&&[7u8; 300][..=longest], &mut out).is_err());
        assert!(encode(&&[7u8; 20][..], &mut out[..10]).is_err());
    }

    #[test]
    fn another_version_is_named_by_its_number() {
        let mut message = std::vec![9, 1, 2, 3];
        message.extend(crc(&message).to_le_bytes());
        let mut bytes = [0; 20];
        cobs::encode(&message, &mut bytes);
        assert_eq!(Decoder::default().next(&mut &bytes[..]), Some(Err(FrameError::Version(9))));
    }

    #[test]
    fn a_body_is_one_message_to_its_last_byte() {
        let ping = HostMessage::Ping { token: 1, seen: 2 };
        let mut body = [0; 8];
        let len = postcard::to_slice(&ping, &mut body).unwrap().len();
        assert_eq!(read(Ok(&body[..len])), Ok(ping));
        let unknown_variant = [9; 4];
        for wrong in [&body[..len - 1], &body[..=len], &unknown_variant, &[]] {
            assert_eq!(read::<HostMessage<'_>>(Ok(wrong)), Err(FrameError::Unknown), "{wrong:?}");
        }
    }

    proptest! {
        #[test]
        fn the_crc_is_the_librarys(bytes: Vec<u8>) {
            prop_assert_eq!(crc(&bytes), crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes));
        }

        #[test]
        fn a_crc_that_fits_is_seen_in_the_encoded_frame(message in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..=30), bit in 0usize..8 * 30) {
            let mut message = message;
            message.extend(crc(&message).to_le_bytes());
            let encode = |message: &[u8]| {
                let mut bytes = [&[0], message].concat();
                encode_cobs(&mut bytes);
                bytes
            };
            prop_assert!(crc_fits(&encode(&message)));
            let bit = bit % (8 * message.len());
            message[bit / 8] ^= 1 << (bit % 8);
            prop_assert!(!crc_fits(&encode(&message)));
        }

        #[test]
        fn any_chunks_give_the_same_frames(bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..200), 1..5), chunk in 1usize..40) {
            let stream: Vec<u8> = bodies.iter().flat_map(|body| frame(body)).collect();
            let mut decoder = Decoder::default();
            let mut seen = Vec::new();
            for mut piece in stream.chunks(chunk) {
                while let Some(body) = decoder.next(&mut piece) {
                    let (bytes, rest) = postcard::take_from_bytes::<&[u8]>(body.unwrap()).unwrap();
                    prop_assert!(rest.is_empty());
                    seen.push(bytes.to_vec());
                }
            }
            prop_assert_eq!(seen, bodies);
        }

        #[test]
        fn cobs_is_as_in_the_library(message in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 0..=MAX_MESSAGE)) {
            let mut ours = std::vec![0];
            ours.extend(&message);
            encode_cobs(&mut ours);
            let mut theirs = std::vec![0; cobs::max_encoding_length(message.len())];
            let len = cobs::encode(&message, &mut theirs);
            prop_assert_eq!(&ours, &theirs[..len]);
            prop_assert_eq!(decode_cobs(&mut ours), Some(&message[..]));
        }

        #[test]
        fn cobs_is_decoded_as_in_the_library(mut frame in prop::collection::vec(prop_oneof![1u8..20, 1u8..=255], 0..MAX_FRAME)) {
            let mut theirs = frame.clone();
            let theirs = cobs::decode_in_place(&mut theirs).ok().map(|len| theirs[..len].to_vec());
            prop_assert_eq!(decode_cobs(&mut frame).map(<[u8]>::to_vec), theirs);
        }

        #[test]
        fn noise_never_panics_and_the_next_frame_is_read(noise in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut decoder = Decoder::default();
            let mut bytes = noise.clone();
            bytes.push(0);
            bytes.extend(frame(&[1, 2, 3]));
            let (mut bytes, mut last) = (&bytes[..], None);
            while let Some(body) = decoder.next(&mut bytes) {
                last = Some(body.map(<[u8]>::to_vec));
            }
            prop_assert_eq!(last, Some(Ok(std::vec![3, 1, 2, 3])));
        }
    }
}
