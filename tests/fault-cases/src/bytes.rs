//! What a device must never send.

/// Bytes that are no frames.
pub fn nonsense(count: u32) -> Vec<u8> {
    (0..count).map(|i| (i * 73 % 251) as u8).collect()
}

/// A frame whose version is one below ours, whole in all else.
pub fn older_frame() -> Vec<u8> {
    let mut body = vec![firmware_protocol::frame::PROTOCOL - 1, 1, 2, 3];
    let crc = !body.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(
            crc ^ u32::from(byte),
            |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 },
        )
    });
    body.extend(crc.to_le_bytes());
    let mut frame = vec![0];
    let mut code = 0;
    for byte in body {
        if byte == 0 {
            frame[code] = (frame.len() - code) as u8;
            code = frame.len();
        }
        frame.push(byte);
    }
    frame[code] = (frame.len() - code) as u8;
    frame.push(0);
    // What came before ends here.
    frame.insert(0, 0);
    frame
}
