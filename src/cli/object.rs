//! Reads objects: a file, or the name of a shipped one.

use super::{files, progress};
use crate::file::{dir_of, open_regular};
use anyhow::{Result, anyhow, bail};
use include_dir::{Dir, File, include_dir};
use meissner_input::message::nearest;
use meissner_touch::{Contact, Object};
use std::io::{ErrorKind, Read};
use std::path::Path;
use toml::Table;

static SHIPPED: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/objects");

/// The most bytes of a file that an object names: a height map of the largest size as 64-bit numbers.
const MAX_NAMED_BYTES: u64 = 160 << 20;

/// The object of an argument, and its contact with the finger.
pub(super) fn of_argument(argument: &str) -> Result<(Object, Contact)> {
    let object = read(argument)?;
    // Of rough objects it takes some seconds.
    let contact = progress::metered(|progress| solved(argument, &object, progress))?;
    Ok((object, contact))
}

/// The contact of an object with the finger; errors call it `argument`.
pub(super) fn contact(argument: &str, object: &Object) -> Result<Contact> {
    solved(argument, object, &|_| ())
}

fn solved(argument: &str, object: &Object, progress: &dyn Fn(f64)) -> Result<Contact> {
    let grains = object.grains(object.pitch_mm());
    if grains.is_empty() {
        bail!("{argument}: the object never lies under the finger: move it onto the fingertip");
    }
    Contact::with_progress(grains, object.touch().most_depth_mm(), progress)
        .map_err(|error| anyhow!("{argument}: {error}"))
}

/// The lines that a trace follows.
pub(super) fn lines(argument: &str, object: &Object) -> Result<Vec<Vec<[f64; 2]>>> {
    if !object.touch().stays_in_place() {
        bail!("{argument}: the object moves, and a trace moves by itself: press it, or take another method");
    }
    object.lines_mm().ok_or_else(|| {
        anyhow!("{argument}: heights have no lines to trace: draw it with shape = \"lines\", or take another method")
    })
}

/// The object of an argument.
pub(super) fn read(argument: &str) -> Result<Object> {
    let text = text(argument)?;
    let dir = if files::is_file(argument) { dir_of(Path::new(argument)) } else { Path::new("") };
    let mut open = |name: &str| {
        let mut bytes = Vec::new();
        open_regular(&dir.join(name))?.take(MAX_NAMED_BYTES).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    Ok(Object::read(&text, argument, &mut open)?)
}

/// The keys of an argument's object; none if it needs other files.
pub(super) fn keys(argument: &str) -> Result<Option<Table>> {
    let text = text(argument)?;
    let mut none = |_: &str| Err(ErrorKind::NotFound.into());
    Ok(Object::read(&text, argument, &mut none).ok().and_then(|_| text.parse().ok()))
}

/// The text of a file, or of a shipped object.
fn text(argument: &str) -> Result<String> {
    if files::is_file(argument) {
        let text = files::text(Path::new(argument), meissner_touch::MAX_FILE_BYTES as u64, "object")?;
        if text.parse::<Table>().is_ok_and(|table| !table.contains_key("kind")) {
            bail!("{argument}: this is no object: an object file has the key `kind = \"object\"`");
        }
        return Ok(text);
    }
    let shipped = SHIPPED.get_file(format!("{argument}.toml")).and_then(File::contents_utf8);
    shipped.map(ToOwned::to_owned).ok_or_else(|| {
        let names = SHIPPED.files().filter_map(|file| file.path().file_stem()?.to_str());
        let nearest = nearest(&names.collect::<Vec<_>>(), argument);
        anyhow!(
            "no object is called `{}`: did you mean `{nearest}`? The name of a file has a slash or ends in .toml",
            argument.escape_debug()
        )
    })
}
