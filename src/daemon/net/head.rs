//! The head of a request as the gate sees it: its origin, and the tokens and name that it shows.
//!
//! A client may show an access token (`Authorization: Bearer mst_...`), a session token (in the same header, or in
//! `Meissner-Session`), and a name for itself (`Meissner-Client`). [`Head::shown`] distinguishes them by their form, in one place
//! for all routes and sockets.
//!
//! Invariant: a value that has none of these forms is refused, and never ignored. Nothing here uses the heap, because the
//! real-time thread for emergency stops reads heads.

use crate::daemon::net::refusal::{MALFORMED, Refusal};
use meissner_api::{CLIENT_HEADER, Code, SESSION_HEADER, TOKEN_PREFIX};

/// Hexadecimal digits of a session's token.
const SESSION_TOKEN: usize = 32;
/// Characters of a client's name at most.
const MAX_CLIENT: usize = 64;

/// The parts of a request that the gate checks. A header that occurs twice counts as malformed.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::daemon) struct Head<'a> {
    pub(in crate::daemon) method: &'a str,
    pub(in crate::daemon) path: &'a str,
    pub(in crate::daemon) host: Option<&'a str>,
    pub(in crate::daemon) origin: Option<&'a str>,
    pub(in crate::daemon) fetch_site: Option<&'a str>,
    pub(in crate::daemon) authorization: Option<&'a str>,
    pub(in crate::daemon) session: Option<&'a str>,
    pub(in crate::daemon) client: Option<&'a str>,
    /// Whether a proxy has passed the request on, so that the client's machine is not known.
    pub(in crate::daemon) forwarded: bool,
    /// Whether one of these headers occurs twice or is not plain text.
    pub(in crate::daemon) malformed: bool,
}

/// The tokens and the name that a request shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::daemon) struct Shown<'a> {
    /// An access token.
    pub(in crate::daemon) access: Option<&'a str>,
    /// The token of a session.
    pub(in crate::daemon) session: Option<&'a str>,
    /// The name that the client has given itself.
    pub(in crate::daemon) client: Option<&'a str>,
}

impl<'a> Head<'a> {
    /// Takes one header of the request.
    pub(in crate::daemon) fn add(&mut self, name: &str, value: &'a [u8]) {
        let is = |known: &str| name.eq_ignore_ascii_case(known);
        let begins =
            |start: &str| name.get(..start.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(start));
        let of_proxies =
            ["forwarded", "via", "x-real-ip", "x-client-ip", "true-client-ip", "cf-connecting-ip"];
        if begins("x-forwarded") || of_proxies.into_iter().any(is) {
            self.forwarded = true;
        }
        let places = [
            ("host", &mut self.host),
            ("origin", &mut self.origin),
            ("sec-fetch-site", &mut self.fetch_site),
            ("authorization", &mut self.authorization),
            (SESSION_HEADER, &mut self.session),
            (CLIENT_HEADER, &mut self.client),
        ];
        let Some((_, place)) = places.into_iter().find(|(known, _)| is(known)) else { return };
        match std::str::from_utf8(value) {
            Ok(value) if place.is_none() => *place = Some(value),
            _ => self.malformed = true,
        }
    }

    /// Takes the host in the request's address. The request is malformed if the header names another.
    pub(in crate::daemon) fn compare_authority(&mut self, authority: &str) {
        self.malformed |= !self.host.is_some_and(|host| host.eq_ignore_ascii_case(authority));
    }

    /// The tokens and the name that it shows.
    pub(in crate::daemon) fn shown(&self) -> Result<Shown<'a>, Refusal> {
        if self.malformed {
            return Err(MALFORMED);
        }
        let (access, session) = match self.authorization.map(bearer) {
            None => (None, self.session),
            Some(Some(token)) if token.starts_with(TOKEN_PREFIX) => (Some(token), self.session),
            Some(Some(token)) if is_session_token(token) => {
                if self.session.is_some_and(|session| session != token) {
                    let detail =
                        "`Authorization` and `Meissner-Session` show tokens of two sessions: send one";
                    return Err(Refusal(Code::BadRequest, detail));
                }
                (None, Some(token))
            }
            Some(_) => {
                let detail = "the `Authorization` header shows neither an access token nor a session's token: send `Bearer TOKEN`, or leave \
                              the header out";
                return Err(Refusal(Code::Unauthorized, detail));
            }
        };
        if !self.client.is_none_or(is_client_name) {
            let detail = "`Meissner-Client` must be 1 to 64 of A-Z, a-z, 0-9, _ and -: choose such a name";
            return Err(Refusal(Code::BadRequest, detail));
        }
        Ok(Shown { access, session, client: self.client })
    }
}

/// The token of an `Authorization` header.
fn bearer(value: &str) -> Option<&str> {
    let (scheme, token) = value.trim_ascii().split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token.trim_ascii_start())
}

fn is_session_token(token: &str) -> bool {
    token.len() == SESSION_TOKEN && token.bytes().all(|byte| byte.is_ascii_hexdigit())
}

fn is_client_name(name: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-');
    (1..=MAX_CLIENT).contains(&name.len()) && name.bytes().all(plain)
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::Problem;

    fn shown<'a>(headers: &[(&str, &'a str)]) -> Result<Shown<'a>, String> {
        let mut head = Head::default();
        for (name, value) in headers {
            head.add(name, value.as_bytes());
        }
        head.shown().map_err(|refusal| Problem::from(refusal).code)
    }

    #[test]
    fn what_is_shown_is_understood_or_refused() {
        const SESSION: &str = "b1946ac92492d2347c6235b4d2611184";
        let both =
            [("Authorization", "Bearer mst_1"), ("Meissner-Session", SESSION), ("meissner-client", "a_B-9")];
        let all = Shown { access: Some("mst_1"), session: Some(SESSION), client: Some("a_B-9") };
        assert_eq!(shown(&both), Ok(all));
        for value in
            [&format!("Bearer {SESSION}"), &format!("bearer  {SESSION}"), &format!("BEARER {SESSION} ")]
        {
            let of_session = Shown { session: Some(SESSION), ..Shown::default() };
            assert_eq!(shown(&[("authorization", value)]), Ok(of_session), "{value}");
            assert_eq!(shown(&[("authorization", value), ("Meissner-Session", SESSION)]), Ok(of_session));
            let other = [("authorization", value.as_str()), ("Meissner-Session", "x")];
            assert_eq!(shown(&other), Err("bad-request".to_owned()));
        }
        for value in [
            "",
            "Bearer",
            "Bearer ",
            "Basic dTpw",
            "mst_1",
            SESSION,
            "Bearer x",
            "Bearer\tmst_1",
            "Digest a=b",
        ] {
            assert_eq!(shown(&[("Authorization", value)]), Err("unauthorized".to_owned()), "{value}");
        }
        for (name, value) in
            [("Meissner-Client", ""), ("Meissner-Client", "a b"), ("Meissner-Client", &"x".repeat(65))]
        {
            assert_eq!(shown(&[(name, value)]), Err("bad-request".to_owned()), "{value}");
        }
        for twice in ["Authorization", "Meissner-Session", "Meissner-Client"] {
            assert_eq!(shown(&[(twice, "x"), (twice, "x")]), Err("bad-request".to_owned()), "{twice}");
        }
    }
}
