//! Reads objects: a file, or the name of a shipped one.

use super::files::{self, Kind};
use super::progress;
use crate::file::{dir_of, open_regular};
use crate::rendering::{self, keys_or_name};
use anyhow::{Result, anyhow};
use meissner_input::message::nearest;
use meissner_paper::{shipped_names, shipped_text};
use meissner_touch::{Contact, Object};
use std::io::Read;
use std::path::Path;
use toml::Value;

/// The most bytes of a file that an object names: a height map of the largest size as 64-bit numbers.
const MAX_NAMED_BYTES: u64 = 160 << 20;

/// The object of an argument, and its contact with the finger.
pub(super) fn of_argument(argument: &str) -> Result<(Object, Contact)> {
    let object = read(argument)?;
    // Of rough objects it takes some seconds.
    let contact = progress::metered(|progress| rendering::contact(&object, progress));
    Ok((object, contact.map_err(|error| anyhow!("{argument}: {error}"))?))
}

/// The contact of an object with the finger; errors call it `argument`.
pub(super) fn contact(argument: &str, object: &Object) -> Result<Contact> {
    rendering::contact(object, &|_| ()).map_err(|error| anyhow!("{argument}: {error}"))
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

/// The object of an argument for a pattern's provenance.
pub(super) fn keys(argument: &str, name: &str) -> Result<Value> {
    Ok(keys_or_name(&text(argument)?, name))
}

/// The text of a file, or of a shipped object.
pub(super) fn text(argument: &str) -> Result<String> {
    if files::is_file(argument) {
        let text = files::text(Path::new(argument), meissner_touch::MAX_FILE_BYTES as u64, "an object")?;
        Kind::Object.check(&text, &files::shown(Path::new(argument)))?;
        return Ok(text);
    }
    shipped_text(argument).map(ToOwned::to_owned).ok_or_else(|| {
        let nearest = nearest(&shipped_names(), argument);
        anyhow!(
            "no object is called `{}`: did you mean `{nearest}`? The name of a file has a slash or ends in .toml",
            argument.escape_debug()
        )
    })
}
