//! Reads patterns: names of the library, files, stdin. A file may name sample files, which are packed as it is read.
//!
//! Names of sample files are relative to the directory of the pattern's file.
//!
//! Invariant: no file that is too large is read into memory.

use super::files::{self, Kind};
use crate::file::{dir_of, open_regular};
use crate::store::{Store, StoreError};
use anyhow::{Result, anyhow};
use meissner_api::PatternChoice;
use meissner_array::pattern::{MAX_PACKED_BYTES, MAX_SAMPLE_FILE_BYTES, Pattern};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

/// The most bytes of a sample file.
const MAX_SAMPLE_FILE: u64 = MAX_SAMPLE_FILE_BYTES as u64;

/// A pattern that was read.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) pattern: Pattern,
    /// Its text, complete in itself: that of the file, or the packed one.
    pub(super) text: String,
    /// Whether it named sample files.
    pub(super) was_packed: bool,
}

/// Reads the pattern of an argument: a name of the library, a file, or `-` for stdin.
pub(super) fn of_argument(argument: &str) -> Result<Found> {
    if argument == "-" {
        let (text, name) = files::text_or_stdin(Path::new(argument), MAX_PACKED_BYTES as u64, "a pattern")?;
        return of_text(text, &name, Path::new("."));
    }
    if files::is_file(argument) {
        return of_file(Path::new(argument));
    }
    let stored = Store::new(None, false)?.get(argument).map_err(|error| match error {
        StoreError::Unknown { .. } => anyhow!(
            "{error}, and one that is not built in is named by its file, as `{}.toml`",
            argument.escape_debug()
        ),
        other => other.into(),
    })?;
    let text = String::from_utf8(stored.text.to_vec())?;
    Ok(Found { pattern: Arc::unwrap_or_clone(stored.pattern), text, was_packed: false })
}

/// Whether a file is that of a pattern.
pub(super) fn is_one(file: &Path) -> Result<bool> {
    let text = files::text(file, MAX_PACKED_BYTES as u64, "a pattern")?;
    Ok(Kind::of(&text) == Some(Kind::Pattern))
}

/// The pattern itself, as a play takes it in place of a name.
pub(super) fn inline(pattern: &Pattern) -> Result<PatternChoice> {
    let keys: toml::Table = pattern.to_toml().parse()?;
    let keys = serde_json::to_value(keys)?;
    Ok(PatternChoice::Inline(Box::new(keys.as_object().cloned().unwrap_or_default())))
}

/// Reads a pattern file.
pub(super) fn of_file(file: &Path) -> Result<Found> {
    let text = files::text(file, MAX_PACKED_BYTES as u64, "a pattern")?;
    Kind::Pattern.check(&text, &files::shown(file))?;
    of_text(text, &file.to_string_lossy(), dir_of(file))
}

/// Reads a pattern's text, and the sample files that it names, from this directory.
fn of_text(text: String, name: &str, dir: &Path) -> Result<Found> {
    let mut was_packed = false;
    let pattern = Pattern::parse_with_files(&text, name, &mut |file| {
        was_packed = true;
        let mut bytes = Vec::new();
        open_regular(&dir.join(file))
            .and_then(|file| file.take(MAX_SAMPLE_FILE + 1).read_to_end(&mut bytes))
            .map_err(|error| format!("cannot be read; name an NPY, CSV or WAV file ({error})"))?;
        Ok(bytes)
    })?;
    let text = if was_packed { pattern.to_toml() } else { text };
    Ok(Found { pattern, text, was_packed })
}
