//! The file of the vibration's sums beside the session record: read at the start.
//!
//! Invariant: if the sums cannot be read, or cannot be true, the day's limit counts as used up until a person has checked the file.

use crate::exposure::{self, Account, Now};
use crate::file::read_regular;
use std::io;
use std::path::Path;
use tracing::warn;

/// Reads the file; `None`: there is none.
pub(in crate::daemon) fn read(dir: &Path) -> io::Result<Option<Vec<u8>>> {
    match read_regular(&dir.join(exposure::FILE), exposure::MAX_FILE) {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            Ok(None)
        }
        read => read.map(Some),
    }
}

/// Restores the sums.
pub(in crate::daemon) fn restore(account: &mut Account, read: io::Result<Option<Vec<u8>>>) {
    let now = Now::read();
    let restored = match read {
        Ok(Some(text)) => account.restore(&text, now),
        Ok(None) => Ok(()),
        Err(error) => Err(account.lose(&error.to_string())),
    };
    if let Some(problem) = restored.err().map(|error| error.to_string()).or_else(|| account.problem(now)) {
        warn!("{problem}");
    }
}
