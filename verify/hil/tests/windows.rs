//! What Windows reads of the device before it chooses drivers: the BOS descriptor and the Microsoft OS 2.0 descriptor set.
//!
//! The numbers are those of USB 3.2, 9.6.2, and of Microsoft's specification of OS 2.0 descriptors, not of the firmware's library.

use crate::bus::start;
use firmware_protocol::urgent::e_stop_request;
use meissner_hil::bench::chip::ChipBench;
use meissner_hil::time::MS;

/// D8DD60DF-4589-4CC7-9CD2-659D9E648A9F, as it is on the wire.
const MICROSOFT_OS_20: [u8; 16] =
    [0xdf, 0x60, 0xdd, 0xd8, 0x89, 0x45, 0xc7, 0x4c, 0x9c, 0xd2, 0x65, 0x9d, 0x9e, 0x64, 0x8a, 0x9f];
/// Windows 8.1, the first that reads them.
const WINDOWS_8_1: u32 = 0x0603_0000;

/// The device's answer to an IN request; `None` if it stalls.
fn get(chip: &mut ChipBench, kind: u8, request: u8, value: u16, index: u16, length: u16) -> Option<Vec<u8>> {
    let ([v, w], [i, j], [l, m]) = (value.to_le_bytes(), index.to_le_bytes(), length.to_le_bytes());
    chip.transfers.clear();
    chip.transfer([kind, request, v, w, i, j, l, m], &[]).unwrap();
    chip.run(chip.cycle() + 10 * MS).unwrap();
    chip.transfers.pop().expect("the request has ended")
}

fn half(bytes: &[u8]) -> usize {
    usize::from(u16::from_le_bytes([bytes[0], bytes[1]]))
}

/// Descriptors in a row, each of the length that it names; `wide` lengths have two bytes.
fn split(mut bytes: &[u8], wide: bool) -> Vec<&[u8]> {
    let mut all = Vec::new();
    while !bytes.is_empty() {
        let len = if wide { half(bytes) } else { bytes[0].into() };
        assert!(len >= 2 && len <= bytes.len(), "a length of {len} in {} bytes", bytes.len());
        let (one, rest) = bytes.split_at(len);
        all.push(one);
        bytes = rest;
    }
    all
}

/// The platform capability of Microsoft: its version, the length of the set, and the request that reads it.
fn capability(chip: &mut ChipBench) -> (u32, usize, u8) {
    let head = get(chip, 0x80, 6, 0x0f00, 0, 5).unwrap();
    let bos = get(chip, 0x80, 6, 0x0f00, 0, half(&head[2..]) as u16).unwrap();
    assert_eq!((bos[0], bos[1], half(&bos[2..])), (5, 15, bos.len()));
    let capabilities = split(&bos[5..], false);
    assert_eq!(capabilities.len(), usize::from(bos[4]));
    let found =
        capabilities.into_iter().find(|one| one[1] == 16 && one[2] == 5 && one[4..20] == MICROSOFT_OS_20);
    let one = found.expect("no platform capability of Microsoft");
    // One descriptor set, and no alternate enumeration.
    assert_eq!((one.len(), one[3], one[27]), (28, 0, 0));
    (u32::from_le_bytes(one[20..24].try_into().unwrap()), half(&one[24..]), one[26])
}

#[test]
fn windows_finds_its_own_driver_for_the_vendor_interface() {
    let mut chip = start();
    let device = get(&mut chip, 0x80, 6, 0x0100, 0, 18).unwrap();
    assert!(half(&device[2..]) >= 0x0201, "Windows asks no device below USB 2.1 for a BOS descriptor");
    let (version, len, request) = capability(&mut chip);
    assert_eq!(version, WINDOWS_8_1);
    assert_ne!(request, e_stop_request(0)[1], "the request is that of an e-stop");

    let set = get(&mut chip, 0xc0, request, 0, 7, len as u16).unwrap();
    assert_eq!(set.len(), len);
    // The set, its configuration subset, and in that the function subset: each header names the rest's length.
    assert_eq!((half(&set), half(&set[2..]), half(&set[8..])), (10, 0, len));
    assert_eq!(u32::from_le_bytes(set[4..8].try_into().unwrap()), version);
    let configuration = &set[10..];
    assert_eq!((half(configuration), half(&configuration[2..]), half(&configuration[6..])), (8, 1, len - 10));
    assert_eq!(configuration[4], 0, "the index of the configuration");
    let function = &configuration[8..];
    assert_eq!((half(function), half(&function[2..]), half(&function[6..])), (8, 2, len - 18));
    assert_eq!(function[4], vendor_interface(&mut chip));
    let features = split(&function[8..], true);
    let kinds: Vec<_> = features.iter().map(|one| half(&one[2..])).collect();
    assert_eq!(kinds, [3, 4], "a compatible id and a registry property");
    assert_eq!(features[0][4..], *b"WINUSB\0\0\0\0\0\0\0\0\0\0");
    let property = features[1];
    // REG_MULTI_SZ.
    assert_eq!(half(&property[4..]), 7);
    let name_len = half(&property[6..]);
    assert_eq!(text(&property[8..8 + name_len]), "DeviceInterfaceGUIDs\0");
    let data = &property[8 + name_len..];
    assert_eq!(half(data), data.len() - 2);
    let guids = text(&data[2..]);
    let guid = guids.strip_suffix("\0\0").unwrap();
    let parts: Vec<_> = guid.strip_prefix('{').unwrap().strip_suffix('}').unwrap().split('-').collect();
    assert_eq!(parts.iter().map(|part| part.len()).collect::<Vec<_>>(), [8, 4, 4, 4, 12], "{guid}");
    assert!(parts.concat().chars().all(|digit| digit.is_ascii_hexdigit()), "{guid}");
}

fn text(utf16: &[u8]) -> String {
    assert_eq!(utf16.len() % 2, 0);
    let units: Vec<_> = utf16.chunks(2).map(|unit| half(unit) as u16).collect();
    String::from_utf16(&units).unwrap()
}

/// The number of the interface of the vendor's class.
fn vendor_interface(chip: &mut ChipBench) -> u8 {
    let configuration = get(chip, 0x80, 6, 0x0200, 0, 512).unwrap();
    let descriptors = split(&configuration, false);
    descriptors.into_iter().find(|one| one[1] == 4 && one[5] == 0xff).expect("no vendor interface")[2]
}

#[test]
fn the_requests_of_windows_and_of_an_e_stop_are_told_apart() {
    let mut chip = start();
    let (_, len, request) = capability(&mut chip);
    let len = len as u16;
    // Another index, the e-stop's number from the device, and the number of Windows to the device: none is known.
    assert_eq!(get(&mut chip, 0xc0, request, 0, 6, len), None);
    assert_eq!(get(&mut chip, 0xc0, b'E', 0, 7, len), None);
    chip.transfers.clear();
    chip.transfer([0x40, request, 1, 0, 0, 0, 0, 0], &[]).unwrap();
    chip.run(chip.cycle() + 10 * MS).unwrap();
    assert_eq!(chip.transfers, [None]);
    // A shorter answer than the set: the host asks for its head.
    assert_eq!(get(&mut chip, 0xc0, request, 0, 7, 10).unwrap().len(), 10);
    chip.transfers.clear();
    chip.transfer(e_stop_request(1), &[]).unwrap();
    chip.run(chip.cycle() + 10 * MS).unwrap();
    assert_eq!(chip.transfers, [Some(vec![])]);
}
