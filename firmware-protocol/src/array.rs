//! An array, as the controller and the handshake know it: motors, carrier, what shares a rail or a driver chip, limits of pulses.
//!
//! A [`Layout`] says it once; [`Controller::new`](crate::controller::Controller::new) and the host's link take one. All times and
//! limits that depend on the array are its methods. [`MotorSet`] is the mask of motors in messages and in the controller.

use crate::tick::{BLOCK, HORIZON};
use core::fmt;
use core::ops::{BitAnd, BitOr, BitOrAssign};
use serde::de::Visitor;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Most motors of any array. This is the capacity of the protocol, not a number of pins.
pub const MAX_MOTORS: usize = 64;

/// A mask with a bit for each motor that this build has room for.
#[cfg(not(feature = "pico"))]
type Bits = u64;
/// Motors that this build has room for.
#[cfg(not(feature = "pico"))]
pub(crate) const CAPACITY: usize = MAX_MOTORS;
#[cfg(not(feature = "pico"))]
const fn narrow(bits: u64) -> Bits {
    bits
}
#[cfg(not(feature = "pico"))]
const fn widen(bits: Bits) -> u64 {
    bits
}

/// A mask with a bit for each motor that this build has room for. The chip's core shifts 32 bits at once, and 64 by a call.
#[cfg(feature = "pico")]
type Bits = u32;
/// Motors that this build has room for: a Pico has pins for so many.
#[cfg(feature = "pico")]
pub(crate) const CAPACITY: usize = 24;
#[cfg(feature = "pico")]
const fn narrow(bits: u64) -> Bits {
    bits as Bits
}
#[cfg(feature = "pico")]
const fn widen(bits: Bits) -> u64 {
    bits as u64
}

/// The lowest bit.
const ONE: Bits = 1;
/// Parts of 32 bits in a mask.
const PARTS: usize = size_of::<Bits>() / 4;

/// A set of motors: bit m is motor m. On the wire a varint of at most 64 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct MotorSet(Bits);

impl MotorSet {
    /// No motor.
    pub const EMPTY: Self = Self(0);

    /// The set with these bits. A build with room for fewer motors leaves out the others: it has no array with them.
    pub const fn from_bits(bits: u64) -> Self {
        Self(narrow(bits))
    }

    /// Bit m: motor m.
    pub const fn bits(self) -> u64 {
        widen(self.0)
    }

    /// The motors from 0 on, so many.
    pub const fn first(motors: usize) -> Self {
        if motors == 0 { Self::EMPTY } else { Self(Bits::MAX >> (Bits::BITS as usize - motors)) }
    }

    /// One motor, which must be less than the capacity.
    #[inline(always)]
    pub(crate) const fn of(motor: usize) -> Self {
        Self(ONE.wrapping_shl(motor as u32))
    }

    /// Whether no motor is in it.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Number of motors.
    pub const fn len(self) -> u32 {
        self.0.count_ones()
    }

    /// Whether `motor`, any number, is in it.
    #[inline(always)]
    pub const fn contains(self, motor: u8) -> bool {
        (motor as u32) < Bits::BITS && self.0.wrapping_shr(motor as u32) & 1 == 1
    }

    /// Adds a motor. A number that no motor has changes nothing.
    #[inline(always)]
    pub const fn insert(&mut self, motor: u8) {
        if (motor as u32) < Bits::BITS {
            self.0 |= Self::of(motor as usize).0;
        }
    }

    /// Removes a motor.
    #[inline(always)]
    pub const fn remove(&mut self, motor: u8) {
        if (motor as u32) < Bits::BITS {
            self.0 &= !Self::of(motor as usize).0;
        }
    }

    /// Adds a motor, or removes it if it is there. A number that no motor has changes nothing.
    pub const fn toggle(&mut self, motor: u8) {
        if (motor as u32) < Bits::BITS {
            self.0 ^= Self::of(motor as usize).0;
        }
    }

    /// The motors that are not in `other`.
    #[inline(always)]
    pub const fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The motor with the lowest number.
    pub const fn lowest(self) -> Option<u8> {
        if self.0 == 0 { None } else { Some(self.0.trailing_zeros() as u8) }
    }

    /// The motors, in order.
    pub fn iter(mut self) -> impl Iterator<Item = u8> + use<> {
        core::iter::from_fn(move || {
            let motor = self.lowest()?;
            self.remove(motor);
            Some(motor)
        })
    }

    /// The motors of a mask of 32, from `32 * part` on.
    #[inline(always)]
    pub(crate) const fn of_part(part: u32, mask: u32) -> Self {
        Self(narrow((mask as u64) << (32 * part)))
    }

    /// The set in parts of 32 motors, for the chip's core.
    #[inline(always)]
    pub(crate) const fn parts(self) -> [u32; PARTS] {
        let mut parts = [0; PARTS];
        let mut part = 0;
        while part < PARTS {
            parts[part] = (widen(self.0) >> (32 * part)) as u32;
            part += 1;
        }
        parts
    }
}

impl BitOr for MotorSet {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitAnd for MotorSet {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOrAssign for MotorSet {
    #[inline(always)]
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl Serialize for MotorSet {
    fn serialize<S: Serializer>(&self, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_u64(self.bits())
    }
}

impl<'de> Deserialize<'de> for MotorSet {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        u64::deserialize(from).map(Self::from_bits)
    }
}

/// The longest name of an array.
const MAX_NAME: usize = 32;

/// The name of an array: 1 to 32 of `a` to `z`, `0` to `9` and `-`.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Name {
    len: u8,
    bytes: [u8; MAX_NAME],
}

impl Name {
    /// `None` if an array may not have this name.
    pub const fn new(name: &str) -> Option<Self> {
        let name = name.as_bytes();
        if name.is_empty() || name.len() > MAX_NAME {
            return None;
        }
        let (mut bytes, mut at) = ([0; MAX_NAME], 0);
        while at < name.len() {
            if !matches!(name[at], b'a'..=b'z' | b'0'..=b'9' | b'-') {
                return None;
            }
            bytes[at] = name[at];
            at += 1;
        }
        Some(Self { len: name.len() as u8, bytes })
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        let name = self.bytes.get(..self.len.into()).unwrap_or_default();
        // It is ASCII.
        core::str::from_utf8(name).unwrap_or_default()
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_str().fmt(out)
    }
}

impl fmt::Display for Name {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.as_str())
    }
}

impl Serialize for Name {
    fn serialize<S: Serializer>(&self, out: S) -> Result<S::Ok, S::Error> {
        out.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for Name {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = Name;
            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("the name of an array")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Name, E> {
                Name::new(text).ok_or_else(|| E::custom("no name of an array"))
            }
        }
        from.deserialize_str(Text)
    }
}

/// What the handshake says of the device's array. The host refuses another array than its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ArrayId {
    /// The name of its description.
    pub name: Name,
    /// Number of motors, 1 to [`MAX_MOTORS`].
    pub motors: u8,
    /// Ticks per second: the carrier, one pulse per tick.
    pub tick_hz: u32,
    /// How long a line is high in an up pulse, 1/1000 of a tick.
    pub duty_up: u16,
    /// The same for a down pulse: longer.
    pub duty_down: u16,
    /// Hash of the description. The controller does not use it.
    pub hash: u64,
}

/// What a controller must know of its array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Layout {
    /// That of `id`, near the other numbers that each move is checked with.
    motors: u8,
    max_up_pulses: u16,
    max_down_pulses: u16,
    max_seek: u16,
    /// Motors of the rail with most, and of the chip with most.
    on_rail: u8,
    on_chip: u8,
    /// For each motor the next one of its rail, and of its chip; the last one has the first. So a search visits only a group.
    next_on_rail: Ring,
    next_on_chip: Ring,
    rails: [u8; CAPACITY],
    chips: [u8; CAPACITY],
    id: ArrayId,
}

/// For each motor the next one of its group, round and round.
pub(crate) type Ring = [u8; CAPACITY];

/// Why there is no such layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayoutError {
    /// No motor, or more than [`MAX_MOTORS`] or than this build has room for.
    Motors,
    /// The carrier is not 20 000 to 200 000 Hz.
    TickHz,
    /// An up pulse is not shorter than half a tick, a down pulse is not longer, or one of them has no edge in its tick.
    Duty,
    /// Not one rail and one chip for each motor, or a number above 63.
    Groups,
    /// Motors of one chip are on two rails.
    TwoRails,
    /// A stroke may have no up pulses, or more than 10 000.
    UpPulses,
    /// A seek may not have the pulses of the whole travel, or has more than 32 767.
    Seek,
}

impl fmt::Display for LayoutError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Motors => {
                write!(out, "an array has 1 to {MAX_MOTORS} motors; this build has room for {CAPACITY}")
            }
            Self::TickHz => out.write_str("the carrier must be 20000 to 200000 Hz"),
            Self::Duty => out.write_str(
                "duties must be 1 to 499 thousandths for an up pulse and 501 to 999 for a down pulse",
            ),
            Self::Groups => {
                out.write_str("each motor must have one rail and one chip, with numbers from 0 to 63")
            }
            Self::TwoRails => out.write_str("the motors of a chip must be on one rail"),
            Self::UpPulses => write!(out, "a stroke must have 1 to {MOST_UP_PULSES} up pulses at most"),
            Self::Seek => {
                write!(
                    out,
                    "the longest seek must cover the whole travel and have at most {MOST_SEEK} pulses"
                )
            }
        }
    }
}

impl core::error::Error for LayoutError {}

/// The carriers of all arrays.
const TICK_HZ: core::ops::RangeInclusive<u32> = 20_000..=200_000;
/// Bounds of what a layout may allow: counts of pulses have 16 bits.
const MOST_UP_PULSES: u16 = 10_000;
const MOST_SEEK: u16 = i16::MAX as u16;

impl Layout {
    /// The layout of an array. `rails` and `chips` have the number of the rail and of the chip of each motor, in any grouping. A
    /// stroke has at most `max_up_pulses` up pulses, and a seek of the lower stop at most `max_seek`.
    ///
    /// # Errors
    /// The first number that is out of bounds.
    pub const fn new(
        id: ArrayId,
        rails: &[u8],
        chips: &[u8],
        max_up_pulses: u16,
        max_seek: u16,
    ) -> Result<Self, LayoutError> {
        let motors = id.motors as usize;
        if motors == 0 || motors > CAPACITY {
            return Err(LayoutError::Motors);
        }
        if id.tick_hz < *TICK_HZ.start() || id.tick_hz > *TICK_HZ.end() {
            return Err(LayoutError::TickHz);
        }
        // The motor's rule: short high pulses move a pin up, long ones down.
        if id.duty_up == 0 || id.duty_up >= 500 || id.duty_down <= 500 || id.duty_down > 999 {
            return Err(LayoutError::Duty);
        }
        if rails.len() != motors || chips.len() != motors {
            return Err(LayoutError::Groups);
        }
        if max_up_pulses == 0 || max_up_pulses > MOST_UP_PULSES {
            return Err(LayoutError::UpPulses);
        }
        let max_down_pulses = max_up_pulses + correction(max_up_pulses);
        if max_seek < max_up_pulses + max_down_pulses || max_seek > MOST_SEEK {
            return Err(LayoutError::Seek);
        }
        let (Some((next_on_rail, on_rail)), Some((next_on_chip, on_chip))) = (ring(rails), ring(chips))
        else {
            return Err(LayoutError::Groups);
        };
        let mut layout = Self {
            motors: id.motors,
            id,
            max_up_pulses,
            max_down_pulses,
            max_seek,
            on_rail,
            on_chip,
            next_on_rail,
            next_on_chip,
            rails: [0; CAPACITY],
            chips: [0; CAPACITY],
        };
        let mut motor = 0;
        while motor < motors {
            (layout.rails[motor], layout.chips[motor]) = (rails[motor], chips[motor]);
            if rails[next_on_chip[motor] as usize] != rails[motor] {
                return Err(LayoutError::TwoRails);
            }
            motor += 1;
        }
        Ok(layout)
    }

    /// What the handshake says of the array.
    pub const fn id(&self) -> &ArrayId {
        &self.id
    }

    /// Number of motors.
    #[inline(always)]
    pub const fn motors(&self) -> usize {
        // Where the end of a loop is known to be within the capacity, it needs no checks.
        let motors = self.motors as usize;
        if motors < CAPACITY { motors } else { CAPACITY }
    }

    /// The end of loops over all motors that have nothing to do for others. On the chip it is a constant.
    #[inline(always)]
    pub(crate) const fn loop_end(&self) -> usize {
        if cfg!(feature = "pico") { CAPACITY } else { self.motors() }
    }

    /// All motors.
    pub const fn all(&self) -> MotorSet {
        MotorSet::first(self.motors())
    }

    /// Ticks per second.
    pub const fn tick_hz(&self) -> u32 {
        self.id.tick_hz
    }

    /// The number of a motor's rail: motors of a rail share a 30 V supply.
    pub const fn rail(&self, motor: usize) -> u8 {
        self.rails[motor]
    }

    /// The number of a motor's driver chip.
    pub const fn chip(&self, motor: usize) -> u8 {
        self.chips[motor]
    }

    /// Motors of the rail that has most.
    pub const fn motors_per_rail(&self) -> u8 {
        self.on_rail
    }

    /// Motors of the driver chip that has most.
    pub const fn motors_per_chip(&self) -> u8 {
        self.on_chip
    }

    pub(crate) const fn next_on_rail(&self) -> &Ring {
        &self.next_on_rail
    }

    pub(crate) const fn next_on_chip(&self) -> &Ring {
        &self.next_on_chip
    }

    /// The highest level.
    pub const fn max_up_pulses(&self) -> u16 {
        self.max_up_pulses
    }

    /// Most pulses of a way down, corrections included.
    pub const fn max_down_pulses(&self) -> u16 {
        self.max_down_pulses
    }

    /// Most net pulses by which moves may shift a pin from where it was at rest.
    pub const fn max_travel(&self) -> u16 {
        self.max_up_pulses
    }

    /// Farthest that shifts and moves can take a pin from the lower stop, pulses. A seek of so many pulses is always enough.
    pub const fn whole_travel(&self) -> u16 {
        self.max_travel() + self.max_down_pulses
    }

    /// Most pulses of a seek of the lower stop.
    pub const fn max_seek(&self) -> u16 {
        self.max_seek
    }

    /// Least pulses of a seek of a pin that is `above` pulses above the lower stop: half as many again, because a motor's first
    /// burst after half a second of rest travels 80 %, and its bursts scatter by 10 %; at most [`Self::whole_travel`].
    pub const fn least_seek(&self, above: u16) -> u16 {
        let whole = self.whole_travel();
        if above < whole / 3 * 2 { above + above / 2 + 1 } else { whole }
    }

    /// Most pulses per sliding second that a motor may push against a lower stop: three tenths of all. Our choice; no data on wear
    /// were found. With the paper's motors there is room for a seek and a half.
    pub const fn max_pushes_per_s(&self) -> u32 {
        self.tick_hz() * 3 / 10
    }

    /// Least ticks from the beginning of a stroke to that of the next one of its motor: 1 ms. Strokes of a pattern are at least
    /// 1.67 ms long, half a period of 300 Hz.
    pub const fn least_apart(&self) -> u32 {
        self.tick_hz().div_ceil(1_000)
    }

    /// Most moves that begin within [`Self::dense_ticks`], of all motors together, before moves up are refused. Each motor begins at most
    /// eight at 300 Hz.
    pub const fn max_dense(&self) -> u16 {
        8 * self.id.motors as u16
    }

    /// 10 ms, in whole blocks of what is rendered.
    pub const fn dense_ticks(&self) -> u32 {
        self.dense_blocks() as u32 * BLOCK
    }

    pub(crate) const fn dense_blocks(&self) -> u8 {
        (self.tick_hz() / 100 / BLOCK) as u8
    }

    /// The blocks of [`Self::dense_blocks`] at the fastest carrier.
    pub(crate) const MAX_DENSE_BLOCKS: usize = *TICK_HZ.end() as usize / 100 / BLOCK as usize;

    /// The shortest time for which a pin may be held above rest: a fifth of a second, ticks. Streams have no longer gaps.
    pub const fn least_hold(&self) -> u32 {
        self.tick_hz() / 5
    }

    /// The longest: a minute, ticks.
    pub const fn longest_hold(&self) -> u32 {
        60 * self.tick_hz()
    }

    /// Ticks from the drivers' enable to the first pulse: 0.5 ms. The 30 V supplies stay on, so only the bridges and their bias
    /// start up in this time. What they need has not been measured: see the firmware's page on wiring.
    pub const fn driver_lead(&self) -> u32 {
        self.tick_hz().div_ceil(2_000)
    }

    /// Ticks from now to the first tick at which a move is never late: the render horizon and the drivers' lead.
    pub const fn horizon(&self) -> u8 {
        (HORIZON + self.driver_lead()) as u8
    }

    /// The longest host watchdog timeout: 10 s.
    pub const fn max_host_timeout(&self) -> u32 {
        10 * self.tick_hz()
    }

    /// Ticks after an edge of the trigger input in which another does not count: 1 ms.
    pub const fn edge_dead_time(&self) -> u32 {
        self.tick_hz() / 1_000
    }

    /// Ticks after which unseen reports are repeated, once the host is heard again: 10 ms.
    pub(crate) const fn report_repeat(&self) -> u32 {
        self.tick_hz() / 100
    }
}

/// The ring of each group, and the motors of the largest one; `None` if a number is too large.
const fn ring(groups: &[u8]) -> Option<(Ring, u8)> {
    let (mut ring, mut most, mut motor) = ([0; CAPACITY], 0, 0);
    while motor < groups.len() {
        if groups[motor] as usize >= MAX_MOTORS {
            return None;
        }
        let (mut count, mut next, mut other) = (0, motor, groups.len());
        // Backward, so that the next one is found last: first the lowest of the group, then the lowest behind `motor`.
        while other > 0 {
            other -= 1;
            if groups[other] == groups[motor] {
                count += 1;
                if other > motor || next <= motor {
                    next = other;
                }
            }
        }
        ring[motor] = next as u8;
        most = if count > most { count } else { most };
        motor += 1;
    }
    Some((ring, most))
}

/// Most pulses by which a correction may change a planned count: 30 %, at least 1.
pub const fn correction(planned: u16) -> u16 {
    // Divides by ten with a multiplication, exact for 16 bits: the chip's core has no division.
    let planned = planned as u32;
    let tens = (planned * 52_429) >> 19;
    let part = tens * 3 + (((planned - tens * 10) * 3 * 52_429) >> 19);
    if part > 1 { part as u16 } else { 1 }
}

/// Whether `count` is within [`correction`] of `planned`.
pub const fn within_correction(planned: u16, count: u16) -> bool {
    count.abs_diff(planned) <= correction(planned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_is_on_one_rail() {
        let of = |chips: &[u8]| {
            Layout::new(ArrayId { motors: 4, ..Layout::PAPER.id }, &[0, 1, 0, 1], chips, 100, 300)
        };
        assert!(of(&[5, 7, 5, 7]).is_ok() && of(&[0, 1, 2, 3]).is_ok());
        for chips in [[0, 0, 1, 2], [0, 1, 2, 0], [3, 3, 3, 3]] {
            assert_eq!(of(&chips).err(), Some(LayoutError::TwoRails), "{chips:?}");
        }
    }

    impl Layout {
        /// Numbers as those of the paper's array, for tests.
        pub(crate) const PAPER: Self = {
            let Some(name) = Name::new("paper") else { panic!("a name") };
            let id = ArrayId { name, motors: 24, tick_hz: 85_000, duty_up: 200, duty_down: 800, hash: 0 };
            let (mut rails, mut chips, mut motor) = ([0; 24], [0; 24], 0);
            while motor < 24 {
                (rails[motor], chips[motor]) = (motor as u8 / 6, motor as u8 / 2);
                motor += 1;
            }
            match Self::new(id, &rails, &chips, 3_000, 17_000) {
                Ok(layout) => layout,
                Err(_) => panic!("a layout"),
            }
        };
    }

    #[test]
    fn an_up_pulse_is_shorter_than_half_a_tick_and_a_down_pulse_is_longer() {
        let with = |duty_up, duty_down| {
            let id = ArrayId { motors: 1, duty_up, duty_down, ..Layout::PAPER.id };
            Layout::new(id, &[0], &[0], 3_000, 17_000).map(|layout| *layout.id())
        };
        for (up, down) in [(1, 501), (499, 999)] {
            assert!(with(up, down).is_ok(), "{up} {down}");
        }
        for (up, down) in [(0, 800), (20, 200), (500, 800), (200, 500), (600, 800), (800, 200), (200, 1_000)]
        {
            assert_eq!(with(up, down), Err(LayoutError::Duty), "{up} {down}");
        }
    }
}
