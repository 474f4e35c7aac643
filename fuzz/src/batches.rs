//! Packed items: whatever is unpacked can be packed again and is the same, and an error ends a list.

use crate::input::byte;
use arbitrary::Unstructured;
use firmware_protocol::batch::{Amendment, Amendments, BATCH_BYTES, MAX_BATCH, Packer, Strokes};
use meissner_array::strokes::Stroke;
use firmware_protocol::tick::Tick;

/// The bytes are a list of either kind; or strokes and amendments are packed that the bytes give.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let how = byte(&mut input);
    // Near zero a list of amendments may go back before it.
    let base = if how & 4 == 0 { Tick::BOOT } else { Tick(byte(&mut input).into()) };
    match how & 3 {
        0 => unpack_strokes(base, input.take_rest()),
        1 => unpack_amendments(base, input.take_rest()),
        2 => pack_strokes(base, &mut input),
        _ => pack_amendments(base, &mut input),
    }
}

fn unpack_strokes(base: Tick, bytes: &[u8]) {
    let mut list = Strokes::new(base, bytes);
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let mut read: [Option<Stroke>; MAX_BATCH] = [None; MAX_BATCH];
    for (count, item) in list.by_ref().enumerate() {
        let Ok(stroke) = item else { break };
        assert!(stroke.motor < 64);
        assert!(stroke.down >= stroke.up + u64::from(stroke.up_pulses), "bursts in order");
        if count < MAX_BATCH && packer.stroke(&stroke).is_ok() {
            read[count] = Some(stroke);
        }
    }
    assert!(list.next().is_none(), "an error ends the list");
    let mut again = Strokes::new(base, packer.bytes());
    for stroke in &read[..packer.items()] {
        // An item that the packer had no room for ends what can be compared.
        let Some(stroke) = stroke else { return };
        assert_eq!(again.next(), Some(Ok(*stroke)));
    }
    // The packer writes the shortest form, except that it names the pulses of the first stroke.
    assert!(packer.bytes().len() <= bytes.len() + 1);
}

fn unpack_amendments(base: Tick, bytes: &[u8]) {
    let mut list = Amendments::new(base, bytes);
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let mut read: [Option<Amendment>; MAX_BATCH] = [None; MAX_BATCH];
    for (count, item) in list.by_ref().enumerate() {
        let Ok(amendment) = item else { break };
        assert!(amendment.motor < 64);
        if count < MAX_BATCH && packer.amendment(&amendment).is_ok() {
            read[count] = Some(amendment);
        }
    }
    assert!(list.next().is_none(), "an error ends the list");
    let mut again = Amendments::new(base, packer.bytes());
    for amendment in &read[..packer.items()] {
        let Some(amendment) = amendment else { return };
        assert_eq!(again.next(), Some(Ok(*amendment)));
    }
    assert!(packer.bytes().len() <= bytes.len());
}

/// A number of a size that varies.
fn number(input: &mut Unstructured<'_>) -> u64 {
    match byte(input) {
        small @ 0..0xe0 => small.into(),
        0xe0..0xf0 => input.arbitrary::<u16>().unwrap_or_default().into(),
        0xf0..0xfd => input.arbitrary::<u32>().unwrap_or_default().into(),
        _ => input.arbitrary::<u64>().unwrap_or_default() >> 8,
    }
}

fn pack_strokes(base: Tick, input: &mut Unstructured<'_>) {
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let mut packed: [Option<Stroke>; MAX_BATCH] = [None; MAX_BATCH];
    let mut at = base.0;
    while !input.is_empty() {
        let motor = byte(input) & 63;
        let up_pulses = number(input) as u16;
        let up = Tick(at + number(input));
        let down = up + u64::from(up_pulses) + number(input);
        let stroke = Stroke { motor, up, up_pulses, down, down_pulses: up_pulses ^ number(input) as u16 };
        let before = (packer.items(), packer.bytes().len());
        if packer.stroke(&stroke).is_ok() {
            packed[before.0] = Some(stroke);
            at = up.0;
        } else {
            assert_eq!(before, (packer.items(), packer.bytes().len()), "what does not fit changes nothing");
        }
        assert!(packer.items() <= MAX_BATCH && packer.bytes().len() <= BATCH_BYTES);
    }
    let mut read = Strokes::new(base, packer.bytes());
    for stroke in packed.iter().flatten() {
        assert_eq!(read.next(), Some(Ok(*stroke)));
    }
    assert!(read.next().is_none());
}

fn pack_amendments(base: Tick, input: &mut Unstructured<'_>) {
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let mut packed: [Option<Amendment>; MAX_BATCH] = [None; MAX_BATCH];
    while !input.is_empty() {
        let head = byte(input);
        let direction = crate::input::direction(input);
        // Before and after the base.
        let up = Tick(if head & 0x40 == 0 {
            base.0 + number(input)
        } else {
            base.0.saturating_sub(number(input))
        });
        let amendment = Amendment { motor: head & 63, up, direction, pulses: number(input) as u16 };
        let items = packer.items();
        if packer.amendment(&amendment).is_ok() {
            packed[items] = Some(amendment);
        } else {
            assert_eq!(items, packer.items());
        }
    }
    let mut read = Amendments::new(base, packer.bytes());
    for amendment in packed.iter().flatten() {
        assert_eq!(read.next(), Some(Ok(*amendment)));
    }
    assert!(read.next().is_none());
}
