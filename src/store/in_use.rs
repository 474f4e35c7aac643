//! Patterns of the directory that are in use. A caller that reads a file again gets the pattern that others hold.
//!
//! Plays queue by the dozen, mostly of one pattern. The store still reads the file each time, because it may have changed; the hash
//! of its bytes tells whether the pattern is held.
//!
//! Invariant: one file is parsed at a time, and a pattern takes memory only while a caller holds it.

use meissner_array::pattern::Pattern;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// See the module. Keys are hashes of files.
#[derive(Debug, Default)]
pub(super) struct InUse(Mutex<HashMap<String, Weak<Pattern>>>);

impl InUse {
    /// The pattern of the file with this hash: the one that a caller holds, or a new one.
    pub(super) fn get<E>(
        &self,
        sha256: &str,
        parse: impl FnOnce() -> Result<Arc<Pattern>, E>,
    ) -> Result<Arc<Pattern>, E> {
        // Keep the lock while parsing, because a parser takes far more memory than a pattern.
        let mut held = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pattern) = held.get(sha256).and_then(Weak::upgrade) {
            return Ok(pattern);
        }
        let pattern = parse()?;
        held.retain(|_, pattern| pattern.strong_count() > 0);
        held.insert(sha256.to_owned(), Arc::downgrade(&pattern));
        Ok(pattern)
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.0.lock().unwrap().len()
    }
}
