//! What fingers feel of an object: the patterns of all methods and rules.

use crate::rendering::{METHODS, of_touch};
use anyhow::Result;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_render::{Method, Rival, TRACE_MM_S, render, trace};
use meissner_touch::{Contact, Object};

/// A pattern, and for how long fingers feel it.
#[derive(Debug)]
pub(super) struct Presented {
    pub(super) name: String,
    pub(super) pattern: Pattern,
    /// Whether it has its own time, and not that of the touch.
    pub(super) is_traced: bool,
}

/// The patterns of all methods and rules; a stroke of objects that move alone.
pub(super) fn presented(array: Array, object: &Object, contact: &Contact) -> Result<Vec<Presented>> {
    let touch = object.touch();
    let mut patterns = Vec::new();
    let mut add = |name: &str, pattern, is_traced| {
        patterns.push(Presented { name: name.to_owned(), pattern, is_traced });
    };
    for (name, _) in METHODS {
        let method = of_touch(serde_json::from_value((*name).into())?);
        let levels = match (method, object.lines_mm()) {
            (Some(Method::Stroke), _) if touch.stays_in_place() => continue,
            (Some(method), _) => Ok(render(array, contact, touch, method).0),
            (None, Some(lines)) if touch.stays_in_place() => trace(array, &lines, TRACE_MM_S),
            _ => continue,
        };
        // What cannot be traced is not judged so.
        let Ok(levels) = levels else { continue };
        let pattern = levels.pattern(array, "rendered", toml::Table::new())?;
        add(&format!("render {name}"), pattern, method.is_none());
    }
    for (name, rival) in
        [("nearest pins at 60 Hz", Rival::Nearest), ("within reach at 60 Hz", Rival::WithinReach)]
    {
        add(name, rival.pattern(array, contact, touch)?, false);
    }
    Ok(patterns)
}

/// A number of fingers.
pub(super) fn fingers_shown(count: usize) -> String {
    if count == 1 { "1 finger".to_owned() } else { format!("{count} fingers") }
}
