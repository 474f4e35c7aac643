//! The file of the vibration's sums beside the session record: read at the start.
//!
//! Invariant: if the sums cannot be read, or cannot be true, the day's limit counts as used up until a person has checked the file.

use crate::exposure::{self, Account, Now};
use crate::file::read_regular;
use crate::record::reader::has_plays;
use std::io;
use std::path::Path;
use tracing::warn;

/// Reads the file; `None`: there is none. Then also whether the record has plays of today, which it would have counted.
pub(in crate::daemon) fn read(dir: &Path) -> io::Result<Result<Vec<u8>, bool>> {
    match read_regular(&dir.join(exposure::FILE), exposure::MAX_FILE) {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            Ok(Err(has_plays(dir, Now::read().date)))
        }
        read => read.map(Ok),
    }
}

/// Restores the sums.
pub(in crate::daemon) fn restore(account: &mut Account, read: &io::Result<Result<Vec<u8>, bool>>) {
    let now = Now::read();
    let restored = match read {
        Ok(Ok(text)) => account.restore(text, now),
        Ok(Err(has_plays)) => {
            account.restore_none(has_plays.then_some(now.date));
            Ok(())
        }
        Err(error) => Err(account.lose(&error.to_string())),
    };
    if let Some(problem) = restored.err().map(|error| error.to_string()).or_else(|| account.problem(now)) {
        warn!("{problem}");
    }
}
