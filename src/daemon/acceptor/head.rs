//! Recognises an emergency stop by the first line of an HTTP request, and over the network checks its headers.

use crate::daemon::network::{Gate, Head};
use crate::session_record::{NetworkPeer, Peer};

/// Length of a request line that is looked at, at most, bytes, with empty lines before it. The API's addresses are shorter.
pub(super) const MAX_LINE: usize = 512;
/// Headers of a request that the acceptor looks at, at most; the server takes requests with more.
const MAX_HEADERS: usize = 64;

/// Whether a request that begins with these bytes is an emergency stop; `None` if more bytes are needed.
pub(super) fn is_estop(all: &[u8]) -> Option<bool> {
    const METHOD: &[u8] = b"POST ";
    // HTTP allows empty lines before a request.
    let head = &all[all.iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count()..];
    if all.len() >= MAX_LINE && head.len() < METHOD.len() {
        return Some(false);
    }
    let Some(target) = head.strip_prefix(METHOD) else {
        return (!METHOD.starts_with(head)).then_some(false);
    };
    match target.iter().position(|byte| matches!(byte, b' ' | b'?' | b'#' | b'\r' | b'\n')) {
        Some(end) => Some(path(&target[..end]) == b"/v1/estop"),
        None => (all.len() >= MAX_LINE).then_some(false),
    }
}

/// Whether the gate lets a network client order the emergency stop that begins with these bytes; `None` if more bytes are needed. If it
/// does not, the server checks the request again and answers it.
pub(super) fn check(all: &[u8], client: NetworkPeer, gate: &Gate) -> Option<bool> {
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(all) {
        Ok(httparse::Status::Partial) => return None,
        Ok(httparse::Status::Complete(_)) => {}
        Err(_) => return Some(false),
    }
    let path = request.path.unwrap_or_default();
    let mut head = Head { method: request.method.unwrap_or_default(), path, ..Head::default() };
    for header in &*request.headers {
        head.add(header.name, header.value);
    }
    // The server alone compares a host in the address with the `Host` header.
    Some(path.starts_with('/') && gate.check(Peer::network(client), &head).is_ok())
}

/// The path of a request's target, which may begin with a scheme and a host.
fn path(target: &[u8]) -> &[u8] {
    let Some(rest) = target.strip_prefix(b"http://") else { return target };
    rest.iter().position(|&byte| byte == b'/').map_or(b"", |at| &rest[at..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_emergency_stop_is_recognised_as_soon_as_its_address_is_complete() {
        for line in [
            "POST /v1/estop HTTP/1.1\r\n",
            "\r\nPOST /v1/estop?x HTTP/1.0\r\n",
            "POST http://localhost/v1/estop HTTP/1.1\r\n",
        ] {
            let end = line.find("estop").unwrap() + "estop".len();
            for len in 0..line.len() {
                let expected = (len > end).then_some(true);
                assert_eq!(is_estop(&line.as_bytes()[..len]), expected, "{:?}", &line[..len]);
            }
        }
    }

    #[test]
    fn other_requests_are_none() {
        for line in [
            "GET /v1/estop HTTP/1.1\r\n",
            "POST /v1/estopp HTTP/1.1\r\n",
            "POST /v1/stop HTTP/1.1\r\n",
            "POST http://localhost HTTP/1.1\r\n",
            "PUT ",
            "post /v1/estop ",
            "\u{1}",
        ] {
            assert_eq!(is_estop(line.as_bytes()), Some(false), "{line:?}");
        }
        assert_eq!(is_estop(&[b'\n'; MAX_LINE]), Some(false), "empty lines without end");
        assert_eq!(is_estop(&[b"POST /", "x".repeat(MAX_LINE).as_bytes()].concat()), Some(false));
    }
}
