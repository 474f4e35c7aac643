//! Inputs as the targets read them: protocol messages, strokes and bytes out of the fuzzer's bytes.
//!
//! The functions read from the front and stop at the end of the input, so that a longer input continues a shorter one. At the
//! end they give zeros.

use arbitrary::Unstructured;
use firmware_protocol::array::MotorSet;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, LowerStop, Mark, MarkKind, Op, Trigger, Withdraw};
use firmware_protocol::stroke::Direction;
use serde::ser::{Serialize, SerializeTuple, Serializer};

/// Bytes that are written as they are, without a length: the body of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Raw<'a>(pub &'a [u8]);

impl Serialize for Raw<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        for byte in self.0 {
            tuple.serialize_element(byte)?;
        }
        tuple.end()
    }
}

/// Up to 255 bytes behind their number.
pub fn chunk<'a>(input: &mut Unstructured<'a>) -> &'a [u8] {
    let len = usize::from(byte(input)).min(input.len());
    input.bytes(len).unwrap_or_default()
}

/// One byte.
pub fn byte(input: &mut Unstructured<'_>) -> u8 {
    input.arbitrary().unwrap_or_default()
}

/// A number of 16 bits.
pub fn word(input: &mut Unstructured<'_>) -> u16 {
    input.arbitrary().unwrap_or_default()
}

/// A number of 32 bits.
pub fn long(input: &mut Unstructured<'_>) -> u32 {
    input.arbitrary().unwrap_or_default()
}

/// Whether a bit of the next byte is set.
pub fn flag(input: &mut Unstructured<'_>) -> bool {
    byte(input) & 1 == 1
}

/// One of these.
pub fn one_of<T: Copy, const N: usize>(input: &mut Unstructured<'_>, all: [T; N]) -> T {
    all[usize::from(byte(input)) % N]
}

/// A direction of a burst.
pub fn direction(input: &mut Unstructured<'_>) -> Direction {
    one_of(input, [Direction::Up, Direction::Down])
}

/// A mark, or none.
pub fn mark(input: &mut Unstructured<'_>) -> Option<Mark> {
    let kind = one_of(input, [None, None, Some(MarkKind::Play), Some(MarkKind::Item)])?;
    let trigger = flag(input).then(|| Trigger { width: word(input) % 300, code: byte(input) });
    Some(Mark { kind, trigger })
}

/// What a frame withdraws, if it does.
pub fn withdraw(input: &mut Unstructured<'_>) -> Option<Withdraw> {
    let motors = match byte(input) % 8 {
        0 => MotorSet::from_bits(long(input).into()),
        1 => MotorSet::from_bits(u64::MAX),
        2 | 3 => MotorSet::from_bits(1 << (byte(input) % 26)),
        _ => return None,
    };
    Some(Withdraw { motors, generation: (byte(input) % 6).into() })
}

/// The reasons for a disarm that a host may name, and others.
pub fn cause(input: &mut Unstructured<'_>) -> Cause {
    let all = [Cause::Request, Cause::Shutdown, Cause::Abort, Cause::Boot, Cause::EStop, Cause::Output];
    one_of(input, all)
}

/// An `arm` of any kind.
pub fn arm(input: &mut Unstructured<'_>, assume_rest: bool) -> Op {
    let how = byte(input);
    let limits = match how & 3 {
        0 | 1 => PowerLimits::NONE,
        2 => PowerLimits { motor: 300, rail: 700, ..PowerLimits::NONE },
        _ => {
            let (rail_at_once, chip_at_once) = (how >> 6, how >> 7);
            PowerLimits { motor: long(input), rail: long(input), rail_at_once, chip_at_once }
        }
    };
    let host_timeout = match how >> 2 & 3 {
        0 => long(input),
        1 => word(input).into(),
        _ => 170_000,
    };
    let lower_stop = match how >> 4 & 3 {
        0 => None,
        1 => Some(LowerStop { pulses_per_s: long(input), seek: word(input) }),
        2 => Some(LowerStop { pulses_per_s: 25_500, seek: word(input) % 20_000 }),
        _ => Some(LowerStop { pulses_per_s: 25_500, seek: 0 }),
    };
    Op::Arm { assume_rest, host_timeout, limits, lower_stop }
}
