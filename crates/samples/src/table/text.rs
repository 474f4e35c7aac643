//! Turns the bytes of a table into text: unpacks gzip, and finds the encoding.
//!
//! A byte order mark names the encoding. Without one, zeros tell UTF-16; valid UTF-8 is UTF-8; else it is that of Windows in Western
//! Europe, or Shift JIS, which instruments and spreadsheets write.
//!
//! Invariant: the text has at most twice the bytes of the file, and no zeros.

use super::error::TableError;
use encoding_rs::{Encoding, SHIFT_JIS, UTF_8, UTF_16BE, UTF_16LE, WINDOWS_1252};
use flate2::read::MultiGzDecoder;
use meissner_input::message::cut;
use std::borrow::Cow;
use std::io::Read;

/// Bytes that tell the encoding.
const HEAD: usize = 1 << 16;
/// How files begin that are often taken for CSV.
const OTHERS: [(&[u8], &str); 9] = [
    (b"PK\x03\x04", "an Excel workbook or a ZIP archive"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB", "a MATLAB file"),
    (b"TDSm", "a TDMS file"),
    (b"RIFF", "a WAV file"),
    (b"%PDF", "a PDF file"),
    (b"\x1f\x8b", "a packed file (gzip)"),
];

/// The bytes, unpacked if they are a gzip file.
///
/// # Errors
/// They are damaged, or more than `most`.
pub fn unpacked(bytes: &[u8], most: usize) -> Result<Cow<'_, [u8]>, TableError> {
    let bytes = if bytes.starts_with(b"\x1f\x8b") {
        let mut unpacked = Vec::new();
        let read = MultiGzDecoder::new(bytes).take(most as u64 + 1).read_to_end(&mut unpacked);
        read.map_err(|error| TableError::Packed { why: cut(&error.to_string(), 200) })?;
        Cow::Owned(unpacked)
    } else {
        Cow::Borrowed(bytes)
    };
    if bytes.len() > most { Err(TableError::TooLarge { most }) } else { Ok(bytes) }
}

/// The text of a file.
///
/// # Errors
/// It is no text.
pub(super) fn decoded(bytes: &[u8]) -> Result<Cow<'_, str>, TableError> {
    if let Some((_, what)) = OTHERS.iter().find(|(begin, _)| bytes.starts_with(begin)) {
        return Err(TableError::NotText { what });
    }
    let (text, ..) = encoding(bytes).decode(bytes);
    if text.contains('\0') { Err(TableError::NotText { what: "a binary file" }) } else { Ok(text) }
}

/// The encoding; a byte order mark overrides it.
fn encoding(bytes: &[u8]) -> &'static Encoding {
    let head = &bytes[..bytes.len().min(HEAD)];
    let zeros = |odd: usize| head.iter().skip(odd).step_by(2).filter(|&&byte| byte == 0).count();
    for (odd, encoding) in [(0, UTF_16BE), (1, UTF_16LE)] {
        if 8 * zeros(odd) > head.len() && zeros(1 - odd) == 0 {
            return encoding;
        }
    }
    if str::from_utf8(bytes).is_ok() {
        return UTF_8;
    }
    // Micrometres in Shift JIS. A header is too short for a guess from its letters, and only the units matter.
    let is_shift_jis = head.windows(3).any(|three| three == b"\x83\xcam");
    if is_shift_jis { SHIFT_JIS } else { WINDOWS_1252 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_are_found() {
        for (bytes, wanted) in [
            (&b"Weg [\xb5m]"[..], "Weg [\u{b5}m]"),
            (
                b"Zeit (s);Auslenkung (\xb5m)\r\n0,001;1,5\r\n",
                "Zeit (s);Auslenkung (\u{b5}m)\r\n0,001;1,5\r\n",
            ),
            (b"\xef\xbb\xbft,\xc2\xb5m", "t,\u{b5}m"),
            (b"t,\xce\xbcm", "t,\u{3bc}m"),
            (b"\xff\xfet\0\xb5\0m\0", "t\u{b5}m"),
            (b"t\0,\0\xb5\0m\0", "t,\u{b5}m"),
            (b"\0t\0,\0\xb5\0m", "t,\u{b5}m"),
            (b"\x95\xcf\x88\xca(\x83\xcam)", "\u{5909}\u{4f4d}(\u{3bc}m)"),
        ] {
            assert_eq!(decoded(bytes).unwrap(), wanted);
        }
        assert_eq!(decoded(b"PK\x03\x04rest").unwrap_err().to_string().find("is an Excel workbook"), Some(0));
        assert_eq!(decoded(b"1,2\n\0\0\0\0"), Err(TableError::NotText { what: "a binary file" }));
    }

    #[test]
    fn a_gzip_file_is_unpacked_within_its_bound() {
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        std::io::Write::write_all(&mut packed, &[b'1'; 1000]).unwrap();
        let packed = packed.finish().unwrap();
        assert_eq!(unpacked(&packed, 1000).unwrap().len(), 1000);
        assert_eq!(unpacked(&packed, 999), Err(TableError::TooLarge { most: 999 }));
        let cut = unpacked(&packed[..packed.len() - 9], 1000).unwrap_err().to_string();
        assert!(cut.starts_with("is damaged"), "{cut}");
        assert_eq!(unpacked(b"1,2", 3).unwrap(), &b"1,2"[..]);
    }
}
