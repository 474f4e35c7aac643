//! The pattern that a request names.
//!
//! Bounds: plays of one pattern hold four patterns of the directory, other plays two, checks one, other requests two; further requests wait.

pub(in crate::daemon) mod handlers;

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::Lane;
use crate::record::reader;
use crate::store::{Store, StoreError, Stored};
use meissner_api::{Code, FOUND_PREFIX, Problem};
use std::io;
use std::sync::Arc;
use tokio::sync::SemaphorePermit;

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        let code = match &error {
            StoreError::Unknown { .. } | StoreError::OtherText { .. } => Code::NotFound,
            StoreError::File(error) if error.is_of_disk() => Code::Store,
            StoreError::Pattern(error) if error.is_too_large() => Code::TooLarge,
            StoreError::Pattern(_) | StoreError::File(_) => Code::BadPattern,
            StoreError::Empty { .. } => Code::Empty,
            StoreError::OtherArray { .. } => Code::OtherArray,
            StoreError::InLibrary { .. } | StoreError::Exists { .. } => Code::Exists,
        };
        Self::new(code, error.to_string())
    }
}

/// A pattern, and its place among the lane's patterns. Patterns of the library and of renderings need no place, because they are in
/// memory anyway. With `sha256` it is the pattern of that text: the stored one, or the one that the session record keeps.
pub(in crate::daemon) async fn find(
    store: Arc<Store>,
    engine: &Engine,
    lane: &'static Lane,
    name: &str,
    sha256: Option<&str>,
) -> Result<(Stored, Option<SemaphorePermit<'static>>), Problem> {
    let is_it = |stored: &&Stored| sha256.is_none_or(|sha256| sha256 == stored.sha256);
    if let Some(stored) = store.library(name).filter(is_it) {
        return Ok((stored.clone(), None));
    }
    if let Some(id) = name.strip_prefix(FOUND_PREFIX) {
        let stored = engine.lock().renderings.found(id)?;
        let other =
            || StoreError::OtherText { name: name.to_owned(), sha256: sha256.unwrap_or_default().to_owned() };
        return Ok((Some(stored).filter(|stored| is_it(&stored)).ok_or_else(other)?, None));
    }
    let place = lane.patterns.acquire().await.ok();
    let (name, sha256) = (name.to_owned(), sha256.map(str::to_owned));
    let record = engine.record().dir();
    let read = move || match sha256 {
        None => store.get(&name),
        Some(sha256) => store.get_text(&name, &sha256, || {
            let dir = record.ok_or(io::ErrorKind::NotFound)?;
            reader::read_text(&dir, &sha256)
        }),
    };
    Ok((lane.blocking(read).await??, place))
}
