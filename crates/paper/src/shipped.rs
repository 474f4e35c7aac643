//! The objects that are built into the program.

use crate::target::Target;
use include_dir::{Dir, File, include_dir};

/// The object files of the repository.
static LIBRARY: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../../library/objects");

/// The shipped object used to compare methods and patterns: an edge at 45°, 12 mm long, through the array's middle.
pub const YARDSTICK: &str = "edge-45";

/// The target of the shipped object of that name, if there is one.
pub fn shipped(name: &str) -> Option<Target> {
    Some(Target::read(shipped_text(name)?, name).expect("shipped targets are valid"))
}

/// The file of the shipped object of that name, if there is one.
pub fn shipped_text(name: &str) -> Option<&'static str> {
    LIBRARY.get_file(format!("{name}.toml")).and_then(File::contents_utf8)
}

/// The names of the shipped objects, sorted.
pub fn shipped_names() -> Vec<&'static str> {
    let paths = LIBRARY.files().map(File::path);
    let toml = paths.filter(|path| path.extension().is_some_and(|extension| extension == "toml"));
    let mut names: Vec<_> = toml.filter_map(|path| path.file_stem()?.to_str()).collect();
    names.sort_unstable();
    names
}
