//! The target store: the built-in targets, and the site's own in the folder `targets` of the pattern directory.
//!
//! As with patterns, the folder is read at every request, and built-in targets cannot be overwritten or shadowed. Calls block for as long
//! as the disk takes.
//!
//! Invariant: a file is replaced atomically, and only by a target of the file's name.

use super::folder::{FileError, check_name, check_new_name};
use super::{FOLDER, Store, first, hash, offer};
use meissner_api::{TargetDetails, TargetList, TargetSummary};
use meissner_design::{MAX_BYTES, Shape, Target, TargetError, shipped, shipped_names};
use meissner_input::message::{nearest, quote};
use serde_json::Value;
use std::path::Path;

/// Why a target is refused.
#[derive(Debug, thiserror::Error)]
pub enum TargetStoreError {
    /// No target of that name.
    #[error("no target is called {}{} `GET /v1/targets` shows all", quote(.name), offer(.nearest))]
    Unknown {
        /// The requested name.
        name: String,
        /// The nearest name there is.
        nearest: Vec<String>,
    },
    /// A file that is not a target.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// Built-in targets are read-only.
    #[error("`{name}` is built in and cannot be {change}: choose another name")]
    BuiltIn {
        /// Its name.
        name: String,
        /// The refused change.
        change: &'static str,
    },
    /// A target of that name is stored.
    #[error(
        "the target `{name}` is stored already (sha256 {sha256}): `?replace=true` stores the new one in its place"
    )]
    Exists {
        /// Its name.
        name: String,
        /// SHA-256 of its file.
        sha256: String,
    },
    /// Another reason, of any file.
    #[error(transparent)]
    File(#[from] FileError),
}

/// A target of the store.
#[derive(Clone, Debug)]
pub struct StoredTarget {
    /// The target.
    pub target: Target,
    /// SHA-256 of its file; of a built-in one, of its definition.
    pub sha256: String,
    /// Whether it is built in.
    pub library: bool,
}

impl StoredTarget {
    /// The target as the API shows it.
    #[must_use]
    pub fn details(&self) -> TargetDetails {
        let Self { target, sha256, library } = self;
        TargetDetails {
            target: target_json(target),
            sha256: sha256.clone(),
            library: *library,
            outline: target.shape().outline(),
            warnings: target.warnings(),
        }
    }

    fn entry(&self) -> TargetSummary {
        let Self { target, sha256, library } = self;
        let shape = match target.shape() {
            Shape::Polyline(points) if points.len() == 2 => "segment",
            Shape::Polyline(_) => "polyline",
            Shape::Disc { .. } => "disc",
            Shape::Dots(_) => "dots",
            Shape::Grating { .. } => "grating",
        };
        let (name, shape) = (target.name().to_owned(), shape.to_owned());
        TargetSummary { name, library: *library, shape, moves: target.moves(), sha256: sha256.clone() }
    }
}

/// A target with all keys of its file, as JSON.
#[must_use]
pub fn target_json(target: &Target) -> Value {
    let mut keys = target.definition();
    // The files of the library keep the old name; the API never had it.
    if let Some(afferent) = keys.remove("receptor") {
        keys.insert("afferent".to_owned(), afferent);
    }
    // Strings, numbers and tables of them.
    serde_json::to_value(keys).unwrap_or_default()
}

impl Store {
    /// The target of that name.
    ///
    /// # Errors
    /// If there is none, or its file holds no target of that name.
    pub fn target(&self, name: &str) -> Result<StoredTarget, TargetStoreError> {
        if let Some(built_in) = built_in(name) {
            return Ok(built_in);
        }
        let Some((path, bytes)) = self.targets.read(name, MAX_BYTES)? else {
            return Err(self.unknown_target(name));
        };
        self.parse_target(name, &bytes, &path)
    }

    /// All targets, and a line for each file that cannot be read as one.
    #[must_use]
    pub fn targets(&self) -> TargetList {
        let names = shipped_names();
        let mut targets: Vec<_> = names.iter().filter_map(|name| Some(built_in(name)?.entry())).collect();
        let mut errors = Vec::new();
        for name in self.targets.names().unwrap_or_default() {
            if names.contains(&name.as_str()) {
                errors.push(format!("{FOLDER}/{name}.toml: `{name}` is built in: rename the file's target"));
                continue;
            }
            match self.target(&name) {
                Ok(stored) => targets.push(stored.entry()),
                Err(TargetStoreError::Unknown { .. }) => {
                    errors.push(format!("{}: not a target's name: use a-z, 0-9 and - only", quote(&name)));
                }
                Err(error) => errors.push(error.to_string()),
            }
        }
        targets.sort_by(|a, b| a.name.cmp(&b.name));
        TargetList { targets, errors: first(errors, "files cannot be read as targets") }
    }

    /// Stores a target under its name. With `replace` it may replace an older one of that name. Returns it, and the SHA-256 of the
    /// file that it replaced.
    ///
    /// # Errors
    /// If the text is not a target of that name, the name is that of a built-in one or is taken, or the file cannot be written.
    pub fn put_target(
        &self,
        name: &str,
        text: &str,
        replace: bool,
    ) -> Result<(StoredTarget, Option<String>), TargetStoreError> {
        if built_in(name).is_some() {
            return Err(TargetStoreError::BuiltIn { name: name.to_owned(), change: "overwritten" });
        }
        let stored = self.parse_target(name, text.as_bytes(), Path::new(&format!("{name}.toml")))?;
        check_new_name(name)?;
        let taken = |sha256| TargetStoreError::Exists { name: name.to_owned(), sha256 };
        let replaced = self.targets.put(name, text, replace, taken)?;
        Ok((stored, replaced))
    }

    /// Removes a target of the folder; returns the SHA-256 of its file.
    ///
    /// # Errors
    /// If there is none, it is built in, or the file cannot be removed.
    pub fn remove_target(&self, name: &str) -> Result<String, TargetStoreError> {
        if built_in(name).is_some() {
            return Err(TargetStoreError::BuiltIn { name: name.to_owned(), change: "removed" });
        }
        self.targets.remove(name)?.ok_or_else(|| self.unknown_target(name))
    }

    fn parse_target(&self, name: &str, bytes: &[u8], path: &Path) -> Result<StoredTarget, TargetStoreError> {
        let target = Target::read(self.targets.text(bytes, path)?, &path.display().to_string())?;
        check_name(name, target.name())?;
        Ok(StoredTarget { target, sha256: hash(bytes), library: false })
    }

    fn unknown_target(&self, name: &str) -> TargetStoreError {
        let own = self.targets.names().unwrap_or_default();
        let known: Vec<&str> = shipped_names().into_iter().chain(own.iter().map(String::as_str)).collect();
        TargetStoreError::Unknown { name: name.to_owned(), nearest: vec![nearest(&known, name).to_owned()] }
    }
}

fn built_in(name: &str) -> Option<StoredTarget> {
    let target = shipped(name)?;
    let sha256 = hash(target_json(&target).to_string().as_bytes());
    Some(StoredTarget { target, sha256, library: true })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const TEXT: &str = "name = \"my-edge\"\nshape = \"segment\"\npoints = [[-4, 0], [4, 0]]\n";

    fn store() -> (tempfile::TempDir, Store) {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::new(Some(dir.path().to_owned()), false).unwrap();
        (dir, store)
    }

    #[test]
    fn what_is_put_is_there_can_be_replaced_and_removed() {
        let (dir, store) = store();
        let (stored, replaced) = store.put_target("my-edge", TEXT, false).unwrap();
        assert!(replaced.is_none() && store.target("my-edge").unwrap().sha256 == stored.sha256);
        assert!(store.put_target("my-edge", TEXT, false).unwrap_err().to_string().contains(&stored.sha256));
        let other = store.put_target("my-edge", &format!("# new\n{TEXT}"), true).unwrap();
        assert!(other.1 == Some(stored.sha256.clone()) && other.0.sha256 != stored.sha256);
        assert_eq!(store.targets().targets.iter().filter(|target| !target.library).count(), 1);
        // Targets do not count as patterns, nor does their folder.
        assert!(
            store.list().patterns.iter().all(|pattern| pattern.library) && store.list().errors.is_empty()
        );
        assert_eq!(store.remove_target("my-edge").unwrap(), other.0.sha256);
        assert!(matches!(store.target("my-edge"), Err(TargetStoreError::Unknown { .. })));
        assert_eq!(fs::read_dir(dir.path().join(FOLDER)).unwrap().count(), 0, "no temporary file is left");
    }

    #[test]
    fn no_name_leads_out_of_the_folder() {
        let (dir, store) = store();
        fs::write(dir.path().join("secret.toml"), TEXT.replace("my-edge", "secret")).unwrap();
        store.put_target("my-edge", TEXT, false).unwrap();
        for name in ["../secret", "..", "", "a/b", "A", "x\n", &"x".repeat(65)] {
            let line = store.target(name).unwrap_err().to_string();
            assert!(line.starts_with("no target is called ") && !line.contains('\n'), "{line}");
            assert!(matches!(store.remove_target(name), Err(TargetStoreError::Unknown { .. })), "{name}");
            assert!(store.put_target(name, TEXT, true).is_err(), "{name}");
        }
        let names: Vec<_> =
            fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(names.len() == 2, "{names:?}");
    }

    #[test]
    fn bad_files_are_lines_and_built_in_ones_stay() {
        let (dir, store) = store();
        store.put_target("my-edge", TEXT, false).unwrap();
        fs::write(dir.path().join("targets/bad.toml"), "nane = 1").unwrap();
        fs::write(dir.path().join("targets/edge-45.toml"), TEXT).unwrap();
        fs::write(dir.path().join("targets/other.toml"), TEXT).unwrap();
        let list = store.targets();
        assert_eq!((list.targets.len(), list.errors.len()), (shipped_names().len() + 1, 3), "{list:?}");
        for change in
            [store.put_target("edge-45", TEXT, true).map(drop), store.remove_target("edge-45").map(drop)]
        {
            assert!(matches!(change, Err(TargetStoreError::BuiltIn { .. })));
        }
        let line = store.put_target("other", TEXT, true).unwrap_err().to_string();
        assert_eq!(
            line,
            "`other`: `name` is `my-edge`: must be the name it is stored under; change one of them"
        );
        let line = store.put_target("my-edge", &TEXT.replace("-4", "-40"), true).unwrap_err().to_string();
        assert!(
            line.starts_with("my-edge.toml:3: `points[0]` is at [-40, 0] mm: must be on the pad"),
            "{line}"
        );
        assert!(Store::new(None, false).unwrap().put_target("a", TEXT, false).is_err());
    }

    /// The API's target can be sent back unchanged.
    #[test]
    fn every_built_in_target_reads_back_from_json() {
        for name in shipped_names() {
            let stored = built_in(name).unwrap();
            let json = target_json(&stored.target).to_string();
            assert!(!json.contains("receptor"));
            assert_eq!(Target::read_json(&json), Ok(stored.target));
        }
        // A null from a program's empty field does not mean the default.
        for key in ["amplitude_um", "reach_mm", "radius_mm", "duration_s", "dot_pitch_mm"] {
            let json = format!(r#"{{"name": "a", "shape": "dots", "points": [[0, 0]], "{key}": null}}"#);
            let line = Target::read_json(&json).unwrap_err().to_string();
            assert!(line.starts_with(&format!("`{key}` is null: must be a number")), "{line}");
        }
        let line = Target::read_json(r#"{"name": "a", "shape": "dots", "ponts": [[0, 0]]}"#).unwrap_err();
        assert_eq!(line.to_string(), "unknown key `ponts`: did you mean `points`?");
        let line = Target::read_json(r#"{"name": "a", "shape": "dots", "points": [[0, 20]]}"#).unwrap_err();
        assert!(line.to_string().starts_with("`points[0]` is at [0, 20] mm: must be on the pad"), "{line}");
    }
}
