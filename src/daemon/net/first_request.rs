//! Recognises from the first bytes of a connection whether its request is an emergency stop, a command with reserved places, or
//! another.

use crate::daemon::net::framing::{MAX_HEADERS, Part, body_of};
use crate::daemon::net::gate::Gate;
use crate::daemon::net::head::Head;
use crate::record::{NetworkPeer, Peer};
use httparse::{EMPTY_HEADER, Request, Status};

/// Most bytes of a request line that are examined, with empty lines before it. The API's addresses are shorter.
pub(in crate::daemon) const MAX_LINE: usize = 512;
/// Requests with reserved places besides emergency stops, so that a flood of others does not keep them out. Each is answered at
/// once.
const PROMPT: [(&str, &str); 2] = [("POST", "/v1/stop"), ("POST", "/v1/disarm")];

/// The first request of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::daemon) struct First {
    pub(in crate::daemon) kind: Kind,
    /// The gate admits it, and it needs more than the page's files do.
    pub(in crate::daemon) is_known: bool,
}

/// The kind of a request, which decides the places that it may take. Each kind has places that those before it cannot take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::daemon) enum Kind {
    /// Its body is still to come.
    Part,
    Other,
    /// A request of [`PROMPT`] that has come completely.
    Prompt,
    EStop,
}

impl First {
    /// A request that the server decides about.
    pub(in crate::daemon) const fn other(is_known: bool) -> Self {
        Self { kind: Kind::Other, is_known }
    }
}

/// The first request of this client, which begins with these bytes; `None` if more bytes are needed.
pub(in crate::daemon) fn first(all: &[u8], peer: Peer, gate: &Gate) -> Option<First> {
    if is_estop_request(all, peer, gate) == Some(true) {
        return Some(First { kind: Kind::EStop, is_known: true });
    }
    let mut headers = [EMPTY_HEADER; MAX_HEADERS];
    let mut request = Request::new(&mut headers);
    let length = match request.parse(all) {
        Ok(Status::Partial) => return None,
        Ok(Status::Complete(length)) => length,
        Err(_) => return Some(First::other(peer.network.is_none())),
    };
    let is_known = peer.network.is_none_or(|client| is_let_in(&request, client, gate));
    let target = request.path.unwrap_or_default();
    let target = target.split(['?', '#']).next().unwrap_or_default();
    let is_prompt = is_known && PROMPT.contains(&(request.method.unwrap_or_default(), target));
    if !is_prompt {
        let is_whole = match body_of(&request) {
            Some(Part::Body(left)) => left <= (all.len() - length) as u64,
            Some(Part::Chunks(_)) => false,
            _ => true,
        };
        return Some(First { kind: if is_whole { Kind::Other } else { Kind::Part }, is_known });
    }
    // A client that sent `Expect: 100-continue` sends its body when the server says so.
    if request.headers.iter().any(|header| header.name.eq_ignore_ascii_case("expect")) {
        return Some(First::other(is_known));
    }
    match body_of(&request) {
        Some(Part::Head) => Some(First { kind: Kind::Prompt, is_known }),
        // A request with its whole body is answered at once.
        Some(Part::Body(left)) if left > (all.len() - length) as u64 => None,
        Some(Part::Body(_)) => Some(First { kind: Kind::Prompt, is_known }),
        _ => Some(First::other(is_known)),
    }
}

/// Whether the request that begins with these bytes is an emergency stop of a client that may order it; `None` if more bytes are needed.
pub(in crate::daemon) fn is_estop_request(all: &[u8], peer: Peer, gate: &Gate) -> Option<bool> {
    match (is_estop(all), peer.network) {
        (Some(true), Some(client)) => check(all, client, gate),
        (is_estop, _) => is_estop,
    }
}

/// Whether the gate admits a request for more than a file of the page.
fn is_let_in(request: &Request<'_, '_>, client: NetworkPeer, gate: &Gate) -> bool {
    let path = request.path.unwrap_or_default();
    path.starts_with("/v1/") && gate.check(Peer::network(client), &head(request)).is_ok()
}

fn head<'a>(request: &Request<'_, 'a>) -> Head<'a> {
    let method = request.method.unwrap_or_default();
    let mut head = Head { method, path: request.path.unwrap_or_default(), ..Head::default() };
    for header in &*request.headers {
        head.add(header.name, header.value);
    }
    head
}

/// Whether a request that begins with these bytes is an emergency stop; `None` if more bytes are needed.
fn is_estop(all: &[u8]) -> Option<bool> {
    is_post(all, b"/v1/estop")
}

/// Whether a request that begins with these bytes is a `POST` to this path; `None` if more bytes are needed.
pub(in crate::daemon) fn is_post(all: &[u8], to: &[u8]) -> Option<bool> {
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
        Some(end) => Some(path(&target[..end]) == to),
        None => (all.len() >= MAX_LINE).then_some(false),
    }
}

/// Whether the gate lets a network client order the emergency stop that begins with these bytes; `None` if more bytes are needed. If it
/// does not, the server checks the request again and answers it.
fn check(all: &[u8], client: NetworkPeer, gate: &Gate) -> Option<bool> {
    let mut headers = [EMPTY_HEADER; MAX_HEADERS];
    let mut request = Request::new(&mut headers);
    match request.parse(all) {
        Ok(Status::Partial) => None,
        // Only the server compares a host in the address with the `Host` header.
        Ok(Status::Complete(_)) => Some(
            request.path.is_some_and(|path| path.starts_with('/'))
                && gate.check(Peer::network(client), &head(&request)).is_ok(),
        ),
        Err(_) => Some(false),
    }
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
