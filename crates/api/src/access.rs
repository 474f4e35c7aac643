//! Who may use a route: which role a client needs, and what other clients may do during an exclusive session.
//!
//! The daemon's gate asks [`Route::find`](crate::Route::find) and [`Route::access`](crate::Route::access) before every request, and again whenever a long answer continues,
//! for example a stream of events.
//!
//! Invariant: a request that no route takes reads nothing and changes nothing.

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
    pub fn without_route(method: &str) -> Self {
        if matches!(method, "GET" | "HEAD") { Self::READS } else { Self::CHANGES }
    }
}
