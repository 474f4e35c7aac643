//! The token of the session that this terminal has started.
//!
//! `session start` keeps it in a file of the user's runtime directory, named after the terminal session (as of `getsid`). So the
//! commands of this terminal are the owner, and those of another terminal of the same user are not. `MEISSNER_SESSION_TOKEN`
//! replaces the file.
//!
//! Invariant: only the user may read the file.

use crate::file::read_regular;
use anyhow::{Context, Result};
use nix::unistd::getsid;
use std::env;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
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

fn read() -> Option<String> {
    String::from_utf8(read_regular(&file()?, MAX_BYTES).ok()?).ok()
}

/// The token, if there is one.
pub(super) fn find() -> Option<String> {
    let token = env::var(VARIABLE).ok().or_else(read)?;
    let token = token.trim();
    // The daemon makes tokens of hexadecimal digits; a header cannot hold anything.
    (!token.is_empty() && token.len() <= 64 && token.bytes().all(|b| b.is_ascii_alphanumeric()))
        .then(|| token.to_owned())
}

/// Keeps a token for the commands of this terminal. Returns where.
pub(super) fn keep(token: &str) -> Result<PathBuf> {
    let path =
        file().context("neither XDG_RUNTIME_DIR nor HOME is set: no file can keep the session's token")?;
    let dir = path.parent().unwrap_or(&path);
    let write = || -> io::Result<()> {
        DirBuilder::new().recursive(true).mode(0o700).create(dir)?;
        let next = path.with_extension("new");
        // An old file may have other rights.
        match fs::remove_file(&next) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&next)?;
        writeln!(file, "{token}")?;
        fs::rename(next, &path)
    };
    write().with_context(|| format!("{}: the session's token cannot be kept", path.display()))?;
    Ok(path)
}

/// Forgets the token.
pub(super) fn forget() {
    // Without a file there is nothing to forget.
    let _ = file().map(fs::remove_file);
}
