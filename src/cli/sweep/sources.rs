//! The documents that a plan names: shipped targets and patterns by name, files by their place beside the plan.
//!
//! Invariant: a name without a slash that does not end in `.toml` is never a file.

use crate::cli::files;
use crate::store::Store;
use anyhow::Result;
use meissner_array::pattern::MAX_FILE_BYTES;
use meissner_design::{MAX_BYTES, shipped, shipped_names};
use meissner_input::message::{nearest, quote};
use meissner_sweep::{Document, Sources};
use std::path::{Path, PathBuf};

#[derive(Debug)]
pub(super) struct Files {
    store: Store,
    /// The directory of the plan.
    dir: PathBuf,
}

impl Files {
    /// Sources for a plan at this place.
    pub(super) fn beside(plan: &Path) -> Result<Self> {
        let dir = plan.parent().map(Path::to_owned).unwrap_or_default();
        Ok(Self { store: Store::new(None, false)?, dir })
    }
}

impl Sources for Files {
    fn names(&self, kind: Document) -> Vec<String> {
        match kind {
            Document::Target => shipped_names().into_iter().map(str::to_owned).collect(),
            Document::Pattern => self.store.list().patterns.into_iter().map(|of| of.name).collect(),
        }
    }

    fn text(&self, kind: Document, name: &str) -> Result<String, String> {
        if files::is_file(name) {
            let most = if kind == Document::Target { MAX_BYTES } else { MAX_FILE_BYTES };
            return files::text(&self.dir.join(name), most as u64, kind.name())
                .map_err(|error| error.to_string());
        }
        match kind {
            Document::Target => {
                let target = shipped(name).ok_or_else(|| {
                    let nearest = quote(nearest(&shipped_names(), name));
                    format!("no target is called so: did you mean {nearest}? The name of a file has a slash or ends in .toml")
                })?;
                toml::to_string(&target.definition()).map_err(|error| error.to_string())
            }
            Document::Pattern => {
                let stored = self.store.get(name).map_err(|error| error.to_string())?;
                String::from_utf8(stored.text.to_vec()).map_err(|error| error.to_string())
            }
        }
    }
}
