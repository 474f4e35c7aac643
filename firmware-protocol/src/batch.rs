//! Packed lists inside messages: the moves of a batch and the items of an amendment.
//!
//! [`Packer`] writes a list; [`moves`] and [`Amendments`] read it, each item as an offset from the one before.
//!
//! ```text
//! move       head | varint dt | varint level << 1 | s     [varint surplus, if s is 1]
//! stroke     head | varint dt | varint level << 1 | s     [varint surplus]  varint held
//! again      head | varint dt | varint held
//! row        head | varint dt | [varint motors]           varint level of each motor
//! amendment  head | zigzag dt | varint pulses
//! ```
//! - `head`: bits 0 to 5 are the motor, bits 6 and 7 the kind: 0 a move, 1 a stroke, 2 a stroke again, 3 a row. An amendment has the motor alone.
//! - `dt`: ticks from the tick of the item before; in the first item from the base tick.
//! - A *stroke* is two moves: to `level`, and `held` ticks after the pin got there to level 0 with the surplus. It is taken or left as a
//!   whole. *Again* is a stroke with level and surplus of the stroke before in this list.
//! - A *row* has a move of each of its motors at the same tick, without surplus. The motors are those of the row before in this list, or,
//!   if bit 0 of the head is set, a set that follows.
//!
//! Varints are LEB128 of at most 5 bytes, that of a set of at most 10. A list that ends within an item, or with a number out of range, is
//! [`Malformed`].

use crate::array::{Layout, MotorSet};
use crate::frame::{self, MAX_BODY, MAX_FRAME};
use crate::message::HostMessage;
use crate::moves::Move;
use crate::tick::Tick;

/// Most moves in a batch: a verdict's mask has 64 bits.
pub const MAX_BATCH: usize = 64;
/// Most moves in the first frame of a play, which the chip takes in one piece: a stroke of each of 24 motors.
pub const MAX_FIRST_BATCH: usize = 48;
/// The moves of a frame. The second move of a stroke is `joined` to the one before it.
pub(crate) type Batch = heapless::Vec<Unpacked, MAX_BATCH>;
/// A move of a list, and whether it is the second one of a stroke.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Unpacked {
    /// The move.
    pub of: Move,
    /// It is taken only with the one before it.
    pub joined: bool,
}
/// Most bytes of packed items in a message: what its longest header leaves.
pub const BATCH_BYTES: usize = MAX_BODY - LONGEST_HEADER;
/// The longest header, of a `Moves` frame: variant; `epoch`, `seq`, `seen`; `mark`; `withdraw`; `base`; length of the batch.
const LONGEST_HEADER: usize = {
    let (varint_u16, varint_u32, varint_u64) = (3, 5, 10);
    let mark = 1 + 1 + 1 + varint_u16 + 1 + varint_u32;
    let withdraw = 1 + varint_u64 + varint_u16;
    1 + 3 * varint_u16 + mark + withdraw + 4 + 2
};

const MOTOR: u8 = 0x3f;
const KIND: u8 = 0xc0;
const MOVE: u8 = 0x00;
const STROKE: u8 = 0x40;
const AGAIN: u8 = 0x80;
const ROW: u8 = 0xc0;
/// In the head of a row: a set of motors follows.
const OTHER_SET: u8 = 0x01;

/// A packed list ends within an item, or an item has a number out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed;

/// There is no room for the item, or it does not follow the one before in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// One excursion of one pin: up to a level and back to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Stroke {
    /// Its number in the array.
    pub motor: u8,
    /// The tick of its first pulse up.
    pub up: Tick,
    /// Pulses up.
    pub level: u16,
    /// The tick of its first pulse down, not before the last one up.
    pub down: Tick,
    /// Pulses after the pin is at rest, against a lower stop.
    pub surplus: u16,
}

impl Stroke {
    /// Its two moves.
    pub const fn moves(&self) -> [Move; 2] {
        let Self { motor, up, level, down, surplus } = *self;
        [Move { motor, tick: up, level, surplus: 0 }, Move { motor, tick: down, level: 0, surplus }]
    }
}

/// Packs items into a buffer of `N` bytes. An item that does not fit changes nothing.
#[derive(Clone, Debug)]
pub struct Packer<const N: usize> {
    bytes: [u8; N],
    len: usize,
    /// Moves, or amendments.
    count: usize,
    base: Tick,
    at: Tick,
    stroke: Option<(u16, u16)>,
    row: MotorSet,
    /// The last item, if moves of other motors may join it.
    open: Option<Open>,
}

/// An item that moves of the same tick may join, and the state of the packer before it.
#[derive(Clone, Debug)]
struct Open {
    len: usize,
    at: Tick,
    row: MotorSet,
    /// The moves, of motors in order; the last one's.
    last: u8,
    motors: MotorSet,
    levels: heapless::Vec<u16, MAX_BATCH>,
}

impl<const N: usize> Packer<N> {
    /// An empty list whose ticks count from `base`.
    pub fn new(base: Tick) -> Self {
        Self {
            bytes: [0; N],
            len: 0,
            count: 0,
            base,
            at: base,
            stroke: None,
            row: MotorSet::EMPTY,
            open: None,
        }
    }

    /// The tick from which the first item counts.
    pub fn base(&self) -> Tick {
        self.base
    }

    /// The packed bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }

    /// Number of moves or amendments.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Appends a move. It must be no earlier than the item before. Moves of one tick, in order of motor, become a row.
    ///
    /// # Errors
    /// [`Full`] if it does not fit; the list is unchanged.
    pub fn to_level(&mut self, to: &Move) -> Result<(), Full> {
        if to.surplus == 0
            && let Some(open) = self.open.take_if(|open| self.at == to.tick && open.last < to.motor)
        {
            return self.join(open, to);
        }
        let (mut motors, mut levels) = (MotorSet::EMPTY, heapless::Vec::new());
        motors.insert(to.motor);
        let fits = levels.push(to.level).is_ok() && !motors.is_empty() && to.surplus == 0;
        let open = Open { len: self.len, at: self.at, row: self.row, last: to.motor, motors, levels };
        self.moves(to)?;
        self.open = Some(open).filter(|_| fits);
        Ok(())
    }

    /// Replaces the last item by a row that has this move, too.
    fn join(&mut self, mut open: Open, to: &Move) -> Result<(), Full> {
        let before = (self.len, self.count, self.at, self.row);
        (self.len, self.count) = (open.len, self.count - open.levels.len());
        (self.at, self.row) = (open.at, open.row);
        open.motors.insert(to.motor);
        open.last = to.motor;
        let fits = open.levels.push(to.level).is_ok();
        let joined = if fits { self.row(to.tick, open.motors, &open.levels) } else { Err(Full) };
        match joined {
            Ok(()) => self.open = Some(open),
            Err(Full) => (self.len, self.count, self.at, self.row) = before,
        }
        joined
    }

    /// Appends a move as an item of its own. It must be no earlier than the item before.
    ///
    /// # Errors
    /// [`Full`] if it does not fit; the list is unchanged.
    pub fn moves(&mut self, to: &Move) -> Result<(), Full> {
        let mut item = Item::new(MOVE | to.motor & MOTOR);
        item.varint(self.delta(to.tick)?);
        item.level(to.level, to.surplus);
        self.append(&item, 1)?;
        self.at = to.tick;
        Ok(())
    }

    /// Appends a stroke. It must begin no earlier than the item before, and come down no earlier than it is up.
    ///
    /// # Errors
    /// [`Full`] if it does not fit; the list is unchanged.
    pub fn stroke(&mut self, stroke: &Stroke) -> Result<(), Full> {
        let held = stroke.down.since(stroke.up + u64::from(stroke.level));
        let held = u32::try_from(held).map_err(|_| Full)?;
        let same = self.stroke == Some((stroke.level, stroke.surplus));
        let mut item = Item::new(if same { AGAIN } else { STROKE } | stroke.motor & MOTOR);
        item.varint(self.delta(stroke.up)?);
        if !same {
            item.level(stroke.level, stroke.surplus);
        }
        item.varint(held);
        self.append(&item, 2)?;
        (self.at, self.stroke) = (stroke.up, Some((stroke.level, stroke.surplus)));
        Ok(())
    }

    /// Appends a row: at `tick` each motor of `motors` gets the level of its place in `levels`.
    ///
    /// # Errors
    /// [`Full`] if it does not fit, or has not as many levels as motors; the list is unchanged.
    pub fn row(&mut self, tick: Tick, motors: MotorSet, levels: &[u16]) -> Result<(), Full> {
        if levels.is_empty() || levels.len() != motors.len() as usize {
            return Err(Full);
        }
        let same = self.row == motors;
        let mut item = Item::new(if same { ROW } else { ROW | OTHER_SET });
        item.varint(self.delta(tick)?);
        if !same {
            item.varint64(motors.bits());
        }
        levels.iter().for_each(|&level| item.varint(level.into()));
        self.append(&item, levels.len())?;
        (self.at, self.row) = (tick, motors);
        Ok(())
    }

    /// Appends an amendment.
    ///
    /// # Errors
    /// [`Full`] if it does not fit; the list is unchanged.
    pub fn amendment(&mut self, amendment: &Amendment) -> Result<(), Full> {
        let Ok(dt) = i32::try_from(amendment.tick.since(self.at)) else { return Err(Full) };
        let mut item = Item::new(amendment.motor & MOTOR);
        item.varint(zigzag(dt));
        item.varint(amendment.pulses.into());
        self.append(&item, 1)?;
        self.at = amendment.tick;
        Ok(())
    }

    fn delta(&self, tick: Tick) -> Result<u32, Full> {
        u32::try_from(tick.since(self.at)).map_err(|_| Full)
    }

    fn append(&mut self, item: &Item, count: usize) -> Result<(), Full> {
        let end = self.len + item.len;
        if self.count + count > MAX_BATCH || end > N {
            return Err(Full);
        }
        self.bytes[self.len..end].copy_from_slice(&item.bytes[..item.len]);
        self.len = end;
        self.count += count;
        self.open = None;
        Ok(())
    }
}

/// An item being packed. The longest is a row of all motors.
struct Item {
    bytes: [u8; 1 + 5 + 10 + 3 * MAX_BATCH],
    len: usize,
}

impl Item {
    fn new(head: u8) -> Self {
        let mut bytes = [0; _];
        bytes[0] = head;
        Self { bytes, len: 1 }
    }

    fn varint(&mut self, value: u32) {
        self.varint64(value.into());
    }

    fn varint64(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes[self.len] = value as u8 | 0x80;
            self.len += 1;
            value >>= 7;
        }
        self.bytes[self.len] = value as u8;
        self.len += 1;
    }

    fn level(&mut self, level: u16, surplus: u16) {
        self.varint(u32::from(level) << 1 | u32::from(surplus > 0));
        if surplus > 0 {
            self.varint(surplus.into());
        }
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

    /// A set of motors. Rare: rows in a list have the same motors.
    #[inline(never)]
    fn set(&mut self) -> Result<MotorSet, Malformed> {
        let mut value = 0;
        for shift in (0..70).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                return Err(Malformed);
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(MotorSet::from_bits(value));
            }
        }
        Err(Malformed)
    }

    fn pulses(&mut self) -> Result<u16, Malformed> {
        u16::try_from(self.varint()?).map_err(|_| Malformed)
    }

    fn tick(&mut self) -> Result<Tick, Malformed> {
        self.at = self.at + u64::from(self.varint()?);
        Ok(self.at)
    }

    /// A level and a surplus.
    fn level(&mut self) -> Result<(u16, u16), Malformed> {
        let word = self.varint()?;
        let level = u16::try_from(word >> 1).map_err(|_| Malformed)?;
        Ok((level, if word & 1 == 1 { self.pulses()? } else { 0 }))
    }
}

/// How far a packed list of moves has been unpacked.
#[derive(Clone, Copy, Debug, Hash)]
pub(crate) struct Place {
    /// Bytes read.
    read: usize,
    at: Tick,
    last: Last,
}

/// What items of a list take over from those before.
#[derive(Clone, Copy, Debug, Hash)]
struct Last {
    stroke: Option<(u16, u16)>,
    row: MotorSet,
}

impl Place {
    /// The beginning of a list whose first item counts from `base`.
    pub(crate) const fn new(base: Tick) -> Self {
        Self { read: 0, at: base, last: Last { stroke: None, row: MotorSet::EMPTY } }
    }
}

/// Reads the next item into `moves`.
fn item(from: &mut Unpacker<'_>, last: &mut Last, moves: &mut Batch) -> Result<(), Malformed> {
    let head = from.byte()?;
    let (motor, tick) = (head & MOTOR, from.tick()?);
    let mut push = |motor, tick, (level, surplus), joined| {
        moves.push(Unpacked { of: Move { motor, tick, level, surplus }, joined }).map_err(|_| Malformed)
    };
    match head & KIND {
        MOVE => push(motor, tick, from.level()?, false),
        ROW => {
            if head & OTHER_SET != 0 {
                last.row = from.set()?;
            }
            if last.row.is_empty() {
                return Err(Malformed);
            }
            for motor in last.row.iter() {
                push(motor, tick, (from.pulses()?, 0), false)?;
            }
            Ok(())
        }
        kind => {
            if kind == STROKE {
                last.stroke = Some(from.level()?);
            }
            let (level, surplus) = last.stroke.ok_or(Malformed)?;
            let down = tick + u64::from(level) + u64::from(from.varint()?);
            push(motor, tick, (level, 0), false)?;
            push(motor, down, (0, surplus), true)
        }
    }
}

/// Reads moves of `batch` from `place` on into `moves`: items until there are `most` moves or more. Returns whether all are read now.
///
/// # Errors
/// If the batch cannot be read to its end.
pub(crate) fn unpack(
    batch: &[u8],
    place: &mut Place,
    moves: &mut Batch,
    most: usize,
) -> Result<bool, Malformed> {
    let mut from = Unpacker { bytes: batch.get(place.read..).unwrap_or_default(), at: place.at };
    let enough = moves.len() + most;
    while !from.bytes.is_empty() && moves.len() < enough {
        item(&mut from, &mut place.last, moves)?;
    }
    (place.read, place.at) = (batch.len() - from.bytes.len(), from.at);
    Ok(from.bytes.is_empty())
}

/// The moves of a batch that counts from `base`, in the order in which they are taken.
///
/// # Errors
/// If the batch cannot be read to its end, or has more than [`MAX_BATCH`] moves.
pub fn moves(base: Tick, batch: &[u8]) -> Result<heapless::Vec<Unpacked, MAX_BATCH>, Malformed> {
    let (mut place, mut moves) = (Place::new(base), Batch::new());
    unpack(batch, &mut place, &mut moves, usize::MAX / 2)?;
    Ok(moves)
}

/// A new count of pulses for the burst of one queued move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Amendment {
    /// The move's motor.
    pub motor: u8,
    /// The move's tick, which identifies it together with the motor.
    pub tick: Tick,
    /// The burst's new number of pulses, absolute.
    pub pulses: u16,
}

/// The items of an amendment message. Ends after an error.
#[derive(Clone, Debug)]
pub struct Amendments<'a>(Unpacker<'a>);

impl<'a> Amendments<'a> {
    /// Reads `bytes` as amendments that count from `base`.
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
        if head & KIND != 0 {
            return Err(Malformed);
        }
        let tick = Tick(self.0.at.0.wrapping_add_signed(unzigzag(self.0.varint()?).into()));
        self.0.at = tick;
        Ok(Amendment { motor: head & MOTOR, tick, pulses: self.0.pulses()? })
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

/// Writes a full frame of the longest items, for a self-test to read; returns its length.
#[must_use]
pub fn longest_frame(layout: &Layout, out: &mut [u8; MAX_FRAME]) -> usize {
    let mut packer = Packer::<BATCH_BYTES>::new(Tick(0));
    let mut at = 0;
    loop {
        // Levels that change with each stroke, so that the packer cannot shorten them.
        let (motor, level) = ((at * 7 % layout.motors() as u64) as u8, 147 + (at % 2) as u16);
        let up = Tick(59 * at);
        if packer.stroke(&Stroke { motor, up, level, down: up + 708, surplus: 0 }).is_err() {
            break;
        }
        at += 1;
    }
    let (base, batch) = (packer.base().wire(), packer.bytes());
    let message = HostMessage::Moves { epoch: 0, seq: 0, seen: 0, mark: None, withdraw: None, base, batch };
    frame::encode(&message, out).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    #[derive(Clone, Debug)]
    enum Any {
        Move(Move),
        /// It may join the item before.
        Joining(Move),
        Stroke(Stroke),
        Row(u64, Vec<u16>),
    }

    fn any_item() -> impl Strategy<Value = (u64, Any)> {
        let level = 0u16..=10_000;
        let to =
            (0u8..32, level.clone(), 0u16..900, any::<bool>()).prop_map(|(motor, level, surplus, joins)| {
                if joins {
                    Any::Joining(Move { motor, tick: Tick(0), level, surplus: surplus / 600 })
                } else {
                    Any::Move(Move { motor, tick: Tick(0), level, surplus })
                }
            });
        let stroke =
            (0u8..32, level.clone(), 0u64..1 << 20, 0u16..2).prop_map(|(motor, level, held, surplus)| {
                let down = Tick(u64::from(level) + held);
                Any::Stroke(Stroke { motor, up: Tick(0), level, down, surplus })
            });
        let row = (1u64..1 << 12, prop::collection::vec(level, 12)).prop_map(|(set, mut levels)| {
            levels.truncate(set.count_ones() as usize);
            Any::Row(set, levels)
        });
        (prop_oneof![Just(0), 0u64..1 << 20], prop_oneof![2 => to, 1 => stroke, 1 => row])
    }

    proptest! {
        #[test]
        fn moves_come_back_as_packed(items in prop::collection::vec(any_item(), 0..14)) {
            let (mut packer, mut wanted, mut at) = (Packer::<700>::new(Tick(50)), Vec::new(), Tick(50));
            for (dt, item) in items {
                let tick = at + dt;
                let (packed, moves) = match item {
                    Any::Move(to) => {
                        let to = Move { tick, ..to };
                        (packer.moves(&to), std::vec![(to, false)])
                    }
                    Any::Joining(to) => {
                        let to = Move { tick, ..to };
                        (packer.to_level(&to), std::vec![(to, false)])
                    }
                    Any::Stroke(of) => {
                        let of = Stroke { up: tick, down: tick + of.down.0, ..of };
                        let [up, down] = of.moves();
                        (packer.stroke(&of), std::vec![(up, false), (down, true)])
                    }
                    Any::Row(set, levels) => {
                        let set = MotorSet::from_bits(set);
                        let of = |(motor, &level)| (Move { motor, tick, level, surplus: 0 }, false);
                        (packer.row(tick, set, &levels), set.iter().zip(&levels).map(of).collect())
                    }
                };
                if packed.is_err() {
                    prop_assert!(wanted.len() + moves.len() > MAX_BATCH || packer.bytes().len() > 650);
                    break;
                }
                wanted.extend(moves.into_iter().map(|(of, joined)| Unpacked { of, joined }));
                at = tick;
            }
            prop_assert_eq!(packer.count(), wanted.len());
            prop_assert_eq!(moves(Tick(50), packer.bytes()).unwrap().to_vec(), wanted.clone());
            // In pieces.
            let (mut place, mut read) = (Place::new(Tick(50)), Batch::new());
            while !unpack(packer.bytes(), &mut place, &mut read, 5).unwrap() {}
            prop_assert_eq!(read.to_vec(), wanted);
        }

        #[test]
        fn amendments_come_back_as_packed(items in prop::collection::vec((0u8..64, 0u64..1 << 30, any::<u16>()), 0..20)) {
            let mut packer = Packer::<400>::new(Tick(1 << 29));
            let items: Vec<_> =
                items.into_iter().map(|(motor, tick, pulses)| Amendment { motor, tick: Tick(tick), pulses }).collect();
            for item in &items {
                packer.amendment(item).unwrap();
            }
            let back: Result<Vec<_>, _> = Amendments::new(Tick(1 << 29), packer.bytes()).collect();
            prop_assert_eq!(back.unwrap(), items);
        }

        #[test]
        fn reading_any_bytes_ends(bytes in prop::collection::vec(any::<u8>(), 0..250)) {
            let _ = moves(Tick(0), &bytes);
            prop_assert!(Amendments::new(Tick(0), &bytes).count() <= bytes.len());
        }
    }

    #[test]
    fn a_steady_stroke_takes_four_bytes_and_a_row_two_a_move() {
        let mut packer = Packer::<200>::new(Tick(0));
        for motor in 0..3 {
            let up = Tick(59 * u64::from(motor));
            packer.stroke(&Stroke { motor, up, level: 147, down: up + 708, surplus: 0 }).unwrap();
        }
        assert_eq!(packer.bytes().len(), 6 + 4 + 4);
        let levels: Vec<u16> = (0..24).map(|motor| 1_000 + 20 * motor).collect();
        let all = MotorSet::from_bits((1 << 24) - 1);
        packer.row(Tick(300), all, &levels).unwrap();
        assert_eq!(packer.bytes().len(), 14 + 7 + 48);
        packer.row(Tick(470), all, &levels).unwrap();
        assert_eq!(packer.bytes().len(), 14 + 7 + 48 + 3 + 48);
    }

    #[test]
    fn an_item_that_does_not_fit_changes_nothing() {
        let mut packer = Packer::<8>::new(Tick(100));
        let stroke = Stroke { motor: 1, up: Tick(100), level: 147, down: Tick(300), surplus: 0 };
        assert_eq!(packer.stroke(&stroke), Ok(()));
        let packed = packer.bytes().to_vec();
        assert_eq!(packer.stroke(&Stroke { level: 7, ..stroke }), Err(Full));
        assert_eq!(packer.stroke(&Stroke { up: Tick(99), ..stroke }), Err(Full));
        assert_eq!(packer.stroke(&Stroke { down: Tick(200), ..stroke }), Err(Full));
        assert_eq!(packer.bytes(), packed);
        // Nothing to take over.
        assert_eq!(moves(Tick(0), &[AGAIN, 0, 0]), Err(Malformed));
        assert_eq!(moves(Tick(0), &[ROW, 0, 0]), Err(Malformed));
    }
}
