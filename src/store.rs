//! The pattern store: the built-in library, and a directory of the site's own patterns. The library has the patterns of
//! `library/patterns`, those of motions in its folder `motions`, those rendered from `library/objects` in `rendered`, and those of
//! the paper's setting in `paper`.
//!
//! The store reads the directory at every request, so it finds manually added files at once. [`Store::get`] reads one file,
//! [`Store::list`] at most [`MAX_FILES`]. Callers that hold the same file share one pattern. Patterns of the library cannot be
//! overwritten or shadowed. Calls block for as long as the disk takes.
//!
//! Invariant: a file of the directory is replaced atomically, and only by one that parses and has the file's name.

mod folder;
mod in_use;

pub use folder::{FileError, MAX_FILES};
pub(crate) use folder::{hash, hexadecimal};

use crate::receipts::{Outline, motion_heights};
use folder::{Folder, check_name, check_new_name};
use in_use::InUse;
use include_dir::{Dir, include_dir};
use meissner_api::pattern_choice::INLINE;
use meissner_api::{MAX_LISTED, MAX_PACKED_BODY, PatternList, PatternSummary, RailLoad, ReachedDrive};
use meissner_array::pattern::{FORMAT, Pattern, PatternError};
use meissner_array::power::{CAPACITANCE_NF, RailPulses, current_ma, rail_pulses};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_input::message::{cut, quote};
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

static LIBRARY: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/library/patterns");

/// The most names offered for an unknown one.
const OFFERED: usize = 3;

/// Why the store refuses a request.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// No pattern of that name.
    #[error("no pattern is called {}{} `meissner list` shows all", quote(.name), offer(.nearest))]
    Unknown {
        /// The requested name.
        name: String,
        /// The nearest existing names.
        nearest: Vec<String>,
    },
    /// No text of that name has this SHA-256.
    #[error(
        "{}: no text with the SHA-256 {sha256} is kept: the stored pattern is another one or gone, and the session record has \
         none; import the pattern as it was", quote(.name)
    )]
    OtherText {
        /// The requested name.
        name: String,
        /// The requested SHA-256.
        sha256: String,
    },
    /// A pattern that does not parse.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// The library is read-only.
    #[error("`{name}` is part of the library and cannot be {change}: choose another name")]
    InLibrary {
        /// Its name.
        name: String,
        /// The refused change.
        change: &'static str,
    },
    /// A pattern of that name is stored.
    #[error(
        "`{name}` is stored already (sha256 {sha256}): `--replace`, or `?replace=true`, stores the new one in its place"
    )]
    Exists {
        /// Its name.
        name: String,
        /// SHA-256 of its file.
        sha256: String,
    },
    /// A pattern without any stroke.
    #[error("{}: the pattern has no stroke, so nothing would be played: {}", quote(.name), .why)]
    Empty {
        /// Its name.
        name: String,
        /// What to change.
        why: String,
    },
    /// A pattern for another array.
    #[error(
        "{} is for the array {}, and this one is {}: `meissner optimise --array ARRAY` makes one for this array: ARRAY is its name, or the file of its description if it is \
         not shipped", quote(.name), .its, .this
    )]
    OtherArray {
        /// Its name.
        name: String,
        /// The name of its array.
        its: String,
        /// The name of this one.
        this: String,
    },
    /// Another reason, of any file.
    #[error(transparent)]
    File(#[from] FileError),
}

fn offer(nearest: &[String]) -> String {
    match nearest {
        [] => ";".to_owned(),
        names => format!(": did you mean `{}`?", names.join("`, `")),
    }
}

/// A pattern and the hash of its file. Clones share the pattern and its JSON.
#[derive(Clone, Debug)]
pub struct Stored {
    /// The pattern.
    pub pattern: Arc<Pattern>,
    /// SHA-256 of its file.
    pub sha256: String,
    /// Whether it is part of the library.
    pub library: bool,
    /// Its file.
    pub text: Arc<[u8]>,
    json: Arc<OnceLock<Arc<[u8]>>>,
    run: Arc<OnceLock<Outline>>,
}

/// A pattern in full, with the keys of [`PatternDetails`](meissner_api::PatternDetails).
#[derive(Serialize)]
struct Details<'a> {
    pattern: &'a Pattern,
    sha256: &'a str,
    library: bool,
    compiled_ms: Option<f64>,
    drives: &'a [ReachedDrive],
    highest_um: Vec<f64>,
    rails: Vec<RailLoad>,
    warnings: Vec<String>,
}

/// The store.
#[derive(Debug)]
pub struct Store {
    library: BTreeMap<String, Stored>,
    in_use: InUse,
    folder: Folder,
}

/// A pattern that was stored.
#[derive(Debug)]
pub struct Put {
    /// The pattern.
    pub stored: Stored,
    /// SHA-256 of the file that it replaced.
    pub replaced: Option<String>,
}

impl Store {
    /// A store of the library and a directory. With `make_dir`, [`Self::put`] makes the directory if it is missing.
    ///
    /// # Errors
    /// If a file of the library does not parse, which a test excludes.
    pub fn new(dir: Option<PathBuf>, make_dir: bool) -> Result<Self, StoreError> {
        let folder = Folder::new(dir, make_dir);
        let mut library = BTreeMap::new();
        let inner = LIBRARY.dirs().flat_map(Dir::files);
        for file in LIBRARY.files().chain(inner) {
            let path = file.path();
            if path.extension().is_some_and(|extension| extension == "toml") {
                let contents = file.contents();
                let pattern = Arc::new(parse(folder::text(contents, path)?, path)?);
                let stored = Stored::new(pattern, contents, true);
                library.insert(stored.pattern.name().to_owned(), stored);
            }
        }
        Ok(Self { library, in_use: InUse::default(), folder })
    }

    /// Checks that the directory can be read.
    ///
    /// # Errors
    /// If it cannot.
    pub fn check_dir(&self) -> Result<(), StoreError> {
        Ok(self.folder.names().map(drop)?)
    }

    /// The pattern of that name, if it is part of the library. Does not read the disk.
    pub fn library(&self, name: &str) -> Option<&Stored> {
        self.library.get(name)
    }

    /// The pattern of that name.
    ///
    /// # Errors
    /// If there is none (with the nearest names), or its file holds no pattern of that name.
    pub fn get(&self, name: &str) -> Result<Stored, StoreError> {
        if let Some(stored) = self.library(name) {
            return Ok(stored.clone());
        }
        let Some((path, bytes)) = self.folder.read(name, MAX_PACKED_BODY)? else {
            return Err(self.unknown(name));
        };
        named(name, self.parse(&bytes, &path)?)
    }

    /// The pattern of that name whose text has this SHA-256: the stored one, or else the text that `kept` finds.
    ///
    /// # Errors
    /// [`StoreError::OtherText`] if neither has it.
    pub fn get_text(
        &self,
        name: &str,
        sha256: &str,
        kept: impl FnOnce() -> io::Result<Vec<u8>>,
    ) -> Result<Stored, StoreError> {
        if let Some(stored) = self.get(name).ok().filter(|stored| stored.sha256 == sha256) {
            return Ok(stored);
        }
        let other = || StoreError::OtherText { name: name.to_owned(), sha256: sha256.to_owned() };
        let text = kept().map_err(|_| other())?;
        let stored = self.parse(&text, Path::new(&format!("{sha256}.toml")))?;
        if stored.sha256 == sha256 { named(name, stored).map_err(|_| other()) } else { Err(other()) }
    }

    /// The pattern that a request holds: its keys as in a file, for this array unless they say another. Its text is the file that it would
    /// be.
    ///
    /// # Errors
    /// If the keys are no pattern.
    pub fn inline(&self, mut keys: Map<String, Value>, array: Array) -> Result<Stored, StoreError> {
        let name = keys.get("name").and_then(Value::as_str).unwrap_or(INLINE).to_owned();
        keys.entry("name").or_insert_with(|| INLINE.into());
        let format = keys.entry("format").or_insert_with(|| FORMAT.into()).as_i64();
        keys.entry("array").or_insert_with(|| array.name().into());
        // A format that is no whole number is unknown, too.
        let pattern = Pattern::from_keys(format.unwrap_or(0), Value::Object(keys), &cut(&name, 64))?;
        let stored = Stored::made(pattern);
        let pattern = self.in_use.get(&stored.sha256, || Ok::<_, StoreError>(Arc::clone(&stored.pattern)))?;
        Ok(Stored { pattern, ..stored })
    }

    /// The pattern in a file of the directory.
    fn parse(&self, bytes: &[u8], path: &Path) -> Result<Stored, StoreError> {
        let sha256 = hash(bytes);
        let pattern = self
            .in_use
            .get(&sha256, || Ok::<_, StoreError>(Arc::new(parse(folder::text(bytes, path)?, path)?)))?;
        Ok(Stored::new(pattern, bytes, false))
    }

    /// All patterns, and a line for each file that cannot be read as one, up to [`MAX_LISTED`].
    pub fn list(&self) -> PatternList {
        let mut list = PatternList::default();
        list.patterns.extend(self.library.values().map(Stored::entry));
        let names = self.folder.names().unwrap_or_else(|error| {
            list.errors.push(error.to_string());
            Vec::new()
        });
        if names.len() == MAX_FILES {
            list.errors.push(format!("only the first {MAX_FILES} files of the pattern directory were read"));
        }
        for name in names {
            if self.library.contains_key(&name) {
                list.errors
                    .push(format!("{name}.toml: `{name}` is part of the library: rename the file's pattern"));
                continue;
            }
            match self.get(&name) {
                Ok(stored) => list.patterns.push(stored.entry()),
                // The file was removed since the names were read, or its name is not valid for a pattern.
                Err(StoreError::Unknown { .. }) => {
                    list.errors
                        .push(format!("{}: not a pattern's name: use a-z, 0-9 and - only", quote(&name)));
                }
                Err(error) => list.errors.push(error.to_string()),
            }
        }
        list.errors = first(list.errors);
        list.patterns.sort_by(|a, b| a.name.cmp(&b.name));
        list
    }

    /// Stores a pattern under its name. With `replace` it may replace an older one of that name.
    ///
    /// # Errors
    /// If the text is not a pattern of that name, the pattern is empty, the name is not allowed for a new pattern, belongs to the
    /// library or is taken, or the file cannot be written.
    pub fn put(&self, name: &str, text: &str, replace: bool) -> Result<Put, StoreError> {
        if self.library.contains_key(name) {
            return Err(StoreError::InLibrary { name: name.to_owned(), change: "overwritten" });
        }
        let stored = self.parse(text.as_bytes(), Path::new(&format!("{name}.toml")))?;
        let stored = named(name, stored)?;
        check_new_name(name)?;
        if let Some(why) = stored.run().empty() {
            return Err(StoreError::Empty { name: name.to_owned(), why: why.to_owned() });
        }
        let taken = |sha256| StoreError::Exists { name: name.to_owned(), sha256 };
        let replaced = self.folder.put(name, text, replace, taken)?;
        Ok(Put { stored, replaced })
    }

    /// Removes a pattern of the directory; returns the SHA-256 of its file. Plays that are queued or run hold the pattern.
    ///
    /// # Errors
    /// If there is none, it belongs to the library, or the file cannot be removed.
    pub fn remove(&self, name: &str) -> Result<String, StoreError> {
        if self.library.contains_key(name) {
            return Err(StoreError::InLibrary { name: name.to_owned(), change: "removed" });
        }
        self.folder.remove(name)?.ok_or_else(|| self.unknown(name))
    }

    fn unknown(&self, name: &str) -> StoreError {
        let mut names = self.folder.names().unwrap_or_default();
        names.extend(self.library.keys().cloned());
        // Compare the beginning only: time and memory grow with each letter.
        let asked: String = name.chars().take(64).collect();
        let mut near: Vec<_> = names
            .into_iter()
            .map(|name| (strsim::jaro_winkler(&name, &asked), name))
            .filter(|(likeness, _)| *likeness > 0.7)
            .collect();
        near.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        let nearest = near.into_iter().take(OFFERED).map(|(_, name)| name).collect();
        StoreError::Unknown { name: name.to_owned(), nearest }
    }
}

impl Stored {
    /// A pattern that does not come from the store.
    pub fn made(pattern: Pattern) -> Self {
        let text = pattern.to_toml();
        Self::new(Arc::new(pattern), text.as_bytes(), false)
    }

    fn new(pattern: Arc<Pattern>, text: &[u8], library: bool) -> Self {
        Self {
            pattern,
            sha256: hash(text),
            library,
            text: text.into(),
            json: Arc::default(),
            run: Arc::default(),
        }
    }

    /// Refuses an array that the pattern is not for.
    ///
    /// # Errors
    /// [`StoreError::OtherArray`].
    pub fn check_array(&self, array: Array) -> Result<(), StoreError> {
        let its = self.pattern.array();
        if its == array {
            return Ok(());
        }
        let [its, this] = [its, array].map(|array| array.name().to_owned());
        Err(StoreError::OtherArray { name: self.pattern.name().to_owned(), its, this })
    }

    /// The order for one run of the pattern.
    pub fn run(&self) -> &Outline {
        // The default options are within their ranges.
        self.run.get_or_init(|| Outline::of(&self.pattern, &StrokeOptions::default()).unwrap_or_default())
    }

    /// [`PatternDetails`](meissner_api::PatternDetails) as JSON: made once, in milliseconds for a long pattern.
    pub fn json(&self) -> Arc<[u8]> {
        let made = self.json.get_or_init(|| {
            let Self { pattern, sha256, library, .. } = self;
            let Outline { compiled_ms, drives, .. } = self.run();
            let details = Details {
                pattern,
                sha256,
                library: *library,
                compiled_ms: *compiled_ms,
                drives,
                highest_um: highest_um(pattern, drives),
                rails: rail_loads(pattern),
                warnings: self.run().listed_warnings(),
            };
            // A checked pattern can be written.
            serde_json::to_vec(&details).unwrap_or_default().into()
        });
        Arc::clone(made)
    }

    /// The JSON, if it was made already.
    pub fn made_json(&self) -> Option<Arc<[u8]>> {
        self.json.get().cloned()
    }

    fn entry(&self) -> PatternSummary {
        let Outline { compiled_ms, drives, .. } = self.run();
        PatternSummary {
            name: self.pattern.name().to_owned(),
            array: self.pattern.array().name().to_owned(),
            library: self.library,
            duration_s: self.pattern.duration_s(),
            drives: self.pattern.drives().len(),
            motions: self.pattern.motions().len(),
            drives_moving: drives.iter().filter(|drive| drive.strokes != Some(0)).count(),
            sha256: self.sha256.clone(),
            compiled_ms: *compiled_ms,
            highest_um: highest_um(&self.pattern, drives).into_iter().fold(0.0, f64::max),
        }
    }
}

fn named(name: &str, stored: Stored) -> Result<Stored, StoreError> {
    check_name(name, stored.pattern.name())?;
    Ok(stored)
}

fn parse(text: &str, path: &Path) -> Result<Pattern, StoreError> {
    Ok(Pattern::parse(text, &path.display().to_string())?)
}

/// The first [`MAX_LISTED`] lines, and how many more there are.
fn first(mut lines: Vec<String>) -> Vec<String> {
    let more = lines.len().saturating_sub(MAX_LISTED);
    lines.truncate(MAX_LISTED);
    if more > 0 {
        lines.push(format!("{more} more files cannot be read as patterns"));
    }
    lines
}

/// The greatest height of each pin above rest in one run, µm. A motor's drives do not overlap with one another or with motions, and a
/// waveform is the sum of all motions of its motor.
fn highest_um(pattern: &Pattern, drives: &[ReachedDrive]) -> Vec<f64> {
    let mut highest_um = vec![0.0_f64; pattern.array().motors()];
    let drives =
        drives.iter().filter(|drive| drive.strokes != Some(0)).map(|drive| (drive.motor, drive.reached_um));
    for (motor, um) in drives.chain(motion_heights(pattern)) {
        let highest_um = &mut highest_um[usize::from(motor)];
        *highest_um = highest_um.max(um);
    }
    highest_um
}

/// The current of each rail in a pattern, for motors of unknown capacitance.
fn rail_loads(pattern: &Pattern) -> Vec<RailLoad> {
    // The default options are within their ranges.
    let Ok(strokes) = Strokes::new(pattern, &StrokeOptions::default()) else { return Vec::new() };
    let (rails, ticks) = rail_pulses(&strokes);
    let load = |(rail, pulses): (u8, RailPulses)| {
        let (most_at_once, mean_at_once) = (pulses.most_at_once, pulses.mean_at_once(ticks));
        let one_ma = current_ma(pattern.array(), CAPACITANCE_NF);
        RailLoad {
            rail,
            most_at_once,
            mean_at_once,
            most_ma: f64::from(most_at_once) * one_ma,
            mean_ma: mean_at_once * one_ma,
        }
    };
    (0..).zip(rails).map(load).collect()
}

#[cfg(test)]
mod tests;
