//! Packed lists inside messages: the strokes of a batch and the items of an amendment.
//!
//! [`Packer`] writes a list; [`Strokes`] and [`Amendments`] read it, each item as an offset from the one before.
//!
//! ```text
//! stroke     head | varint up | [varint up_pulses] | varint held | [varint correction]
//! amendment  head | varint up (zigzag) | varint pulses
//! ```
//! - `head`: bits 0–5 are the motor. In a stroke, bit 6 set means that `up_pulses` is as in the stroke before and left out;
//!   bit 7 set means that both bursts have as many pulses and `correction` is left out. In an amendment, bit 6 is the
//!   burst's direction (1 = down), and bit 7 is not used.
//! - `up`: ticks from the up tick of the item before; in the first item from the base tick.
//! - `held`: ticks from the end of the up burst to the down burst.
//! - `correction`: down pulses minus up pulses, zigzag.
//!
//! Varints are LEB128 of at most 5 bytes. A list that ends within an item, or with a number out of range, is [`Malformed`].

use crate::array::Layout;
use crate::frame::{self, MAX_BODY, MAX_FRAME};
use crate::message::HostMessage;
use crate::stroke::{Direction, Stroke};
use crate::tick::Tick;

/// Most strokes in a batch; a verdict's mask has 64 bits. The chip unpacks them between two blocks of lines.
pub const MAX_BATCH: usize = 32;
/// The strokes of a frame.
pub(crate) type Batch = heapless::Vec<Stroke, MAX_BATCH>;
/// Most bytes of packed items in a message: what its longest header leaves.
pub const BATCH_BYTES: usize = MAX_BODY - LONGEST_HEADER;
/// The longest header, of a `Strokes` frame: variant; `epoch`, `seq`, `seen`; `mark`; `withdraw`; `base`; length of the batch.
const LONGEST_HEADER: usize = {
    let (varint_u16, varint_u64) = (3, 10);
    let mark = 1 + 1 + 1 + varint_u16 + 1;
    let withdraw = 1 + varint_u64 + varint_u16;
    1 + 3 * varint_u16 + mark + withdraw + 4 + 2
};

const MOTOR: u8 = 0x3f;
const SAME_PULSES: u8 = 0x40;
const BALANCED: u8 = 0x80;
const AMENDS_DOWN: u8 = 0x40;

/// A packed list ends within an item, or an item has a number out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// There is no room for the item, or it does not follow the one before in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// Packs items into a buffer of `N` bytes. An item that does not fit changes nothing.
#[derive(Clone, Debug)]
pub struct Packer<const N: usize> {
    bytes: [u8; N],
    len: usize,
    items: usize,
    base: Tick,
    at: Tick,
    pulses: u16,
}

impl<const N: usize> Packer<N> {
    /// An empty list whose ticks count from `base`.
    #[must_use]
    pub fn new(base: Tick) -> Self {
        Self { bytes: [0; N], len: 0, items: 0, base, at: base, pulses: 0 }
    }

    /// The tick from which the first item counts.
    #[must_use]
    pub fn base(&self) -> Tick {
        self.base
    }

    /// The packed bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }

    /// Number of items.
    #[must_use]
    pub fn items(&self) -> usize {
        self.items
    }

    /// Appends a stroke. Its up burst must begin no earlier than that of the stroke before, and end before its own down burst.
    ///
    /// # Errors
    /// [`Full`] if it does not fit; the list is unchanged.
    pub fn stroke(&mut self, stroke: &Stroke) -> Result<(), Full> {
        let Ok(up) = u32::try_from(stroke.up.since(self.at)) else { return Err(Full) };
        let held = stroke.down.since(stroke.up + u64::from(stroke.up_pulses));
        let Ok(held) = u32::try_from(held) else { return Err(Full) };
        let mut item = Item::new(stroke.motor & MOTOR);
        item.varint(up);
        if self.items > 0 && stroke.up_pulses == self.pulses {
            item.bytes[0] |= SAME_PULSES;
        } else {
            item.varint(stroke.up_pulses.into());
        }
        item.varint(held);
        if stroke.down_pulses == stroke.up_pulses {
            item.bytes[0] |= BALANCED;
        } else {
            item.varint(zigzag(i32::from(stroke.down_pulses) - i32::from(stroke.up_pulses)));
        }
        self.append(&item)?;
        (self.at, self.pulses) = (stroke.up, stroke.up_pulses);
        Ok(())
    }

    /// Appends an amendment.
    ///
    /// # Errors
    /// [`Full`] if it does not fit; the list is unchanged.
    pub fn amendment(&mut self, amendment: &Amendment) -> Result<(), Full> {
        let Ok(up) = i32::try_from(amendment.up.since(self.at)) else { return Err(Full) };
        let down = if amendment.direction == Direction::Down { AMENDS_DOWN } else { 0 };
        let mut item = Item::new((amendment.motor & MOTOR) | down);
        item.varint(zigzag(up));
        item.varint(amendment.pulses.into());
        self.append(&item)?;
        self.at = amendment.up;
        Ok(())
    }

    fn append(&mut self, item: &Item) -> Result<(), Full> {
        let end = self.len + item.len;
        if self.items == MAX_BATCH || end > N {
            return Err(Full);
        }
        self.bytes[self.len..end].copy_from_slice(&item.bytes[..item.len]);
        self.len = end;
        self.items += 1;
        Ok(())
    }
}

/// An item being packed: a head and at most four varints.
struct Item {
    bytes: [u8; 21],
    len: usize,
}

impl Item {
    fn new(head: u8) -> Self {
        let mut bytes = [0; 21];
        bytes[0] = head;
        Self { bytes, len: 1 }
    }

    fn varint(&mut self, mut value: u32) {
        while value >= 0x80 {
            self.bytes[self.len] = value as u8 | 0x80;
            self.len += 1;
            value >>= 7;
        }
        self.bytes[self.len] = value as u8;
        self.len += 1;
    }
}

const fn zigzag(value: i32) -> u32 {
    (value << 1 ^ value >> 31).cast_unsigned()
}

const fn unzigzag(value: u32) -> i32 {
    (value >> 1).cast_signed() ^ -(value & 1).cast_signed()
}

/// Reads bytes and varints of packed items.
#[derive(Clone, Debug)]
struct Unpacker<'a> {
    bytes: &'a [u8],
    at: Tick,
}

impl Unpacker<'_> {
    fn byte(&mut self) -> Result<u8, Malformed> {
        let (&byte, rest) = self.bytes.split_first().ok_or(Malformed)?;
        self.bytes = rest;
        Ok(byte)
    }

    /// Inlined for the usual one and two bytes: a frame has a hundred of these.
    #[inline(always)]
    fn varint(&mut self) -> Result<u32, Malformed> {
        match *self.bytes {
            [low @ 0..0x80, ref rest @ ..] => {
                self.bytes = rest;
                Ok(low.into())
            }
            [low, high @ 0..0x80, ref rest @ ..] => {
                self.bytes = rest;
                Ok(u32::from(low & 0x7f) | u32::from(high) << 7)
            }
            _ => self.long_varint(),
        }
    }

    /// Works in 32 bits: on the chip's core a shift of 64 bits is a function call.
    #[inline(never)]
    fn long_varint(&mut self) -> Result<u32, Malformed> {
        let mut value = 0;
        for shift in [0, 7, 14, 21] {
            let byte = self.byte()?;
            value |= u32::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        let last = self.byte()?;
        if last > 0x0f { Err(Malformed) } else { Ok(value | u32::from(last) << 28) }
    }

    fn pulses(&mut self) -> Result<u16, Malformed> {
        u16::try_from(self.varint()?).map_err(|_| Malformed)
    }
}

/// The strokes of a batch, in order. Ends after an error.
#[derive(Clone, Debug)]
pub struct Strokes<'a> {
    rest: Unpacker<'a>,
    pulses: u16,
}

/// How far a packed list of strokes has been unpacked.
#[derive(Clone, Copy, Debug, Hash)]
pub(crate) struct Place {
    /// Bytes read.
    read: usize,
    at: Tick,
    pulses: u16,
}

impl Place {
    /// The beginning of a list whose first stroke counts from `base`.
    pub(crate) const fn new(base: Tick) -> Self {
        Self { read: 0, at: base, pulses: 0 }
    }
}

impl<'a> Strokes<'a> {
    /// Reads `bytes` as strokes that count from `base`.
    #[must_use]
    pub fn new(base: Tick, bytes: &'a [u8]) -> Self {
        Self { rest: Unpacker { bytes, at: base }, pulses: 0 }
    }

    fn read(&mut self) -> Result<Stroke, Malformed> {
        let head = self.rest.byte()?;
        let up = self.rest.at + u64::from(self.rest.varint()?);
        let up_pulses = if head & SAME_PULSES != 0 { self.pulses } else { self.rest.pulses()? };
        let down = up + u64::from(up_pulses) + u64::from(self.rest.varint()?);
        let correction = if head & BALANCED != 0 { 0 } else { unzigzag(self.rest.varint()?) };
        let down_pulses = i64::from(up_pulses) + i64::from(correction);
        let down_pulses = u16::try_from(down_pulses).map_err(|_| Malformed)?;
        (self.rest.at, self.pulses) = (up, up_pulses);
        Ok(Stroke { motor: head & MOTOR, up, up_pulses, down, down_pulses })
    }
}

impl Iterator for Strokes<'_> {
    type Item = Result<Stroke, Malformed>;
    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.bytes.is_empty() {
            return None;
        }
        let stroke = self.read();
        if stroke.is_err() {
            self.rest.bytes = &[];
        }
        Some(stroke)
    }
}

/// A new count of pulses for one burst of a queued stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Amendment {
    /// The stroke's motor.
    pub motor: u8,
    /// The stroke's up tick, which identifies it together with the motor.
    pub up: Tick,
    /// Which of its two bursts.
    pub direction: Direction,
    /// The burst's new number of pulses, absolute.
    pub pulses: u16,
}

/// The items of an amendment message. Ends after an error.
#[derive(Clone, Debug)]
pub struct Amendments<'a>(Unpacker<'a>);

impl<'a> Amendments<'a> {
    /// Reads `bytes` as amendments that count from `base`.
    #[must_use]
    pub fn new(base: Tick, bytes: &'a [u8]) -> Self {
        Self(Unpacker { bytes, at: base })
    }

    /// The bytes that are not read yet.
    pub(crate) fn rest(&self) -> &'a [u8] {
        self.0.bytes
    }

    /// The tick from which the next item counts.
    pub(crate) fn at(&self) -> Tick {
        self.0.at
    }

    fn read(&mut self) -> Result<Amendment, Malformed> {
        let head = self.0.byte()?;
        let up = Tick(self.0.at.0.wrapping_add_signed(unzigzag(self.0.varint()?).into()));
        self.0.at = up;
        let direction = if head & AMENDS_DOWN != 0 { Direction::Down } else { Direction::Up };
        Ok(Amendment { motor: head & MOTOR, up, direction, pulses: self.0.pulses()? })
    }
}

impl Iterator for Amendments<'_> {
    type Item = Result<Amendment, Malformed>;
    fn next(&mut self) -> Option<Self::Item> {
        if self.0.bytes.is_empty() {
            return None;
        }
        let item = self.read();
        if item.is_err() {
            self.0.bytes = &[];
        }
        Some(item)
    }
}

/// Reads strokes of `batch` from `place` on into `strokes`, at most `most`. Returns whether all are read now.
///
/// # Errors
/// If the batch cannot be read to its end.
pub(crate) fn unpack(
    batch: &[u8],
    place: &mut Place,
    strokes: &mut Batch,
    most: usize,
) -> Result<bool, Malformed> {
    let bytes = batch.get(place.read..).unwrap_or_default();
    let mut packed = Strokes { rest: Unpacker { bytes, at: place.at }, pulses: place.pulses };
    for _ in 0..most {
        if packed.rest.bytes.is_empty() {
            break;
        }
        strokes.push(packed.read()?).map_err(|_| Malformed)?;
    }
    let left = packed.rest.bytes.len();
    *place = Place { read: batch.len() - left, at: packed.rest.at, pulses: packed.pulses };
    Ok(left == 0)
}

/// Writes a full frame of the longest strokes, for a self-test to read; returns its length.
#[must_use]
pub fn longest_frame(layout: &Layout, out: &mut [u8; MAX_FRAME]) -> usize {
    let mut strokes = Packer::<BATCH_BYTES>::new(Tick(0));
    let mut at = 0;
    loop {
        // Numbers that change with each stroke, so that the packer cannot shorten them.
        let (motor, up_pulses) = ((at * 7 % layout.motors() as u64) as u8, 147 + (at % 2) as u16);
        let up = Tick(59 * at);
        if strokes.stroke(&Stroke { motor, up, up_pulses, down: up + 708, down_pulses: up_pulses }).is_err() {
            break;
        }
        at += 1;
    }
    let (base, batch) = (strokes.base().wire(), strokes.bytes());
    frame::encode(
        &HostMessage::Strokes { epoch: 0, seq: 0, seen: 0, mark: None, withdraw: None, base, batch },
        out,
    )
    .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn stroke() -> impl Strategy<Value = Stroke> {
        (0u8..64, 0u64..1 << 31, any::<u16>(), 0u64..1 << 31, any::<u16>()).prop_map(
            |(motor, up, up_pulses, held, down_pulses)| {
                let up = Tick(up);
                Stroke { motor, up, up_pulses, down: up + u64::from(up_pulses) + held, down_pulses }
            },
        )
    }

    proptest! {
        #[test]
        fn strokes_come_back_as_packed(mut strokes in prop::collection::vec(stroke(), 0..20)) {
            strokes.sort_by_key(|stroke| stroke.up);
            let mut packer = Packer::<400>::new(Tick(0));
            for stroke in &strokes {
                packer.stroke(stroke).unwrap();
            }
            let back: Result<Vec<_>, _> = Strokes::new(Tick(0), packer.bytes()).collect();
            prop_assert_eq!(back.unwrap(), strokes);
        }

        #[test]
        fn amendments_come_back_as_packed(items in prop::collection::vec((0u8..64, 0u64..1 << 30, any::<bool>(), any::<u16>()), 0..20)) {
            let mut packer = Packer::<400>::new(Tick(1 << 29));
            let items: Vec<_> = items.into_iter().map(|(motor, up, down, pulses)| Amendment {
                motor, up: Tick(up), pulses, direction: if down { Direction::Down } else { Direction::Up },
            }).collect();
            for item in &items {
                packer.amendment(item).unwrap();
            }
            let back: Result<Vec<_>, _> = Amendments::new(Tick(1 << 29), packer.bytes()).collect();
            prop_assert_eq!(back.unwrap(), items);
        }

        #[test]
        fn reading_any_bytes_ends(bytes in prop::collection::vec(any::<u8>(), 0..250)) {
            prop_assert!(Strokes::new(Tick(0), &bytes).count() <= bytes.len());
            prop_assert!(Amendments::new(Tick(0), &bytes).count() <= bytes.len());
        }
    }

    #[test]
    fn a_steady_stroke_takes_four_bytes() {
        let mut packer = Packer::<64>::new(Tick(0));
        for motor in 0..3 {
            let up = Tick(59 * u64::from(motor));
            let stroke = Stroke { motor, up, up_pulses: 147, down: up + 708, down_pulses: 147 };
            packer.stroke(&stroke).unwrap();
        }
        assert_eq!(packer.bytes().len(), 6 + 4 + 4);
    }

    #[test]
    fn an_item_that_does_not_fit_changes_nothing() {
        let mut packer = Packer::<8>::new(Tick(100));
        let stroke = Stroke { motor: 1, up: Tick(100), up_pulses: 147, down: Tick(300), down_pulses: 147 };
        assert_eq!(packer.stroke(&stroke), Ok(()));
        let packed = packer.bytes().to_vec();
        assert_eq!(packer.stroke(&Stroke { up_pulses: 7, ..stroke }), Err(Full));
        assert_eq!(packer.stroke(&Stroke { up: Tick(99), ..stroke }), Err(Full));
        assert_eq!(packer.stroke(&Stroke { down: Tick(200), ..stroke }), Err(Full));
        assert_eq!(packer.bytes(), packed);
    }
}
