//! Decides which requests may pass, by host, origin, token and role.
//!
//! A page of another site can make a browser send requests. The `Host` header shows a name that was made to point here (DNS
//! rebinding), and `Origin` and `Sec-Fetch-Site` show that another site's page has sent the request. So both are checked first.
//! Then the request needs a token whose role allows it, unless it comes from this machine and the configuration asks for none. A
//! token that the client shows must always be valid, and its role applies, even on this machine.
//!
//! Invariant: a check never waits and uses no heap, because the real-time thread for emergency stops calls it.

use crate::config::Listen;
use crate::daemon::net::head::{Head, Shown};
use crate::daemon::net::refusal::{MALFORMED, NOT_VALID, READS_ONLY, Refusal};
use crate::daemon::page;
use crate::daemon::tokens::store::TokenStore;
use crate::record::{NetworkPeer, Peer, TokenId};
use meissner_api::access::Access;
use meissner_api::{Code, NetworkStatus, Role, Route};
use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A request that the gate lets through.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::daemon) struct Checked<'a> {
    /// The valid access token that it shows.
    pub(in crate::daemon) access: Option<TokenId>,
    pub(in crate::daemon) shown: Shown<'a>,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Gate {
    listen: Option<Listen>,
    /// Why the daemon does not listen there.
    problem: Option<String>,
    pub(in crate::daemon) tokens: Arc<TokenStore>,
    denied: AtomicU64,
}

impl Gate {
    /// The gate of a daemon that listens as configured, or that has this problem.
    pub(in crate::daemon) fn new(
        listen: Option<Listen>,
        problem: Option<String>,
        tokens: TokenStore,
    ) -> Self {
        Self { listen, problem, tokens: Arc::new(tokens), denied: AtomicU64::default() }
    }

    /// Sites whose pages may send requests over the network.
    pub(in crate::daemon) fn origins(&self) -> &[String] {
        self.listen.as_ref().map_or(&[], |listen| &listen.origins)
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
    pub(in crate::daemon) fn count_denied(&self) {
        self.denied.fetch_add(1, Ordering::Relaxed);
    }

    /// Decides about a request of this client.
    pub(in crate::daemon) fn check<'a>(&self, client: Peer, head: &Head<'a>) -> Result<Checked<'a>, Refusal> {
        match client.network {
            None => self.check_local(head),
            Some(client) => self.check_network(client, head),
        }
    }

    fn check_network<'a>(&self, client: NetworkPeer, head: &Head<'a>) -> Result<Checked<'a>, Refusal> {
        let listen = self.check_host(head)?;
        check_site(head, &listen.origins)?;
        // The page itself needs no token: it asks the person for it.
        let Some(needs) = needs(head) else { return Ok(Checked::default()) };
        let shown = head.shown()?;
        let access = self.find(shown.access, needs)?;
        if needs.local {
            let detail = "tokens are created and revoked on the daemon's machine: `meissner token`";
            return Err(Refusal(Code::Forbidden, detail));
        }
        if access.is_none() && !is_trusted(client, head, listen) {
            let detail = "send a valid token in the `Authorization: Bearer` header: `meissner token create` on the daemon's machine makes one";
            return Err(Refusal(Code::Unauthorized, detail));
        }
        Ok(Checked { access, shown })
    }

    /// Refuses a request over the network that goes to another host.
    fn check_host(&self, head: &Head<'_>) -> Result<&Listen, Refusal> {
        let Some(listen) = &self.listen else {
            return Err(Refusal(Code::Forbidden, "the daemon does not serve the network"));
        };
        // Check this first: if there are two hosts, either may be the wrong one.
        if head.malformed {
            return Err(MALFORMED);
        }
        if !head.host.is_some_and(|host| is_known(host, &listen.hosts)) {
            let detail = "the `Host` header names another host: use this machine's address, or add the name to `listen_hosts`";
            return Err(Refusal(Code::Forbidden, detail));
        }
        Ok(listen)
    }

    /// Refuses a request on the port for emergency stops that goes to another host, or that a page of another site has sent.
    pub(in crate::daemon) fn check_estop_site(&self, head: &Head<'_>) -> Result<(), Refusal> {
        let listen = self.check_host(head)?;
        match head.origin {
            Some(origin) if head.host.is_some_and(|host| is_page_beside(origin, host)) => Ok(()),
            _ => check_site(head, &listen.origins),
        }
    }

    /// Decides about an emergency stop on its port, which shows this access token, or an empty one.
    pub(in crate::daemon) fn check_estop_token(
        &self,
        client: NetworkPeer,
        head: &Head<'_>,
        token: &str,
    ) -> Result<Option<TokenId>, Refusal> {
        let access = self.find(Some(token).filter(|token| !token.is_empty()), Route::EStop.access())?;
        let is_trusted = self.listen.as_ref().is_some_and(|listen| is_trusted(client, head, listen));
        if access.is_none() && !is_trusted {
            let detail = "send a valid access token as the body: `meissner token create` on the daemon's machine makes one";
            return Err(Refusal(Code::Unauthorized, detail));
        }
        Ok(access)
    }

    /// Decides about a request on the Unix socket. `ssh -L` makes the socket a port of another machine, where a browser may reach
    /// it; so the gate refuses pages of other sites here, too. It also refuses an unknown host name with a dot, because anyone may
    /// have made it point to that port.
    fn check_local<'a>(&self, head: &Head<'a>) -> Result<Checked<'a>, Refusal> {
        let hosts = self.listen.as_ref().map_or(&[][..], |listen| &listen.hosts);
        let is_public = head.host.is_some_and(|host| host.contains('.') && !is_known(host, hosts));
        if is_public {
            let detail = "the `Host` header names another host: use `localhost`";
            return Err(Refusal(Code::Forbidden, detail));
        }
        check_site(head, &[])?;
        let Some(needs) = needs(head) else { return Ok(Checked::default()) };
        if Route::find(head.method, head.path) == Some(Route::EStop) {
            // Every client of the socket may order an emergency stop, whatever token it shows.
            let shown = head.shown().unwrap_or_default();
            return Ok(Checked { access: None, shown });
        }
        let shown = head.shown()?;
        Ok(Checked { access: self.find(shown.access, needs)?, shown })
    }

    /// The access token that the client shows, if any. It must be valid, and its role must allow the request.
    fn find(&self, token: Option<&str>, needs: Access) -> Result<Option<TokenId>, Refusal> {
        let Some(token) = token else { return Ok(None) };
        match self.tokens.find(token) {
            Some((_, Role::Observe)) if needs.role == Role::Operate => Err(READS_ONLY),
            Some((id, _)) => Ok(Some(id)),
            None => Err(NOT_VALID),
        }
    }
}

/// The access that a client needs for this request; none for a file of the page.
fn needs(head: &Head<'_>) -> Option<Access> {
    if page::is_file(head.method, head.path) {
        return None;
    }
    // For every method: the answer to a request about tokens without a route must not reveal anything either.
    if head.path == "/v1/tokens" || head.path.starts_with("/v1/tokens/") {
        return Some(Route::Tokens.access());
    }
    Some(
        Route::find(head.method, head.path).map_or_else(|| Access::without_route(head.method), Route::access),
    )
}

/// Refuses requests that a page of another site has sent, unless it is one of these.
fn check_site(head: &Head<'_>, origins: &[String]) -> Result<(), Refusal> {
    if head.origin.is_some_and(|origin| origins.iter().any(|allowed| allowed == origin)) {
        return Ok(());
    }
    let same_origin = head.origin.is_none_or(|origin| is_same_origin(origin, head.host));
    // A link on another site may open the page.
    let same_site =
        needs(head).is_none() || head.fetch_site.is_none_or(|site| matches!(site, "same-origin" | "none"));
    if same_origin && same_site {
        return Ok(());
    }
    Err(Refusal(
        Code::Forbidden,
        "a page of another site has sent this request: use the daemon's own page, or add the site to `listen_origins`",
    ))
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
    name(origin).zip(host).is_some_and(|(from, host)| from.eq_ignore_ascii_case(host))
}

/// The host and port of an origin.
fn name(origin: &str) -> Option<&str> {
    origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"))
}

/// Whether a request's origin is the API's page of the host whose port for emergency stops it goes to: the port before it.
fn is_page_beside(origin: &str, host: &str) -> bool {
    fn port(name: &str) -> (&str, Option<u16>) {
        let parts = name.rsplit_once(':').filter(|(_, port)| !port.contains(']'));
        parts.map_or((name, Some(80)), |(name, port)| (name, port.parse().ok()))
    }
    name(origin).is_some_and(|origin| {
        let ((page, api), (host, estop)) = (port(origin), port(host));
        page.eq_ignore_ascii_case(host) && api.is_some_and(|api| api.checked_add(1) == estop)
    })
}

/// Whether a client needs no token: it is on this machine, and the configuration asks for none.
const fn is_trusted(client: NetworkPeer, head: &Head<'_>, listen: &Listen) -> bool {
    client.address.is_loopback() && !head.forwarded && !listen.always_token
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::Problem;

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
        let listen = Listen {
            address,
            hosts: vec!["lab-pc.example".to_owned()],
            origins: vec!["https://lab.example".to_owned()],
            always_token,
        };
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
        let checked = gate.check(Peer::network(client), head);
        checked.map_or_else(|refusal| Problem::from(refusal).code, |_| "ok".to_owned())
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
        is("ok", &[("Origin", "https://lab.example"), ("Sec-Fetch-Site", "cross-site")]);
        is("forbidden", &[("Origin", "https://lab.example"), ("Host", "evil.example")]);
        is("forbidden", &[("Origin", "http://lab.example")]);
        is("forbidden", &[("Origin", "https://lab.example:8443")]);
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
        let is_let_in =
            |headers: &[(&str, &str)]| gate.check(Peer::local(1, 0), &head("POST", headers)).is_ok();
        for good in ["localhost:9000", "m", "localhost", "127.0.0.1:9000", "lab-pc.example"] {
            assert!(is_let_in(&[("Host", good)]), "{good}");
        }
        let bare = Head { method: "POST", path: "/v1/arm", ..Head::default() };
        assert!(gate.check(Peer::local(1, 0), &bare).is_ok());
        assert!(is_let_in(&[("Host", "localhost:9000"), ("Origin", "http://localhost:9000")]));
        assert!(!is_let_in(&[("Host", "localhost:9000"), ("Origin", "http://evil.example")]));
        assert!(!is_let_in(&[("Host", "localhost:9000"), ("Sec-Fetch-Site", "cross-site")]));
        assert!(!is_let_in(&[("Host", "evil.example:9000"), ("Origin", "http://evil.example:9000")]));
    }

    /// This is so even where no token is needed. But every client of the socket can order an emergency stop.
    #[test]
    fn a_token_that_is_shown_must_be_valid_everywhere() {
        let (gate, [observe, operate]) = gate(false);
        let revoked = gate.tokens.create(Role::Operate, "x").unwrap();
        gate.tokens.revoke(&revoked.info.id).unwrap();
        let ask = |client: Peer, method: &str, path: &'static str, bearer: &str| {
            let headers = [("Authorization", bearer)];
            let asked = gate.check(client, &Head { path, ..head(method, &headers) }).map(|_| "ok".to_owned());
            asked.unwrap_or_else(|refusal| Problem::from(refusal).code)
        };
        let session = format!("Bearer {}", "0".repeat(32));
        for (client, estop) in [(Peer::network(LOCAL), "unauthorized"), (Peer::local(1, 0), "ok")] {
            for wrong in
                [&format!("Bearer {}", revoked.token), "Bearer mst_00", "Bearer x", "Basic dTpw", "Bearer"]
            {
                assert_eq!(ask(client, "GET", "/v1/status", wrong), "unauthorized", "{wrong}");
                assert_eq!(ask(client, "POST", "/v1/disarm", wrong), "unauthorized", "{wrong}");
                assert_eq!(ask(client, "POST", "/v1/estop", wrong), estop, "{wrong}");
                assert_eq!(ask(client, "GET", "/", wrong), "ok", "the page asks for another one");
            }
            assert_eq!(ask(client, "POST", "/v1/arm", &session), "ok", "sessions are asked behind the gate");
            assert_eq!(ask(client, "POST", "/v1/arm", &format!("Bearer {operate}")), "ok");
            assert_eq!(ask(client, "POST", "/v1/arm", &format!("Bearer {observe}")), "forbidden");
            assert_eq!(ask(client, "POST", "/v1/stop", &format!("Bearer {observe}")), "forbidden");
            assert_eq!(
                ask(client, "POST", "/v1/estop", &format!("Bearer {observe}")),
                "ok",
                "an observer may stop"
            );
            assert_eq!(ask(client, "GET", "/v1/live/00", &format!("Bearer {observe}")), "forbidden");
            assert_eq!(ask(client, "GET", "/v1/status", &format!("Bearer {observe}")), "ok");
        }
    }

    #[test]
    fn the_port_for_emergency_stops_admits_the_page_beside_it_and_a_token() {
        let ask = |gate: &Gate, client, headers: &[(&str, &str)], token: &str| {
            let head = Head { path: "/v1/estop", ..head("POST", headers) };
            let site = gate.check_estop_site(&head);
            let asked = site.and_then(|()| gate.check_estop_token(client, &head, token));
            asked.map_or_else(|refusal| Problem::from(refusal).code, |_| "ok".to_owned())
        };
        let (open, tokens) = gate(false);
        let host = ("Host", "localhost:8766");
        for (good, site) in [
            ("http://localhost:8765", "same-site"),
            ("https://LOCALHOST:8765", "same-site"),
            ("https://lab.example", "cross-site"),
        ] {
            assert_eq!(ask(&open, LOCAL, &[host, ("Origin", good), ("Sec-Fetch-Site", site)], ""), "ok");
        }
        let of_80 = [("Host", "[::1]:81"), ("Origin", "http://[::1]"), ("Sec-Fetch-Site", "same-site")];
        assert_eq!(ask(&open, LOCAL, &of_80, ""), "ok");
        for bad in ["http://localhost:8767", "http://127.0.0.1:8765", "http://evil.example:8765", "null"] {
            assert_eq!(ask(&open, LOCAL, &[host, ("Origin", bad)], ""), "forbidden", "{bad}");
        }
        assert_eq!(ask(&open, LOCAL, &[host, ("Sec-Fetch-Site", "cross-site")], ""), "forbidden");
        assert_eq!(ask(&open, LOCAL, &[("Host", "evil.example:8766")], ""), "forbidden");
        assert_eq!(ask(&open, LOCAL, &[host, host], ""), "bad-request");
        let (strict, strict_tokens) = gate(true);
        for (gate, client, tokens) in
            [(&open, LOCAL, &tokens), (&open, far(), &tokens), (&strict, LOCAL, &strict_tokens)]
        {
            assert_eq!(ask(gate, client, &[host], "mst_00"), "unauthorized");
            for token in tokens {
                assert_eq!(ask(gate, client, &[host], token), "ok", "an observer may stop");
            }
        }
        assert_eq!(ask(&open, far(), &[host], ""), "unauthorized");
        assert_eq!(ask(&strict, LOCAL, &[host], ""), "unauthorized");
        assert_eq!(ask(&open, LOCAL, &[host, ("Via", "x")], ""), "unauthorized");
    }
}
