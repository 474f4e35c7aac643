//! Finds where each request of a connection begins and ends, so that the daemon sees the requests behind the one that it is
//! answering.
//!
//! [`Framer::take`] gets the bytes in the order in which they come and reports each complete head. It finds the end of a body as
//! hyper does: by chunks if the last `Transfer-Encoding` is `chunked`, else by `Content-Length`, else there is no body. It does not
//! store bodies.
//!
//! Where hyper refuses a request and closes the connection, the framer may read on and report an emergency stop that nobody
//! answers: it errs on the side of stopping. A message that it cannot delimit ends the framing. From then on only the server
//! recognises emergency stops.

use std::time::Duration;

/// How long a request's line and headers may take, from their first byte on.
pub(in crate::daemon) const HEAD: Duration = Duration::from_secs(5);
/// The most bytes of a head: hyper refuses longer ones.
const MAX_HEAD: usize = 64 << 10;
/// Headers of a request, at most, as in hyper.
pub(in crate::daemon) const MAX_HEADERS: usize = 100;

/// The part of a request that is still to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::daemon) enum Part {
    Head,
    /// This many bytes of a body.
    Body(u64),
    Chunks(Chunk),
    /// The bytes are not requests: an upgraded connection, or invalid data.
    Lost,
}

/// A place in a body of chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::daemon) enum Chunk {
    /// The digits of a chunk's size so far.
    Size(u64),
    /// The rest of the line with this size.
    Line(u64),
    /// This many bytes of a chunk, with its line end.
    Data(u64),
    /// The lines after the last chunk; whether this one has bytes.
    Trailer(bool),
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Framer {
    part: Part,
    /// The incomplete head of the current request.
    head: Vec<u8>,
    /// The number of requests with complete heads.
    heads: u64,
}

impl Framer {
    pub(in crate::daemon) const fn new() -> Self {
        Self { part: Part::Head, head: Vec::new(), heads: 0 }
    }

    /// Takes the next bytes; calls `see` with each head that they complete, and its number from 0 on.
    pub(in crate::daemon) fn take(&mut self, mut bytes: &[u8], mut see: impl FnMut(u64, &[u8])) {
        while let Some(&byte) = bytes.first() {
            let used = match self.part {
                Part::Head => self.take_head(bytes, &mut see),
                Part::Body(left) => {
                    let used = bytes.len().min(usize::try_from(left).unwrap_or(usize::MAX));
                    self.part = body(left - used as u64);
                    used
                }
                Part::Chunks(Chunk::Data(left)) if left > 0 => {
                    let used = bytes.len().min(usize::try_from(left).unwrap_or(usize::MAX));
                    self.part = Part::Chunks(Chunk::Data(left - used as u64));
                    used
                }
                Part::Chunks(chunk) => {
                    let (part, used) = chunk.take(byte);
                    self.part = part;
                    used
                }
                Part::Lost => bytes.len(),
            };
            bytes = &bytes[used..];
        }
    }

    /// The number of the current request, and its incomplete head; empty between two requests.
    pub(in crate::daemon) fn begun(&self) -> (u64, &[u8]) {
        (self.heads, &self.head)
    }

    /// Whether a request is incomplete.
    pub(in crate::daemon) fn is_within(&self) -> bool {
        match self.part {
            Part::Head => !self.head.is_empty(),
            Part::Body(_) | Part::Chunks(_) => true,
            Part::Lost => false,
        }
    }

    /// Whether a request's head is incomplete.
    pub(in crate::daemon) fn is_within_head(&self) -> bool {
        self.part == Part::Head && !self.head.is_empty()
    }

    /// Takes bytes up to the next line end; returns how many.
    fn take_head(&mut self, bytes: &[u8], see: &mut impl FnMut(u64, &[u8])) -> usize {
        // HTTP allows empty lines before a request.
        if self.head.is_empty() && matches!(bytes[0], b'\r' | b'\n') {
            return 1;
        }
        let line = bytes.iter().position(|&byte| byte == b'\n');
        let used = line.map_or(bytes.len(), |end| end + 1);
        self.head.extend_from_slice(&bytes[..used]);
        if line.is_some() && (self.head.ends_with(b"\n\r\n") || self.head.ends_with(b"\n\n")) {
            self.part = after(&self.head);
            if self.part != Part::Lost {
                see(self.heads, &self.head);
                self.heads += 1;
            }
            self.head = Vec::new();
        } else if self.head.len() > MAX_HEAD {
            (self.part, self.head) = (Part::Lost, Vec::new());
        }
        used
    }
}

impl Chunk {
    /// What follows after this byte, and whether it was used.
    fn take(self, byte: u8) -> (Part, usize) {
        let next = match (self, byte) {
            (Self::Size(0) | Self::Line(0), b'\n') => Self::Trailer(false),
            (Self::Size(size) | Self::Line(size), b'\n') => Self::Data(size),
            (Self::Size(size), _) => match char::from(byte).to_digit(16) {
                Some(digit) => match size.checked_mul(16) {
                    Some(size) => Self::Size(size + u64::from(digit)),
                    None => return (Part::Lost, 1),
                },
                None if matches!(byte, b'\r' | b' ' | b'\t' | b';') => Self::Line(size),
                None => return (Part::Lost, 1),
            },
            (Self::Line(size), _) => Self::Line(size),
            // The line end after the bytes of a chunk.
            (Self::Data(_), b'\r') => self,
            (Self::Data(_), b'\n') => Self::Size(0),
            (Self::Data(_), _) => return (Part::Lost, 1),
            (Self::Trailer(false), b'\n') => return (Part::Head, 1),
            (Self::Trailer(_), b'\n') => Self::Trailer(false),
            (Self::Trailer(has), b'\r') => Self::Trailer(has),
            (Self::Trailer(_), _) => Self::Trailer(true),
        };
        (Part::Chunks(next), 1)
    }
}

const fn body(length: u64) -> Part {
    if length == 0 { Part::Head } else { Part::Body(length) }
}

/// What follows after this complete head.
fn after(head: &[u8]) -> Part {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => body_of(&request).unwrap_or(Part::Lost),
        _ => Part::Lost,
    }
}

/// The body of a request with these headers; none where hyper refuses the request.
pub(in crate::daemon) fn body_of(request: &httparse::Request<'_, '_>) -> Option<Part> {
    let (mut length, mut is_chunked) = (None, None);
    for header in &*request.headers {
        if header.name.eq_ignore_ascii_case("transfer-encoding") {
            let last = header.value.rsplit(|&byte| byte == b',').next().unwrap_or_default();
            is_chunked = Some(last.trim_ascii().eq_ignore_ascii_case(b"chunked"));
        } else if header.name.eq_ignore_ascii_case("content-length") && is_chunked.is_none() {
            let digits = Some(header.value).filter(|value| value.iter().all(u8::is_ascii_digit));
            let value = std::str::from_utf8(digits?).ok()?.parse::<u64>().ok()?;
            if length.replace(value).is_some_and(|before| before != value) {
                return None;
            }
        }
    }
    match is_chunked {
        Some(true) => Some(Part::Chunks(Chunk::Size(0))),
        Some(false) => None,
        None => Some(body(length.unwrap_or(0))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first lines of the requests that are found, whole and byte by byte.
    fn requests(bytes: &str) -> (Vec<String>, bool) {
        let found = |pieces: &mut dyn Iterator<Item = &[u8]>| {
            let (mut framer, mut lines) = (Framer::new(), Vec::new());
            for piece in pieces {
                framer.take(piece, |number, head| {
                    assert_eq!(number, lines.len() as u64);
                    let line = head.split(|&byte| byte == b'\r' || byte == b'\n').next().unwrap();
                    lines.push(String::from_utf8(line.to_vec()).unwrap());
                });
            }
            (lines, framer.is_within())
        };
        let whole = found(&mut std::iter::once(bytes.as_bytes()));
        assert_eq!(whole, found(&mut bytes.as_bytes().chunks(1)), "{bytes:?}");
        whole
    }

    const STOP: &str = "POST /v1/estop HTTP/1.1\r\nhost: x\r\n\r\n";

    #[test]
    fn a_request_behind_others_is_found_at_its_first_byte_and_only_there() {
        let post = |headers: &str, body: &str| format!("POST /v1/stop HTTP/1.1\r\n{headers}\r\n{body}{STOP}");
        let chunks = format!("{:x};x=\"y\"\r\n{STOP}\r\n3\r\nabc\r\n0\r\n", STOP.len());
        for before in [
            post("", ""),
            post("host: x\r\n", "\r\n\n"),
            post(&format!("content-length: {}\r\n", STOP.len()), STOP),
            post(&format!("Content-Length: {0}\r\ncontent-length: {0}\r\n", STOP.len()), STOP),
            post("transfer-encoding: gzip, Chunked\r\n", &format!("{chunks}\r\n")),
            post(
                "transfer-encoding: chunked\r\ncontent-length: 5\r\n",
                &format!("{chunks}trailer: {}\r\n\r\n", "y"),
            ),
            post("content-length: 5\r\ntransfer-encoding: chunked\r\n", "0\r\n\r\n"),
        ] {
            let (found, within) = requests(&before);
            assert_eq!(found, ["POST /v1/stop HTTP/1.1", "POST /v1/estop HTTP/1.1"], "{before:?}");
            assert!(!within);
        }
    }

    #[test]
    fn what_hyper_refuses_ends_the_framing() {
        for bad in [
            "content-length: 1\r\ncontent-length: 2\r\n",
            "content-length: +0\r\n",
            "content-length: 99999999999999999999\r\n",
            "transfer-encoding: chunked, gzip\r\n",
            "no header\r\n",
        ] {
            let (found, within) = requests(&format!("GET / HTTP/1.1\r\n{bad}\r\n{STOP}"));
            assert!(found.is_empty() && !within, "{bad:?}: {found:?}");
        }
        let long = format!("GET / HTTP/1.1\r\nx: {}\r\n\r\n{STOP}", "y".repeat(MAX_HEAD));
        assert!(requests(&long).0.is_empty());
        let sizes = ["fffffffffffffffff", "x"]
            .map(|size| format!("POST / HTTP/1.1\r\ntransfer-encoding: chunked\r\n\r\n{size}\r\n{STOP}"));
        for bytes in sizes {
            assert_eq!(requests(&bytes).0.len(), 1);
        }
        assert!(requests("\u{81}{}\n\n").0.is_empty(), "a frame of an upgraded connection");
    }

    #[test]
    fn a_request_that_is_not_complete_is_known() {
        assert!(!requests("\r\n").1);
        for part in ["G", "GET / HTTP/1.1\r\n", "PUT / HTTP/1.1\r\ncontent-length: 2\r\n\r\n{"] {
            assert!(requests(part).1, "{part:?}");
        }
    }
}
