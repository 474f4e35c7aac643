//! Access tokens, by which the daemon admits network clients.
//!
//! A client on the Unix socket creates a token ([`TokenRequest`]), and [`TokenCreated`] shows it once; the daemon keeps only its
//! hash. A network client sends it as `Authorization: Bearer TOKEN`. A session's token then goes into the header
//! [`SESSION_HEADER`].
//!
//! Invariant: an access token begins with [`PREFIX`], and no token of a session does.

use crate::body::{check_text, read};
use crate::problem::Problem;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How every access token begins.
pub const PREFIX: &str = "mst_";
/// The header of a session's token beside an access token.
pub const SESSION_HEADER: &str = "meissner-session";
/// The header for a name that a client gives itself, 1 to 64 of `A-Za-z0-9_-`: requests with the same name are signs of life of the same client.
pub const CLIENT_HEADER: &str = "meissner-client";
/// Tokens that are valid at the same time, at most.
pub const MAX_TOKENS: usize = 100;

/// What a client with a token may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read and order an emergency stop.
    Observe,
    /// Do everything but create and revoke tokens.
    Operate,
}

impl Role {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Observe => "observe",
            Self::Operate => "operate",
        }
    }
}

/// A token to be created.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(examples(json!({"role": "observe", "name": "screen in the corridor"})))]
pub struct TokenRequest {
    /// What a client with the token may do.
    pub role: Role,
    /// Who or what uses it, 1 to 100 characters.
    #[schema(min_length = 1, max_length = 100)]
    pub name: String,
}

impl TokenRequest {
    /// Reads a body.
    ///
    /// # Errors
    /// A `bad-request` that names the key.
    pub fn parse(body: &[u8]) -> Result<Self, Problem> {
        let request: Self = read(body)?;
        check_text("name", &request.name)?;
        Ok(request)
    }
}

/// A token that was created.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": "5f3a9c01", "role": "observe", "name": "screen in the corridor", "created": "2026-11-23T10:00:00Z",
    "token": "mst_0f6d..."
})))]
pub struct TokenCreated {
    /// The token without its secret.
    #[serde(flatten)]
    pub info: TokenInfo,
    /// The token itself. The daemon does not show it again.
    pub token: String,
}

/// A token without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "id": "5f3a9c01", "role": "observe", "name": "screen in the corridor", "created": "2026-11-23T10:00:00Z"
})))]
pub struct TokenInfo {
    /// Its id, 8 hexadecimal digits, as in the log and the session record.
    pub id: String,
    /// What a client with the token may do.
    pub role: Role,
    /// Who or what uses it.
    pub name: String,
    /// When it was created, UTC.
    pub created: String,
}

/// The tokens that are valid.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({"tokens": [{
    "id": "5f3a9c01", "role": "observe", "name": "screen in the corridor", "created": "2026-11-23T10:00:00Z"
}]})))]
pub struct TokenList {
    /// The oldest first.
    pub tokens: Vec<TokenInfo>,
}

/// Who can reach the daemon over the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct NetworkStatus {
    /// Where the daemon listens, with the port.
    pub address: String,
    /// Whether a client on the same machine may do everything without a token.
    pub loopback_without_token: bool,
    /// Tokens that may only read and order an emergency stop.
    pub observe_tokens: u32,
    /// Tokens that may operate.
    pub operate_tokens: u32,
    /// Requests that were refused since the start: a wrong token, role, host or origin.
    pub denied: u64,
    /// Why the daemon does not listen there, in one line; null: it does.
    pub problem: Option<String>,
}
