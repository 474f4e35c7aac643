//! Inputs as the targets read them: arrays, protocol messages, texts and bytes out of the fuzzer's bytes.
//!
//! The functions read from the front and stop at the end of the input, so that a longer input continues a shorter one. At the
//! end they give zeros.

use arbitrary::Unstructured;
use firmware_protocol::array::MotorSet;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, LowerStop, Op};
use meissner_array::spec::{Array, ArraySpec};
use serde::ser::{Serialize, SerializeTuple, Serializer};
use std::sync::LazyLock;

/// Another carrier, other limits, and groups of several sizes with motors in no order: nothing of it is the paper's.
const UNEVEN: &str = r#"
name = "uneven-2x3"
pins = { rows = 2, columns = 3, pitch_mm = 2.9 }
tick_hz = 70000
duty = { up = 0.25, down = 0.75 }
rails = [[1, 3], [0, 5, 2, 4]]
chips = [[0, 4, 5], [3, 1], [2]]
[motor]
step_um = 0.2
window_ms = 4.3
travel_um = 200.0
most_pulses = 1000
seek_pulses = 9000
"#;

/// The paper's, one with fewer motors, and one with as many as there may be.
static ARRAYS: LazyLock<[Array; 3]> = LazyLock::new(|| {
    let uneven = ArraySpec::parse(UNEVEN, "uneven").expect("a description");
    let uneven = Array::known(uneven).expect("a name of its own");
    [Array::paper(), uneven, Array::named("simulated-8x8").expect("a shipped description")]
});

/// The array of an input that begins with this byte: its upper half chooses it, a target has the lower one for itself.
pub fn array(first: u8) -> Array {
    ARRAYS[usize::from(first >> 4) % ARRAYS.len()]
}

/// Hands a text on, if the bytes are one.
pub fn text(bytes: &[u8], read: impl FnOnce(&str)) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        read(text);
    }
}

/// A message is one line that can be shown.
pub fn told<E: std::fmt::Display>(error: E) {
    let text = error.to_string();
    assert!(!text.is_empty() && !text.contains(['\n', '\r', '\u{1b}']), "{text:?}");
}

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

/// A motor of the array, or one of the two numbers behind them.
pub fn motor(input: &mut Unstructured<'_>, array: Array) -> u8 {
    byte(input) % (array.motors() as u8 + 2)
}

/// Any motors, also of no array.
pub fn motors(input: &mut Unstructured<'_>) -> MotorSet {
    MotorSet::from_bits(input.arbitrary().unwrap_or_default())
}

/// The reasons for a disarm that a host may name, and others.
pub fn cause(input: &mut Unstructured<'_>) -> Cause {
    let all = [Cause::Request, Cause::Shutdown, Cause::Abort, Cause::Boot, Cause::EStop, Cause::Output];
    one_of(input, all)
}

/// An `arm` of any kind.
pub fn arm(input: &mut Unstructured<'_>, array: Array, assume_rest: bool) -> Op {
    let layout = array.layout();
    let pulses_per_s = layout.max_pushes_per_s();
    let how = byte(input);
    let limits = match how & 3 {
        0 | 1 => layout.no_limits(),
        2 => PowerLimits { motor: 300, rail: 700, ..layout.no_limits() },
        _ => {
            let (rail_at_once, chip_at_once) = (how >> 6, how >> 7);
            PowerLimits { motor: long(input), rail: long(input), rail_at_once, chip_at_once }
        }
    };
    let host_timeout = match how >> 2 & 3 {
        0 => long(input),
        1 => word(input).into(),
        _ => 2 * layout.tick_hz(),
    };
    let lower_stop = match how >> 4 & 3 {
        0 => None,
        1 => Some(LowerStop { pulses_per_s: long(input), seek: word(input) }),
        2 => Some(LowerStop { pulses_per_s, seek: word(input) % 20_000 }),
        _ => Some(LowerStop { pulses_per_s, seek: 0 }),
    };
    Op::Arm { assume_rest, host_timeout, limits, lower_stop }
}
