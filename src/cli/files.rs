//! Reads and writes the files of commands.
//!
//! An argument with a slash or the ending `.toml` is a file; others are names of shipped patterns and targets. A new file is made
//! beside its place before the work, so that an unwritable place is reported at once. After the work it is renamed. A device, a
//! pipe or a link is refused: the rename would replace it.
//!
//! Invariant: an existing file is replaced atomically; a file that is too large is not read into memory.

use crate::file::{dir_of, read_regular};
use anyhow::{Result, anyhow, bail};
use meissner_array::pattern;
use std::fs::{self, File, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// The argument for stdin.
pub(super) const STDIN: &str = "-";
const BYTE_ORDER_MARK: char = '\u{feff}';

/// A new file, and its final place.
#[derive(Debug)]
pub(super) struct Beside {
    new: NamedTempFile,
    place: PathBuf,
}

/// The kinds of files that people write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Pattern,
    Object,
    Scene,
}

impl Kind {
    /// The kind of a TOML text: the first key that only one kind has decides.
    pub(super) fn of(text: &str) -> Option<Self> {
        text.lines().find_map(|line| {
            let key = line.trim_start().trim_start_matches('[').split(['=', ']', '.', ' ', '\t']).next()?;
            match key {
                "format" | "drive" | "wave" | "ramp" | "tone" | "provenance" => Some(Self::Pattern),
                "shape" | "touch" => Some(Self::Object),
                "drives" | "afferents" | "receptors" | "pins" => Some(Self::Scene),
                _ => None,
            }
        })
    }

    /// Refuses a text of another kind, of which every key would be called unknown.
    pub(super) fn check(self, text: &str, at: &str) -> Result<()> {
        let name = |kind| match kind {
            Self::Pattern => "a pattern",
            Self::Object => "an object",
            Self::Scene => "a scene",
        };
        let Some(found) = Self::of(text).filter(|found| *found != self) else { return Ok(()) };
        let advice = match found {
            Self::Pattern => "`meissner play`, `simulate` and `judge` take patterns",
            Self::Object => "make a pattern of it with `meissner render` or `meissner optimise`",
            Self::Scene => "`meissner simulate` and `meissner tradeoff` take scenes",
        };
        bail!("{at}: this is {}, not {}: {advice}", name(found), name(self))
    }
}

/// Whether an argument is a file rather than a name.
pub(super) fn is_file(argument: &str) -> bool {
    argument.contains('/') || argument.ends_with(".toml")
}

/// Reads a file of at most `most` bytes; errors call it a `kind` file.
///
/// # Errors
/// It is too large, cannot be read, or is not UTF-8 text: in one line.
pub(super) fn text(place: &Path, most: u64, kind: &str) -> Result<String> {
    let at = shown(place);
    if let Ok(found) = fs::metadata(place)
        && found.is_file()
        && found.len() > most
    {
        bail!("{at}: {} bytes are too many: {kind} file has at most {most}", found.len());
    }
    let bytes = read_regular(place, most)
        .map_err(|error| anyhow!("{at}: cannot be read; name {kind} file ({error})"))?;
    utf8(bytes, &at, kind)
}

/// Reads the text of a file or, for `-`, of stdin. Returns it with its name in errors.
pub(super) fn text_or_stdin(place: &Path, most: u64, kind: &str) -> Result<(String, String)> {
    if place == Path::new(STDIN) {
        let text = utf8(bytes(place, most, kind)?, "stdin", kind)?;
        return Ok((text, "stdin".to_owned()));
    }
    Ok((text(place, most, kind)?, shown(place)))
}

/// Reads a file, a pipe or, for `-`, stdin to its end: at most `most` bytes.
pub(super) fn bytes(place: &Path, most: u64, kind: &str) -> Result<Vec<u8>> {
    let is_stdin = place == Path::new(STDIN);
    let at = if is_stdin { "stdin".to_owned() } else { shown(place) };
    let mut bytes = Vec::new();
    let read = if is_stdin {
        io::stdin().lock().take(most + 1).read_to_end(&mut bytes)
    } else {
        File::open(place).and_then(|file| file.take(most + 1).read_to_end(&mut bytes))
    };
    read.map_err(|error| anyhow!("{at}: cannot be read; name {kind} file ({error})"))?;
    if bytes.len() as u64 > most {
        bail!("{at}: more than {most} bytes are too many for {kind} file");
    }
    Ok(bytes)
}

/// Text without its byte order mark, which editors and spreadsheets of Windows write.
fn utf8(bytes: Vec<u8>, at: &str, kind: &str) -> Result<String> {
    let mut text =
        String::from_utf8(bytes).map_err(|_| anyhow!("{at}: not UTF-8 text: name {kind} file in UTF-8"))?;
    if text.starts_with(BYTE_ORDER_MARK) {
        text.drain(..BYTE_ORDER_MARK.len_utf8());
    }
    Ok(text)
}

/// Makes a new file beside a place.
pub(super) fn beside(place: &Path) -> Result<Beside> {
    if fs::symlink_metadata(place).is_ok_and(|found| !found.is_file()) {
        bail!("{}: is not a regular file: name a regular or a new file", shown(place));
    }
    let new = tempfile::Builder::new().permissions(Permissions::from_mode(0o666)).tempfile_in(dir_of(place));
    Ok(Beside { new: new.map_err(|error| cannot_write(place, &error))?, place: place.to_owned() })
}

impl Beside {
    /// Writes the text and renames the file into its place.
    pub(super) fn write(self, text: &str) -> Result<()> {
        let Self { mut new, place } = self;
        let written = new.write_all(text.as_bytes()).and_then(|()| new.as_file().sync_all());
        let written = written.and_then(|()| Ok(new.persist(&place).map(drop)?));
        written.map_err(|error| cannot_write(&place, &error))
    }
}

/// A path, escaped to fit on one line.
pub(super) fn shown(place: &Path) -> String {
    place.to_string_lossy().escape_debug().to_string()
}

fn cannot_write(place: &Path, error: &io::Error) -> anyhow::Error {
    let cause =
        error.get_ref().and_then(std::error::Error::source).map_or(error.to_string(), ToString::to_string);
    anyhow!(
        "{}: cannot be written; check that the directory exists and that you may write there ({cause})",
        shown(place)
    )
}

/// Whether an argument was read from this file, also through links.
pub(super) fn is_itself(argument: &str, file: &Path) -> bool {
    let found = |file: &Path| fs::canonicalize(file).ok();
    is_file(argument) && found(file).is_some_and(|file| Some(file) == found(Path::new(argument)))
}

/// The name of a pattern that is written to a file: the store requires that both have the same name.
pub(super) fn pattern_name(file: &Path) -> Result<String> {
    if file == Path::new("-") {
        bail!("-o -: not a file: leave -o out to write to stdout");
    }
    let stem = file.file_stem().and_then(|stem| stem.to_str()).filter(|stem| pattern::is_name(stem));
    stem.map(str::to_owned).ok_or_else(|| {
        let place = file.to_string_lossy();
        anyhow!("{}: not a pattern's name: write 1 to 64 of a-z, 0-9 and -, then .toml", place.escape_debug())
    })
}

#[cfg(test)]
mod tests {
    use super::Kind;

    #[test]
    fn a_kind_is_told_by_its_first_own_key() {
        for (text, kind) in [
            ("# a\nformat = 1\n", Some(Kind::Pattern)),
            ("name = \"a\"\n  format=1\n", Some(Kind::Pattern)),
            ("name = \"a\"\n[[ramp]]\nmotor = 1\n", Some(Kind::Pattern)),
            ("format = 1\n[provenance.definition]\nshape = \"dots\"\n", Some(Kind::Pattern)),
            ("duration_s = 1.0\nmotion.frames = 2\nshape = \"dots\"\n", Some(Kind::Object)),
            ("duration_s = 1.0\n[[drives]]\nformat = 1\n", Some(Kind::Scene)),
            ("noise = false\nramp_s = 0.1\npins = []\n", Some(Kind::Scene)),
            ("{\"duration_s\": 1.0}", None),
            ("formats = 1", None),
        ] {
            assert_eq!(Kind::of(text), kind, "{text}");
        }
    }
}
