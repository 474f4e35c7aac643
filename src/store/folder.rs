//! The folder of the site's patterns: TOML files, each of which has the name of its pattern.
//!
//! It knows bytes and names, and no patterns. It is read at every request, so it finds manually added files at once.
//! Calls block for as long as the disk takes.
//!
//! Invariant: no name leads out of the folder, and a file is replaced atomically.

use crate::file::{self, LISTED_BY_ALL, READABLE_BY_ALL, make_dirs, open_regular};
use meissner_array::pattern::{is_name, is_new_name};
use meissner_input::message::quote;
use sha2::{Digest, Sha256};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Most files of a folder that are read.
pub const MAX_FILES: usize = 10_000;

/// Why a file is refused, whatever it holds.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file's name and the name in it differ.
    #[error("{}: `name` is `{inside}`: must be the name it is stored under; change one of them", quote(.name))]
    Name {
        /// The name it was to be stored under.
        name: String,
        /// The name in the text.
        inside: String,
    },
    /// A name that a command line would misread.
    #[error("{}: a new name begins with a letter or a digit: a command line takes `-` for stdin or an option", quote(.name))]
    NewName {
        /// The name it was to be stored under.
        name: String,
    },
    /// A file that is not UTF-8 text.
    #[error("{}: not UTF-8 text: write patterns as TOML in UTF-8", .path.display())]
    NotText {
        /// The file.
        path: PathBuf,
    },
    /// No directory to write to.
    #[error("there is no pattern directory: set patterns_dir in the daemon's configuration")]
    NoDirectory,
    /// The disk or the permissions.
    #[error("{}: {source}; check that it exists, that the disk has space and that the daemon may use it", .path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl FileError {
    /// Whether the disk or the configuration is the reason, not the file's text or name.
    pub const fn is_of_disk(&self) -> bool {
        matches!(self, Self::NoDirectory | Self::Io { .. })
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct Folder {
    dir: Option<PathBuf>,
    /// Whether a missing folder, with those above it, is made when a file is stored.
    make: bool,
    /// Held while a file is replaced or removed, so that the answer names the file that was there.
    writing: Mutex<()>,
}

impl Folder {
    pub(super) const fn new(dir: Option<PathBuf>, make: bool) -> Self {
        Self { dir, make, writing: Mutex::new(()) }
    }

    /// The file of a name; `None` if the name is not valid, or there is no folder.
    fn path(&self, name: &str) -> Option<PathBuf> {
        is_name(name).then_some(())?;
        Some(self.dir.as_ref()?.join(format!("{name}.toml")))
    }

    /// The names of its first [`MAX_FILES`] files, sorted. A folder that would be made has none.
    pub(super) fn names(&self) -> Result<Vec<String>, FileError> {
        let Some(dir) = &self.dir else { return Ok(Vec::new()) };
        let entries = match fs::read_dir(dir) {
            Err(error) if error.kind() == io::ErrorKind::NotFound && self.make => {
                return Ok(Vec::new());
            }
            entries => entries.map_err(failed(dir))?,
        };
        let mut names: Vec<String> = entries
            .filter_map(|entry| {
                entry.ok()?.file_name().into_string().ok()?.strip_suffix(".toml").map(str::to_owned)
            })
            // Skip temporary files of editors and of `replace`.
            .filter(|name| !name.starts_with('.'))
            .take(MAX_FILES)
            .collect();
        names.sort_unstable();
        Ok(names)
    }

    /// The path and the bytes of a file, cut at one more than `most`, which the parser refuses; `None` if there is no such file.
    pub(super) fn read(&self, name: &str, most: usize) -> Result<Option<(PathBuf, Vec<u8>)>, FileError> {
        let Some(path) = self.path(name) else { return Ok(None) };
        let mut bytes = Vec::new();
        match open_regular(&path).and_then(|file| file.take(most as u64 + 1).read_to_end(&mut bytes)) {
            Ok(_) => Ok(Some((path, bytes))),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(FileError::Io { path, source }),
        }
    }

    /// Stores a file; returns the SHA-256 of the one that it replaced. If there is one and `replace` is not set, the error is
    /// `taken` of its SHA-256.
    pub(super) fn put<E: From<FileError>>(
        &self,
        name: &str,
        text: &str,
        replace: bool,
        taken: impl FnOnce(String) -> E,
    ) -> Result<Option<String>, E> {
        let (Some(dir), Some(path)) = (&self.dir, self.path(name)) else {
            return Err(FileError::NoDirectory.into());
        };
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if self.make {
            make_dirs(dir, LISTED_BY_ALL).map_err(failed(dir))?;
        }
        let replaced = present(&path)?;
        if let Some(sha256) = replaced.clone().filter(|_| !replace) {
            return Err(taken(sha256));
        }
        file::replace(&path, text.as_bytes(), READABLE_BY_ALL).map_err(failed(&path))?;
        Ok(replaced)
    }

    /// Removes a file; returns its SHA-256, or `None` if there is no such file.
    pub(super) fn remove(&self, name: &str) -> Result<Option<String>, FileError> {
        let (Some(dir), Some(path)) = (&self.dir, self.path(name)) else { return Ok(None) };
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(sha256) = present(&path)? else { return Ok(None) };
        fs::remove_file(&path).and_then(|()| File::open(dir)?.sync_all()).map_err(failed(&path))?;
        Ok(Some(sha256))
    }
}

/// The text of a file.
pub(super) fn text<'a>(bytes: &'a [u8], path: &Path) -> Result<&'a str, FileError> {
    std::str::from_utf8(bytes).map_err(|_| FileError::NotText { path: path.to_owned() })
}

/// Refuses a text with another name than that of its file.
pub(super) fn check_name(name: &str, inside: &str) -> Result<(), FileError> {
    if inside == name {
        return Ok(());
    }
    Err(FileError::Name { name: name.to_owned(), inside: inside.to_owned() })
}

/// Refuses a name that a command line would misread.
pub(super) fn check_new_name(name: &str) -> Result<(), FileError> {
    if is_new_name(name) { Ok(()) } else { Err(FileError::NewName { name: name.to_owned() }) }
}

fn failed(path: &Path) -> impl FnOnce(io::Error) -> FileError {
    move |source| FileError::Io { path: path.to_owned(), source }
}

/// SHA-256 of the file, if it exists.
fn present(path: &Path) -> Result<Option<String>, FileError> {
    let mut hasher = Sha256::new();
    match open_regular(path).and_then(|mut file| io::copy(&mut file, &mut hasher)) {
        Ok(_) => Ok(Some(hexadecimal(&hasher.finalize()))),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(failed(path)(source)),
    }
}

/// SHA-256 in hexadecimal.
pub(crate) fn hash(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

/// Bytes in hexadecimal.
pub(crate) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
