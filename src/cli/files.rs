//! Files that a command reads, and those it writes: beside their place first, then renamed into it.
//!
//! What has a slash or ends in `.toml` is a file; other words are names of what is shipped.
//!
//! Whether a place can be written to is found out before the work, by making the file beside it. A place that is a
//! device, a pipe or a link is refused: it would be replaced, not written to.
//!
//! Invariant: what is there already is replaced whole or not at all; what is too large or not a file is not read into
//! memory.

use crate::config;
use anyhow::{Result, anyhow, bail};
use std::fs::{self, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A new file, and the place it is for.
#[derive(Debug)]
pub(super) struct Beside {
    new: NamedTempFile,
    place: PathBuf,
}

/// Whether an argument is a file rather than a name.
pub(super) fn is_file(argument: &str) -> bool {
    argument.contains('/') || argument.ends_with(".toml")
}

/// The text of a file of a kind, at most so many bytes.
pub(super) fn text(place: &Path, most: u64, kind: &str) -> Result<String> {
    let at = shown(place);
    if let Ok(found) = fs::metadata(place)
        && found.is_file()
        && found.len() > most
    {
        bail!("{at}: {} bytes are too many: a {kind} file has at most {most}", found.len());
    }
    let bytes = config::read_regular(place, most)
        .map_err(|error| anyhow!("{at}: cannot be read; name a {kind} file ({error})"))?;
    String::from_utf8(bytes).map_err(|_| anyhow!("{at}: not UTF-8 text: name a {kind} file in UTF-8"))
}

/// Makes a new file beside a place.
pub(super) fn beside(place: &Path) -> Result<Beside> {
    if fs::symlink_metadata(place).is_ok_and(|found| !found.is_file()) {
        bail!("{}: is not a plain file: name one to be written", shown(place));
    }
    let dir = place.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let new = tempfile::Builder::new().permissions(Permissions::from_mode(0o666)).tempfile_in(dir);
    Ok(Beside { new: new.map_err(|error| cannot_write(place, &error))?, place: place.to_owned() })
}

impl Beside {
    /// Writes the file and puts it in its place.
    pub(super) fn write(self, text: &str) -> Result<()> {
        let Self { mut new, place } = self;
        let written = new.write_all(text.as_bytes()).and_then(|()| Ok(new.persist(&place).map(drop)?));
        written.map_err(|error| cannot_write(&place, &error))
    }
}

/// Sees that a directory is there, or makes it.
pub(super) fn directory(dir: &Path) -> Result<()> {
    if fs::metadata(dir).is_ok_and(|found| !found.is_dir()) {
        bail!("{}: is not a directory: name one, or a new one", shown(dir));
    }
    fs::create_dir_all(dir)
        .map_err(|error| anyhow!("{}: cannot be made; see that you may ({error})", shown(dir)))
}

/// A place on one line.
pub(super) fn shown(place: &Path) -> String {
    place.to_string_lossy().escape_debug().to_string()
}

fn cannot_write(place: &Path, error: &io::Error) -> anyhow::Error {
    let cause =
        error.get_ref().and_then(std::error::Error::source).map_or(error.to_string(), ToString::to_string);
    anyhow!("{}: cannot be written; see that the directory is there and you may ({cause})", shown(place))
}
