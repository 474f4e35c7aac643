//! Which requests over the network may pass: by host, origin, token and role.
//!
//! A page of another site can make a browser send requests. The `Host` header shows a name that was made to point here (DNS
//! rebinding), and `Origin` and `Sec-Fetch-Site` show that another site's page has sent the request. So both are checked first. Then
//! the request needs a token whose role allows it, unless it comes from this machine and the configuration asks for none.
//!
//! Invariant: [`Gate::check`] waits for nothing and uses no heap unless it refuses: the acceptor's real-time thread calls it.

use super::tokens::TokenStore;
use crate::config::Listen;
use crate::daemon::page;
use crate::session_record::NetworkPeer;
use meissner_api::{Code, NetworkStatus, Problem, Role};
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::{AtomicU64, Ordering};

/// What the gate looks at of a request. A header that occurs twice counts as malformed.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::daemon) struct Head<'a> {
    pub(in crate::daemon) method: &'a str,
    pub(in crate::daemon) path: &'a str,
    pub(in crate::daemon) host: Option<&'a str>,
    pub(in crate::daemon) origin: Option<&'a str>,
    pub(in crate::daemon) fetch_site: Option<&'a str>,
    pub(in crate::daemon) authorization: Option<&'a str>,
    /// A proxy has passed the request on, so the client's machine is not known.
    pub(in crate::daemon) forwarded: bool,
    /// One of these headers occurs twice or is not plain text.
    pub(in crate::daemon) malformed: bool,
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
        let place = if is("host") {
            &mut self.host
        } else if is("origin") {
            &mut self.origin
        } else if is("sec-fetch-site") {
            &mut self.fetch_site
        } else if is("authorization") {
            &mut self.authorization
        } else {
            return;
        };
        match std::str::from_utf8(value) {
            Ok(value) if place.is_none() => *place = Some(value),
            _ => self.malformed = true,
        }
    }

    /// Takes the host in the request's address. The request is malformed if the header names another.
    pub(in crate::daemon) fn compare_authority(&mut self, authority: &str) {
        self.malformed |= !self.host.is_some_and(|host| host.eq_ignore_ascii_case(authority));
    }

    fn token(&self) -> Option<&'a str> {
        let (scheme, token) = self.authorization?.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then_some(token)
    }

    /// What a client needs for this request.
    fn needs(&self) -> Needs {
        let reads = matches!(self.method, "GET" | "HEAD");
        if page::is_file(self.method, self.path) {
            Needs::Nothing
        } else if self.path == "/v1/tokens" || self.path.starts_with("/v1/tokens/") {
            Needs::Local
        } else if reads {
            Needs::Role(Role::Observe)
        } else {
            Needs::Role(Role::Operate)
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Needs {
    /// The page itself: it asks for the token.
    Nothing,
    /// The Unix socket.
    Local,
    Role(Role),
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Gate {
    listen: Option<Listen>,
    /// Why the daemon does not listen there.
    problem: Option<String>,
    pub(in crate::daemon) tokens: TokenStore,
    denied: AtomicU64,
}

impl Gate {
    /// The gate of a daemon that listens there, or has this problem.
    pub(in crate::daemon) const fn new(
        listen: Option<Listen>,
        problem: Option<String>,
        tokens: TokenStore,
    ) -> Self {
        Self { listen, problem, tokens, denied: AtomicU64::new(0) }
    }

    /// Who can reach the daemon; none if nothing listens.
    pub(in crate::daemon) fn status(&self) -> Option<NetworkStatus> {
        let listen = self.listen.as_ref()?;
        let tokens = self.tokens.list();
        let count = |role| tokens.iter().filter(|token| token.role == role).map(|_| 1).sum();
        Some(NetworkStatus {
            address: listen.address.to_string(),
            loopback_without_token: !listen.always_token,
            observe_tokens: count(Role::Observe),
            operate_tokens: count(Role::Operate),
            denied: self.denied(),
            problem: self.problem.clone(),
        })
    }

    /// Requests that were refused.
    pub(in crate::daemon) fn denied(&self) -> u64 {
        self.denied.load(Ordering::Relaxed)
    }

    /// Counts a refusal.
    pub(super) fn count_denied(&self) {
        self.denied.fetch_add(1, Ordering::Relaxed);
    }

    /// Decides about a request of this network client; returns the client with the id of its token.
    pub(in crate::daemon) fn check(
        &self,
        client: NetworkPeer,
        head: &Head<'_>,
    ) -> Result<NetworkPeer, Refusal> {
        let Some(listen) = &self.listen else {
            return Err(Refusal(Code::Forbidden, "the daemon does not serve the network"));
        };
        if head.malformed {
            let detail =
                "a header occurs twice, is not plain text, or the address names another host: send it once";
            return Err(Refusal(Code::BadRequest, detail));
        }
        if !head.host.is_some_and(|host| is_known(host, &listen.hosts)) {
            let detail = "the `Host` header names another host: use this machine's address, or add the name to `listen_hosts`";
            return Err(Refusal(Code::Forbidden, detail));
        }
        check_site(head)?;
        let role = match head.needs() {
            Needs::Local => {
                let detail = "tokens are created and revoked on the daemon's machine: `meissner token`";
                return Err(Refusal(Code::Forbidden, detail));
            }
            Needs::Nothing => return Ok(client),
            Needs::Role(role) => role,
        };
        match head.token().and_then(|token| self.tokens.find(token)) {
            Some((token, has)) if has == Role::Operate || role == Role::Observe => {
                Ok(NetworkPeer { token: Some(token), ..client })
            }
            Some(_) => {
                Err(Refusal(Code::Forbidden, "the token may only read: use one with the role `operate`"))
            }
            None if client.address.is_loopback() && !head.forwarded && !listen.always_token => Ok(client),
            None => {
                let detail = "send a valid token in the `Authorization: Bearer` header: `meissner token create` on the daemon's machine makes one";
                Err(Refusal(Code::Unauthorized, detail))
            }
        }
    }

    /// Decides about a request on the Unix socket. `ssh -L` makes the socket a port of another machine, where a browser may reach it; so
    /// the gate refuses pages of other sites here, too. A host name with a dot may have been made to point to that port.
    pub(in crate::daemon) fn check_local(&self, head: &Head<'_>) -> Result<(), Refusal> {
        let hosts = self.listen.as_ref().map_or(&[][..], |listen| &listen.hosts);
        let is_public = head.host.is_some_and(|host| host.contains('.') && !is_known(host, hosts));
        if is_public {
            let detail = "the `Host` header names another host: use `localhost`";
            return Err(Refusal(Code::Forbidden, detail));
        }
        check_site(head)
    }
}

/// Why a request is refused. The acceptor drops it unread, so it costs no heap.
#[derive(Clone, Copy, Debug)]
pub(in crate::daemon) struct Refusal(Code, &'static str);

impl From<Refusal> for Problem {
    fn from(Refusal(code, detail): Refusal) -> Self {
        Self::new(code, detail)
    }
}

/// Refuses what a page of another site has sent.
fn check_site(head: &Head<'_>) -> Result<(), Refusal> {
    let same_origin = head.origin.is_none_or(|origin| is_same_origin(origin, head.host));
    // A link on another site may lead to the page.
    let same_site = head.needs() == Needs::Nothing
        || head.fetch_site.is_none_or(|site| matches!(site, "same-origin" | "none"));
    if same_origin && same_site {
        return Ok(());
    }
    Err(Refusal(Code::Forbidden, "a page of another site has sent this request: use the daemon's own page"))
}

/// Whether a `Host` header names this machine: by an address, as `localhost`, or by a configured name. The port does not matter.
fn is_known(host: &str, names: &[String]) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.contains(']') => {
            if port.is_empty() || !port.bytes().all(|byte| byte.is_ascii_digit()) {
                return false;
            }
            name
        }
        _ => host,
    };
    if let Some(address) = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
        return address.parse::<Ipv6Addr>().is_ok();
    }
    let name = name.strip_suffix('.').unwrap_or(name);
    name.parse::<IpAddr>().is_ok_and(|address| address.is_ipv4())
        || name.eq_ignore_ascii_case("localhost")
        || names.iter().any(|known| known.eq_ignore_ascii_case(name))
}

/// Whether a request's origin is the host that it goes to.
fn is_same_origin(origin: &str, host: Option<&str>) -> bool {
    let from = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    from.zip(host).is_some_and(|(from, host)| from.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOCAL: NetworkPeer =
        NetworkPeer { address: IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), token: None };

    fn far() -> NetworkPeer {
        NetworkPeer { address: [192, 168, 1, 7].into(), token: None }
    }

    fn gate(always_token: bool) -> (Gate, [String; 2]) {
        let tokens = TokenStore::open(None);
        let of = |role| tokens.create(role, "a test").unwrap().token;
        let made = [of(Role::Observe), of(Role::Operate)];
        let address = "0.0.0.0:8765".parse().unwrap();
        let listen = Listen { address, hosts: vec!["lab-pc.example".to_owned()], always_token };
        (Gate::new(Some(listen), None, tokens), made)
    }

    fn head<'a>(method: &'a str, headers: &'a [(&str, &str)]) -> Head<'a> {
        let mut head = Head { method, path: "/v1/play", ..Head::default() };
        if !headers.iter().any(|(name, _)| *name == "Host") {
            head.add("Host", b"127.0.0.1:8765");
        }
        for (name, value) in headers {
            head.add(name, value.as_bytes());
        }
        head
    }

    fn code(gate: &Gate, client: NetworkPeer, head: &Head<'_>) -> String {
        gate.check(client, head).map_or_else(|refusal| Problem::from(refusal).code, |_| "ok".to_owned())
    }

    #[test]
    fn hosts_are_addresses_and_names_that_are_known() {
        let names = ["lab-pc.example".to_owned()];
        for good in [
            "localhost",
            "LOCALHOST:1",
            "127.0.0.1:8765",
            "10.0.0.7",
            "[::1]:8765",
            "[fe80::1]",
            "Lab-PC.example.:80",
        ] {
            assert!(is_known(good, &names), "{good}");
        }
        for bad in [
            "",
            "evil.example",
            "localhost.evil.example",
            "lab-pc",
            "127.0.0.1:",
            "127.0.0.1:80x",
            "[localhost]",
            "::1",
            "[::1",
        ] {
            assert!(!is_known(bad, &names), "{bad}");
        }
    }

    #[test]
    fn a_page_of_another_site_gets_nothing() {
        let (gate, [_, operate]) = gate(false);
        let bearer = format!("Bearer {operate}");
        let is = |expected: &str, headers: &[(&str, &str)]| {
            for client in [LOCAL, far()] {
                let mut all = vec![("Authorization", bearer.as_str())];
                all.extend(headers);
                assert_eq!(code(&gate, client, &head("POST", &all)), expected, "{headers:?}");
            }
        };
        is("ok", &[]);
        is("ok", &[("Origin", "http://127.0.0.1:8765"), ("Sec-Fetch-Site", "same-origin")]);
        is("ok", &[("Host", "lab-pc.example"), ("Origin", "https://LAB-PC.example")]);
        is("forbidden", &[("Origin", "http://evil.example")]);
        is("forbidden", &[("Origin", "http://127.0.0.1:8766")]);
        is("forbidden", &[("Origin", "null")]);
        is("forbidden", &[("Sec-Fetch-Site", "cross-site")]);
        is("forbidden", &[("Sec-Fetch-Site", "same-site")]);
        is("forbidden", &[("Host", "evil.example"), ("Origin", "http://evil.example")]);
        is("bad-request", &[("Origin", "http://127.0.0.1:8765"), ("origin", "http://evil.example")]);
        assert_eq!(
            code(&gate, LOCAL, &Head { method: "GET", path: "/v1/status", ..Head::default() }),
            "forbidden"
        );
    }

    #[test]
    fn a_token_opens_what_its_role_allows() {
        let (gate, [observe, operate]) = gate(false);
        let with = |client, method, token: &str| {
            let bearer = format!("Bearer {token}");
            code(&gate, client, &head(method, &[("Authorization", &bearer)]))
        };
        assert_eq!([with(far(), "GET", &observe), with(far(), "POST", &observe)], ["ok", "forbidden"]);
        assert_eq!([with(far(), "GET", &operate), with(far(), "POST", &operate)], ["ok", "ok"]);
        assert_eq!(with(LOCAL, "POST", &observe), "forbidden", "a token counts also where none is needed");
        let longer = format!("{operate}0");
        for wrong in [
            "",
            "mst_",
            "mst_00",
            &observe[4..],
            &operate[..operate.len() - 1],
            &longer,
            &operate.to_uppercase(),
        ] {
            assert_eq!(with(far(), "GET", wrong), "unauthorized", "{wrong}");
        }
        let id = gate
            .check(far(), &head("GET", &[("Authorization", &format!("Bearer {observe}"))]))
            .unwrap()
            .token;
        gate.tokens.revoke(&id.unwrap().to_string()).unwrap();
        assert_eq!(with(far(), "GET", &observe), "unauthorized");
        assert_eq!(with(far(), "GET", &operate), "ok");
    }

    #[test]
    fn this_machine_needs_no_token_unless_a_proxy_or_the_configuration_says_so() {
        let (open, _) = gate(false);
        assert_eq!(code(&open, LOCAL, &head("POST", &[])), "ok");
        assert_eq!(code(&open, far(), &head("GET", &[])), "unauthorized");
        for proxy in ["Forwarded", "X-Forwarded-For", "x-forwarded-proto", "X-Real-IP", "Via"] {
            assert_eq!(
                code(&open, LOCAL, &head("GET", &[(proxy, "192.168.1.7")])),
                "unauthorized",
                "{proxy}"
            );
        }
        let (strict, [_, operate]) = gate(true);
        assert_eq!(code(&strict, LOCAL, &head("GET", &[])), "unauthorized");
        assert_eq!(
            code(&strict, LOCAL, &head("POST", &[("Authorization", &format!("Bearer {operate}"))])),
            "ok"
        );
    }

    #[test]
    fn a_page_of_another_site_gets_nothing_through_a_forwarded_socket_either() {
        let (gate, _) = gate(false);
        let is_let_in = |headers: &[(&str, &str)]| gate.check_local(&head("POST", headers)).is_ok();
        for good in ["localhost:9000", "m", "localhost", "127.0.0.1:9000", "lab-pc.example"] {
            assert!(is_let_in(&[("Host", good)]), "{good}");
        }
        assert!(gate.check_local(&Head { method: "POST", path: "/v1/arm", ..Head::default() }).is_ok());
        assert!(is_let_in(&[("Host", "localhost:9000"), ("Origin", "http://localhost:9000")]));
        assert!(!is_let_in(&[("Host", "localhost:9000"), ("Origin", "http://evil.example")]));
        assert!(!is_let_in(&[("Host", "localhost:9000"), ("Sec-Fetch-Site", "cross-site")]));
        assert!(!is_let_in(&[("Host", "evil.example:9000"), ("Origin", "http://evil.example:9000")]));
    }

    #[test]
    fn tokens_cannot_be_made_over_the_network() {
        let (gate, [_, operate]) = gate(false);
        let bearer = format!("Bearer {operate}");
        for path in ["/v1/tokens", "/v1/tokens/5f3a9c01"] {
            for method in ["GET", "POST", "DELETE"] {
                let headers = [("Authorization", bearer.as_str())];
                let head = Head { path, ..head(method, &headers) };
                assert_eq!(code(&gate, LOCAL, &head), "forbidden", "{method} {path}");
            }
        }
    }
}
