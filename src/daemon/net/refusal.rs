//! Why the gate refuses a request.
//!
//! Invariant: a refusal uses no heap, because the real-time thread for emergency stops makes and drops it.

use meissner_api::{Code, Problem};

/// Why a request is refused. See the module.
#[derive(Clone, Copy, Debug)]
pub(in crate::daemon) struct Refusal(pub(in crate::daemon) Code, pub(in crate::daemon) &'static str);

impl From<Refusal> for Problem {
    fn from(Refusal(code, detail): Refusal) -> Self {
        Self::new(code, detail)
    }
}

/// The refusal of headers that cannot be told apart.
pub(in crate::daemon) const MALFORMED: Refusal = Refusal(
    Code::BadRequest,
    "a header occurs twice, is not plain text, or the address names another host: send it once",
);
/// The refusal of an observer's access token.
pub(in crate::daemon) const READS_ONLY: Refusal = Refusal(
    Code::Forbidden,
    "the token may only read and order an emergency stop: use one with the role `operate`",
);
/// The refusal of an invalid access token.
pub(in crate::daemon) const NOT_VALID: Refusal = Refusal(
    Code::Unauthorized,
    "the access token is not valid: it was revoked, or is another daemon's; `meissner token create` on the daemon's machine makes one",
);
