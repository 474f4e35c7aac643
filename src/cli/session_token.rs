//! The token of the session that this terminal has started.
//!
//! `session start` keeps it in a file of the user's runtime directory, named after the terminal session (as of `getsid`). So the
//! commands of this terminal act as the owner; those of another terminal of the same user do not. `MEISSNER_SESSION_TOKEN` replaces
//! the file. The second line of the file is the session's id: plays of this terminal name it, so that none is recorded in another
//! session.
//!
//! Invariant: only the user may read the file.

use crate::file::{PRIVATE, PRIVATE_DIR, dir_of, make_dirs, read_regular, replace};
use anyhow::{Context, Result};
use meissner_api::{Code, Problem};
use meissner_client::ClientError;
use nix::unistd::getsid;
use std::env;
use std::fs;
use std::io;
use std::path::PathBuf;

/// The variable that replaces the file.
pub(super) const VARIABLE: &str = "MEISSNER_SESSION_TOKEN";

/// The most bytes of a file: a token has 32.
const MAX_BYTES: u64 = 1 << 10;

fn file() -> Option<PathBuf> {
    let set = |name: &str| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let runtime = set("XDG_RUNTIME_DIR").or_else(|| set("HOME").map(|home| home.join(".local/state")))?;
    let session = getsid(None).ok()?;
    Some(runtime.join(format!("meissner/session-{session}.token")))
}

/// The token, if there is one.
pub(super) fn find() -> Option<String> {
    let token = env::var(VARIABLE).ok().or_else(|| Some(kept()?.0))?;
    let token = token.trim();
    // The daemon makes tokens of hexadecimal digits; other characters may not be allowed in a header.
    (!token.is_empty() && token.len() <= 64 && token.bytes().all(|b| b.is_ascii_alphanumeric()))
        .then(|| token.to_owned())
}

/// The session that this terminal has started, as far as its file tells.
pub(super) fn session() -> Option<String> {
    let (token, session) = kept()?;
    // The variable may hold another session's token.
    (find()? == token.trim()).then_some(session).filter(|session| !session.is_empty())
}

/// What the file holds: the token, and the session's id.
fn kept() -> Option<(String, String)> {
    let text = String::from_utf8(read_regular(&file()?, MAX_BYTES).ok()?).ok()?;
    let mut lines = text.lines().map(|line| line.trim().to_owned());
    Some((lines.next()?, lines.next().unwrap_or_default()))
}

/// Advice for the error that the session of this terminal is over.
pub(super) fn hint(error: &anyhow::Error) -> &'static str {
    let of_session = |problem: &Problem| problem.code == Code::SessionRunning.parts().0;
    match error.downcast_ref::<ClientError>() {
        Some(ClientError::Problem(problem)) if of_session(problem) && env::var_os(VARIABLE).is_some() => {
            "; MEISSNER_SESSION_TOKEN names the session: unset it, or set it to another session's"
        }
        Some(ClientError::Problem(problem)) if of_session(problem) && kept().is_some() => {
            "; `meissner session start` starts one, and after `meissner session leave` this terminal plays outside of its session"
        }
        _ => "",
    }
}

/// Keeps the token of a session for the commands of this terminal. Returns where.
pub(super) fn keep(token: &str, session: &str) -> Result<PathBuf> {
    let path =
        file().context("neither XDG_RUNTIME_DIR nor HOME is set: no file can keep the session's token")?;
    let write = || -> io::Result<()> {
        make_dirs(dir_of(&path), PRIVATE_DIR)?;
        replace(&path, format!("{token}\n{session}\n").as_bytes(), PRIVATE)
    };
    write().with_context(|| format!("{}: the session's token cannot be kept", path.display()))?;
    Ok(path)
}

/// Forgets the token.
pub(super) fn forget() {
    // Without a file there is nothing to forget.
    let _ = file().map(fs::remove_file);
}
