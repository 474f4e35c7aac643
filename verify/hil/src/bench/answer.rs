//! Reads the emulator's answers: a line of JSON, and a binary tail whose size the line gives.
//!
//! A truncated or invalid answer is an error.

use serde::Deserialize;
use std::io::{self, BufRead};

/// Bytes of a level change in the tail: cycle (u64 LE), levels (u32 LE).
const RECORD: usize = 12;

/// The JSON line of an answer.
#[derive(Clone, Debug, Default, Deserialize)]
struct Head {
    #[serde(default)]
    error: Option<String>,
    #[serde(default)]
    cycle: u64,
    #[serde(default)]
    levels: usize,
    #[serde(default)]
    cdc: usize,
    #[serde(default)]
    bulk: usize,
    #[serde(default)]
    packets: Vec<(String, u64, u64)>,
    #[serde(default)]
    transfers: Vec<Option<String>>,
    #[serde(default)]
    configured: bool,
    #[serde(default)]
    resets: u64,
    #[serde(default)]
    asleep: u64,
    #[serde(default)]
    hex: Option<String>,
}

/// A whole answer.
#[derive(Clone, Debug, Default)]
pub struct Answer {
    /// The chip's clock, in cycles.
    pub cycle: u64,
    /// Level changes of GP0 to GP29 since the last answer: cycle and new levels.
    pub levels: Vec<(u64, u32)>,
    /// Bytes from the tty function.
    pub cdc: Vec<u8>,
    /// Bytes from the bulk function.
    pub bulk: Vec<u8>,
    /// Packets that the chip has taken: pipe, cycle and length.
    pub packets: Vec<(String, u64, u64)>,
    /// Control transfers that have ended: the bytes from the device, or `None` if it refused.
    pub transfers: Vec<Option<Vec<u8>>>,
    /// Whether the host has configured the device.
    pub configured: bool,
    /// Resets since power-up.
    pub resets: u64,
    /// Cycles slept since power-up.
    pub asleep: u64,
    /// The memory asked for.
    pub memory: Vec<u8>,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum AnswerError {
    /// The emulator ended, or its pipe broke.
    #[error("the emulator is gone: {0}")]
    Gone(#[from] io::Error),
    /// The line is not valid.
    #[error("the emulator's answer cannot be read: {0}")]
    Line(#[from] serde_json::Error),
    /// The emulator refused the request.
    #[error("the emulator says: {0}")]
    Refused(String),
    /// Not hexadecimal digits.
    #[error("the emulator's memory dump is no hex: {0}")]
    Hex(String),
}

impl Answer {
    /// Reads the next answer.
    ///
    /// # Errors
    /// If there is none, or it is not valid.
    pub fn read(from: &mut impl BufRead) -> Result<Self, AnswerError> {
        let mut line = String::new();
        if from.read_line(&mut line)? == 0 {
            return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
        }
        let head: Head = serde_json::from_str(&line)?;
        if let Some(error) = head.error {
            return Err(AnswerError::Refused(error));
        }
        let mut bytes = |len| {
            let mut bytes = vec![0; len];
            from.read_exact(&mut bytes).map(|()| bytes)
        };
        let levels = bytes(head.levels * RECORD)?;
        let (cdc, bulk) = (bytes(head.cdc)?, bytes(head.bulk)?);
        let hex = head.hex.unwrap_or_default();
        let bytes_of = |got: String| unhex(&got).ok_or(AnswerError::Hex(got));
        let transfers = head.transfers.into_iter().map(|got| got.map(bytes_of).transpose());
        let transfers = transfers.collect::<Result<_, _>>()?;
        Ok(Self {
            cycle: head.cycle,
            levels: levels.chunks_exact(RECORD).map(record).collect(),
            cdc,
            bulk,
            packets: head.packets,
            transfers,
            configured: head.configured,
            resets: head.resets,
            asleep: head.asleep,
            memory: bytes_of(hex)?,
        })
    }
}

fn record(bytes: &[u8]) -> (u64, u32) {
    let number = |bytes: &[u8]| bytes.iter().rev().fold(0, |sum, &byte| sum << 8 | u64::from(byte));
    (number(&bytes[..8]), number(&bytes[8..]) as u32)
}

/// Bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    let digit = |nibble: u8| char::from_digit(nibble.into(), 16).unwrap_or('0');
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

/// Hexadecimal digits as bytes.
pub fn unhex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<_>> = text.chars().map(|digit| digit.to_digit(16)).collect();
    let digits = digits.filter(|digits| digits.len() % 2 == 0)?;
    Some(digits.chunks_exact(2).map(|pair| (pair[0] << 4 | pair[1]) as u8).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn canned(line: &str, tail: &[u8]) -> Vec<u8> {
        [line.as_bytes(), b"\n", tail].concat()
    }

    #[test]
    fn a_line_and_its_tail_are_one_answer_and_the_next_follows() {
        let mut tail = Vec::new();
        tail.extend(0x1_0000_0002u64.to_le_bytes());
        tail.extend(0x1000_0001u32.to_le_bytes());
        tail.extend([10, 0, 13, 7]);
        let line = r#"{"cycle":9,"levels":1,"cdc":3,"bulk":1,"packets":[["cdc",5,64]],"configured":true,"resets":1,"asleep":2}"#;
        let mut bytes = canned(line, &tail);
        bytes.extend(canned(r#"{"cycle":10,"levels":0,"cdc":0,"bulk":0,"packets":[],"configured":true,"resets":1,"hex":"0aff"}"#, &[]));
        let mut bytes = &bytes[..];
        let first = Answer::read(&mut bytes).unwrap();
        assert_eq!(first.levels, [(0x1_0000_0002, 0x1000_0001)]);
        assert_eq!((&first.cdc[..], &first.bulk[..], first.cycle), (&[10, 0, 13][..], &[7][..], 9));
        assert_eq!((first.packets, first.resets), (vec![("cdc".to_owned(), 5, 64)], 1));
        assert_eq!(Answer::read(&mut bytes).unwrap().memory, [10, 255]);
        assert!(matches!(Answer::read(&mut bytes), Err(AnswerError::Gone(_))));
    }

    #[test]
    fn what_is_no_answer_is_an_error() {
        let read = |line: &str, tail: &[u8]| Answer::read(&mut &canned(line, tail)[..]).unwrap_err();
        assert!(matches!(read("Error: no such file", &[]), AnswerError::Line(_)));
        assert!(matches!(read(r#"{"error":"no such symbol"}"#, &[]), AnswerError::Refused(_)));
        assert!(matches!(read(r#"{"cycle":1,"levels":2}"#, &[0; 13]), AnswerError::Gone(_)));
        assert!(matches!(read(r#"{"cycle":1,"hex":"0g"}"#, &[]), AnswerError::Hex(_)));
        assert_eq!(hex(&[0, 0x9f]), "009f");
    }
}
