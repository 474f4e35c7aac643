//! Packed items: whatever is unpacked can be packed again and is the same, and an error ends a list.

use crate::input::byte;
use arbitrary::Unstructured;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{
    Amendment, Amendments, BATCH_BYTES, Full, MAX_BATCH, Packer, Stroke, Unpacked, moves,
};
use firmware_protocol::moves::Move;
use firmware_protocol::tick::Tick;

/// Bytes from here on are heads of rows, or continued varints.
const ROW: u8 = 0xc0;

/// The bytes are a list of either kind; or moves and amendments are packed that the bytes give.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let how = byte(&mut input);
    // Near zero a list of amendments may go back before it.
    let base = if how & 4 == 0 { Tick::BOOT } else { Tick(byte(&mut input).into()) };
    match how & 3 {
        0 => unpack_moves(base, input.take_rest()),
        1 => unpack_amendments(base, input.take_rest()),
        2 => pack_moves(base, &mut input),
        _ => pack_amendments(base, &mut input),
    }
}

/// Packs a list again, without rows.
fn pack(packer: &mut Packer<BATCH_BYTES>, list: &[Unpacked]) -> Result<(), Full> {
    let mut list = list.iter().peekable();
    while let Some(first) = list.next() {
        let of = first.of;
        match list.next_if(|second| second.joined) {
            Some(Unpacked { of: second, .. }) => {
                let Move { motor, tick: up, level, .. } = of;
                let (down, surplus) = (second.tick, second.surplus);
                assert!(second.motor == motor && second.level == 0 && of.surplus == 0);
                assert!(down >= up + u64::from(level), "bursts in order");
                packer.stroke(&Stroke { motor, up, level, down, surplus })?;
            }
            None => packer.moves(&of)?,
        }
    }
    Ok(())
}

fn unpack_moves(base: Tick, bytes: &[u8]) {
    let Ok(list) = moves(base, bytes) else { return };
    assert!(list.iter().all(|item| item.of.motor < 64) && list.len() <= MAX_BATCH);
    assert!(list.first().is_none_or(|first| !first.joined));
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let rows = bytes.iter().any(|&byte| byte >= ROW);
    // Rows are shorter than their moves.
    if pack(&mut packer, &list).is_err() {
        assert!(rows || bytes.len() > BATCH_BYTES);
        return;
    }
    assert_eq!(moves(base, packer.bytes()).as_ref(), Ok(&list));
    // The packer writes the shortest form.
    assert!(rows || packer.bytes().len() <= bytes.len());
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
    for amendment in &read[..packer.count()] {
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

fn pack_moves(base: Tick, input: &mut Unstructured<'_>) {
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let mut packed: Vec<Unpacked> = Vec::with_capacity(MAX_BATCH);
    let mut at = base.0;
    while !input.is_empty() {
        let head = byte(input);
        let (motor, level, tick) = (head & 63, number(input) as u16, Tick(at + number(input)));
        let before = (packer.count(), packer.bytes().len());
        let mut items: Vec<Unpacked> = Vec::new();
        let fits = match head >> 6 {
            0 => {
                let of = Move { motor, tick, level, surplus: number(input) as u16 };
                items.push(Unpacked { of, joined: false });
                packer.moves(&of)
            }
            1 | 2 => {
                let down = tick + u64::from(level) + number(input);
                let of = Stroke { motor, up: tick, level, down, surplus: number(input) as u16 };
                let [up, down] = of.moves();
                items.extend([Unpacked { of: up, joined: false }, Unpacked { of: down, joined: true }]);
                packer.stroke(&of)
            }
            _ => {
                let motors = MotorSet::from_bits(number(input) << (motor % 8));
                let levels: Vec<u16> =
                    (0..motors.len() as u16).map(|k| level.wrapping_add(k << (motor / 8))).collect();
                let of = motors.iter().zip(&levels);
                let of = of.map(|(motor, &level)| Move { motor, tick, level, surplus: 0 });
                items.extend(of.map(|of| Unpacked { of, joined: false }));
                packer.row(tick, motors, &levels)
            }
        };
        if fits.is_ok() {
            packed.extend(items);
            at = tick.0;
        } else {
            assert_eq!(before, (packer.count(), packer.bytes().len()), "what does not fit changes nothing");
        }
        assert!(packer.count() <= MAX_BATCH && packer.bytes().len() <= BATCH_BYTES);
    }
    assert_eq!(packer.count(), packed.len());
    assert_eq!(moves(base, packer.bytes()).as_deref(), Ok(&packed[..]));
}

fn pack_amendments(base: Tick, input: &mut Unstructured<'_>) {
    let mut packer = Packer::<BATCH_BYTES>::new(base);
    let mut packed: [Option<Amendment>; MAX_BATCH] = [None; MAX_BATCH];
    while !input.is_empty() {
        let head = byte(input);
        // Before and after the base.
        let tick = Tick(if head & 0x40 == 0 {
            base.0 + number(input)
        } else {
            base.0.saturating_sub(number(input))
        });
        let amendment = Amendment { motor: head & 63, tick, pulses: number(input) as u16 };
        let items = packer.count();
        if packer.amendment(&amendment).is_ok() {
            packed[items] = Some(amendment);
        } else {
            assert_eq!(items, packer.count());
        }
    }
    let mut read = Amendments::new(base, packer.bytes());
    for amendment in packed.iter().flatten() {
        assert_eq!(read.next(), Some(Ok(*amendment)));
    }
    assert!(read.next().is_none());
}
