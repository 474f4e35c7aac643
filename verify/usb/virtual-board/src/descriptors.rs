//! The board's USB descriptors: a CDC-ACM port, which becomes a `ttyACM`, and a vendor interface with the same frames.

use usbip::{UsbDevice, UsbSpeed};

/// Endpoint numbers. The top bit of an address means: to the host.
pub(crate) const NOTIFICATIONS: u32 = 1;
pub(crate) const SERIAL: u32 = 2;
pub(crate) const VENDOR: u32 = 3;

const TO_HOST: u8 = 0x80;
/// Bytes per packet of a full-speed bulk endpoint.
const PACKET: u8 = 64;
const VENDOR_ID: u16 = 0x1209;
const PRODUCT_ID: u16 = 0x0001;

/// The board as USB/IP exports it. The host requests the rest from the board.
pub(crate) fn exported() -> UsbDevice {
    let mut device = UsbDevice::new(0);
    device.speed = UsbSpeed::Full as u32;
    device.vendor_id = VENDOR_ID;
    device.product_id = PRODUCT_ID;
    (device.device_class, device.device_subclass, device.device_protocol) = (0xEF, 2, 1);
    device
}

/// The descriptor of a type and an index, if there is one.
pub(crate) fn descriptor(kind: u8, index: u8, serial: &str) -> Option<Vec<u8>> {
    match (kind, index) {
        (1, 0) => Some(device()),
        (2, 0) => Some(configuration()),
        (3, 0) => Some(vec![4, 3, 0x09, 0x04]),
        (3, 1 | 2) => Some(string("meissner")),
        (3, 3) => Some(string(serial)),
        // A full-speed device has no others.
        _ => None,
    }
}

fn device() -> Vec<u8> {
    let [vendor, product] = [VENDOR_ID.to_le_bytes(), PRODUCT_ID.to_le_bytes()];
    // USB 2.0, a composite device with interface associations, release 0.1.
    let mut bytes = vec![18, 1, 0x00, 0x02, 0xEF, 2, 1, PACKET];
    bytes.extend([vendor, product, [0x10, 0x00]].concat());
    // Strings: manufacturer, product, serial number. One configuration.
    bytes.extend([1, 2, 3, 1]);
    bytes
}

fn string(text: &str) -> Vec<u8> {
    let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    // The length is one byte, enough for a serial number.
    let len = u8::try_from(units.len() + 2).unwrap_or(u8::MAX);
    [vec![len, 3], units].concat()
}

fn configuration() -> Vec<u8> {
    let (serial, vendor) = (SERIAL as u8, VENDOR as u8);
    let parts: [Vec<u8>; 13] = [
        // Interfaces 0 and 1 belong together.
        vec![8, 11, 0, 2, 2, 2, 0, 0],
        interface(0, 1, [2, 2, 0]),
        // CDC 1.10; no call management; line coding and state; interface 0 controls 1.
        vec![5, 0x24, 0, 0x10, 0x01],
        vec![5, 0x24, 1, 0, 1],
        vec![4, 0x24, 2, 2],
        vec![5, 0x24, 6, 0, 1],
        vec![7, 5, NOTIFICATIONS as u8 | TO_HOST, 3, 8, 0, 255],
        interface(1, 2, [10, 0, 0]),
        bulk(serial),
        bulk(serial | TO_HOST),
        interface(2, 2, [0xFF, 0, 0]),
        bulk(vendor),
        bulk(vendor | TO_HOST),
    ];
    let body = parts.concat();
    let [low, high] = (body.len() as u16 + 9).to_le_bytes();
    // Three interfaces, configuration 1, powered by the bus with up to 500 mA.
    [vec![9, 2, low, high, 3, 1, 0, 0x80, 250], body].concat()
}

fn interface(number: u8, endpoints: u8, class: [u8; 3]) -> Vec<u8> {
    let [class, subclass, protocol] = class;
    vec![9, 4, number, 0, endpoints, class, subclass, protocol, 0]
}

fn bulk(address: u8) -> Vec<u8> {
    vec![7, 5, address, 2, PACKET, 0, 0]
}
