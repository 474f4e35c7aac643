//! Who may use a route: which role a client needs, and what other clients may do during an exclusive session.
//!
//! The daemon's gate asks [`Route::find`] and [`Route::access`] before every request, and again whenever a long answer continues,
//! for example a stream of events.
//!
//! Invariant: a request that no route takes reads nothing and changes nothing.

use crate::route::{Method, Route};
use crate::token::Role;

/// What a client needs for a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// The role that an access token must have, if the client shows one or needs one.
    pub role: Role,
    /// Clients of the Unix socket alone may use the route.
    pub local: bool,
    /// What sessions keep from whom.
    pub session: SessionRule,
}

/// What a route asks of a client's session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionRule {
    /// Nothing: it reads, or makes safe. The owner of a session must not keep others from it.
    Open,
    /// Nobody else's exclusive session runs: it starts a session, also for a client whose last one is over.
    Starts,
    /// Nobody else's exclusive session runs, and a session token that the client shows is the running session's.
    Owner,
}

impl Access {
    pub(crate) const READS: Self = Self { role: Role::Observe, local: false, session: SessionRule::Open };
    pub(crate) const CHANGES: Self = Self { role: Role::Operate, local: false, session: SessionRule::Owner };
    pub(crate) const MAKES_SAFE: Self = Self { session: SessionRule::Open, ..Self::CHANGES };

    /// Of a request that no route takes.
    #[must_use]
    pub fn without_route(method: &str) -> Self {
        if matches!(method, "GET" | "HEAD") { Self::READS } else { Self::CHANGES }
    }
}

impl Route {
    /// The route that takes this method and path. It uses no heap.
    #[must_use]
    pub fn find(method: &str, path: &str) -> Option<Self> {
        let method = match method {
            "GET" | "HEAD" => Method::Get,
            "POST" => Method::Post,
            "PUT" => Method::Put,
            "DELETE" => Method::Delete,
            _ => return None,
        };
        Self::ALL.into_iter().find(|route| route.method() == method && takes(route.path(), path))
    }
}

/// Whether a path fits a route's, whose parts in braces stand for any text.
fn takes(route: &str, path: &str) -> bool {
    let mut parts = path.split('/');
    let fits = |wanted: &str| {
        parts
            .next()
            .is_some_and(|part| if wanted.starts_with('{') { !part.is_empty() } else { part == wanted })
    };
    route.split('/').all(fits) && parts.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_finds_its_route_and_no_other() {
        for route in Route::ALL {
            let method = match route.method() {
                Method::Get => "GET",
                Method::Post => "POST",
                Method::Put => "PUT",
                Method::Delete => "DELETE",
            };
            let path = route.path().replace("{name}", "x").replace("{id}", "7").replace("{key}", "00");
            assert_eq!(Route::find(method, &path), Some(route), "{method} {path}");
            assert_ne!(Route::find("PATCH", &path), Some(route));
            assert_ne!(Route::find(method, &(path + "/more")), Some(route));
        }
        assert_eq!(Route::find("HEAD", "/v1/live/00"), Some(Route::LiveConnection));
        for path in ["", "/", "/v1", "/v1/", "/v1/plays/", "/v1//live/0", "/v1/%6cive/0"] {
            assert_eq!(Route::find("GET", path), None, "{path}");
        }
    }
}
