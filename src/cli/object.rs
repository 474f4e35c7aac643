//! Reads objects: a file, or the thing that a shipped target stands for.

use super::files;
use crate::file::{dir_of, open_regular};
use anyhow::{Result, anyhow, bail};
use meissner_design::{shipped, shipped_names};
use meissner_input::message::nearest;
use meissner_touch::{Contact, Object, Touch, surface_of};
use std::io::Read;
use std::path::Path;

/// The most bytes of a file that an object names: a height map of the largest size as 64-bit numbers.
const MAX_NAMED_BYTES: u64 = 160 << 20;

/// The object of an argument, and its contact with the finger.
pub(super) fn of_argument(argument: &str) -> Result<(Object, Contact)> {
    let object = read(argument)?;
    let contact = contact(argument, &object)?;
    Ok((object, contact))
}

/// The contact of an object with the finger; errors call it `argument`.
pub(super) fn contact(argument: &str, object: &Object) -> Result<Contact> {
    let grains = object.grains(object.pitch_mm());
    if grains.is_empty() {
        bail!("{argument}: the object never lies under the finger: move it onto the fingertip");
    }
    Contact::new(grains, object.touch().most_depth_mm()).map_err(|error| anyhow!("{argument}: {error}"))
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
    if files::is_file(argument) {
        let file = Path::new(argument);
        let text = files::text(file, meissner_touch::MAX_FILE_BYTES as u64, "object")?;
        if text.parse::<toml::Table>().is_ok_and(|table| !table.contains_key("kind")) {
            bail!("{argument}: this is no object: an object file has the key `kind = \"object\"`");
        }
        let mut open = |name: &str| {
            let mut bytes = Vec::new();
            open_regular(&dir_of(file).join(name))?.take(MAX_NAMED_BYTES).read_to_end(&mut bytes)?;
            Ok(bytes)
        };
        return Ok(Object::read(&text, argument, &mut open)?);
    }
    let target = shipped(argument).ok_or_else(|| {
        let nearest = nearest(&shipped_names(), argument);
        anyhow!(
            "no object is called `{}`: did you mean `{nearest}`? The name of a file has a slash or ends in .toml",
            argument.escape_debug()
        )
    })?;
    if target.frames().len() > 1 {
        bail!(
            "`{argument}` moves, and only targets at rest are objects by name: write an object file with a scan"
        );
    }
    Ok(Object::new(argument, surface_of(target.shape()), Touch::default()))
}
